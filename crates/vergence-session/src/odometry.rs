//! Our own tracking of a recorded rig (`slam:DATASET`): it moves the simulated headset; on a real one, whose runtime says where
//! the head is, its pose is kept beside the runtime's and compared.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use nalgebra::Vector3;
use vergence_geom::{Rigid, log, yaw};
use vergence_sense::Pose;
use vergence_slam::dataset::{Dataset, Rig};
use vergence_slam::follower::Follower;
use vergence_slam::playback::{Mode, Playback};
use vergence_slam::{Estimate, Params, State};
use vergence_stream::{How, PoseHistory, Reach};
use vergence_time::{Span, Timestamp};
use vergence_vision::TrackerKnobs;
use vergence_xr_sim::motion::{AtEnd, Gaps, Motion, Sample, Trajectory};

use crate::error::Error;
use crate::report::OdometryReport;
use crate::rig_log::RigLog;

/// What the name of such a motion begins with.
const PREFIX: &str = "slam:";
/// Eyes above the floor where the rig starts, metres.
const EYE_HEIGHT_M: f64 = 1.6;
/// Without a pose for longer than so many periods of the cameras, the head is held, not tracked.
const PERIODS_BRIDGED: f64 = 3.5;
/// Poses that may wait for their time to come: half a minute of a camera at 20 Hz, 200 bytes each.
const AHEAD: usize = 600;

/// The recording that a motion names: a folder or a log; `None` for another motion.
pub(crate) fn folder(motion: &str) -> Option<&Path> {
    motion.strip_prefix(PREFIX).map(Path::new)
}

/// A recorded rig: the folder of a data set, or a session log that has one.
enum Recording {
    Folder(Box<Dataset>),
    Log(RigLog),
}

impl Recording {
    fn open(path: &Path) -> Result<Self, Error> {
        if RigLog::is_log(path) {
            return RigLog::open(path).map(Self::Log);
        }
        Ok(Self::Folder(Box::new(Dataset::open(path)?)))
    }

    fn rig(&self) -> Rig {
        match self {
            Self::Folder(dataset) => dataset.rig(),
            Self::Log(log) => log.rig.clone(),
        }
    }

    /// The one in which most of its sensors take part.
    fn mode(&self) -> Mode {
        match self {
            Self::Folder(dataset) => Mode::of(dataset),
            Self::Log(log) => Mode::of_rig(&log.rig),
        }
    }

    /// Frames, where that is known before they are followed.
    fn frames(&self) -> Option<usize> {
        match self {
            Self::Folder(dataset) => Some(dataset.frames.len()),
            Self::Log(_) => None,
        }
    }

    /// Follows the whole recording, as far as `take` lets it.
    fn follow(&self, mut take: impl FnMut(&Estimate) -> bool) -> Result<(), Error> {
        let (mode, knobs, params) = (self.mode(), TrackerKnobs::default(), Params::default());
        match self {
            Self::Folder(dataset) => {
                let mut playback = Playback::new(dataset, mode, knobs, params)?;
                for frame in 0..dataset.frames.len() {
                    let loaded = Playback::load(dataset, mode, frame)?;
                    if !take(&playback.follow(frame, &loaded)?) {
                        break;
                    }
                }
            }
            Self::Log(log) => {
                let follower = Follower::new(log.path(), &log.rig, mode, knobs, params, 1)?;
                log.follow(follower, |follower| {
                    while let Some(estimate) = follower.follow()? {
                        if !take(&estimate) {
                            return Ok(false);
                        }
                    }
                    Ok(true)
                })?;
            }
        }
        Ok(())
    }
}

/// A head for a rig: between the eyes is where the first camera is, and it looks where that looks (x right, y down, z ahead
/// become x right, y up, −z ahead).
fn body_from_head(rig: &Rig) -> Rigid {
    let camera_from_head = Rigid::rotation(Vector3::x() * std::f64::consts::PI);
    rig.cameras.first().map_or(camera_from_head, |camera| camera.body_from_camera * camera_from_head)
}

