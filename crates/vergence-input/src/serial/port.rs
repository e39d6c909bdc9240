//! The ports that there are, and reading from one.

use std::io::{ErrorKind, Read};
use std::path::Path;
use std::time::Duration;

use serialport::{SerialPort, SerialPortType};

use crate::claim::{Claim, is_claimed};
use crate::found::Found;

/// Where bytes of a device come from.
pub trait Port: Send {
    /// Reads what there is, waiting at most `longest` for something; 0 where nothing came.
    ///
    /// # Errors
    /// Where the device is gone.
    fn read(&mut self, buffer: &mut [u8], longest: Duration) -> std::io::Result<usize>;
}

impl Port for Box<dyn SerialPort> {
    fn read(&mut self, buffer: &mut [u8], longest: Duration) -> std::io::Result<usize> {
        if self.timeout() != longest {
            self.set_timeout(longest)?;
        }
        match Read::read(self, buffer) {
            // The other end of a line that is at its end.
            Ok(0) => Err(ErrorKind::BrokenPipe.into()),
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => Ok(0),
            read => read,
        }
    }
}

/// Opens the port at `path`: 8 data bits, no parity, one stop bit.
///
/// # Errors
/// Where it is not there, is used by another program, or may not be opened.
pub fn open(path: &str, baud: u32) -> std::io::Result<Box<dyn SerialPort>> {
    Ok(serialport::new(path, baud).timeout(Duration::from_millis(100)).open()?)
}

/// A port that counts as read.
struct Claimed {
    port: Box<dyn SerialPort>,
    _claim: Claim,
}

impl Port for Claimed {
    fn read(&mut self, buffer: &mut [u8], longest: Duration) -> std::io::Result<usize> {
        Port::read(&mut self.port, buffer, longest)
    }
}

/// The same as [`open`], of a port that no other source of this process shall take for its own.
pub(super) fn open_claimed(path: &str, baud: u32) -> std::io::Result<Box<dyn Port>> {
    if is_claimed(path) {
        return Err(std::io::Error::other("it is read already"));
    }
    Ok(Box::new(Claimed { port: open(path, baud)?, _claim: Claim::on(path) }))
}

/// Where a device is now that was lost, perhaps under another name; of two alike never the one that somebody reads.
pub(super) fn again(wanted: &Found) -> Option<String> {
    place_of(wanted, found(), is_claimed)
}

fn place_of(wanted: &Found, found: Vec<Found>, is_read: impl Fn(&str) -> bool) -> Option<String> {
    let is_free = |found: &Found| found.is_same_device(wanted) && !is_read(&found.path);
    let mut free: Vec<String> = found.into_iter().filter(is_free).map(|found| found.path).collect();
    if free.contains(&wanted.path) || free.is_empty() && wanted.vendor_id.is_none() {
        return Some(wanted.path.clone());
    }
    (!free.is_empty()).then(|| free.swap_remove(0))
}

/// The ports that are there, by their paths.
pub fn found() -> Vec<Found> {
    // The library panics where there is no such folder, as in a container.
    if cfg!(target_os = "linux") && !Path::new("/sys/class/tty").exists() {
        return Vec::new();
    }
    let mut ports = serialport::available_ports().unwrap_or_else(|error| {
        log::warn!("serial ports cannot be listed: {error}");
        Vec::new()
    });
    ports.sort_by(|a, b| a.port_name.cmp(&b.port_name));
    // On boards and virtual machines dozens of ports have a driver and no socket.
    ports.retain(|port| matches!(port.port_type, SerialPortType::UsbPort(_)));
    let describe = |port: serialport::SerialPortInfo| {
        let mut found = Found::new("serial", port.port_name.clone());
        found.name = port.port_name.rsplit('/').next().unwrap_or(&port.port_name).to_owned();
        if let SerialPortType::UsbPort(usb) = port.port_type {
            (found.vendor_id, found.product_id) = (Some(usb.vid), Some(usb.pid));
            found.serial_number = usb.serial_number;
            let maker = usb.manufacturer.unwrap_or_default();
            let product = usb.product.unwrap_or_default();
            let name = format!("{maker} {product}").replace('_', " ");
            if !name.trim().is_empty() {
                name.trim().clone_into(&mut found.name);
            }
        }
        found.check_access("dialout");
        found
    };
    ports.into_iter().map(describe).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_alike_the_one_that_is_read_is_not_taken() {
        let alike = |path: &str| Found {
            vendor_id: Some(0x1a86),
            product_id: Some(0x7523),
            ..Found::new("serial", path.to_owned())
        };
        let (first, second) = (alike("/dev/a"), alike("/dev/b"));
        let place = |wanted: &Found, found: &[&Found], read: &[&str]| {
            let found = found.iter().map(|found| (*found).clone()).collect();
            place_of(wanted, found, |path| read.contains(&path))
        };
        let at = |path: &str| Some(path.to_owned());
        // The second was lost, and is back where it was, or elsewhere; or not yet.
        assert_eq!(place(&second, &[&first, &second], &["/dev/a"]), at("/dev/b"));
        assert_eq!(place(&second, &[&first, &alike("/dev/c")], &["/dev/a"]), at("/dev/c"));
        assert_eq!(place(&second, &[&first], &["/dev/a"]), None);
        // Both were lost.
        assert_eq!(place(&second, &[&first, &second], &[]), at("/dev/b"));
        // Not of those that are listed.
        let unlisted = Found::new("serial", "/dev/pts/7".to_owned());
        assert_eq!(place(&unlisted, &[&first, &second], &[]), at("/dev/pts/7"));
    }
}
