//! Behind damage: where reading goes on, and what a complete file says twice.

use std::io::{ErrorKind, Read};

use super::{Ending, Reader};
use crate::error::Error;
use crate::records::{Fields, HEAD, MAGIC, Malformed, op};

/// Bytes of the longest head of a chunk, with the names of compression that are known.
const CHUNK_HEAD: usize = HEAD + 44;

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
    pub(super) offset: u64,
    /// The record after it, if its length is right.
    pub(super) next: u64,
}

impl Reader {
    /// Goes to the first record behind damage: the next one where the damaged one's length leads to one, else the next
    /// whole chunk.
    pub(super) fn go_on(&mut self, behind: Behind) -> Result<(), Error> {
        let next = if self.is_record(behind.next)? {
            Some(behind.next)
        } else {
            self.find_chunk(behind.offset + 1)?
        };
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
                Ok(read) => filled += read,
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
        let (mut at, mut window) = (from, vec![0; 256 << 10]);
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
        self.body = waiting;
        self.seek(before)
    }
}
