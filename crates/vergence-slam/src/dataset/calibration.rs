//! `sensor.yaml`, and the files that Kalibr writes: what a sensor is and where it sits.

use std::path::Path;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use vergence_geom::{Camera, Distortion, Lens, Rigid};
use yaml_rust2::{Yaml, YamlLoader};

use crate::Error;
use crate::trajectory::read_text;

/// A parsed file, or one sensor's part of it.
pub(super) struct Sheet<'a> {
    path: &'a Path,
    /// What stands before each key in errors.
    part: String,
    root: Yaml,
}

/// How far a rotation matrix may be from orthonormal; files have six digits and more.
const ORTHONORMAL: f64 = 1e-3;
/// A sensor that is farther from its body than this is one whose calibration is in another unit, m.
const FARTHEST_M: f64 = 5.0;

impl<'a> Sheet<'a> {
    pub fn read(path: &'a Path) -> Result<Self, Error> {
        Self::parse(path, &read_text(path)?)
    }

    /// `text` of what errors call `path`.
    pub fn parse(path: &'a Path, text: &str) -> Result<Self, Error> {
        /// More is no calibration, and YAML's aliases can make much of little.
        const MOST: usize = 1 << 20;
        if text.len() > MOST || text.contains("*") && text.contains("&") {
            return Err(Error::file(
                path,
                "a calibration of at most 1 MiB without aliases",
                format!("{} bytes", text.len()),
            ));
        }
        // OpenCV's first line, `%YAML:1.0`, is not YAML.
        let body: String = text
            .lines()
            .map(|line| if line.starts_with('%') { "" } else { line })
            .collect::<Vec<_>>()
            .join("\n");
        let mut documents = YamlLoader::load_from_str(&body).map_err(|error| {
            let at = error.marker();
            Error::content(path, (at.line(), at.col() + 1), "YAML", error.info())
        })?;
        if documents.len() != 1 {
            return Err(Error::file(path, "one YAML document", documents.len().to_string()));
        }
        Ok(Self { path, part: String::new(), root: documents.swap_remove(0) })
    }

    /// One sensor's part.
    pub fn part(&self, key: &str) -> Option<Self> {
        let root = self.root[key].clone();
        root.as_hash()?;
        Some(Self { path: self.path, part: format!("{}{key}.", self.part), root })
    }

    /// Whether something stands there.
    pub fn has(&self, key: &str) -> bool {
        !self.root[key].is_badvalue()
    }

    fn wrong(&self, key: &str, expected: &str, found: impl std::fmt::Display) -> Error {
        Error::file(self.path, format!("{}{key}: {expected}", self.part), found.to_string())
    }

    fn text(&self, key: &str) -> Result<&str, Error> {
        self.root[key].as_str().ok_or_else(|| self.wrong(key, "a word", show(&self.root[key])))
    }

    /// A finite number above zero.
    pub fn positive(&self, key: &str) -> Result<f64, Error> {
        let value = &self.root[key];
        let found = number(value).filter(|x| *x > 0.0);
        found.ok_or_else(|| self.wrong(key, "a number above 0", show(value)))
    }

    fn numbers(&self, key: &str, value: &Yaml, counts: &[usize]) -> Result<Vec<f64>, Error> {
        let expected =
            format!("{} numbers", counts.iter().map(usize::to_string).collect::<Vec<_>>().join(" or "));
        let list = value.as_vec().ok_or_else(|| self.wrong(key, &expected, show(value)))?;
        if !counts.contains(&list.len()) {
            return Err(self.wrong(key, &expected, list.len()));
        }
        list.iter()
            .map(|value| number(value).ok_or_else(|| self.wrong(key, "finite numbers", show(value))))
            .collect()
    }

    /// A finite number.
    pub fn number(&self, key: &str) -> Result<f64, Error> {
        number(&self.root[key]).ok_or_else(|| self.wrong(key, "a number", show(&self.root[key])))
    }

    /// `T_BS`: takes the sensor's coordinates to the body's.
    pub fn body_from_sensor(&self) -> Result<Rigid, Error> {
        self.rigid("T_BS")
    }

    /// A rigid transform: 16 numbers row by row, four rows of four, or either of them under `data`.
    pub fn rigid(&self, key: &str) -> Result<Rigid, Error> {
        let value = &self.root[key];
        let value = if value["data"].is_badvalue() { value } else { &value["data"] };
        let data = match value.as_vec().map(Vec::as_slice) {
            Some([a, b, c, d]) => {
                let rows = [a, b, c, d].map(|row| self.numbers(key, row, &[4]));
                rows.into_iter().collect::<Result<Vec<_>, _>>()?.concat()
            }
            _ => self.numbers(key, value, &[16])?,
        };
        let linear = Matrix3::from_fn(|row, column| data[4 * row + column]);
        let off = (linear.transpose() * linear - Matrix3::identity()).norm();
        if off > ORTHONORMAL {
            return Err(self.wrong(
                key,
                "a rotation (orthonormal columns)",
                format!("columns that are off by {off:.3}"),
            ));
        }
        if linear.determinant() < 0.0 {
            return Err(self.wrong(key, "a rotation (determinant 1)", "a mirror (determinant -1)"));
        }
        if data[12..] != [0.0, 0.0, 0.0, 1.0] {
            return Err(self.wrong(key, "the last row 0, 0, 0, 1", format!("{:?}", &data[12..])));
        }
        let translation = Vector3::new(data[3], data[7], data[11]);
        if translation.norm() > FARTHEST_M {
            return Err(self.wrong(
                key,
                &format!("a sensor within {FARTHEST_M} m of its body"),
                format!("{:.1} m: millimetres or centimetres?", translation.norm()),
            ));
        }
        // The nearest rotation: polar decomposition, exact to the last bit, as six digits are not.
        let svd = linear.svd(true, true);
        let rotation = match (svd.u, svd.v_t) {
            (Some(u), Some(vt)) => u * vt,
            _ => linear,
        };
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        Ok(Rigid::from_parts(translation.into(), rotation))
    }

