//! What is said of each pose.

/// How far a pose can be trusted, and what it waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// No frame yet.
    Waiting,
    /// Poses are provisional: gravity's direction and the velocity are not known well yet.
    FindingGravity,
    /// Poses are provisional: the camera has not moved far enough to see how far anything is.
    FindingDepth,
    /// Poses are provisional: next to nothing is seen in the pictures.
    FindingCorners,
    /// What is seen does not fit together: lens, mounting or times are not what they are said to be.
    Disagreeing,
    /// Within three of its own standard deviations.
    Tracked,
    /// Too few points are seen: the inertial unit alone carries it.
    Coasting,
    /// Nothing holds it: the pose is the last one, or one that has been carried too long.
    Lost,
}

impl State {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Waiting,
        Self::FindingGravity,
        Self::FindingDepth,
        Self::FindingCorners,
        Self::Disagreeing,
        Self::Tracked,
        Self::Coasting,
        Self::Lost,
    ];

    /// In one word, as tables have it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::FindingGravity => "finding-gravity",
            Self::FindingDepth => "finding-depth",
            Self::FindingCorners => "finding-corners",
            Self::Disagreeing => "disagreeing",
            Self::Tracked => "tracked",
            Self::Coasting => "coasting",
            Self::Lost => "lost",
        }
    }

    /// That of a word.
    pub fn of_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.word() == word)
    }

    /// In words: what it is, and what it waits for.
    pub fn says(self) -> &'static str {
        match self {
            Self::Waiting => "waiting for the first frame",
            Self::FindingGravity => {
                "provisional: gravity and velocity are being found; standing still or moving for a second helps"
            }
            Self::FindingDepth => "provisional: distances are not known yet; moving sideways helps",
            Self::FindingCorners => {
                "provisional: next to nothing is seen in the pictures; are they dark, blurred, or few bits of sixteen?"
            }
            Self::Disagreeing => {
                "not to be trusted: what is seen does not fit together; are intrinsics, distortion, T_BS and times right?"
            }
            Self::Tracked => "tracked",
            Self::Coasting => "carried by the inertial unit: too few points are seen",
            Self::Lost => "lost: nothing is seen that holds the pose",
        }
    }
}
