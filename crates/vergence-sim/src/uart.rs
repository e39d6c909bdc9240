//! A serial line between two UARTs: what becomes of bytes when the two disagree about the baud rate, when the line loses, turns
//! or adds something, and how an adapter hands them over in batches.
//!
//! A pseudo terminal takes any baud rate and enforces none; this model does, by sampling the bits.

use vergence_inertial::Dice;
use vergence_time::{Span, Timestamp};

use crate::Error;

/// Bits of one byte on the line: start, eight of data (lowest first), stop.
const BITS: usize = 10;

/// What a receiver at `receiver_baud` reads from a sender at `sender_baud` that sends `bytes` without a pause, and before
/// and after nothing (the line rests high).
///
/// The receiver waits for an edge from high to low, reads each bit in its middle, by its own clock, and waits again from
/// the middle of the stop bit on. A stop bit that is low is a framing error, which a terminal in raw mode reads as 0.
/// Up to about 5 % apart nothing is wrong.
///
/// # Errors
/// Where a rate is not between 1 and 100 million.
pub fn at_another_baud(bytes: &[u8], sender_baud: f64, receiver_baud: f64) -> Result<Vec<u8>, Error> {
    for (what, found) in [("sender_baud", sender_baud), ("receiver_baud", receiver_baud)] {
        if !(1.0..=1e8).contains(&found) {
            return Err(Error::Parameter { what, expected: "1 to 100 million baud", found });
        }
    }
    // The level of the line in the sender's bit number `index`.
    let is_high = |index: usize| match bytes.get(index / BITS) {
        None => true,
        Some(byte) => match index % BITS {
            0 => false,
            9 => true,
            bit => byte >> (bit - 1) & 1 == 1,
        },
    };
    // The receiver's bits, in those of the sender.
    let step = sender_baud / receiver_baud;
    let end = bytes.len() * BITS;
    let mut read = Vec::new();
    let mut from = 0;
    while let Some(edge) = (from..end).find(|&index| !is_high(index) && (index == 0 || is_high(index - 1))) {
        let at = |bits: f64| (edge as f64 + bits * step) as usize;
        let byte = (0..8).fold(0u8, |byte, bit| byte | u8::from(is_high(at(1.5 + f64::from(bit)))) << bit);
        read.push(if is_high(at(9.5)) { byte } else { 0 });
        // The next edge lies after the bit in which the stop bit was read, and after this one.
        from = (at(9.5) + 1).max(edge + 1);
    }
    Ok(read)
}

/// What a line does to bytes, each at every so-manieth of them; 0: never.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// This one is lost.
    pub drop_every: usize,
    /// One bit of this one is turned.
    pub flip_every: usize,
    /// After this one comes another, of any value.
    pub add_every: usize,
}

/// The bytes as they arrive; which bit is turned and what is added hangs on `seed`.
pub fn damaged(bytes: &[u8], damage: Damage, seed: u64) -> Vec<u8> {
    let dice = Dice::new(seed, 0);
    let hit = |every: usize, index: usize| every > 0 && (index + 1).is_multiple_of(every);
    let mut arrived =
        Vec::with_capacity(bytes.len() + bytes.len().checked_div(damage.add_every).unwrap_or(0));
    for (index, byte) in bytes.iter().copied().enumerate() {
        let luck = dice.bits(index as u64);
        if !hit(damage.drop_every, index) {
            arrived.push(if hit(damage.flip_every, index) { byte ^ 1 << (luck % 8) } else { byte });
        }
        if hit(damage.add_every, index) {
            arrived.push((luck >> 8) as u8);
        }
    }
    arrived
}

/// Bytes that were handed over together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// When.
    pub arrived: Timestamp,
    /// What.
    pub bytes: Vec<u8>,
}

/// How an adapter between line and USB hands bytes over: when so many are there, or so much time has passed since the
/// first of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Batching {
    /// At this many bytes.
    pub full: usize,
    /// At this age of the oldest byte.
    pub timer: Span,
}

impl Batching {
    /// FTDI's default: packets of 62 bytes, latency timer of 16 ms.
    pub const FTDI: Self = Self { full: 62, timer: Span::from_millis(16) };

