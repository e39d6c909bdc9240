//! A recording played into odometry, frame by frame: which of its sensors take part, in which order their data come.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::{Camera, Rigid};
use vergence_time::Span;
use vergence_vision::{Gray, TrackerKnobs};

use crate::dataset::{Dataset, Depth, Picture};
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
        match (dataset.cameras.len() > 1, dataset.inertial.is_some()) {
            (true, true) => Self::StereoInertial,
            (true, false) => Self::Stereo,
            (false, true) => Self::MonoInertial,
            (false, false) if dataset.frames.iter().any(|frame| frame.depth.is_some()) => Self::Rgbd,
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
    tracking: Tracking,
    next_reading: usize,
    reduce: usize,
    reduced: Vec<Picture>,
}

/// Pictures are made smaller by at most this.
pub const MOST_REDUCED: usize = 8;

/// The mean of each square of `by` pixels; what is left over at the right and below is cut off.
fn reduce(picture: &Picture, by: usize, into: &mut Picture) {
    (into.width, into.height) = (picture.width / by, picture.height / by);
    into.pixels.clear();
    let area = (by * by) as u32;
    for row in 0..into.height {
        let rows = &picture.pixels[row * by * picture.width..(row + 1) * by * picture.width];
        into.pixels.extend((0..into.width).map(|column| {
            let square = rows.chunks_exact(picture.width).map(|line| &line[column * by..(column + 1) * by]);
            let sum: u32 = square.flatten().map(|pixel| u32::from(*pixel)).sum();
            ((sum + area / 2) / area) as u8
        }));
    }
}

impl<'a> Playback<'a> {
    /// From the first frame. The unit's noise is the recording's own; everything else is `params`.
    ///
    /// # Errors
    /// A mode that needs what the recording does not have; a knob outside of its range.
    pub fn new(dataset: &'a Dataset, mode: Mode, knobs: TrackerKnobs, params: Params) -> Result<Self, Error> {
        Self::reduced(dataset, mode, knobs, params, 1)
    }

    /// As [`Self::new`], with pictures that are made smaller first, by a whole number of 1 to [`MOST_REDUCED`] along each side. Knobs in
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
        let most = if mode == Mode::Rgbd { 1 } else { MOST_REDUCED };
        if !(1..=most).contains(&reduce) {
            let expected = if most == 1 { "1 with depth" } else { "1 to 8" };
            return Err(Error::Knob { name: "reduce", expected, found: reduce as f64 });
        }
        let lacks = |expected: &str, found: &str| Err(Error::file(&dataset.root, expected, found));
        if mode.inertial() && dataset.inertial.is_none() {
            return lacks("an inertial unit, for an inertial mode", "none");
        }
        if mode.stereo() && dataset.cameras.len() < 2 {
            return lacks("two cameras, for a stereo mode", "one");
        }
        if mode == Mode::Rgbd && dataset.frames.iter().all(|f| f.depth.is_none()) {
            return lacks("depth pictures, for the mode with depth", "none");
        }
        let rig: &[Camera] = if mode.stereo() { &dataset.cameras } else { &dataset.cameras[..1] };
        let smaller = |camera: &Camera| {
            let lens = camera.lens.scaled(1.0 / reduce as f64);
            let lens = lens.map_err(|source| Error::Lens { path: dataset.root.clone(), source })?;
            Ok(Camera { lens, size_px: camera.size_px.map(|side| side / reduce as u32), ..*camera })
        };
        let rig: Vec<Camera> = rig.iter().map(smaller).collect::<Result<_, Error>>()?;
        let unit = dataset.inertial.as_ref().map(|i| i.unit);
        let params = Params { inertial: unit.filter(|_| mode.inertial()), ..params };
        let tracking = Tracking::new(&rig, knobs, params)?;
        let reduced = vec![Picture::default(); if reduce > 1 { rig.len() } else { 0 }];
        Ok(Self { dataset, mode, tracking, next_reading: 0, reduce, reduced })
    }

    /// Frames of the recording.
    pub fn frames(&self) -> usize {
        self.dataset.frames.len()
    }

    /// The tracker and the estimator.
    pub fn tracking(&self) -> &Tracking {
        &self.tracking
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
        if let (true, Some(inertial)) = (self.mode.inertial(), &self.dataset.inertial) {
            // One reading past the frame closes the last span; of a live unit it comes within one period.
            let period = Span::from_secs_f64(1.0 / inertial.rate_hz.max(1.0)).unwrap_or(Span::ZERO);
            let until = time.saturating_add(period);
            while let Some((at, imu)) = inertial.samples.get(self.next_reading).filter(|s| s.0 <= until) {
                self.tracking.imu(*at, imu);
                self.next_reading += 1;
            }
        }
        for (picture, into) in loaded.pictures.iter().zip(&mut self.reduced) {
            reduce(picture, self.reduce, into);
        }
        let pictures = if self.reduce > 1 { &self.reduced } else { &loaded.pictures };
        let grays: Result<Vec<Gray>, _> =
            pictures.iter().map(|p| Gray::new(p.width, p.height, p.width, &p.pixels)).collect();
        Ok(self.tracking.frame(time, &grays?, loaded.depth.as_ref())?)
    }
}

/// A pose with the world's z axis up (as EuRoC and TUM write them) for one with y up: (x, y, z) becomes (x, −z, y).
pub fn z_up(world_from_body: &Rigid) -> Rigid {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    Rigid::from_parts(Vector3::zeros().into(), turn) * world_from_body
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reduced_pictures_are_means() {
        let picture = Picture { width: 5, height: 4, pixels: (0..20).collect() };
        let mut small = Picture::default();
        reduce(&picture, 2, &mut small);
        assert_eq!(small, Picture { width: 2, height: 2, pixels: vec![3, 5, 13, 15] });
        reduce(&picture, 1, &mut small);
        assert_eq!(small, picture);
    }
}
