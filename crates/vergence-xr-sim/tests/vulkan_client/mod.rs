//! A small OpenXR application on Vulkan, with validation on, that submits what a test gives it.

use std::sync::Arc;

use openxr as xr;
use vergence_geom::Rigid;
use vergence_gpu::vk::{self, Handle as _};
use vergence_gpu::{
    Area, Buffer, CommandBuffer, Device, DeviceDesc, Error, Image, ImageDesc, Instance, InstanceDesc, Memory,
    Use, VulkanCreator,
};
use vergence_xr_sim::{Config, Runtime, get_instance_proc_addr};
use xr::sys;

const STEREO: xr::ViewConfigurationType = xr::ViewConfigurationType::PRIMARY_STEREO;

struct Creator<'a>(&'a xr::Instance, xr::SystemId);

fn refused(code: impl std::fmt::Debug) -> Error {
    Error::creator("OpenXR", format!("{code:?}"))
}

// SAFETY: the runtime passes the create info on and only adds to it.
unsafe impl VulkanCreator for Creator<'_> {
    unsafe fn create_instance(
        &mut self,
        gipa: vk::PFN_vkGetInstanceProcAddr,
        info: &vk::InstanceCreateInfo<'_>,
    ) -> Result<vk::Instance, Error> {
        // SAFETY: both are the type of vkGetInstanceProcAddr.
        let gipa = unsafe {
            std::mem::transmute::<vk::PFN_vkGetInstanceProcAddr, sys::platform::VkGetInstanceProcAddr>(gipa)
        };
        // SAFETY: the create info is valid, as the caller says.
        let made = unsafe { self.0.create_vulkan_instance(self.1, gipa, std::ptr::from_ref(info).cast()) };
        let raw = made.map_err(refused)?.map_err(refused)?;
        Ok(vk::Instance::from_raw(raw as u64))
    }

    fn physical_device(&mut self, instance: vk::Instance) -> Result<vk::PhysicalDevice, Error> {
        // SAFETY: the instance was made above.
        let found = unsafe { self.0.vulkan_graphics_device(self.1, instance.as_raw() as *const _) };
        Ok(vk::PhysicalDevice::from_raw(found.map_err(refused)? as u64))
    }

    unsafe fn create_device(
        &mut self,
        gipa: vk::PFN_vkGetInstanceProcAddr,
        physical: vk::PhysicalDevice,
        info: &vk::DeviceCreateInfo<'_>,
    ) -> Result<vk::Device, Error> {
        // SAFETY: both are the type of vkGetInstanceProcAddr.
        let gipa = unsafe {
            std::mem::transmute::<vk::PFN_vkGetInstanceProcAddr, sys::platform::VkGetInstanceProcAddr>(gipa)
        };
        let (physical, info) = (physical.as_raw() as *const _, std::ptr::from_ref(info).cast());
        // SAFETY: the create info is valid, as the caller says.
        let made = unsafe { self.0.create_vulkan_device(self.1, gipa, physical, info) };
        Ok(vk::Device::from_raw(made.map_err(refused)?.map_err(refused)? as u64))
    }
}

pub struct Client {
    // In the order of destruction: the session before the device that it lives on.
    local: xr::Space,
    view: xr::Space,
    stream: xr::FrameStream<xr::Vulkan>,
    waiter: xr::FrameWaiter,
    pub session: xr::Session<xr::Vulkan>,
    pub instance: xr::Instance,
    pub device: Arc<Device>,
}

/// A projection layer, open to be spoiled.
pub struct Projection {
    pub views: [sys::CompositionLayerProjectionView; 2],
    pub view_count: u32,
    pub space: sys::Space,
    depth: Option<Box<[sys::CompositionLayerDepthInfoKHR; 2]>>,
}

