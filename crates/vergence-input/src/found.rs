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
        if let Err(error) = access(&self.path, both) {
            self.refused(error, group);
        }
    }

    #[cfg(any(feature = "serial", feature = "hid", feature = "gamepad"))]
    fn refused(&mut self, error: rustix::io::Errno, group: &str) {
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

#[cfg(all(test, feature = "serial"))]
mod tests {
    use super::*;

    /// What mends it for a device of an adapter: with its maker and product a rule for it alone, else a group.
    fn remedy(adapter: &'static str, ids: Option<(u16, u16)>) -> String {
        let mut found = Found::new(adapter, "/dev/node".to_owned());
        (found.vendor_id, found.product_id) = ids.unzip();
        found.refused(rustix::io::Errno::ACCESS, "dialout");
        assert_eq!(found.problem.as_deref(), Some("/dev/node may not be opened by this user"));
        found.remedy.unwrap_or_default()
    }

    #[test]
    fn what_may_not_be_opened_has_the_command_that_mends_it() {
        let ids = Some((0x046d, 0xc62b));
        let rule = |which: &str| {
            format!(
                "echo '{which}, TAG+=\"uaccess\"' | sudo tee /etc/udev/rules.d/70-vergence-046d-c62b.rules && \
                 sudo udevadm control --reload && sudo udevadm trigger"
            )
        };
        assert_eq!(remedy("hid", ids), rule("SUBSYSTEM==\"hidraw\", KERNELS==\"*:046D:C62B.*\""));
        let usb = "SUBSYSTEM==\"tty\", ATTRS{idVendor}==\"046d\", ATTRS{idProduct}==\"c62b\"";
        assert_eq!(remedy("serial", ids), rule(usb));
        let input = "SUBSYSTEM==\"input\", ATTRS{id/vendor}==\"046d\", ATTRS{id/product}==\"c62b\"";
        assert_eq!(remedy("gamepad", ids), rule(input));
        assert_eq!(remedy("serial", None), "sudo usermod -aG dialout $USER, then log in again");
    }

    #[test]
    fn a_node_that_is_not_there_has_a_problem_and_nothing_that_mends_it() {
        let mut found = Found::new("serial", "/nowhere/ttyACM0".to_owned());
        found.check_access("dialout");
        assert!(found.problem.as_deref().is_some_and(|problem| problem.starts_with("/nowhere/ttyACM0: ")));
        assert_eq!(found.remedy, None);
    }
}
