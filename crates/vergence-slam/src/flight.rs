//! Velocity, gravity and biases from a second of views of one camera and of inertial readings, before anything else is known.

use nalgebra::{Matrix3, Matrix3x2, SMatrix, SVector, UnitQuaternion, Vector3};
use vergence_geom::{Rigid, log};
use vergence_inertial::preintegrate::Biases;
use vergence_solve::{Kernel, Normal, Options, Problem, minimise};

use crate::link::{Link, Motion};
use crate::sighting::across;

/// How a frame sees a track: frame, direction in the body, the camera's place on the body.
pub(crate) type View = (usize, Vector3<f64>, Vector3<f64>);

/// What is known before, as standard deviations: velocity (m/s), direction of gravity (rad), biases (m/s² and rad/s).
const VELOCITY: f64 = 3.0;
const TILT: f64 = 0.3;
pub(crate) const ACC_BIAS: f64 = 0.1;
const GYR_BIAS: f64 = 0.1;
/// One over the distance of each point, 1/m: at first as in a room; its standard deviation there, and where nothing is said of it.
const NEAR: f64 = 0.5;
const NEAR_IN_A_ROOM: f64 = 0.5;
const NEAR_ANYWHERE: f64 = 5.0;
/// Nearest and farthest point, 1/m.
const NEARS: (f64, f64) = (20.0, 0.0);
const KERNEL: Kernel = Kernel::Huber(2.0);
/// Step of numerical derivatives by the gyroscope's bias, rad/s.
const H: f64 = 1e-4;

/// Velocity, direction of gravity, accelerometer's bias, gyroscope's bias.
const UNKNOWNS: usize = 11;
type Row = SMatrix<f64, 2, UNKNOWNS>;
type Square = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
type Column = SVector<f64, UNKNOWNS>;

/// Where a body is that began at rest without gravity, in the first frame's axes.
#[derive(Clone, Copy)]
struct Free {
    rotation: UnitQuaternion<f64>,
    moved: Vector3<f64>,
    /// What the accelerometer's bias does to it (columns), s².
    shift: Matrix3<f64>,
    /// Since the first frame, s.
    t: f64,
    /// Variance of its speed along each axis by the accelerometer's noise, m²/s², and that noise, m²/s³.
    faster: f64,
    noise: f64,
    /// What the gyroscope's bias does to place and rotation (columns).
    moved_by_gyr: Matrix3<f64>,
    turned_by_gyr: Matrix3<f64>,
}

/// What the first frame is taken to be, in its own axes.
#[derive(Clone, Copy)]
struct Guess {
    velocity_m_s: Vector3<f64>,
    gravity_m_s2: Vector3<f64>,
    biases: Biases,
}

/// What the first frame is found to be, in its own axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    pub(crate) velocity_m_s: Vector3<f64>,
    pub(crate) gravity_m_s2: Vector3<f64>,
    pub(crate) biases: Biases,
    /// Standard deviation of the velocity, m/s.
    pub(crate) velocity_sigma_m_s: f64,
    /// Half of the sum of squares of all that is left, in standard deviations.
    cost: f64,
    /// Root mean square of the angles left, in standard deviations.
    pub(crate) misfit: f64,
}

/// A point: one over its distance along the ray of its first view, and how it follows the unknowns.
#[derive(Clone, Copy)]
struct Near {
    inverse_m: f64,
    before: f64,
    by_unknowns: Column,
    slope: f64,
    square: f64,
}

/// Frames from the first on: the links from each to the next, and for each track how frames see it.
pub(crate) struct Flight<'a> {
    links: Vec<&'a Link>,
    tracks: Vec<Vec<View>>,
    /// Standard deviation of a direction, rad.
    rad: f64,
    /// Gravity before anything is seen.
    level: Vector3<f64>,
    /// Standard deviation of one over a distance, 1/m.
    near_sigma: f64,
    guess: Guess,
    before: Guess,
    states: Vec<Free>,
    nears: Vec<Near>,
}

impl<'a> Flight<'a> {
    /// `gravity_m_s2` as the accelerometer alone has it, in the first frame's axes; `rad` is the standard deviation of a direction.
    pub(crate) fn new(
        links: Vec<&'a Link>,
        tracks: Vec<Vec<View>>,
        gravity_m_s2: Vector3<f64>,
        rad: f64,
    ) -> Self {
        let guess = Guess { velocity_m_s: Vector3::zeros(), gravity_m_s2, biases: Biases::default() };
        let near =
            Near { inverse_m: NEAR, before: NEAR, by_unknowns: Column::zeros(), slope: 0.0, square: 1.0 };
        let nears = vec![near; tracks.len()];
        let level = gravity_m_s2;
        Self {
            links,
            tracks,
            rad,
            level,
            near_sigma: NEAR_IN_A_ROOM,
            guess,
            before: guess,
            states: Vec::new(),
            nears,
        }
    }

