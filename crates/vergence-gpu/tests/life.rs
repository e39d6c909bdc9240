//! What lives how long: adoption, counting, keeping what is in use, misuse, devices that are not there.

// A stand-in for a runtime handles raw Vulkan, as a runtime does.
#![allow(unsafe_code)]
#![allow(clippy::unwrap_used)]

mod shared;

use std::sync::Arc;

use shared::{assert_valid, device};
use vergence_gpu::{
    Buffer, Census, CommandBuffer, Device, DeviceDesc, Error, Image, ImageDesc, Instance, InstanceDesc,
    Memory, ReadBack, Sampler, SamplerDesc, Signal, Timeline, Upload, Use, VulkanCreator, Wait, vk,
};

const RED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];

fn target(device: &Arc<Device>) -> Arc<Image> {
    let desc = ImageDesc {
        name: "target",
        width: 8,
        height: 8,
        usage: vk::ImageUsageFlags::TRANSFER_DST
            | vk::ImageUsageFlags::TRANSFER_SRC
            | vk::ImageUsageFlags::SAMPLED,
        ..Default::default()
    };
    Image::new(device, &desc).unwrap()
}

/// A runtime works on its application's device: the adopted wrapper draws into the application's image, the application reads it.
#[test]
fn an_adopted_device_shares_images_and_queue_and_destroys_nothing() {
    let Some(owner) = device() else { return };
    let image = target(&owner);
    // SAFETY: the owner outlives the adopted device, and was made by this crate, so with all that is required.
    let adopted = unsafe { Device::adopt(&owner.raw()) }.unwrap();
    assert_eq!(adopted.limits().name, owner.limits().name);
    let desc =
        ImageDesc { name: "borrowed", width: 8, height: 8, usage: image.usage(), ..Default::default() };
    // SAFETY: the image is of the device that was adopted, is described by `desc`, and outlives the wrapper.
    let borrowed = unsafe { Image::borrowed(&adopted, image.handle(), &desc) };
    assert_eq!((adopted.census().borrowed_images, adopted.census().images), (1, 0));

    // Both submit from their own threads; the shared lock keeps the queue to one at a time (the validation layer checks that).
    let theirs = Arc::clone(&adopted);
    let runtime = std::thread::spawn(move || {
        let mut commands = CommandBuffer::new(&theirs, "runtime", 0).unwrap();
        for _ in 0..50 {
            let mut encoder = commands.record().unwrap();
            encoder.transition(&borrowed, Use::Undefined, Use::TransferDestination);
            encoder.clear(&borrowed, RED);
            encoder.finish().unwrap();
            theirs.submit(&mut commands, &[], &[]).unwrap();
        }
    });
    let own = target(&owner);
    let mut commands = CommandBuffer::new(&owner, "application", 0).unwrap();
    for _ in 0..50 {
        let mut encoder = commands.record().unwrap();
        encoder.transition(&own, Use::Undefined, Use::TransferDestination);
        encoder.clear(&own, RED);
        encoder.finish().unwrap();
        owner.submit(&mut commands, &[], &[]).unwrap();
    }
    runtime.join().unwrap();
    assert_eq!(adopted.last_submission(), 50, "each wrapper counts its own submissions");
    adopted.wait_idle().unwrap();
    drop(adopted);

    let mut texels = Vec::new();
    ReadBack::new(&owner).unwrap().layer(&image, 0, Use::TransferDestination, &mut texels).unwrap();
    assert!(texels.chunks(4).all(|t| t == [255, 0, 0, 255]));
    assert_valid(&owner);
}

#[test]
fn everything_is_counted_and_goes_away() {
    let Some(device) = device() else { return };
    assert_eq!(device.census(), Census::default());
    let image = target(&device);
    let view = image.view().unwrap();
    let sampler = Sampler::new(&device, &SamplerDesc::default()).unwrap();
    let buffer =
        Buffer::new(&device, "buffer", 1000, vk::BufferUsageFlags::UNIFORM_BUFFER, Memory::Upload).unwrap();
    let census = device.census();
    assert_eq!((census.images, census.image_views, census.samplers, census.buffers), (1, 1, 1, 1));
    assert!(census.image_bytes >= 8 * 8 * 4 && census.buffer_bytes >= 1000);
    assert_eq!(device.allocated_bytes(), census.image_bytes + census.buffer_bytes);
    drop(image);
    assert_eq!(device.census().images, 1, "a view keeps its image");
    drop((view, sampler, buffer));
    assert_eq!(device.census(), Census::default());
    assert_valid(&device);
}

