use nalgebra::{UnitQuaternion, Vector3};
use vergence_sense::Imu;
use vergence_time::{Span, Timestamp};

use super::saved::{Saved, saved};
use super::{Axes, Clean, Core, Filter};
use crate::Error;

/// What of one sample was not used, as a set of flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Rejected(u16);

impl Rejected {
    /// Nothing was rejected.
    pub const NOTHING: Self = Self(0);
    /// The rate was not finite; the last good one stood in.
    pub const GYR_NOT_FINITE: Self = Self(1);
    /// The rate was beyond what the sensor can measure; it was cut to the limit.
    pub const GYR_SATURATED: Self = Self(2);
    /// The specific force was not finite, or beyond what the sensor can measure.
    pub const ACC_WRONG: Self = Self(4);
    /// The specific force was zero: free fall or a dead sensor. It says nothing about up.
    pub const ACC_ZERO: Self = Self(8);
    /// The field was not finite, or stronger than any that a sensor in use is in.
    pub const MAG_WRONG: Self = Self(16);
    /// The field was zero: a dead sensor.
    pub const MAG_ZERO: Self = Self(32);
    /// The time was that of the sample before: the sample was ignored.
    pub const REPEATED: Self = Self(64);
    /// The time was before that of the sample before: the sample was ignored.
    pub const REVERSED: Self = Self(128);
    /// Samples are missing, but few enough to bridge by turning on at the mean rate.
    pub const GAP_BRIDGED: Self = Self(256);
    /// Samples are missing for so long that the motion is not known: the filter converges anew.
    pub const GAP_LOST: Self = Self(512);
    /// The clock was set back: time counts from here.
    pub const CLOCK_RESET: Self = Self(1024);

    /// Each flag with its name.
    pub const ALL: [(Self, &'static str); 11] = [
        (Self::GYR_NOT_FINITE, "gyr_not_finite"),
        (Self::GYR_SATURATED, "gyr_saturated"),
        (Self::ACC_WRONG, "acc_wrong"),
        (Self::ACC_ZERO, "acc_zero"),
        (Self::MAG_WRONG, "mag_wrong"),
        (Self::MAG_ZERO, "mag_zero"),
        (Self::REPEATED, "repeated"),
        (Self::REVERSED, "reversed"),
        (Self::GAP_BRIDGED, "gap_bridged"),
        (Self::GAP_LOST, "gap_lost"),
        (Self::CLOCK_RESET, "clock_reset"),
    ];

    /// Whether all flags of `other` are set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether nothing was rejected.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
}

impl std::ops::BitOr for Rejected {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl std::ops::BitOrAssign for Rejected {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl std::fmt::Display for Rejected {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut separator = "";
        for (flag, name) in Self::ALL {
            if self.contains(flag) {
                write!(f, "{separator}{name}")?;
                separator = "+";
            }
        }
        if self.is_empty() { f.write_str("nothing") } else { Ok(()) }
    }
}

/// How many samples were touched, for each flag in the order of [`Rejected::ALL`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Rejections(pub [u64; Rejected::ALL.len()]);

impl Rejections {
    fn count(&mut self, rejected: Rejected) {
        for (count, (flag, _)) in self.0.iter_mut().zip(Rejected::ALL) {
            *count += u64::from(rejected.contains(flag));
        }
    }

    /// Names and counts of the reasons that occurred.
    pub fn occurred(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        self.0
            .iter()
            .zip(Rejected::ALL)
            .filter(|(count, _)| **count > 0)
            .map(|(count, (_, name))| (name, *count))
    }
}

/// What a sensor can say at all. Wide enough for every unit in use; a stream outside of it is broken, not fast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest believable rate of one axis, radians per second. Default 4000°/s, twice the range of common units.
    pub gyr_rad_s: f64,
    /// Largest believable specific force, metres per second squared. Default 40 g.
    pub acc_m_s2: f64,
    /// Largest believable field, microteslas. Default 5000: a hundred times the earth's.
    pub mag_ut: f64,
    /// Longest gap that is bridged at the mean rate. Default 250 ms; never less than five periods.
    pub bridge: Span,
    /// Samples in a row with a time before the newest after which the clock counts as set back. Default 10.
    pub reversed: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            gyr_rad_s: 4000f64.to_radians(),
            acc_m_s2: 400.0,
            mag_ut: 5000.0,
            bridge: Span::from_millis(250),
            reversed: 10,
        }
    }
}

/// What the guard remembers.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Guard {
    last: Option<Timestamp>,
    last_gyr: Vector3<f64>,
    /// Samples in a row with a time before the newest.
    reversed: u64,
    rejections: [u64; Rejected::ALL.len()],
}

saved!(Guard { last, last_gyr, reversed, rejections });

/// A filter behind a guard: any samples in, only clean ones used.
#[derive(Clone, Debug)]
pub struct Stream<C: Core> {
    core: C,
    limits: Limits,
    axes: Axes,
    period_s: f64,
    bridge_ns: i64,
    /// Longest step that is no gap.
    step_ns: i64,
    guard: Guard,
}

impl<C: Core> Stream<C> {
    /// `core`, which was made for samples every `period`, behind the guard. With [`Axes::Six`] the magnetometer is not read.
    pub fn new(core: C, axes: Axes, period: Span, limits: Limits) -> Self {
        let period_ns = period.as_nanos().max(1);
        Self {
            core,
            axes,
            period_s: period_ns as f64 * 1e-9,
            bridge_ns: limits.bridge.as_nanos().max(period_ns.saturating_mul(5)),
            step_ns: period_ns.saturating_mul(5) / 2,
            limits,
            guard: Guard {
                last: None,
                last_gyr: Vector3::zeros(),
                reversed: 0,
                rejections: [0; Rejected::ALL.len()],
            },
        }
    }

