//! Whether cameras sit on the body as the calibration says: what they see is compared with what the gyroscope feels and with what
//! the first camera sees.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};
use vergence_geom::{Camera, Rigid, exp, log};
use vergence_sense::Imu;
use vergence_time::Timestamp;
use vergence_vision::{
    Frame, Gray, Match, MatchKnobs, Orb, OrbKnobs, RansacKnobs, RayPair, epipolar_angle, match_all,
    relative_pose,
};

/// A camera that sits otherwise than the calibration says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Which.
    pub camera: usize,
    /// Against what: the first camera, or with `None` the gyroscope.
    pub beside: Option<usize>,
    /// By how much it is turned, rad.
    pub turned_rad: f64,
    /// The inverse of what is said would fit.
    pub inverted: bool,
}

impl std::fmt::Display for Misfit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (camera, degrees) = (self.camera, self.turned_rad.to_degrees());
        match self.beside {
            _ if self.inverted => write!(
                f,
                "inverted extrinsics: T_BS takes the camera's coordinates to the body's (it is the inverse of Kalibr's T_cam_imu)"
            ),
            // What nobody mounts wrongly.
            Some(other) if degrees < 3.0 => write!(
                f,
                "others: cam{camera} and cam{other} are not turned, but what they see does not fit; are intrinsics and distortion right?"
            ),
            Some(other) => {
                write!(
                    f,
                    "rotated extrinsics: cam{camera} is turned by {degrees:.0} degrees against what it and cam{other} see"
                )
            }
            None => {
                write!(
                    f,
                    "rotated extrinsics: cam{camera} is turned by {degrees:.0} degrees against what it sees and the gyroscope feels"
                )
            }
        }
    }
}

/// Time between two views that are compared with the gyroscope, s.
const SPAN_S: f64 = 0.5;
/// A turn that says something; and by how much the gyroscope may be off in the span (a share, and its bias), rad.
const LEAST_TURN: f64 = 0.06;
const TURN_SLACK: (f64, f64) = (0.15, 0.03);
/// Turns until something is said, and the most that are looked at.
const TURNS: (usize, usize) = (12, 100);
/// How far turns must spread about two axes (standard deviation), rad; the share of them (squared) that may be left unexplained, and how
/// many times as much the calibration must leave, and half of that share: what some rotation explains a little better says nothing against it.
const SPREAD: f64 = 0.025;
const UNEXPLAINED: f64 = 0.1;
const WORSE: f64 = 5.0;
/// Turned against the gyroscope: beyond this it is wrong, below half of it it is right, rad.
const AGAINST_GYROSCOPE: f64 = 0.12;
/// A look tells against the calibration where that explains less than this share of the matches that some relative pose explains.
const EXPLAINED: f64 = 0.7;
/// Frames between two looks, looks that must agree (within this, rad) against the calibration, one more of which is for it; the most looks.
const EVERY: usize = 5;
const LOOKS: (usize, usize) = (3, 8);
const AGREE: f64 = 0.04;
/// How far a match may be from its epipolar plane, pixels.
const PIXELS: f64 = 1.5;
/// Matches that must agree on a relative pose.
const AGREEING: usize = 30;
const KNOBS: RansacKnobs = RansacKnobs { seed: 1, most: 400, confidence: 0.99 };

/// What is known of another camera.
#[derive(Debug, Default)]
struct Other {
    frames: usize,
    /// First from this one, as pictures show it against the calibration.
    against: Vec<Rigid>,
    /// Looks that the inverse of what is said would explain.
    inverse: usize,
    /// Looks for the calibration.
    fine: usize,
    looked: usize,
    decided: bool,
}

/// Directions in the first camera, by track, in order.
type Rays = Vec<(u64, Vector3<f64>)>;

/// Watches the beginning of a recording.
#[derive(Debug)]
pub(crate) struct Mounting {
    rig: Vec<Camera>,
    /// Then from now, by the gyroscope.
    turned: UnitQuaternion<f64>,
    reading: Option<(Timestamp, Vector3<f64>)>,
    then: Option<(Timestamp, Rays)>,
    /// By the gyroscope in the body, by the pictures in the first camera, rad.
    turns: Vec<(Vector3<f64>, Vector3<f64>)>,
    decided: bool,
    others: Vec<Other>,
    found: Option<Misfit>,
}

impl Mounting {
    pub(crate) fn new(rig: &[Camera], with_gyroscope: bool) -> Self {
        Self {
            rig: rig.to_vec(),
            turned: UnitQuaternion::identity(),
            reading: None,
            then: None,
            turns: Vec::new(),
            decided: !with_gyroscope,
            others: (1..rig.len()).map(|_| Other::default()).collect(),
            found: None,
        }
    }

