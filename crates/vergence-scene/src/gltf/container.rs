//! The bytes around the JSON: GLB chunks, buffers, data URIs.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use base64::Engine;

use super::raw;
use crate::Error;
use crate::import::{Bytes, Import};

/// Written before JSON by some editors; the JSON is then refused with its place.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

/// A glTF file taken apart, and the buffers that its JSON names.
pub(super) struct Container {
    pub json: Range<usize>,
    binary: Option<Range<usize>>,
    /// Of the JSON in the file, for messages.
    pub json_place: &'static str,
}

impl Container {
    /// Finds the chunks of a `.glb`, or takes the whole file as JSON.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, Error> {
        if bytes.is_empty() {
            return Err(Error::invalid(path, "byte 0", "expected glTF, found an empty file"));
        }
        if !bytes.starts_with(b"glTF") {
            let first = bytes.iter().find(|byte| !byte.is_ascii_whitespace());
            if first != Some(&b'{') && !bytes.starts_with(BYTE_ORDER_MARK) {
                let expected = "expected \"glTF\" or a JSON object";
                return Err(Error::invalid(path, "byte 0", format!("{expected}, found neither")));
            }
            return Ok(Self { json: 0..bytes.len(), binary: None, json_place: "JSON" });
        }
        let word = |at: usize| {
            let bytes = bytes.get(at..at + 4)?;
            Some(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
        };
        let header = |at: usize, what: &str| {
            word(at).ok_or_else(|| {
                Error::invalid(
                    path,
                    format!("byte {at}"),
                    format!("expected {what}, found the end of the file"),
                )
            })
        };
        let version = header(4, "the GLB version")?;
        if version != 2 {
            return Err(Error::invalid(path, "byte 4", format!("expected GLB version 2, found {version}")));
        }
        let length = header(8, "the GLB length")? as usize;
        if length > bytes.len() {
            return Err(Error::invalid(
                path,
                "byte 8",
                format!("expected {length} bytes as the header says, found {}: the file is cut", bytes.len()),
            ));
        }
        let (mut json, mut binary) = (None, None);
        let mut at = 12;
        while at < length {
            let chunk_length = header(at, "a chunk length")? as usize;
            let kind = header(at + 4, "a chunk type")?;
            let start = at + 8;
            if chunk_length > length.saturating_sub(start) {
                return Err(Error::invalid(
                    path,
                    format!("byte {at}"),
                    format!(
                        "expected a chunk of at most {} bytes, found {chunk_length}",
                        length.saturating_sub(start)
                    ),
                ));
            }
            let range = start..start + chunk_length;
            match kind {
                0x4E4F_534A if json.is_none() => json = Some(range),
                0x004E_4942 if binary.is_none() => binary = Some(range),
                _ => {}
            }
            // Chunks are padded to four bytes; a writer that forgot the padding is followed to its next chunk.
            at = start + chunk_length;
        }
        let json =
            json.ok_or_else(|| Error::invalid(path, "byte 12", "expected a JSON chunk, found none"))?;
        Ok(Self { json, binary, json_place: "JSON chunk" })
    }

    /// What is wrong with the JSON `text`, and where: line and column of a text, the byte of a `.glb`.
    pub fn json_error(&self, path: &Path, text: &[u8], error: &serde_json::Error) -> Error {
        let (line, column) = (error.line(), error.column());
        let place = if self.json.start == 0 {
            format!("{}:{}", line.max(1), column.max(1))
        } else {
            let before: usize = text
                .split_inclusive(|&byte| byte == b'\n')
                .take(line.saturating_sub(1))
                .map(<[u8]>::len)
                .sum();
            format!("byte {}", self.json.start + before + column.saturating_sub(1))
        };
        let said = error.to_string();
        // The place is said once.
        let said = said.strip_suffix(&format!(" at line {line} column {column}")).unwrap_or(&said);
        Error::invalid(path, place, format!("expected glTF, found: {said}"))
    }
}

/// The bytes of one buffer: a part of a file, or decoded from a data URI.
pub(super) struct Buffer {
    bytes: Bytes,
    range: Range<usize>,
}

impl Buffer {
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[self.range.clone()]
    }
}

/// Fetches all buffers that buffer views refer to.
pub(super) fn buffers(
    import: &mut Import<'_>,
    path: &Path,
    file: &Bytes,
    container: &Container,
    root: &raw::Root,
) -> Result<Vec<Option<Buffer>>, Error> {
    let mut used = vec![false; root.buffers.len()];
    for view in &root.buffer_views {
        if let Some(used) = used.get_mut(view.buffer) {
            *used = true;
        }
    }
    let mut buffers = Vec::with_capacity(root.buffers.len());
    for (index, buffer) in root.buffers.iter().enumerate() {
        if !used[index] {
            buffers.push(None);
            continue;
        }
        let place = format!("buffers[{index}]");
        let (bytes, range) = match (&buffer.uri, &container.binary) {
            (Some(uri), _) => {
                let bytes = fetch(import, path, &format!("{place}.uri"), uri)?;
                let range = 0..bytes.len();
                (bytes, range)
            }
            (None, Some(range)) if index == 0 => (Arc::clone(file), range.clone()),
            (None, _) => {
                return Err(Error::invalid(
                    path,
                    place,
                    "expected a uri or the file's binary chunk, found neither",
                ));
            }
        };
        if (range.len() as u64) < buffer.byte_length {
            return Err(Error::invalid(
                path,
                format!("{place}.byteLength"),
                format!(
                    "expected at most {} bytes (those that are there), found {}",
                    range.len(),
                    buffer.byte_length
                ),
            ));
        }
        // The binary chunk may be longer by its padding.
        let range = range.start..range.start + buffer.byte_length as usize;
        buffers.push(Some(Buffer { bytes, range }));
    }
    Ok(buffers)
}

/// The bytes behind a URI: a data URI, or a relative path to a file inside the scene's folder.
pub(super) fn fetch(import: &mut Import<'_>, path: &Path, place: &str, uri: &str) -> Result<Bytes, Error> {
    let Some(data) = uri.strip_prefix("data:") else {
        let relative = percent_decoded(uri).ok_or_else(|| {
            Error::invalid(path, place, format!("expected UTF-8 behind %XX, found {uri:?}"))
        })?;
        return import.read_beside(path, place, &relative);
    };
    let (head, payload) = data
        .split_once(',')
        .ok_or_else(|| Error::invalid(path, place, "expected a comma in the data URI, found none"))?;
    if !head.ends_with(";base64") {
        return Err(Error::invalid(
            path,
            place,
            format!("expected a base64 data URI, found \"data:{head}\""),
        ));
    }
    import.charge(path, place, payload.len(), 1)?;
    let engine = base64::engine::GeneralPurpose::new(
        &base64::alphabet::STANDARD,
        base64::engine::GeneralPurposeConfig::new()
            .with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent)
            .with_decode_allow_trailing_bits(true),
    );
    let bytes = engine
        .decode(payload)
        .map_err(|error| Error::invalid(path, place, format!("expected base64, found: {error}")))?;
    Ok(Arc::new(bytes))
}

fn percent_decoded(uri: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&first, tail)) = rest.split_first() {
        let digits = (first == b'%').then(|| tail.get(..2)).flatten();
        let value = digits.and_then(|d| u8::from_str_radix(std::str::from_utf8(d).ok()?, 16).ok());
        bytes.push(value.unwrap_or(first));
        rest = if value.is_some() { &tail[2..] } else { tail };
    }
    String::from_utf8(bytes).ok()
}
