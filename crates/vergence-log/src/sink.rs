//! The file under the writer.

use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// A file with a buffer that goes quiet once it has failed. The MCAP writer ends its file when it is dropped; after a
/// failure that must not touch what is good.
#[derive(Debug)]
pub(crate) struct Sink {
    file: File,
    buffer: Vec<u8>,
    quiet: Arc<AtomicBool>,
    checksum: Arc<Mutex<crc32fast::Hasher>>,
}

const BUFFER: usize = 256 << 10;

impl Sink {
    pub(crate) fn new(file: File) -> Self {
        Self { file, buffer: Vec::with_capacity(BUFFER), quiet: Arc::default(), checksum: Arc::default() }
    }

    /// Once set, nothing is written any more and nothing fails.
    pub(crate) fn quiet(&self) -> Arc<AtomicBool> {
        self.quiet.clone()
    }

    /// Of all that went to the file, CRC-32.
    pub(crate) fn checksum(&self) -> Arc<Mutex<crc32fast::Hasher>> {
        self.checksum.clone()
    }

    fn count(&self, bytes: &[u8]) {
        self.checksum.lock().unwrap_or_else(PoisonError::into_inner).update(bytes);
    }

    fn empty(&mut self) -> std::io::Result<()> {
        let result = self.file.write_all(&self.buffer);
        self.count(&self.buffer);
        self.buffer.clear();
        result
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.quiet.load(Ordering::Acquire) {
            return Ok(bytes.len());
        }
        if self.buffer.len() + bytes.len() > BUFFER {
            self.empty()?;
        }
        if bytes.len() >= BUFFER {
            self.file.write_all(bytes)?;
            self.count(bytes);
        } else {
            self.buffer.extend_from_slice(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        if self.quiet.load(Ordering::Acquire) { Ok(()) } else { self.empty() }
    }
}

impl Seek for Sink {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        if self.quiet.load(Ordering::Acquire) {
            return Ok(0);
        }
        // Only asked where it is; chunks are put together in memory, so nothing is patched.
        if to == SeekFrom::Current(0) {
            return Ok(self.file.stream_position()? + self.buffer.len() as u64);
        }
        self.empty()?;
        self.file.seek(to)
    }
}