    /// Whether nothing more is to be found out.
    fn is_done(&self) -> bool {
        self.decided && self.others.iter().all(|other| other.decided)
    }

    pub(crate) fn imu(&mut self, time: Timestamp, imu: &Imu) {
        if self.decided {
            return;
        }
        if let Some((before, rate)) = self.reading.replace((time, imu.gyr_rad_s)) {
            let seconds = time.since(before).map_or(0.0, |span| span.as_secs_f64());
            self.turned *= exp(&((rate + imu.gyr_rad_s) * (0.5 * seconds)));
        }
    }

    /// One frame as the tracker saw it; a camera that sits otherwise, once that is sure.
    pub(crate) fn frame(&mut self, time: Timestamp, pictures: &[Gray], seen: &Frame) -> Option<Misfit> {
        if self.found.is_some() || self.is_done() {
            return self.found;
        }
        self.against_gyroscope(time, seen);
        for camera in 1..self.rig.len() {
            if self.found.is_none() {
                self.against_first(camera, pictures);
            }
        }
        self.found
    }

    fn against_gyroscope(&mut self, time: Timestamp, seen: &Frame) {
        if self.decided {
            return;
        }
        let lens = &self.rig[0].lens;
        let span = self.then.as_ref().and_then(|then| time.since(then.0)).map(|span| span.as_secs_f64());
        if span.is_some_and(|span| span < SPAN_S) {
            return;
        }
        let rays =
            seen.cameras[0].iter().filter_map(|s| Some((s.track.0, lens.unproject(&s.pixel)?.into_inner())));
        let now: Rays = rays.collect();
        let turned = std::mem::take(&mut self.turned);
        let Some((_, then)) = self.then.replace((time, now)) else { return };
        let (Some((_, now)), true) = (&self.then, span.is_some_and(|span| span < 2.0 * SPAN_S)) else {
            return;
        };
        let by_gyroscope = log(&turned);
        if by_gyroscope.norm() < LEAST_TURN {
            return;
        }
        let pair = |(track, ray): &(u64, Vector3<f64>)| {
            let same = then.binary_search_by_key(track, |t| t.0).ok()?;
            Some((then[same].1, *ray))
        };
        let pairs: Vec<RayPair> = now.iter().filter_map(pair).collect();
        let angle_rad = 1.0 / lens.focal_px().max();
        let Some((pose, fine)) = relative_pose(&pairs, angle_rad, &KNOBS) else { return };
        let by_pictures = log(&pose.rotation);
        let slack = TURN_SLACK.0 * by_gyroscope.norm() + TURN_SLACK.1;
        // Whatever the extrinsics, both have turned by the same angle.
        if fine.len() < AGREEING.min(pairs.len() * 2 / 3)
            || (by_pictures.norm() - by_gyroscope.norm()).abs() > slack
        {
            return;
        }
        self.turns.push((by_gyroscope, by_pictures));
        self.judge_gyroscope();
    }

    /// The rotation that takes the turns of the pictures to those of the gyroscope, apart from its bias. After G. Wahba, "A Least Squares
    /// Estimate of Satellite Attitude", 1965.
    fn judge_gyroscope(&mut self) {
        let count = self.turns.len();
        if count < TURNS.0 {
            return;
        }
        let share = 1.0 / count as f64;
        let mean = self
            .turns
            .iter()
            .fold((Vector3::zeros(), Vector3::zeros()), |m, t| (m.0 + t.0 * share, m.1 + t.1 * share));
        let centred = || self.turns.iter().map(|t| (t.0 - mean.0, t.1 - mean.1));
        let moment = centred().fold(Matrix3::zeros(), |b, (g, v)| b + g * v.transpose() * share);
        let svd = moment.svd(true, true);
        let (Some(u), Some(vt)) = (svd.u, svd.v_t) else { return };
        let mut sizes = svd.singular_values;
        sizes.as_mut_slice().sort_by(f64::total_cmp);
        let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * vt).determinant().signum()));
        let best = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * sign * vt));
        let all: f64 = centred().map(|(g, _)| g.norm_squared()).sum();
        let left: f64 = centred().map(|(g, v)| (g - best * v).norm_squared()).sum();
        let said = self.rig[0].body_from_camera.rotation;
        let left_by_said: f64 = centred().map(|(g, v)| (g - said * v).norm_squared()).sum();
        let turned_rad = best.angle_to(&said);
        if sizes[1].sqrt() > SPREAD && left < UNEXPLAINED * all {
            let is_wrong = left_by_said > (WORSE * left).max(0.5 * UNEXPLAINED * all);
            if turned_rad > AGAINST_GYROSCOPE && is_wrong {
                let inverted = best.angle_to(&said.inverse()) < AGAINST_GYROSCOPE;
                self.found = Some(Misfit { camera: 0, beside: None, turned_rad, inverted });
                self.decided = true;
            } else if turned_rad < 0.5 * AGAINST_GYROSCOPE {
                self.decided = true;
            }
        }
        self.decided |= count >= TURNS.1;
    }

    fn against_first(&mut self, camera: usize, pictures: &[Gray]) {
        let other = &mut self.others[camera - 1];
        other.frames += 1;
        if other.decided || !other.frames.is_multiple_of(EVERY) {
            return;
        }
        other.looked += 1;
        let (first, second) = (&self.rig[0], &self.rig[camera]);
        let said = first.body_from_camera.inverse() * second.body_from_camera;
        let inverse = first.body_from_camera * second.body_from_camera.inverse();
        match look([&pictures[0], &pictures[camera]], [first, second], [&said, &inverse]) {
            Look::Nothing => {}
            Look::For => other.fine += 1,
            Look::Against { found, inverse_fits } => {
                other.against.push(found);
                other.inverse += usize::from(inverse_fits);
                let like = |look: &&Rigid| look.rotation.angle_to(&found.rotation) < AGREE;
                if other.against.iter().filter(like).count() >= LOOKS.0 && other.fine == 0 {
                    // A baseline that points the wrong way is a turn, too.
                    let ways = found.translation.vector.angle(&said.translation.vector);
                    let turned_rad = found.rotation.angle_to(&said.rotation);
                    let turned_rad = if ways > 1.5 { ways.max(turned_rad) } else { turned_rad };
                    let inverted = other.inverse * 2 > other.against.len();
                    self.found = Some(Misfit { camera, beside: Some(0), turned_rad, inverted });
                }
            }
        }
        other.decided = self.found.is_some() || other.fine > 0 || other.looked >= LOOKS.1;
    }
}

