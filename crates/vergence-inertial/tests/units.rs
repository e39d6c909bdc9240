//! `vergence` with units as they are: sensors of different rates, samples that miss one sensor, turns before the first rest.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use nalgebra::{UnitQuaternion, Vector3};
use vergence_inertial::filter::{Axes, Filter, Kind, Limits, Stream, Vergence, VergenceParams};
use vergence_inertial::motion::{Earth, Motion, Wander, WanderParams};
use vergence_inertial::score;
use vergence_sense::Imu;
use vergence_time::{Span, Timestamp};

const RATE_HZ: usize = 200;
const PERIOD: Span = Span::from_millis(5);
const REST_S: f64 = 15.0;
const LENGTH_S: f64 = 75.0;

fn at(sample: usize) -> Timestamp {
    Timestamp::from_nanos((sample * 1_000_000_000 / RATE_HZ) as i64)
}

/// A unit that rests and then moves as hands do, and its true orientations.
fn moved() -> Vec<(Timestamp, Imu, UnitQuaternion<f64>)> {
    moved_as(5, WanderParams::default())
}

fn moved_as(seed: u64, params: WanderParams) -> Vec<(Timestamp, Imu, UnitQuaternion<f64>)> {
    let rests_s = vec![(-10.0, REST_S)];
    let motion = Wander::new(seed, &WanderParams { rests_s, ..params }).unwrap();
    let earth = Earth::MID_LATITUDE;
    let bias = Vector3::new(0.3, -0.2, 0.25).map(f64::to_radians);
    (0..(LENGTH_S as usize * RATE_HZ))
        .map(|i| {
            // Half a period: the rate is one of an instant, and is taken for the mean over its step.
            let seen = motion.at(Timestamp::from_nanos(at(i).as_nanos() - PERIOD.as_nanos() / 2));
            let imu = Imu {
                gyr_rad_s: seen.rate_in_body_rad_s + bias,
                acc_m_s2: seen.specific_force_m_s2(&earth),
                mag_ut: Some(seen.world_from_body.rotation.inverse_transform_vector(&earth.field_ut)),
            };
            (at(i), imu, motion.at(at(i)).world_from_body.rotation)
        })
        .collect()
}

/// 9D total, and 6D total after aligning the start, degrees.
fn scored(kind: Kind, samples: &[(Timestamp, Imu, UnitQuaternion<f64>)]) -> [f64; 2] {
    scored_with(samples, &|axes| kind.filter(axes, PERIOD))
}

fn scored_with(
    samples: &[(Timestamp, Imu, UnitQuaternion<f64>)],
    made: &dyn Fn(Axes) -> Box<dyn Filter>,
) -> [f64; 2] {
    [Axes::Nine, Axes::Six].map(|axes| {
        let mut filter = made(axes);
        let mut pairs = Vec::new();
        for (at, imu, truth) in samples {
            filter.update(*at, imu);
            if at.as_nanos() as f64 * 1e-9 > REST_S {
                pairs.push((*at, filter.earth_from_sensor(), *truth));
            }
        }
        let score = score(&pairs).unwrap();
        if axes == Axes::Nine { score.total_rad } else { score.start_total_rad }.to_degrees()
    })
}

/// What slower sensors may add to the error, degrees.
const SLOWER_DEG: f64 = 0.7;

#[test]
fn a_magnetometer_may_be_slower_than_the_gyroscope() {
    let samples = moved();
    let [all, _] = scored(Kind::Vergence, &samples);
    for rate_hz in [100, 50, 20, 5, 2] {
        let mut slow = samples.clone();
        for (_, imu, _) in
            slow.iter_mut().enumerate().filter(|(i, _)| i % (RATE_HZ / rate_hz) != 0).map(|(_, s)| s)
        {
            imu.mag_ut = None;
        }
        let [found, _] = scored(Kind::Vergence, &slow);
        println!("magnetometer at {rate_hz} Hz: {found:.3} (at {RATE_HZ}: {all:.3})");
        assert!(found < all + SLOWER_DEG, "{rate_hz} Hz: {found}, {all}");
    }
}

