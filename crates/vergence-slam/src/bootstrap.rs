//! Where there is one camera and nothing says how far anything is: the first relative pose from two views, and velocity and gravity from
//! views and inertial readings.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};
use vergence_geom::{Rigid, advance};
use vergence_inertial::preintegrate::Biases;
use vergence_solve::{Kernel, Normal, Options, Problem, minimise};

use crate::link::{Link, Motion};
use crate::sighting::across;

/// Directions of one corner in two cameras.
pub(crate) type Pair = (Vector3<f64>, Vector3<f64>);

/// Rotation and direction of translation between two views, by the angles between each ray and its epipolar plane.
struct TwoViews<'a> {
    pairs: &'a [Pair],
    /// First camera from second.
    rotation: UnitQuaternion<f64>,
    way: Vector3<f64>,
    before: (UnitQuaternion<f64>, Vector3<f64>),
    kernel: Kernel,
    /// One over the standard deviation of a direction, 1/rad.
    weight: f64,
}

impl TwoViews<'_> {
    fn each(&self, pair: &Pair) -> (f64, SVector<f64, 5>) {
        let second = self.rotation * pair.1;
        let normal = second.cross(&self.way);
        let value = pair.0.dot(&normal);
        // The length of the normal changes slowly: its derivative is left out.
        let scale = self.weight / normal.norm().max(1e-3);
        // Turning the second view by w (right): second + rotation (w × pair.1).
        let local = self.rotation.inverse() * self.way.cross(&pair.0);
        let by_turn = pair.1.cross(&local);
        let by_way = across(&self.way).transpose() * pair.0.cross(&second);
        let mut slope = SVector::<f64, 5>::zeros();
        slope.fixed_rows_mut::<3>(0).copy_from(&(by_turn * scale));
        slope.fixed_rows_mut::<2>(3).copy_from(&(by_way * scale));
        (value * scale, slope)
    }

    fn cost(&self) -> f64 {
        self.pairs.iter().map(|p| 0.5 * self.kernel.of(self.each(p).0.powi(2)).0).sum()
    }
}

impl Problem for TwoViews<'_> {
    fn dimension(&self) -> usize {
        5
    }

    fn linearise(&mut self, _: f64, normal: &mut Normal) -> f64 {
        for pair in self.pairs {
            let (value, slope) = self.each(pair);
            let (_, weight) = self.kernel.of(value * value);
            normal.add_square(0, &slope.transpose(), &SVector::<f64, 1>::new(value), weight);
        }
        self.cost()
    }

    fn step(&mut self, by: &[f64]) -> f64 {
        self.before = (self.rotation, self.way);
        self.rotation = advance(&self.rotation, &Vector3::from_column_slice(&by[..3]));
        let basis = across(&self.way);
        self.way = (self.way + basis * nalgebra::Vector2::new(by[3], by[4])).normalize();
        self.cost()
    }

    fn undo(&mut self) {
        (self.rotation, self.way) = self.before;
    }
}

/// Distances along both rays to where they come nearest, for `first_from_second` with a translation of any length.
fn distances(pair: &Pair, first_from_second: &Rigid) -> (f64, f64) {
    let second = first_from_second.rotation * pair.1;
    let way = first_from_second.translation.vector;
    let (cross, square) = (pair.0.dot(&second), 1.0 - pair.0.dot(&second).powi(2));
    let (a, b) = (pair.0.dot(&way), second.dot(&way));
    ((a - cross * b) / square.max(1e-12), (cross * a - b) / square.max(1e-12))
}

