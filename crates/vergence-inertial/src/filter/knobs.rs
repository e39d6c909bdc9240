//! The knobs of filters: what each means, its unit and its range; and files of them.

use super::{ComplementaryParams, Kind, MadgwickParams, MahonyParams, VergenceParams, VqfParams};
use crate::Unit;

/// One number of a filter's parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knob {
    /// Its name in files.
    pub name: &'static str,
    /// Its unit; empty for a share or a factor.
    pub unit: &'static str,
    /// What it means, and what turning it does.
    pub meaning: &'static str,
    /// The least value that makes sense …
    pub least: f64,
    /// … and the largest.
    pub most: f64,
}

/// Parameters that can be read from a file.
pub trait Params: serde::de::DeserializeOwned {
    /// Each knob with its value.
    fn knobs(&self) -> Vec<(Knob, f64)>;
}

macro_rules! knobs {
    ($name:ident { $($field:ident: $unit:literal, $least:literal..$most:literal, $meaning:literal;)* }) => {
        impl Params for $name {
            fn knobs(&self) -> Vec<(Knob, f64)> {
                vec![$((
                    Knob { name: stringify!($field), unit: $unit, meaning: $meaning, least: $least, most: $most },
                    self.$field,
                )),*]
            }
        }
    };
}

knobs! { ComplementaryParams {
    tau_acc_s: "s", 0.001..1000.0, "time constant of the pull towards the accelerometer's up: short lets acceleration tilt it, long the gyroscope's bias";
    tau_mag_s: "s", 0.001..10000.0, "time constant of the pull towards the magnetometer's north";
} }

knobs! { MadgwickParams {
    beta: "rad/s", 0.00001..100.0, "speed of the pull towards the measured directions: large follows acceleration, small the gyroscope's bias";
} }

knobs! { MahonyParams {
    kp: "1/s", 0.0001..1000.0, "pull towards the measured directions: large follows acceleration, small the gyroscope's bias";
    ki: "1/s²", 0.0..100.0, "how fast the bias is learned";
} }

knobs! { VqfParams {
    tau_acc_s: "s", 0.1..60.0, "time constant of the accelerometer's low-pass: short lets acceleration tilt it, long the gyroscope's errors";
    tau_mag_s: "s", 0.1..1000.0, "time constant of the heading's correction";
    bias_sigma_start_deg_s: "°/s", 0.0..50.0, "standard deviation of the bias at the start";
    bias_forgetting_s: "s", 0.1..1e6, "time in which the uncertainty of the bias grows by 0.1 °/s";
    bias_clip_deg_s: "°/s", 0.001..100.0, "largest bias, and the largest mean rate that counts as rest";
    bias_sigma_motion_deg_s: "°/s", 0.0001..50.0, "standard deviation of the bias that motion alone leaves";
    bias_vertical_forgetting: "", 0.0..1.0, "weight of the pull to zero of the bias about the vertical, which motion alone does not show";
    bias_sigma_rest_deg_s: "°/s", 0.0001..50.0, "standard deviation of the bias that rest leaves";
    rest_min_s: "s", 0.0..60.0, "how long it must be still to count as rest";
    rest_filter_s: "s", 0.001..60.0, "time constant of the low-pass from which deviations are taken";
    rest_gyr_deg_s: "°/s", 0.001..100.0, "largest deviation of the rate at rest";
    rest_acc_m_s2: "m/s²", 0.001..20.0, "largest deviation of the specific force at rest";
    mag_current_s: "s", 0.001..60.0, "time constant of the low-pass of norm and dip of the field";
    mag_reference_s: "s", 0.1..1e6, "time constant with which the reference of norm and dip follows";
    mag_norm_threshold: "", 0.001..10.0, "largest deviation of the field's norm, as a share of it";
    mag_dip_threshold_deg: "°", 0.01..180.0, "largest deviation of the dip";
    mag_new_s: "s", 0.0..1e6, "how long another field must be even to be accepted";
    mag_new_first_s: "s", 0.0..1e6, "the same for the first field";
    mag_new_min_gyr_deg_s: "°/s", 0.0..10000.0, "only samples with at least this rate count for that";
    mag_min_undisturbed_s: "s", 0.0..1e6, "how long the field must be undisturbed to be used again";
    mag_max_rejection_s: "s", 0.0..1e6, "how long a disturbed field is not used at all";
    mag_rejection_factor: "", 0.001..1e6, "how much slower a disturbed field is followed after that";
} }

