//! Recordings on disk: EuRoC's ASL folders and 7-Scenes folders.
//!
//! Opening looks at everything but the pixels: calibration, tables, times, and that each picture is there and not empty. A
//! broken recording gives one sentence with its file and place. Frames and worlds stay the recording's own: the body is the inertial
//! unit where there is one, else the first camera; worlds have z up.

mod calibration;
mod euroc;
mod kalibr;
mod pairing;
mod seven_scenes;
mod stream;
mod writer;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use vergence_geom::Camera;
use vergence_sense::{Image, Imu};
use vergence_time::{Span, Timestamp};

use crate::Error;
use crate::trajectory::Trajectory;

pub use kalibr::Calibration;
pub use pairing::{MOST_APART, holes, say_holes};
pub use stream::DatasetSource;
pub use writer::Writer;

/// How a folder is opened.
#[derive(Clone, Copy, Debug)]
pub struct Opening<'a> {
    /// Another calibration than the folder's own, which need not be there (EuRoC's).
    pub calibration: Option<&'a Calibration>,
    /// Pictures of different cameras that are not farther apart than this are of one instant, the first camera's; 1 ms: clocks of hardware that
    /// is triggered differ by microseconds. What lies between two exposures is an error: a rig that moves at 1 m/s is a millimetre on
    /// after each millisecond.
    pub pair_within: Span,
}

impl Default for Opening<'_> {
    fn default() -> Self {
        Self { calibration: None, pair_within: Span::from_millis(1) }
    }
}

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
    /// Pictures of each camera, also of those instants of which another camera has none: these are in no frame.
    pub pictures: Vec<usize>,
    /// As it was opened.
    pub pair_within: Span,
    /// How far the nearest picture of another camera is from those of the first that have no partner, in the middle (positive: later); `None` where all have one.
    pub apart: Option<Span>,
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

impl Rig {
    /// The rig of calibrations as EuRoC writes them, by the name that they have in a folder: `cam0/sensor.yaml` and so on, and
    /// `imu0/sensor.yaml` where there is an inertial unit. Errors begin with `place`.
    ///
    /// # Errors
    /// No camera, or a calibration that cannot be.
    pub fn from_sheets(place: &Path, sheets: &BTreeMap<String, String>) -> Result<Self, Error> {
        let (rig, _) = euroc::rig_of(place, &|name| Ok(sheets.get(name).cloned()))?;
        if rig.cameras.is_empty() {
            return Err(Error::file(place, "a calibration cam0/sensor.yaml", "none"));
        }
        Ok(rig)
    }
}

impl Picture {
    /// What a camera gave, in grey: `mono8`, `rgb8`, `bgr8`, `rgba8`, or compressed (`png`, `jpeg`). Errors begin with `from`.
    ///
    /// # Errors
    /// Another encoding; fewer bytes than the size says; what cannot be decoded.
    pub fn of(image: &Image<'_>, from: &Path) -> Result<Self, Error> {
        let channels: &[u32] = match &*image.encoding {
            "mono8" => &[1],
            // Rec. 601 in 256ths, as luma of pictures that are decoded nearly is.
            "rgb8" => &[77, 150, 29],
            "bgr8" => &[29, 150, 77],
            "rgba8" => &[77, 150, 29, 0],
            "png" | "jpeg" | "jpg" => {
                let gray = decode_bytes(from, &image.data)?.into_luma8();
                let (width, height) = (gray.width() as usize, gray.height() as usize);
                return Ok(Self { width, height, pixels: gray.into_raw() });
            }
            other => {
                let expected = "a picture in mono8, rgb8, bgr8, rgba8, png or jpeg";
                return Err(Error::file(from, expected, other.chars().take(60).collect::<String>()));
            }
        };
        let (width, height, step) = (image.width as usize, image.height as usize, image.step as usize);
        let row = width.saturating_mul(channels.len());
        let needed = step.checked_mul(height.saturating_sub(1)).and_then(|all| all.checked_add(row));
        if width == 0 || height == 0 || step < row || needed.is_none_or(|needed| image.data.len() < needed) {
            let found = format!("{} bytes for {width}x{height} in steps of {step}", image.data.len());
            return Err(Error::file(from, "rows of pixels", found));
        }
        let mut pixels = Vec::with_capacity(width * height);
        for line in image.data.chunks(step).take(height) {
            if channels.len() == 1 {
                pixels.extend_from_slice(&line[..row]);
            } else {
                pixels.extend(line[..row].chunks_exact(channels.len()).map(|pixel| {
                    let sum: u32 = pixel.iter().zip(channels).map(|(value, by)| u32::from(*value) * by).sum();
                    (sum >> 8) as u8
                }));
            }
        }
        Ok(Self { width, height, pixels })
    }
}

