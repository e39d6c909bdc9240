//! A validated device for tests, or a skip; and WGSL to SPIR-V.

use std::sync::Arc;

use vergence_gpu::{Device, DeviceDesc, Error, Instance, InstanceDesc};

/// A device with validation, or `None` with the reason printed; `VERGENCE_REQUIRE=vulkan` makes the lack a failure.
pub fn device() -> Option<Arc<Device>> {
    let desc = InstanceDesc { app_name: "vergence-gpu tests", validation: true, surface: None };
    let device = Instance::new(&desc, None).and_then(|i| Device::new(&i, &DeviceDesc::default(), None));
    match device {
        Ok(device) => {
            assert!(
                !required() || device.instance().validation(),
                "the validation layer is required and not installed"
            );
            Some(device)
        }
        Err(error @ (Error::NoLoader { .. } | Error::NoDevice { .. } | Error::Unsuitable { .. })) => {
            assert!(!required(), "{error}");
            eprintln!("skipped: no Vulkan device ({error})");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// Whether `VERGENCE_REQUIRE` names vulkan.
pub fn required() -> bool {
    std::env::var("VERGENCE_REQUIRE").is_ok_and(|list| list.split(',').any(|word| word.trim() == "vulkan"))
}

/// Fails on any message of the validation layer.
pub fn assert_valid(device: &Device) {
    let messages = device.validation_messages();
    assert!(messages.is_empty(), "validation: {}", messages.join("\n"));
}

/// SPIR-V of a WGSL module with all its entry points.
#[allow(dead_code, reason = "not every test has shaders")]
pub fn spirv(wgsl: &str) -> Vec<u32> {
    let module = naga::front::wgsl::parse_str(wgsl).unwrap_or_else(|e| panic!("{}", e.emit_to_string(wgsl)));
    let capabilities = naga::valid::Capabilities::MULTIVIEW | naga::valid::Capabilities::IMMEDIATES;
    let mut validator = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities);
    let info = validator.validate(&module).unwrap();
    let options = naga::back::spv::Options {
        flags: naga::back::spv::WriterFlags::empty(),
        lang_version: (1, 3),
        ..Default::default()
    };
    naga::back::spv::write_vec(&module, &info, &options, None).unwrap()
}