    /// Where things are taken to be as far away as in a room: a guess, from three frames on. What moves one way looks much like what moves the
    /// other way and turns a little more: the better of both is taken.
    pub(crate) fn in_a_room(&mut self) -> Option<Start> {
        self.near_sigma = NEAR_IN_A_ROOM;
        let one = self.start()?;
        let (guess, nears) = (self.guess, self.nears.clone());
        self.guess =
            Guess { velocity_m_s: -guess.velocity_m_s, gravity_m_s2: self.level, biases: Biases::default() };
        self.nears.iter_mut().for_each(|near| near.inverse_m = NEAR);
        let other = self.start();
        if let Some(other) = other.filter(|other| other.cost < one.cost) {
            return Some(other);
        }
        (self.guess, self.nears) = (guess, nears);
        Some(one)
    }

    /// Where nothing is said of how far things are: what the readings say; from where [`Self::in_a_room`] ended.
    pub(crate) fn anywhere(&mut self) -> Option<Start> {
        self.near_sigma = NEAR_ANYWHERE;
        self.start()
    }

    fn start(&mut self) -> Option<Start> {
        let mut normal = Normal::default();
        let options = Options { cost_share: 1e-4, smallest_step: 1e-5, ..Options::default() };
        let report = minimise(self, &mut normal, &options);
        let views: usize = self.tracks.iter().map(Vec::len).sum();
        let variances = normal.variances(&[0, 1, 2])?;
        report.cost.is_finite().then(|| Start {
            velocity_m_s: self.guess.velocity_m_s,
            gravity_m_s2: self.guess.gravity_m_s2,
            biases: self.guess.biases,
            velocity_sigma_m_s: variances.iter().sum::<f64>().sqrt(),
            cost: report.cost,
            misfit: (report.cost / views.max(1) as f64).sqrt(),
        })
    }

    /// Each frame by the readings alone, where the gyroscope's bias is this.
    fn chain(&self, gyr_rad_s: Vector3<f64>) -> Vec<Free> {
        let biases = Biases { gyr_rad_s, acc_m_s2: Vector3::zeros() };
        let (mut pose, mut motion) = (Rigid::identity(), Motion { biases, ..Motion::default() });
        let (zero, mut speed_shift) = (Matrix3::zeros(), Matrix3::zeros());
        let mut free = Free {
            rotation: pose.rotation,
            moved: Vector3::zeros(),
            shift: zero,
            t: 0.0,
            faster: 0.0,
            noise: 0.0,
            moved_by_gyr: zero,
            turned_by_gyr: zero,
        };
        let mut states = Vec::with_capacity(self.links.len() + 1);
        states.push(free);
        for link in &self.links {
            let turn = pose.rotation.to_rotation_matrix().into_inner();
            let (by_place, by_speed) = link.by_acc_bias();
            free.shift += speed_shift * link.seconds() + turn * by_place;
            speed_shift += turn * by_speed;
            (pose, motion) = link.follow_free(&pose, &motion);
            (free.rotation, free.moved) = (pose.rotation, pose.translation.vector);
            free.t += link.seconds();
            free.noise = link.acc_noise().powi(2);
            free.faster += free.noise * link.seconds();
            states.push(free);
        }
        states
    }

    /// The states at the guess, with derivatives by the gyroscope's bias.
    fn refresh(&mut self) {
        let at = self.guess.biases.gyr_rad_s;
        let mut states = self.chain(at);
        for axis in 0..3 {
            let moved = self.chain(at + Vector3::ith(axis, H));
            for (state, moved) in states.iter_mut().zip(&moved) {
                state.moved_by_gyr.set_column(axis, &((moved.moved - state.moved) / H));
                let turned = log(&(moved.rotation * state.rotation.inverse()));
                state.turned_by_gyr.set_column(axis, &(turned / H));
            }
        }
        self.states = states;
    }

    /// Where the camera is, in the first frame's axes.
    fn camera(&self, state: &Free, place: &Vector3<f64>) -> Vector3<f64> {
        let Guess { velocity_m_s, gravity_m_s2, biases } = &self.guess;
        let fallen = velocity_m_s * state.t + gravity_m_s2 * (0.5 * state.t * state.t);
        state.moved + fallen + state.shift * biases.acc_m_s2 + state.rotation * place
    }

