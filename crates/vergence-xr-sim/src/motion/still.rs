use vergence_geom::Rigid;
use vergence_time::Timestamp;

use super::{Controller, Hand, PoseProvider, Tracked, held_in_front};

/// A head that stands still, looking along −z, and two controllers at rest in front of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Still {
    /// Height of the eyes above the floor, metres.
    pub eye_height_m: f64,
}

impl Default for Still {
    /// A standing adult: 1.6 m.
    fn default() -> Self {
        Self { eye_height_m: 1.6 }
    }
}

impl PoseProvider for Still {
    fn head(&self, _at: Timestamp) -> Tracked {
        Tracked::Seen(Rigid::translation(0.0, self.eye_height_m, 0.0))
    }

    fn controller(&self, hand: Hand, at: Timestamp) -> Controller {
        held_in_front(&self.head(at), hand)
    }
}
