//! Where two logs part.

use std::collections::{BTreeMap, VecDeque};
use std::hash::{DefaultHasher, Hasher};
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
    hash: u64,
    length: usize,
    arrived_ns: i64,
    offset: u64,
    /// Where it is not large: to be taken apart.
    payload: Vec<u8>,
}

/// Of larger messages, pictures, it is not told what differs.
const TAKEN_APART: usize = 16 << 10;

impl Seen {
    fn of(entry: &Entry<'_>) -> Self {
        let mut hasher = DefaultHasher::new();
        hasher.write(entry.payload);
        Self {
            hash: hasher.finish(),
            length: entry.payload.len(),
            arrived_ns: crate::cut::arrival(entry).as_nanos(),
            offset: entry.place.offset,
            payload: if entry.payload.len() <= TAKEN_APART { entry.payload.to_vec() } else { Vec::new() },
        }
    }

    fn equals(&self, other: &Self) -> bool {
        (self.hash, self.length) == (other.hash, other.length)
    }
}

#[derive(Default)]
struct Pair {
    diff: StreamDiff,
    /// Of the first log (0) or the second (1), which is ahead.
    ahead: usize,
    waiting: VecDeque<Seen>,
    types: [String; 2],
}

impl Pair {
    fn add(&mut self, side: usize, seen: Seen) {
        let count = if side == 0 { &mut self.diff.count_a } else { &mut self.diff.count_b };
        *count += 1;
        if self.diff.first_difference.is_some() || self.diff.not_compared.is_some() {
            return;
        }
        if self.waiting.is_empty() || self.ahead == side {
            self.ahead = side;
            self.waiting.push_back(seen);
            return;
        }
        let Some(other) = self.waiting.pop_front() else { return };
        if other.equals(&seen) {
            self.diff.equal_until += 1;
        } else {
            let (a, b) = if side == 0 { (seen, other) } else { (other, seen) };
            self.part(Some(a), Some(b));
        }
    }

    fn part(&mut self, a: Option<Seen>, b: Option<Seen>) {
        let apart = |a: &Seen, b: &Seen| {
            if a.payload.is_empty() || b.payload.is_empty() || self.types[0] != self.types[1] {
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
            (Some(a), Some(b)) if a.length != b.length => {
                format!("{} bytes in the first log, {} in the second", a.length, b.length)
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
    }
}

/// Compares the messages of each stream in their order, bit for bit, with both times. Streams of host time and the
/// recorder's own are counted and never compared. Memory is in proportion to how far one log is ahead of the other;
/// both are read at the same pace.
///
/// # Errors
/// Where a log is damaged or cannot be read.
pub fn diff(a: &Path, b: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Diff, Error> {
    let mut readers = [Reader::open(a)?, Reader::open(b)?];
    let mut over = [false; 2];
    let mut pairs: BTreeMap<String, Pair> = BTreeMap::new();
    let mut step = 0u64;
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
        let seen = Seen::of(&entry);
        if !pairs.contains_key(&entry.stream.name) {
            pairs.insert(entry.stream.name.clone(), Pair::default());
        }
        if let Some(pair) = pairs.get_mut(&entry.stream.name) {
            note(pair, side, &entry);
            pair.add(side, seen);
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

fn note(pair: &mut Pair, side: usize, entry: &Entry<'_>) {
    entry.stream.type_name().clone_into(&mut pair.types[side]);
    if entry.stream.clock() == ClockKind::Host {
        pair.diff.not_compared = Some("host time");
    } else if entry.stream.name == crate::writer::StreamRecord::OWN {
        pair.diff.not_compared = Some(OWN);
    }
}
