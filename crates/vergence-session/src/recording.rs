//! Writes a session's log: which stream each thing that was said goes to.

use vergence_action::{ActionSet, Kind};
use vergence_log::{Header, Options, Recorder, Stream, StreamDesc, Times};
use vergence_sense::{
    Axis, Body, Button, CallResult, ControlState, Event, FrameHash, FrameTiming, Hand, Haptic, Pose,
    RawJoints, RawLocation, RawViews, Said, Scalar, Vector2,
};
use vergence_time::{Span, Timestamp};
use vergence_xr::Client;
use vergence_xr_sim::motion::{RUN_ENDED, SESSION_BEGINS};

use crate::book::SessionNow;
use crate::config::RecordConfig;
use crate::error::Error;
use crate::headset::Chosen;
use crate::provenance;
use crate::report::RecordReport;
use crate::resolved::Resolved;
use crate::run::Run;

/// Names of the streams of a session log.
pub(crate) mod name {
    pub(crate) const EVENTS: &str = "/session/events";
    pub(crate) const RESULTS: &str = "/session/results";
    pub(crate) const TIMING: &str = "/frame/timing";
    pub(crate) const HASHES: &str = "/frame/hashes";
    pub(crate) const VIEWS: &str = "/views/located";
    pub(crate) const SUBMITTED: &str = "/views/submitted";
    pub(crate) const HEAD: &str = "/head";
    pub(crate) const FLOOR: &str = "/floor";
    pub(crate) const GAZE: &str = "/gaze";
    pub(crate) const ODOMETRY: &str = "/odometry/head";
    pub(crate) const JOINTS: [&str; 2] = ["/hand/left/joints", "/hand/right/joints"];
    /// `/action/NAME/HAND`
    pub(crate) const ACTION: &str = "/action/";
    /// The recorder's own.
    pub(crate) const RECORDER: &str = "/recorder/events";
}

/// The reference frame of every pose: OpenXR's LOCAL.
const LOCAL: &str = "local";

enum ActionStream {
    Place(Stream<RawLocation>),
    Button(Stream<Button>),
    Axis(Stream<Axis>),
    Vector2(Stream<Vector2>),
    Haptic(Stream<Haptic>),
}

/// A recording in progress.
pub(crate) struct Recording {
    recorder: Recorder,
    now: SessionNow,
    is_virtual: bool,
    timing: Option<FrameTiming>,
    events: Stream<Event>,
    results: Stream<CallResult>,
    timings: Stream<FrameTiming>,
    hashes: Option<Stream<FrameHash>>,
    views: Stream<RawViews>,
    submitted: Stream<RawViews>,
    head: Stream<RawLocation>,
    floor: Stream<RawLocation>,
    gaze: Option<Stream<RawLocation>>,
    joints: Option<[Stream<RawJoints>; 2]>,
    /// Where our own tracking has the head, beside a real headset.
    odometry: Option<Stream<Pose>>,
    /// By the action's place; left, right.
    actions: Vec<[ActionStream; 2]>,
    diagnostics: [Stream<Scalar>; 3],
}

/// What a session has, and so its log.
struct Contents<'a> {
    actions: &'a ActionSet,
    hand_joints: bool,
    eye_gaze: bool,
    odometry: bool,
    /// What pictures that are hashed are like.
    hashes: Option<String>,
    /// The session's clock stands still between frames.
    is_virtual: bool,
}

