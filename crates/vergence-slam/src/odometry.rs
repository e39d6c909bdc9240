//! Odometry: inertial readings and sightings in, a pose for every frame out.

use std::collections::{HashMap, VecDeque};

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::Rigid;
use vergence_inertial::preintegrate::Biases;
use vergence_sense::Imu;
use vergence_solve::{Normal, Options, minimise};
use vergence_time::{Span, Timestamp};

use crate::link::{Held, Link, Motion};
use crate::one_camera::WAITING_STEPS;
use crate::params::Params;
use crate::shrink::{Leaving, Shrink};
use crate::sighting::{Sighting, Way};
use crate::state::State;
use crate::stillness::Stillness;
use crate::window::{Anchor, Frame, Observation, Point, Window};

/// One frame's answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Of the frame.
    pub time: Timestamp,
    /// World: gravity-aligned (y up), its origin where the first frame was.
    pub world_from_body: Rigid,
    /// In the world, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Of the inertial unit; zero without one.
    pub biases: Biases,
    /// How far to trust it.
    pub state: State,
    /// Standard deviation of the position since the start (root of the trace), m.
    pub position_sigma_m: f64,
    /// Of the rotation since the start, rad.
    pub rotation_sigma_rad: f64,
    /// It became a keyframe.
    pub keyframe: bool,
    /// Which map it is in, from 0: after [`State::Lost`] another one begins, whose place in those before is a guess.
    pub map: u32,
    /// Points of the map that it sees.
    pub known: usize,
    /// Points of the map that were thrown away after this frame.
    pub outliers: usize,
    /// Root mean square of what is left between where points are seen and where they should be, over the window, pixels. Far above
    /// [`Params::pixel_px`], the lens or the unit is not what it is said to be.
    pub residual_px: f64,
}

/// Sliding-window odometry; see the crate's page. Feed readings and frames in the order of time.
#[derive(Debug)]
pub struct Odometry {
    pub(crate) window: Window,
    readings: VecDeque<(Timestamp, Imu)>,
    /// The shortest from one reading to the next, ns; 0 before there are two.
    period_ns: i64,
    pub(crate) known: HashMap<u64, usize>,
    refused: HashMap<u64, u64>,
    just_refused: Vec<u64>,
    normal: Normal,
    /// Working memory.
    residuals: Vec<Option<f64>>,
    shrink: Shrink,
    stillness: Stillness,
    next_id: u64,
    pub(crate) settled: bool,
    /// One camera and an inertial unit: there is a guess of velocity and gravity.
    pub(crate) flying: bool,
    keyframe_at: Option<Timestamp>,
    /// When velocity and gravity were last tried for, with one camera and an inertial unit.
    pub(crate) tried_at: Option<Timestamp>,
    /// The last frame that saw enough, where the latest did not.
    unseen_since: Option<Timestamp>,
    /// The first of the latest frames of which most points were thrown away.
    adrift_since: Option<Timestamp>,
    /// Residual over the latest half second, pixels, and the frame before.
    misfit_px: f64,
    last: Option<Estimate>,
    map: u32,
    biases: Biases,
}

/// Fewer points than this hold no pose.
pub(crate) const FEWEST: usize = 6;
/// Time for which the inertial unit alone carries it until it is lost, s.
const LONGEST_UNSEEN_S: f64 = 2.0;
/// Readings farther apart than this, and than so many of the shortest periods, say nothing of what was between them: ns, periods.
const LONGEST_GAP: (i64, i64) = (25_000_000, 4);
/// Gravity is known when its direction is known this well, rad.
const GRAVITY_RAD: f64 = 0.03;

/// After this time, in frames of which most points had to be thrown away each, what is estimated is not what is seen, s: three frames of 20 Hz
/// in a row.
const ADRIFT_S: f64 = 0.09;
/// What is left of sightings settles over this, s. Beyond so many deviations of a corner (with and without inertial unit) it is no noise: right
/// calibrations leave 0.1 to 0.7 of one, 1.8 without a unit behind a lens that nobody has calibrated; a focal length that is a tenth off 1.4, distortion that
/// is left out 2.3.
const MISFIT_S: f64 = 0.5;
const MISFIT: (f64, f64) = (1.25, 2.5);
/// Points that say so little of the velocity (standard deviation, m/s) hold no position: they are too far away.
const UNKNOWN_M_S: f64 = 0.3;

