//! One log out of several.
//!
//! Messages stay encoded, a log may fail in the middle, and a stream is announced when its first message is met.

use std::collections::BTreeSet;
use std::path::Path;

use serde::Serialize;
use vergence_time::Timestamp;

use crate::cut::arrival;
use crate::error::Error;
use crate::header::Header;
use crate::reader::{Limits, Reader};
use crate::rewrite::{Copier, Rewriter};

/// What was merged.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Merged {
    /// Messages in the new file.
    pub messages: u64,
    /// Streams that were given another name, since an earlier log has one of theirs: old and new.
    pub renamed: Vec<(String, String)>,
}

/// Merges logs into the order of arrival, session time; at the same instant the log that was named first comes first.
/// A stream whose name an earlier log has, too, is put below the name of its file. The session is that of the first
/// log; the others' become notes (`vergence.session.2`, …). Clocks are not aligned: that takes somebody who knows them.
///
/// # Errors
/// Where a log is damaged or cannot be read, or `to` cannot be written.
pub fn merge(from: &[&Path], to: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Merged, Error> {
    let mut merged = Merged::default();
    let mut taken = BTreeSet::new();
    let mut copiers = Vec::new();
    for (source, path) in from.iter().enumerate() {
        // Names first, since a stream may be announced late.
        let mut reader = Reader::open(path)?;
        while reader.next()?.is_some() {}
        let names: BTreeSet<String> = reader.streams().map(|info| info.name.clone()).collect();
        let stem =
            path.file_stem().map_or_else(|| source.to_string(), |stem| stem.to_string_lossy().into_owned());
        let mut renamed = std::collections::BTreeMap::new();
        for name in names {
            let mut new = name.clone();
            let mut count = 1;
            while !taken.insert(new.clone()) {
                let number = if count == 1 { String::new() } else { format!("-{count}") };
                new = format!("/{stem}{number}{name}");
                count += 1;
            }
            if new != name {
                merged.renamed.push((name.clone(), new.clone()));
                renamed.insert(name, new);
            }
        }
        let mut copier = Copier::open(source, path, Limits::default())?;
        copier.name = Box::new(move |name| renamed.get(name).cloned().unwrap_or_else(|| name.to_owned()));
        copiers.push(copier);
    }
    let mut writer = Rewriter::create(to, from)?;
    for (index, copier) in copiers.iter().enumerate() {
        if let Some(session) = copier.reader.header().map(Header::to_map) {
            let name = format!("vergence.session.{}", index + 1);
            if index == 0 { writer.session(session)? } else { writer.metadata(&name, session)? }
        }
    }
    let mut heads: Vec<Option<Waiting>> =
        copiers.iter_mut().map(|copier| Waiting::next(copier, &mut writer)).collect::<Result<_, _>>()?;
    loop {
        let first =
            heads.iter().enumerate().filter_map(|(index, head)| Some((head.as_ref()?.arrived, index))).min();
        let Some((_, index)) = first else { break };
        if let Some(head) = heads[index].take() {
            writer.message(index, head.stream, head.sequence, head.times, &head.payload)?;
            merged.messages += 1;
        }
        heads[index] = Waiting::next(&mut copiers[index], &mut writer)?;
        if merged.messages.is_multiple_of(1024) {
            let (read, all) = copiers
                .iter()
                .map(|copier| copier.reader.progress())
                .fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
            progress(read, all);
        }
    }
    for copier in &mut copiers {
        copier.copy_streams(&mut writer)?;
        copier.copy_facts(&mut writer)?;
    }
    writer.finish()?;
    Ok(merged)
}

/// The message of a log that comes next.
struct Waiting {
    arrived: Timestamp,
    stream: u16,
    sequence: u32,
    times: (u64, u64),
    payload: Vec<u8>,
}

impl Waiting {
    fn next(copier: &mut Copier<'_>, writer: &mut Rewriter) -> Result<Option<Self>, Error> {
        let Some(entry) = copier.reader.next()? else { return Ok(None) };
        let waiting = Self {
            arrived: arrival(&entry),
            stream: entry.stream.id,
            sequence: entry.sequence,
            times: (entry.log_time, entry.publish_time),
            payload: entry.payload.to_vec(),
        };
        let info = entry.stream.clone();
        writer.stream(copier.source, &info, &(copier.name)(&info.name), copier.reader.schema(&info))?;
        Ok(Some(waiting))
    }
}
