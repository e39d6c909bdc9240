//! Which headset: the real one where there is one, else the simulated one.

use std::sync::Arc;
use std::time::{Duration, Instant};

use vergence_plan::Plan;
use vergence_time::Timestamp;
use vergence_xr::{Connection, EmbeddedRuntime, State, Way};
use vergence_xr_sim::{ClockMode, Config, PoseProvider, Profile, Runtime};

use crate::capture::Capture;
use crate::config::{HeadsetChoice, RunConfig};
use crate::desk::ByHand;
use crate::error::Error;
use crate::motion::open_followed;
use crate::odometry;
use crate::report::OdometryReport;
use crate::run::Again;

const APP_NAME: &str = "vergence";

/// A headset that was found.
pub(crate) struct Chosen {
    pub(crate) connection: Arc<Connection>,
    pub(crate) is_simulated: bool,
    /// What the simulated headset is; of another one, what it says of its pictures.
    pub(crate) profile: Profile,
    /// Why this one, for people.
    pub(crate) why: String,
}

/// What a run hands to each simulated headset that it makes, one after the other.
pub(crate) struct Handed<'a> {
    pub(crate) capture: Option<&'a Capture>,
    pub(crate) by_hand: Option<ByHand>,
    pub(crate) again: Option<&'a Again>,
    /// What moves it; opened once, so that a file that changes or goes meanwhile changes nothing.
    pub(crate) motion: &'a mut Option<Arc<dyn PoseProvider>>,
    /// How our odometry went, where it moves it.
    pub(crate) odometry: &'a mut Option<OdometryReport>,
    /// What its clock reads at first, where it goes on from an earlier one's.
    pub(crate) begins: Option<Timestamp>,
}

/// Finds the headset that the configuration asks for, waiting for it as long as that says.
pub(crate) fn choose(
    config: &RunConfig,
    plan: &Plan,
    handed: Handed<'_>,
    say: &mut dyn FnMut(&str),
) -> Result<Chosen, Error> {
    match config.headset {
        HeadsetChoice::Simulated => simulated(config, plan, handed, "asked for".into(), say),
        HeadsetChoice::OpenXr => {
            let connection = wait_for_real(config, plan, say)?;
            real(config, connection, "asked for".into())
        }
        HeadsetChoice::Auto => match Connection::open(Way::Loader, APP_NAME, &plan.extensions) {
            Ok(connection) => {
                let unmoved = RunConfig { motion: None, ..config.clone() };
                let chosen = real(&unmoved, connection, "a runtime with a headset was found".into())?;
                if let Some(motion) =
                    config.motion.as_deref().filter(|motion| odometry::folder(motion).is_none())
                {
                    say(&format!(
                        "--motion {motion} is for the simulated headset and is not used: the user moves the head"
                    ));
                }
                Ok(chosen)
            }
            Err(error) => {
                log::info!("{error}");
                simulated(config, plan, handed, error.brief(), say)
            }
        },
    }
}

/// Tries until there is a headset or the time is up.
fn wait_for_real(config: &RunConfig, plan: &Plan, say: &mut dyn FnMut(&str)) -> Result<Connection, Error> {
    let until = Instant::now() + Duration::try_from_secs_f64(config.wait_s).unwrap_or_default();
    let mut said = false;
    loop {
        match Connection::open(Way::Loader, APP_NAME, &plan.extensions) {
            Ok(connection) => return Ok(connection),
            Err(error)
                if error.state() == State::WaitingForRuntime
                    && Instant::now() < until
                    && !config.stop.is_stopped() =>
            {
                if !std::mem::replace(&mut said, true) {
                    say(&format!("{error}; waiting {:.0} s for it", config.wait_s));
                }
                std::thread::sleep(Duration::from_millis(500));
            }
            Err(error) => return Err(error.into()),
        }
    }
}

/// Whether the named motion is for a simulated headset only: our odometry is also of use beside a real one.
pub(crate) fn moves_a_head(config: &RunConfig) -> bool {
    config.motion.as_deref().is_some_and(|motion| odometry::folder(motion).is_none())
}

fn real(config: &RunConfig, connection: Connection, why: String) -> Result<Chosen, Error> {
    let refused = [
        ("--ipd", config.ipd_m.is_some(), "the eye poses are the user's own"),
        ("--motion", moves_a_head(config), "the user moves the head"),
        ("--fault", !config.faults.is_empty(), "it has its own"),
        ("--profile", config.profile.is_some(), "the headset is what it is"),
    ];
    if let Some((option, _, reason)) = refused.iter().find(|(_, given, _)| *given) {
        let runtime = &connection.description().runtime;
        return Err(Error::Call(format!(
            "{option} is for the simulated headset, found a real runtime ({runtime}): {reason}; leave it out, or ask \
             for --headset simulated"
        )));
    }
    let resolution = connection.views().first().map_or((1, 1), |view| view.recommended);
    let name = connection.description().headset.clone();
    let profile = Profile { name, resolution, ..Profile::default() };
    Ok(Chosen { connection: Arc::new(connection), is_simulated: false, profile, why })
}

fn simulated(
    config: &RunConfig,
    plan: &Plan,
    handed: Handed<'_>,
    why: String,
    say: &mut dyn FnMut(&str),
) -> Result<Chosen, Error> {
    let Handed { capture, by_hand, again, motion, odometry, begins } = handed;
    let mut profile = match (again, &config.profile) {
        (Some(again), _) => again.profile.clone(),
        (None, Some(name)) => Profile::open(name)?,
        (None, None) => Profile::default(),
    };
    if let Some(ipd_m) = config.ipd_m {
        if !(0.0..=1.0).contains(&ipd_m) {
            return Err(Error::Call(format!("--ipd: expected 0 to 1000 mm, found {} mm", ipd_m * 1e3)));
        }
        profile = profile.with_ipd(ipd_m);
    }
    let motion = match motion {
        Some(motion) => Arc::clone(motion),
        None => Arc::clone(motion.insert(match (again, config.motion.as_deref(), by_hand) {
            (Some(again), ..) => Arc::new(again.replay.clone()),
            (None, None, Some(by_hand)) => Arc::new(by_hand),
            (None, name, _) => {
                let name = name.unwrap_or("still");
                let (motion, report) = open_followed(name, &|| config.stop.is_stopped(), say)?;
                *odometry = report;
                motion
            }
        })),
    };
    let first = Config::default();
    Runtime::configure(Config {
        profile: profile.clone(),
        motion: Box::new(motion),
        begins: begins.unwrap_or(first.begins),
        clock: if config.real_time || config.window { ClockMode::RealTime } else { ClockMode::Virtual },
        frames: None,
        capture: capture.map(Capture::of_composed_pictures),
        render: true,
        control: config.control.clone(),
        faults: config.faults.clone(),
    });
    let connection = Connection::open(Way::Embedded(embedded()), APP_NAME, &plan.extensions)?;
    Ok(Chosen { connection: Arc::new(connection), is_simulated: true, profile, why })
}

#[allow(unsafe_code)]
fn embedded() -> EmbeddedRuntime {
    // SAFETY: our own runtime conforms: it resolves every core name to a function that checks its arguments.
    unsafe { EmbeddedRuntime::new(vergence_xr_sim::get_instance_proc_addr) }
}