impl Client {
    /// `None`, said aloud, where there is no Vulkan device.
    pub fn new(config: Config) -> Option<Self> {
        Runtime::configure(config);
        // SAFETY: the runtime follows the specification.
        let entry = unsafe { xr::Entry::from_get_instance_proc_addr(get_instance_proc_addr, &()).unwrap() };
        let mut extensions = xr::ExtensionSet::default();
        extensions.khr_vulkan_enable2 = true;
        extensions.khr_composition_layer_depth = true;
        let instance = entry
            .create_instance(
                &xr::ApplicationInfo {
                    application_name: "test",
                    api_version: xr::Version::new(1, 0, 0),
                    ..Default::default()
                },
                &extensions,
                &[],
                &(),
            )
            .unwrap();
        let system = instance.system(xr::FormFactor::HEAD_MOUNTED_DISPLAY).unwrap();
        let mut creator = Creator(&instance, system);
        let desc = InstanceDesc { app_name: "test", validation: true, surface: None };
        let device = Instance::new(&desc, Some(&mut creator))
            .and_then(|vulkan| Device::new(&vulkan, &DeviceDesc::default(), Some(&mut creator)));
        let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
        let required = required.split(',').any(|need| need == "vulkan");
        let device = match device {
            Ok(device) => device,
            Err(error) => {
                assert!(!required, "{error}");
                println!("skipped: no Vulkan device ({error})");
                return None;
            }
        };
        assert!(!required || device.instance().validation(), "the Vulkan validation layer is not installed");
        let raw = device.raw();
        let info = xr::vulkan::SessionCreateInfo {
            instance: raw.instance.as_raw() as *const _,
            physical_device: raw.physical_device.as_raw() as *const _,
            device: raw.device.as_raw() as *const _,
            queue_family_index: raw.queue_family,
            queue_index: raw.queue_index,
        };
        // SAFETY: the handles are of the device, which the client keeps longer than the session.
        let early = unsafe { instance.create_session::<xr::Vulkan>(system, &info) };
        assert_eq!(early.err(), Some(sys::Result::ERROR_GRAPHICS_REQUIREMENTS_CALL_MISSING));
        instance.graphics_requirements::<xr::Vulkan>(system).unwrap();
        // SAFETY: as above.
        let (session, waiter, stream) =
            unsafe { instance.create_session::<xr::Vulkan>(system, &info).unwrap() };
        let space = |ty| session.create_reference_space(ty, xr::Posef::IDENTITY).unwrap();
        let (local, view) = (space(xr::ReferenceSpaceType::LOCAL), space(xr::ReferenceSpaceType::VIEW));
        Some(Self { local, view, stream, waiter, session, instance, device })
    }

    /// Destroys everything and fails where validation said anything.
    pub fn finish(self) {
        let Self { local, view, stream, waiter, session, instance, device } = self;
        drop((local, view, stream, waiter, session));
        drop(instance);
        let said = device.validation_messages();
        assert!(said.is_empty(), "{}", said.join("\n"));
        let vulkan = device.instance().clone();
        drop(device);
        let said = vulkan.validation_messages();
        assert!(said.is_empty(), "{}", said.join("\n"));
    }

    pub fn entered(&mut self) -> Vec<xr::SessionState> {
        let mut states = Vec::new();
        let mut buffer = xr::EventDataBuffer::new();
        while let Some(event) = self.instance.poll_event(&mut buffer).unwrap() {
            if let xr::Event::SessionStateChanged(event) = event {
                states.push(event.state());
            }
        }
        states
    }

    pub fn begin(&mut self) {
        self.session.begin(STEREO).unwrap();
    }

    pub fn begin_frame(&mut self) -> (xr::Time, bool) {
        let state = self.waiter.wait().unwrap();
        self.stream.begin().unwrap();
        (state.predicted_display_time, state.should_render)
    }

    pub fn views(&self, time: xr::Time) -> Vec<xr::View> {
        self.session.locate_views(STEREO, time, &self.local).unwrap().1
    }

    pub fn projection(&self, views: &[xr::View], picture: &Picture, depth: Option<&Picture>) -> Projection {
        let mut depth: Option<Box<[sys::CompositionLayerDepthInfoKHR; 2]>> = depth.map(|depth| {
            Box::new([0, 1].map(|eye| sys::CompositionLayerDepthInfoKHR {
                ty: sys::CompositionLayerDepthInfoKHR::TYPE,
                next: std::ptr::null(),
                sub_image: depth.part(eye),
                min_depth: 0.0,
                max_depth: 1.0,
                near_z: f32::INFINITY,
                far_z: 0.05,
            }))
        });
        let views = [0, 1].map(|eye| sys::CompositionLayerProjectionView {
            ty: sys::CompositionLayerProjectionView::TYPE,
            next: depth.as_mut().map_or(std::ptr::null(), |depth| (&raw const depth[eye]).cast()),
            pose: views[eye].pose,
            fov: views[eye].fov,
            sub_image: picture.part(eye as u32),
        });
        Projection { views, view_count: 2, space: self.local.as_raw(), depth }
    }

