//! The folder of a study's data: the study file, a log per sitting, a manifest with checksums.

use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use vergence_study::Study;

use crate::date::{date_of, wall_ns};
use crate::error::Error;
use crate::journal::{About, Journal, hash_of};
use crate::reading::{SessionLog, read};
use crate::record::Record;

pub(crate) const MANIFEST: &str = "manifest.json";
pub(crate) const STUDY_FILE: &str = "study.toml";
const LOCK: &str = ".lock";
const FORMAT: u32 = 1;
/// Larger files are not searched for the name of somebody who was deleted.
const SEARCHED_BYTES: u64 = 256 << 20;

/// How a sitting's log ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// It is being written, or nobody could say that it ended.
    Open,
    /// The participant has done everything.
    Finished,
    /// It ended before.
    Stopped,
    /// It ended without a word: killed, crashed, or out of power.
    CutOff,
}

/// One log of the folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sitting {
    /// Name of its file.
    pub file: String,
    /// Pseudonym.
    pub participant: String,
    /// 1, and one more each time that it went on.
    pub part: u32,
    /// How it ended.
    pub state: State,
    /// Why, where it was stopped.
    #[serde(default)]
    pub why: String,
    /// Trials in it.
    pub trials: u64,
    /// Of the file when it ended, `blake3:…`; empty while it is open.
    #[serde(default)]
    pub hash: String,
}

/// That somebody was deleted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Deleted {
    /// `2026-03-01`, UTC.
    pub on: String,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Manifest {
    pub(crate) format: u32,
    pub(crate) study: String,
    pub(crate) study_hash: String,
    pub(crate) sittings: Vec<Sitting>,
    #[serde(default)]
    pub(crate) deleted: Vec<Deleted>,
}

/// The folder of a study's data.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    study: Study,
    study_text: String,
    pub(crate) manifest: Manifest,
}

/// Headset and input.
type Device = (String, String);

/// Nobody else writes while it is there.
#[derive(Debug)]
pub(crate) struct Lock {
    _file: File,
}

impl Folder {
    /// Opens the folder of `study_file` at `path`, making it where there is none.
    ///
    /// # Errors
    /// Where the folder is of another study, or of this one before it was changed, or cannot be made.
    pub fn create(path: &Path, study_file: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(study_file).map_err(Error::io(study_file))?;
        let study = Study::parse(study_file, &text)?;
        if path.join(MANIFEST).exists() {
            let folder = Self::open(path)?;
            if folder.study_text != text {
                return Err(Error::Call(format!(
                    "expected in {} the data of {}, found those of another study, or of that file before it was changed: a \
                     study is not changed while it runs",
                    path.display(),
                    study_file.display()
                )));
            }
            return Ok(folder);
        }
        std::fs::create_dir_all(path).map_err(Error::io(path))?;
        let manifest = Manifest {
            format: FORMAT,
            study: study.name.clone(),
            study_hash: hash_of(text.as_bytes()),
            sittings: Vec::new(),
            deleted: Vec::new(),
        };
        replace(&path.join(STUDY_FILE), text.as_bytes())?;
        let folder = Self { path: path.to_owned(), study, study_text: text, manifest };
        folder.save()?;
        Ok(folder)
    }

    /// Opens a folder that is there.
    ///
    /// # Errors
    /// Where there is none, or its manifest or study file are damaged.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let manifest_path = path.join(MANIFEST);
        if !manifest_path.is_file() {
            return Err(Error::Call(format!(
                "expected the folder of a study, with a {MANIFEST}, found none in {}",
                path.display()
            )));
        }
        let text = std::fs::read_to_string(&manifest_path).map_err(Error::io(&manifest_path))?;
        let damaged = |expected: &str, found: String| Error::Damaged {
            path: manifest_path.clone(),
            expected: expected.to_owned(),
            found,
        };
        let manifest: Manifest =
            serde_json::from_str(&text).map_err(|error| damaged("a study's manifest", error.to_string()))?;
        if manifest.format > FORMAT {
            return Err(damaged(
                &format!("format {FORMAT} or earlier"),
                format!("format {}", manifest.format),
            ));
        }
        let plain = |name: &str| {
            !name.is_empty()
                && !name.starts_with('.')
                && Path::new(name).file_name().is_some_and(|own| own == name)
        };
        if let Some(sitting) = manifest.sittings.iter().find(|sitting| !plain(&sitting.file)) {
            return Err(damaged("names of files in this folder", format!("{:?}", sitting.file)));
        }
        let study_path = path.join(STUDY_FILE);
        let study_text = std::fs::read_to_string(&study_path).map_err(Error::io(&study_path))?;
        let study = Study::parse(&study_path, &study_text)?;
        Ok(Self { path: path.to_owned(), study, study_text, manifest })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The study.
    pub fn study(&self) -> &Study {
        &self.study
    }

    /// The study file's text.
    pub fn study_text(&self) -> &str {
        &self.study_text
    }