/// The motion of the simulated headset: as our odometry says, from the user's start; it ends with the recording. The whole
/// recording is followed first, since a pose provider gives the same answer whenever it is asked.
pub(crate) fn motion(
    folder: &Path,
    is_stopped: &dyn Fn() -> bool,
    say: &mut dyn FnMut(&str),
) -> Result<(Motion, OdometryReport), Error> {
    let recording = Recording::open(folder)?;
    let name = folder.display();
    let frames = recording.frames().map_or("frames".to_owned(), |count| format!("{count} frames"));
    say(&format!("following the {frames} of {name} ({}) before the session", recording.mode()));
    let mut samples = Vec::with_capacity(recording.frames().unwrap_or(0));
    let (mut held, mut tracked, mut count, mut begins_ends) = (0usize, 0usize, 0usize, None);
    let mut doubt = None;
    let mut followed = Followed::default();
    recording.follow(|estimate| {
        count += 1;
        followed.add(estimate);
        begins_ends = Some((begins_ends.map_or(estimate.time, |(begins, _)| begins), estimate.time));
        match estimate.state {
            State::Tracked | State::Coasting => tracked += 1,
            state => doubt = Some(state),
        }
        match estimate.state {
            State::Waiting | State::Lost | State::Disagreeing => held += 1,
            _ => samples.push(Sample { at: estimate.time, world_from_body: estimate.world_from_body }),
        }
        !is_stopped()
    })?;
    if held > 0 {
        say(&format!("{name}: tracking is lost in {held} of {count} frames; the head is held there"));
    }
    if let Some(doubt) = doubt.filter(|_| tracked * 2 < count) {
        say(&format!(
            "{name}: {tracked} of {count} frames are tracked; of the others at last: {}",
            doubt.says()
        ));
    }
    let mut report = OdometryReport {
        dataset: name.to_string(),
        mode: recording.mode().to_string(),
        ..OdometryReport::default()
    };
    followed.tell(&mut report);
    let lasts = begins_ends.and_then(|(begins, ends)| ends.since(begins)).map_or(0.0, Span::as_secs_f64);
    say(&format!("{}; the motion ends after {lasts:.2} s, and the session with it", report.followed()));
    let nothing = || Error::Call(format!("{name}: expected frames that can be followed, found none"));
    let begins = samples.first().ok_or_else(nothing)?.at;
    let period = begins_ends.and_then(|(begins, ends)| period(begins, ends, count));
    let bridged = period.and_then(|period| Span::from_secs_f64(period * PERIODS_BRIDGED));
    let step = bridged.unwrap_or(Span::from_millis(175));
    let trajectory = Trajectory::new(samples, begins, AtEnd::Stop, Gaps::Hold, step).ok_or_else(nothing)?;
    Ok((Motion::from_start(trajectory, body_from_head(&recording.rig()), EYE_HEIGHT_M), report))
}

/// How a recording was followed so far.
#[derive(Clone, Debug, Default)]
struct Followed {
    frames: u64,
    by_state: BTreeMap<&'static str, u64>,
    last: Option<State>,
}

impl Followed {
    fn add(&mut self, estimate: &Estimate) {
        self.frames += 1;
        *self.by_state.entry(estimate.state.word()).or_default() += 1;
        self.last = Some(estimate.state);
    }

    fn tell(&self, report: &mut OdometryReport) {
        report.frames = self.frames;
        report.frames_by_state =
            self.by_state.iter().map(|(word, count)| ((*word).to_owned(), *count)).collect();
        report.says = self.last.unwrap_or(State::Waiting).says().to_owned();
    }
}

/// From one frame to the next on the average, seconds.
fn period(first: Timestamp, last: Timestamp, frames: usize) -> Option<f64> {
    let steps = frames.checked_sub(1).filter(|steps| *steps > 0)?;
    Some(last.since(first)?.as_secs_f64() / steps as f64)
}

