//! Where two logs part.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;

use serde::Serialize;

use crate::error::Error;
use crate::fields::{FieldDiff, differing};
use crate::message::ClockKind;
use crate::messages::schema_of;
use crate::reader::{Entry, Reader};

/// How two logs compare.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Diff {
    /// All compared streams are equal.
    pub equal: bool,
    /// By name.
    pub streams: Vec<StreamDiff>,
}

/// How a stream of two logs compares.
#[derive(Clone, Debug, Default, Serialize)]
pub struct StreamDiff {
    /// `/head`.
    pub name: String,
    /// Why it is not compared: it holds host time, or is the recorder's own.
    pub not_compared: Option<&'static str>,
    /// Messages in the first log.
    pub count_a: u64,
    /// Messages in the second log.
    pub count_b: u64,
    /// Messages that are equal, bit for bit, before the first that is not.
    pub equal_until: u64,
    /// The first message that differs, or that only one of the logs has.
    pub first_difference: Option<Difference>,
}

/// The first message that differs.
#[derive(Clone, Debug, Serialize)]
pub struct Difference {
    /// Counted from 0 in its stream.
    pub index: u64,
    /// Arrival in the first log, nanoseconds; `None` where it has ended.
    pub arrived_a_ns: Option<i64>,
    /// Arrival in the second log, nanoseconds.
    pub arrived_b_ns: Option<i64>,
    /// Offset of its chunk in the first log.
    pub offset_a: Option<u64>,
    /// Offset of its chunk in the second log.
    pub offset_b: Option<u64>,
    /// In words.
    pub sentence: String,
    /// What of the message differs, the first eight of it.
    pub fields: Vec<FieldDiff>,
    /// How many fields differ in all.
    pub fields_count: u64,
}

/// Why what the recorder itself says is not compared.
const OWN: &str = "the recorder's own";

/// A message that waits for the other log's.
struct Seen {
    arrived_ns: i64,
    offset: u64,
    payload: Vec<u8>,
}

/// Of larger messages, pictures, it is not told what differs.
const TAKEN_APART: usize = 16 << 10;
/// Bytes of messages that may wait before it is counted how many the other log has: what waits for nothing need not be kept.
const WAITING: usize = 8 << 20;
/// Memory that a message takes beside its payload, about.
const SEEN: usize = 64;

impl Seen {
    fn of(entry: &Entry<'_>) -> Self {
        Self {
            arrived_ns: crate::cut::arrival(entry).as_nanos(),
            offset: entry.place.offset,
            payload: entry.payload.to_vec(),
        }
    }
}

#[derive(Default)]
struct Pair {
    diff: StreamDiff,
    /// Of the first log (0) or the second (1), which is ahead.
    ahead: usize,
    waiting: VecDeque<Seen>,
    waiting_bytes: usize,
    types: [String; 2],
    /// How many messages each log has in all, where that was counted.
    totals: Option<[u64; 2]>,
}

impl Pair {
    /// Messages that can still be compared, and the first that cannot.
    fn useful(&self) -> u64 {
        let seen = [self.diff.count_a, self.diff.count_b];
        let behind = 1 - self.ahead;
        self.totals.map_or(u64::MAX, |totals| totals[behind].saturating_sub(seen[behind]).saturating_add(1))
    }

    fn forget(&mut self) {
        self.waiting = VecDeque::new();
        self.waiting_bytes = 0;
    }

    fn count(&mut self, totals: [u64; 2]) {
        self.totals = Some(totals);
        let useful = usize::try_from(self.useful()).unwrap_or(usize::MAX);
        self.waiting.truncate(useful);
        self.waiting.shrink_to_fit();
        self.waiting_bytes = self.waiting.iter().map(|seen| seen.payload.len() + SEEN).sum();
    }

    fn add(&mut self, side: usize, entry: &Entry<'_>) {
        let count = if side == 0 { &mut self.diff.count_a } else { &mut self.diff.count_b };
        *count += 1;
        if self.diff.not_compared.is_some() {
            return self.forget();
        }
        if self.diff.first_difference.is_some() {
            return;
        }
        if self.waiting.is_empty() || self.ahead == side {
            self.ahead = side;
            if (self.waiting.len() as u64) < self.useful() {
                self.waiting_bytes += entry.payload.len() + SEEN;
                self.waiting.push_back(Seen::of(entry));
            }
            return;
        }
        let Some(other) = self.waiting.pop_front() else { return };
        self.waiting_bytes -= other.payload.len() + SEEN;
        if other.payload == entry.payload {
            self.diff.equal_until += 1;
        } else {
            let seen = Seen::of(entry);
            let (a, b) = if side == 0 { (seen, other) } else { (other, seen) };
            self.part(Some(a), Some(b));
        }
    }

    fn part(&mut self, a: Option<Seen>, b: Option<Seen>) {
        let apart = |a: &Seen, b: &Seen| {
            let large = a.payload.len().max(b.payload.len()) > TAKEN_APART;
            if large || self.types[0] != self.types[1] {
                return (Vec::new(), 0);
            }
            differing(schema_of(&self.types[0]), &a.payload, &b.payload)
        };
        let (fields, count) = a.as_ref().zip(b.as_ref()).map_or((Vec::new(), 0), |(a, b)| apart(a, b));
        let sentence = match (&a, &b) {
            (Some(_), Some(_)) if count > 0 => {
                let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "none".to_owned());
                let word = |f: &FieldDiff| format!("{}: {} | {}", f.name, value(&f.a), value(&f.b));
                let more = count - fields.len();
                let more = if more > 0 { format!("; and {more} fields more") } else { String::new() };
                fields.iter().map(word).collect::<Vec<_>>().join("; ") + &more
            }
            (Some(a), Some(b)) if a.payload.len() != b.payload.len() => {
                format!("{} bytes in the first log, {} in the second", a.payload.len(), b.payload.len())
            }
            (Some(_), Some(_)) => "other values".to_owned(),
            (Some(_), None) => "only the first log has it".to_owned(),
            _ => "only the second log has it".to_owned(),
        };
        self.diff.first_difference = Some(Difference {
            index: self.diff.equal_until,
            arrived_a_ns: a.as_ref().map(|seen| seen.arrived_ns),
            arrived_b_ns: b.as_ref().map(|seen| seen.arrived_ns),
            offset_a: a.as_ref().map(|seen| seen.offset),
            offset_b: b.as_ref().map(|seen| seen.offset),
            sentence,
            fields,
            fields_count: count as u64,
        });
        self.forget();
    }
}