    /// How a view sees a point of another view: what is left (two angles), its weight; and the parts that derivatives are made of.
    fn look(&self, host: &View, view: &View, inverse_m: f64) -> Option<Looked> {
        let (from, to) = (self.states.get(host.0)?, self.states.get(view.0)?);
        let ray = from.rotation * host.1;
        let way = self.camera(from, &host.2) - self.camera(to, &view.2);
        let carried = ray + way * inverse_m;
        let length = carried.norm();
        let (unit, seen) = (carried / length, to.rotation * view.1);
        let basis = to.rotation.to_rotation_matrix().into_inner() * across(&view.1);
        let (early, late) = if from.t < to.t { (from, to) } else { (to, from) };
        let span = late.t - early.t;
        let strayed = span * span * (early.faster + late.noise * span / 3.0);
        let weight = 1.0 / (self.rad * self.rad + strayed * inverse_m * inverse_m);
        (unit.dot(&seen) > 0.1).then(|| Looked {
            ray,
            way,
            length,
            unit,
            basis,
            weight,
            left: basis.tr_mul(&unit),
        })
    }

    /// Derivatives of what is left by the unknowns and by the inverse distance.
    fn derivatives(
        &self,
        looked: &Looked,
        host: &View,
        view: &View,
        inverse_m: f64,
    ) -> (Row, SVector<f64, 2>) {
        let (from, to) = (&self.states[host.0], &self.states[view.0]);
        let by_carried = (looked.basis.transpose() - looked.left * looked.unit.transpose()) / looked.length;
        let mut row = Row::zeros();
        let gravity = across(&self.guess.gravity_m_s2.normalize()) * self.guess.gravity_m_s2.norm();
        row.fixed_columns_mut::<3>(0).copy_from(&(by_carried * (inverse_m * (from.t - to.t))));
        let fallen = 0.5 * (from.t * from.t - to.t * to.t);
        row.fixed_columns_mut::<2>(3).copy_from(&(by_carried * gravity * (inverse_m * fallen)));
        row.fixed_columns_mut::<3>(5).copy_from(&(by_carried * (from.shift - to.shift) * inverse_m));
        let place = |state: &Free, place: &Vector3<f64>| {
            state.moved_by_gyr - (state.rotation * place).cross_matrix() * state.turned_by_gyr
        };
        let way = place(from, &host.2) - place(to, &view.2);
        let carried = way * inverse_m - looked.ray.cross_matrix() * from.turned_by_gyr;
        let turned = looked.basis.transpose() * looked.unit.cross_matrix() * to.turned_by_gyr;
        row.fixed_columns_mut::<3>(8).copy_from(&(by_carried * carried + turned));
        (row, by_carried * looked.way)
    }

    /// What is known before, whitened, with its derivative by the unknowns.
    fn known(&self) -> (Column, Column) {
        let Guess { velocity_m_s, gravity_m_s2, biases } = &self.guess;
        let tilt = across(&gravity_m_s2.normalize()).tr_mul(&(gravity_m_s2 - self.level)) / self.level.norm();
        let mut left = Column::zeros();
        left.fixed_rows_mut::<3>(0).copy_from(&(velocity_m_s / VELOCITY));
        left.fixed_rows_mut::<2>(3).copy_from(&(tilt / TILT));
        left.fixed_rows_mut::<3>(5).copy_from(&(biases.acc_m_s2 / ACC_BIAS));
        left.fixed_rows_mut::<3>(8).copy_from(&(biases.gyr_rad_s / GYR_BIAS));
        let one = |sigma: f64| 1.0 / sigma;
        let scales = [VELOCITY; 3].into_iter().chain([TILT; 2]).chain([ACC_BIAS; 3]).chain([GYR_BIAS; 3]);
        (left, Column::from_iterator(scales.map(one)))
    }

    /// Of all, at the guess.
    fn cost(&self) -> f64 {
        let mut cost = 0.5 * self.known().0.norm_squared();
        for (track, near) in self.tracks.iter().zip(&self.nears) {
            let [host, others @ ..] = &track[..] else { continue };
            cost += 0.5 * ((near.inverse_m - NEAR) / self.near_sigma).powi(2);
            cost += others
                .iter()
                .map(|view| self.look(host, view, near.inverse_m).map_or(BEHIND, |l| l.cost().0))
                .sum::<f64>();
        }
        cost
    }
}

/// Cost of a point that lies behind a camera that sees it.
const BEHIND: f64 = 200.0;