impl Recording {
    /// Starts the recording of a run whose first session has just been made.
    pub(crate) fn begin(
        run: &mut Run<'_>,
        config: &RecordConfig,
        chosen: &Chosen,
        client: &Client,
        hashes: bool,
    ) -> Result<Self, Error> {
        let actions: Vec<String> =
            run.plan.actions.actions.iter().map(|action| action.name.to_owned()).collect();
        // A runtime's own faults are done again in a replay, which therefore asks for what the simulated headset has, be it
        // that a fault took it away. What another runtime did not offer is not in a replay.
        let has = |asked: bool, simulated: bool, read: bool| {
            if chosen.is_simulated { asked && simulated } else { read }
        };
        let hand_joints = has(run.config.hand_joints, chosen.profile.hands, client.reads_hand_joints());
        let eye_gaze = has(run.config.eye_gaze, chosen.profile.gaze, client.reads_gaze());
        let mut profile = chosen.profile.clone();
        if let (false, Some(rate)) = (chosen.is_simulated, client.refresh_rate_hz()) {
            // What it was asked for, or had; its others are of no use to a replay.
            profile.rates_hz = vec![f64::from(rate)];
        }
        let resolved = Resolved {
            hash_frames: hashes,
            build: if hashes { provenance::build() } else { String::new() },
            hand_joints,
            eye_gaze,
            without_clock: client.without().clock,
            without_floor: client.without().floor,
            views: client.pictures().views,
            ..Resolved::of(&run.config, &profile, chosen.is_simulated, actions)
        };
        let is_virtual = resolved.simulated && !resolved.real_time;
        let configuration =
            serde_json::to_string(&resolved).map_err(|error| Error::Call(error.to_string()))?;
        let header = Header {
            application: concat!("vergence ", env!("CARGO_PKG_VERSION")).to_owned(),
            headset: run.report.headset.clone(),
            runtime: run.report.runtime.clone(),
            device: run.report.device.clone(),
            driver: client.driver().to_owned(),
            clock: if is_virtual { "virtual" } else { "monotonic" }.to_owned(),
            scene_path: provenance::scene_path(&run.scene),
            scene_hash: provenance::scene_hash(&run.scene)?,
            configuration,
            ..Header::default()
        };
        let contents = Contents {
            actions: &run.plan.actions,
            hand_joints,
            eye_gaze,
            odometry: run.beside.is_some(),
            hashes: hashes.then(|| hashed(&client.pictures())),
            is_virtual,
        };
        let mut recording = Self::create(config, &header, &contents)?;
        // What happens before the first frame happens now.
        recording.now = SessionNow::new(client.now().unwrap_or_default(), is_virtual);
        if config.attach_scene {
            recording.attach(&provenance::named_files(&run.scene));
        }
        let path = config.path.display().to_string();
        run.report.recording = Some(RecordReport { path, ..RecordReport::default() });
        Ok(recording)
    }

    fn create(
        config: &RecordConfig,
        header: &Header,
        contents: &Contents<'_>,
    ) -> Result<Self, vergence_log::Error> {
        let options = Options { durable: config.durable, ..Options::default() };
        let mut recorder = Recorder::create(&config.path, header, &options)?;
        let local = |name: &str| StreamDesc::new(name).frame(LOCAL);
        let host = |name: &str| StreamDesc::new(name).unit("ms").host_time();
        let odometry = StreamDesc::new(name::ODOMETRY).frame("odometry");
        let mut actions = Vec::with_capacity(contents.actions.actions.len());
        for action in &contents.actions.actions {
            let mut of = |hand: Hand| -> Result<ActionStream, vergence_log::Error> {
                let desc = StreamDesc::new(format!("{}{}/{}", name::ACTION, action.name, hand.name()));
                Ok(match action.kind {
                    Kind::Pose => ActionStream::Place(recorder.stream(&desc.frame(LOCAL))?),
                    Kind::Button => ActionStream::Button(recorder.stream(&desc)?),
                    Kind::Axis => ActionStream::Axis(recorder.stream(&desc)?),
                    Kind::Vector2 => ActionStream::Vector2(recorder.stream(&desc)?),
                    Kind::Haptic => ActionStream::Haptic(recorder.stream(&desc)?),
                })
            };
            actions.push([of(Hand::Left)?, of(Hand::Right)?]);
        }
        let joints = if contents.hand_joints {
            let [left, right] = name::JOINTS;
            Some([recorder.stream(&local(left))?, recorder.stream(&local(right))?])
        } else {
            None
        };
        Ok(Self {
            now: SessionNow::new(Timestamp::default(), contents.is_virtual),
            is_virtual: contents.is_virtual,
            timing: None,
            events: recorder.stream(&StreamDesc::new(name::EVENTS))?,
            results: recorder.stream(&StreamDesc::new(name::RESULTS))?,
            timings: recorder.stream(&StreamDesc::new(name::TIMING))?,
            hashes: match &contents.hashes {
                Some(of) => Some(recorder.stream(&StreamDesc::new(name::HASHES).note("hash", of))?),
                None => None,
            },
            views: recorder.stream(&local(name::VIEWS))?,
            submitted: recorder.stream(&local(name::SUBMITTED))?,
            head: recorder.stream(&local(name::HEAD))?,
            floor: recorder.stream(&local(name::FLOOR))?,
            gaze: contents.eye_gaze.then(|| recorder.stream(&local(name::GAZE))).transpose()?,
            joints,
            odometry: contents.odometry.then(|| recorder.stream(&odometry)).transpose()?,
            actions,
            diagnostics: [
                recorder.stream(&host("/diagnostics/frame_cpu"))?,
                recorder.stream(&host("/diagnostics/pose_age"))?,
                recorder.stream(&host("/diagnostics/recording"))?,
            ],
            recorder,
        })
    }

