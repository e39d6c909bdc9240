//! What the environment says of the headset.

use std::path::PathBuf;

use vergence_session::open_motion;
use vergence_xr_sim::{ClockMode, Config, Fault, FaultPlan, Profile};

use crate::capture;

/// Why the environment does not describe a headset.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A value that is none.
    #[error("{name}: expected {expected}, found \"{found}\"")]
    Value {
        /// The variable.
        name: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        found: String,
    },
    /// The headset or its motion cannot be so.
    #[error("{name}: {source}")]
    Headset {
        /// The variable.
        name: &'static str,
        /// Why.
        source: vergence_xr_sim::Error,
    },
    /// What is to move it cannot be read, or is none.
    #[error("{name}: {source}")]
    Motion {
        /// The variable.
        name: &'static str,
        /// Why.
        source: vergence_session::Error,
    },
    /// The folder for pictures cannot be written.
    #[error("{path}: {source}")]
    Write {
        /// The folder or file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// The headset that the variables describe; `get` gives a variable, so that tests need no environment. See the crate's
/// documentation for the variables.
///
/// # Errors
/// A value that is none, a file that cannot be read, a folder that cannot be written.
pub fn configuration(get: impl Fn(&str) -> Option<String>) -> Result<Config, Error> {
    let given = |name: &'static str| get(name).filter(|value| !value.is_empty());
    let headset = |name: &'static str| move |source| Error::Headset { name, source };
    let mut config = Config { clock: ClockMode::RealTime, ..Config::default() };
    if let Some(profile) = given("VERGENCE_XR_PROFILE") {
        config.profile = Profile::open(&profile).map_err(headset("VERGENCE_XR_PROFILE"))?;
    }
    if let Some(name) = given("VERGENCE_XR_MOTION") {
        let motion =
            open_motion(&name, &|| false, &mut |sentence| eprintln!("vergence OpenXR runtime: {sentence}"));
        config.motion =
            Box::new(motion.map_err(|source| Error::Motion { name: "VERGENCE_XR_MOTION", source })?);
    }
    if let Some(clock) = given("VERGENCE_XR_CLOCK") {
        config.clock = match clock.as_str() {
            "real-time" => ClockMode::RealTime,
            "virtual" => ClockMode::Virtual,
            _ => {
                let (name, expected) = ("VERGENCE_XR_CLOCK", "real-time or virtual");
                return Err(Error::Value { name, expected, found: clock });
            }
        };
    }
    config.frames = given("VERGENCE_XR_FRAMES").map(|n| count("VERGENCE_XR_FRAMES", n)).transpose()?;
    let every = given("VERGENCE_XR_CAPTURE_EVERY");
    let every = every.map(|n| count("VERGENCE_XR_CAPTURE_EVERY", n)).transpose()?.unwrap_or(1);
    if let Some(folder) = given("VERGENCE_XR_CAPTURE") {
        config.capture = Some(capture::to_folder(PathBuf::from(folder), every)?);
    }
    if let Some(faults) = given("VERGENCE_XR_FAULTS") {
        let faults = faults.split_whitespace().map(Fault::parse).collect::<Result<Vec<_>, _>>();
        config.faults = FaultPlan::new(faults.map_err(headset("VERGENCE_XR_FAULTS"))?);
    }
    Ok(config)
}

fn count(name: &'static str, value: String) -> Result<u64, Error> {
    let number = value.parse().ok().filter(|&number: &u64| number > 0);
    number.ok_or(Error::Value { name, expected: "a number from 1", found: value })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(name: &'static str, value: &'static str) -> Result<Config, Error> {
        configuration(|asked| (asked == name).then(|| value.to_owned()))
    }

    #[test]
    fn nothing_said_is_the_default_headset_in_real_time() {
        let config = configuration(|_| None).unwrap();
        assert_eq!((config.clock, config.frames), (ClockMode::RealTime, None));
        assert!(config.capture.is_none());
        assert_eq!(with("VERGENCE_XR_FRAMES", "60").unwrap().frames, Some(60));
        assert_eq!(
            with("VERGENCE_XR_PROFILE", "quest3").unwrap().profile.name,
            Profile::open("quest3").unwrap().name
        );
        assert!(!with("VERGENCE_XR_FAULTS", "xrEndFrame=ERROR_LAYER_INVALID@3").unwrap().faults.is_empty());
    }

    #[test]
    fn wrong_values_are_named() {
        for (name, value) in [
            ("VERGENCE_XR_FRAMES", "0"),
            ("VERGENCE_XR_FRAMES", "many"),
            ("VERGENCE_XR_CLOCK", "sundial"),
            ("VERGENCE_XR_PROFILE", "no-such-headset"),
            ("VERGENCE_XR_MOTION", "no-such-motion"),
            ("VERGENCE_XR_MOTION", "no-such-session.mcap"),
            ("VERGENCE_XR_FAULTS", "xrEndFrame=NO_SUCH_CODE"),
            ("VERGENCE_XR_CAPTURE_EVERY", "-1"),
        ] {
            let Err(error) = with(name, value) else { panic!("{name}={value} is taken") };
            assert!(error.to_string().starts_with(name), "{error}");
        }
        let Err(error) = with("VERGENCE_XR_CAPTURE", "/proc/no/folder") else { panic!("a folder in /proc") };
        assert!(error.to_string().starts_with("/proc"), "{error}");
    }
}
