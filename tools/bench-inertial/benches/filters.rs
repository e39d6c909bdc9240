//! Time of one sample, update and orientation, of our filters beside other crates', on one simulated motion: one run, one thread.

use std::hint::black_box;
use std::time::Duration;

use ahrs::Ahrs as _;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::Vector3;
use rustix::time::{ClockId, clock_gettime};
use vergence_inertial::filter::{
    Axes, Clean, Core, Filter, Limits, Madgwick, MadgwickParams, Stream, Vergence, VergenceParams, Vqf,
    VqfParams,
};
use vergence_sense::Imu;
use vergence_time::{Span, Timestamp};

const PERIOD_NS: i64 = 3_500_000;
const SAMPLES: usize = 8000;

/// Rest, then slow and fast turning, with noise from a fixed sequence.
fn motion() -> Vec<(Timestamp, Imu)> {
    let mut seed = 1u64;
    let mut noise = move || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (seed >> 33) as f64 / f64::from(1u32 << 31) - 0.5
    };
    let mut q = nalgebra::UnitQuaternion::identity();
    (0..SAMPLES)
        .map(|i| {
            let t = i as f64 * PERIOD_NS as f64 * 1e-9;
            let on = if t < 5.0 { 0.0 } else { 1.0 };
            let rate = Vector3::new((1.3 * t).sin(), 0.7 * (2.1 * t).cos(), 1.5 * (0.6 * t).sin()) * on;
            q *= nalgebra::UnitQuaternion::new(rate * PERIOD_NS as f64 * 1e-9);
            let shake = Vector3::new((9.0 * t).sin(), (7.0 * t).cos(), (8.0 * t).sin()) * on;
            let mut jitter = |scale: f64| Vector3::new(noise(), noise(), noise()) * scale;
            let imu = Imu {
                gyr_rad_s: rate + jitter(0.005) + Vector3::new(0.003, -0.002, 0.004),
                acc_m_s2: q.inverse() * (Vector3::new(0.0, 0.0, 9.81) + shake) + jitter(0.05),
                mag_ut: Some(q.inverse() * Vector3::new(0.0, 16.0, -42.0) + jitter(0.8)),
            };
            (Timestamp::from_nanos(i as i64 * PERIOD_NS), imu)
        })
        .collect()
}

fn core(samples: &[(Timestamp, Imu)], axes: Axes, core: &mut impl Core) {
    for (_, imu) in samples {
        let mag_ut = if axes == Axes::Nine { imu.mag_ut } else { None };
        core.step(&Clean {
            step_s: PERIOD_NS as f64 * 1e-9,
            gyr_rad_s: imu.gyr_rad_s,
            acc_m_s2: Some(imu.acc_m_s2),
            mag_ut,
        });
        black_box(core.earth_from_sensor());
    }
}

fn guarded(samples: &[(Timestamp, Imu)], filter: &mut impl Filter) {
    for (at, imu) in samples {
        black_box(filter.update(*at, imu));
        black_box(filter.earth_from_sensor());
    }
}

/// CPU time of this thread so far: what else the machine does is not counted.
fn spent() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec as u32)
}

fn on_cpu(times: u64, mut run: impl FnMut()) -> Duration {
    let began = spent();
    (0..times).for_each(|_| run());
    spent() - began
}

fn filters(criterion: &mut Criterion) {
    let samples = motion();
    let period_s = PERIOD_NS as f64 * 1e-9;
    let period = Span::from_nanos(PERIOD_NS);
    let f32s = |v: &Vector3<f64>| v.cast::<f32>();
    let old = |v: &Vector3<f64>| nalgebra_for_ahrs::Vector3::new(v.x, v.y, v.z);
    let zero = Vector3::zeros();
    for axes in [Axes::Nine, Axes::Six] {
        let nine = axes == Axes::Nine;
        let mut group = criterion.benchmark_group(if nine { "9D" } else { "6D" });
        group.throughput(Throughput::Elements(SAMPLES as u64));
        group
            .sample_size(40)
            .warm_up_time(Duration::from_millis(500))
            .measurement_time(Duration::from_secs(3));
        group.bench_function("ours/vergence", |b| {
            b.iter_custom(|times| {
                on_cpu(times, || {
                    core(&samples, axes, &mut Vergence::new(VergenceParams::default(), period_s))
                })
            });
        });
        group.bench_function("ours/vergence, guarded", |b| {
            b.iter_custom(|times| {
                on_cpu(times, || {
                    let core = Vergence::new(VergenceParams::default(), period_s);
                    guarded(&samples, &mut Stream::new(core, axes, period, Limits::default()));
                })
            });
        });
        group.bench_function("ours/vqf", |b| {
            b.iter_custom(|times| {
                on_cpu(times, || core(&samples, axes, &mut Vqf::new(VqfParams::FULL, period_s)))
            });
        });
        group.bench_function("ours/madgwick", |b| {
            b.iter_custom(|times| {
                on_cpu(times, || core(&samples, axes, &mut Madgwick::new(MadgwickParams::default())))
            });
        });
        group.bench_function("vqf-rs/vqf", |b| {
            b.iter_custom(|times| {
                on_cpu(times, || {
                    let mut filter = vqf_rs::VQF::new(period_s as vqf_rs::Float, None, None, None);
                    for (_, imu) in &samples {
                        let array = |v: &Vector3<f64>| {
                            [v.x as vqf_rs::Float, v.y as vqf_rs::Float, v.z as vqf_rs::Float]
                        };
                        let mag = imu.mag_ut.as_ref().filter(|_| nine).map(array);
                        filter.update(array(&imu.gyr_rad_s), array(&imu.acc_m_s2), mag);
                        black_box(if nine { filter.quat_9d() } else { filter.quat_6d() });
                    }
                })
            });
        });
        group.bench_function("uf-ahrs/vqf", |b| {
            b.iter_custom(|times| {
                on_cpu(times, || {
                    let mut filter = uf_ahrs::Vqf::new(
                        Duration::from_nanos(PERIOD_NS as u64),
                        uf_ahrs::VqfParams::default(),
                    );
                    for (_, imu) in &samples {
                        let (gyr, acc) = (f32s(&imu.gyr_rad_s), f32s(&imu.acc_m_s2));
                        if nine {
                            let mag = f32s(imu.mag_ut.as_ref().unwrap_or(&zero));
                            uf_ahrs::Ahrs::update(&mut filter, gyr, acc, mag);
                        } else {
                            uf_ahrs::Ahrs::update_imu(&mut filter, gyr, acc);
                        }
                        black_box(uf_ahrs::Ahrs::orientation(&filter));
                    }
                })
            });
        });
        group.bench_function("ahrs/madgwick", |b| {
            b.iter_custom(|times| {
                on_cpu(times, || {
                    let mut filter = ahrs::Madgwick::new(period_s, 0.12);
                    for (_, imu) in &samples {
                        let (gyr, acc) = (old(&imu.gyr_rad_s), old(&imu.acc_m_s2));
                        let _ = if nine {
                            filter.update(&gyr, &acc, &old(imu.mag_ut.as_ref().unwrap_or(&zero))).map(|_| ())
                        } else {
                            filter.update_imu(&gyr, &acc).map(|_| ())
                        };
                        black_box(filter.quat);
                    }
                })
            });
        });
        group.finish();
    }
}

criterion_group!(benches, filters);
criterion_main!(benches);