/// From one instant to a later one, s; without end where that does not fit.
pub(crate) fn seconds(from: Timestamp, to: Timestamp) -> f64 {
    to.since(from).map_or(f64::INFINITY, Span::as_secs_f64)
}

impl Odometry {
    /// For a rig whose cameras sit so on the body (the inertial unit's frame; cameras x right, y down, z forward).
    pub fn new(params: Params, body_from_cameras: Vec<Rigid>) -> Self {
        let mut window = Window::default();
        (window.cameras, window.params) = (body_from_cameras, params);
        Self {
            window,
            readings: VecDeque::new(),
            period_ns: 0,
            known: HashMap::new(),
            refused: HashMap::new(),
            just_refused: Vec::new(),
            normal: Normal::default(),
            residuals: Vec::new(),
            shrink: Shrink::default(),
            stillness: Stillness::default(),
            next_id: 0,
            settled: false,
            flying: false,
            keyframe_at: None,
            tried_at: None,
            unseen_since: None,
            adrift_since: None,
            misfit_px: 0.0,
            last: None,
            map: 0,
            biases: Biases::default(),
        }
    }

    /// The last answer.
    pub fn last(&self) -> Option<&Estimate> {
        self.last.as_ref()
    }

    /// One inertial reading, in the body's frame. What is out of order or not finite is left out: `false`.
    pub fn imu(&mut self, time: Timestamp, imu: &Imu) -> bool {
        let finite = imu.gyr_rad_s.iter().chain(imu.acc_m_s2.iter()).all(|x| x.is_finite());
        let after = self.readings.back().is_none_or(|(last, _)| *last < time);
        if finite && after && self.window.params.inertial.is_some() {
            if let Some(step) = self.readings.back().and_then(|(last, _)| time.since(*last)) {
                let step = step.as_nanos();
                self.period_ns = if self.period_ns == 0 { step } else { step.min(self.period_ns) };
            }
            self.readings.push_back((time, *imu));
            // Without frames, the last ten seconds are enough.
            let old = |first: &(Timestamp, Imu)| time.since(first.0).is_some_and(|s| s.as_secs_f64() > 10.0);
            while self.readings.front().is_some_and(old) {
                self.readings.pop_front();
            }
        }
        finite && after
    }

    /// Whether the readings since the latest frame, up to `time`, say that nothing moves; `None` without readings.
    pub(crate) fn is_quiet(&self, time: Timestamp) -> Option<bool> {
        let last = self.window.frames.last()?;
        let (_, _, link) = self.predicted(last, time);
        let quiet = |link: Link| link.is_quiet(&last.motion_now().biases, self.window.params.gravity_m_s2);
        link.map(quiet)
    }

    /// Where the body will be at `time` by the readings so far: for the tracker, and for poses between frames.
    pub fn predict(&self, time: Timestamp) -> Option<Rigid> {
        let last = self.window.frames.last()?;
        Some(self.predicted(last, time).0)
    }

    /// Where the latest frame of the window is.
    pub fn last_pose(&self) -> Option<Rigid> {
        self.window.frames.last().map(|f| f.pose)
    }

    /// Where the points that the latest frame saw are expected at `world_from_body`: track, camera, and the direction in that camera
    /// (its length means nothing), in order of track and camera.
    pub fn expected(&self, world_from_body: &Rigid, into: &mut Vec<(u64, usize, Vector3<f64>)>) {
        into.clear();
        let Some(last) = self.window.frames.len().checked_sub(1) else { return };
        for point in self.window.points.iter().filter(|p| p.seen.last().is_some_and(|o| o.slot == last)) {
            let host = &self.window.frames[point.host_slot].pose;
            let relative = world_from_body.inv_mul(host);
            let from = &self.window.cameras[usize::from(point.camera)];
            for (index, camera) in self.window.cameras.iter().enumerate() {
                let carried =
                    Way::new(&relative, from, camera).carry(&point.direction, point.inverse_distance);
                into.push((point.track, index, carried));
            }
        }
        into.sort_unstable_by_key(|e| (e.0, e.1));
    }