knobs! { VergenceParams {
    latency_s: "s", -0.02..0.1, "how late readings are; the orientation given is turned on by as much";
    gyr_averaged: "", 0.0..1.0, "how much of its step a rate is the mean of: 0 for what the sensor says at an instant, 1 for all of it";
    acc_lag_s: "s", -0.02..0.02, "how much later the accelerometer reads than the gyroscope";
    mag_lag_s: "s", -0.05..0.05, "how much later the magnetometer reads than the gyroscope";
    tau_acc_s: "s", 0.1..60.0, "time constant of the accelerometer's low-pass: short lets acceleration tilt it, long the gyroscope's errors";
    window_s: "s", 0.001..2.0, "time over which observations are gathered before the errors of the gyroscope are corrected: short costs more, long reacts late";
    bias_sigma_deg_s: "°/s", 0.0..50.0, "standard deviation of the bias at the start";
    bias_limit_deg_s: "°/s", 0.0..100.0, "largest bias, and the largest mean rate that counts as rest (a first rest may have 20)";
    bias_wander_deg_s: "°/s", 0.0..10.0, "how much the bias wanders within 100 s";
    factor_sigma: "", 0.0..0.2, "standard deviation of the gyroscope's scale and cross-axis factors; 0: they are not estimated";
    factor_doubt: "", 0.0..100.0, "how much what was learned of these factors is doubted: large leaves a good gyroscope alone and corrects a bad one late";
    tilt_noise_deg_s: "°/s", 0.001..100.0, "noise of the rate that the tilt's correction shows in motion, over 1 s: small learns fast and follows acceleration";
    tilt_noise_before_rest_deg_s: "°/s", 0.001..100.0, "the same before there was a rest: small takes what levelling needs for bias";
    tilt_outlier_deg_s: "°/s", 0.001..1000.0, "the most that one window counts for";
    tilt_noise_per_acc: "s⁴/m²", 0.0..100.0, "how much the variance of that noise grows with the square of the horizontal acceleration";
    rest_noise_deg_s: "°/s", 0.00001..10.0, "noise of the mean rate at rest, over 1 s";
    rest_min_s: "s", 0.0..60.0, "how long it must be still to count as rest";
    rest_gyr_deg_s: "°/s", 0.001..100.0, "largest deviation of the rate at rest from its mean over half a second";
    rest_acc_m_s2: "m/s²", 0.001..20.0, "the same of the specific force";
    start_s: "s", 0.1..1000.0, "longest time for which the start goes on without a rest: up, bias and north are looked for together";
    start_acc_m_s2: "m/s²", 0.01..100.0, "strength of the acceleration in motion that the start supposes, until it has seen it";
    start_pulse_rad_s: "rad/s", 0.1..100.0, "angular frequency that most of that acceleration is supposed to have";
    offset_sigma_ut: "µT", 0.0..1000.0, "standard deviation of the magnetometer's offset at the start: large learns one fast, and takes an uneven field for one";
    field_noise_ut: "µT", 0.01..1000.0, "unevenness of the field over 1 s of motion: large lets the heading follow the gyroscope longer";
    field_outlier_ut: "µT", 0.01..1000.0, "deviation beyond which a reading of the magnetometer loses weight";
    field_motion_deg_s: "°/s", 0.1..10000.0, "mean rate at which readings of the magnetometer count half of what they do in fast motion";
    jump_ut: "µT", 0.0..1000.0, "deviation that stays with the sensor beyond which a magnet was attached or removed";
    jump_offset: "1/s", 0.0..1000.0, "how fast an attached magnet is learned";
    jump_field: "1/s", 0.0..1000.0, "the same for the field itself while turning has not confirmed it: large recovers from a disturbed start, and is misled by a magnet in the room";
} }