    /// The batches in which `writes` (ascending in time) arrive from a line at `baud`, ten bits a byte.
    ///
    /// # Errors
    /// Where the rate is not between 1 and 100 million, or a batch could hold nothing.
    pub fn batches(&self, baud: f64, writes: &[(Timestamp, Vec<u8>)]) -> Result<Vec<Batch>, Error> {
        if !(1.0..=1e8).contains(&baud) {
            let expected = "1 to 100 million baud";
            return Err(Error::Parameter { what: "baud", expected, found: baud });
        }
        if self.full == 0 {
            return Err(Error::Parameter { what: "full", expected: "at least 1 byte", found: 0.0 });
        }
        let byte_takes = Span::from_secs_f64(10.0 / baud).unwrap_or_default();
        let mut batches = Vec::new();
        let mut open: Option<(Timestamp, Vec<u8>)> = None;
        let mut line_free = Timestamp::from_nanos(i64::MIN);
        for (written, bytes) in writes {
            for byte in bytes {
                let arrives = line_free.max(*written).saturating_add(byte_takes);
                line_free = arrives;
                if let Some((due, waiting)) = open.take() {
                    if due <= arrives {
                        batches.push(Batch { arrived: due, bytes: waiting });
                    } else {
                        open = Some((due, waiting));
                    }
                }
                let (_, waiting) =
                    open.get_or_insert_with(|| (arrives.saturating_add(self.timer), Vec::with_capacity(8)));
                waiting.push(*byte);
                if waiting.len() == self.full {
                    batches.extend(open.take().map(|(_, bytes)| Batch { arrived: arrives, bytes }));
                }
            }
        }
        batches.extend(open.map(|(due, bytes)| Batch { arrived: due, bytes }));
        Ok(batches)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames() -> Vec<u8> {
        (0..500u32).flat_map(|k| [0xAA, 0x55, k as u8, (k >> 8) as u8, 0, 0xFF, (k * 37) as u8]).collect()
    }

    #[test]
    fn a_few_percent_harm_nothing_and_another_rate_leaves_nothing() {
        let sent = frames();
        for receiver in [115_200.0, 117_504.0, 112_896.0, 120_960.0, 109_700.0] {
            assert_eq!(at_another_baud(&sent, 115_200.0, receiver).unwrap(), sent, "{receiver}");
        }
        for factor in [0.5, 2.0, 8.0] {
            let read = at_another_baud(&sent, 115_200.0, 115_200.0 * factor).unwrap();
            assert!(!read.is_empty() && !read.windows(7).any(|w| sent.chunks(7).any(|frame| w == frame)));
        }
        assert!(at_another_baud(&sent, 0.0, 9600.0).is_err());
        assert!(at_another_baud(&sent, 9600.0, f64::NAN).is_err());
        assert_eq!(at_another_baud(&[], 9600.0, 9600.0).unwrap(), []);
    }

    #[test]
    fn damage_is_where_it_was_asked_for() {
        let sent = frames();
        let damage = Damage { drop_every: 97, ..Damage::default() };
        assert_eq!(damaged(&sent, damage, 1).len(), 3500 - 36);
        let damage = Damage { flip_every: 131, ..Damage::default() };
        let turned = damaged(&sent, damage, 1);
        let bits: u32 = turned.iter().zip(&sent).map(|(a, b)| (a ^ b).count_ones()).sum();
        assert_eq!((turned.len(), bits), (3500, 26));
        let damage = Damage { add_every: 211, ..Damage::default() };
        assert_eq!(damaged(&sent, damage, 1).len(), 3516);
        assert_eq!(damaged(&sent, Damage::default(), 1), sent);
        assert_eq!(damaged(&sent, damage, 1), damaged(&sent, damage, 1));
        assert_ne!(damaged(&sent, damage, 1), damaged(&sent, damage, 2));
    }

    #[test]
    fn batches_hold_what_was_sent_no_later_than_the_timer() {
        let writes: Vec<(Timestamp, Vec<u8>)> =
            (0..200).map(|k| (Timestamp::from_nanos(k * 1_000_000), vec![k as u8; 17])).collect();
        let batches = Batching::FTDI.batches(921_600.0, &writes).unwrap();
        let sent: Vec<u8> = writes.iter().flat_map(|(_, bytes)| bytes.clone()).collect();
        assert_eq!(batches.iter().flat_map(|batch| batch.bytes.clone()).collect::<Vec<u8>>(), sent);
        // 17 bytes a millisecond: full before the timer, but for the last.
        assert!(batches[..batches.len() - 1].iter().all(|batch| batch.bytes.len() == 62));
        assert!(batches.windows(2).all(|pair| pair[0].arrived <= pair[1].arrived));
        // One byte a second waits for the timer.
        let slow: Vec<(Timestamp, Vec<u8>)> =
            (0..3).map(|k| (Timestamp::from_nanos(k * 1_000_000_000), vec![k as u8])).collect();
        let batches = Batching::FTDI.batches(1_000_000.0, &slow).unwrap();
        let arrivals: Vec<i64> = batches.iter().map(|batch| batch.arrived.as_nanos()).collect();
        assert_eq!(arrivals, [16_010_000, 1_016_010_000, 2_016_010_000]);
    }
}
