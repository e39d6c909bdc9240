//! Recordings on disk: EuRoC's ASL folders and 7-Scenes folders.
//!
//! Opening looks at everything but the pixels: calibration, tables, times, and that each picture is there and not empty. A
//! broken recording gives one sentence with its file and place. Frames and worlds stay the recording's own: the body is the inertial
//! unit where there is one, else the first camera; worlds have z up.

mod calibration;
mod euroc;
mod seven_scenes;
mod writer;

use std::path::{Path, PathBuf};

use vergence_geom::Camera;
use vergence_sense::Imu;
use vergence_time::{Span, Timestamp};

use crate::Error;
use crate::trajectory::Trajectory;

pub use writer::Writer;

/// A recording: what its sensors are, and where each frame's pictures lie.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// The folder.
    pub root: PathBuf,
    /// The cameras, the one that is followed first. The body is the inertial unit, or else the first camera.
    pub cameras: Vec<Camera>,
    /// The inertial unit, where there is one.
    pub inertial: Option<InertialRecording>,
    /// The frames, in order of time; each has one picture for each camera.
    pub frames: Vec<FrameFiles>,
    /// Where the body truly was.
    pub truth: Option<Trajectory>,
    /// Pictures of one camera that no other camera has a partner for; they are left out.
    pub unpaired: usize,
}

/// The recording of an inertial unit.
#[derive(Clone, Debug)]
pub struct InertialRecording {
    /// Its readings, in order of time.
    pub samples: Vec<(Timestamp, Imu)>,
    /// What it is, as its calibration says.
    pub unit: crate::Inertial,
    /// Rate, hertz.
    pub rate_hz: f64,
}

/// Where the pictures of one instant are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameFiles {
    /// When they were taken.
    pub at: Timestamp,
    /// One for each camera.
    pub pictures: Vec<PathBuf>,
    /// Depth seen by the first camera.
    pub depth: Option<PathBuf>,
}

/// A grey picture.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row from the top.
    pub pixels: Vec<u8>,
}

/// A depth picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Depth {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Distance along the camera's forward axis, metres; 0 where nothing was measured.
    pub metres: Vec<f32>,
}

impl Dataset {
    /// Opens a folder: EuRoC's (it has `mav0`, or is it), or 7-Scenes' (it has `frame-000000.color.jpg` or `.png`).
    ///
    /// # Errors
    /// The first fault that is found: no such folder, a missing or empty file, a table whose times do not grow, a calibration that
    /// cannot be.
    pub fn open(folder: &Path) -> Result<Self, Error> {
        std::fs::read_dir(folder).map_err(Error::read(folder))?;
        if let Some(rig) =
            [folder.join("mav0"), folder.to_owned()].into_iter().find(|f| f.join("cam0").is_dir())
        {
            return euroc::open(folder, &rig);
        }
        if folder.join("frame-000000.pose.txt").is_file() || folder.join("camera-intrinsics.txt").is_file() {
            return seven_scenes::open(folder);
        }
        Err(Error::file(
            folder,
            "a folder with mav0/cam0 (EuRoC) or frame-000000.color.jpg (7-Scenes)",
            "neither",
        ))
    }

    /// The pictures of frame `index`, grey, one for each camera.
    ///
    /// # Errors
    /// A picture that cannot be decoded, or is not of its camera's size.
    ///
    /// # Panics
    /// Where there is no such frame.
    pub fn pictures(&self, index: usize) -> Result<Vec<Picture>, Error> {
        let files = self.frames[index].pictures.iter().zip(&self.cameras);
        files.map(|(path, camera)| read_gray(path, camera.size_px)).collect()
    }

    /// The picture of one camera of frame `index`, grey.
    ///
    /// # Errors
    /// As [`Self::pictures`].
    ///
    /// # Panics
    /// Where there is no such frame or camera.
    pub fn picture(&self, index: usize, camera: usize) -> Result<Picture, Error> {
        read_gray(&self.frames[index].pictures[camera], self.cameras[camera].size_px)
    }

