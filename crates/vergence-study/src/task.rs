//! Where targets stand: the same definitions in a headset and on a desktop. Metres, x right, y up, −z forward.

use crate::trial::Point;

/// A plane of rings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Plane {
    /// Upright, facing the viewer.
    Xy,
    /// Upright, seen from its edge: movements in height and depth.
    Yz,
    /// Level: movements sideways and in depth.
    Zx,
    /// Any other: [`Plane::Xy`] with its top leaned away, then turned about the vertical.
    Turned {
        /// How far its right side is turned away, radians ([`Plane::Yz`]: a quarter turn).
        yaw_rad: f64,
        /// How far its top is leaned away, radians ([`Plane::Zx`]: a quarter turn).
        pitch_rad: f64,
    },
}

impl Plane {
    /// In words.
    pub fn described(self) -> String {
        match self {
            Self::Xy => "upright, facing the viewer".to_owned(),
            Self::Yz => "upright, seen from its edge".to_owned(),
            Self::Zx => "level".to_owned(),
            Self::Turned { yaw_rad, pitch_rad } => format!(
                "its right side turned away by {:.1} and its top leaned away by {:.1} degrees",
                yaw_rad.to_degrees(),
                pitch_rad.to_degrees()
            ),
        }
    }

    /// The place of `right` and `up` in this plane, of which `up` is towards the ring's first target.
    pub fn place(self, right: f64, up: f64) -> Point {
        match self {
            // Exactly where they are: sines of quarter turns are not exact.
            Self::Xy => [right, up, 0.0],
            Self::Yz => [0.0, up, -right],
            Self::Zx => [right, 0.0, -up],
            Self::Turned { yaw_rad, pitch_rad } => {
                let ((sy, cy), (sp, cp)) = (yaw_rad.sin_cos(), pitch_rad.sin_cos());
                [right * cy - up * sp * sy, up * cp, -right * sy - up * sp * cy]
            }
        }
    }
}

/// What kind of task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Geometry {
    /// Two targets, left and right, in turn (Fitts 1954).
    Reciprocal,
    /// An odd number of targets on a circle, each opposite to the one before (ISO 9241-411).
    Ring {
        /// How many.
        targets: u32,
        /// In which plane.
        plane: Plane,
    },
    /// Balls near and far in turn, along the line of sight.
    Depth,
    /// A ring on a sphere around the viewer: amplitude and width are angles, the amplitude that between opposite targets.
    Ray {
        /// How many.
        targets: u32,
        /// Radius of the sphere, metres.
        distance: f64,
    },
    /// A straight tunnel from left to right and back: amplitude is its length, width its width.
    Steering,
    /// Targets at the left and the right edge of the screen, of unbounded width along the axis: effective measures only.
    Edge,
    /// Targets in the lower left and the upper right corner of the screen, unbounded to both sides away from the middle:
    /// effective measures only. The amplitude is the distance of the corners.
    Corner,
}

impl Geometry {
    /// Whether targets have no width along the axis, since nobody can go too far.
    pub fn is_unbounded(self) -> bool {
        matches!(self, Self::Edge | Self::Corner)
    }
}

/// One place to go to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Its centre, relative to the task's centre (for [`Geometry::Ray`] to the viewer), metres.
    pub centre: Point,
    /// Its extent along the axis, metres (radians for [`Geometry::Ray`]); none where unbounded.
    pub width: Option<f64>,
}

/// The targets in the order of presentation: the first is the start, so there is one more than movements in a round.
/// `amplitude` is the layout's (its diameter), in metres or for [`Geometry::Ray`] radians.
pub fn layout(geometry: Geometry, amplitude: f64, width: f64) -> Vec<Target> {
    let half = 0.5 * amplitude;
    let target = |centre: Point| Target { centre, width: (!geometry.is_unbounded()).then_some(width) };
    match geometry {
        Geometry::Reciprocal | Geometry::Steering | Geometry::Edge => {
            [-half, half, -half].into_iter().map(|x| target([x, 0.0, 0.0])).collect()
        }
        Geometry::Corner => {
            let side = half * std::f64::consts::FRAC_1_SQRT_2;
            [-side, side, -side].into_iter().map(|at| target([at, at, 0.0])).collect()
        }
        Geometry::Depth => [half, -half, half].into_iter().map(|z| target([0.0, 0.0, z])).collect(),
        Geometry::Ring { targets, plane } => {
            let place = |angle: f64| plane.place(half * angle.sin(), half * angle.cos());
            opposite(targets).map(|angle| target(place(angle))).collect()
        }
        Geometry::Ray { targets, distance } => {
            let place = |angle: f64| {
                let (off, forward) = (half.sin(), half.cos());
                [off * angle.sin(), off * angle.cos(), -forward].map(|value| distance * value)
            };
            opposite(targets).map(|angle| target(place(angle))).collect()
        }
    }
}