/// First camera from second camera, with a translation such that the middle distance is 2 m (no one knows how far anything is), from
/// corners that both see; `None` where they do not determine it. `rad` is the standard deviation of a direction.
pub(crate) fn two_views(pairs: &[Pair], rad: f64) -> Option<Rigid> {
    const LEAST: usize = 20;
    if pairs.len() < LEAST {
        return None;
    }
    let mut best: Option<(f64, UnitQuaternion<f64>, Vector3<f64>)> = None;
    // The cost has several minima; thirteen directions (no sign is needed yet) find the lowest.
    for x in -1i32..=1 {
        for y in -1i32..=1 {
            for z in 0i32..=1 {
                let way = Vector3::new(f64::from(x), f64::from(y), f64::from(z));
                if way == Vector3::zeros() || (z == 0 && (y < 0 || (y == 0 && x < 0))) {
                    continue;
                }
                let mut views = TwoViews {
                    pairs,
                    rotation: UnitQuaternion::identity(),
                    way: way.normalize(),
                    before: (UnitQuaternion::identity(), way),
                    kernel: Kernel::Cauchy(2.0),
                    weight: 1.0 / rad,
                };
                let report = minimise(
                    &mut views,
                    &mut Normal::default(),
                    &Options { iterations: 25, ..Options::default() },
                );
                if best.as_ref().is_none_or(|b| report.cost < b.0) {
                    best = Some((report.cost, views.rotation, views.way));
                }
            }
        }
    }
    let (_, rotation, way) = best?;
    let mut found = None;
    for sign in [1.0, -1.0] {
        let pose = Rigid::from_parts((way * sign).into(), rotation);
        let mut near: Vec<f64> = pairs
            .iter()
            .map(|p| distances(p, &pose))
            .filter(|(a, b)| *a > 0.0 && *b > 0.0)
            .map(|d| d.0)
            .collect();
        if near.len() * 10 > pairs.len() * 8 {
            let middle = near.len() / 2;
            let middle = *near.select_nth_unstable_by(middle, f64::total_cmp).1;
            found = Some((pose, middle));
        }
    }
    let (mut pose, middle) = found?;
    // Rays that meet at less than a degree in the middle do not say where.
    if middle > 60.0 {
        return None;
    }
    pose.translation.vector *= 2.0 / middle;
    Some(pose)
}

/// How a frame sees a track: frame, direction in the body, the camera's place on the body.
pub(crate) type View = (usize, Vector3<f64>, Vector3<f64>);

/// Frames from the first on: the links from each to the next, and for each track its directions in body axes and the camera's place
/// on the body, by frame.
pub(crate) struct Flight<'a> {
    pub(crate) links: Vec<&'a Link>,
    pub(crate) tracks: Vec<Vec<View>>,
    pub(crate) gravity_m_s2: f64,
    /// Standard deviation of a direction, rad.
    pub(crate) rad: f64,
}

/// What the first frame is found to be, in its own axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    pub(crate) velocity_m_s: Vector3<f64>,
    pub(crate) gravity_m_s2: Vector3<f64>,
    pub(crate) gyr_bias_rad_s: Vector3<f64>,
    pub(crate) acc_bias_m_s2: Vector3<f64>,
    /// Standard deviation of the velocity, m/s.
    pub(crate) velocity_sigma_m_s: f64,
    /// Root mean square of the angles left, in standard deviations.
    pub(crate) misfit: f64,
}

type Matrix9 = SMatrix<f64, 9, 9>;
type Vector9 = SVector<f64, 9>;

/// Standard deviation of the accelerometer's bias, m/s²: what is known of it before.
const ACC_BIAS: f64 = 0.1;

/// Of one gyroscope's bias: velocity, gravity and accelerometer's bias, the cost there, its curvature, and of how many numbers.
struct Solved {
    cost: f64,
    x: Vector9,
    square: Matrix9,
    count: f64,
    /// Of each view of each track, m; negative: behind.
    distances: Vec<f64>,
}

/// Distances that stand for the unknown ones at first; the nearest and the farthest that are believed, m.
const DISTANCE_M: f64 = 2.0;
const DISTANCES_M: (f64, f64) = (0.2, 50.0);
/// Solutions with the distances of the one before.
const ROUNDS: usize = 4;