#[test]
fn an_accelerometer_may_be_slower_or_miss_a_sample() {
    let samples = moved();
    let all = scored(Kind::Vergence, &samples);
    for rate_hz in [100, 50, 20, 10] {
        let mut slow = samples.clone();
        for (_, imu, _) in
            slow.iter_mut().enumerate().filter(|(i, _)| i % (RATE_HZ / rate_hz) != 0).map(|(_, s)| s)
        {
            imu.acc_m_s2 = Vector3::repeat(f64::NAN);
        }
        let found = scored(Kind::Vergence, &slow);
        println!("accelerometer at {rate_hz} Hz: {found:.3?} (at {RATE_HZ}: {all:.3?})");
        assert!(
            found.iter().zip(all).all(|(found, all)| *found < all + SLOWER_DEG),
            "{rate_hz}: {found:?} {all:?}"
        );
    }
    let mut holes = samples;
    for (_, imu, _) in holes.iter_mut().step_by(20) {
        imu.acc_m_s2 = Vector3::repeat(f64::NAN);
    }
    let found = scored(Kind::Vergence, &holes);
    assert!(found.iter().zip(all).all(|(found, all)| *found < all + 0.1), "{found:?} {all:?}");
}

/// What the bias, and so the drift, may be wrong by after five seconds of rest, degrees per second.
const BIAS_DEG_S: f64 = 0.1;

#[test]
fn an_even_turn_before_a_rest_is_no_bias() {
    let earth = Earth::MID_LATITUDE;
    let bias = Vector3::new(0.2, -0.2, 0.2).map(f64::to_radians);
    for rate_deg_s in [-15.0, 1.0, 1.8, 2.5, 5.0, 10.0, 20.0f64] {
        for turn_s in [3.0, 4.0, 6.0, 10.0] {
            for axes in [Axes::Nine, Axes::Six] {
                let mut filter = Kind::Vergence.filter(axes, PERIOD);
                for i in 0..((turn_s as usize + 20) * RATE_HZ) {
                    let t = i as f64 / RATE_HZ as f64;
                    let turning = if t < turn_s { 1.0 } else { 0.0 };
                    let rate = rate_deg_s.to_radians();
                    let q = UnitQuaternion::from_euler_angles(0.0, 0.0, rate * t.min(turn_s));
                    let imu = Imu {
                        gyr_rad_s: Vector3::z() * (rate * turning) + bias,
                        acc_m_s2: Vector3::new(0.0, 0.0, 9.81),
                        mag_ut: Some(q.inverse_transform_vector(&earth.field_ut)),
                    };
                    filter.update(at(i), &imu);
                    let off = (filter.gyro_bias_rad_s() - bias).norm().to_degrees();
                    let rested = t > turn_s + 5.0;
                    assert!(
                        !rested || off < BIAS_DEG_S,
                        "{rate_deg_s} deg/s, {turn_s} s, {axes:?}: {off} deg/s"
                    );
                }
            }
        }
    }
}

#[test]
fn an_even_turn_after_a_gap_is_no_bias() {
    // The bias is known from a rest; then half a second is missing, and the unit turns evenly.
    let mut filter = Kind::Vergence.filter(Axes::Six, PERIOD);
    for i in 0..40 * RATE_HZ {
        let t = i as f64 / RATE_HZ as f64;
        let rate = if (20.5..30.0).contains(&t) { 6f64.to_radians() } else { 0.0 };
        let imu =
            Imu { gyr_rad_s: Vector3::z() * rate, acc_m_s2: Vector3::new(0.0, 0.0, 9.81), mag_ut: None };
        if !(20.0..20.5).contains(&t) {
            filter.update(at(i), &imu);
        }
        let off = filter.gyro_bias_rad_s().norm().to_degrees();
        assert!(t < 10.0 || off < BIAS_DEG_S, "{t} s: {off} deg/s");
    }
}

