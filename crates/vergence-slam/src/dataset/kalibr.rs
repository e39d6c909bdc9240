//! Calibrations as Kalibr writes them: `camchain-imucam.yaml` and `imu.yaml`.
//!
//! Formats: Kalibr's wiki, "YAML formats" (P. Furgale, J. Rehder, R. Siegwart, "Unified Temporal and Spatial Calibration for Multi-Sensor
//! Systems", IROS 2013).

use std::path::{Path, PathBuf};

use vergence_geom::{Camera, Rigid};
use vergence_time::Span;

use super::Rig;
use super::calibration::Sheet;
use super::euroc::unit;
use crate::{Error, Inertial};

/// Cameras and inertial unit of a rig, from other files than those in a recording's folder.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The cameras, on the inertial unit's frame; without `T_cam_imu` on the first camera's.
    pub rig: Rig,
    /// What is added to the times of pictures to be times of the inertial unit (`timeshift_cam_imu` of the first camera).
    pub unit_from_camera: Span,
}

/// A shift that is longer than this is none of one rig's, s.
const LONGEST_SHIFT_S: f64 = 10.0;

impl Calibration {
    /// Reads a chain of cameras (`cam0`, `cam1`, …) and, from a file of its own, the unit's noise and rate; in any order.
    ///
    /// # Errors
    /// A file that is neither, or a calibration that cannot be.
    pub fn kalibr(files: &[PathBuf]) -> Result<Self, Error> {
        let (mut chain, mut inertial) = (None, None);
        for path in files {
            let sheet = Sheet::read(path)?;
            if sheet.has("cam0") {
                chain = Some(cameras(&sheet, path)?);
            } else {
                // Newer files have all under `imu0`.
                let part = sheet.part("imu0");
                inertial = Some(noise(part.as_ref().unwrap_or(&sheet))?);
            }
        }
        let Some((cameras, unit_from_camera)) = chain else {
            let name = files.first().cloned().unwrap_or_default();
            return Err(Error::file(&name, "a chain of cameras (cam0, cam1, …) of Kalibr", "none"));
        };
        Ok(Self { rig: Rig { cameras, inertial }, unit_from_camera })
    }
}

fn noise(sheet: &Sheet) -> Result<(Inertial, f64), Error> {
    Ok((unit(sheet)?, sheet.positive("update_rate")?))
}

fn cameras(chain: &Sheet, path: &Path) -> Result<(Vec<Camera>, Span), Error> {
    let mut cameras: Vec<Camera> = Vec::new();
    let mut shift_s = 0.0;
    while let Some(sheet) = chain.part(&format!("cam{}", cameras.len())) {
        let (lens, size_px) = sheet.lens()?;
        let body_from_camera = match cameras.last() {
            _ if sheet.has("T_cam_imu") => sheet.rigid("T_cam_imu")?.inverse(),
            Some(before) => before.body_from_camera * sheet.rigid("T_cn_cnm1")?.inverse(),
            None => Rigid::identity(),
        };
        if cameras.is_empty() && sheet.has("timeshift_cam_imu") {
            shift_s = sheet.number("timeshift_cam_imu")?;
        }
        cameras.push(Camera { lens, size_px, body_from_camera });
    }
    if shift_s.abs() > LONGEST_SHIFT_S {
        let expected = format!("cam0.timeshift_cam_imu: at most {LONGEST_SHIFT_S} s");
        return Err(Error::file(path, expected, format!("{shift_s} s")));
    }
    Ok((cameras, Span::from_nanos((shift_s * 1e9).round() as i64)))
}