/// What was recorded stays alive until its submission is complete, even if everybody else lets go of it.
#[test]
fn commands_keep_what_they_use() {
    let Some(device) = device() else { return };
    let mut commands = CommandBuffer::new(&device, "frame", 0).unwrap();
    for _ in 0..20 {
        let image = target(&device);
        let mut encoder = commands.record().unwrap();
        encoder.transition(&image, Use::Undefined, Use::TransferDestination);
        encoder.clear(&image, RED);
        encoder.finish().unwrap();
        drop(image);
        assert_eq!(device.census().images, 1);
        device.submit(&mut commands, &[], &[]).unwrap();
    }
    drop(commands);
    assert_eq!(device.census(), Census::default());
    assert_valid(&device);
}

#[test]
fn timelines_order_submissions_and_the_host() {
    let Some(device) = device() else { return };
    let timeline = Timeline::new(&device, 5).unwrap();
    let mut commands = CommandBuffer::new(&device, "empty", 0).unwrap();
    commands.record().unwrap().finish().unwrap();
    let wait = Wait { timeline: &timeline, value: 6, stages: vk::PipelineStageFlags2::ALL_COMMANDS };
    let number = device.submit(&mut commands, &[wait], &[Signal { timeline: &timeline, value: 7 }]).unwrap();
    // What is found is judged once nothing waits any more: a test that fails must not wait for its own submission.
    let waited = timeline.wait(7, 1_000_000);
    let completed = device.completed().unwrap();
    let backwards = timeline.signal(5);
    timeline.signal(6).unwrap();
    assert!(
        matches!(waited, Err(Error::Timeout { timeout_ms: 1, .. })),
        "nothing was signalled yet: {waited:?}"
    );
    assert!(completed < number);
    assert!(backwards.is_err(), "a timeline only grows");
    timeline.wait(7, 10_000_000_000).unwrap();
    device.wait(number).unwrap();
    assert!(device.wait(number + 1).is_err(), "what was never submitted would be waited for in vain");
    assert_valid(&device);
}

#[test]
fn misuse_is_an_error_at_the_end_of_recording() {
    let Some(device) = device() else { return };
    let small = Buffer::new(&device, "small", 16, vk::BufferUsageFlags::empty(), Memory::Upload).unwrap();
    let image = target(&device);
    let mut commands = CommandBuffer::new(&device, "wrong", 0).unwrap();
    assert!(device.submit(&mut commands, &[], &[]).is_err(), "nothing was recorded");
    let mut wrong = |record: &dyn Fn(&mut vergence_gpu::Encoder<'_>)| {
        let mut encoder = commands.record().unwrap();
        record(&mut encoder);
        encoder.finish().unwrap_err().to_string()
    };
    assert!(wrong(&|e| e.draw(3, 0, 1, 0)).contains("a draw outside of rendering"));
    assert!(wrong(&|e| e.end_rendering()).contains("not begun"));
    assert!(wrong(&|e| e.begin_pass("open")).contains("open"));
    assert!(wrong(&|e| e.copy_buffer(&small, 0, &small, 8, 16)).contains("outside of a buffer"));
    let whole = vergence_gpu::Area::whole(&image, 0, 0);
    assert!(
        wrong(&|e| e.copy_buffer_to_image(&small, 0, &image, whole))
            .contains("outside of an image or buffer")
    );
    assert!(wrong(&|e| e.push(0, &1.0f32)).contains("without a pipeline"));
    assert!(wrong(&|e| e.dispatch(1, 1, 1)).contains("without a compute pipeline"));
    let other = shared::device().unwrap();
    let foreign = Buffer::new(&other, "foreign", 16, vk::BufferUsageFlags::empty(), Memory::Device).unwrap();
    assert!(wrong(&|e| e.copy_buffer(&small, 0, &foreign, 0, 16)).contains("another device"));
    assert!(other.submit(&mut commands, &[], &[]).is_err(), "commands of another device");
    // The command buffer is not spoiled.
    commands.record().unwrap().finish().unwrap();
    device.submit(&mut commands, &[], &[]).unwrap();
    assert_valid(&device);
}

