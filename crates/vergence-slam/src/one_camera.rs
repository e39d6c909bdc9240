//! How odometry begins with one camera: nothing to do with a second one or with depth.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::Rigid;

use crate::bootstrap::{Pair, two_views};
use crate::flight::{ACC_BIAS, Flight, Start};
use crate::link::{Link, Motion};
use crate::odometry::{Odometry, seconds};
use crate::sighting::Sighting;
use crate::window::Window;

/// Corners must have moved by this much in the middle before two views are tried, pixels.
const PARALLAX_PX: f64 = 25.0;
/// Corners that both views must share.
const SHARED: usize = 30;
/// Time between two attempts at velocity and gravity; the span before they are guessed, before one is believed, and the longest that an attempt
/// takes, s.
const EVERY_S: f64 = 0.09;
const SPAN_S: (f64, f64, f64) = (0.09, 0.7, 2.5);
/// Views and corners that an attempt takes.
const VIEWS: usize = 10;
const CORNERS: usize = 40;

/// Poses are tracked when the position is known this well, as a share of the way, or the way is shorter than this, m.
const ROUGH: (f64, f64) = (0.1, 0.05);
/// The size of everything is known when the position is known this well, as a share of the way; the window waits for it no longer than
/// this, s, with at most so many frames.
const SCALE: f64 = 0.008;
const LONGEST_S: f64 = 10.0;
const MOST_FRAMES: usize = 28;
/// While one camera waits for its scale: so many frames, and once there are as many so many steps of the minimisation for each further one, which begins
/// near its end. Time grows with the square of the one and with the other; 28 frames and 4 steps gave no better scale.
const WAITING_FRAMES: usize = 18;
pub(crate) const WAITING_STEPS: usize = 2;

fn same(seen: &[Sighting], track: u64) -> Option<&Sighting> {
    seen.binary_search_by_key(&(track, 0), |s| (s.track, s.camera)).ok().map(|i| &seen[i])
}

impl Odometry {
    /// Whether points may be made at the latest frame. With one camera and none yet: once the relative pose of two views, or
    /// velocity and gravity, are found; the frames of the window are put there.
    pub(crate) fn ready_for_points(&mut self) -> bool {
        let window = &self.window;
        let depth = window.frames.iter().any(|f| f.seen.iter().any(|s| s.depth_m.is_some()));
        if window.cameras.len() != 1 || depth || !window.points.is_empty() || self.settled {
            return true;
        }
        if window.params.inertial.is_some() { self.fly() } else { self.look() }
    }

    /// Whether what says how large everything is may be marginalised: with one camera and an inertial unit it takes accelerations, and what was
    /// marginalised before they came would hold a wrong size for ever.
    pub(crate) fn knows_scale(&self, position_sigma_m: f64) -> bool {
        let window = &self.window;
        // What moves fast knows soon, and fills the window with points that it sees no more: there must be room for others.
        let known = |s: &&Sighting| self.known.contains_key(&s.track);
        let starved =
            window.frames.last().is_some_and(|f| f.seen.iter().filter(known).count() * 2 < f.seen.len());
        let full = starved && window.points.len() * 10 >= window.params.points * 9;
        let measured = |p: &crate::window::Point| p.seen.iter().any(|o| o.sighting.depth_m.is_some());
        let given = window.params.inertial.is_none() || window.cameras.len() != 1;
        if given || full || window.points.iter().any(measured) {
            return true;
        }
        let (Some(first), Some(last)) = (window.frames.first(), window.frames.last()) else { return true };
        position_sigma_m < SCALE * self.way_m()
            || last.time.since(first.time).is_none_or(|s| s.as_secs_f64() > LONGEST_S)
    }

    /// Whether one camera and an inertial unit know how large everything is too badly for a pose that can be trusted.
    pub(crate) fn scale_is_rough(&self, position_sigma_m: f64) -> bool {
        let way = self.way_m();
        !self.knows_scale(position_sigma_m) && way > ROUGH.1 && position_sigma_m > ROUGH.0 * way
    }

    /// How far the window reaches from its first frame, m.
    fn way_m(&self) -> f64 {
        let place = |f: &crate::window::Frame| f.pose.translation.vector;
        let Some(first) = self.window.frames.first() else { return 0.0 };
        self.window.frames.iter().map(|f| (place(f) - place(first)).norm()).fold(0.0, f64::max)
    }

