//! The side of a recording that must never wait: a bounded queue of bytes between one thread and the writer.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use rtrb::{Consumer, Producer, RingBuffer};
use vergence_time::Timestamp;

use crate::message::{Message, Stream, Times};
use crate::wire::Encoder;

/// Bytes in front of each message in the queue.
pub(crate) const PREFIX: usize = 32;

/// What the writer and all lanes share.
#[derive(Debug)]
pub(crate) struct Shared {
    /// Messages taken so far, by all lanes: the order of arrival.
    pub(crate) order: AtomicU64,
    /// Messages that found a queue full, came after a failure, or belong to no stream of the recording.
    pub(crate) dropped: AtomicU64,
    /// Nothing is written any more.
    pub(crate) failed: AtomicBool,
    /// The writer has to finish.
    pub(crate) stop: AtomicBool,
    began: Instant,
    /// When the writer last looked at the queues, nanoseconds after the beginning, and the longest that it ever did not.
    looked: AtomicU64,
    away: AtomicU64,
}

impl Default for Shared {
    fn default() -> Self {
        Self {
            order: AtomicU64::default(),
            dropped: AtomicU64::default(),
            failed: AtomicBool::default(),
            stop: AtomicBool::default(),
            began: Instant::now(),
            looked: AtomicU64::default(),
            away: AtomicU64::default(),
        }
    }
}

impl Shared {
    fn now(&self) -> u64 {
        u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    /// The writer looks at the queues.
    pub(crate) fn look(&self) {
        let now = self.now();
        let away = now.saturating_sub(self.looked.load(Ordering::Relaxed));
        self.away.fetch_max(away, Ordering::Relaxed);
        self.looked.store(now, Ordering::Release);
    }

    /// The longest that the writer did not look, now included.
    pub(crate) fn longest_away(&self) -> Duration {
        let now = self.now().saturating_sub(self.looked.load(Ordering::Acquire));
        Duration::from_nanos(now.max(self.away.load(Ordering::Relaxed)))
    }
}

/// Of a lane that is not just now handing over a message.
const IDLE: u64 = u64::MAX;

/// One thread's way into a recording. Writing neither locks nor allocates once the largest message has been seen, and
/// never waits: what finds the queue full is dropped, counted, and said in the log.
#[derive(Debug)]
pub struct Lane {
    shared: Arc<Shared>,
    queue: Producer<u8>,
    scratch: Vec<u8>,
    /// Next number of each stream; a dropped message takes its number with it.
    sequences: Vec<u32>,
    /// A place in the order at or before that of the message that is just now handed over.
    handing_over: Arc<AtomicU64>,
}

impl Lane {
    pub(crate) fn new(shared: Arc<Shared>, capacity: usize) -> (Self, LaneEnd) {
        let (queue, end) = RingBuffer::new(capacity.max(PREFIX));
        let handing_over = Arc::new(AtomicU64::new(IDLE));
        let end = LaneEnd { queue: end, head: None, handing_over: handing_over.clone() };
        let (scratch, sequences) = (Vec::with_capacity(4096), Vec::with_capacity(64));
        (Self { shared, queue, scratch, sequences, handing_over }, end)
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
        let order = self.take_order();
        self.push(Prefix { length, order, stream, sequence: number, times });
    }

    /// The next place in the order of all lanes. Whoever takes a later one and is heard of has the writer know of this one: the store
    /// goes before the addition, which later ones come after.
    fn take_order(&self) -> u64 {
        self.handing_over.store(self.shared.order.load(Ordering::Relaxed), Ordering::Release);
        self.shared.order.fetch_add(1, Ordering::AcqRel)
    }

    fn push(&mut self, prefix: Prefix) {
        prefix.write(&mut self.scratch);
        if self.queue.push_entire_slice(&self.scratch).is_err() {
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
        }
        self.handing_over.store(IDLE, Ordering::Release);
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
    handing_over: Arc<AtomicU64>,
}

/// Which message comes next.
#[derive(Debug)]
pub(crate) enum Next {
    /// There is none.
    None,
    /// A lane is just now handing over one that may come before those that are there.
    Soon,
    /// That of this lane.
    Of(usize, Prefix),
}

fn earliest(lanes: &mut [LaneEnd]) -> Option<(usize, Prefix)> {
    let heads = lanes.iter_mut().enumerate().filter_map(|(index, lane)| Some((index, lane.peek()?)));
    heads.min_by_key(|(_, prefix)| prefix.order)
}

/// The next message in the order of all lanes; where `patient` is false, of those that are there already.
pub(crate) fn next(lanes: &mut [LaneEnd], patient: bool) -> Next {
    let Some((index, prefix)) = earliest(lanes) else { return Next::None };
    if lanes.len() == 1 || !patient {
        return Next::Of(index, prefix);
    }
    if lanes.iter().any(|lane| lane.handing_over.load(Ordering::Acquire) <= prefix.order) {
        return Next::Soon;
    }
    // Nobody hands over an earlier one any more; what was handed over since the lanes were looked at is there now.
    earliest(lanes).map_or(Next::None, |(index, prefix)| Next::Of(index, prefix))
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

    /// The bytes of the message that was peeked at, in a room that only grows: what it held is written over, not wiped.
    pub(crate) fn take<'a>(&mut self, room: &'a mut Vec<u8>) -> &'a [u8] {
        let Some(prefix) = self.head.take() else { return &[] };
        let length = prefix.length as usize;
        if room.len() < length {
            room.resize(length, 0);
        }
        // The message was put in whole, so its bytes are there.
        let whole = self.queue.pop_entire_slice(&mut room[..length]).is_ok();
        debug_assert!(whole);
        &room[..length]
    }

    /// The other end is gone and nothing is left.
    pub(crate) fn is_over(&self) -> bool {
        self.head.is_none() && self.queue.is_abandoned() && self.queue.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prefix(order: u64) -> Prefix {
        Prefix { length: 0, order, stream: 1, sequence: 0, times: Times::at(Timestamp::default()) }
    }

    /// A thread that took its place in the order and was held up before it had handed over its message.
    #[test]
    fn a_message_that_is_being_handed_over_keeps_its_place() {
        let shared = Arc::<Shared>::default();
        let (mut early, early_end) = Lane::new(shared.clone(), 1 << 10);
        let (mut late, late_end) = Lane::new(shared, 1 << 10);
        let mut ends = [early_end, late_end];
        for lane in [&mut early, &mut late] {
            lane.scratch.resize(PREFIX, 0);
        }
        assert!(matches!(next(&mut ends, true), Next::None));
        let first = early.take_order();
        let second = late.take_order();
        late.push(prefix(second));
        assert!(matches!(next(&mut ends, true), Next::Soon));
        // Somebody who does not come back is not waited for without end.
        assert!(matches!(next(&mut ends, false), Next::Of(1, _)));
        early.push(prefix(first));
        let mut order = Vec::new();
        while let Next::Of(index, prefix) = next(&mut ends, true) {
            ends[index].take(&mut Vec::new());
            order.push(prefix.order);
        }
        assert_eq!(order, [first, second]);
    }

    #[test]
    fn the_longest_time_away_is_kept() {
        let shared = Shared::default();
        std::thread::sleep(Duration::from_millis(3));
        assert!(shared.longest_away() >= Duration::from_millis(3), "it has not looked yet");
        shared.look();
        shared.look();
        assert!(shared.longest_away() >= Duration::from_millis(3));
    }
}
