//! Behind damage: where reading goes on, and what a complete file says twice.

use std::io::{ErrorKind, Read};

use super::{Ending, Reader};
use crate::error::Error;
use crate::records::{Fields, HEAD, MAGIC, Malformed, op};

/// Bytes of the longest head of a chunk, with the names of compression that are known.
const CHUNK_HEAD: usize = HEAD + 44;

/// Bytes in which the next chunk is looked for, at first and at most.
const WINDOW: usize = 1 << 10;
const LARGEST_WINDOW: usize = 256 << 10;

fn head_of(bytes: &[u8]) -> Option<(u8, u64)> {
    let (&opcode, rest) = bytes.split_first()?;
    Some((opcode, u64::from_le_bytes(*rest.first_chunk()?)))
}

/// Whether these bytes, the first of `left` to the end of the file, are the head of a chunk.
fn is_chunk(bytes: &[u8], left: u64) -> bool {
    let Some((op::CHUNK, length)) = head_of(bytes) else { return false };
    let mut fields = Fields(&bytes[HEAD..]);
    let what = "a chunk";
    let mut sizes = || {
        fields.bytes(28, what)?;
        let compression = fields.text(what)?;
        Ok::<_, Malformed>((compression, fields.u64(what)?))
    };
    sizes().is_ok_and(|(compression, size)| {
        ["", "lz4", "zstd"].contains(&compression)
            && size.checked_add(40 + compression.len() as u64) == Some(length)
            && length <= left.saturating_sub(HEAD as u64)
    })
}

/// Where reading may go on behind damage.
#[derive(Clone, Copy)]
pub(super) struct Behind {
    /// The damaged record.
    offset: u64,
    /// The record after it, if its length is right.
    next: u64,
    /// From here on a chunk is looked for, if not.
    search: u64,
}

impl Behind {
    pub(super) fn new(offset: u64, next: u64) -> Self {
        Self { offset, next, search: offset + 1 }
    }
}

/// What reading has cost. Inside of a damaged record others may lie that are whole, so what was read is read again there: in a file
/// that was made to mislead, a head of a chunk every few bytes, each of which has all the others in it. So there is a bound.
#[derive(Default)]
pub(super) struct Effort {
    bytes: u64,
    /// Bytes that were read, or decompressed, although they had been read before.
    again: u64,
    /// Everything before this was read.
    furthest: u64,
    /// The record that is read had been.
    is_again: bool,
}

/// Bytes that may be read again however small the file, …
const AGAIN_BYTES: u64 = 16 << 20;
/// … and how many times its length. Damage that nobody made on purpose is far below: each damaged chunk is read again once.
const AGAIN_TIMES: u64 = 4;

impl Effort {
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// What is behind `at` was only looked at.
    pub(super) fn again_from(&mut self, at: u64) {
        self.furthest = self.furthest.min(at);
    }

    /// A record of `wanted` bytes at `at` is going to be read, in a file of `length` bytes. Where too much was read again already,
    /// reading goes on behind everything that was.
    pub(super) fn take(&mut self, at: u64, wanted: u64, length: u64) -> Result<(), Behind> {
        let end = at + HEAD as u64 + wanted;
        let again = self.furthest.min(end).saturating_sub(at);
        if again > 0 && self.again > AGAIN_BYTES.saturating_add(length.saturating_mul(AGAIN_TIMES)) {
            let search = self.furthest.max(at + 1);
            return Err(Behind { offset: at, next: search, search });
        }
        self.is_again = again > 0;
        self.again += again;
        self.bytes += end - at;
        self.furthest = self.furthest.max(end);
        Ok(())
    }

    /// The record that was read last was a chunk, of so many bytes.
    pub(super) fn decompressed(&mut self, bytes: u64) {
        self.bytes += bytes;
        if self.is_again {
            self.again += bytes;
        }
    }
}