    /// Frames that the window waits with at most; those of the start are among them.
    fn most_frames(&self) -> usize {
        let params = &self.window.params;
        let most = if self.window.cameras.len() == 1 { WAITING_FRAMES } else { MOST_FRAMES };
        most.max(params.first_frames + params.states)
    }

    /// Whether the window is full of frames of one camera that wait for the scale.
    pub(crate) fn waits_for_scale(&self) -> bool {
        self.window.cameras.len() == 1 && !self.settled && self.window.frames.len() >= self.most_frames()
    }

    /// Where the window waits long, frames between others are let go that no point hangs on; their readings stay.
    pub(crate) fn thin(&mut self) {
        while self.window.frames.len() > self.most_frames() && !self.window.points.is_empty() {
            let window = &mut self.window;
            let hosts = |id: u64| window.points.iter().any(|p| p.host == id);
            let gap = |k: usize| {
                let span = window.frames[k + 1].time.since(window.frames[k - 1].time);
                span.map_or(i64::MAX, |span| span.as_nanos())
            };
            let latest = window.frames.len() - window.params.states.max(1);
            let Some(k) = (1..latest).filter(|k| !hosts(window.frames[*k].id)).min_by_key(|k| gap(*k)) else {
                return;
            };
            let joined = match (&window.frames[k].link, &window.frames[k + 1].link) {
                (Some(a), Some(b)) => a.joined(b),
                _ => None,
            };
            let Some(joined) = joined else { return };
            let id = window.frames.remove(k).id;
            window.frames[k].link = Some(joined);
            for point in &mut window.points {
                point.seen.retain(|o| o.frame != id);
            }
            window.points.retain(|p| p.seen.len() > 1);
            window.number();
            self.index();
        }
    }

    /// Standard deviation of a direction, rad.
    fn direction_rad(&self) -> f64 {
        let seen = self.window.frames.last().and_then(|f| f.seen.first());
        let px_per_rad = seen.map_or(400.0, |s| s.px_by_direction.norm() / std::f64::consts::SQRT_2);
        self.window.params.pixel_px / px_per_rad.max(1.0)
    }

    /// Images alone: the first frame of the window and the latest one; those between are let go.
    fn look(&mut self) -> bool {
        let rad = self.direction_rad();
        let count = self.window.frames.len();
        if count < 2 {
            return false;
        }
        if count > 2 {
            self.window.frames.remove(count - 2);
            self.window.number();
        }
        let [first, last] = &self.window.frames[..] else { return false };
        let mut pairs: Vec<Pair> = Vec::new();
        let mut moved = Vec::new();
        for s in &last.seen {
            if let Some(then) = same(&first.seen, s.track) {
                pairs.push((then.direction, s.direction));
                moved.push((s.px_by_direction * then.direction).norm());
            }
        }
        if pairs.len() < SHARED {
            // Too little is left of the first view: this one takes its place.
            let last = self.window.frames.remove(1);
            let id = last.id;
            self.window.frames[0] = last;
            if let Some(anchor) = &mut self.window.anchor {
                anchor.frame = id;
                anchor.pose = self.window.frames[0].pose;
            }
            self.window.frames[0].keyframe = true;
            self.window.number();
            return false;
        }
        let middle = moved.len() / 2;
        if *moved.select_nth_unstable_by(middle, f64::total_cmp).1 < PARALLAX_PX {
            return false;
        }
        let Some(first_from_last) = two_views(&pairs, rad) else { return false };
        let camera = self.window.cameras[0];
        let pose = self.window.frames[0].pose * camera * first_from_last * camera.inverse();
        self.window.frames[0].keyframe = true;
        let last = &mut self.window.frames[1];
        last.pose = pose;
        last.guess = Some(pose);
        true
    }