impl Dataset {
    /// Cameras and inertial unit.
    pub fn rig(&self) -> Rig {
        let inertial = self.inertial.as_ref().map(|recording| (recording.unit, recording.rate_hz));
        Rig { cameras: self.cameras.clone(), inertial }
    }

    /// Opens a folder: EuRoC's (it has `mav0`, or is it), or 7-Scenes' (it has `frame-000000.color.jpg` or `.png`).
    ///
    /// # Errors
    /// The first fault that is found: no such folder, a missing or empty file, a table whose times do not grow, a calibration that
    /// cannot be.
    pub fn open(folder: &Path) -> Result<Self, Error> {
        Self::open_as(folder, &Opening::default())
    }

    /// As [`Self::open`], otherwise than usual.
    ///
    /// # Errors
    /// As [`Self::open`]; a calibration for a 7-Scenes folder; pictures that may be further apart than [`MOST_APART`].
    pub fn open_as(folder: &Path, opening: &Opening<'_>) -> Result<Self, Error> {
        let within = opening.pair_within;
        if !(Span::ZERO..=MOST_APART).contains(&within) {
            let found = within.as_millis_f64();
            return Err(Error::Knob { name: "pair_within_ms", expected: "0 to 100", found });
        }
        if folder.is_file() {
            let hint = match folder.extension().and_then(|end| end.to_str()) {
                Some("bag") => "; Kalibr's kalibr_bagextractor makes one of a bag",
                Some("mcap") => "; log export euroc makes one of a log",
                _ => "",
            };
            let expected =
                format!("a folder with mav0/cam0 (EuRoC) or frame-000000.color.jpg (7-Scenes){hint}");
            return Err(Error::file(folder, expected, "a file"));
        }
        std::fs::read_dir(folder).map_err(Error::read(folder))?;
        if let Some(rig) =
            [folder.join("mav0"), folder.to_owned()].into_iter().find(|f| f.join("cam0").is_dir())
        {
            return euroc::open(folder, &rig, opening);
        }
        if opening.calibration.is_some() {
            return Err(Error::file(folder, "a folder with mav0/cam0 (EuRoC) for a calibration", "none"));
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

/// The file in which a EuRoC (ASL) folder, or one with a truth beside it, has its truth: `state_groundtruth_estimate0/data.csv` (in `mav0`, or here),
/// `truth.tum`, or the first `gt*.txt`.
pub fn truth_file(folder: &Path) -> Option<PathBuf> {
    euroc::truth_file(folder)
}

fn decode(path: &Path) -> Result<image::DynamicImage, Error> {
    decode_bytes(path, &std::fs::read(path).map_err(Error::read(path))?)
}

fn decode_bytes(path: &Path, bytes: &[u8]) -> Result<image::DynamicImage, Error> {
    let wrong = |error: image::ImageError| Error::file(path, "a PNG or JPEG picture", error.to_string());
    let mut reader = image::ImageReader::new(std::io::Cursor::new(bytes))
        .with_guessed_format()
        .map_err(Error::read(path))?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(16_384);
    limits.max_image_height = Some(16_384);
    limits.max_alloc = Some(512 << 20);
    let whole = reader.format() != Some(image::ImageFormat::Jpeg) || ends_as_jpeg(bytes);
    reader.limits(limits);
    let decoded = reader.decode().map_err(wrong)?;
    // The decoder fills with grey what is missing of a JPEG.
    if whole { Ok(decoded) } else { Err(Error::file(path, "a whole JPEG picture", "one that is cut off")) }
}

/// Whether a JPEG has its end-of-image marker (ITU-T T.81, B.1.1.3); some writers pad after it.
fn ends_as_jpeg(bytes: &[u8]) -> bool {
    let padding = bytes.iter().rev().take_while(|byte| **byte == 0).count();
    bytes[..bytes.len() - padding].ends_with(&[0xff, 0xd9])
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
