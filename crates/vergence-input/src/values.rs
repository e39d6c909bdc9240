//! Readings out of plain numbers, as serial and HID devices give them.

use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion, UnitVector3, Vector3};
use vergence_geom::Rigid;
use vergence_sense::{Axis, Button, Gaze, Imu, Pose, Reading, ReadingKind, Scalar, Vector2};

/// A reading out of its numbers; `None` where they are none, unless the kind has a value for that.
pub(crate) fn reading(kind: ReadingKind, values: &[f64]) -> Option<Reading<'static>> {
    let finite = |value: &f64| value.is_finite();
    let three = |from: usize| {
        let three = values.get(from..from + 3)?;
        three.iter().all(finite).then(|| Vector3::from_column_slice(three))
    };
    let single = |index: usize| values.get(index).filter(|value| finite(value)).map(|value| *value as f32);
    Some(match kind {
        ReadingKind::Imu => Reading::Imu(Imu { gyr_rad_s: three(0)?, acc_m_s2: three(3)?, mag_ut: three(6) }),
        ReadingKind::Scalar => Reading::Scalar(Scalar(*values.first().filter(|value| finite(value))?)),
        ReadingKind::Axis => Reading::Axis(Axis(single(0))),
        ReadingKind::Button => {
            Reading::Button(Button(values.first().filter(|value| finite(value)).map(|value| *value != 0.0)))
        }
        ReadingKind::Vector2 => Reading::Vector2(Vector2(single(0).zip(single(1)).map(|(x, y)| [x, y]))),
        ReadingKind::Gaze => {
            let direction = three(3).and_then(|direction| UnitVector3::try_new(direction, 1e-9));
            let direction = direction.filter(|direction| direction.iter().all(finite));
            let gaze = three(0).zip(direction);
            Reading::Gaze(gaze.map(|(origin, direction)| Gaze { origin: Point3::from(origin), direction }))
        }
        ReadingKind::Pose => {
            let &[.., x, y, z, w] = values else { return None };
            let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9)?;
            let tracked = three(0).filter(|_| rotation.coords.iter().all(finite)).map(|translation| {
                Pose::tracked(Rigid { rotation, translation: Translation3::from(translation) })
            });
            Reading::Pose(tracked.unwrap_or(Pose::LOST))
        }
        ReadingKind::Touch | ReadingKind::Image | ReadingKind::Event => return None,
    })
}
