//! EuRoC's ASL folders, written: simulated rigs leave what real ones do.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use image::ImageEncoder as _;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use vergence_geom::{Camera, Distortion, Rigid};
use vergence_sense::Imu;
use vergence_time::Timestamp;

use super::Rig;
use crate::Error;
use crate::trajectory::Trajectory;

/// Writes a recording as [`Dataset::open`](super::Dataset::open) reads it: `mav0/cam*`, `mav0/imu0`, `truth.tum`. The body is the
/// inertial unit, or without one the first camera's body.
#[derive(Debug)]
pub struct Writer {
    root: PathBuf,
    sizes_px: Vec<[u32; 2]>,
    tables: Vec<String>,
}

impl Writer {
    /// Makes the folder (and those above it) with the calibrations of `rig`, whose cameras take `frames_hz` frames per second.
    ///
    /// # Errors
    /// What cannot be written.
    pub fn create(root: &Path, rig: &Rig, frames_hz: f64) -> Result<Self, Error> {
        for n in 0..rig.cameras.len() {
            make(&root.join(format!("mav0/cam{n}/data")))?;
        }
        for (name, text) in rig.sheets(frames_hz) {
            let path = root.join("mav0").join(name);
            path.parent().map_or(Ok(()), make)?;
            write(&path, text.as_bytes())?;
        }
        Ok(Self {
            root: root.to_owned(),
            sizes_px: rig.cameras.iter().map(|camera| camera.size_px).collect(),
            tables: vec!["#timestamp [ns],filename\n".to_owned(); rig.cameras.len()],
        })
    }

    /// Writes the picture that `camera` took at `at`: grey, row by row from the top, of the size of its calibration.
    ///
    /// # Errors
    /// Another number of pixels; what cannot be written.
    ///
    /// # Panics
    /// Where there is no such camera.
    pub fn picture(&mut self, camera: usize, at: Timestamp, pixels: &[u8]) -> Result<(), Error> {
        let name = format!("{}.png", at.as_nanos());
        let path = self.root.join(format!("mav0/cam{camera}/data/{name}"));
        let [width, height] = self.sizes_px[camera];
        let expected = width as usize * height as usize;
        if pixels.len() != expected {
            return Err(Error::file(&path, format!("{expected} pixels"), pixels.len().to_string()));
        }
        let mut bytes = Vec::new();
        let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive);
        encoder
            .write_image(pixels, width, height, image::ExtendedColorType::L8)
            .map_err(|error| Error::file(&path, "a picture that can be encoded", error.to_string()))?;
        write(&path, &bytes)?;
        let _ = writeln!(self.tables[camera], "{},{name}", at.as_nanos());
        Ok(())
    }

    /// Writes the tables of pictures, the readings (none: no table), and where the body truly was.
    ///
    /// # Errors
    /// What cannot be written.
    pub fn finish(self, readings: &[(Timestamp, Imu)], truth: &Trajectory) -> Result<(), Error> {
        for (n, table) in self.tables.iter().enumerate() {
            write(&self.root.join(format!("mav0/cam{n}/data.csv")), table.as_bytes())?;
        }
        if !readings.is_empty() {
            let mut table = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],\
                             a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
                .to_owned();
            for (at, imu) in readings {
                let (w, a) = (imu.gyr_rad_s, imu.acc_m_s2);
                let _ = writeln!(table, "{},{},{},{},{},{},{}", at.as_nanos(), w.x, w.y, w.z, a.x, a.y, a.z);
            }
            write(&self.root.join("mav0/imu0/data.csv"), table.as_bytes())?;
        }
        let mut text = Vec::new();
        let path = self.root.join("truth.tum");
        truth.write_tum(&mut text).map_err(Error::read(&path))?;
        write(&path, &text)
    }
}

impl Rig {
    /// The calibrations as EuRoC writes them, by the name that they have in a folder (`cam0/sensor.yaml`, `imu0/sensor.yaml`); cameras take
    /// `frames_hz` frames per second.
    pub fn sheets(&self, frames_hz: f64) -> Vec<(String, String)> {
        let camera = |(n, camera)| (format!("cam{n}/sensor.yaml"), calibration(camera, frames_hz));
        let unit = self.inertial.as_ref().map(|(unit, rate_hz)| {
            let text = format!(
                "sensor_type: imu\n{}rate_hz: {rate_hz}\ngyroscope_noise_density: {:?}\ngyroscope_random_walk: {:?}\n\
                 accelerometer_noise_density: {:?}\naccelerometer_random_walk: {:?}\n",
                extrinsics(&Rigid::identity()),
                unit.noise.gyr_rad_s_rthz,
                unit.gyr_walk,
                unit.noise.acc_m_s2_rthz,
                unit.acc_walk,
            );
            ("imu0/sensor.yaml".to_owned(), text)
        });
        self.cameras.iter().enumerate().map(camera).chain(unit).collect()
    }
}

fn make(path: &Path) -> Result<(), Error> {
    std::fs::create_dir_all(path).map_err(Error::read(path))
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    std::fs::write(path, bytes).map_err(Error::read(path))
}

fn extrinsics(body_from_sensor: &Rigid) -> String {
    let matrix = body_from_sensor.to_homogeneous().transpose();
    let numbers: Vec<String> = matrix.iter().map(|number| format!("{number:?}")).collect();
    format!("T_BS:\n  cols: 4\n  rows: 4\n  data: [{}]\n", numbers.join(", "))
}

fn calibration(camera: &Camera, frames_hz: f64) -> String {
    let (focal, centre) = (camera.lens.focal_px(), camera.lens.centre_px());
    let pinhole = format!("{:?}, {:?}, {:?}, {:?}", focal.x, focal.y, centre.x, centre.y);
    let lens = match camera.lens.distortion() {
        Distortion::Radtan { radial: [a, b, c], tangential: [p, q] } => format!(
            "camera_model: pinhole\nintrinsics: [{pinhole}]\ndistortion_model: radial-tangential\n\
             distortion_coefficients: [{a:?}, {b:?}, {p:?}, {q:?}, {c:?}]\n"
        ),
        Distortion::KannalaBrandt { k: [a, b, c, d] } => format!(
            "camera_model: pinhole\nintrinsics: [{pinhole}]\ndistortion_model: equidistant\n\
             distortion_coefficients: [{a:?}, {b:?}, {c:?}, {d:?}]\n"
        ),
        Distortion::DoubleSphere { xi, alpha } => {
            format!("camera_model: double-sphere\nintrinsics: [{xi:?}, {alpha:?}, {pinhole}]\n")
        }
    };
    let [width, height] = camera.size_px;
    format!(
        "sensor_type: camera\n{}rate_hz: {frames_hz}\nresolution: [{width}, {height}]\n{lens}",
        extrinsics(&camera.body_from_camera)
    )
}
