//! The framed protocol: what is on the wire, and how frames are found in what arrives. `SERIAL.md` says it for those who
//! write firmware.

/// Every frame begins with these.
pub const SYNC: [u8; 2] = [0xAA, 0x55];
/// Bytes of a frame beside its payload.
pub const OVERHEAD: usize = 14;
/// Payloads are no longer; so nothing waits for more than this many bytes to be told from a frame.
pub const MOST_PAYLOAD: usize = 255;
/// The number of the stream whose payloads describe the others.
pub const DESCRIPTIONS: u8 = 0;

const HEAD: usize = 10;
/// What arrives is kept until it is taken; more than this at once is more than any port buffers.
const CAPACITY: usize = 128 << 10;

/// A frame whose checksum is right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Which of the device's streams.
    pub stream: u8,
    /// Counts the device's frames, of all streams; wraps.
    pub sequence: u16,
    /// The device's clock when the payload was measured, microseconds; wraps.
    pub time_us: u32,
    /// What was measured.
    pub payload: &'a [u8],
}

impl Frame<'_> {
    /// Appends the frame's bytes; payloads longer than [`MOST_PAYLOAD`] are cut off.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let payload = &self.payload[..self.payload.len().min(MOST_PAYLOAD)];
        out.extend_from_slice(&SYNC);
        let from = out.len();
        out.extend_from_slice(&[self.stream, payload.len() as u8]);
        out.extend_from_slice(&self.sequence.to_le_bytes());
        out.extend_from_slice(&self.time_us.to_le_bytes());
        out.extend_from_slice(payload);
        let checksum = crc32fast::hash(&out[from..]);
        out.extend_from_slice(&checksum.to_le_bytes());
    }
}

/// What became of the bytes so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Bytes that arrived.
    pub bytes: u64,
    /// Frames among them.
    pub frames: u64,
    /// What began like a frame and had another checksum: damage, or chance.
    pub broken: u64,
    /// Bytes that belong to no frame.
    pub skipped: u64,
}

/// Finds frames in bytes that arrive in pieces. A damaged frame costs itself only: after one, the search goes on behind its
/// first byte. Memory is bounded, and none is taken after the making.
#[derive(Debug)]
pub struct Decoder {
    buffer: Box<[u8]>,
    from: usize,
    to: usize,
    tally: Tally,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// With nothing in it.
    pub fn new() -> Self {
        Self { buffer: vec![0; CAPACITY].into_boxed_slice(), from: 0, to: 0, tally: Tally::default() }
    }

    /// Forgets the beginning of a frame: what follows is of another connection.
    pub fn clear(&mut self) {
        self.skip(self.to - self.from);
    }

    /// Room for bytes that arrive; [`Decoder::arrived`] says how many were put there. Never empty after all frames were taken.
    pub fn room(&mut self) -> &mut [u8] {
        // The beginning of a frame is moved each time, so that what is read stays in the processor's cache.
        if self.to - self.from < MOST_PAYLOAD + OVERHEAD || self.buffer.len() - self.to < CAPACITY / 2 {
            self.buffer.copy_within(self.from..self.to, 0);
            (self.from, self.to) = (0, self.to - self.from);
        }
        &mut self.buffer[self.to..]
    }

    /// So many bytes were put into [`Decoder::room`].
    pub fn arrived(&mut self, count: usize) {
        let count = count.min(self.buffer.len() - self.to);
        self.to += count;
        self.tally.bytes += count as u64;
    }

    /// Takes bytes from elsewhere; those that find no room, which are none where frames are taken after each call with at
    /// most 64 KiB, are left and counted as what is returned.
    pub fn push(&mut self, bytes: &[u8]) -> usize {
        let room = self.room();
        let count = bytes.len().min(room.len());
        room[..count].copy_from_slice(&bytes[..count]);
        self.arrived(count);
        bytes.len() - count
    }

    /// The next frame that is complete.
    #[expect(clippy::should_implement_trait, reason = "it lends")]
    pub fn next(&mut self) -> Option<Frame<'_>> {
        let (start, payload) = loop {
            let here = &self.buffer[self.from..self.to];
            match here.iter().position(|&byte| byte == SYNC[0]) {
                None => {
                    self.skip(here.len());
                    return None;
                }
                Some(0) => {}
                Some(ahead) => {
                    self.skip(ahead);
                    continue;
                }
            }
            if here.len() < 2 {
                return None;
            }
            if here[1] != SYNC[1] {
                self.skip(1);
                continue;
            }
            if here.len() < HEAD {
                return None;
            }
            let payload = usize::from(here[3]);
            let bytes = here.get(..payload + OVERHEAD)?;
            let (checked, checksum) = bytes.split_at(payload + HEAD);
            if crc32fast::hash(&checked[2..]).to_le_bytes() == checksum {
                break (self.from, payload);
            }
            self.tally.broken += 1;
            self.skip(1);
        };
        self.from += payload + OVERHEAD;
        self.tally.frames += 1;
        let bytes = &self.buffer[start..start + HEAD + payload];
        Some(Frame {
            stream: bytes[2],
            sequence: u16::from_le_bytes([bytes[4], bytes[5]]),
            time_us: u32::from_le_bytes([bytes[6], bytes[7], bytes[8], bytes[9]]),
            payload: &bytes[HEAD..],
        })
    }

    fn skip(&mut self, count: usize) {
        self.from += count;
        self.tally.skipped += count as u64;
    }

    /// What became of the bytes so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sequences(bytes: &[u8], piece: usize) -> (Vec<u16>, Tally) {
        let (mut decoder, mut found) = (Decoder::new(), Vec::new());
        for piece in bytes.chunks(piece) {
            assert_eq!(decoder.push(piece), 0);
            while let Some(frame) = decoder.next() {
                assert_eq!((frame.stream, frame.time_us), (7, 0xAA55_AA55));
                assert_eq!(frame.payload.len(), usize::from(frame.sequence) % 6);
                found.push(frame.sequence);
            }
        }
        (found, decoder.tally())
    }

    #[test]
    fn the_example_of_the_documentation_is_a_frame() {
        let mut bytes = Vec::new();
        Frame { stream: 1, sequence: 2, time_us: 3, payload: &[72] }.encode(&mut bytes);
        let wanted = [0xAA, 0x55, 1, 1, 2, 0, 3, 0, 0, 0, 72];
        assert_eq!(bytes[..11], wanted);
        let text = include_str!("../../SERIAL.md");
        let hex: Vec<String> = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
        assert!(text.contains(&hex.join(" ")), "SERIAL.md does not show {}", hex.join(" "));
    }

    #[test]
    fn frames_are_found_in_any_pieces_and_between_anything() {
        let mut bytes = b"boot: ok\r\n\xAA\x55\xAA".to_vec();
        for sequence in 0..50u16 {
            // Payloads that look like beginnings of frames.
            let payload = [0xAA, 0x55, sequence as u8, 0xFF, 0xAA];
            Frame { stream: 7, sequence, time_us: 0xAA55_AA55, payload: &payload[..sequence as usize % 6] }
                .encode(&mut bytes);
            if sequence % 9 == 0 {
                bytes.push(0xAA);
            }
        }
        // What looked like a beginning is told from one once that many bytes have come.
        bytes.extend([0; MOST_PAYLOAD]);
        for piece in [1, 2, 3, 7, 64, 4096] {
            let (found, tally) = sequences(&bytes, piece);
            assert_eq!(found, (0..50).collect::<Vec<_>>(), "pieces of {piece}");
            assert_eq!((tally.frames, tally.bytes), (50, bytes.len() as u64));
        }
    }
}