impl Flight<'_> {
    /// Cost, velocity, gravity and the accelerometer's bias where the gyroscope's bias is this and each view's point lies so far away;
    /// everything else is linear. After A. Martinelli, "Closed-Form Solution of Visual-Inertial Structure from Motion", IJCV 2014,
    /// with gravity's strength known and a prior of the accelerometer's bias. What is left across a ray is divided by the distance along
    /// it: metres alone are fewer the smaller everything is taken to be.
    fn at(&self, bias: &Vector3<f64>, far: &[f64]) -> Option<Solved> {
        let chain = |acc: Vector3<f64>| {
            let biases = Biases { gyr_rad_s: *bias, acc_m_s2: acc };
            let mut states = vec![(UnitQuaternion::identity(), Vector3::zeros(), 0.0)];
            let (mut pose, mut motion, mut t) =
                (Rigid::identity(), Motion { biases, ..Motion::default() }, 0.0);
            for link in &self.links {
                (pose, motion) = link.follow_free(&pose, &motion);
                t += link.seconds();
                states.push((pose.rotation, pose.translation.vector, t));
            }
            states
        };
        let states = chain(Vector3::zeros());
        let shifted: [_; 3] = std::array::from_fn(|i| chain(Vector3::ith(i, 1.0)));
        let (mut square, mut slope, mut constant, mut count) =
            (Matrix9::zeros(), Vector9::zeros(), 0.0, 0usize);
        let mut placed = Vec::with_capacity(self.tracks.len());
        let mut view = 0;
        for track in &self.tracks {
            let (mut n, mut na, mut nc) = (Matrix3::zeros(), SMatrix::<f64, 3, 9>::zeros(), Vector3::zeros());
            let (mut aa, mut ac, mut cc) = (Matrix9::zeros(), Vector9::zeros(), 0.0);
            for (frame, direction, place) in track {
                let (rotation, moved, t) = states.get(*frame)?;
                let ray = rotation * direction;
                let p = (Matrix3::identity() - ray * ray.transpose()) / (far[view] * far[view]);
                view += 1;
                let mut a = SMatrix::<f64, 3, 9>::zeros();
                a.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(*t);
                a.fixed_view_mut::<3, 3>(0, 3).fill_diagonal(0.5 * t * t);
                for (i, shifted) in shifted.iter().enumerate() {
                    a.set_column(6 + i, &(shifted[*frame].1 - moved));
                }
                let c = moved + rotation * place;
                let pa = p * a;
                n += p;
                na += pa;
                nc += p * c;
                aa += a.tr_mul(&pa);
                ac += pa.tr_mul(&c);
                cc += c.dot(&(p * c));
                count += 2;
            }
            let inverse = n.try_inverse()?;
            placed.push((inverse * na, inverse * nc));
            let cross = na.transpose() * inverse;
            square += aa - cross * na;
            slope += ac - cross * nc;
            constant += cc - nc.dot(&(inverse * nc));
        }
        // Costs are in squares of angles: a sigma of the bias is worth one of a direction.
        let prior = (self.rad / ACC_BIAS).powi(2);
        for i in 6..9 {
            square[(i, i)] += prior;
        }
        // Gravity's strength is known: Newton's steps along the sphere.
        let mut x = -(square.try_inverse()? * slope);
        let mut gravity = x.fixed_rows::<3>(3).try_normalize(1e-9)? * self.gravity_m_s2;
        for _ in 0..8 {
            x.fixed_rows_mut::<3>(3).copy_from(&gravity);
            let basis = across(&gravity.normalize());
            let mut onto = SMatrix::<f64, 9, 8>::zeros();
            onto.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(1.0);
            onto.fixed_view_mut::<3, 2>(3, 3).copy_from(&basis);
            onto.fixed_view_mut::<3, 3>(6, 5).fill_diagonal(1.0);
            let gradient = onto.tr_mul(&(square * x + slope));
            let step = -((onto.transpose() * square * onto).try_inverse()? * gradient);
            x += onto * step;
            gravity = x.fixed_rows::<3>(3).normalize() * self.gravity_m_s2;
        }
        x.fixed_rows_mut::<3>(3).copy_from(&gravity);
        let cost = x.dot(&(square * x)) + 2.0 * slope.dot(&x) + constant;
        let mut distances = Vec::with_capacity(far.len());
        for (track, (by_x, fixed)) in self.tracks.iter().zip(&placed) {
            let point = by_x * x + fixed;
            for (frame, direction, place) in track {
                let (rotation, moved, t) = states.get(*frame)?;
                let along = (0..3).map(|i| (shifted[i][*frame].1 - moved) * x[6 + i]).sum::<Vector3<f64>>();
                let body = moved + x.fixed_rows::<3>(0) * *t + x.fixed_rows::<3>(3) * (0.5 * t * t) + along;
                distances.push((rotation * direction).dot(&(point - body - rotation * place)));
            }
        }
        Some(Solved { cost, x, square, count: count as f64, distances })
    }

    /// Velocity, gravity and biases; each round knows from the one before how far the points are.
    pub(crate) fn start(&self, guess: &Vector3<f64>) -> Option<Start> {
        let views = self.tracks.iter().map(Vec::len).sum();
        let (mut bias, mut far) = (*guess, vec![DISTANCE_M; views]);
        let mut found = None;
        for _ in 0..ROUNDS {
            let at = self.least(&mut bias, &far)?;
            far.clear();
            far.extend(at.distances.iter().map(|d| d.clamp(DISTANCES_M.0, DISTANCES_M.1)));
            found = Some(at);
        }
        let at = found?;
        let behind = at.distances.iter().filter(|d| **d <= 0.0).count();
        if behind * 10 > views {
            return None;
        }
        let covariance = at.square.try_inverse()? * (self.rad * self.rad);
        let three = |i: usize| at.x.fixed_rows::<3>(i).into_owned();
        Some(Start {
            velocity_m_s: three(0),
            gravity_m_s2: three(3),
            gyr_bias_rad_s: bias,
            acc_bias_m_s2: three(6),
            velocity_sigma_m_s: covariance.fixed_view::<3, 3>(0, 0).trace().max(0.0).sqrt(),
            misfit: (at.cost.max(0.0) / at.count.max(1.0)).sqrt() / self.rad,
        })
    }

    /// The gyroscope's bias by damped Newton steps over numerical derivatives of the whole, from what it is.
    fn least(&self, bias: &mut Vector3<f64>, far: &[f64]) -> Option<Solved> {
        const H: f64 = 1e-3;
        let mut at = self.at(bias, far)?;
        let mut damping = 1e-3;
        for _ in 0..12 {
            let f = |v: Vector3<f64>| self.at(&(*bias + v), far).map(|r| r.cost);
            let axis = |i: usize| Vector3::ith(i, H);
            let (mut gradient, mut curvature) = (Vector3::zeros(), Matrix3::zeros());
            for i in 0..3 {
                let (plus, minus) = (f(axis(i))?, f(-axis(i))?);
                gradient[i] = (plus - minus) / (2.0 * H);
                curvature[(i, i)] = (plus + minus - 2.0 * at.cost) / (H * H);
                for j in 0..i {
                    let cross = (f(axis(i) + axis(j))? - f(axis(i) - axis(j))? - f(axis(j) - axis(i))?
                        + f(-axis(i) - axis(j))?)
                        / (4.0 * H * H);
                    curvature[(i, j)] = cross;
                    curvature[(j, i)] = cross;
                }
            }
            let size = curvature.diagonal().amax().max(1e-12);
            let mut moved = None;
            while damping < 1e3 && moved.is_none() {
                let damped = curvature + Matrix3::identity() * (damping * size);
                if let Some(factored) = damped.cholesky() {
                    let step = -factored.solve(&gradient);
                    let step = step * (0.1 / step.norm().max(0.1));
                    moved = self
                        .at(&(*bias + step), far)
                        .filter(|next| next.cost < at.cost)
                        .map(|next| (step, next));
                }
                damping *= if moved.is_some() { 0.1 } else { 10.0 };
            }
            let Some((step, next)) = moved else { break };
            *bias += step;
            at = next;
            if step.norm() < 1e-5 {
                break;
            }
        }
        Some(at)
    }
}