/// What two pictures say of a relative pose.
enum Look {
    Nothing,
    For,
    Against {
        /// First from second, as the pictures show it.
        found: Rigid,
        /// Whether the inverse of what is said would explain them.
        inverse_fits: bool,
    },
}

/// Whether a pose (first from second) explains a match: both rays are near their epipolar planes and meet before the cameras, or are as good as
/// parallel.
fn explains(pose: &Rigid, (first, second): &RayPair, angle_rad: f64) -> bool {
    let turned = pose.rotation * second;
    let (cosine, way) = (first.dot(&turned), &pose.translation.vector);
    let (a, b) = (first.dot(way), turned.dot(way));
    let meet = a - cosine * b > 0.0 && cosine * a - b > 0.0;
    let off = epipolar_angle(&pose.inverse(), first, second).zip(epipolar_angle(pose, second, first));
    off.is_some_and(|(a, b)| a.abs().max(b.abs()) < angle_rad)
        && (meet || first.angle(&turned) < 2.0 * angle_rad)
}

/// Whether what two cameras see at one instant tells for where the calibration has the second one, in the first one's frame; and for where it
/// would be with both cameras' places inverted.
fn look(pictures: [&Gray; 2], cameras: [&Camera; 2], [said, inverse]: [&Rigid; 2]) -> Look {
    let described = pictures.map(|picture| {
        let (mut points, mut words) = (Vec::new(), Vec::new());
        let orb = Orb::new(picture.width(), picture.height(), OrbKnobs::default());
        // What is too small for it shows nothing.
        let done = orb.and_then(|mut orb| orb.detect(picture, &mut points, &mut words));
        if done.is_ok() { (points, words) } else { Default::default() }
    });
    let [(first, first_words), (second, second_words)] = &described;
    let matches = match_all(first_words, second_words, &MatchKnobs::default());
    let ray =
        |camera: &Camera, pixel: Vector2<f64>| camera.lens.unproject(&pixel).map(|ray| ray.into_inner());
    let pair =
        |m: &Match| Some((ray(cameras[0], first[m.first].pixel)?, ray(cameras[1], second[m.second].pixel)?));
    let pairs: Vec<RayPair> = matches.iter().filter_map(pair).collect();
    let angle_rad = PIXELS / cameras[0].lens.focal_px().max();
    let by = |pose: &Rigid| pairs.iter().filter(|pair| explains(pose, pair, angle_rad)).count();
    let explained = by(said);
    match relative_pose(&pairs, angle_rad, &RansacKnobs { most: 2000, ..KNOBS }) {
        Some((found, fine))
            if fine.len() >= AGREEING && (explained as f64) < EXPLAINED * fine.len() as f64 =>
        {
            let inverse_fits = by(inverse) as f64 >= EXPLAINED * fine.len() as f64;
            Look::Against { found, inverse_fits }
        }
        _ if explained >= AGREEING => Look::For,
        _ => Look::Nothing,
    }
}