    pub fn end_frame(&mut self, time: xr::Time, layer: Option<&Projection>) -> xr::Result<()> {
        let Some(layer) = layer else { return self.stream.end(time, xr::EnvironmentBlendMode::OPAQUE, &[]) };
        let raw = sys::CompositionLayerProjection {
            ty: sys::CompositionLayerProjection::TYPE,
            next: std::ptr::null(),
            layer_flags: sys::CompositionLayerFlags::EMPTY,
            space: layer.space,
            view_count: layer.view_count,
            views: layer.views.as_ptr(),
        };
        assert!(layer.depth.is_none() || !layer.views[0].next.is_null());
        // SAFETY: the views live during the call.
        let layer = unsafe { xr::CompositionLayerProjection::<xr::Vulkan>::from_raw(raw) };
        self.stream.end(time, xr::EnvironmentBlendMode::OPAQUE, &[&layer])
    }

    /// Runs until a frame was rendered: with `bytes` in both layers of `picture`, for the views that `change` makes of
    /// the located ones.
    pub fn show(
        &mut self,
        picture: &mut Picture,
        bytes: &[u8],
        change: impl Fn(&[xr::View]) -> Vec<xr::View>,
    ) {
        self.begin();
        loop {
            let (time, should_render) = self.begin_frame();
            let views = change(&self.views(time));
            if should_render {
                picture.fill(self, bytes);
                let layer = self.projection(&views, picture, None);
                self.end_frame(time, Some(&layer)).unwrap();
                return;
            }
            self.end_frame(time, None).unwrap();
        }
    }

    /// The same with a quad that is fixed to the head.
    pub fn show_quad(&mut self, picture: &mut Picture, bytes: &[u8], at: [f32; 3], size: [f32; 2]) {
        let quad =
            Quad { bytes, at, size, eyes: xr::EyeVisibility::BOTH, flags: sys::CompositionLayerFlags::EMPTY };
        self.show_quads(&mut [(picture, quad)]);
    }

    /// The same with quads that are fixed to the head, in this order.
    pub fn show_quads(&mut self, quads: &mut [(&mut Picture, Quad<'_>)]) {
        self.begin();
        loop {
            let (time, should_render) = self.begin_frame();
            if !should_render {
                self.end_frame(time, None).unwrap();
                continue;
            }
            let mut layers = Vec::new();
            for (picture, quad) in quads.iter_mut() {
                picture.fill(self, quad.bytes);
                let [x, y, z] = quad.at;
                let raw = sys::CompositionLayerQuad {
                    ty: sys::CompositionLayerQuad::TYPE,
                    next: std::ptr::null(),
                    layer_flags: quad.flags,
                    space: self.view.as_raw(),
                    eye_visibility: quad.eyes,
                    sub_image: picture.part(0),
                    pose: xr::Posef {
                        orientation: xr::Quaternionf::IDENTITY,
                        position: xr::Vector3f { x, y, z },
                    },
                    size: xr::Extent2Df { width: quad.size[0], height: quad.size[1] },
                };
                // SAFETY: the layer points to nothing.
                layers.push(unsafe { xr::CompositionLayerQuad::<xr::Vulkan>::from_raw(raw) });
            }
            let layers: Vec<&xr::CompositionLayerBase<'_, xr::Vulkan>> =
                layers.iter().map(|layer| &**layer).collect();
            self.stream.end(time, xr::EnvironmentBlendMode::OPAQUE, &layers).unwrap();
            return;
        }
    }

    pub fn swapchain(
        &self,
        format: vk::Format,
        size: (u32, u32),
        layers: u32,
    ) -> xr::Result<xr::Swapchain<xr::Vulkan>> {
        let usage = if format == vk::Format::D32_SFLOAT {
            xr::SwapchainUsageFlags::DEPTH_STENCIL_ATTACHMENT
        } else {
            xr::SwapchainUsageFlags::COLOR_ATTACHMENT | xr::SwapchainUsageFlags::TRANSFER_DST
        };
        self.session.create_swapchain(&xr::SwapchainCreateInfo {
            create_flags: xr::SwapchainCreateFlags::EMPTY,
            usage_flags: usage,
            format: format.as_raw() as u32,
            sample_count: 1,
            width: size.0,
            height: size.1,
            face_count: 1,
            array_size: layers,
            mip_count: 1,
        })
    }
}

/// A rectangle in front of the head.
pub struct Quad<'a> {
    pub bytes: &'a [u8],
    pub at: [f32; 3],
    pub size: [f32; 2],
    pub eyes: xr::EyeVisibility,
    pub flags: sys::CompositionLayerFlags,
}

/// A swapchain and what fills it.
pub struct Picture {
    chain: std::cell::RefCell<xr::Swapchain<xr::Vulkan>>,
    images: Vec<Arc<Image>>,
    commands: CommandBuffer,
    size: (u32, u32),
    layers: u32,
}

impl Picture {
    pub fn new(client: &Client, format: vk::Format, size: (u32, u32), layers: u32) -> Self {
        let chain = client.swapchain(format, size, layers).unwrap();
        let desc = ImageDesc {
            name: "swapchain",
            format,
            width: size.0,
            height: size.1,
            layers,
            ..ImageDesc::default()
        };
        let raws = chain.enumerate_images().unwrap();
        // SAFETY: the images are of the runtime on this device, and the swapchain is kept beside them.
        let borrow = |&raw: &u64| unsafe { Image::borrowed(&client.device, vk::Image::from_raw(raw), &desc) };
        let images = raws.iter().map(borrow).collect();
        let commands = CommandBuffer::new(&client.device, "fill", 0).unwrap();
        Self { chain: chain.into(), images, commands, size, layers }
    }

