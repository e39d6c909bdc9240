//! A whole log out of a damaged one.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use crate::error::Error;
use crate::header::{Header, REPAIRED};
use crate::reader::{Ending, Limits, Reader};
use crate::rewrite::{Copier, Rewriter};

/// What a repair found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Repair {
    /// Messages in the new file: every one that is whole in the old one, bit for bit, in its order.
    pub messages: u64,
    /// The old file ended as it should, and nothing in it was damaged.
    pub was_complete: bool,
    /// From here on nothing whole was left.
    pub cut_off_at: Option<u64>,
    /// The recording had failed (a full disk), and the file ends there: its note `vergence.failed` says why.
    pub recording_failed: bool,
    /// Bytes behind the last whole record.
    pub lost_bytes_at_end: u64,
    /// Damage before that: where, and what was expected and found. The first thousand places.
    pub damaged: Vec<String>,
    /// Places of damage in all.
    pub damaged_count: u64,
    /// Messages whose numbers are missing.
    pub missing: u64,
    /// Messages that are missing because the announcement of their stream is lost, by the stream's number in the old
    /// file: nothing says what they carry.
    pub unannounced: BTreeMap<u16, u64>,
    /// Attachments that were damaged and are not in the new file.
    pub lost_attachments: Vec<String>,
}

/// Writes every message that is whole in the log at `from` to a new file at `to`; `progress` hears of bytes read and
/// bytes in all. A log that is whole is copied; else the new file has a note `vergence.repaired` of what was found.
///
/// # Errors
/// Where `from` is no log at all, or `to` cannot be written.
pub fn repair(
    from: &Path,
    to: &Path,
    limits: Limits,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Repair, Error> {
    let mut found = Repair::default();
    let mut copier = Copier::open(0, from, limits)?;
    let mut writer = Rewriter::create(to, &[from])?;
    let session = copier.reader.header().map(Header::to_map);
    let had_session = session.is_some();
    if let Some(session) = session {
        writer.session(session)?;
    }
    let mut next: BTreeMap<u16, u32> = BTreeMap::new();
    loop {
        if found.messages.is_multiple_of(1024) {
            let (read, all) = copier.reader.progress();
            progress(read, all);
        }
        match copier.reader.next() {
            Ok(Some(entry)) => {
                found.messages += 1;
                let expected = next.entry(entry.stream.id).or_insert(entry.sequence);
                let ahead = entry.sequence.wrapping_sub(*expected);
                if ahead < u32::MAX / 2 {
                    found.missing += u64::from(ahead);
                }
                *expected = entry.sequence.wrapping_add(1);
                let (id, sequence) = (entry.stream.id, entry.sequence);
                let times = (entry.log_time, entry.publish_time);
                if writer.message(0, id, sequence, times, entry.payload).is_err() {
                    // A stream that was met just now.
                    let payload = entry.payload.to_vec();
                    let info = entry.stream.clone();
                    found.lost_attachments.extend(copier.copy_facts(&mut writer)?);
                    writer.stream(0, &info, &info.name, copier.reader.schema(&info))?;
                    writer.message(0, id, sequence, times, &payload)?;
                }
            }
            Ok(None) => break,
            Err(Error::Damaged { at, expected, found: there, .. }) => {
                // Reading goes on behind each, so there are no more of them than the file has bytes.
                found.damaged_count += 1;
                if found.damaged.len() < DAMAGE_KEPT {
                    found.damaged.push(format!("byte {at}: expected {expected}, found {there}"));
                }
            }
            Err(error) => return Err(error),
        }
    }
    found.lost_attachments.extend(copier.copy_facts(&mut writer)?);
    copier.copy_streams(&mut writer)?;
    if !had_session && let Some(header) = copier.reader.header() {
        writer.session(header.to_map())?;
    }
    end(&copier.reader, &mut found);
    if !found.was_complete {
        writer.metadata(REPAIRED, note(from, &found))?;
    }
    writer.finish()?;
    Ok(found)
}

/// What the new file says of the old one.
fn note(from: &Path, found: &Repair) -> BTreeMap<String, String> {
    let mut note = BTreeMap::from([("of".to_owned(), from.display().to_string())]);
    let mut add = |key: &str, value: u64| {
        if value > 0 {
            note.insert(key.to_owned(), value.to_string());
        }
    };
    add("recording_failed", found.recording_failed.into());
    add("lost_bytes_at_end", found.lost_bytes_at_end);
    add("damaged", found.damaged_count);
    add("missing_messages", found.missing);
    add("unannounced_messages", found.unannounced.values().sum());
    add("lost_attachments", found.lost_attachments.len() as u64);
    if let Some(at) = found.cut_off_at {
        note.insert("cut_off_at".to_owned(), at.to_string());
    }
    note
}

/// Places of damage that are told one by one.
const DAMAGE_KEPT: usize = 1000;

fn end(reader: &Reader, found: &mut Repair) {
    found.unannounced.clone_from(reader.unannounced());
    match reader.ending() {
        Some(Ending::CutOff { at }) => {
            found.cut_off_at = Some(at);
            found.lost_bytes_at_end = reader.progress().1.saturating_sub(at);
        }
        Some(Ending::Failed { at }) => (found.cut_off_at, found.recording_failed) = (Some(at), true),
        _ => found.was_complete = found.damaged_count == 0 && found.lost_attachments.is_empty(),
    }
}
