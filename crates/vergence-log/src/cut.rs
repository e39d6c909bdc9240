//! A part of a log.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use vergence_time::Timestamp;

use crate::error::Error;
use crate::header::Header;
use crate::message::Times;
use crate::messages::times_of;
use crate::reader::{Entry, Limits};
use crate::rewrite::{Copier, Rewriter};

/// Which part of a log.
#[derive(Clone, Debug, Default)]
pub struct Part {
    /// Messages that arrived at or after this instant, session time.
    pub from: Option<Timestamp>,
    /// Messages that arrived before this instant.
    pub until: Option<Timestamp>,
    /// Streams whose names are one of these or lie below one (`/hand` keeps `/hand/left`); all, where none is named.
    pub streams: Vec<String>,
}

/// What was kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Kept {
    /// Messages in the new file.
    pub messages: u64,
    /// Messages left out.
    pub left_out: u64,
}

impl Part {
    fn has(&self, stream: &str) -> bool {
        let below = |name: &String| {
            stream.strip_prefix(name.as_str()).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
        };
        self.streams.is_empty() || self.streams.iter().any(below)
    }
}

/// When a message arrived: exactly where the payload says, else as MCAP counts.
pub(crate) fn arrival(entry: &Entry<'_>) -> Timestamp {
    let counted = Timestamp::from_nanos(i64::try_from(entry.log_time).unwrap_or(i64::MAX));
    times_of(entry).ok().flatten().map_or(counted, |times: Times| times.arrived)
}

/// Writes a part of the log at `from` to `to`, with all that the log says about its session; `progress` hears of bytes
/// read and bytes in all.
///
/// # Errors
/// Where the log is damaged or cannot be read, has no stream that was named, or `to` cannot be written.
pub fn cut(from: &Path, to: &Path, part: &Part, progress: &mut dyn FnMut(u64, u64)) -> Result<Kept, Error> {
    let mut copier = Copier::open(0, from, Limits::default())?;
    if let (Some(begin), Some(end)) = (part.from, part.until)
        && begin >= end
    {
        let length = begin.since(end).map_or(f64::INFINITY, |span| span.as_secs_f64());
        return Err(Error::Request(format!(
            "expected a part that ends after it begins, found one that ends {length} s before"
        )));
    }
    let mut writer = Rewriter::create(to, &[from])?;
    if let Some(session) = copier.reader.header().map(Header::to_map) {
        writer.session(session)?;
    }
    let mut kept = Kept::default();
    loop {
        let (read, all) = copier.reader.progress();
        let Some(entry) = copier.reader.next()? else { break };
        if kept.messages.is_multiple_of(1024) {
            progress(read, all);
        }
        let arrived = arrival(&entry);
        let inside =
            part.from.is_none_or(|from| arrived >= from) && part.until.is_none_or(|end| arrived < end);
        if !inside || !part.has(&entry.stream.name) {
            kept.left_out += 1;
            continue;
        }
        kept.messages += 1;
        let info = entry.stream.clone();
        if writer.entry(0, &entry).is_err() {
            let (sequence, times, payload) =
                (entry.sequence, (entry.log_time, entry.publish_time), entry.payload.to_vec());
            writer.stream(0, &info, &info.name, copier.reader.schema(&info))?;
            writer.message(0, info.id, sequence, times, &payload)?;
        }
    }
    for name in &part.streams {
        if !copier
            .reader
            .streams()
            .any(|info| Part { streams: vec![name.clone()], ..Part::default() }.has(&info.name))
        {
            let names: Vec<&str> = copier.reader.streams().map(|info| info.name.as_str()).collect();
            return Err(Error::NoStream {
                path: from.to_owned(),
                stream: name.clone(),
                found: names.join(", "),
            });
        }
    }
    // Also streams without messages, so that a part has the streams of the whole.
    let kept_streams: Vec<_> = copier.reader.streams().filter(|info| part.has(&info.name)).cloned().collect();
    for info in kept_streams {
        writer.stream(0, &info, &info.name, copier.reader.schema(&info))?;
    }
    copier.copy_facts(&mut writer)?;
    let mut note = BTreeMap::from([("of".to_owned(), from.display().to_string())]);
    for (key, instant) in [("from_ns", part.from), ("until_ns", part.until)] {
        if let Some(instant) = instant {
            note.insert(key.to_owned(), instant.as_nanos().to_string());
        }
    }
    if !part.streams.is_empty() {
        note.insert("streams".to_owned(), part.streams.join(" "));
    }
    writer.metadata("vergence.cut", note)?;
    writer.finish()?;
    Ok(kept)
}

/// When the first message of a log arrived, session time; `None` where it has none.
///
/// # Errors
/// Where the log is damaged there or cannot be read.
pub fn first_arrival(path: &Path) -> Result<Option<Timestamp>, Error> {
    Ok(crate::reader::Reader::open(path)?.next()?.map(|entry| arrival(&entry)))
}