    /// The depth picture of frame `index`, where there is one.
    ///
    /// # Errors
    /// A picture that cannot be decoded, is not of 16 bits, or is not of the first camera's size.
    ///
    /// # Panics
    /// Where there is no such frame.
    pub fn depth(&self, index: usize) -> Result<Option<Depth>, Error> {
        let Some(path) = &self.frames[index].depth else { return Ok(None) };
        let decoded = decode(path)?;
        let image::DynamicImage::ImageLuma16(depth) = decoded else {
            return Err(Error::file(path, "a grey picture of 16 bits", format!("{:?}", decoded.color())));
        };
        check_size(path, [depth.width(), depth.height()], self.cameras[0].size_px)?;
        // Millimetres; both ends of the range say that there was nothing.
        let metres = |value: &u16| if *value == u16::MAX { 0.0 } else { f32::from(*value) * 1e-3 };
        Ok(Some(Depth {
            width: depth.width() as usize,
            height: depth.height() as usize,
            metres: depth.as_raw().iter().map(metres).collect(),
        }))
    }

    /// The median time between frames; `None` where there are fewer than two.
    pub fn period(&self) -> Option<Span> {
        let mut steps: Vec<i64> = self
            .frames
            .windows(2)
            .map(|pair| pair[1].at.as_nanos().saturating_sub(pair[0].at.as_nanos()))
            .collect();
        let middle = steps.len() / 2;
        (!steps.is_empty()).then(|| Span::from_nanos(*steps.select_nth_unstable(middle).1))
    }
}

/// Cameras and an inertial unit without a recording.
#[derive(Clone, Debug)]
pub struct Rig {
    /// The cameras. The body is the inertial unit, where there is one.
    pub cameras: Vec<Camera>,
    /// What the inertial unit is, and its rate, hertz.
    pub inertial: Option<(crate::Inertial, f64)>,
}

/// Reads the calibrations of a EuRoC (ASL) folder (it has `mav0`, or is it): `cam*/sensor.yaml` and `imu0/sensor.yaml`.
///
/// # Errors
/// No `cam0/sensor.yaml`, or a calibration that cannot be.
pub fn rig(folder: &Path) -> Result<Rig, Error> {
    let inner = folder.join("mav0");
    euroc::rig(if inner.is_dir() { &inner } else { folder })
}

fn decode(path: &Path) -> Result<image::DynamicImage, Error> {
    let wrong = |error: image::ImageError| Error::file(path, "a PNG or JPEG picture", error.to_string());
    let bytes = std::fs::read(path).map_err(Error::read(path))?;
    let mut reader = image::ImageReader::new(std::io::Cursor::new(bytes.as_slice()))
        .with_guessed_format()
        .map_err(Error::read(path))?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(16_384);
    limits.max_image_height = Some(16_384);
    limits.max_alloc = Some(512 << 20);
    reader.limits(limits);
    reader.decode().map_err(wrong)
}

fn check_size(path: &Path, found: [u32; 2], expected: [u32; 2]) -> Result<(), Error> {
    if found == expected {
        return Ok(());
    }
    let pixels = |[width, height]: [u32; 2]| format!("{width}x{height} pixels");
    Err(Error::file(path, format!("{}, as the calibration says", pixels(expected)), pixels(found)))
}

fn read_gray(path: &Path, size_px: [u32; 2]) -> Result<Picture, Error> {
    let gray = decode(path)?.into_luma8();
    check_size(path, [gray.width(), gray.height()], size_px)?;
    let (width, height) = (gray.width() as usize, gray.height() as usize);
    Ok(Picture { width, height, pixels: gray.into_raw() })
}

/// That a file is there and has something in it.
fn check_there(path: &Path) -> Result<(), Error> {
    let found = std::fs::metadata(path).map_err(Error::read(path))?;
    if found.is_file() && found.len() > 0 {
        return Ok(());
    }
    Err(Error::file(path, "a picture", if found.is_file() { "0 bytes" } else { "no file" }))
}