    /// A camera's lens, size and place.
    pub fn camera(&self) -> Result<Camera, Error> {
        let (lens, size_px) = self.lens()?;
        Ok(Camera { lens, size_px, body_from_camera: self.body_from_sensor()? })
    }

    /// A camera's lens and the size of its pictures.
    pub fn lens(&self) -> Result<(Lens, [u32; 2]), Error> {
        let size = self.numbers("resolution", &self.root["resolution"], &[2])?;
        let side = |x: f64| (x.fract() == 0.0 && (16.0..=16_384.0).contains(&x)).then_some(x as u32);
        let (Some(width), Some(height)) = (side(size[0]), side(size[1])) else {
            return Err(self.wrong("resolution", "whole numbers of 16 to 16384", format!("{size:?}")));
        };
        let model = self.text("camera_model")?;
        let intrinsics = &self.root["intrinsics"];
        let (pinhole, distortion) = match model {
            "pinhole" => {
                let pinhole = self.numbers("intrinsics", intrinsics, &[4])?;
                (pinhole, self.distortion()?)
            }
            "ds" | "double-sphere" | "double_sphere" => {
                let all = self.numbers("intrinsics", intrinsics, &[6])?;
                (all[2..].to_vec(), Distortion::DoubleSphere { xi: all[0], alpha: all[1] })
            }
            other => {
                let expected = "pinhole or double-sphere (calibrate anew with pinhole-equi or ds)";
                return Err(self.wrong("camera_model", expected, other));
            }
        };
        let (centre, size) = ([pinhole[2], pinhole[3]], [f64::from(width), f64::from(height)]);
        if (0..2).any(|k| !(0.0..size[k]).contains(&centre[k])) {
            return Err(self.wrong("intrinsics", "a principal point in the picture", format!("{centre:?}")));
        }
        let lens = Lens::new([pinhole[0], pinhole[1]], centre, distortion)
            .map_err(|source| Error::Lens { path: self.path.to_owned(), source })?;
        // A lens whose picture folds before a quarter of the picture's height is none that took these pictures.
        let quarter = nalgebra::Vector2::new(centre[0], centre[1] + 0.25 * size[1]);
        if lens.unproject(&quarter).is_none() {
            return Err(self.wrong(
                "distortion_coefficients",
                "a lens that sees the picture",
                "one whose picture folds over in its middle",
            ));
        }
        Ok((lens, [width, height]))
    }

    fn distortion(&self) -> Result<Distortion, Error> {
        // Kalibr's word.
        let kalibr = "distortion_coeffs";
        let key = if self.has(kalibr) { kalibr } else { "distortion_coefficients" };
        let coefficients = |counts: &[usize]| self.numbers(key, &self.root[key], counts);
        match self.text("distortion_model")? {
            "radial-tangential" | "radtan" | "plumb_bob" => {
                let d = coefficients(&[4, 5])?;
                let third = d.get(4).copied().unwrap_or(0.0);
                Ok(Distortion::Radtan { radial: [d[0], d[1], third], tangential: [d[2], d[3]] })
            }
            "equidistant" | "kannala-brandt" => {
                let d = coefficients(&[4])?;
                Ok(Distortion::KannalaBrandt { k: [d[0], d[1], d[2], d[3]] })
            }
            "none" => Ok(Distortion::Radtan { radial: [0.0; 3], tangential: [0.0; 2] }),
            other => Err(self.wrong("distortion_model", "radial-tangential, equidistant or none", other)),
        }
    }
}

fn number(value: &Yaml) -> Option<f64> {
    let number = match value {
        Yaml::Integer(whole) => *whole as f64,
        Yaml::Real(text) => text.parse().ok()?,
        _ => return None,
    };
    number.is_finite().then_some(number)
}

fn show(value: &Yaml) -> String {
    let text = match value {
        Yaml::BadValue | Yaml::Null => return "nothing".to_owned(),
        Yaml::String(text) | Yaml::Real(text) => text.clone(),
        Yaml::Integer(whole) => whole.to_string(),
        Yaml::Boolean(value) => value.to_string(),
        Yaml::Array(_) => "a list".to_owned(),
        Yaml::Hash(_) => "a table".to_owned(),
        Yaml::Alias(_) => "an alias".to_owned(),
    };
    text.chars().take(60).collect()
}