    /// Keeps one thing that was said. Neither waits nor allocates once the largest message has been seen.
    pub(crate) fn hear(&mut self, said: &Said, frame: u64) {
        let now = self.now.read();
        let Self { recorder, .. } = self;
        match said {
            Said::Event(event) => {
                // A frame that is still open then is never ended.
                let abandoned = abandons(event).then(|| self.timing.take()).flatten();
                let abandon = |recorder: &mut Recorder| {
                    if let Some(timing) = abandoned {
                        let times = Times::new(timing.predicted_display, now);
                        recorder.write(&self.timings, times, &FrameTiming { ended: false, ..timing });
                    }
                };
                // That the session stops came while the frame was open; another one, or none, begins behind it.
                if is_stop(event) {
                    recorder.write(&self.events, Times::at(now), event);
                    abandon(recorder);
                } else {
                    abandon(recorder);
                    recorder.write(&self.events, Times::at(now), event);
                }
            }
            Said::Result(result) => recorder.write(&self.results, Times::at(now), result),
            Said::Frame { now, display, period, should_render, raw_display, raw_period } => {
                self.now = SessionNow::new(*now, self.is_virtual);
                self.timing = Some(FrameTiming {
                    frame,
                    wait_returned: *now,
                    begun: *now,
                    submitted: None,
                    predicted_display: *display,
                    predicted_period: *period,
                    should_render: *should_render,
                    presented: None,
                    raw_display: *raw_display,
                    raw_period: *raw_period,
                    ended: true,
                });
            }
            Said::Views { at, views } => recorder.write(&self.views, Times::new(*at, now), views),
            Said::Place { of, at, location } => {
                let stream = match of {
                    Body::Head => Some(&self.head),
                    Body::Floor => Some(&self.floor),
                    Body::Gaze => self.gaze.as_ref(),
                    Body::Action(action, hand) => match self.actions.get(usize::from(*action)) {
                        Some(hands) => match &hands[hand.index()] {
                            ActionStream::Place(stream) => Some(stream),
                            _ => None,
                        },
                        None => None,
                    },
                };
                if let Some(stream) = stream {
                    recorder.write(stream, Times::new(*at, now), location);
                }
            }
            Said::Control { action, hand, at, state } => {
                let Some(hands) = self.actions.get(usize::from(*action)) else { return };
                let times = Times::new(*at, now);
                match (&hands[hand.index()], state) {
                    (ActionStream::Button(stream), ControlState::Button(value)) => {
                        recorder.write(stream, times, value);
                    }
                    (ActionStream::Axis(stream), ControlState::Axis(value)) => {
                        recorder.write(stream, times, value);
                    }
                    (ActionStream::Vector2(stream), ControlState::Vector2(value)) => {
                        recorder.write(stream, times, value);
                    }
                    _ => {}
                }
            }
            Said::Joints { hand, at, joints } => {
                if let Some(streams) = &self.joints {
                    recorder.write(&streams[hand.index()], Times::new(*at, now), joints);
                }
            }
            Said::Haptic { action, hand, haptic } => {
                if let Some(ActionStream::Haptic(stream)) =
                    self.actions.get(usize::from(*action)).map(|hands| &hands[hand.index()])
                {
                    recorder.write(stream, Times::at(now), haptic);
                }
            }
            Said::Hash(hash) => {
                if let Some(stream) = &self.hashes {
                    recorder.write(stream, Times::at(now), hash);
                }
            }
            Said::Submitted { display, views } => {
                if let Some(views) = views {
                    recorder.write(&self.submitted, Times::new(*display, now), views);
                }
                // Last: a frame whose times are there is whole.
                if let Some(timing) = self.timing.take() {
                    let timing = FrameTiming { submitted: views.map(|_| now), ..timing };
                    recorder.write(&self.timings, Times::new(*display, now), &timing);
                }
            }
        }
    }

