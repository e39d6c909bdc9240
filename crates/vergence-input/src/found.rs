//! A device that is there, before it is opened.

use serde::Serialize;

/// What is plugged in, which adapter reads it, and what stands in the way.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Found {
    /// As the device calls itself.
    pub name: String,
    /// `gamepad`, `hid`, `serial`, `motion`.
    pub adapter: &'static str,
    /// Of its node; what `--device` takes.
    pub path: String,
    /// Of the maker, where the bus says it.
    pub vendor_id: Option<u16>,
    /// Of the product, where the bus says it.
    pub product_id: Option<u16>,
    /// Names of the streams that it gives, as far as they are known before it is opened.
    pub streams: Vec<String>,
    /// Why it cannot be read now.
    pub problem: Option<String>,
    /// What mends it: a command.
    pub remedy: Option<String>,
    /// Tells two of the same kind apart, where the device has one.
    #[serde(skip)]
    pub serial_number: Option<String>,
}

impl Found {
    /// A device of which nothing more is known.
    pub fn new(adapter: &'static str, path: String) -> Self {
        Self {
            name: path.clone(),
            adapter,
            path,
            vendor_id: None,
            product_id: None,
            streams: Vec::new(),
            problem: None,
            remedy: None,
            serial_number: None,
        }
    }

    #[cfg(any(feature = "serial", feature = "hid", feature = "gamepad"))]
    /// Says a problem where the node may not be read and written, with the udev rule or the group that mends it.
    pub(crate) fn check_access(&mut self, group: &str) {
        use rustix::fs::{Access, access};
        let both = Access::READ_OK | Access::WRITE_OK;
        let Err(error) = access(&self.path, both) else { return };
        if error != rustix::io::Errno::ACCESS {
            self.problem = Some(format!("{}: {error}", self.path));
            return;
        }
        self.problem = Some(format!("{} may not be opened by this user", self.path));
        let subsystem = match self.adapter {
            "hid" => "hidraw",
            "serial" => "tty",
            _ => "input",
        };
        self.remedy = Some(match self.vendor_id.zip(self.product_id) {
            Some((vendor, product)) => {
                let (usb, own) = (
                    format!("ATTRS{{idVendor}}==\"{vendor:04x}\", ATTRS{{idProduct}}==\"{product:04x}\""),
                    // Bluetooth devices have no USB attributes.
                    format!("KERNELS==\"*:{vendor:04X}:{product:04X}.*\""),
                );
                // The input layer repeats them, whatever the bus.
                let input =
                    format!("ATTRS{{id/vendor}}==\"{vendor:04x}\", ATTRS{{id/product}}==\"{product:04x}\"");
                let which = match self.adapter {
                    "hid" => own,
                    "serial" => usb,
                    _ => input,
                };
                format!(
                    "echo 'SUBSYSTEM==\"{subsystem}\", {which}, TAG+=\"uaccess\"' | sudo tee \
                     /etc/udev/rules.d/70-vergence-{vendor:04x}-{product:04x}.rules && \
                     sudo udevadm control --reload && sudo udevadm trigger"
                )
            }
            None => format!("sudo usermod -aG {group} $USER, then log in again"),
        });
    }

    /// Whether it is the device that `other` was, perhaps at another path after it was plugged in again.
    pub fn is_same_device(&self, other: &Self) -> bool {
        let ids =
            |found: &Self| (found.adapter, found.vendor_id, found.product_id, found.serial_number.clone());
        ids(self) == ids(other) && (self.vendor_id.is_some() || self.path == other.path)
    }
}
