//! The ports that there are, and reading from one.

use std::io::{ErrorKind, Read};
use std::path::Path;
use std::time::Duration;

use serialport::{SerialPort, SerialPortType};

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