/// See [`Flight::look`].
struct Looked {
    ray: Vector3<f64>,
    way: Vector3<f64>,
    length: f64,
    unit: Vector3<f64>,
    basis: Matrix3x2<f64>,
    weight: f64,
    left: SVector<f64, 2>,
}

impl Looked {
    /// And the weight of its row.
    fn cost(&self) -> (f64, f64) {
        let (half, weight) = KERNEL.of(self.weight * self.left.norm_squared());
        (0.5 * half, weight * self.weight)
    }
}

impl Problem for Flight<'_> {
    fn dimension(&self) -> usize {
        UNKNOWNS
    }

    fn linearise(&mut self, damping: f64, normal: &mut Normal) -> f64 {
        self.refresh();
        let (left, scales) = self.known();
        let mut square = Square::from_diagonal(&scales.component_mul(&scales));
        let mut slope = scales.component_mul(&left);
        let mut nears = std::mem::take(&mut self.nears);
        for (track, near) in self.tracks.iter().zip(&mut nears) {
            let [host, others @ ..] = &track[..] else { continue };
            let prior = self.near_sigma.powi(-2);
            (near.square, near.slope) = (prior, prior * (near.inverse_m - NEAR));
            near.by_unknowns = Column::zeros();
            for view in others {
                let Some(looked) = self.look(host, view, near.inverse_m) else { continue };
                let weight = looked.cost().1;
                let (row, by_near) = self.derivatives(&looked, host, view, near.inverse_m);
                square += row.tr_mul(&row) * weight;
                slope += row.tr_mul(&looked.left) * weight;
                near.by_unknowns += row.tr_mul(&by_near) * weight;
                near.square += by_near.norm_squared() * weight;
                near.slope += by_near.dot(&looked.left) * weight;
            }
            near.square *= 1.0 + damping;
            square -= near.by_unknowns * near.by_unknowns.transpose() / near.square;
            slope -= near.by_unknowns * (near.slope / near.square);
        }
        self.nears = nears;
        normal.add_block(0, 0, &square);
        normal.add_gradient(0, &slope);
        self.cost()
    }

    fn step(&mut self, by: &[f64]) -> f64 {
        self.before = self.guess;
        let step = Column::from_column_slice(by);
        let three = |at: usize| step.fixed_rows::<3>(at).into_owned();
        let Guess { velocity_m_s, gravity_m_s2, biases } = &mut self.guess;
        *velocity_m_s += three(0);
        let strength = gravity_m_s2.norm();
        let down = gravity_m_s2.normalize();
        *gravity_m_s2 = (down + across(&down) * step.fixed_rows::<2>(3)).normalize() * strength;
        biases.acc_m_s2 += three(5);
        biases.gyr_rad_s += three(8);
        for near in &mut self.nears {
            near.before = near.inverse_m;
            let moved = -(near.slope + near.by_unknowns.dot(&step)) / near.square;
            near.inverse_m = (near.inverse_m + moved).clamp(NEARS.1, NEARS.0);
        }
        self.states = self.chain(self.guess.biases.gyr_rad_s);
        self.cost()
    }

    fn undo(&mut self) {
        self.guess = self.before;
        self.nears.iter_mut().for_each(|near| near.inverse_m = near.before);
    }
}

#[cfg(test)]
mod tests {
    use vergence_solve::numeric;
    use vergence_time::Span;

    use super::*;
    use crate::link::Held;
    use crate::params::{Inertial, Params};

    /// A hand that swings for 0.6 s past points 1.5 to 4 m away; a frame each 50 ms. Truth: velocity and gravity in the first frame's axes.
    struct Swing {
        links: Vec<Link>,
        tracks: Vec<Vec<View>>,
        velocity_m_s: Vector3<f64>,
        gravity_m_s2: Vector3<f64>,
    }

    const BIAS: Vector3<f64> = Vector3::new(0.03, -0.02, 0.04);
    const PLACE: Vector3<f64> = Vector3::new(0.03, -0.02, 0.05);

