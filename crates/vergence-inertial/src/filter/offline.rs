//! The acausal variant of `vergence`: a recording seen from both ends.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_sense::Imu;
use vergence_time::{Span, Timestamp};

use super::turn::headed;
use super::{Axes, Filter, Limits, Stream, Vergence, VergenceParams};

fn pass(
    filter: &mut Stream<Vergence>,
    samples: impl Iterator<Item = (Timestamp, Imu)>,
) -> Vec<UnitQuaternion<f64>> {
    samples
        .map(|(at, imu)| {
            filter.update(at, &imu);
            filter.earth_from_sensor()
        })
        .collect()
}

/// Orientations of a whole recording, each from all samples before and after it: the filter runs forwards to learn the sensors,
/// then backwards and forwards once more with what it learned; the answer lies half way between the last two. Six axes: the
/// heading starts at zero.
///
/// Costs three times what the causal filter does, and memory for two orientations per sample.
pub fn offline(
    params: VergenceParams,
    axes: Axes,
    period: Span,
    samples: &[(Timestamp, Imu)],
) -> Vec<UnitQuaternion<f64>> {
    let Some(last) = samples.last() else {
        return Vec::new();
    };
    let stream = |core| Stream::new(core, axes, period, Limits::default());
    let mut learning = stream(Vergence::new(params, period.as_secs_f64()));
    for (at, imu) in samples {
        learning.update(*at, imu);
    }
    let mut backwards = stream(learning.core().learned(params.mirrored(period.as_secs_f64()), true));
    let turned = samples.iter().rev().map(|(at, imu)| {
        let nanos = last.0.as_nanos().saturating_sub(at.as_nanos());
        (Timestamp::from_nanos(nanos), Imu { gyr_rad_s: -imu.gyr_rad_s, ..*imu })
    });
    let mut from_end = pass(&mut backwards, turned);
    from_end.reverse();
    let mut forwards = stream(backwards.core().learned(params, true));
    let from_start = pass(&mut forwards, samples.iter().copied());
    let between = |(a, b): (&UnitQuaternion<f64>, &UnitQuaternion<f64>)| *a * b.inverse();
    let heading = |e: UnitQuaternion<f64>| 2.0 * e.k.atan2(e.w);
    // Without a magnetometer the two know nothing of each other's north.
    let aligned = if axes == Axes::Six {
        let (sine, cosine) = from_start
            .iter()
            .zip(&from_end)
            .map(between)
            .map(heading)
            .fold((0.0, 0.0), |(sine, cosine), angle| (sine + angle.sin(), cosine + angle.cos()));
        sine.atan2(cosine)
    } else {
        0.0
    };
    from_start
        .iter()
        .zip(&from_end)
        .map(|(a, b)| {
            let half: Vector3<f64> = between((&headed(aligned, b), a)).scaled_axis() * 0.5;
            UnitQuaternion::new_normalize(super::turn::turn(&half) * a.into_inner())
        })
        .collect()
}
