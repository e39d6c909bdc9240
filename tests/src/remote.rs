//! The protocol of Monado's `remote` driver (`mndrmt3`, Monado 25): packets of 376 bytes over TCP, little endian. The
//! service greets with two packets; then each packet that it receives is the state of headset and controllers until the
//! next one. Nothing is interpolated or predicted.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::time::{Duration, Instant};

/// Bytes of one packet: mark 8, head 128, two controllers of 120.
pub const PACKET_BYTES: usize = 376;
const MARK: &[u8; 8] = b"mndrmt3\0";
const CONTROLLER_BYTES: usize = 120;

/// A rigid pose as the wire has it: position in metres, unit quaternion x, y, z, w.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Metres.
    pub position: [f32; 3],
    /// Hamilton, x, y, z, w, unit length.
    pub orientation: [f32; 4],
}

impl Pose {
    /// No translation, no rotation.
    pub const IDENTITY: Pose = Pose { position: [0.0; 3], orientation: [0.0, 0.0, 0.0, 1.0] };
}

/// One eye: where it is in the head, and how far it sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// Pose of the eye in the head's frame.
    pub head_from_eye: Pose,
    /// Angles from the eye's forward axis in radians: left (negative), right, up, down (negative).
    pub fov_rad: [f32; 4],
}

/// What the script says of the headset; the controllers stay inactive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Pose of the head in the driver's own space, whose origin lies on the floor.
    pub origin_from_head: Pose,
    /// Left, right.
    pub eyes: [Eye; 2],
}

impl State {
    /// The packet of this state.
    #[must_use]
    pub fn packet(&self) -> [u8; PACKET_BYTES] {
        let mut bytes = Vec::with_capacity(PACKET_BYTES);
        bytes.extend_from_slice(MARK);
        for eye in &self.eyes {
            floats(&mut bytes, &eye.fov_rad);
            pose(&mut bytes, &eye.head_from_eye);
            bytes.extend_from_slice(&[0; 4]);
        }
        pose(&mut bytes, &self.origin_from_head);
        // The eyes above are to be used.
        bytes.extend_from_slice(&[1, 0, 0, 0]);
        bytes.resize(bytes.len() + 2 * CONTROLLER_BYTES, 0);
        bytes.try_into().expect("8 + 128 + 2 × 120 bytes were written")
    }
}

fn floats(bytes: &mut Vec<u8>, values: &[f32]) {
    for value in values {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
}

fn pose(bytes: &mut Vec<u8>, pose: &Pose) {
    floats(bytes, &pose.orientation);
    floats(bytes, &pose.position);
}

/// A connection to the driver.
#[derive(Debug)]
pub struct Script(TcpStream);

impl Script {
    /// Connects, waiting for the service to listen, and reads its greeting, whose length tells the protocol's version.
    ///
    /// # Errors
    /// When nobody listens within `patience`, or the greeting is not that of `mndrmt3`.
    pub fn connect(port: u16, patience: Duration) -> io::Result<Script> {
        let started = Instant::now();
        let mut stream = loop {
            match TcpStream::connect((Ipv4Addr::LOCALHOST, port)) {
                Ok(stream) => break stream,
                Err(error) if started.elapsed() > patience => return Err(error),
                Err(_) => std::thread::sleep(Duration::from_millis(50)),
            }
        };
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(patience))?;
        let mut greeting = [0; 2 * PACKET_BYTES];
        stream.read_exact(&mut greeting)?;
        // A longer packet would leave bytes behind.
        stream.set_read_timeout(Some(Duration::from_millis(100)))?;
        match stream.read(&mut [0]) {
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {
                Ok(Script(stream))
            }
            Err(error) => Err(error),
            Ok(_) => Err(io::Error::other(
                "the greeting is not two packets of 376 bytes: another protocol than mndrmt3",
            )),
        }
    }

    /// Makes `state` what the runtime sees from now on.
    ///
    /// # Errors
    /// When the service is gone.
    pub fn send(&mut self, state: &State) -> io::Result<()> {
        self.0.write_all(&state.packet())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packet_has_the_wire_layout() {
        let eye = Eye { head_from_eye: Pose::IDENTITY, fov_rad: [-0.5, 0.25, 0.75, -1.0] };
        let head = Pose { position: [1.0, 2.0, 3.0], ..Pose::IDENTITY };
        let packet = State { origin_from_head: head, eyes: [eye, eye] }.packet();
        let float = |at: usize| f32::from_le_bytes(packet[at..at + 4].try_into().unwrap());
        assert_eq!(&packet[..8], MARK);
        assert_eq!((float(8), float(12), float(16), float(20)), (-0.5, 0.25, 0.75, -1.0));
        // Second eye 48 bytes on; its quaternion's w after the four angles.
        assert_eq!((float(56), float(56 + 16 + 12)), (-0.5, 1.0));
        // Head: after two eyes of 48 bytes; quaternion first, then position.
        assert_eq!((float(104 + 12), float(104 + 16), float(104 + 24)), (1.0, 1.0, 3.0));
        assert_eq!(packet[132], 1);
        assert!(packet[136..].iter().all(|&byte| byte == 0));
    }
}