    /// With an inertial unit: velocity and gravity from a second or two of flight. Where it stands still, the velocity is known.
    fn fly(&mut self) -> bool {
        let found = self.flown();
        if !found {
            // The oldest frames are let go.
            let long = |w: &Window| match &w.frames[..] {
                [first, .., last] => last.time.since(first.time).is_some_and(|s| s.as_secs_f64() > SPAN_S.2),
                _ => false,
            };
            while long(&self.window) {
                self.window.frames.remove(0);
                let first = &mut self.window.frames[0];
                first.link = None;
                if let Some(anchor) = &mut self.window.anchor {
                    (anchor.frame, anchor.pose) = (first.id, first.pose);
                    anchor.motion.velocity_m_s = first.motion_now().velocity_m_s;
                    anchor.tilt_rad = 0.3;
                    anchor.velocity_m_s = 3.0;
                }
            }
            if !self.flying {
                // Nothing says where it went: it is said to be where it was.
                let place = self.window.frames[0].pose.translation;
                for frame in &mut self.window.frames {
                    frame.pose.translation = place;
                    if let Some(motion) = &mut frame.motion {
                        motion.velocity_m_s = Vector3::zeros();
                    }
                }
            }
            self.window.number();
        }
        found
    }

    fn flown(&mut self) -> bool {
        let count = self.window.frames.len();
        let (first, last) = (&self.window.frames[0], &self.window.frames[count - 1]);
        if count < 2 || self.window.frames.iter().filter(|f| f.still.is_some()).count() * 2 > count {
            return count > 1;
        }
        let span = last.time.since(first.time).map_or(0.0, |s| s.as_secs_f64());
        if span < SPAN_S.0 || self.tried_at.is_some_and(|at| seconds(at, last.time) < EVERY_S) {
            return false;
        }
        self.tried_at = Some(last.time);
        let links: Option<Vec<&Link>> = self.window.frames[1..].iter().map(|f| f.link.as_ref()).collect();
        let Some(links) = links else { return false };
        let camera = self.window.cameras[0];
        let stride = (count - 1).div_ceil(VIEWS).max(1);
        let mut tracks = Vec::new();
        for s in &last.seen {
            let views: Vec<_> = (0..count)
                .rev()
                .step_by(stride)
                .filter_map(|k| Some((k, same(&self.window.frames[k].seen, s.track)?)))
                .map(|(k, s)| (k, camera.rotation * s.direction, camera.translation.vector))
                .collect();
            if views.len() >= count.min(4) {
                tracks.push(views);
            }
        }
        // Tracks are in the order of cells of the picture: some from everywhere.
        let every = tracks.len().div_ceil(CORNERS).max(1);
        let tracks: Vec<_> = tracks.into_iter().step_by(every).collect();
        if tracks.len() < CORNERS / 2 {
            return false;
        }
        let gravity_m_s2 = first.pose.rotation.inverse() * self.window.params.gravity();
        let mut flight = Flight::new(links, tracks, gravity_m_s2, self.direction_rad());
        let fits = |start: &Start| start.misfit < 4.0;
        let is_sure = |start: &Start| {
            start.velocity_sigma_m_s * start.misfit.max(1.0) < 0.1 + 0.2 * start.velocity_m_s.norm()
                && start.biases.acc_m_s2.norm() < 3.0 * ACC_BIAS
        };
        // Until the readings say how far things are it is a guess: they are taken to be as far away as in a room.
        let room = flight.in_a_room().filter(fits);
        let sure = (span >= SPAN_S.1).then(|| flight.anywhere()).flatten();
        let sure = sure.filter(|start| fits(start) && is_sure(start));
        let is_sure = sure.is_some();
        let Some(start) = sure.or(room) else { return false };
        let Some(level) = UnitQuaternion::rotation_between(&-start.gravity_m_s2, &Vector3::y()) else {
            return false;
        };
        let place = first.pose.translation.vector;
        let mut pose = Rigid::from_parts(place.into(), level);
        let mut motion = Motion { velocity_m_s: level * start.velocity_m_s, biases: start.biases };
        if let Some(anchor) = &mut self.window.anchor {
            // What is known of biases before does not come from what is seen.
            (anchor.pose, anchor.motion.velocity_m_s) = (pose, motion.velocity_m_s);
            (anchor.tilt_rad, anchor.velocity_m_s) = if is_sure { (0.1, 0.5) } else { (0.3, 3.0) };
        }
        for frame in &mut self.window.frames {
            if let Some(link) = &frame.link {
                (pose, motion) = link.follow(&pose, &motion);
            }
            (frame.pose, frame.motion) = (pose, Some(motion));
        }
        self.flying = true;
        is_sure
    }
}