#[cfg(test)]
mod tests {
    use vergence_geom::exp;

    use super::*;

    fn points() -> Vec<Vector3<f64>> {
        (0..60)
            .map(|k| {
                let k = f64::from(k);
                Vector3::new((k * 1.7).sin() * 2.0, (k * 2.3).cos() * 1.5, 3.0 + (k * 0.9).sin())
            })
            .collect()
    }

    #[test]
    fn two_views_give_the_relative_pose() {
        for (turn, way) in [
            (Vector3::new(0.05, -0.1, 0.02), Vector3::new(0.3, 0.05, 0.0)),
            (Vector3::new(0.0, 0.1, 0.0), Vector3::new(0.0, 0.1, 0.3)),
            (Vector3::new(-0.1, 0.0, 0.1), Vector3::new(-0.1, -0.3, -0.1)),
        ] {
            let truth = Rigid::from_parts(way.into(), exp(&turn));
            let pairs: Vec<Pair> = points()
                .iter()
                .map(|p| (p.normalize(), (truth.inverse() * nalgebra::Point3::from(*p)).coords.normalize()))
                .collect();
            let found = two_views(&pairs, 1e-3).unwrap();
            assert!(found.rotation.angle_to(&truth.rotation) < 1e-5);
            assert!((found.translation.vector.normalize() - way.normalize()).norm() < 1e-4);
            // No parallax: nothing is said.
            let turned: Vec<Pair> = pairs.iter().map(|p| (p.0, exp(&turn).inverse() * p.0)).collect();
            assert!(two_views(&turned, 1e-3).is_none());
        }
    }
}