    /// Tracks whose points were thrown away after the last frame, in order.
    pub fn refused(&self) -> &[u64] {
        &self.just_refused
    }

    fn predicted(&self, last: &Frame, time: Timestamp) -> (Rigid, Option<Motion>, Option<Link>) {
        let Some((motion, inertial)) = last.motion.zip(self.window.params.inertial) else {
            return (self.glide(last, time), None, None);
        };
        let held = self.held(last.time, time);
        match Link::new(held, motion.biases, &self.window.params, &inertial) {
            Some(link) => {
                let (pose, motion) = link.follow(&last.pose, &motion);
                (pose, Some(motion), Some(link))
            }
            None => (self.glide(last, time), Some(motion), None),
        }
    }

    /// Without an inertial unit: on as between the two frames before.
    fn glide(&self, last: &Frame, time: Timestamp) -> Rigid {
        let frames = &self.window.frames;
        let Some(before) = frames.len().checked_sub(2).and_then(|i| frames.get(i)) else { return last.pose };
        let span = last.time.since(before.time).map_or(0.0, Span::as_secs_f64);
        let ahead = time.since(last.time).map_or(0.0, Span::as_secs_f64);
        // Across a gap of the window nothing is known of the speed.
        if !(span > 0.0 && span < 0.5 && ahead > 0.0 && ahead < 0.5) {
            return last.pose;
        }
        vergence_geom::interpolate(&before.pose, &last.pose, 1.0 + (ahead / span).min(2.0))
    }

    /// Readings that hold between two instants: the mean of each pair of neighbours, cut at both ends.
    fn held(&self, from: Timestamp, to: Timestamp) -> Vec<Held> {
        let nanos = |t: Timestamp| t.as_nanos();
        let range = self.window.params.inertial.map_or(f64::INFINITY, |i| 0.99 * i.gyr_range_rad_s);
        let beyond = |r: &(Timestamp, Imu)| r.1.gyr_rad_s.amax() >= range;
        // What lies between two readings that are so far apart nobody knows.
        let longest = LONGEST_GAP.0.max(self.period_ns.saturating_mul(LONGEST_GAP.1));
        let at = |a: &(Timestamp, Imu), b: &(Timestamp, Imu), t: i64| {
            let share = (t - nanos(a.0)) as f64 / (nanos(b.0) - nanos(a.0)) as f64;
            (a.1.gyr_rad_s.lerp(&b.1.gyr_rad_s, share), a.1.acc_m_s2.lerp(&b.1.acc_m_s2, share))
        };
        let mut out = Vec::new();
        let (from, to) = (nanos(from), nanos(to));
        let first = self.readings.partition_point(|r| nanos(r.0) <= from).saturating_sub(1);
        let mut end = from;
        for k in first..self.readings.len().saturating_sub(1) {
            let (a, b) = (&self.readings[k], &self.readings[k + 1]);
            let (begin, stop) = (nanos(a.0).max(from), nanos(b.0).min(to));
            if stop <= begin {
                if nanos(a.0) >= to {
                    break;
                }
                continue;
            }
            if out.is_empty() && begin > end {
                // Nothing was read before: the first reading is held backwards.
                out.push(Held {
                    gyr_rad_s: a.1.gyr_rad_s,
                    acc_m_s2: a.1.acc_m_s2,
                    span: Span::from_nanos(begin - end),
                    saturated: beyond(a),
                    missing: begin - end > longest,
                });
            }
            let ((ga, aa), (gb, ab)) = (at(a, b, begin), at(a, b, stop));
            out.push(Held {
                gyr_rad_s: (ga + gb) * 0.5,
                acc_m_s2: (aa + ab) * 0.5,
                span: Span::from_nanos(stop - begin),
                saturated: beyond(a) || beyond(b),
                missing: nanos(b.0) - nanos(a.0) > longest,
            });
            end = stop;
        }
        if let (true, Some(last)) = (end < to, self.readings.back()) {
            let late = to - end.max(from);
            if !out.is_empty() || late < 100_000_000 {
                out.push(Held {
                    gyr_rad_s: last.1.gyr_rad_s,
                    acc_m_s2: last.1.acc_m_s2,
                    span: Span::from_nanos(late),
                    saturated: beyond(last),
                    missing: late > longest,
                });
            }
        }
        out
    }