    fn swing() -> Swing {
        let params = Params { noise_factor: 1.0, ..Params::default() };
        let reading = |k: i32| {
            let t = f64::from(k) * 5e-3;
            let turn = Vector3::new(0.4 * (5.0 * t).sin(), 0.5 * (4.0 * t).cos(), 0.2);
            let push = Vector3::new(2.5 * (6.0 * t).cos(), 9.4 + 1.5 * (7.0 * t).sin(), 1.0);
            let span = Span::from_millis(5);
            Held { gyr_rad_s: turn + BIAS, acc_m_s2: push, span, saturated: false, missing: false }
        };
        let link = |n: i32| {
            let readings = (10 * n..10 * n + 10).map(reading).collect();
            Link::new(readings, Biases::default(), &params, &Inertial::EUROC).unwrap()
        };
        let links: Vec<Link> = (0..12).map(link).collect();
        let (velocity_m_s, gravity_m_s2) =
            (Vector3::new(0.6, -0.2, 0.3), Vector3::new(0.8, -9.7, 0.4).normalize() * 9.80665);
        // In a world that is the first frame's axes; links fall along its y axis.
        let upright = UnitQuaternion::rotation_between(&gravity_m_s2, &-Vector3::y()).unwrap();
        let mut pose = Rigid::from_parts(Vector3::zeros().into(), upright);
        let biases = Biases { gyr_rad_s: BIAS, ..Biases::default() };
        let mut motion = Motion { velocity_m_s: upright * velocity_m_s, biases };
        let mut poses = vec![pose];
        for link in &links {
            (pose, motion) = link.follow(&pose, &motion);
            poses.push(pose);
        }
        let point = |k: i32| {
            let k = f64::from(k);
            Vector3::new(1.5 * (1.7 * k).sin(), 1.2 * (2.3 * k).cos(), 2.75 + 1.25 * (0.9 * k).sin())
        };
        let seen = |frame: usize, point: &Vector3<f64>| {
            let world = upright * point - poses[frame].translation.vector;
            (frame, (poses[frame].rotation.inverse() * world - PLACE).normalize(), PLACE)
        };
        let tracks = (0..30).map(|k| (0..13).rev().map(|frame| seen(frame, &point(k))).collect()).collect();
        Swing { links, tracks, velocity_m_s, gravity_m_s2 }
    }

    fn flight(swing: &Swing) -> Flight<'_> {
        let level = Vector3::new(0.0, -9.80665, 0.0);
        Flight::new(swing.links.iter().collect(), swing.tracks.clone(), level, 1e-3)
    }

    #[test]
    fn a_swing_tells_velocity_gravity_and_bias() {
        let swing = swing();
        let mut flight = flight(&swing);
        let room = flight.in_a_room().unwrap();
        assert!((room.velocity_m_s - swing.velocity_m_s).norm() < 0.15, "{:?}", room.velocity_m_s);
        let found = flight.anywhere().unwrap();
        assert!((found.velocity_m_s - swing.velocity_m_s).norm() < 0.02, "{:?}", found.velocity_m_s);
        assert!(found.gravity_m_s2.angle(&swing.gravity_m_s2) < 0.01);
        assert!((found.biases.gyr_rad_s - BIAS).norm() < 0.005 && found.misfit < 0.2, "{found:?}");
        assert!(found.velocity_sigma_m_s < 0.1, "{}", found.velocity_sigma_m_s);
    }

    #[test]
    fn derivatives_are_the_numerical_ones() {
        let swing = swing();
        let mut flight = flight(&swing);
        let guess = Guess {
            velocity_m_s: Vector3::new(0.4, 0.1, 0.2),
            gravity_m_s2: Vector3::new(0.3, -9.7, -0.6).normalize() * 9.80665,
            // What its bias does to the accelerometer hangs on the gyroscope's a little, which is left out.
            biases: Biases { gyr_rad_s: Vector3::new(0.01, 0.02, -0.03), ..Biases::default() },
        };
        flight.guess = guess;
        flight.refresh();
        for (track, view, inverse_m) in [(0, 12, 0.3), (7, 5, 0.8), (20, 1, 0.45)] {
            let (host, view) = (swing.tracks[track][0], swing.tracks[track][view]);
            flight.guess = guess;
            flight.refresh();
            let looked = flight.look(&host, &view, inverse_m).unwrap();
            let (row, by_near) = flight.derivatives(&looked, &host, &view, inverse_m);
            let mut moved = |by: &Column| {
                flight.guess = guess;
                flight.nears.clear();
                let _ = flight.step(by.as_slice());
                flight.look(&host, &view, inverse_m).unwrap().left
            };
            let numeric_row = numeric::jacobian(1e-4, |by| moved(by));
            assert!(numeric::error(&row, &numeric_row) < 1e-5, "{row}{numeric_row}");
            flight.guess = guess;
            flight.refresh();
            let nearer = |by: &SVector<f64, 1>| flight.look(&host, &view, inverse_m + by.x).unwrap().left;
            assert!(numeric::error(&by_near, &numeric::jacobian(1e-4, nearer)) < 1e-7);
        }
    }
}
