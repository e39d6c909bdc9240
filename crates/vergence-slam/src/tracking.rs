//! Pictures and inertial readings in, poses out: the tracker and the estimator joined.

use std::hash::{DefaultHasher, Hasher};

use nalgebra::{UnitQuaternion, Vector2};
use vergence_geom::Camera;
use vergence_sense::Imu;
use vergence_time::Timestamp;
use vergence_vision::{Gray, Prediction, TrackId, Tracker, TrackerKnobs};

use crate::Error;
use crate::dataset::Depth;
use crate::mounting::{Misfit, Mounting};
use crate::odometry::{Estimate, Odometry};
use crate::params::Params;
use crate::sighting::Sighting;

/// The depth at a pixel, m, if its neighbours agree that it lies on one surface (within 3 %).
fn depth_at(depth: &Depth, pixel: &Vector2<f64>) -> Option<f64> {
    let (x, y) = (pixel.x.round(), pixel.y.round());
    if !(x >= 1.0 && y >= 1.0 && x + 1.0 < depth.width as f64 && y + 1.0 < depth.height as f64) {
        return None;
    }
    let (x, y) = (x as usize, y as usize);
    let read =
        |column: usize, row: usize| depth.metres.get(row * depth.width + column).copied().unwrap_or(0.0);
    let centre = read(x, y);
    let (mut low, mut high) = (centre, centre);
    for row in y - 1..=y + 1 {
        for column in x - 1..=x + 1 {
            let value = read(column, row);
            (low, high) = (low.min(value), high.max(value));
        }
    }
    (low > 0.0 && high.is_finite() && high - low < 0.03 * centre).then(|| f64::from(centre))
}

/// A rig that is followed.
#[derive(Debug)]
pub struct Tracking {
    rig: Vec<Camera>,
    tracker: Tracker,
    odometry: Odometry,
    mounting: Option<Mounting>,
    misfit: Option<Misfit>,
    /// Of the pictures of the frame before.
    sum: Option<u64>,
    expected: Vec<(u64, usize, nalgebra::Vector3<f64>)>,
    pixels: Vec<(TrackId, usize, Vector2<f64>)>,
    sightings: Vec<Sighting>,
    refused: Vec<TrackId>,
}

impl Tracking {
    /// For the cameras of `rig`, whose body is the inertial unit's frame.
    ///
    /// # Errors
    /// A knob of the tracker outside of its range; no camera or too many.
    pub fn new(rig: &[Camera], knobs: TrackerKnobs, params: Params) -> Result<Self, Error> {
        let params = params.checked()?;
        Ok(Self {
            rig: rig.to_vec(),
            tracker: Tracker::new(rig, knobs)?,
            odometry: Odometry::new(params, rig.iter().map(|c| c.body_from_camera).collect()),
            mounting: params.check_mounting.then(|| Mounting::new(rig, params.inertial.is_some())),
            misfit: None,
            sum: None,
            expected: Vec::new(),
            pixels: Vec::new(),
            sightings: Vec::new(),
            refused: Vec::new(),
        })
    }

    /// The estimator.
    pub fn odometry(&self) -> &Odometry {
        &self.odometry
    }

    /// A camera that sits otherwise than the rig says: known within the first seconds of motion, if at all.
    pub fn misfit(&self) -> Option<Misfit> {
        self.misfit
    }

    /// One inertial reading, in the body's frame; `false`, and it is left out, where it is not finite or not later than
    /// the one before.
    pub fn imu(&mut self, time: Timestamp, imu: &Imu) -> bool {
        let taken = self.odometry.imu(time, imu);
        if let (true, Some(mounting)) = (taken, &mut self.mounting) {
            mounting.imu(time, imu);
        }
        taken
    }

    /// Whether these are the pictures of the frame before, by every eighth row; remembers them.
    fn is_same(&mut self, pictures: &[Gray]) -> bool {
        let mut hasher = DefaultHasher::new();
        for picture in pictures {
            (0..picture.height()).step_by(8).for_each(|row| hasher.write(picture.row(row)));
        }
        let sum = hasher.finish();
        self.sum.replace(sum) == Some(sum)
    }

    /// One picture of each camera, and the first camera's depth where there is one. Readings up to `time` have been given.
    ///
    /// # Errors
    /// Pictures that are not those of the rig.
    pub fn frame(
        &mut self,
        time: Timestamp,
        pictures: &[Gray],
        depth: Option<&Depth>,
    ) -> Result<Estimate, vergence_vision::Error> {
        // A camera that is stuck shows the same again and again, to the last bit, while the unit feels motion: no pictures.
        let stuck = self.is_same(pictures) && self.odometry.is_quiet(time) == Some(false);
        if stuck {
            return Ok(self.odometry.frame(time, &[]));
        }
        let mut now_from_before = UnitQuaternion::identity();
        self.pixels.clear();
        if let (Some(predicted), Some(last)) = (self.odometry.predict(time), self.odometry.last_pose()) {
            now_from_before = predicted.rotation.inverse() * last.rotation;
            self.odometry.expected(&predicted, &mut self.expected);
            self.pixels.extend(self.expected.iter().filter_map(|(track, camera, direction)| {
                Some((TrackId(*track), *camera, self.rig[*camera].lens.project(direction)?))
            }));
        }
        let prediction = Prediction { now_from_before, pixels: &self.pixels };
        let frame = self.tracker.track(pictures, &prediction)?;
        self.misfit = self.mounting.as_mut().and_then(|mounting| mounting.frame(time, pictures, frame));
        self.sightings.clear();
        for (index, (camera, list)) in self.rig.iter().zip(&frame.cameras).enumerate() {
            for seen in list {
                let sighting = Sighting::new(seen.track.0, index as u8, &seen.pixel, &camera.lens);
                self.sightings.extend(sighting.map(|s| Sighting {
                    depth_m: depth.filter(|_| index == 0).and_then(|d| depth_at(d, &seen.pixel)),
                    ..s
                }));
            }
        }
        let estimate = self.odometry.frame(time, &self.sightings);
        self.refused.clear();
        self.refused.extend(self.odometry.refused().iter().map(|track| TrackId(*track)));
        self.tracker.forget(&self.refused);
        Ok(estimate)
    }
}