    /// The logs, in the order in which they were begun.
    pub fn sittings(&self) -> &[Sitting] {
        &self.manifest.sittings
    }

    /// Who was deleted: that somebody was.
    pub fn deleted(&self) -> &[Deleted] {
        &self.manifest.deleted
    }

    /// The log of a sitting, as far as it is whole.
    ///
    /// # Errors
    /// Where it cannot be read at all.
    pub fn log(&self, sitting: &Sitting) -> Result<SessionLog, Error> {
        read(&self.path.join(&sitting.file))
    }

    /// Whether somebody writes now.
    pub fn is_in_use(&self) -> bool {
        File::open(self.path.join(LOCK)).is_ok_and(|file| file.try_lock_shared().is_err())
    }

    pub(crate) fn lock(&self) -> Result<Lock, Error> {
        let path = self.path.join(LOCK);
        let file =
            File::options().create(true).truncate(false).write(true).open(&path).map_err(Error::io(&path))?;
        match file.try_lock() {
            Ok(()) => Ok(Lock { _file: file }),
            Err(std::fs::TryLockError::WouldBlock) => Err(Error::Call(format!(
                "{} is in use: another `study run` or `study delete` writes there",
                self.path.display()
            ))),
            Err(std::fs::TryLockError::Error(source)) => Err(Error::Io { path, source }),
        }
    }

    /// The trials that a participant has finished, in order, from all of their logs.
    ///
    /// # Errors
    /// Where a log cannot be read.
    pub fn finished_trials(&self, participant: &str) -> Result<Vec<Record>, Error> {
        Ok(self.done_so_far(participant)?.0)
    }

    /// These trials, and the headset and input of those that are there.
    fn done_so_far(&self, participant: &str) -> Result<(Vec<Record>, Option<Device>), Error> {
        let own = self.manifest.sittings.iter().filter(|sitting| sitting.participant == participant);
        let (mut records, mut device) = (Vec::new(), None);
        for sitting in own {
            let log = self.log(sitting)?;
            if !log.records.is_empty() {
                device = Some((log.about.headset, log.about.input));
            }
            records.extend(log.records);
        }
        Ok((records, device))
    }

    /// Closes logs that were left open, by a process that is gone. Call with the lock held.
    pub(crate) fn seal(&mut self) -> Result<(), Error> {
        let mut changed = false;
        for place in 0..self.manifest.sittings.len() {
            if self.manifest.sittings[place].state == State::Open {
                let sitting = self.manifest.sittings[place].clone();
                self.manifest.sittings[place] = self.closed(sitting, State::CutOff, String::new())?;
                changed = true;
            }
        }
        if changed { self.save() } else { Ok(()) }
    }

    fn closed(&self, sitting: Sitting, state: State, why: String) -> Result<Sitting, Error> {
        let path = self.path.join(&sitting.file);
        // A log of which not even the header was written holds no trial.
        let trials = read(&path).map_or(0, |log| log.records.len() as u64);
        let hash = std::fs::read(&path).map_or_else(|_| String::new(), |bytes| hash_of(&bytes));
        Ok(Sitting { state, why, trials, hash, ..sitting })
    }

    /// Begins a log for `about.participant`, who must not have one, or goes on (`resume`); fills in what the folder knows.
    /// With the trials that are finished.
    ///
    /// # Errors
    /// Where the pseudonym is none, somebody else writes, or the participant has finished trials (without `resume`), has not
    /// begun (with it), has done everything, or began on another headset or with another input.
    pub(crate) fn begin(
        &mut self,
        about: &mut About,
        resume: bool,
    ) -> Result<(Lock, Journal, Vec<Record>), Error> {
        let name = about.participant.clone();
        check_pseudonym(&name)?;
        let lock = self.lock()?;
        // Somebody else may have written since.
        self.manifest = Self::open(&self.path)?.manifest;
        self.seal()?;
        let (records, device) = self.done_so_far(&name)?;
        let own = self.manifest.sittings.iter().filter(|sitting| sitting.participant == name);
        let part = own.clone().map(|sitting| sitting.part).max().unwrap_or(0) + 1;
        let done = own.clone().any(|sitting| sitting.state == State::Finished);
        let (begun, here) = (part > 1, self.path.display());
        if done {
            return Err(Error::Call(format!(
                "{name} has done everything ({} trials in {here}): use another pseudonym, or `study delete` first",
                records.len()
            )));
        }
        if !records.is_empty() && !resume {
            return Err(Error::Call(format!(
                "{name} has begun and finished {} trials (in {here}): --resume goes on with the next one",
                records.len()
            )));
        }
        if !begun && resume {
            return Err(Error::Call(format!(
                "--resume: expected that {name} has begun, found no trial in {here}"
            )));
        }
        let own = (about.headset.clone(), about.input.clone());
        if let Some(device) = device.filter(|device| *device != own) {
            return Err(Error::Call(format!(
                "{name} has begun with --headset {} --input {}: expected the same for the rest, found --headset {} --input {} (what \
                 is compared within a person must be measured alike)",
                device.0, device.1, own.0, own.1
            )));
        }
        about.part = part;
        let mut course = crate::Course::new(&self.study, &name);
        // Where the logs do not fit together, whoever begins finds out.
        let _ = course.resume(&records);
        about.session = course.session();
        about.study = self.study.name.clone();
        about.study_file = self.study_text.clone();
        about.study_hash = self.manifest.study_hash.clone();
        let file = format!("{name}.{part}.mcap");
        self.manifest.sittings.push(Sitting {
            file: file.clone(),
            participant: name,
            part,
            state: State::Open,
            why: String::new(),
            trials: 0,
            hash: String::new(),
        });
        // First in the manifest: a log that nobody announced would be a stranger's.
        self.save()?;
        let journal = Journal::create(&self.path.join(&file), about)?;
        Ok((lock, journal, records))
    }

