//! EuRoC's ASL folders: `mav0/cam*/{sensor.yaml,data.csv,data/}`, `imu0`, `state_groundtruth_estimate0`.

use std::path::{Path, PathBuf};

use vergence_geom::Rigid;
use vergence_inertial::Recording;
use vergence_inertial::preintegrate::NoiseDensities;
use vergence_time::Timestamp;

use super::calibration::Sheet;
use super::kalibr::Calibration;
use super::{Dataset, FrameFiles, InertialRecording, Rig, TOGETHER_NS, check_there};
use crate::trajectory::{Trajectory, read_text};
use crate::{Error, Inertial};

pub(super) fn rig(rig: &Path) -> Result<Rig, Error> {
    read_rig(rig).map(|(rig, _)| rig)
}

fn read_rig(rig: &Path) -> Result<(Rig, Rigid), Error> {
    rig_of(rig, &|name| {
        let path = rig.join(name);
        // The first camera's is missed by its name, and so is that of a sensor that is there.
        let there = name == "cam0/sensor.yaml" || path.parent().is_some_and(Path::is_dir);
        there.then(|| read_text(&path)).transpose()
    })
}

/// The rig of the sheets that `sheet` has, by the name that they have in a folder; and where the inertial unit sits on the body that they speak
/// of.
pub(super) fn rig_of(
    place: &Path,
    sheet: &dyn Fn(&str) -> Result<Option<String>, Error>,
) -> Result<(Rig, Rigid), Error> {
    let mut cameras = Vec::new();
    for index in 0..MOST_CAMERAS {
        let name = format!("cam{index}/sensor.yaml");
        let Some(text) = sheet(&name)? else { break };
        cameras.push(Sheet::parse(&place.join(name), &text)?.camera()?);
    }
    let name = "imu0/sensor.yaml";
    let Some(text) = sheet(name)? else { return Ok((Rig { cameras, inertial: None }, Rigid::identity())) };
    let path = place.join(name);
    let sheet = Sheet::parse(&path, &text)?;
    let body_from_imu = sheet.body_from_sensor()?;
    for camera in &mut cameras {
        camera.body_from_camera = body_from_imu.inverse() * camera.body_from_camera;
    }
    Ok((Rig { cameras, inertial: Some((unit(&sheet)?, sheet.positive("rate_hz")?)) }, body_from_imu))
}

/// The noise that a calibration says.
pub(super) fn unit(sheet: &Sheet) -> Result<Inertial, Error> {
    Ok(Inertial {
        noise: NoiseDensities {
            gyr_rad_s_rthz: sheet.positive("gyroscope_noise_density")?,
            acc_m_s2_rthz: sheet.positive("accelerometer_noise_density")?,
        },
        gyr_walk: sheet.positive("gyroscope_random_walk")?,
        acc_walk: sheet.positive("accelerometer_random_walk")?,
        ..Inertial::EUROC
    })
}

/// More cameras than any rig has.
const MOST_CAMERAS: usize = 64;

pub(super) fn open(folder: &Path, rig: &Path, given: Option<&Calibration>) -> Result<Dataset, Error> {
    let (Rig { cameras, inertial }, body_from_imu) = match given {
        Some(given) => (given.rig.clone(), Rigid::identity()),
        None => read_rig(rig)?,
    };
    let mut tables = Vec::new();
    for index in 0..cameras.len() {
        let mut table = pictures(&rig.join(format!("cam{index}")))?;
        if let Some(given) = given {
            table.iter_mut().for_each(|row| row.0 = row.0.saturating_add(given.unit_from_camera));
        }
        tables.push(table);
    }
    let mut truth = read_truth(folder, rig)?;
    for (_, pose) in truth.iter_mut().flat_map(|truth| &mut truth.poses) {
        *pose *= body_from_imu;
    }
    let place = rig.join("imu0");
    let inertial = match inertial.filter(|_| place.is_dir()) {
        Some((unit, rate_hz)) => {
            Some(InertialRecording { unit, rate_hz, samples: Recording::read(&place)?.samples })
        }
        None => None,
    };
    let (frames, unpaired) = pair(&tables);
    if frames.is_empty() {
        let times: Vec<String> = tables.iter().map(|table| format!("{} pictures", table.len())).collect();
        return Err(Error::file(
            rig,
            "cameras with pictures at the same times",
            format!("{} and none in common", times.join(", ")),
        ));
    }
    if let Some(inertial) = &inertial {
        check_readings(&place.join("data.csv"), inertial, &frames)?;
    }
    Ok(Dataset { root: folder.to_owned(), cameras, inertial, frames, truth, unpaired })
}

