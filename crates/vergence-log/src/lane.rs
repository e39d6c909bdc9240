//! The side of a recording that must never wait: a bounded queue of bytes between one thread and the writer.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rtrb::{Consumer, Producer, RingBuffer};
use vergence_time::Timestamp;

use crate::message::{Message, Stream, Times};
use crate::wire::Encoder;

/// Bytes in front of each message in the queue.
pub(crate) const PREFIX: usize = 32;

/// What the writer and all lanes share.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    /// Messages taken so far, by all lanes: the order of arrival.
    pub(crate) order: AtomicU64,
    /// Messages that found a queue full, came after a failure, or belong to no stream of the recording.
    pub(crate) dropped: AtomicU64,
    /// Nothing is written any more.
    pub(crate) failed: AtomicBool,
    /// The writer has to finish.
    pub(crate) stop: AtomicBool,
}

/// One thread's way into a recording. Writing neither locks nor allocates once the largest message has been seen, and
/// never waits: what finds the queue full is dropped, counted, and said in the log.
#[derive(Debug)]
pub struct Lane {
    shared: Arc<Shared>,
    queue: Producer<u8>,
    scratch: Vec<u8>,
    /// Next number of each stream; a dropped message takes its number with it.
    sequences: Vec<u32>,
}

impl Lane {
    pub(crate) fn new(shared: Arc<Shared>, capacity: usize) -> (Self, LaneEnd) {
        let (queue, end) = RingBuffer::new(capacity.max(PREFIX));
        let lane =
            Self { shared, queue, scratch: Vec::with_capacity(4096), sequences: Vec::with_capacity(64) };
        (lane, LaneEnd { queue: end, head: None })
    }

    /// Takes a message of `stream`, which holds for `times.captured` and reached us at `times.arrived` (session time).
    /// A stream belongs to one lane.
    pub fn write<T: Message>(&mut self, stream: &Stream<T>, times: Times, value: &T) {
        self.put(stream.id, times, |out| value.encode(times, &stream.frame, out));
    }

    /// Counts a message that belongs to no stream of the recording.
    pub(crate) fn refuse(&self) {
        self.shared.dropped.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn put(&mut self, stream: u16, times: Times, encode: impl FnOnce(&mut Encoder<'_>)) {
        if self.sequences.len() <= usize::from(stream) {
            self.sequences.resize(usize::from(stream) + 1, 0);
        }
        let sequence = &mut self.sequences[usize::from(stream)];
        let number = *sequence;
        *sequence = number.wrapping_add(1);
        if self.shared.failed.load(Ordering::Relaxed) {
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        self.scratch.clear();
        self.scratch.resize(PREFIX, 0);
        encode(&mut Encoder::new(&mut self.scratch));
        let length = (self.scratch.len() - PREFIX) as u64;
        let order = self.shared.order.fetch_add(1, Ordering::Relaxed);
        let prefix = Prefix { length, order, stream, sequence: number, times };
        prefix.write(&mut self.scratch);
        if self.queue.push_entire_slice(&self.scratch).is_err() {
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// What stands in front of a message in the queue.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prefix {
    pub(crate) length: u64,
    pub(crate) order: u64,
    pub(crate) stream: u16,
    pub(crate) sequence: u32,
    pub(crate) times: Times,
}

impl Prefix {
    // Length 32 bits, stream 16, sequence 32 in 10 bytes, then order in 6: 2^48 messages are enough for a session.
    fn write(&self, out: &mut [u8]) {
        out[0..4].copy_from_slice(&(self.length as u32).to_le_bytes());
        out[4..6].copy_from_slice(&self.stream.to_le_bytes());
        out[6..10].copy_from_slice(&self.sequence.to_le_bytes());
        out[10..16].copy_from_slice(&self.order.to_le_bytes()[..6]);
        out[16..24].copy_from_slice(&self.times.captured.as_nanos().to_le_bytes());
        out[24..32].copy_from_slice(&self.times.arrived.as_nanos().to_le_bytes());
    }

    fn read(bytes: &[u8; PREFIX]) -> Self {
        let number = |from: usize, to: usize| {
            let mut all = [0; 8];
            all[..to - from].copy_from_slice(&bytes[from..to]);
            u64::from_le_bytes(all)
        };
        Self {
            length: number(0, 4),
            stream: number(4, 6) as u16,
            sequence: number(6, 10) as u32,
            order: number(10, 16),
            times: Times::new(
                Timestamp::from_nanos(number(16, 24) as i64),
                Timestamp::from_nanos(number(24, 32) as i64),
            ),
        }
    }
}

/// The writer's end of a lane.
#[derive(Debug)]
pub(crate) struct LaneEnd {
    queue: Consumer<u8>,
    head: Option<Prefix>,
}

impl LaneEnd {
    /// The next message's prefix, if there is one. A message is put into the queue whole.
    pub(crate) fn peek(&mut self) -> Option<Prefix> {
        if self.head.is_none() {
            let mut bytes = [0; PREFIX];
            self.queue.pop_entire_slice(&mut bytes).ok()?;
            self.head = Some(Prefix::read(&bytes));
        }
        self.head
    }

    /// The bytes of the message that was peeked at.
    pub(crate) fn take(&mut self, into: &mut Vec<u8>) {
        into.clear();
        let Some(prefix) = self.head.take() else { return };
        into.resize(prefix.length as usize, 0);
        // The message was put in whole, so its bytes are there.
        let whole = self.queue.pop_entire_slice(into).is_ok();
        debug_assert!(whole);
    }

    /// The other end is gone and nothing is left.
    pub(crate) fn is_over(&self) -> bool {
        self.head.is_none() && self.queue.is_abandoned() && self.queue.is_empty()
    }
}