    /// The first frame: level by the mean of what the accelerometer has felt.
    fn begin(&mut self, time: Timestamp) -> Frame {
        let inertial = self.window.params.inertial.is_some();
        let near: Vec<&Imu> = self
            .readings
            .iter()
            .filter(|r| r.0.since(time).or(time.since(r.0)).is_none_or(|s| s.as_secs_f64().abs() < 0.5))
            .map(|r| &r.1)
            .collect();
        let count = near.len().max(1) as f64;
        let mean = near.iter().map(|i| i.acc_m_s2).sum::<Vector3<f64>>() / count;
        let turning = near.iter().map(|i| i.gyr_rad_s).sum::<Vector3<f64>>() / count;
        let spread = (near.iter().map(|i| (i.acc_m_s2 - mean).norm_squared()).sum::<f64>() / count).sqrt();
        let standing = near.len() >= 10
            && spread < 0.6
            && turning.norm() < 0.15
            && (mean.norm() - self.window.params.gravity_m_s2).abs() < 0.6;
        let level = match UnitQuaternion::rotation_between(&mean, &Vector3::y()) {
            Some(level) if inertial => level,
            None if inertial => UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
            // Without an inertial unit the first camera is taken to be level.
            _ => self.window.cameras.first().map_or(UnitQuaternion::identity(), |camera| {
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
                    * camera.rotation.inverse()
            }),
        };
        let pose = Rigid::from_parts(Vector3::zeros().into(), level);
        let biases =
            Biases { gyr_rad_s: if standing { turning } else { Vector3::zeros() }, ..Biases::default() };
        let motion = inertial.then_some(Motion { velocity_m_s: Vector3::zeros(), biases });
        self.window.anchor = Some(Anchor {
            frame: self.next_id,
            pose,
            motion: motion.unwrap_or_default(),
            yaw_rad: 1e-4,
            tilt_rad: if !inertial {
                1e-4
            } else if standing {
                0.03
            } else {
                0.3
            },
            position_m: 1e-4,
            velocity_m_s: if standing { 0.1 } else { 3.0 },
            gyr_rad_s: if standing { 0.02 } else { 0.1 },
            acc_m_s2: 0.15,
        });
        Frame::new(self.next_id, time, pose, motion)
    }

