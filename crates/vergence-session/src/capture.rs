//! Pictures of a run as files: stereo PNGs, the poses they were seen from, and the report.

use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use vergence_geom::components;
use vergence_time::Timestamp;
use vergence_xr_sim::ComposedFrame;

use crate::config::CaptureConfig;
use crate::error::Error;
use crate::pose_log::{PoseLog, four};
use crate::report::RunReport;

/// Runs of up to so many frames are captured in full where nothing else is said.
const FULL_RUN: u64 = 300;
/// Pictures that wait to be written; the frame loop waits beyond that.
const QUEUE: usize = 4;

/// One picture: both eyes.
pub(crate) struct Picture {
    pub(crate) frame: u64,
    pub(crate) display: Timestamp,
    pub(crate) size: (u32, u32),
    /// Head pose in LOCAL, where it is known.
    pub(crate) head: Option<[f64; 7]>,
    /// For each eye: pose in LOCAL, angles, and 8-bit sRGB RGBA, rows from the top.
    pub(crate) eyes: Vec<([f64; 7], [f64; 4], Vec<u8>)>,
}

/// Where pictures come in; shared with the simulated headset, which may outlive the run.
struct Inlet {
    every: u64,
    /// Frames of the run before the session began: after a loss, the simulated headset counts from 0 again.
    before: u64,
    /// The newest picture that was not written, in case it is the last one.
    newest: Option<Picture>,
    /// `None` once the run is over: the writer then ends.
    send: Option<SyncSender<Picture>>,
}

/// Writes pictures on a thread of its own.
pub(crate) struct Capture {
    dir: PathBuf,
    every: u64,
    inlet: Arc<Mutex<Inlet>>,
    /// What is to be written, until the run begins.
    outlet: Option<Receiver<Picture>>,
    writer: Option<JoinHandle<Result<Vec<String>, Error>>>,
}

impl Capture {
    /// Beside the pictures.
    pub(crate) const FILES: [&str; 2] = ["poses.jsonl", "summary.json"];

    /// Makes the folder, and changes nothing in one that is there; `frames` is how long the run will be, where that is known.
    pub(crate) fn prepare(config: &CaptureConfig, frames: Option<u64>) -> Result<Self, Error> {
        let dir = config.dir.clone();
        if dir.exists() && !dir.is_dir() {
            let place = dir.display();
            return Err(Error::Call(format!("--capture {place}: expected a folder, found something else")));
        }
        let every = match config.every {
            Some(0) => return Err(Error::Call("--capture-every: expected 1 or more, found 0".into())),
            Some(every) => every,
            None if frames.is_some_and(|frames| frames <= FULL_RUN) => 1,
            // The first; the last comes from `newest`.
            None => u64::MAX,
        };
        std::fs::create_dir_all(&dir).map_err(Error::write(&dir))?;
        earlier_run(&dir)?;
        let (send, receive) = sync_channel(QUEUE);
        let inlet = Inlet { every, before: 0, newest: None, send: Some(send) };
        Ok(Self { dir, every, inlet: Arc::new(Mutex::new(inlet)), outlet: Some(receive), writer: None })
    }

    /// Replaces what an earlier run has written, and begins to write; once.
    pub(crate) fn begin(&mut self) -> Result<(), Error> {
        let Some(pictures) = self.outlet.take() else { return Ok(()) };
        for path in earlier_run(&self.dir)? {
            std::fs::remove_file(&path).map_err(Error::write(&path))?;
        }
        let poses = PoseLog::create(&self.dir.join(Self::FILES[0]))?;
        let folder = self.dir.clone();
        let writer = std::thread::Builder::new()
            .name("capture".into())
            .spawn(move || write_all(&folder, poses, &pictures))
            .map_err(Error::write(&self.dir))?;
        self.writer = Some(writer);
        Ok(())
    }

    /// Whether the frame's picture is one that is written for certain.
    pub(crate) fn wants(&self, frame: u64) -> bool {
        frame.is_multiple_of(self.every)
    }

    /// A session begins when so many frames of the run have been shown.
    pub(crate) fn continue_at(&self, frame: u64) {
        self.inlet.lock().unwrap_or_else(PoisonError::into_inner).before = frame;
    }

    /// Takes a picture.
    pub(crate) fn take(&self, picture: Picture) {
        self.inlet.lock().unwrap_or_else(PoisonError::into_inner).take(picture);
    }

    /// What the simulated headset gives its composed pictures to.
    pub(crate) fn of_composed_pictures(&self) -> vergence_xr_sim::Capture {
        let inlet = Arc::clone(&self.inlet);
        let before = inlet.lock().unwrap_or_else(PoisonError::into_inner).before;
        vergence_xr_sim::Capture::new(move |composed| {
            inlet.lock().unwrap_or_else(PoisonError::into_inner).take(picture_of(composed, before));
        })
    }