    /// Writes down how the log that was begun last has ended.
    pub(crate) fn end(&mut self, file: &str, state: State, why: &str) -> Result<(), Error> {
        let Some(place) = self.manifest.sittings.iter().position(|sitting| sitting.file == file) else {
            return Ok(());
        };
        let sitting = self.manifest.sittings[place].clone();
        self.manifest.sittings[place] = self.closed(sitting, state, why.to_owned())?;
        self.save()
    }

    /// Deletes a participant: logs, and every mention in the manifest. What is left is that somebody was deleted, and
    /// when. Says which other files of the folder still name them (reports and tables, to be made anew).
    ///
    /// # Errors
    /// Where nobody is called so, somebody writes, or a file cannot be removed.
    pub fn delete(&mut self, participant: &str) -> Result<Vec<PathBuf>, Error> {
        let _lock = self.lock()?;
        self.manifest = Self::open(&self.path)?.manifest;
        let (own, others): (Vec<Sitting>, Vec<Sitting>) = self
            .manifest
            .sittings
            .clone()
            .into_iter()
            .partition(|sitting| sitting.participant == participant);
        if own.is_empty() {
            return Err(Error::Call(format!(
                "expected a participant of {}, found nobody called {participant}",
                self.path.display()
            )));
        }
        for sitting in &own {
            let path = self.path.join(&sitting.file);
            match std::fs::remove_file(&path) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(Error::Io { path, source: error });
                }
                _ => {}
            }
        }
        self.manifest.sittings = others;
        self.manifest.deleted.push(Deleted { on: date_of(wall_ns()) });
        self.save()?;
        let mut naming = Vec::new();
        still_naming(&self.path, participant.as_bytes(), 0, &mut naming);
        Ok(naming)
    }

    fn save(&self) -> Result<(), Error> {
        let path = self.path.join(MANIFEST);
        let text = serde_json::to_string_pretty(&self.manifest)
            .map_err(|error| Error::Io { path: path.clone(), source: error.into() })?;
        replace(&path, format!("{text}\n").as_bytes())
    }
}

/// Pseudonyms are parts of file names.
fn check_pseudonym(name: &str) -> Result<(), Error> {
    let fine = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
    if name.is_empty() || name.len() > 40 || !name.chars().all(fine) || name.starts_with('-') {
        return Err(Error::Call(format!(
            "expected a pseudonym of 1 to 40 letters, digits, - and _, found {name:?}"
        )));
    }
    Ok(())
}

/// Replaces a file so that there is always a whole one, also after a power cut.
fn replace(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let new = path.with_extension("new");
    let write = || -> std::io::Result<()> {
        let mut file = File::create(&new)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&new, path)?;
        // The rename is safe when the folder is.
        match path.parent().map(File::open) {
            Some(Ok(folder)) => folder.sync_all(),
            _ => Ok(()),
        }
    };
    write().map_err(|source| {
        drop(std::fs::remove_file(&new));
        Error::Io { path: path.to_owned(), source }
    })
}

/// Files that hold these bytes, or have them in their names.
fn still_naming(folder: &Path, name: &[u8], depth: u32, found: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for path in entries.flatten().map(|entry| entry.path()) {
        let Ok(about) = path.symlink_metadata() else { continue };
        if about.is_dir() && depth < 4 {
            still_naming(&path, name, depth + 1, found);
        } else if about.is_file() {
            let own = path.file_name().is_some_and(|own| whole_word(own.as_encoded_bytes(), name));
            let inside = || {
                about.len() <= SEARCHED_BYTES
                    && std::fs::read(&path).is_ok_and(|bytes| whole_word(&bytes, name))
            };
            if own || inside() {
                found.push(path);
            }
        }
    }
    found.sort();
}

/// Whether `name` is in `bytes` and is not part of a longer word there.
fn whole_word(bytes: &[u8], name: &[u8]) -> bool {
    let letter =
        |byte: Option<&u8>| byte.is_some_and(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(byte));
    !name.is_empty()
        && bytes.windows(name.len()).enumerate().any(|(at, window)| {
            window == name
                && !letter(at.checked_sub(1).and_then(|at| bytes.get(at)))
                && !letter(bytes.get(at + name.len()))
        })
}