    /// One frame: where the tracked corners of all its pictures are seen. Always answers; the answer says how far it can be trusted.
    pub fn frame(&mut self, time: Timestamp, sightings: &[Sighting]) -> Estimate {
        let ascending = self.window.frames.last().is_none_or(|f| f.time < time);
        if let (false, Some(last)) = (ascending, self.last) {
            // Twice the same instant, or an earlier one: nothing that it says can be placed.
            return last;
        }
        let mut frame = match self.window.frames.last() {
            None => self.begin(time),
            Some(last) => {
                let (pose, motion, link) = self.predicted(last, time);
                let mut frame = Frame::new(self.next_id, time, pose, motion);
                frame.link = link;
                if frame.link.is_none() {
                    frame.guess = Some(pose);
                }
                frame
            }
        };
        self.next_id += 1;
        let cameras = self.window.cameras.len();
        frame.seen.extend(sightings.iter().filter(|s| {
            usize::from(s.camera) < cameras
                && s.direction.iter().all(|x| x.is_finite())
                && s.direction.norm() > 0.5
        }));
        frame.seen.sort_by_key(|s| (s.track, s.camera));
        frame.seen.dedup_by_key(|s| (s.track, s.camera));
        frame.still = self.stands_still(&frame);
        let id = frame.id;
        let (mut known, mut tracks, mut last_track) = (0, 0, None);
        for sighting in &frame.seen {
            let point = self.known.get(&sighting.track);
            if let Some(&point) = point {
                self.window.points[point].seen.push(Observation { frame: id, slot: 0, sighting: *sighting });
            }
            if last_track != Some(sighting.track) {
                last_track = Some(sighting.track);
                tracks += 1;
                known += usize::from(point.is_some());
            }
        }
        // What saw something last must not leave the window before something is seen again: it holds everything that comes.
        let goes_blind = known < FEWEST && self.unseen_since.is_none() && self.settled;
        if let Some(last) = self.window.frames.last_mut().filter(|_| goes_blind) {
            last.keyframe = true;
        }
        self.window.frames.push(frame);
        self.window.number();
        let params = self.window.params;
        let first = self.window.frames.len() == 1;
        let few = (known as f64) < params.known_share * tracks as f64;
        let keyframe = first
            || (few && self.keyframe_at.is_none_or(|at| seconds(at, time) >= params.keyframe_gap_s))
            || (known < 2 * FEWEST && tracks > known);
        let ready = self.ready_for_points();
        let begins = ready && self.window.cameras.len() == 1 && self.window.points.is_empty();
        let blind = self.window.points.is_empty() && !ready;
        if !(first || begins || blind) {
            let long = self.window.frames.len() > 2 * params.first_frames;
            self.solve(match (self.settled, self.waits_for_scale()) {
                (false, true) => params.iterations.min(WAITING_STEPS),
                (false, false) if !long => 3 * params.iterations,
                _ => params.iterations,
            });
        }
        let (outliers, residual_px) = self.drop_outliers();
        if (keyframe || begins) && (ready || first) {
            self.keyframe_at = Some(time);
            self.make_points();
            if begins && !first {
                self.solve(5 * params.iterations);
            }
        }
        let [position_sigma_m, rotation_sigma_rad, velocity_sigma_m_s, tilt_rad] =
            if blind && !first { [f64::INFINITY; 4] } else { self.sigmas(first) };
        let adrift = outliers > known.saturating_sub(outliers);
        self.adrift_since = adrift.then(|| self.adrift_since.unwrap_or(time));
        // Points that this frame has made hold it as well as known ones.
        let held = if first || begins { self.window.points.len() } else { known };
        let span = self.last.and_then(|last| time.since(last.time)).map_or(0.0, Span::as_secs_f64);
        if known >= FEWEST {
            self.misfit_px += (residual_px - self.misfit_px) * (span / MISFIT_S).min(1.0);
        }
        let state = if !self.settled && !first && tracks < FEWEST && known < FEWEST {
            self.judge(held, position_sigma_m, velocity_sigma_m_s, tilt_rad);
            State::FindingCorners
        } else {
            self.judge(held, position_sigma_m, velocity_sigma_m_s, tilt_rad)
        };
        let was_lost = self.last.is_some_and(|last| last.state == State::Lost);
        self.map += u32::from(was_lost && state != State::Lost);
        let last = self.window.frames.last().expect("a frame was pushed above");
        let motion = last.motion_now();
        self.biases = motion.biases;
        let estimate = Estimate {
            time,
            world_from_body: last.pose,
            velocity_m_s: motion.velocity_m_s,
            biases: motion.biases,
            state,
            position_sigma_m,
            rotation_sigma_rad,
            keyframe,
            map: self.map,
            known,
            outliers,
            residual_px,
        };
        self.shrink();
        self.forget(time);
        self.last = Some(estimate);
        estimate
    }

    fn solve(&mut self, iterations: usize) {
        for slot in 1..self.window.frames.len() {
            let biases = self.window.frames[slot - 1].motion_now().biases;
            if let Some(link) = &mut self.window.frames[slot].link {
                link.refresh(&biases);
            }
        }
        self.minimise(iterations);
    }

    fn minimise(&mut self, iterations: usize) {
        let options =
            Options { iterations, damping: 1e-6, cost_share: 1e-4, smallest_step: 1e-6, floor: 1e-6 };
        minimise(&mut self.window, &mut self.normal, &options);
    }

