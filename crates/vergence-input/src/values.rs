//! Readings out of plain numbers, as serial and HID devices give them.

use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion, UnitVector3, Vector3};
use vergence_geom::Rigid;
use vergence_sense::{Axis, Button, Gaze, Imu, Pose, Reading, ReadingKind, Scalar, Vector2};

/// A reading out of its numbers; `None` where they are none.
pub(crate) fn reading(kind: ReadingKind, values: &[f64]) -> Option<Reading<'static>> {
    let three = |from: usize| Some(Vector3::from_column_slice(values.get(from..from + 3)?));
    let single = |index: usize| Some(*values.get(index)? as f32);
    Some(match kind {
        ReadingKind::Imu => Reading::Imu(Imu { gyr_rad_s: three(0)?, acc_m_s2: three(3)?, mag_ut: three(6) }),
        ReadingKind::Scalar => Reading::Scalar(Scalar(*values.first()?)),
        ReadingKind::Axis => Reading::Axis(Axis(Some(single(0)?))),
        ReadingKind::Button => Reading::Button(Button(Some(*values.first()? != 0.0))),
        ReadingKind::Vector2 => Reading::Vector2(Vector2(Some([single(0)?, single(1)?]))),
        ReadingKind::Gaze => Reading::Gaze(Gaze {
            origin: Point3::from(three(0)?),
            direction: UnitVector3::try_new(three(3)?, 1e-9).filter(|d| d.iter().all(|x| x.is_finite()))?,
        }),
        ReadingKind::Pose => {
            let &[.., x, y, z, w] = values else { return None };
            let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9)?;
            let translation = Translation3::from(three(0)?);
            let finite = translation.vector.iter().chain(rotation.coords.iter()).all(|x| x.is_finite());
            Reading::Pose(if finite { Pose::tracked(Rigid { rotation, translation }) } else { Pose::LOST })
        }
        ReadingKind::Touch | ReadingKind::Image | ReadingKind::Event => return None,
    })
}
