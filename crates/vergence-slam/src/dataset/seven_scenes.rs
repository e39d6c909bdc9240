//! 7-Scenes folders: `frame-000000.{color,depth}.*`, `.pose.txt`, and `camera-intrinsics.txt` where somebody added it.

use std::path::Path;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use vergence_geom::{Camera, Lens, Rigid};
use vergence_time::Timestamp;

use super::{Dataset, FrameFiles, Opening, check_there};
use crate::Error;
use crate::trajectory::{Trajectory, read_text};

/// The recordings have no times; the camera gave 30 frames a second.
const RATE_HZ: i64 = 30;
/// The Kinect's focal length and centre, as the recordings' page says.
const KINECT: ([f64; 2], [f64; 2]) = ([585.0, 585.0], [320.0, 240.0]);
const SIZE_PX: [u32; 2] = [640, 480];

pub(super) fn open(folder: &Path) -> Result<Dataset, Error> {
    let intrinsics = folder.join("camera-intrinsics.txt");
    let (focal, centre) = if intrinsics.is_file() {
        let k = matrix::<9>(&intrinsics)?;
        if k[1] != 0.0 || k[3] != 0.0 || k[6..] != [0.0, 0.0, 1.0] {
            return Err(Error::file(&intrinsics, "a camera matrix f 0 c, 0 f c, 0 0 1", format!("{k:?}")));
        }
        ([k[0], k[4]], [k[2], k[5]])
    } else {
        KINECT
    };
    let lens = Lens::pinhole(focal, centre).map_err(|source| Error::Lens { path: intrinsics, source })?;
    let cameras = vec![Camera { lens, size_px: SIZE_PX, body_from_camera: Rigid::identity() }];
    let mut frames = Vec::new();
    let mut poses = Vec::new();
    let mut last = None;
    for entry in std::fs::read_dir(folder).map_err(Error::read(folder))? {
        let entry = entry.map_err(Error::read(folder))?;
        let name = entry.file_name();
        let number = name
            .to_str()
            .and_then(|name| name.strip_prefix("frame-")?.split('.').next()?.parse::<i64>().ok());
        last = last.max(number);
    }
    for number in 0..=last.unwrap_or(-1) {
        let file = |end: &str| folder.join(format!("frame-{number:06}.{end}"));
        let color = [file("color.jpg"), file("color.png")].into_iter().find(|path| path.exists());
        let color = color.unwrap_or_else(|| file("color.jpg"));
        check_there(&color)?;
        let depth = Some(file("depth.png")).filter(|path| path.exists());
        depth.iter().try_for_each(|path| check_there(path))?;
        let at = Timestamp::from_nanos(number * 1_000_000_000 / RATE_HZ);
        poses.push((at, pose(&file("pose.txt"))?));
        frames.push(FrameFiles { at, pictures: vec![color], depth });
    }
    if frames.is_empty() {
        return Err(Error::file(folder, "frames (frame-000000.color.jpg …)", "none"));
    }
    let truth = Some(Trajectory { poses });
    let pictures = vec![frames.len()];
    let pair_within = Opening::default().pair_within;
    Ok(Dataset {
        root: folder.to_owned(),
        cameras,
        inertial: None,
        frames,
        truth,
        pictures,
        pair_within,
        apart: None,
    })
}

fn matrix<const N: usize>(path: &Path) -> Result<[f64; N], Error> {
    let text = read_text(path)?;
    let mut all = [0.0; N];
    let mut count = 0;
    for (index, line) in text.lines().enumerate() {
        for (word, found) in line.split_whitespace().enumerate() {
            let place = (index + 1, word + 1);
            let Some(value) = all.get_mut(count) else {
                return Err(Error::content(path, place, format!("{N} numbers"), "more"));
            };
            count += 1;
            let number = found.parse::<f64>().ok().filter(|x| x.is_finite());
            *value = number.ok_or_else(|| {
                Error::content(path, place, "a finite number", found.chars().take(40).collect::<String>())
            })?;
        }
    }
    if count < N {
        return Err(Error::file(path, format!("{N} numbers"), count.to_string()));
    }
    Ok(all)
}

/// A camera-to-world matrix; the rotation nearest to it.
fn pose(path: &Path) -> Result<Rigid, Error> {
    let m = matrix::<16>(path)?;
    let linear = Matrix3::from_fn(|row, column| m[4 * row + column]);
    let off = (linear.transpose() * linear - Matrix3::identity()).norm();
    if off > 0.01 || linear.determinant() < 0.0 {
        return Err(Error::file(
            path,
            "a rotation in the first three columns",
            format!("columns that are off by {off:.3}"),
        ));
    }
    let svd = linear.svd(true, true);
    let rotation = match (svd.u, svd.v_t) {
        (Some(u), Some(vt)) => u * vt,
        _ => linear,
    };
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Ok(Rigid::from_parts(Vector3::new(m[3], m[7], m[11]).into(), rotation))
}
