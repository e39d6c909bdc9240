//! A USB serial adapter of QEMU's, behind the driver of real ones; the device behind it is the host's end of a socket.

use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::net::UnixListener;

use vergence_input::Config;

use crate::gadget::{is_last, numbered_frames, numbers};
use crate::{found, has_event, open, read};

const COUNT: u32 = 3000;

/// Outside: what the device does. It waits for a byte, and sends.
pub(crate) fn device(listener: &UnixListener) {
    let (mut line, _) = listener.accept().expect("the machine's adapter");
    line.read_exact(&mut [0]).expect("somebody asks");
    line.write_all(&numbered_frames(COUNT)).expect("sent");
    // Until the machine ends.
    let _ = line.read(&mut [0; 64]);
}

/// Inside.
pub(crate) fn every_frame_through_its_driver() {
    let port = found("serial", 1).remove(0);
    assert_eq!((port.vendor_id, port.product_id), (Some(0x0403), Some(0x6001)), "{port:?}");
    assert_eq!(port.problem, None);
    let mut asking = File::options().write(true).open(&port.path).expect("the port");
    let mut source = open(&port, &Config::default());
    read(&mut source, |samples| has_event(samples, "connected"));
    asking.write_all(b"?").expect("asked");
    let samples = read(&mut source, |samples| is_last(samples, COUNT));
    assert_eq!(numbers(&source, &samples, "number"), (0..COUNT).collect::<Vec<_>>());
    assert!(!has_event(&samples, "gap"));
    println!("scene ok: {NAME}");
}

pub(crate) const NAME: &str = "a USB serial adapter, 3,000 frames";
