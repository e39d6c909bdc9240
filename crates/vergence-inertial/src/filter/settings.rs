//! Parameters of filters from files: TOML with one key for each knob, named and in units as in the struct.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Params, VergenceParams};
use crate::{Error, Unit};

/// Reads parameters; a knob that the file does not name has its default.
///
/// # Errors
/// File, line and column of what is no TOML or no knob; the name of a knob that is out of its range, and the range
/// ([`Knob`](super::Knob)).
pub fn read_params<P: Params>(path: &Path) -> Result<P, Error> {
    let params: P = vergence_config::read(path)?;
    for (knob, value) in params.knobs() {
        if !(knob.least..=knob.most).contains(&value) {
            let unit = if knob.unit.is_empty() { String::new() } else { format!(" {}", knob.unit) };
            return Err(Error::Mismatch {
                path: path.to_owned(),
                expected: format!("{} from {} to {}{unit}", knob.name, knob.least, knob.most),
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
        assert!(read("gyr_averaged = 1.5").unwrap_err().contains("gyr_averaged from 0 to 1, found 1.5"));
        let error = read("tau = 3.0\n").unwrap_err();
        assert!(error.contains(".toml:1:1: unknown field `tau`"), "{error}");
        for value in ["0.0", "nan", "-1.0", "inf", "1e9"] {
            let error = read(&format!("tau_acc_s = {value}")).unwrap_err();
            assert!(error.contains("expected tau_acc_s from 0.1 to 60 s"), "{error}");
        }
        assert!(
            read("latency_s = -5.0")
                .unwrap_err()
                .contains("expected latency_s from -0.02 to 0.1 s, found -5")
        );
    }
}
