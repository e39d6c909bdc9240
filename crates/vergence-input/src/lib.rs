#![doc = include_str!("../README.md")]

#[cfg(any(feature = "gamepad", feature = "hid", feature = "serial"))]
mod claim;
mod config;
// What devices with a clock have is dead in a build without them.
#[cfg_attr(not(any(feature = "serial", feature = "hid", feature = "gamepad")), allow(dead_code))]
mod connection;
#[cfg(feature = "desktop")]
pub mod desktop;
mod error;
mod found;
#[cfg(feature = "gamepad")]
pub mod gamepad;
#[cfg(feature = "hid")]
pub mod hid;
#[cfg(feature = "serial")]
pub mod serial;
#[cfg(any(feature = "serial", feature = "hid"))]
mod values;

pub use config::Config;
pub use connection::{CLOCK_RESIDUAL, EVENTS};
pub use error::Error;
pub use found::Found;

use std::sync::Arc;

use vergence_sense::Source;
use vergence_time::Clock;

/// Everything that is plugged in and that one of the adapters of this build reads, by adapter and path.
pub fn found(config: &Config) -> Vec<Found> {
    #[cfg_attr(not(any(feature = "serial", feature = "hid", feature = "gamepad")), allow(unused_mut))]
    let mut all = Vec::new();
    let _ = config;
    #[cfg(feature = "gamepad")]
    all.extend(gamepad::found(config));
    #[cfg(feature = "hid")]
    all.extend(hid::found(config));
    #[cfg(feature = "serial")]
    all.extend(serial::found());
    all
}

/// The device that `name` means: its path, or a part of its name that no other has, or `serial:PATH` for a port that is not
/// listed (one without USB), or `desktop` for keyboard, mouse and touches of a window that is opened for it.
///
/// # Errors
/// Where there is none, or more than one.
pub fn find(name: &str, config: &Config) -> Result<Found, Error> {
    let all = found(config);
    if let Some(device) = all.iter().find(|device| device.path == name) {
        return Ok(device.clone());
    }
    #[cfg(feature = "desktop")]
    if name == desktop::DESKTOP {
        return Ok(desktop::found());
    }
    #[cfg(feature = "serial")]
    if let Some(path) = name.strip_prefix("serial:") {
        let listed = all.iter().find(|device| device.adapter == "serial" && device.path == path);
        return Ok(listed.cloned().unwrap_or_else(|| Found::new("serial", path.to_owned())));
    }
    let wanted = name.to_lowercase();
    let mut matching = all.iter().filter(|device| device.name.to_lowercase().contains(&wanted));
    match (matching.next(), matching.next()) {
        (Some(device), None) => Ok(device.clone()),
        (first, _) => {
            let listed = if first.is_some() { "more than one: " } else { "" };
            let all = all.iter().filter(|d| first.is_none() || d.name.to_lowercase().contains(&wanted));
            let there: Vec<String> = all.map(|device| format!("{} ({})", device.path, device.name)).collect();
            let there =
                if there.is_empty() { "none".to_owned() } else { format!("{listed}{}", there.join(", ")) };
            Err(Error::NoDevice { found: name.to_owned(), there })
        }
    }
}

/// Opens a device; `clock` stamps what arrives.
///
/// # Errors
/// Where it cannot be opened, or a mapping for it is wrong.
pub fn open(device: &Found, config: &Config, clock: Arc<dyn Clock>) -> Result<Box<dyn Source>, Error> {
    let _ = (config, &clock);
    match device.adapter {
        #[cfg(feature = "serial")]
        "serial" => {
            Ok(Box::new(serial::SerialSource::open(device, config.serial_of(device).clone(), clock)?))
        }
        #[cfg(feature = "gamepad")]
        "gamepad" => Ok(Box::new(gamepad::GamepadSource::open(device, config, clock)?)),
        #[cfg(feature = "gamepad")]
        "motion" => Ok(Box::new(gamepad::MotionSource::open(device, clock)?)),
        #[cfg(feature = "desktop")]
        desktop::DESKTOP => Ok(Box::new(desktop::DesktopSource::open(config.desktop, clock)?)),
        #[cfg(feature = "hid")]
        "hid" => Ok(Box::new(hid::HidSource::open(device, config, clock)?)),
        _ => Err(Error::open(device, "no adapter of this build reads it")),
    }
}