/// How many messages each stream of a log has.
fn totals(path: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<BTreeMap<String, u64>, Error> {
    let mut reader = Reader::open(path)?;
    let mut by_number: BTreeMap<u16, (String, u64)> = BTreeMap::new();
    let mut step = 0u64;
    loop {
        let (read, all) = reader.progress();
        let Some(entry) = reader.next()? else { break };
        by_number.entry(entry.stream.id).or_insert_with(|| (entry.stream.name.clone(), 0)).1 += 1;
        step += 1;
        if step.is_multiple_of(1024) {
            progress(read, all);
        }
    }
    let mut totals = BTreeMap::new();
    for (name, count) in by_number.into_values() {
        *totals.entry(name).or_default() += count;
    }
    Ok(totals)
}

/// Compares the messages of each stream in their order, bit for bit, with both times. Streams of host time and the
/// recorder's own are counted and never compared. Memory is in proportion to how far one log is ahead of the other in a stream that
/// both have; both are read at the same pace, and a second time where one is more than 8 MiB ahead, to count its messages.
///
/// # Errors
/// Where a log is damaged or cannot be read.
pub fn diff(a: &Path, b: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Diff, Error> {
    let mut readers = [Reader::open(a)?, Reader::open(b)?];
    let mut over = [false; 2];
    let mut pairs: BTreeMap<String, Pair> = BTreeMap::new();
    let mut step = 0u64;
    let (mut waiting_bytes, mut counted) = (0, None);
    while over != [true; 2] {
        let part = |reader: &Reader| {
            let (read, all) = reader.progress();
            read as f64 / all.max(1) as f64
        };
        let side = usize::from(over[0] || (!over[1] && part(&readers[0]) > part(&readers[1])));
        let Some(entry) = readers[side].next()? else {
            over[side] = true;
            continue;
        };
        if !pairs.contains_key(&entry.stream.name) {
            let totals = counted.as_ref().map(|counted| totals_of(counted, &entry.stream.name));
            pairs.insert(entry.stream.name.clone(), Pair { totals, ..Pair::default() });
        }
        if let Some(pair) = pairs.get_mut(&entry.stream.name) {
            note(pair, side, &entry);
            let before = pair.waiting_bytes;
            pair.add(side, &entry);
            waiting_bytes = waiting_bytes + pair.waiting_bytes - before;
        }
        if waiting_bytes > WAITING && counted.is_none() {
            let totals = counted.insert([totals(a, progress)?, totals(b, progress)?]);
            for (name, pair) in &mut pairs {
                pair.count(totals_of(totals, name));
            }
            waiting_bytes = pairs.values().map(|pair| pair.waiting_bytes).sum();
        }
        step += 1;
        if step.is_multiple_of(1024) {
            let (a, b) = (readers[0].progress(), readers[1].progress());
            progress(a.0 + b.0, a.1 + b.1);
        }
    }
    let mut result = Diff { equal: true, streams: Vec::new() };
    // A stream without messages counts, too.
    for (side, reader) in readers.iter().enumerate() {
        for info in reader.streams() {
            let pair = pairs.entry(info.name.clone()).or_default();
            info.type_name().clone_into(&mut pair.types[side]);
        }
    }
    for (name, mut pair) in pairs {
        if name == crate::writer::StreamRecord::OWN {
            pair.diff.not_compared = Some(OWN);
        }
        pair.diff.name = name;
        if pair.diff.not_compared.is_none() && pair.diff.first_difference.is_none() {
            if let Some(seen) = pair.waiting.pop_front() {
                let (a, b) = if pair.ahead == 0 { (Some(seen), None) } else { (None, Some(seen)) };
                pair.part(a, b);
            } else if pair.types[0] != pair.types[1] {
                pair.part(None, None);
                if let Some(difference) = &mut pair.diff.first_difference {
                    difference.sentence = match (&*pair.types[0], &*pair.types[1]) {
                        (_, "") => "only the first log has this stream".to_owned(),
                        ("", _) => "only the second log has this stream".to_owned(),
                        (a, b) => format!("type '{a}' in the first log, '{b}' in the second"),
                    };
                }
            }
        }
        result.equal &= pair.diff.first_difference.is_none();
        result.streams.push(pair.diff);
    }
    Ok(result)
}

fn totals_of(counted: &[BTreeMap<String, u64>; 2], name: &str) -> [u64; 2] {
    counted.each_ref().map(|counts| counts.get(name).copied().unwrap_or(0))
}

fn note(pair: &mut Pair, side: usize, entry: &Entry<'_>) {
    if pair.types[side].is_empty() {
        entry.stream.type_name().clone_into(&mut pair.types[side]);
    }
    if entry.stream.clock() == ClockKind::Host {
        pair.diff.not_compared = Some("host time");
    } else if entry.stream.name == crate::writer::StreamRecord::OWN {
        pair.diff.not_compared = Some(OWN);
    }
}