    /// Whether the corners and the inertial unit agree that nothing moves, and how well that is known.
    fn stands_still(&mut self, frame: &Frame) -> Option<f64> {
        let before = self.window.frames.last().map(Frame::motion_now).unwrap_or_default();
        let gravity_m_s2 = self.window.params.gravity_m_s2;
        let quiet = frame.link.as_ref().is_some_and(|link| link.is_quiet(&before.biases, gravity_m_s2));
        self.stillness.judge(frame.time, &frame.seen, quiet)
    }

    /// Sightings that lie far off are thrown away, and points that are left with too few.
    /// Throws away what does not fit; how many points, and the root mean square of what is left, pixels.
    fn drop_outliers(&mut self) -> (usize, f64) {
        let limit = self.window.params.outlier_px;
        self.window.residuals_px(&mut self.residuals);
        let mut residuals = self.residuals.iter();
        let mut points = std::mem::take(&mut self.window.points);
        let last = self.window.frames.last().map_or(0, |f| f.id);
        self.just_refused.clear();
        let (mut square, mut count) = (0.0, 0_usize);
        for point in &mut points {
            let seen = std::mem::take(&mut point.seen);
            let mut fine = |_: &Observation| {
                let residual = residuals.next().copied().flatten().filter(|r| *r < limit);
                if let Some(residual) = residual {
                    (square, count) = (square + residual * residual, count + 1);
                }
                residual.is_some()
            };
            let kept: Vec<Observation> = seen.iter().filter(|o| fine(o)).copied().collect();
            let host_lost =
                seen.iter().any(|o| o.frame == point.host) && !kept.iter().any(|o| o.frame == point.host);
            let now_lost = seen.iter().any(|o| o.frame == last) && !kept.iter().any(|o| o.frame == last);
            point.seen = kept;
            if now_lost || host_lost || point.seen.len() < 2 {
                point.seen.clear();
                self.refused.insert(point.track, last);
                self.just_refused.push(point.track);
            }
        }
        points.retain(|p| !p.seen.is_empty());
        self.window.points = points;
        self.window.number();
        self.index();
        self.just_refused.sort_unstable();
        (self.just_refused.len(), (square / count.max(1) as f64).sqrt())
    }

    pub(crate) fn index(&mut self) {
        self.known.clear();
        self.known.extend(self.window.points.iter().enumerate().map(|(i, p)| (p.track, i)));
    }

    /// New points for the tracks of the latest frame that have none, from all frames of the window that saw them.
    fn make_points(&mut self) {
        let params = self.window.params;
        let frames = &self.window.frames;
        let Some((host, slot)) = frames.last().zip(frames.len().checked_sub(1)) else { return };
        let (mut made, mut ways) = (Vec::new(), Vec::new());
        let mut at = 0;
        while at < host.seen.len() {
            let sighting = host.seen[at];
            let track = sighting.track;
            while at < host.seen.len() && host.seen[at].track == track {
                at += 1;
            }
            let full = self.window.points.len() + made.len() >= params.points;
            if full || self.known.contains_key(&track) || self.refused.contains_key(&track) {
                continue;
            }
            let mut seen = Vec::new();
            for (slot, frame) in frames.iter().enumerate() {
                let from = frame.seen.partition_point(|s| s.track < track);
                let same = frame.seen[from..].iter().take_while(|s| s.track == track);
                seen.extend(same.map(|s| Observation { frame: frame.id, slot, sighting: *s }));
            }
            if let Some(inverse_distance) = self.triangulate(slot, &sighting, &seen, &mut ways) {
                let mut point =
                    Point::new(track, host.id, sighting.camera, sighting.direction, inverse_distance);
                point.host_slot = slot;
                point.seen = seen;
                made.push(point);
            }
        }
        self.window.frames[slot].keyframe = true;
        self.window.points.append(&mut made);
        self.window.number();
        self.index();
    }

