//! A recording played into odometry, frame by frame: which of its sensors take part, in which order their data come.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::Rigid;
use vergence_vision::TrackerKnobs;

use crate::dataset::{Dataset, Depth, Picture, Rig};
use crate::follower::Follower;
use crate::{Error, Estimate, Params, Tracking};

/// Which sensors take part. Whatever is left out is as if it were not there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// All cameras and the inertial unit.
    #[default]
    StereoInertial,
    /// All cameras.
    Stereo,
    /// The first camera and the inertial unit.
    MonoInertial,
    /// The first camera: the size of everything is a guess.
    Mono,
    /// The first camera and its depth.
    Rgbd,
}

impl std::fmt::Display for Mode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::StereoInertial => "stereo-inertial",
            Self::Stereo => "stereo",
            Self::MonoInertial => "mono-inertial",
            Self::Mono => "mono",
            Self::Rgbd => "rgbd",
        })
    }
}

impl Mode {
    /// The one in which most sensors of a recording take part.
    pub fn of(dataset: &Dataset) -> Self {
        let depth = dataset.frames.iter().any(|frame| frame.depth.is_some());
        match Self::of_rig(&dataset.rig()) {
            Self::Mono if depth => Self::Rgbd,
            mode => mode,
        }
    }

    /// The one in which most sensors of a rig take part.
    pub fn of_rig(rig: &Rig) -> Self {
        match (rig.cameras.len() > 1, rig.inertial.is_some()) {
            (true, true) => Self::StereoInertial,
            (true, false) => Self::Stereo,
            (false, true) => Self::MonoInertial,
            (false, false) => Self::Mono,
        }
    }

    /// Whether the inertial unit takes part.
    pub fn inertial(self) -> bool {
        matches!(self, Self::StereoInertial | Self::MonoInertial)
    }

    /// Whether all cameras take part, or the first one only.
    pub fn stereo(self) -> bool {
        matches!(self, Self::StereoInertial | Self::Stereo)
    }
}

/// Pictures of one frame, decoded.
#[derive(Clone, Debug, Default)]
pub struct Loaded {
    pictures: Vec<Picture>,
    depth: Option<Depth>,
}

/// A recording that is being played.
#[derive(Debug)]
pub struct Playback<'a> {
    dataset: &'a Dataset,
    mode: Mode,
    follower: Follower,
    next_reading: usize,
}

impl<'a> Playback<'a> {
    /// From the first frame. The unit's noise is the recording's own; everything else is `params`.
    ///
    /// # Errors
    /// A mode that needs what the recording does not have; a knob outside of its range.
    pub fn new(dataset: &'a Dataset, mode: Mode, knobs: TrackerKnobs, params: Params) -> Result<Self, Error> {
        Self::reduced(dataset, mode, knobs, params, 1)
    }

    /// As [`Self::new`], with pictures that are made smaller first, by a whole number of 1 to [`MOST_REDUCED`](crate::follower::MOST_REDUCED) along each side. Knobs in
    /// pixels are in those of the smaller pictures.
    ///
    /// # Errors
    /// As of [`Self::new`]; another number; with depth, where pictures are taken as they are: any but 1.
    pub fn reduced(
        dataset: &'a Dataset,
        mode: Mode,
        knobs: TrackerKnobs,
        params: Params,
        reduce: usize,
    ) -> Result<Self, Error> {
        if mode == Mode::Rgbd && dataset.frames.iter().all(|f| f.depth.is_none()) {
            return Err(Error::file(&dataset.root, "depth pictures, for the mode with depth", "none"));
        }
        let follower = Follower::new(&dataset.root, &dataset.rig(), mode, knobs, params, reduce)?;
        Ok(Self { dataset, mode, follower, next_reading: 0 })
    }

    /// Frames of the recording.
    pub fn frames(&self) -> usize {
        self.dataset.frames.len()
    }

    /// The tracker and the estimator.
    pub fn tracking(&self) -> &Tracking {
        self.follower.tracking()
    }

    /// Decodes the pictures of a frame that take part.
    ///
    /// # Errors
    /// A picture that cannot be decoded.
    ///
    /// # Panics
    /// Where there is no such frame.
    pub fn load(dataset: &Dataset, mode: Mode, frame: usize) -> Result<Loaded, Error> {
        let pictures =
            if mode.stereo() { dataset.pictures(frame)? } else { vec![dataset.picture(frame, 0)?] };
        let depth = if mode == Mode::Rgbd { dataset.depth(frame)? } else { None };
        Ok(Loaded { pictures, depth })
    }

    /// Follows a frame, with the readings up to it; frames in order.
    ///
    /// # Errors
    /// Pictures that are not those of the rig.
    pub fn follow(&mut self, frame: usize, loaded: &Loaded) -> Result<Estimate, Error> {
        let time = self.dataset.frames[frame].at;
        let readings = self.dataset.inertial.as_ref().filter(|_| self.mode.inertial());
        while let (false, Some(inertial)) = (self.follower.has_read(time), readings) {
            let Some((at, imu)) = inertial.samples.get(self.next_reading) else { break };
            self.follower.reading(*at, imu);
            self.next_reading += 1;
        }
        self.follower.frame(time, &loaded.pictures, loaded.depth.as_ref())
    }
}

/// A pose with the world's z axis up (as EuRoC and TUM write them) for one with y up: (x, y, z) becomes (x, −z, y).
pub fn z_up(world_from_body: &Rigid) -> Rigid {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    Rigid::from_parts(Vector3::zeros().into(), turn) * world_from_body
}