#[test]
fn more_than_the_device_has_is_refused() {
    let Some(device) = device() else { return };
    let size = device.limits().max_image_size;
    let big = ImageDesc { width: size + 1, usage: vk::ImageUsageFlags::SAMPLED, ..Default::default() };
    assert!(matches!(Image::new(&device, &big), Err(Error::Unsupported { .. })));
    let none = ImageDesc { width: 0, usage: vk::ImageUsageFlags::SAMPLED, ..Default::default() };
    assert!(matches!(Image::new(&device, &none), Err(Error::Unsupported { .. })));
    let much = SamplerDesc { anisotropy: 1000.0, ..Default::default() };
    assert!(matches!(Sampler::new(&device, &much), Err(Error::Unsupported { .. })));
    let nan = SamplerDesc { anisotropy: f32::NAN, ..Default::default() };
    assert!(Sampler::new(&device, &nan).is_err());
    assert!(
        Upload::new(&device).unwrap().buffer::<u32>("empty", &[], vk::BufferUsageFlags::empty()).is_err()
    );
    assert!(vergence_gpu::ShaderModule::new(&device, &[1, 2, 3]).is_err());
    assert_valid(&device);
}

/// A creator stands in for an OpenXR runtime: it makes both, from the create infos that it is given.
#[test]
fn a_creator_makes_instance_and_device() {
    struct Runtime {
        calls: Vec<&'static str>,
    }
    // SAFETY: the handles are made from the infos given, by the loader, and left alone.
    unsafe impl VulkanCreator for Runtime {
        unsafe fn create_instance(
            &mut self,
            get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
            info: &vk::InstanceCreateInfo<'_>,
        ) -> Result<vk::Instance, Error> {
            self.calls.push("instance");
            // SAFETY: the caller gives the loader's entry point.
            let entry = unsafe { ash::Entry::from_static_fn(ash::StaticFn { get_instance_proc_addr }) };
            // SAFETY: the caller gives a valid info.
            let instance = unsafe { entry.create_instance(info, None) };
            instance
                .map(|i| i.handle())
                .map_err(|e| Error::creator("xrCreateVulkanInstanceKHR", e.to_string()))
        }
        fn physical_device(&mut self, instance: vk::Instance) -> Result<vk::PhysicalDevice, Error> {
            self.calls.push("physical device");
            // SAFETY: the loader is there, since the instance is.
            let entry = unsafe { ash::Entry::load() }.unwrap();
            // SAFETY: the instance was made above.
            let instance = unsafe { ash::Instance::load(entry.static_fn(), instance) };
            // SAFETY: as above.
            Ok(unsafe { instance.enumerate_physical_devices() }.unwrap()[0])
        }
        unsafe fn create_device(
            &mut self,
            get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
            physical_device: vk::PhysicalDevice,
            _info: &vk::DeviceCreateInfo<'_>,
        ) -> Result<vk::Device, Error> {
            let _ = (get_instance_proc_addr, physical_device);
            self.calls.push("device");
            Err(Error::creator("xrCreateVulkanDeviceKHR", "this runtime has no headset"))
        }
    }
    if device().is_none() {
        return;
    }
    let mut runtime = Runtime { calls: Vec::new() };
    let desc = InstanceDesc { app_name: "creator", validation: true, surface: None };
    let instance = Instance::new(&desc, Some(&mut runtime)).unwrap();
    let error = Device::new(&instance, &DeviceDesc::default(), Some(&mut runtime)).err().unwrap();
    assert_eq!(error.to_string(), "xrCreateVulkanDeviceKHR failed: this runtime has no headset");
    assert_eq!(runtime.calls, ["instance", "physical device", "device"]);
    assert_eq!(instance.validation_messages(), [""; 0]);
}

#[test]
fn pipeline_caches_of_other_drivers_are_ignored() {
    let Some(device) = device() else { return };
    let data = device.pipeline_cache_data().unwrap();
    device.load_pipeline_cache(&data).unwrap();
    device.load_pipeline_cache(&[]).unwrap();
    device.load_pipeline_cache(&[7; 100]).unwrap();
    let mut other = data.clone();
    other[16] ^= 1;
    device.load_pipeline_cache(&other).unwrap();
    assert_valid(&device);
}

#[test]
fn devices_are_described_with_what_they_lack() {
    let Ok(instance) = Instance::new(&InstanceDesc::default(), None) else {
        assert!(!shared::required());
        eprintln!("skipped: no Vulkan device");
        return;
    };
    for device in instance.describe_devices().unwrap() {
        assert!(!device.name.is_empty() && device.vulkan.starts_with("1."), "{device:?}");
    }
}
