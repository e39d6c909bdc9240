//! `vergence log export euroc`: the folder `mav0` as EuRoC's data sets have it, with the calibrations that the log keeps.

use std::collections::{BTreeMap, BTreeSet, btree_map};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use vergence_geom::components;
use vergence_log::{Compressed, Reader};
use vergence_sense::Imu;

use super::export::{ExportArgs, Progress, Written};
use super::failed;
use super::gather::TRUTHS;
use super::table::Draft;
use crate::failure::Failure;

const IMU_HEAD: &str = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]";
const CAMERA_HEAD: &str = "#timestamp [ns],filename";
const TRUTH_HEAD: &str =
    "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []";

/// The folder of a stream: the one it is called after, `cam1` of `/rig/cam1`, where that is one of `kind` and free, else the next.
fn folder_of(stream: &str, kind: &str, taken: &mut BTreeSet<String>) -> String {
    let last = stream.rsplit('/').next().unwrap_or_default();
    let number = last.strip_prefix(kind);
    let is_own = number.is_some_and(|n| (1..=2).contains(&n.len()) && n.bytes().all(|b| b.is_ascii_digit()))
        || kind == TRUTHS[0].trim_end_matches('0') && TRUTHS.contains(&last);
    let own = is_own.then(|| last.to_owned());
    let numbered = (0..).map(|n| format!("{kind}{n}"));
    let folder = own.into_iter().chain(numbered).find(|name| !taken.contains(name)).unwrap_or_default();
    taken.insert(folder.clone());
    folder
}

/// A table `data.csv` in a folder of the rig.
fn table(rig: &Path, folder: &str, head: &str) -> Result<(PathBuf, Draft), Failure> {
    let folder = rig.join(folder);
    std::fs::create_dir_all(&folder).map_err(|e| Failure::unwritable(&folder, &e))?;
    let path = folder.join("data.csv");
    let mut file = Draft::create(&path)?;
    writeln!(file, "{head}").map_err(|e| Failure::unwritable(&path, &e))?;
    Ok((path, file))
}

/// Writes what of the log EuRoC's folders can hold: inertial units, compressed pictures, poses; and the calibration of each, where
/// the log has one.
pub fn write(args: &ExportArgs, reader: &mut Reader, bar: &mut Progress) -> Result<Vec<Written>, Failure> {
    let mut all = Vec::new();
    let rig = args.output.join("mav0");
    let mut taken = BTreeSet::new();
    let mut tables: BTreeMap<u16, (Written, Draft, PathBuf)> = BTreeMap::new();
    while let Some(entry) = bar.next(reader)? {
        if !args.wants(&entry) || !(entry.is::<Imu>() || entry.is::<Compressed<'_>>()) {
            continue;
        }
        let (written, file, data) = match tables.entry(entry.stream.id) {
            btree_map::Entry::Occupied(table) => table.into_mut(),
            btree_map::Entry::Vacant(place) => {
                let (kind, head) = if entry.is::<Imu>() { ("imu", IMU_HEAD) } else { ("cam", CAMERA_HEAD) };
                let folder = folder_of(&entry.stream.name, kind, &mut taken);
                let (path, file) = table(&rig, &folder, head)?;
                let written = Written { stream: entry.stream.name.clone(), path, rows: 0 };
                place.insert((written, file, rig.join(&folder).join("data")))
            }
        };
        let line = if entry.is::<Imu>() {
            let imu = entry.decode::<Imu>().map_err(|error| failed(&error))?;
            let (g, a) = (imu.value.gyr_rad_s, imu.value.acc_m_s2);
            format!("{},{},{},{},{},{},{}", imu.captured.as_nanos(), g.x, g.y, g.z, a.x, a.y, a.z)
        } else {
            let picture = entry.decode::<Compressed<'_>>().map_err(|error| failed(&error))?;
            let ending = match &*picture.value.0.encoding {
                "png" => "png",
                "jpeg" | "jpg" => "jpg",
                _ => continue,
            };
            std::fs::create_dir_all(&*data).map_err(|e| Failure::unwritable(data, &e))?;
            let name = format!("{}.{ending}", picture.captured.as_nanos());
            let place = data.join(&name);
            std::fs::write(&place, &picture.value.0.data).map_err(|e| Failure::unwritable(&place, &e))?;
            format!("{},{name}", picture.captured.as_nanos())
        };
        writeln!(file, "{line}").map_err(|e| Failure::unwritable(&written.path, &e))?;
        written.rows += 1;
    }
    for (_, (written, file, _)) in tables {
        file.keep()?;
        all.push(written);
    }
    let mut again = Reader::open(&args.file).map_err(|error| failed(&error))?;
    for (stream, trajectory) in args.trajectories(&mut again, bar)? {
        let folder = folder_of(&stream, TRUTHS[0].trim_end_matches('0'), &mut taken);
        let (path, mut file) = table(&rig, &folder, TRUTH_HEAD)?;
        for (at, pose) in &trajectory.poses {
            let [x, y, z, qx, qy, qz, qw] = components(pose);
            writeln!(file, "{},{x},{y},{z},{qw},{qx},{qy},{qz}", at.as_nanos())
                .map_err(|e| Failure::unwritable(&path, &e))?;
        }
        file.keep()?;
        all.push(Written { stream, path, rows: trajectory.poses.len() as u64 });
    }
    let sheets = reader.metadata().iter().filter(|(name, _)| name == vergence_session::RIG);
    for (name, sheet) in sheets.flat_map(|(_, sheets)| sheets) {
        // Only beside what was written, whatever the log says.
        let Some(folder) = name.strip_suffix("/sensor.yaml").filter(|folder| taken.contains(*folder)) else {
            continue;
        };
        let path = rig.join(folder).join("sensor.yaml");
        let mut file = Draft::create(&path)?;
        file.write_all(sheet.as_bytes()).map_err(|e| Failure::unwritable(&path, &e))?;
        file.keep()?;
    }
    Ok(all)
}
