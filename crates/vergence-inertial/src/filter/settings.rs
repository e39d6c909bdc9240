//! Parameters of filters from files: TOML with one key for each knob, named and in units as in the struct.

use std::collections::BTreeMap;
use std::path::Path;

use super::{ComplementaryParams, MadgwickParams, MahonyParams, VergenceParams, VqfParams};
use crate::{Error, Unit};

/// The widest value of any knob; beyond it the mathematics would leave the range of numbers.
const WIDEST: f64 = 1e6;

/// Parameters that can be read from a file.
pub trait Params: serde::de::DeserializeOwned {
    /// Each number with its name.
    fn numbers(&self) -> Vec<(&'static str, f64)>;
}

macro_rules! params {
    ($name:ident { $($field:ident),* $(,)? }) => {
        impl Params for $name {
            fn numbers(&self) -> Vec<(&'static str, f64)> {
                vec![$((stringify!($field), self.$field)),*]
            }
        }
    };
}

params!(ComplementaryParams { tau_acc_s, tau_mag_s });
params!(MadgwickParams { beta });
params!(MahonyParams { kp, ki });
params!(VqfParams {
    tau_acc_s,
    tau_mag_s,
    bias_sigma_start_deg_s,
    bias_forgetting_s,
    bias_clip_deg_s,
    bias_sigma_motion_deg_s,
    bias_vertical_forgetting,
    bias_sigma_rest_deg_s,
    rest_min_s,
    rest_filter_s,
    rest_gyr_deg_s,
    rest_acc_m_s2,
    mag_current_s,
    mag_reference_s,
    mag_norm_threshold,
    mag_dip_threshold_deg,
    mag_new_s,
    mag_new_first_s,
    mag_new_min_gyr_deg_s,
    mag_min_undisturbed_s,
    mag_max_rejection_s,
    mag_rejection_factor
});
params!(VergenceParams {
    latency_s,
    gyr_averaged,
    acc_lag_s,
    mag_lag_s,
    tau_acc_s,
    window_s,
    bias_sigma_deg_s,
    bias_limit_deg_s,
    bias_wander_deg_s,
    factor_sigma,
    factor_doubt,
    tilt_noise_deg_s,
    tilt_noise_before_rest_deg_s,
    tilt_outlier_deg_s,
    tilt_noise_per_acc,
    rest_noise_deg_s,
    rest_min_s,
    rest_gyr_deg_s,
    rest_acc_m_s2,
    offset_sigma_ut,
    field_noise_ut,
    field_outlier_ut,
    field_motion_deg_s,
    jump_ut,
    jump_offset,
    jump_field
});

/// Reads parameters; a knob that the file does not name has its default.
///
/// # Errors
/// File, line and column of what is no TOML or no knob; the name of a knob that is out of its range (finite, at most 10⁶, above
/// zero; sigmas, gains of jumps and limits may be zero, lags of either sign).
pub fn read_params<P: Params>(path: &Path) -> Result<P, Error> {
    let params: P = vergence_config::read(path)?;
    for (name, value) in params.numbers() {
        let signed = name.ends_with("lag_s") || name.starts_with("latency");
        // A share, not a size.
        let widest = if name == "gyr_averaged" { 1.0 } else { WIDEST };
        let zero = ["averaged", "doubt", "sigma", "jump", "per_acc", "ki", "min_s"]
            .iter()
            .any(|part| name.contains(part));
        let least = if signed { -WIDEST } else { 0.0 };
        if !(least..=widest).contains(&value) || (value == 0.0 && !zero && !signed) {
            let above = if zero || signed { "from" } else { "above" };
            return Err(Error::Mismatch {
                path: path.to_owned(),
                expected: format!("{name} {above} {least} and at most {widest}"),
                found: value.to_string(),
            });
        }
    }
    Ok(params)
}

/// Parameters of `vergence` for a unit; where the file names a part of the timing, that counts.
///
/// # Errors
/// Those of [`read_params`].
pub fn read_unit_params(path: &Path, unit: Unit) -> Result<VergenceParams, Error> {
    let mut params: VergenceParams = read_params(path)?;
    let named: BTreeMap<String, serde::de::IgnoredAny> = vergence_config::read(path)?;
    let known = unit.params();
    for (name, value, of_unit) in [
        ("latency_s", &mut params.latency_s, known.latency_s),
        ("gyr_averaged", &mut params.gyr_averaged, known.gyr_averaged),
        ("acc_lag_s", &mut params.acc_lag_s, known.acc_lag_s),
        ("mag_lag_s", &mut params.mag_lag_s, known.mag_lag_s),
    ] {
        if !named.contains_key(name) {
            *value = of_unit;
        }
    }
    Ok(params)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<VergenceParams, String> {
        read_of(text, Unit::Unknown)
    }

    fn read_of(text: &str, unit: Unit) -> Result<VergenceParams, String> {
        let path = std::env::temp_dir().join(format!("vergence-params-{}.toml", std::process::id()));
        std::fs::write(&path, text).unwrap();
        let result = read_unit_params(&path, unit).map_err(|error| error.to_string());
        std::fs::remove_file(&path).unwrap();
        result
    }

    #[test]
    fn a_file_changes_what_it_names_and_nothing_else() {
        let default = VergenceParams::default();
        assert_eq!(read(""), Ok(default));
        assert_eq!(read("latency_s = -0.001\n"), Ok(VergenceParams { latency_s: -0.001, ..default }));
        let broad = Unit::Broad.params();
        assert_eq!(read_of("", Unit::Broad), Ok(broad));
        assert_eq!(
            read_of("latency_s = 0\ngyr_averaged = 1", Unit::Broad),
            Ok(VergenceParams { latency_s: 0.0, gyr_averaged: 1.0, ..broad })
        );
        assert!(read("gyr_averaged = 1.5").unwrap_err().contains("at most 1"));
        let error = read("tau = 3.0\n").unwrap_err();
        assert!(error.contains(".toml:1:1: unknown field `tau`"), "{error}");
        for text in ["tau_acc_s = 0.0", "tau_acc_s = nan", "tau_acc_s = -1.0", "tau_acc_s = inf"] {
            let error = read(text).unwrap_err();
            assert!(error.contains("expected tau_acc_s above 0"), "{error}");
        }
    }
}