/// Odometry beside a real headset. It runs on a thread of its own, ahead of the session; each pose is taken when its time has
/// come, and carried on to the display time as that of a live rig would have to be.
pub(crate) struct Beside {
    poses: Receiver<Result<(Span, Rigid), Error>>,
    thread: Option<JoinHandle<()>>,
    /// Taken and not due yet.
    next: Option<(Span, Rigid)>,
    /// On the recording's clock, from its first frame.
    history: PoseHistory,
    /// The display time at which the recording began.
    begins: Option<Timestamp>,
    /// How far into the recording the latest frame was.
    reached: Span,
    comparison: Comparison,
    failure: Option<Error>,
    dataset: PathBuf,
    mode: Mode,
    /// The thread counts in it.
    followed: Arc<Mutex<Followed>>,
}

impl Beside {
    /// Opens the recording and begins to follow it.
    pub(crate) fn start(folder: &Path) -> Result<Self, Error> {
        let recording = Recording::open(folder)?;
        let mode = recording.mode();
        let (give, poses) = sync_channel(AHEAD);
        let followed = Arc::<Mutex<Followed>>::default();
        let counted = Arc::clone(&followed);
        let work = move || {
            let body_from_head = body_from_head(&recording.rig());
            let mut first = None;
            let followed = recording.follow(|estimate| {
                counted.lock().unwrap_or_else(PoisonError::into_inner).add(estimate);
                let begins = *first.get_or_insert(estimate.time);
                let is_known = !matches!(estimate.state, State::Waiting | State::Lost | State::Disagreeing);
                let pose = estimate.time.since(begins).filter(|_| is_known);
                // Where nobody takes it any more, the session is over.
                pose.is_none_or(|at| give.send(Ok((at, estimate.world_from_body * body_from_head))).is_ok())
            });
            if let Err(error) = followed {
                // As above.
                let _ = give.send(Err(error));
            }
        };
        let thread = std::thread::Builder::new().name("odometry".into()).spawn(work);
        let thread = thread.map_err(Error::read(folder))?;
        let mut beside = Self::of(poses, Some(thread), folder, mode);
        beside.followed = followed;
        Ok(beside)
    }

    fn of(
        poses: Receiver<Result<(Span, Rigid), Error>>,
        thread: Option<JoinHandle<()>>,
        folder: &Path,
        mode: Mode,
    ) -> Self {
        Self {
            poses,
            thread,
            next: None,
            history: PoseHistory::new(&Reach::default()),
            begins: None,
            reached: Span::ZERO,
            comparison: Comparison::default(),
            failure: None,
            dataset: folder.to_owned(),
            mode,
            followed: Arc::default(),
        }
    }

    /// Where our odometry has the head at a display time, in its own world (y up); compared with where the runtime has it, in
    /// LOCAL space. `None` before the recording, behind it, and where the odometry has not come so far. Neither waits nor
    /// allocates.
    pub(crate) fn at(&mut self, display: Timestamp, local_from_head: Option<&Rigid>) -> Option<Pose> {
        let earlier = display.saturating_add(Span::from_nanos(self.reached.as_nanos().saturating_neg()));
        let begins = *self.begins.get_or_insert(earlier);
        let at = display.since(begins)?;
        self.reached = at;
        while let Some((time, pose)) = self.take_until(at) {
            self.history.push(instant(time), Pose::tracked(pose), None);
        }
        let answer = self.history.at(instant(at));
        if answer.how == How::Lost {
            return None;
        }
        if let Some((ours, theirs)) = answer.pose.reference_from_device().zip(local_from_head) {
            self.comparison.add(&ours, theirs);
        }
        Some(answer.pose)
    }

    fn take_until(&mut self, at: Span) -> Option<(Span, Rigid)> {
        if self.next.is_none() {
            self.next = match self.poses.try_recv() {
                Ok(Ok(pose)) => Some(pose),
                Ok(Err(error)) => {
                    self.failure = Some(error);
                    None
                }
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => None,
            };
        }
        self.next.take_if(|(time, _)| *time <= at)
    }

    /// The session's clock was set: the time between the frame before and this one has not passed.
    pub(crate) fn rebase(&mut self) {
        self.begins = None;
    }

