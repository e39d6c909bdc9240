//! Where there is one camera and nothing says how far anything is: the first relative pose from two views.

use nalgebra::{SVector, UnitQuaternion, Vector3};
use vergence_geom::{Rigid, advance};
use vergence_solve::{Kernel, Normal, Options, Problem, minimise};

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
