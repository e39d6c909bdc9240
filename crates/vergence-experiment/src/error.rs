use std::path::{Path, PathBuf};

/// Why a study cannot go on, or its data cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// What was asked makes no sense here.
    #[error("{0}")]
    Call(String),
    /// A file of the study's folder cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file of the study's folder is not what it should be.
    #[error("{}: expected {expected}, found {found}", path.display())]
    Damaged {
        /// Which.
        path: PathBuf,
        /// What it should be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// The study file is wrong, or measures cannot be had.
    #[error(transparent)]
    Study(#[from] vergence_study::Error),
    /// The log cannot be written or read.
    #[error(transparent)]
    Log(#[from] vergence_log::Error),
    /// The headset, or what draws in it.
    #[error(transparent)]
    Session(Box<vergence_session::Error>),
    /// The window.
    #[error(transparent)]
    Window(#[from] vergence_window::Error),
    /// What draws in the window.
    #[error(transparent)]
    Gpu(#[from] vergence_gpu::Error),
    /// As above.
    #[error(transparent)]
    Render(Box<vergence_render::Error>),
    /// The simulated person.
    #[error(transparent)]
    Person(#[from] vergence_sim::Error),
    /// The metronome is not heard any more.
    #[error("the metronome's player, {player}, has ended: expected one that plays on")]
    Silent {
        /// Its name.
        player: String,
    },
    /// The simulated person does not get on.
    #[error(
        "the simulated person has ended no trial for {seconds:.0} s: expected one that finds its targets"
    )]
    Lost {
        /// Since when.
        seconds: f64,
    },
}

impl Error {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }

    /// Whether the call was wrong, rather than the work.
    pub fn is_wrong_call(&self) -> bool {
        match self {
            Self::Call(_) => true,
            Self::Session(error) => error.is_wrong_call(),
            _ => false,
        }
    }
}

impl From<vergence_render::Error> for Error {
    fn from(error: vergence_render::Error) -> Self {
        Self::Render(Box::new(error))
    }
}

impl From<vergence_session::Error> for Error {
    fn from(error: vergence_session::Error) -> Self {
        Self::Session(Box::new(error))
    }
}
