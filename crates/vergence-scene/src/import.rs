//! What all importers share: limits, files inside one folder, a budget for memory, warnings.

use std::collections::HashMap;
use std::fmt::Display;
use std::io::Read;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use crate::Error;

/// How much a scene may take to load. What a file asks for beyond that is an error, not an allocation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Pixels of all images of a scene together: 4 bytes each once decoded, up to 16 while one is. Default 2²⁷
    /// (512 MiB).
    pub image_pixels: u64,
    /// Bytes of all files of a scene together. Default 2³¹.
    pub file_bytes: u64,
    /// Memory for everything but images: this many bytes … Default 32,000,000.
    pub memory_bytes: u64,
    /// … and this many for each byte on disk. Default 20.
    pub memory_per_file_byte: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            image_pixels: 1 << 27,
            file_bytes: 1 << 31,
            memory_bytes: 32_000_000,
            memory_per_file_byte: 20,
        }
    }
}

/// Longest path that a scene may name, in bytes: Linux's own limit.
const LONGEST_PATH_BYTES: usize = 4096;
/// So many warnings are told apart; a broken file could have any number.
const MOST_WARNINGS: usize = 64;

/// How far a load has come, for a progress bar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// What is being done: "meshes", "images".
    pub stage: &'static str,
    /// How many are done.
    pub done: usize,
    /// Of how many.
    pub of: usize,
}

/// One file's bytes; read once, however often it is named.
pub(crate) type Bytes = Arc<Vec<u8>>;

/// The state of one load.
pub(crate) struct Import<'a> {
    limits: &'a Limits,
    /// Canonical: nothing outside of it is read.
    root: PathBuf,
    files: HashMap<PathBuf, Bytes>,
    read: Vec<PathBuf>,
    file_bytes: u64,
    charged: u64,
    pixels: u64,
    warnings: Vec<String>,
    progress: &'a mut dyn FnMut(Progress),
}

impl<'a> Import<'a> {
    /// Starts a load that may read what lies in (or below) the folder of `path`.
    pub(crate) fn new(
        path: &Path,
        limits: &'a Limits,
        progress: &'a mut dyn FnMut(Progress),
    ) -> Result<Self, Error> {
        let folder = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let root = folder.canonicalize().map_err(|source| Error::Io { path: path.to_owned(), source })?;
        Ok(Self {
            limits,
            root,
            files: HashMap::new(),
            read: Vec::new(),
            file_bytes: 0,
            charged: 0,
            pixels: 0,
            warnings: Vec::new(),
            progress,
        })
    }

    /// Reads the file that the user named; it is the only one that may be a link to somewhere else.
    pub(crate) fn read_named(&mut self, path: &Path) -> Result<Bytes, Error> {
        self.read_once(path, path.to_owned())
    }

