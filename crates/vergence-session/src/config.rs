use std::path::PathBuf;

use vergence_render::Quality;

use crate::stop::Stop;

/// Which headset to show the scene on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HeadsetChoice {
    /// A real runtime where the loader finds one with a headset, else the simulated one.
    #[default]
    Auto,
    /// The system's OpenXR runtime.
    OpenXr,
    /// The simulated one.
    Simulated,
}

/// Pictures of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CaptureConfig {
    /// Folder; made where it is missing. What an earlier run has written there is replaced; a folder with other
    /// pictures of the same names is refused.
    pub dir: PathBuf,
    /// Every how many frames a picture is written. `None`: each one of runs of up to 300 frames, else the first and the
    /// last one.
    pub every: Option<u64>,
}

/// The recording of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordConfig {
    /// The log; one that is there is replaced.
    pub path: PathBuf,
    /// Asks the disk to have each chunk before the next begins: a power cut loses no more than a kill.
    pub durable: bool,
    /// Whether the colour pictures are hashed, so that a replay can tell whether it draws the same. Each frame is then
    /// waited for and read back before it is handed over: the GPU no longer draws while the next frame is recorded, and
    /// the frame takes the copy and the hash of its bytes longer. `None`: on the simulated headset, whose virtual clock
    /// does not notice.
    pub hash_frames: Option<bool>,
    /// Puts the scene's files into the log.
    pub attach_scene: bool,
}

/// What to run, where, for how long, and what to write down.
#[derive(Clone, Debug)]
pub struct RunConfig {
    /// Which headset.
    pub headset: HeadsetChoice,
    /// Of the simulated headset: a built-in profile or a file; `None`: the default one.
    pub profile: Option<String>,
    /// Of the simulated headset: `still`, a built-in motion or script, or a file; `None`: still.
    pub motion: Option<String>,
    /// Of the simulated headset: distance between the eyes, metres; `None`: as the profile says.
    pub ipd_m: Option<f64>,
    /// The simulated headset keeps to the wall clock instead of running as fast as it can.
    pub real_time: bool,
    /// Ends after so many frames were shown.
    pub frames: Option<u64>,
    /// Ends after so many seconds of session time.
    pub seconds: Option<f64>,
    /// How long to wait for a runtime and a headset that are not there yet, seconds. Default 0.
    pub wait_s: f64,
    /// How long the run waits for its first frame before it gives up, seconds of the host's clock. Default 60; a headset
    /// that nobody wears shows none. Later, only the time counts in which the headset wants pictures and none can be
    /// shown: who has worn it may put it down.
    pub patience_s: f64,
    /// How long the runtime may take to say when the next frame begins before it is taken for hung, seconds. Default 10.
    pub hang_s: f64,
    /// How often a lost session is asked for anew. Default 3.
    pub retries: u32,
    /// Mirrors the pictures in a window and ends when that is closed. The simulated headset then keeps to the wall clock,
    /// and where no motion is named, mouse and keys move its user: drag to look, W A S D and Q E to go, right button or
    /// space to take.
    pub window: bool,
    /// The renderer's knobs.
    pub quality: Quality,
    /// Pictures, poses and the report as files.
    pub capture: Option<CaptureConfig>,
    /// Where every frame's located poses are written, a JSON object per line.
    pub log_poses: Option<PathBuf>,
    /// Records the session.
    pub record: Option<RecordConfig>,
    /// Reads the joints of both hands.
    pub hand_joints: bool,
    /// Reads where the user looks.
    pub eye_gaze: bool,
    /// The display's rate, where it can be chosen, Hz.
    pub refresh_rate_hz: Option<f32>,
    /// Vulkan validation with synchronization validation, where it is installed; its messages are counted in the report.
    pub validation: bool,
    /// A hand on the simulated headset, for tests: recentring, taking it off, losing the session.
    pub control: vergence_xr_sim::Control,
    /// What the simulated headset does wrong. Only there.
    pub faults: vergence_xr_sim::FaultPlan,
    /// Ends the run from outside.
    pub stop: Stop,
}

impl Default for RunConfig {
    fn default() -> Self {
        Self {
            headset: HeadsetChoice::Auto,
            profile: None,
            motion: None,
            ipd_m: None,
            real_time: false,
            frames: None,
            seconds: None,
            wait_s: 0.0,
            patience_s: 60.0,
            hang_s: 10.0,
            retries: 3,
            window: false,
            quality: Quality::default(),
            capture: None,
            log_poses: None,
            record: None,
            hand_joints: false,
            eye_gaze: false,
            refresh_rate_hz: None,
            validation: false,
            control: vergence_xr_sim::Control::default(),
            faults: vergence_xr_sim::FaultPlan::default(),
            stop: Stop::default(),
        }
    }
}
