//! Devices that are not there: each lack is one sentence with what to do. The environment belongs to a process, so each case is one.

use std::process::Command;

use vergence_gpu::{Device, DeviceDesc, Error, Instance, InstanceDesc};

#[test]
#[ignore = "run by the other test"]
fn inner() {
    let made = Instance::new(&InstanceDesc { app_name: "absent", ..Default::default() }, None)
        .and_then(|instance| Device::new(&instance, &DeviceDesc::default(), None));
    match made {
        Ok(device) => println!("told: device {}", device.limits().name),
        Err(Error::NoLoader { .. }) => println!("told: no loader"),
        Err(error) => println!("told: {error}"),
    }
}

/// What is told with these variables set.
fn told(variables: &[(&str, &str)]) -> String {
    let output = Command::new(std::env::current_exe().expect("the test is a file"))
        .args(["--exact", "inner", "--ignored", "--nocapture"])
        .env_remove("VERGENCE_GPU")
        .envs(variables.iter().copied())
        .output()
        .expect("the test runs itself");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let told = text.lines().find_map(|line| line.split_once("told: ")).expect("something is told");
    told.1.to_owned()
}

#[test]
fn what_is_missing_is_said_with_what_to_do() {
    let nothing = [("VK_ICD_FILENAMES", "/nonexistent.json"), ("VK_DRIVER_FILES", "/nonexistent.json")];
    let message = told(&nothing);
    if message == "no loader" {
        eprintln!("skipped: no Vulkan loader");
        return;
    }
    assert!(
        message.contains("Vulkan") && message.contains("apt-get install mesa-vulkan-drivers"),
        "no driver: {message}"
    );

    let present = told(&[]);
    let Some(name) = present.strip_prefix("device ") else {
        eprintln!("skipped: no Vulkan device ({present})");
        return;
    };
    assert_eq!(told(&[("VERGENCE_GPU", name)]), present, "a device that is named is taken");
    let unknown = told(&[("VERGENCE_GPU", "a device of dreams")]);
    assert!(unknown.contains("a device of dreams") && unknown.contains(name), "{unknown}");
}