    /// How the two compare, and why the odometry ended early where it did.
    pub(crate) fn finish(mut self) -> (OdometryReport, Option<String>) {
        let (position_rms_m, rotation_rms_deg) = self.comparison.rms();
        let mut report = OdometryReport {
            dataset: self.dataset.display().to_string(),
            mode: self.mode.to_string(),
            compared: self.comparison.count,
            position_rms_m,
            rotation_rms_deg,
            ..OdometryReport::default()
        };
        self.followed.lock().unwrap_or_else(PoisonError::into_inner).tell(&mut report);
        (report, self.failure.take().map(|error| crate::error::with_cause(&error)))
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        // Without a receiver the thread ends at its next pose.
        self.poses = sync_channel(0).1;
        if let Some(thread) = self.thread.take() {
            // It says what fails through the channel.
            let _ = thread.join();
        }
    }
}

/// An instant on the recording's clock.
fn instant(since_first: Span) -> Timestamp {
    Timestamp::default().saturating_add(since_first)
}

/// Two tracks of one head. Both worlds have y up, so they differ by a turn about the vertical and a shift, which the first
/// pair gives.
#[derive(Debug, Default)]
struct Comparison {
    theirs_from_ours: Option<Rigid>,
    count: u64,
    position_m2: f64,
    rotation_rad2: f64,
}

impl Comparison {
    fn add(&mut self, ours: &Rigid, theirs: &Rigid) {
        let aligned = self.theirs_from_ours.get_or_insert_with(|| {
            let turn = yaw(&(theirs * ours.inverse()).rotation);
            let shift = theirs.translation.vector - turn * ours.translation.vector;
            Rigid::from_parts(shift.into(), turn)
        });
        let ours = *aligned * ours;
        self.count += 1;
        self.position_m2 += (ours.translation.vector - theirs.translation.vector).norm_squared();
        self.rotation_rad2 += log(&(ours.rotation.inverse() * theirs.rotation)).norm_squared();
    }

    /// Position in metres, rotation in degrees.
    fn rms(&self) -> (f64, f64) {
        let rms = |sum: f64| (sum / self.count.max(1) as f64).sqrt();
        (rms(self.position_m2), rms(self.rotation_rad2).to_degrees())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A head that goes ahead at 1 m/s and turns at 0.5 rad/s.
    fn way(at: Span) -> Rigid {
        let s = at.as_secs_f64();
        Rigid::new(Vector3::new(0.0, 0.0, -s), Vector3::y() * (0.5 * s))
    }

    fn beside(poses: i64) -> Beside {
        let (give, take) = sync_channel(AHEAD);
        for number in 0..poses {
            let at = Span::from_millis(50 * number);
            give.send(Ok((at, way(at)))).expect("there is room");
        }
        Beside::of(take, None, Path::new("recording"), Mode::StereoInertial)
    }

    #[test]
    fn what_two_trackers_say_of_one_head_differs_by_the_prediction_alone() {
        let mut beside = beside(40);
        // The runtime's origin is elsewhere and turned.
        let local_from_ours = Rigid::new(Vector3::new(3.0, -1.0, 2.0), Vector3::y() * 2.0);
        let begins = Timestamp::from_nanos(1_400_000_000_000_000_000);
        for frame in 0..180 {
            let at = Span::from_nanos(frame * 11_111_111);
            let display = begins.saturating_add(at);
            let found = beside.at(display, Some(&(local_from_ours * way(at))));
            let found = found.and_then(|pose| pose.reference_from_device());
            // At first there is no velocity to go on with.
            if frame > 5 {
                let found = found.expect("a pose is carried 50 ms ahead");
                let off = (found.translation.vector - way(at).translation.vector).norm();
                assert!(off < 1e-9, "frame {frame}: {off}");
            }
        }
        let (report, failure) = beside.finish();
        assert_eq!((report.compared, failure), (180, None));
        // Five frames of the first 50 ms without a velocity: up to 50 mm and 1.4 degrees.
        assert!(report.position_rms_m < 8e-3 && report.rotation_rms_deg < 0.25, "{report:?}");
    }

    #[test]
    fn what_ends_is_not_carried_on_for_ever() {
        let mut beside = beside(3);
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        assert!(beside.at(at(0), None).is_some());
        assert!(beside.at(at(150), None).is_some());
        assert!(beside.at(at(450), None).is_none());
        assert_eq!(beside.finish().0.compared, 0);
    }
}
