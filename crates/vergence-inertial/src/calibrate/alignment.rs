//! How a sensor is turned against the gyroscope: directions that stand still in the world turn back in both as the unit
//! turns.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use vergence_geom::{advance, exp};

/// Sensors of one unit are turned against each other by about this, rad, before anything is seen.
pub(super) const PRIOR_RAD: f64 = 0.05;

/// A rotation counts as seen where its deviation is less than this, rad: half a degree …
const ENOUGH_RAD: f64 = 0.01;
/// … and where as many turns told it: of fewer, what is left of them does not say what they are worth.
const LEAST_TURNS: usize = 4;

/// Two rests and the turn between them.
pub(super) struct Turn {
    /// A direction that is constant in the world, as the sensor saw it before, of unit length …
    pub from: Vector3<f64>,
    /// … and after.
    pub to: Vector3<f64>,
    /// The unit before from the unit after, as the gyroscope saw it.
    pub from_to: UnitQuaternion<f64>,
}

/// A sensor against the gyroscope.
pub(super) struct Alignment {
    /// The sensor from the gyroscope: about the axes that were not seen, not turned at all.
    pub sensor_from_unit: UnitQuaternion<f64>,
    /// Standard deviations of its rotation vector, rad.
    pub deviations: Vector3<f64>,
    /// About which axes it was seen.
    pub seen: [bool; 3],
}

/// The rotation between a sensor and the gyroscope. Without turns: none, ± the prior. Where the sensor's own errors are not
/// all `known`, a direction that it sees may be off by as much as the prior, and so may the rotation that they tell.
pub(super) fn align(turns: &[Turn], known: bool) -> Alignment {
    let (sensor_from_unit, deviations) = solve(turns);
    let seen =
        std::array::from_fn(|axis| known && turns.len() >= LEAST_TURNS && deviations[axis] < ENOUGH_RAD);
    let deviations = if known { deviations } else { Vector3::repeat(PRIOR_RAD) };
    let vector = vergence_geom::log(&sensor_from_unit);
    let told = Vector3::from_fn(|axis, _| if seen[axis] { vector[axis] } else { 0.0 });
    Alignment { sensor_from_unit: exp(&told), deviations, seen }
}

/// The rotation that fits all turns best, and its standard deviations.
fn solve(turns: &[Turn]) -> (UnitQuaternion<f64>, Vector3<f64>) {
    let mut sensor_from_unit = UnitQuaternion::identity();
    let mut deviations = Vector3::repeat(PRIOR_RAD);
    let mut variance = 1e-4;
    for _ in 0..10 {
        let mut information = Matrix3::from_diagonal_element(PRIOR_RAD.powi(-2));
        let mut gradient = -vergence_geom::log(&sensor_from_unit) * PRIOR_RAD.powi(-2);
        let mut squares = 0.0;
        for turn in turns {
            let around = sensor_from_unit * turn.from_to * sensor_from_unit.inverse();
            let foreseen = around * turn.to;
            let left = turn.from - foreseen;
            // A small rotation on the left of `sensor_from_unit` turns the axis of the turn.
            let by =
                -foreseen.cross_matrix() + around.to_rotation_matrix().into_inner() * turn.to.cross_matrix();
            information += by.transpose() * by / variance;
            gradient += by.transpose() * left / variance;
            squares += left.norm_squared();
        }
        let Some(inverse) = information.try_inverse() else { break };
        sensor_from_unit = advance(&exp(&(inverse * gradient)), &vergence_geom::log(&sensor_from_unit));
        // Each turn tells two numbers.
        let freedom = (2.0 * turns.len() as f64 - 3.0).max(1.0);
        variance = (squares / freedom).max(1e-12);
        deviations = inverse.diagonal().map(|v| v.sqrt().min(PRIOR_RAD));
        if turns.len() < 2 {
            break;
        }
    }
    (sensor_from_unit, deviations)
}