    /// Acquires, copies `bytes` to all layers, and releases.
    pub fn fill(&mut self, client: &Client, bytes: &[u8]) {
        let mut chain = self.chain.borrow_mut();
        let index = chain.acquire_image().unwrap();
        chain.wait_image(xr::Duration::INFINITE).unwrap();
        let image = &self.images[index as usize];
        let usage = vk::BufferUsageFlags::TRANSFER_SRC;
        let staging =
            Buffer::new(&client.device, "bytes", bytes.len() as u64, usage, Memory::Upload).unwrap();
        staging.write(0, bytes).unwrap();
        let mut encoder = self.commands.record().unwrap();
        encoder.transition(image, Use::ColorAttachment, Use::TransferDestination);
        let stride = bytes.len() as u64 / u64::from(self.layers);
        for layer in 0..self.layers {
            encoder.copy_buffer_to_image(
                &staging,
                u64::from(layer) * stride,
                image,
                Area::whole(image, layer, 0),
            );
        }
        encoder.transition(image, Use::TransferDestination, Use::ColorAttachment);
        encoder.finish().unwrap();
        client.device.submit(&mut self.commands, &[], &[]).unwrap();
        chain.release_image().unwrap();
    }

    /// Acquires and releases, whatever is in the image.
    pub fn touch(&self) {
        let mut chain = self.chain.borrow_mut();
        chain.acquire_image().unwrap();
        chain.wait_image(xr::Duration::INFINITE).unwrap();
        chain.release_image().unwrap();
    }

    fn part(&self, layer: u32) -> sys::SwapchainSubImage {
        let extent = xr::Extent2Di { width: self.size.0 as i32, height: self.size.1 as i32 };
        sys::SwapchainSubImage {
            swapchain: self.chain.borrow().as_raw(),
            image_rect: xr::Rect2Di { offset: xr::Offset2Di { x: 0, y: 0 }, extent },
            image_array_index: layer,
        }
    }
}

/// The pose, turned by `turn` in its own axes.
pub fn turned(pose: &xr::Posef, turn: &Rigid) -> xr::Posef {
    let q = pose.orientation;
    let q =
        nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z).cast::<f64>());
    let q = (q * turn.rotation).coords.cast::<f32>();
    xr::Posef { orientation: xr::Quaternionf { x: q.x, y: q.y, z: q.z, w: q.w }, position: pose.position }
}