    /// One over the distance from the host's camera along the direction that it sees: least squares over all other sightings. `ways` is
    /// working memory.
    fn triangulate(
        &self,
        host: usize,
        sighting: &Sighting,
        seen: &[Observation],
        ways: &mut Vec<Way>,
    ) -> Option<f64> {
        let window = &self.window;
        let from = &window.frames[host].pose;
        let camera = &window.cameras[usize::from(sighting.camera)];
        let other = |o: &&Observation| o.slot != host || o.sighting.camera != sighting.camera;
        ways.clear();
        ways.extend(seen.iter().filter(other).map(|o| {
            let target = &window.frames[o.slot].pose;
            Way::new(&target.inv_mul(from), camera, &window.cameras[usize::from(o.sighting.camera)])
        }));
        let others = || seen.iter().filter(other).zip(ways.iter());
        let mut inverse = 0.3;
        let mut sigma = f64::INFINITY;
        for _ in 0..4 {
            let (mut slope, mut square) = (0.0, 0.0);
            for (o, way) in others() {
                let carried = way.carry(&sighting.direction, inverse);
                let length = carried.norm().max(1e-9);
                // Of J (along d + ρ offset) / length, with the length held.
                let constant = o.sighting.px_by_direction * (way.along * sighting.direction) / length;
                let by_inverse = o.sighting.px_by_direction * way.offset / length;
                slope += by_inverse.dot(&constant);
                square += by_inverse.norm_squared();
            }
            let (mut slope, mut square) = (slope * window.pixel_weight(), square * window.pixel_weight());
            if let Some(measured) = sighting.inverse_range() {
                let weight = 1.0 / window.params.depth_inverse_m.powi(2);
                slope -= measured * weight;
                square += weight;
            }
            if square <= 0.0 || square.is_nan() {
                return None;
            }
            inverse = -slope / square;
            sigma = square.sqrt().recip();
        }
        // Behind, or so unsure that it could be anywhere nearer than infinity and has no parallax to speak of.
        let two = others().any(|(o, _)| o.slot == host);
        if inverse < -3.0 * sigma
            || (!two && sigma > 0.5 * inverse.max(0.05))
            || inverse > crate::window::NEAREST
        {
            return None;
        }
        let inverse = inverse.max(0.0);
        let fine = others().all(|(o, way)| {
            way.residual(&o.sighting, &sighting.direction, inverse)
                .is_some_and(|r| r.norm() < window.params.outlier_px)
        });
        fine.then_some(inverse)
    }

    /// Standard deviations of the latest position, rotation and velocity, and of the first frame's rotation, by the equations of the last
    /// solution; infinite where it has none.
    fn sigmas(&mut self, first: bool) -> [f64; 4] {
        let slot = self.window.frames.len() - 1;
        if let (true, Some(a)) = (first, self.window.anchor) {
            return [a.position_m, a.tilt_rad.hypot(a.yaw_rad), a.velocity_m_s, a.tilt_rad];
        }
        let at = 6 * slot;
        let root = |from: &[f64]| from.iter().sum::<f64>().sqrt();
        let pose = [3, 4, 5, at, at + 1, at + 2, at + 3, at + 4, at + 5];
        let found = match self.window.motion_column(slot) {
            Some(m) => {
                let [a, b, c, d, e, f, g, h, i] = pose;
                self.normal
                    .variances(&[a, b, c, d, e, f, g, h, i, m, m + 1, m + 2])
                    .map(|v| [root(&v[3..6]), root(&v[6..9]), root(&v[9..]), root(&v[..3])])
            }
            None => self.normal.variances(&pose).map(|v| [root(&v[3..6]), root(&v[6..]), 0.0, root(&v[..3])]),
        };
        found.unwrap_or([f64::INFINITY; 4])
    }