/// A switch of VQF, which is no number.
const SWITCHES: [(&str, &str); 3] = [
    ("motion_bias", "whether the bias is estimated in motion; costs a third of the time of a sample"),
    ("rest_bias", "whether the bias is estimated at rest"),
    ("magnetic_rejection", "whether a disturbed magnetic field is recognised and not followed"),
];

impl Kind {
    /// Its knobs with their defaults, those of `vergence` for a unit.
    pub fn knobs(self, unit: Unit) -> Vec<(Knob, f64)> {
        match self {
            Self::Integration => Vec::new(),
            Self::Complementary => ComplementaryParams::default().knobs(),
            Self::Madgwick => MadgwickParams::default().knobs(),
            Self::Mahony => MahonyParams::default().knobs(),
            Self::VqfBasic => VqfParams::BASIC.knobs(),
            Self::Vqf => VqfParams::FULL.knobs(),
            Self::Vergence => unit.params().knobs(),
        }
    }

    /// A file of parameters (TOML) with every knob at its default: its meaning, unit and range in comments.
    pub fn config_text(self, unit: Unit) -> String {
        use std::fmt::Write as _;
        let mut text = format!(
            "# Knobs of {}, at their defaults. A knob that is not named has its default.\n",
            self.name()
        );
        for (knob, value) in self.knobs(unit) {
            let Knob { name, unit, meaning, least, most } = knob;
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            // Text takes everything.
            let _ = write!(text, "\n# {meaning}; {least} to {most}{unit}\n{name} = {value:?}\n");
        }
        if self == Self::Vqf {
            for (name, meaning) in SWITCHES {
                let _ = write!(text, "\n# {meaning}\n{name} = true\n");
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::super::{read_params, read_unit_params};
    use super::*;

    /// Names and values of the numbers of a struct, as it prints itself.
    fn fields(printed: &str) -> Vec<(String, f64)> {
        let inner = printed.split_once('{').unwrap().1;
        let field = |part: &str| {
            let (name, value) = part.trim_end_matches(['}', ' ']).split_once(':')?;
            Some((name.trim().to_owned(), value.trim().parse().ok()?))
        };
        inner.split(',').filter_map(field).collect()
    }

    fn checked<P: Params + std::fmt::Debug>(params: &P) {
        let knobs: Vec<(String, f64)> =
            params.knobs().into_iter().map(|(knob, value)| (knob.name.to_owned(), value)).collect();
        assert_eq!(knobs, fields(&format!("{params:?}")), "each number of the struct is a knob");
        for (knob, value) in params.knobs() {
            assert!((knob.least..=knob.most).contains(&value) && knob.meaning.len() > 10, "{knob:?}");
        }
    }

    #[test]
    fn every_number_is_a_knob_and_its_default_is_in_range() {
        checked(&ComplementaryParams::default());
        checked(&MadgwickParams::default());
        checked(&MahonyParams::default());
        checked(&VqfParams::FULL);
        Unit::ALL.iter().for_each(|unit| checked(&unit.params()));
    }

    #[test]
    fn what_is_printed_is_read_as_the_defaults() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.toml");
        for unit in Unit::ALL {
            std::fs::write(&path, Kind::Vergence.config_text(unit)).unwrap();
            assert_eq!(read_unit_params(&path, Unit::Unknown).unwrap(), unit.params());
        }
        std::fs::write(&path, Kind::Vqf.config_text(Unit::Unknown)).unwrap();
        assert_eq!(read_params::<VqfParams>(&path).unwrap(), VqfParams::FULL);
        std::fs::write(&path, Kind::Mahony.config_text(Unit::Unknown)).unwrap();
        assert_eq!(read_params::<MahonyParams>(&path).unwrap(), MahonyParams::default());
    }
}