    /// Keeps where our own tracking has the head at a display time.
    pub(crate) fn beside(&mut self, display: Timestamp, pose: &Pose) {
        if let Some(stream) = &self.odometry {
            self.recorder.write(stream, Times::new(display, self.now.read()), pose);
        }
    }

    pub(crate) fn diagnose(&mut self, cpu: Span, pose_age: Span, recording: Span) {
        let times = Times::at(self.now.read());
        for (stream, span) in self.diagnostics.iter().zip([cpu, pose_age, recording]) {
            self.recorder.write(stream, times, &Scalar(span.as_millis_f64()));
        }
    }

    /// Why nothing is recorded any more; said once.
    pub(crate) fn failure(&mut self) -> Option<vergence_log::Error> {
        self.recorder.failure()
    }

    /// Puts the scene's files into the log.
    pub(crate) fn attach(&self, files: &[(String, std::path::PathBuf)]) {
        for (name, path) in files {
            self.recorder.attach(name, "application/octet-stream", path);
        }
    }

    /// Writes what is left and ends the file: how that went, and why it failed where that was not said before.
    pub(crate) fn close(self) -> (vergence_log::Status, Option<vergence_log::Error>) {
        self.recorder.close()
    }
}

/// Whether a session stops, with its frames.
pub(crate) fn is_stop(event: &Event) -> bool {
    event.name == "session_state" && event.text == "STOPPING"
}

/// Whether a frame that is open at this event is never ended.
pub(crate) fn abandons(event: &Event) -> bool {
    is_stop(event) || matches!(&*event.name, SESSION_BEGINS | RUN_ENDED)
}

/// What the hash of a picture is of, for readers of the log.
fn hashed(pictures: &vergence_xr::Pictures) -> String {
    let (width, height) = pictures.size;
    format!(
        "BLAKE3 (32 bytes) of the {width} x {height} pixels that the renderer wrote for the view, rows from the top, {:?}, \
         no padding",
        pictures.color_format
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_xr_sim::motion::EXIT_REQUESTED;

    /// Who writes a reader from the page must find every stream and event that a session writes.
    #[test]
    fn the_format_page_names_every_stream_and_event() {
        let page = include_str!("../../vergence-log/FORMAT.md");
        let streams = [
            name::EVENTS,
            name::RESULTS,
            name::TIMING,
            name::HASHES,
            name::VIEWS,
            name::SUBMITTED,
            name::HEAD,
            name::FLOOR,
            name::GAZE,
            name::JOINTS[0],
            name::JOINTS[1],
            "/diagnostics/frame_cpu",
            "/diagnostics/pose_age",
            "/diagnostics/recording",
        ];
        let events = [SESSION_BEGINS, EXIT_REQUESTED, RUN_ENDED];
        let of_the_runtime = [
            "session_state",
            "space_changing",
            "interaction_profile_changed",
            "visibility_mask_changed",
            "refresh_rate_changed",
            "instance_loss_pending",
            "events_lost",
            "time_fault",
            "time_rebased",
        ];
        for name in streams.into_iter().chain(events).chain(of_the_runtime) {
            assert!(page.contains(&format!("`{name}`")), "FORMAT.md does not name {name}");
        }
    }
}