    fn judge(
        &mut self,
        known: usize,
        position_sigma_m: f64,
        velocity_sigma_m_s: f64,
        tilt_rad: f64,
    ) -> State {
        let params = self.window.params;
        let count = self.window.frames.len();
        let now = self.window.frames.last().map_or(Timestamp::default(), |frame| frame.time);
        self.unseen_since =
            (known < FEWEST).then(|| self.unseen_since.or(self.last.map(|l| l.time)).unwrap_or(now));
        let unseen_s =
            self.unseen_since.map(|since| now.since(since).map_or(f64::INFINITY, Span::as_secs_f64));
        if self.window.points.is_empty() && !self.settled {
            return State::FindingDepth;
        }
        if !self.settled {
            // Without an inertial unit the first camera is level.
            let tilt = if params.inertial.is_some() { tilt_rad } else { 0.0 };
            let standing = self.window.frames.last().is_some_and(|f| f.still.is_some()) && count > 2;
            self.settled = params.inertial.is_none() && count > 2
                || (count >= params.first_frames && tilt < GRAVITY_RAD
                    || standing && tilt < 2.0 * GRAVITY_RAD
                    || count >= 4 * params.first_frames)
                    && self.knows_scale(position_sigma_m);
            if tilt > GRAVITY_RAD && !standing {
                return State::FindingGravity;
            }
            if !self.settled && !standing && self.scale_is_rough(position_sigma_m) {
                return State::FindingDepth;
            }
        }
        let limit = params.pixel_px * if params.inertial.is_some() { MISFIT.0 } else { MISFIT.1 };
        match unseen_s {
            _ if self.adrift_since.is_some_and(|since| seconds(since, now) >= ADRIFT_S) => State::Lost,
            None if self.misfit_px > limit => State::Disagreeing,
            None if velocity_sigma_m_s > UNKNOWN_M_S => State::FindingDepth,
            None => State::Tracked,
            Some(seconds) if params.inertial.is_some() && seconds < LONGEST_UNSEEN_S => State::Coasting,
            Some(_) => State::Lost,
        }
    }

    /// What no longer fits into the window leaves it.
    fn shrink(&mut self) {
        if !self.settled {
            self.thin();
            return;
        }
        let params = self.window.params;
        let count = self.window.frames.len();
        let latest = count.saturating_sub(params.states.max(1));
        let mut leaving = Leaving::default();
        for (slot, frame) in self.window.frames.iter().enumerate().take(latest) {
            match (frame.keyframe, frame.motion.is_some()) {
                (false, _) => leaving.frames.push(slot),
                (true, true) => leaving.motions.push(slot),
                (true, false) => {}
            }
        }
        let keyframes: Vec<usize> = (0..latest).filter(|s| self.window.frames[*s].keyframe).collect();
        let excess = keyframes.len().saturating_sub(params.keyframes);
        let mut kept = keyframes;
        for _ in 0..excess {
            let worst = self.least_useful(&kept);
            kept.retain(|s| *s != worst);
            leaving.frames.push(worst);
            leaving.motions.retain(|s| *s != worst);
        }
        if leaving != Leaving::default() {
            leaving.frames.sort_unstable();
            self.shrink.marginalise(&mut self.window, &leaving);
            self.index();
        }
    }

    /// The keyframe to give up: one whose points are no longer seen, else one in a crowd far from here. After J. Engel,
    /// V. Koltun, D. Cremers, "Direct Sparse Odometry", 2016, section 3.1.
    fn least_useful(&self, keyframes: &[usize]) -> usize {
        let frames = &self.window.frames;
        let last = frames.len() - 1;
        for &slot in &keyframes[..keyframes.len().saturating_sub(2)] {
            let hosted = self.window.points.iter().filter(|p| p.host_slot == slot);
            let (all, seen) = hosted.fold((0, 0), |(all, seen), p| {
                (all + 1, seen + usize::from(p.seen.iter().any(|o| o.slot == last)))
            });
            if seen * 20 <= all {
                return slot;
            }
        }
        let distance = |a: usize, b: usize| {
            (frames[a].pose.translation.vector - frames[b].pose.translation.vector).norm() + 1e-5
        };
        let score = |slot: usize| {
            let crowd: f64 = keyframes.iter().filter(|s| **s != slot).map(|s| 1.0 / distance(slot, *s)).sum();
            distance(slot, last).sqrt() * crowd
        };
        let candidates = &keyframes[..keyframes.len().saturating_sub(2).max(1)];
        candidates.iter().copied().max_by(|a, b| score(*a).total_cmp(&score(*b))).unwrap_or(keyframes[0])
    }

    /// Readings and refusals that nothing needs any more.
    fn forget(&mut self, time: Timestamp) {
        while self.readings.len() > 1 && self.readings[1].0 <= time {
            self.readings.pop_front();
        }
        let last = self.next_id;
        self.refused.retain(|_, since| *since + 200 > last);
    }
}
