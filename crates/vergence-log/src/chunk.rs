//! What is inside of a chunk.

use std::io::Read;

use crate::records::{ChunkRecord, Malformed};

/// The largest window that a compressor may ask for: 2^26 bytes, more than any level of zstd uses on its own.
const WINDOW_LOG_MAX: u32 = 26;

/// Chunks up to this size are decompressed in one piece; larger ones as they come, for the size is only announced.
const MOST_AT_ONCE: u64 = 4 << 20;

/// Decompresses chunk after chunk with what the first one took.
#[derive(Default)]
pub(crate) struct Decompressor {
    zstd: Option<zstd::bulk::Decompressor<'static>>,
}

impl Decompressor {
    /// Decompresses a chunk into `into` and checks its checksum: what is not whole is not read at all.
    pub(crate) fn decompress(
        &mut self,
        chunk: &ChunkRecord<'_>,
        limit: u64,
        into: &mut Vec<u8>,
    ) -> Result<(), Malformed> {
        into.clear();
        let size = chunk.uncompressed_size;
        if size > limit {
            return Err(Malformed::new(
                "a chunk that fits into the memory that is allowed",
                format!("{size} bytes"),
            ));
        }
        let broken = |error: std::io::Error| Malformed::new("compressed data", error.to_string());
        match chunk.compression {
            "" => into.extend_from_slice(chunk.data),
            "zstd" if size <= MOST_AT_ONCE => self.zstd_at_once(chunk.data, size, into).map_err(broken)?,
            "zstd" => {
                let mut decoder = zstd::stream::read::Decoder::with_buffer(chunk.data).map_err(broken)?;
                decoder.window_log_max(WINDOW_LOG_MAX).map_err(broken)?;
                decoder.take(size + 1).read_to_end(into).map_err(broken)?;
            }
            "lz4" => {
                let decoder = lz4::Decoder::new(chunk.data).map_err(broken)?;
                decoder.take(size + 1).read_to_end(into).map_err(broken)?;
            }
            other => return Err(Malformed::new("compression by zstd, lz4 or none", format!("'{other}'"))),
        }
        if into.len() as u64 != size {
            return Err(Malformed::new("as many bytes as the chunk announces", format!("{size} announced")));
        }
        if chunk.crc != 0 && chunk.crc != crc32fast::hash(into) {
            return Err(Malformed::new("a chunk whose checksum is right", "another checksum"));
        }
        Ok(())
    }

    /// Straight to where it is read, without the window of a stream.
    fn zstd_at_once(&mut self, data: &[u8], size: u64, into: &mut Vec<u8>) -> std::io::Result<()> {
        let context = match &mut self.zstd {
            Some(context) => context,
            none => none.insert(zstd::bulk::Decompressor::new()?),
        };
        // At most what was just compared.
        into.reserve_exact(size as usize);
        context.decompress_to_buffer(data, into).map(drop)
    }
}
