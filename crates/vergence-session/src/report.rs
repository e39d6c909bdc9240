//! What a run was like, for people and for other programs.

use std::collections::BTreeMap;

use serde::Serialize;

/// Percentiles of something that is measured once per frame, milliseconds. Zero where nothing was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Milliseconds {
    /// Half of the frames took less.
    pub p50: f64,
    /// 19 of 20 took less.
    pub p95: f64,
    /// 99 of 100 took less.
    pub p99: f64,
    /// The longest.
    pub max: f64,
}

/// Time of one pass on the Vulkan device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PassReport {
    /// The pass.
    pub name: String,
    /// Milliseconds, of the last frame that was measured.
    pub ms: f64,
}

/// Something was pointed at or taken.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Touch {
    /// Frame, counted from 0.
    pub frame: u64,
    /// `left` or `right`.
    pub hand: &'static str,
    /// `pointed`, `taken` or `released`.
    pub what: &'static str,
    /// Name of what was touched.
    pub name: String,
}

/// What became of a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RecordReport {
    /// The log.
    pub path: String,
    /// Messages that were taken.
    pub messages: u64,
    /// Of these, messages that are not in the file.
    pub dropped: u64,
    /// Host time per frame that recording took on the frame's thread, microseconds.
    pub frame_us: Milliseconds,
    /// Why it ended early; `None` where it did not.
    pub error: Option<String>,
}

impl RecordReport {
    /// Takes over how the recording ended, whatever `failure` was not said before.
    pub(crate) fn end(&mut self, status: vergence_log::Status, failure: Option<&vergence_log::Error>) {
        (self.messages, self.dropped) = (status.taken, status.dropped);
        if let Some(error) = failure {
            self.error = Some(crate::error::with_cause(error));
        } else if status.failed && self.error.is_none() {
            self.error = Some(format!("{}: recording ended early, and nobody knows why", self.path));
        }
    }

    /// What the log lacks, in a sentence; `None` where it holds all that was said.
    pub fn shortfall(&self) -> Option<String> {
        let dropped =
            || format!("{} messages found the recorder's queue full and are not in the log", self.dropped);
        self.error.clone().or_else(|| (self.dropped > 0).then(dropped))
    }
}

/// Our odometry of a recorded rig. It moves the simulated headset; beside a real one, it says how far the two are apart, after they were aligned
/// at the first pose of both.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct OdometryReport {
    /// The recording that was followed.
    pub dataset: String,
    /// The sensors that took part.
    pub mode: String,
    /// Frames that were followed.
    pub frames: u64,
    /// How many of them had each state, by its word (`tracked`, `lost`, …).
    pub frames_by_state: BTreeMap<String, u64>,
    /// What the last one was, in a sentence.
    pub says: String,
    /// Frames of the session for which both knew the head's pose; 0 on the simulated headset.
    pub compared: u64,
    /// Root of the mean squared distance, metres.
    pub position_rms_m: f64,
    /// Root of the mean squared angle, degrees.
    pub rotation_rms_deg: f64,
}

impl OdometryReport {
    /// How many frames had each state, in words.
    pub(crate) fn followed(&self) -> String {
        let states = self.frames_by_state.iter().map(|(word, count)| format!("{count} {word}"));
        let states: Vec<String> = states.collect();
        format!("{} frames followed: {}; at the end: {}", self.frames, states.join(", "), self.says)
    }
}

/// What a run was like. Its JSON is an interface.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RunReport {
    /// `openxr` or `simulated`, and its name.
    pub headset: String,
    /// Why that one.
    pub why: String,
    /// The runtime and its version.
    pub runtime: String,
    /// Version of OpenXR that was agreed on.
    pub api: String,
    /// The state at the end: `exiting` where all went well.
    pub state: String,
    /// The states in the order in which they came.
    pub states: Vec<String>,
    /// Frames that were shown.
    pub frames: u64,
    /// Frames that were paced, shown or not.
    pub paced: u64,
    /// Periods of the display without a new picture: it showed the one before once more.
    pub missed: u64,
    /// How often the session was lost and asked for anew.
    pub losses: u32,
    /// Session time from the first frame to the last, seconds.
    pub seconds: f64,
    /// CPU time of our frame thread per frame, command recording included, time inside driver and runtime calls excluded.
    pub frame_cpu_ms: Milliseconds,
    /// Age of the pose, from asking for it to the return of vkQueueSubmit, host clock.
    pub pose_age_ms: Milliseconds,
    /// Time per pass on the Vulkan device (a processor, where [`Self::software`] says so).
    pub gpu_ms: Vec<PassReport>,
    /// The Vulkan device.
    pub device: String,
    /// Whether that is a program on the processor, not a GPU.
    pub software: bool,
    /// Pixels per view.
    pub size: (u32, u32),
    /// Views per frame.
    pub views: u32,
    /// Samples per pixel.
    pub msaa: u32,
    /// Whether depth is submitted.
    pub depth_layer: bool,
    /// Whether what the lenses hide is left out.
    pub visibility_mask: bool,
    /// The display's rate, Hz, where the runtime says it.
    pub refresh_hz: Option<f32>,
    /// The OpenXR extensions that were asked for.
    pub extensions: Vec<String>,
    /// The actions that were created.
    pub actions: Vec<String>,
    /// Devices whose bindings the runtime took.
    pub profiles: Vec<String>,
    /// What each hand held at the end, where the runtime says it.
    pub hands: [Option<String>; 2],
    /// What was pointed at or taken; the first thousand.
    pub touches: Vec<Touch>,
    /// What happened meanwhile, in sentences; the first thousand.
    pub notices: Vec<String>,
    /// What happened beyond those.
    pub notices_left_out: u64,
    /// What was asked for and is not there, one sentence each.
    pub warnings: Vec<String>,
    /// Our own tracking of a recorded rig, where it was asked for: it moves the simulated headset, or is compared with a real one.
    pub odometry: Option<OdometryReport>,
    /// Messages of Vulkan validation; `None` where it was off or is not installed.
    pub validation_messages: Option<u64>,
    /// The recording; `None` where none was asked for.
    pub recording: Option<RecordReport>,
    /// Pictures that were written.
    pub pictures: Vec<String>,
}