impl Reader {
    /// Goes to the first record behind damage: the next one where the damaged one's length leads to one, else the next
    /// whole chunk.
    pub(super) fn go_on(&mut self, behind: Behind) -> Result<(), Error> {
        let next =
            if self.is_record(behind.next)? { Some(behind.next) } else { self.find_chunk(behind.search)? };
        match next {
            Some(next) => self.seek(next),
            None => {
                self.ending = Some(Ending::CutOff { at: behind.offset });
                Ok(())
            }
        }
    }

    fn read_at(&mut self, at: u64, into: &mut [u8]) -> Result<usize, Error> {
        self.seek(at)?;
        let mut filled = 0;
        while filled < into.len() {
            match self.file.read(&mut into[filled..]) {
                Ok(0) => break,
                Ok(read) => {
                    filled += read;
                    self.effort.bytes += read as u64;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(Error::read(&self.path, error)),
            }
        }
        Ok(filled)
    }

    /// Whether something like a record begins at `at`.
    fn is_record(&mut self, at: u64) -> Result<bool, Error> {
        let mut head = [0; CHUNK_HEAD];
        if at >= self.length {
            return Ok(false);
        }
        let there = self.read_at(at, &mut head)?;
        let Some((opcode, length)) = head_of(&head[..there]) else { return Ok(false) };
        let inside = length <= self.length - at - HEAD as u64;
        Ok(match opcode {
            op::CHUNK => is_chunk(&head[..there], self.length - at),
            op::HEADER..=op::DATA_END => inside,
            _ => false,
        })
    }

    /// The first place from `from` on where a chunk begins. A chunk is known by its head, whose lengths agree with each
    /// other and with the file.
    pub(super) fn find_chunk(&mut self, from: u64) -> Result<Option<u64>, Error> {
        let before = self.at;
        // Most often it is near.
        let (mut at, mut window) = (from, vec![0; WINDOW]);
        let mut found = None;
        while found.is_none() && at < self.length {
            let there = self.read_at(at, &mut window)?;
            let bytes = &window[..there];
            found = (0..there)
                .filter(|&index| bytes[index] == op::CHUNK)
                .find(|&index| is_chunk(&bytes[index..], self.length - at - index as u64))
                .map(|index| at + index as u64);
            if there < window.len() {
                break;
            }
            // A head may lie across the border of two windows.
            at += (there - CHUNK_HEAD) as u64;
            window.resize((window.len() * 4).min(LARGEST_WINDOW), 0);
        }
        self.seek(before)?;
        Ok(found)
    }

    /// Streams that were announced in a part that is damaged are announced again at the end of a complete file.
    pub(super) fn read_summary(&mut self) -> Result<(), Error> {
        const ENDING: usize = HEAD + 20 + MAGIC.len();
        if std::mem::replace(&mut self.summary_read, true) || self.length < ENDING as u64 {
            return Ok(());
        }
        let (before, mut ending) = (self.at, [0; ENDING]);
        // What is found here says nothing of where the chunks end that are being read.
        let how_it_ends = (self.ending, self.behind);
        let (furthest, again) = (self.effort.furthest, self.effort.again);
        // The message that is waiting may lie in it.
        let waiting = std::mem::take(&mut self.body);
        self.read_at(self.length - ENDING as u64, &mut ending)?;
        let mut start = [0; 8];
        start.copy_from_slice(&ending[HEAD..HEAD + 8]);
        let start = u64::from_le_bytes(start);
        if ending[0] == op::FOOTER && ending.ends_with(MAGIC) && start > 0 && start < self.length {
            self.seek(start)?;
            while let Ok(Some(head)) = self.read_record()
                && matches!(head.opcode, op::SCHEMA | op::CHANNEL)
            {
                let body = std::mem::take(&mut self.body);
                // What is damaged here, too, is not known.
                drop(self.take_body(head, &body));
                self.body = body;
            }
        }
        (self.ending, self.behind) = how_it_ends;
        (self.effort.furthest, self.effort.again) = (furthest, again);
        self.body = waiting;
        self.seek(before)
    }
}
