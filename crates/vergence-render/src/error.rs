/// Why a scene cannot be drawn.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The device refused.
    #[error(transparent)]
    Gpu(#[from] vergence_gpu::Error),
    /// A knob or an argument is outside of its range.
    #[error("{what}: expected {expected}, found {found}")]
    Range {
        /// Which one.
        what: &'static str,
        /// What it may be.
        expected: String,
        /// What it was.
        found: String,
    },
    /// A scene whose indices do not refer to anything: importers never make one.
    #[error("scene: expected {what} below {len}, found {found}")]
    Index {
        /// Which table.
        what: &'static str,
        /// Its length.
        len: usize,
        /// The index.
        found: usize,
    },
    /// The parts of a frame were called out of order.
    #[error("frame: expected {expected}, found {found}")]
    Order {
        /// The call that should have come.
        expected: &'static str,
        /// The call that came.
        found: &'static str,
    },
}

impl Error {
    pub(crate) fn range(what: &'static str, expected: impl ToString, found: impl ToString) -> Self {
        Self::Range { what, expected: expected.to_string(), found: found.to_string() }
    }
}