impl std::fmt::Display for RunReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "headset        {}", self.headset)?;
        writeln!(f, "device         {}", self.device)?;
        writeln!(
            f,
            "pictures       {} x {} x {}, MSAA {}{}{}",
            self.views,
            self.size.0,
            self.size.1,
            self.msaa,
            if self.depth_layer { ", depth submitted" } else { "" },
            if self.visibility_mask { ", hidden pixels left out" } else { "" }
        )?;
        writeln!(f, "frames         {} in {:.2} s, ended {}", self.frames, self.seconds, self.state)?;
        if self.missed > 0 {
            writeln!(
                f,
                "missed         {} more periods of the display had no new picture: it showed the one before again",
                self.missed
            )?;
        }
        let Milliseconds { p50, p95, p99, .. } = self.frame_cpu_ms;
        writeln!(
            f,
            "frame CPU      p50 {p50:.3}, p95 {p95:.3}, p99 {p99:.3} ms (ours, without driver and runtime)"
        )?;
        let Milliseconds { p50, p99, .. } = self.pose_age_ms;
        writeln!(f, "pose age       p50 {p50:.3}, p99 {p99:.3} ms when handed to the device")?;
        let kind = if self.software { "software" } else { "GPU" };
        for pass in &self.gpu_ms {
            writeln!(f, "{:<14} {:.3} ms ({kind}, last frame)", pass.name, pass.ms)?;
        }
        if let Some(recording) = &self.recording {
            let RecordReport { path, messages, dropped, frame_us, error } = recording;
            match error {
                Some(error) => writeln!(f, "recording      {error}")?,
                None => writeln!(
                    f,
                    "recording      {path}: {messages} messages, {dropped} dropped, p95 {:.1} us per frame",
                    frame_us.p95
                )?,
            }
        }
        if let Some(odometry) = &self.odometry {
            writeln!(f, "odometry       {}", odometry.followed())?;
        }
        if let Some(beside) = self.odometry.as_ref().filter(|odometry| odometry.compared > 0) {
            writeln!(
                f,
                "               {} frames beside the runtime's poses: {:.4} m, {:.3} deg apart (root mean square)",
                beside.compared, beside.position_rms_m, beside.rotation_rms_deg
            )?;
        }
        if let Some(count) = self.validation_messages {
            writeln!(f, "validation     {count} messages")?;
        }
        for touch in self.touches.iter().take(10) {
            writeln!(f, "frame {:<8} {} hand {} {}", touch.frame, touch.hand, touch.what, touch.name)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_log::{Error, Status};

    #[test]
    fn a_recording_that_failed_says_so_and_how_much_it_took() {
        let ended = |status, error: Option<&Error>| {
            let mut report = RecordReport { path: "a.mcap".into(), ..RecordReport::default() };
            report.end(status, error);
            report
        };
        let well = ended(Status { taken: 9, ..Status::default() }, None);
        assert_eq!((well.messages, well.shortfall()), (9, None));
        let full = ended(Status { taken: 9, dropped: 2, failed: false }, None);
        assert_eq!((full.dropped, full.error.as_ref()), (2, None));
        assert!(full.shortfall().is_some_and(|sentence| sentence.starts_with("2 messages")));
        // A failure that is first seen at the end leaves what was taken.
        let status = Status { taken: 9, dropped: 4, failed: true };
        let failed = ended(status, Some(&Error::Request("the disk is full".into())));
        assert_eq!((failed.messages, failed.dropped), (9, 4));
        assert_eq!(failed.shortfall().as_deref(), Some("the disk is full"));
        // One that nobody explains is one all the same.
        assert!(ended(status, None).shortfall().is_some_and(|sentence| sentence.contains("a.mcap")));
        // What was said while the session ran stays.
        let mut said = RecordReport { error: Some("said".into()), ..RecordReport::default() };
        said.end(status, None);
        assert_eq!((said.messages, said.shortfall().as_deref()), (9, Some("said")));
    }
}
