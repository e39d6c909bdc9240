//! The file of a recording: claimed for one writer, safe in its folder, ended early where it cannot be written on.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

use crate::header::FAILED;
use crate::records::{MAGIC, op, put_metadata, put_record};

/// Opens a file to be written from its beginning, once nobody else records to it. With `durable`, a power cut does not take its
/// name.
pub(crate) fn claim(path: &Path, durable: bool) -> std::io::Result<File> {
    // Not cut off before it is known to be ours alone.
    let file = File::options().write(true).create(true).truncate(false).open(path)?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            let found = "expected a file that nobody writes, found one that another recording is writing";
            return Err(std::io::Error::new(std::io::ErrorKind::ResourceBusy, found));
        }
        // Some file systems have no locks.
        Err(TryLockError::Error(error)) => log::info!("{}: cannot be locked: {error}", path.display()),
    }
    if file.metadata()?.is_file() {
        file.set_len(0)?;
        if durable {
            sync_folder_of(path);
        }
    }
    Ok(file)
}

/// Asks the disk to have the folder that names this file, so that a power cut does not take a new or a changed name. A folder that
/// cannot be synced (some file systems have none that can) is said and is no failure.
pub fn sync_folder_of(path: &Path) {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    #[cfg(test)]
    tests::SYNCED.with_borrow_mut(|synced| synced.push(folder.to_owned()));
    // Elsewhere a folder cannot be opened, and a name is kept with the file.
    if cfg!(unix)
        && let Err(error) = File::open(folder).and_then(|folder| folder.sync_all())
    {
        log::warn!("{}: a power cut may take the name of a new file: {error}", folder.display());
    }
}

/// Cuts the file off at `good` and writes the shortest ending that MCAP allows (no summary, no checksums), in front of it why,
/// where there is room.
pub(crate) fn close_at(file: &mut File, good: u64, why: &str) -> std::io::Result<()> {
    let mut ending = Vec::with_capacity(64);
    put_record(op::DATA_END, &[0; 4], &mut ending);
    put_record(op::FOOTER, &[0; 20], &mut ending);
    ending.extend_from_slice(MAGIC);
    let mut with_reason = Vec::with_capacity(256);
    let note =
        BTreeMap::from([("reason".to_owned(), why.to_owned()), ("good_bytes".to_owned(), good.to_string())]);
    put_metadata(FAILED, &note, &mut with_reason);
    with_reason.extend_from_slice(&ending);
    let mut write = |bytes: &[u8]| {
        file.set_len(good)?;
        file.seek(SeekFrom::Start(good))?;
        file.write_all(bytes)
    };
    if write(&with_reason).is_err()
        && let Err(error) = write(&ending)
    {
        file.set_len(good)?;
        return Err(error);
    }
    file.sync_data()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

    use std::cell::RefCell;
    use std::path::PathBuf;

    use crate::{Header, Limits, Options, Recorder, repair};

    thread_local! {
        /// Folders that this thread had synced.
        pub(super) static SYNCED: RefCell<Vec<PathBuf>> = const { RefCell::new(Vec::new()) };
    }

    #[test]
    fn the_folder_of_a_new_file_is_synced() {
        let dir = tempfile::TempDir::new().unwrap();
        let path = dir.path().join("a.mcap");
        let record = |durable: bool| {
            let options = Options { durable, ..Options::default() };
            Recorder::create(&path, &Header::default(), &options).unwrap().finish().unwrap();
            SYNCED.take()
        };
        assert_eq!(record(false), Vec::<PathBuf>::new());
        assert_eq!(record(true), [dir.path()]);
        repair(&path, &dir.path().join("b.mcap"), Limits::default(), &mut |_, _| {}).unwrap();
        assert_eq!(SYNCED.take(), [dir.path()], "the new name of a rewritten log");
        super::sync_folder_of("b.mcap".as_ref());
        assert_eq!(SYNCED.take(), [PathBuf::from(".")]);
    }
}
