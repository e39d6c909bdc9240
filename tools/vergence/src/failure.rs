//! How a verb ends when it does not end well.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Why a verb did not do what was asked; becomes the exit status.
#[derive(Debug)]
pub enum Failure {
    /// The work failed: exit status 1.
    Work(String),
    /// The call was wrong, or asks for what this machine cannot give: exit status 2. The call is what the command line
    /// and the settings that it names say (options, environment, files of quality, profile, motion), and whether the
    /// files are there; what is in a scene or a recording is not.
    Call(String),
}

impl Failure {
    /// The work failed for the reason `error`, with all its causes.
    pub fn work(error: &dyn std::error::Error) -> Self {
        Self::Work(with_causes(error))
    }

    /// The call was wrong for the reason `error`, with all its causes.
    pub fn call(error: &dyn std::error::Error) -> Self {
        Self::Call(with_causes(error))
    }

    /// From the graphics device: whether it lacks what was asked for, or failed.
    pub fn gpu(error: &vergence_gpu::Error) -> Self {
        match error {
            vergence_gpu::Error::NoSuchDevice { .. } | vergence_gpu::Error::Unsupported { .. } => {
                Self::call(error)
            }
            _ => Self::work(error),
        }
    }

    /// Refuses to write what is read: `option` is what the user calls the output.
    pub fn unless_own(option: &str, output: &Path, read: &[PathBuf]) -> Result<(), Self> {
        vergence_session::own_file(option, output, read).map_err(|error| Self::call(&error))
    }

    /// Refuses to write over a file that has something in it, unless that was asked for.
    pub fn unless_kept(output: &Path, overwrite: bool) -> Result<(), Self> {
        match std::fs::metadata(output) {
            Ok(there) if there.is_file() && there.len() > 0 && !overwrite => Err(Self::Call(format!(
                "{}: expected no such file yet, found one of {} bytes; --overwrite replaces it",
                output.display(),
                there.len()
            ))),
            _ => Ok(()),
        }
    }

    /// Makes the folder for results where it is missing: before the work, that is not lost over one that cannot be made.
    pub fn unless_folder(path: &Path) -> Result<(), Self> {
        if path.exists() && !path.is_dir() {
            return Err(Self::Call(format!("{}: expected a folder, found a file", path.display())));
        }
        std::fs::create_dir_all(path)
            .map_err(|error| Self::Work(format!("{}: cannot be made: {error}", path.display())))
    }

    /// What should be at `path` cannot be written there.
    pub fn unwritable(path: &Path, error: &dyn std::error::Error) -> Self {
        Self::Work(format!("{}: {error}", path.display()))
    }

    /// Says it on stderr and gives the exit status.
    pub fn report(&self) -> ExitCode {
        let (Self::Work(sentence) | Self::Call(sentence)) = self;
        eprintln!("vergence: {sentence}");
        match self {
            Self::Work(_) => ExitCode::from(1),
            Self::Call(_) => ExitCode::from(2),
        }
    }
}

fn with_causes(error: &dyn std::error::Error) -> String {
    let mut sentence = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        let inner_sentence = inner.to_string();
        if !sentence.contains(&inner_sentence) {
            sentence.push_str(": ");
            sentence.push_str(&inner_sentence);
        }
        cause = inner.source();
    }
    sentence
}