/// That readings are of the same flight as the frames, and in SI units: what accelerometers feel is gravity above all.
fn check_readings(table: &Path, unit: &InertialRecording, frames: &[FrameFiles]) -> Result<(), Error> {
    /// Middle of what is felt, m/s²: half of gravity for long is a fall, twice of it a centrifuge. Fastest turn in the middle, rad/s.
    const FELT: std::ops::Range<f64> = 5.0..20.0;
    const FASTEST: f64 = 20.0;
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else { return Ok(()) };
    let seconds = |at: Timestamp| at.as_nanos() as f64 * 1e-9;
    let samples = &unit.samples;
    let (Some(begin), Some(end)) = (samples.first(), samples.last()) else { return Ok(()) };
    let within = |at: Timestamp| (begin.0..=end.0).contains(&at);
    let covered = frames.iter().filter(|frame| within(frame.at)).count();
    if covered * 2 < frames.len() {
        return Err(Error::file(
            table,
            format!(
                "readings at the times of the pictures ({:.3} to {:.3} s)",
                seconds(first.at),
                seconds(last.at)
            ),
            format!("readings from {:.3} to {:.3} s", seconds(begin.0), seconds(end.0)),
        ));
    }
    let middle = |size: fn(&vergence_sense::Imu) -> f64| {
        let flown = samples.iter().filter(|sample| (first.at..=last.at).contains(&sample.0));
        let mut sizes: Vec<f64> =
            flown.map(|sample| size(&sample.1)).filter(|size| size.is_finite()).collect();
        let middle = sizes.len() / 2;
        (!sizes.is_empty()).then(|| *sizes.select_nth_unstable_by(middle, f64::total_cmp).1)
    };
    if let Some(felt) = middle(|imu| imu.acc_m_s2.norm()).filter(|felt| !FELT.contains(felt)) {
        let expected = "accelerations in m/s² (gravity is 9.8)";
        return Err(Error::file(table, expected, format!("{felt:.3} in the middle")));
    }
    if let Some(turn) = middle(|imu| imu.gyr_rad_s.norm()).filter(|turn| *turn > FASTEST) {
        return Err(Error::file(table, "turns in rad/s", format!("{turn:.1} in the middle: degrees?")));
    }
    Ok(())
}

/// `data.csv` of a camera: when, and which file.
fn pictures(place: &Path) -> Result<Vec<(Timestamp, PathBuf)>, Error> {
    let path = place.join("data.csv");
    let text = read_text(&path)?;
    let mut all: Vec<(Timestamp, PathBuf)> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let wrong = |column: usize, expected: String, found: &str| {
            let found: String = found.chars().take(60).collect();
            Error::content(&path, (index + 1, column), expected, found)
        };
        let (time, name) = line.split_once(',').unwrap_or((line, ""));
        let (time, name) = (time.trim(), name.trim());
        let nanos: i64 = time.parse().map_err(|_| wrong(1, "whole nanoseconds".to_owned(), time))?;
        let outside =
            Path::new(name).components().any(|part| !matches!(part, std::path::Component::Normal(_)));
        if name.is_empty() || outside {
            return Err(wrong(2, "the name of a picture in data/".to_owned(), name));
        }
        let at = Timestamp::from_nanos(nanos);
        match all.last() {
            Some((last, _)) if at == *last => {
                return Err(wrong(1, "each time once".to_owned(), &format!("{nanos} ns a second time")));
            }
            Some((last, _)) if at < *last => {
                let expected = format!("times that grow (after {} ns)", last.as_nanos());
                return Err(wrong(1, expected, &format!("{nanos} ns")));
            }
            _ => {}
        }
        let picture = place.join("data").join(name);
        check_there(&picture)?;
        all.push((at, picture));
    }
    if all.is_empty() {
        return Err(Error::file(&path, "pictures", "none"));
    }
    Ok(all)
}

/// Frames at the first camera's times for which all cameras have a picture, and how many pictures stay alone.
fn pair(tables: &[Vec<(Timestamp, PathBuf)>]) -> (Vec<FrameFiles>, usize) {
    let Some((first, others)) = tables.split_first() else { return (Vec::new(), 0) };
    let mut frames = Vec::with_capacity(first.len());
    for (at, picture) in first {
        let partner = |table: &Vec<(Timestamp, PathBuf)>| {
            let after = table.partition_point(|row| row.0 < *at);
            let apart = |row: &(Timestamp, PathBuf)| row.0.as_nanos().abs_diff(at.as_nanos());
            let near = table[after.saturating_sub(1)..].iter().take(2).min_by_key(|row| apart(row))?;
            (apart(near) <= TOGETHER_NS).then(|| near.1.clone())
        };
        if let Some(rest) = others.iter().map(partner).collect::<Option<Vec<_>>>() {
            let pictures = std::iter::once(picture.clone()).chain(rest).collect();
            frames.push(FrameFiles { at: *at, pictures, depth: None });
        }
    }
    let unpaired = tables.iter().map(|table| table.len() - frames.len()).sum();
    (frames, unpaired)
}

fn read_truth(folder: &Path, rig: &Path) -> Result<Option<Trajectory>, Error> {
    let table = rig.join("state_groundtruth_estimate0").join("data.csv");
    if table.is_file() {
        return Trajectory::read(&table).map(Some);
    }
    let mut beside: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(Error::read(folder))?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            name.starts_with("gt") && name.ends_with(".txt") || name == "truth.tum"
        })
        .collect();
    beside.sort();
    beside.first().map(|path| Trajectory::read(path)).transpose()
}
