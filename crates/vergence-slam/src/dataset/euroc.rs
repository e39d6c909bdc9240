//! EuRoC's ASL folders: `mav0/cam*/{sensor.yaml,data.csv,data/}`, `imu0`, `state_groundtruth_estimate0`.

use std::path::{Path, PathBuf};

use vergence_geom::Rigid;
use vergence_inertial::Recording;
use vergence_inertial::preintegrate::NoiseDensities;
use vergence_time::Timestamp;

use super::calibration::Sheet;
use super::pairing::{milliseconds, pair};
use super::{Dataset, FrameFiles, InertialRecording, Opening, Rig, check_there};
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

pub(super) fn open(folder: &Path, rig: &Path, opening: &Opening<'_>) -> Result<Dataset, Error> {
    let given = opening.calibration;
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
    let times: Vec<Vec<Timestamp>> =
        tables.iter().map(|table| table.iter().map(|row| row.0).collect()).collect();
    let paired = pair(&times, opening.pair_within);
    if paired.frames.is_empty() {
        let counts: Vec<String> = tables.iter().map(|table| format!("{} pictures", table.len())).collect();
        let apart = paired.apart.map_or_else(String::new, |apart| {
            let (later, by) = (if apart.as_nanos() < 0 { "earlier" } else { "later" }, milliseconds(apart));
            format!("; the nearest of another camera is {by} {later} in the middle, and a longer pair_within_ms takes them together")
        });
        return Err(Error::file(
            rig,
            format!("cameras with pictures at the same times (within {})", milliseconds(opening.pair_within)),
            format!("{} and none in common{apart}", counts.join(", ")),
        ));
    }
    let frame = |numbers: &Vec<usize>| FrameFiles {
        at: times[0][numbers[0]],
        pictures: numbers.iter().zip(&tables).map(|(number, table)| table[*number].1.clone()).collect(),
        depth: None,
    };
    let frames: Vec<FrameFiles> = paired.frames.iter().map(frame).collect();
    if let Some(inertial) = &inertial {
        check_readings(&place.join("data.csv"), inertial, &frames)?;
    }
    Ok(Dataset {
        root: folder.to_owned(),
        cameras,
        inertial,
        frames,
        truth,
        pictures: tables.iter().map(Vec::len).collect(),
        pair_within: opening.pair_within,
        apart: paired.apart,
    })
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

fn read_truth(folder: &Path, rig: &Path) -> Result<Option<Trajectory>, Error> {
    let table = rig.join(TABLE);
    let found = if table.is_file() { Some(table) } else { beside(folder)? };
    found.map(|path| Trajectory::read(&path)).transpose()
}

/// EuRoC's own truth.
const TABLE: &str = "state_groundtruth_estimate0/data.csv";

/// A truth in TUM's format: `truth.tum`, or `gt*.txt`.
fn beside(folder: &Path) -> Result<Option<PathBuf>, Error> {
    let mut found: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(Error::read(folder))?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            name.starts_with("gt") && name.ends_with(".txt") || name == "truth.tum"
        })
        .collect();
    found.sort();
    Ok(found.into_iter().next())
}

pub(super) fn truth_file(folder: &Path) -> Option<PathBuf> {
    let tables = ["mav0", ""].map(|rig| folder.join(rig).join(TABLE));
    let of_euroc = tables.into_iter().find(|table| table.is_file());
    of_euroc.or_else(|| beside(folder).ok().flatten())
}