    /// Where `relative`, named at `place` of the file `from`, lies.
    ///
    /// # Errors
    /// Where it is not a relative path to a file inside the scene's folder.
    pub(crate) fn resolve(&self, from: &Path, place: &str, relative: &str) -> Result<PathBuf, Error> {
        if relative.len() > LONGEST_PATH_BYTES {
            let found = relative.len();
            return Err(Error::invalid(
                from,
                place,
                format!("expected a path of at most {LONGEST_PATH_BYTES} bytes, found {found}"),
            ));
        }
        let expected = |found: &str| {
            Error::invalid(
                from,
                place,
                format!("expected a file inside the scene's folder, found {relative:?}{found}"),
            )
        };
        let is_plain =
            |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir | Component::ParentDir);
        let is_windows_absolute = relative.as_bytes().get(1) == Some(&b':');
        if relative.is_empty()
            || relative.contains('\0')
            || is_windows_absolute
            || !Path::new(relative).components().all(is_plain)
        {
            return Err(expected(""));
        }
        let joined = from.parent().unwrap_or(Path::new("")).join(relative);
        // Whether a file outside exists is not said: an escape by name is refused before the system is asked.
        let base_depth = from
            .parent()
            .and_then(|parent| {
                if parent.as_os_str().is_empty() { Path::new(".") } else { parent }.canonicalize().ok()
            })
            .and_then(|parent| {
                parent.strip_prefix(&self.root).ok().map(|below| below.components().count() as i64)
            })
            .unwrap_or(0);
        let mut depth = base_depth;
        for component in Path::new(relative).components() {
            depth += match component {
                Component::Normal(_) => 1,
                Component::ParentDir => -1,
                _ => 0,
            };
            if depth < 0 {
                return Err(expected(" outside of it"));
            }
        }
        let canonical = joined.canonicalize().map_err(|source| Error::Missing {
            path: from.to_owned(),
            place: place.to_owned(),
            wanted: relative.to_owned(),
            source,
        })?;
        if !canonical.starts_with(&self.root) {
            return Err(expected(" outside of it"));
        }
        Ok(joined)
    }

    /// Reads the file `relative`, named at `place` of the file `from`.
    pub(crate) fn read_beside(&mut self, from: &Path, place: &str, relative: &str) -> Result<Bytes, Error> {
        let path = self.resolve(from, place, relative)?;
        self.read_once(&path, path.clone())
    }

    fn read_once(&mut self, path: &Path, key: PathBuf) -> Result<Bytes, Error> {
        let io = |source| Error::Io { path: path.to_owned(), source };
        let key = key.canonicalize().map_err(io)?;
        if let Some(bytes) = self.files.get(&key) {
            return Ok(Arc::clone(bytes));
        }
        let metadata = std::fs::metadata(path).map_err(io)?;
        if !metadata.is_file() {
            return Err(Error::invalid(path, "file", "expected a file, found a folder or a device"));
        }
        let left = self.limits.file_bytes.saturating_sub(self.file_bytes);
        if metadata.len() > left {
            return Err(Error::TooLarge {
                path: path.to_owned(),
                place: "file".into(),
                what: "bytes",
                allowed: left,
                found: metadata.len(),
            });
        }
        let mut bytes = Vec::with_capacity(metadata.len() as usize);
        std::fs::File::open(path).map_err(io)?.take(left).read_to_end(&mut bytes).map_err(io)?;
        self.file_bytes += bytes.len() as u64;
        self.charged += bytes.len() as u64;
        let bytes = Arc::new(bytes);
        if !self.read.iter().any(|read| read == path) {
            self.read.push(path.to_owned());
        }
        self.files.insert(key, Arc::clone(&bytes));
        Ok(bytes)
    }

    /// Every file that was read, in that order.
    pub(crate) fn take_read(&mut self) -> Vec<PathBuf> {
        std::mem::take(&mut self.read)
    }

    /// Forgets file contents: what has been decoded is no longer needed.
    pub(crate) fn release(&mut self, bytes: Bytes) {
        self.files.retain(|_, kept| !Arc::ptr_eq(kept, &bytes));
    }

    /// Asks for `count` elements of `size` bytes before they are allocated.
    pub(crate) fn charge(
        &mut self,
        path: &Path,
        place: impl Display,
        count: usize,
        size: usize,
    ) -> Result<(), Error> {
        let bytes = (count as u64).saturating_mul(size as u64);
        let allowed = self
            .limits
            .memory_bytes
            .saturating_add(self.limits.memory_per_file_byte.saturating_mul(self.file_bytes));
        let found = self.charged.saturating_add(bytes);
        if found > allowed {
            return Err(Error::TooLarge {
                path: path.to_owned(),
                place: place.to_string(),
                what: "bytes of memory",
                allowed,
                found,
            });
        }
        self.charged = found;
        Ok(())
    }

    /// How many pixels images may still have.
    pub(crate) fn charge_pixels(
        &mut self,
        path: &Path,
        place: impl Display,
        width: u32,
        height: u32,
    ) -> Result<(), Error> {
        let found = self.pixels.saturating_add(u64::from(width) * u64::from(height));
        if found > self.limits.image_pixels {
            return Err(Error::TooLarge {
                path: path.to_owned(),
                place: place.to_string(),
                what: "pixels in all images together",
                allowed: self.limits.image_pixels,
                found,
            });
        }
        self.pixels = found;
        Ok(())
    }

    /// Says, once, that something is not drawn.
    pub(crate) fn warn(&mut self, warning: impl Into<String>) {
        let warning = warning.into();
        if self.warnings.len() < MOST_WARNINGS && !self.warnings.contains(&warning) {
            self.warnings.push(warning);
            if self.warnings.len() == MOST_WARNINGS {
                self.warnings.push("there is more that is not drawn".into());
            }
        }
    }

    /// Tells how far the load has come.
    pub(crate) fn progress(&mut self, stage: &'static str, done: usize, of: usize) {
        (self.progress)(Progress { stage, done, of });
    }

    /// What has been warned of so far.
    pub(crate) fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }
}