    /// The filter itself.
    pub const fn core(&self) -> &C {
        &self.core
    }

    /// The step to this sample in nanoseconds, or `None` where the sample must be ignored.
    #[inline]
    fn time(&mut self, at: Timestamp, rejected: &mut Rejected) -> Option<i64> {
        let nominal = (self.period_s * 1e9) as i64;
        let Some(last) = self.guard.last else {
            self.guard.last = Some(at);
            return Some(nominal);
        };
        let step = at.as_nanos().saturating_sub(last.as_nanos());
        if step > 0 {
            self.guard.last = Some(at);
            self.guard.reversed = 0;
            if step > self.step_ns {
                *rejected |= if step > self.bridge_ns { Rejected::GAP_LOST } else { Rejected::GAP_BRIDGED };
            }
            return Some(step);
        }
        if step == 0 {
            *rejected |= Rejected::REPEATED;
            return None;
        }
        self.guard.reversed += 1;
        if self.guard.reversed < u64::from(self.limits.reversed) {
            *rejected |= Rejected::REVERSED;
            return None;
        }
        *rejected |= Rejected::CLOCK_RESET;
        self.guard.last = Some(at);
        self.guard.reversed = 0;
        Some(nominal)
    }

    #[cold]
    fn wrong_rate(&self, gyr: &Vector3<f64>, rejected: &mut Rejected) -> Vector3<f64> {
        if gyr.iter().any(|value| value.is_nan()) {
            *rejected |= Rejected::GYR_NOT_FINITE;
            return self.guard.last_gyr;
        }
        *rejected |= if gyr.iter().all(|value| value.is_finite()) {
            Rejected::GYR_SATURATED
        } else {
            Rejected::GYR_NOT_FINITE
        };
        gyr.map(|value| value.clamp(-self.limits.gyr_rad_s, self.limits.gyr_rad_s))
    }
}

/// `vector` where it is finite, not zero and within `limit`; otherwise one of the two flags.
#[inline]
fn believed(
    vector: &Vector3<f64>,
    limit: f64,
    wrong: Rejected,
    zero: Rejected,
    rejected: &mut Rejected,
) -> Option<Vector3<f64>> {
    let square = vector.norm_squared();
    // NaN fails both comparisons.
    if square <= limit * limit && square > 1e-12 {
        return Some(*vector);
    }
    *rejected |= if square <= limit * limit { zero } else { wrong };
    None
}

impl<C: Core> Filter for Stream<C> {
    #[inline]
    fn update(&mut self, at: Timestamp, imu: &Imu) -> Rejected {
        let mut rejected = Rejected::NOTHING;
        let Some(step_ns) = self.time(at, &mut rejected) else {
            self.guard.count(rejected);
            return rejected;
        };
        let gyr = if imu.gyr_rad_s.amax() <= self.limits.gyr_rad_s && imu.gyr_rad_s.sum().is_finite() {
            imu.gyr_rad_s
        } else {
            self.wrong_rate(&imu.gyr_rad_s, &mut rejected)
        };
        let acc_m_s2 = believed(
            &imu.acc_m_s2,
            self.limits.acc_m_s2,
            Rejected::ACC_WRONG,
            Rejected::ACC_ZERO,
            &mut rejected,
        );
        let mag_ut = match (self.axes, &imu.mag_ut) {
            (Axes::Nine, Some(mag)) => {
                believed(mag, self.limits.mag_ut, Rejected::MAG_WRONG, Rejected::MAG_ZERO, &mut rejected)
            }
            _ => None,
        };
        let mut sample = Clean { step_s: step_ns as f64 * 1e-9, gyr_rad_s: gyr, acc_m_s2, mag_ut };
        if !rejected.is_empty() {
            if rejected.contains(Rejected::GAP_LOST) {
                self.core.lost(sample.step_s);
                sample.step_s = self.period_s;
            } else if rejected.contains(Rejected::GAP_BRIDGED) {
                sample.gyr_rad_s = (gyr + self.guard.last_gyr) * 0.5;
            }
            self.guard.count(rejected);
        }
        self.guard.last_gyr = gyr;
        self.core.step(&sample);
        rejected
    }

    fn earth_from_sensor(&self) -> UnitQuaternion<f64> {
        self.core.earth_from_sensor()
    }

    fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        self.core.gyro_bias_rad_s()
    }

    fn rejections(&self) -> Rejections {
        Rejections(self.guard.rejections)
    }

    fn save(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.guard.put(&mut bytes);
        self.core.state().put(&mut bytes);
        bytes
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let mut rest = bytes;
        let read = (Guard::take(&mut rest), C::State::take(&mut rest));
        let (Some(guard), Some(state), true) = (read.0, read.1, rest.is_empty()) else {
            return Err(Error::State { expected: self.save().len(), found: bytes.len() });
        };
        self.guard = guard;
        self.core.set_state(state);
        Ok(())
    }
}

impl Guard {
    #[cold]
    fn count(&mut self, rejected: Rejected) {
        let mut rejections = Rejections(self.rejections);
        rejections.count(rejected);
        self.rejections = rejections.0;
    }
}