/// Angles from the top, clockwise, in the order of presentation: half a turn (and half a step) further each time.
fn opposite(targets: u32) -> impl Iterator<Item = f64> {
    let n = u64::from(targets.max(1));
    (0..=n).map(move |i| (i * n.div_ceil(2) % n) as f64 / n as f64 * std::f64::consts::TAU)
}

/// The real distance between successive targets of a ring: below its diameter by cos(π/2n) where n is odd.
pub fn real_amplitude(diameter: f64, targets: u32) -> f64 {
    let n = f64::from(targets.max(1));
    if targets % 2 == 1 { diameter * (std::f64::consts::FRAC_PI_2 / n).cos() } else { diameter }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn distance(a: Point, b: Point) -> f64 {
        (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn a_ring_visits_every_target_at_the_real_amplitude() {
        let turned = Plane::Turned { yaw_rad: 0.7, pitch_rad: -1.1 };
        for plane in [Plane::Xy, Plane::Yz, Plane::Zx, turned] {
            for targets in [3, 9, 11, 25] {
                let ring = layout(Geometry::Ring { targets, plane }, 0.4, 0.02);
                assert_eq!(ring.len(), targets as usize + 1);
                assert!(distance(ring[0].centre, ring[targets as usize].centre) < 1e-12);
                for pair in ring.windows(2) {
                    let found = distance(pair[0].centre, pair[1].centre);
                    assert!(
                        (found - real_amplitude(0.4, targets)).abs() < 1e-12,
                        "{plane:?} {targets}: {found}"
                    );
                }
                for (i, a) in ring[1..].iter().enumerate() {
                    assert!(ring[i + 2..].iter().all(|b| distance(a.centre, b.centre) > 1e-3));
                }
            }
        }
    }

    #[test]
    fn quarter_turns_are_the_planes_with_names() {
        let quarter = std::f64::consts::FRAC_PI_2;
        for (plane, yaw_rad, pitch_rad) in
            [(Plane::Xy, 0.0, 0.0), (Plane::Yz, quarter, 0.0), (Plane::Zx, 0.0, quarter)]
        {
            let turned = Plane::Turned { yaw_rad, pitch_rad };
            assert!(distance(plane.place(0.3, 0.2), turned.place(0.3, 0.2)) < 1e-15, "{plane:?}");
        }
    }

    #[test]
    fn corners_are_apart_as_the_amplitude_says() {
        let corners = layout(Geometry::Corner, 0.3, 0.0);
        assert!((distance(corners[0].centre, corners[1].centre) - 0.3).abs() < 1e-15);
        assert!(corners[0].centre[0] < 0.0 && corners[0].centre[1] < 0.0);
        assert_eq!((corners[1].width, corners[2]), (None, corners[0]));
    }

    #[test]
    fn rays_are_angles() {
        let ring = layout(Geometry::Ray { targets: 9, distance: 2.0 }, 0.5, 0.05);
        for target in &ring {
            assert!((distance(target.centre, [0.0; 3]) - 2.0).abs() < 1e-12);
            let from_ahead = (-target.centre[2] / 2.0).acos();
            assert!((from_ahead - 0.25).abs() < 1e-12);
        }
        assert_eq!(layout(Geometry::Edge, 0.3, 0.01)[0].width, None);
        assert_eq!(layout(Geometry::Reciprocal, 0.3, 0.01)[1].centre, [0.15, 0.0, 0.0]);
    }
}