    /// Waits until everything is written and gives the names of the pictures.
    pub(crate) fn finish(&mut self) -> Result<Vec<String>, Error> {
        self.inlet.lock().unwrap_or_else(PoisonError::into_inner).close();
        match self.writer.take().map(JoinHandle::join) {
            Some(Ok(written)) => written,
            // The writer has no code that panics; if it does, there are no pictures.
            Some(Err(_)) => Err(Error::Call("the thread that writes pictures ended early".into())),
            None => Ok(Vec::new()),
        }
    }

    /// Writes the report beside the pictures; what an earlier run has written stays where this one has not begun.
    pub(crate) fn write_summary(&self, report: &RunReport) -> Result<(), Error> {
        if self.outlet.is_some() {
            return Ok(());
        }
        let path = self.dir.join(Self::FILES[1]);
        let text = serde_json::to_string_pretty(report)
            .map_err(|error| Error::Write { path: path.clone(), source: std::io::Error::other(error) })?;
        std::fs::write(&path, text + "\n").map_err(Error::write(&path))
    }
}

impl Inlet {
    fn take(&mut self, picture: Picture) {
        if picture.frame.is_multiple_of(self.every) {
            self.newest = None;
            if let Some(send) = &self.send {
                // The writer is gone only where it failed, which `finish` says.
                let _ = send.send(picture);
            }
        } else {
            self.newest = Some(picture);
        }
    }

    fn close(&mut self) {
        if let (Some(last), Some(send)) = (self.newest.take(), self.send.take()) {
            // As above.
            let _ = send.send(last);
        }
        self.send = None;
    }
}

/// The files of an earlier run, which go, so that no picture is mistaken for one of this run.
fn earlier_run(dir: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut pictures = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(Error::write(dir))? {
        let name = entry.map_err(Error::write(dir))?.file_name();
        let is_picture = name
            .to_str()
            .and_then(|name| name.strip_prefix("frame-")?.strip_suffix(".png"))
            .is_some_and(|number| number.len() >= 6 && number.bytes().all(|b| b.is_ascii_digit()));
        if is_picture {
            pictures.push(dir.join(name));
        }
    }
    let ours = Capture::FILES.map(|name| dir.join(name));
    // Every run writes its poses first: pictures without them are somebody else's.
    if !pictures.is_empty() && !ours[0].is_file() {
        return Err(Error::Call(format!(
            "--capture: expected a folder of its own, found {} pictures in {} that no run has written there",
            pictures.len(),
            dir.display()
        )));
    }
    Ok(pictures.into_iter().chain(ours).filter(|path| path.is_file()).collect())
}

fn picture_of(composed: ComposedFrame, before: u64) -> Picture {
    Picture {
        frame: before + composed.number,
        display: composed.display_time,
        size: composed.size,
        head: Some(components(&composed.local_from_head)),
        eyes: composed
            .eyes
            .into_iter()
            .map(|eye| (components(&eye.view_in_local.world_from_eye), four(&eye.view_in_local), eye.rgba))
            .collect(),
    }
}

fn write_all(dir: &Path, mut poses: PoseLog, pictures: &Receiver<Picture>) -> Result<Vec<String>, Error> {
    let mut names = Vec::new();
    for picture in pictures {
        let name = format!("frame-{:06}.png", picture.frame);
        let path = dir.join(&name);
        write_stereo(&path, &picture).map_err(Error::write(&path))?;
        let eyes = picture.eyes.iter().map(|(pose, fov, _)| (*pose, *fov));
        poses.write(picture.frame, picture.display, picture.head, eyes)?;
        names.push(name);
    }
    poses.finish()?;
    Ok(names)
}

/// The eyes side by side, left eye left.
fn write_stereo(path: &Path, picture: &Picture) -> std::io::Result<()> {
    let (width, height) = picture.size;
    let row_bytes = 4 * width as usize;
    let mut rgba = Vec::with_capacity(row_bytes * height as usize * picture.eyes.len());
    for row in 0..height as usize {
        for (_, _, eye) in &picture.eyes {
            let rows = eye.get(row * row_bytes..(row + 1) * row_bytes);
            rgba.extend_from_slice(
                rows.ok_or_else(|| std::io::Error::other("a picture is smaller than its size says"))?,
            );
        }
    }
    let eyes = u32::try_from(picture.eyes.len()).unwrap_or(1);
    let mut encoder = png::Encoder::new(BufWriter::new(std::fs::File::create(path)?), eyes * width, height);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(std::io::Error::other)?;
    writer.write_image_data(&rgba).map_err(std::io::Error::other)?;
    writer.finish().map_err(std::io::Error::other)
}