#[test]
fn an_even_turn_followed_by_motion_is_given_up() {
    // A turntable for ten seconds, then hands: there was no rest yet.
    let turn_s = 10;
    let rate = Vector3::z() * 6f64.to_radians();
    let moved = moved();
    let moving = &moved[REST_S as usize * RATE_HZ..];
    let mut samples = Vec::new();
    for i in 0..turn_s * RATE_HZ {
        let q = UnitQuaternion::new(rate * (i as f64 / RATE_HZ as f64 - turn_s as f64));
        let first = moving[0].1;
        let up = q.inverse_transform_vector(&Vector3::new(0.0, 0.0, 9.81));
        samples.push((at(i), Imu { gyr_rad_s: rate, acc_m_s2: up, mag_ut: first.mag_ut }, q));
    }
    for (i, (_, imu, truth)) in moving.iter().enumerate() {
        samples.push((at(turn_s * RATE_HZ + i), *imu, *truth));
    }
    let mut filter = Kind::Vergence.filter(Axes::Six, PERIOD);
    let mut pairs = Vec::new();
    for (at, imu, truth) in &samples {
        filter.update(*at, imu);
        if at.as_nanos() > 40_000_000_000 {
            pairs.push((*at, filter.earth_from_sensor(), *truth));
        }
    }
    let inclination = score(&pairs).unwrap().inclination_rad.to_degrees();
    assert!(inclination < 2.0, "{inclination}");
}

/// What a perfect gyroscope may lose by its factors being learned, degrees, mean over the draws.
const LEARNED_DEG: f64 = 0.1;

#[test]
fn learning_factors_takes_nothing_from_a_perfect_gyroscope() {
    let fast = WanderParams {
        tilt_rad: 2.0,
        turn_rad: 2.0,
        way_m: 0.1,
        frequency_hz: 0.8,
        ..WanderParams::default()
    };
    let draws: Vec<_> = (0..6).map(|seed| moved_as(seed, fast.clone())).collect();
    let mean = |params: VergenceParams| {
        let period_s = PERIOD.as_secs_f64();
        let all = draws.iter().map(|samples| {
            scored_with(samples, &|axes| {
                Box::new(Stream::new(Vergence::new(params, period_s), axes, PERIOD, Limits::default()))
            })
        });
        all.fold([0.0; 2], |sum, found| [sum[0] + found[0] / 6.0, sum[1] + found[1] / 6.0])
    };
    let learned = mean(VergenceParams::default());
    let not = mean(VergenceParams { factor_sigma: 0.0, ..VergenceParams::default() });
    let believed = mean(VergenceParams { factor_doubt: 0.0, ..VergenceParams::default() });
    println!(
        "9D total, 6D start: factors learned {learned:.3?}, not {not:.3?}, without doubt {believed:.3?}"
    );
    assert!(
        learned.iter().zip(not).all(|(with, without)| *with < without + LEARNED_DEG),
        "{learned:?} {not:?}"
    );
}

#[test]
fn a_unit_that_averages_may_be_slow() {
    let fast = moved();
    for every in [2, 4, 8] {
        let mean = |part: &[(Timestamp, Imu, UnitQuaternion<f64>)], of: &dyn Fn(&Imu) -> Vector3<f64>| {
            part.iter().map(|(_, imu, _)| of(imu)).sum::<Vector3<f64>>() / every as f64
        };
        let slow: Vec<_> = fast
            .chunks_exact(every)
            .map(|part| {
                let imu = Imu {
                    gyr_rad_s: mean(part, &|imu| imu.gyr_rad_s),
                    acc_m_s2: mean(part, &|imu| imu.acc_m_s2),
                    mag_ut: Some(mean(part, &|imu| imu.mag_ut.unwrap())),
                };
                let (at, _, truth) = part[every - 1];
                (at, imu, truth)
            })
            .collect();
        let period = Span::from_nanos(PERIOD.as_nanos() * every as i64);
        let [vqf, ours] =
            [Kind::Vqf, Kind::Vergence].map(|kind| scored_with(&slow, &|axes| kind.filter(axes, period)));
        println!("means at {} Hz: vqf {vqf:.3?} vergence {ours:.3?}", RATE_HZ / every);
        assert!(ours.iter().zip(vqf).all(|(ours, vqf)| *ours < vqf + 0.2), "{every}: {ours:?} {vqf:?}");
    }
}
