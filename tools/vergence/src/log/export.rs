//! `vergence log export`: a session log for other people's programs.

use std::collections::{BTreeMap, HashMap, btree_map};
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::PathBuf;

use clap::ValueEnum;
use vergence_geom::components;
use vergence_log::foreign::{Cell, flat};
use vergence_log::{Compressed, Entry, Reader};
use vergence_sense::{Imu, Pose, RawLocation, Sample};
use vergence_slam::trajectory::Trajectory;
use vergence_time::Timestamp;

use super::failed;
use super::table::{Column, CsvTable, ParquetTable, Table};
use crate::failure::Failure;

#[derive(clap::Args)]
pub struct ExportArgs {
    /// What to write
    #[arg(value_enum)]
    kind: Kind,
    /// A session log (.mcap)
    file: PathBuf,
    /// Folder for the files; made where it is missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Streams by name, with all that lie below [default: all that the kind can hold]
    #[arg(long, value_delimiter = ',', value_name = "STREAM")]
    streams: Vec<String>,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// A table of every stream: times in nanoseconds, a column for each value
    Csv,
    /// The same as columns
    Parquet,
    /// Poses: a file of `seconds x y z qx qy qz qw` for every stream that has them
    Tum,
    /// Inertial units, poses and PNG pictures as EuRoC has them, in the folder mav0
    Euroc,
}

/// A file that was written.
struct Written {
    stream: String,
    path: PathBuf,
    rows: u64,
}

/// The name of a file for a stream: `/hand/left` is `hand-left`.
fn file_name(stream: &str) -> String {
    let word: String =
        stream.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '-' }).collect();
    let word = word.trim_matches(['-', '.']).to_owned();
    if word.is_empty() { "stream".to_owned() } else { word }
}

impl ExportArgs {
    pub fn run(self) -> Result<(), Failure> {
        let mut reader = Reader::open(&self.file).map_err(|error| failed(&error))?;
        std::fs::create_dir_all(&self.output).map_err(|e| Failure::unwritable(&self.output, &e))?;
        let written = match self.kind {
            Kind::Csv | Kind::Parquet => self.tables(&mut reader)?,
            Kind::Tum => self.tum(&mut reader)?,
            Kind::Euroc => self.euroc(&mut reader)?,
        };
        if written.is_empty() {
            return Err(self.nothing());
        }
        crate::record::warn_of_end(&reader);
        if self.json {
            let files: Vec<_> = written
                .iter()
                .map(|w| serde_json::json!({ "stream": w.stream, "file": w.path, "rows": w.rows }))
                .collect();
            println!("{}", serde_json::json!({ "files": files }));
        } else {
            for w in &written {
                println!("{}: {} rows of {}", w.path.display(), w.rows, w.stream);
            }
        }
        Ok(())
    }

    /// Why nothing was written: what was looked for, and what the log has.
    fn nothing(&self) -> Failure {
        let holds = match self.kind {
            Kind::Csv | Kind::Parquet => "samples of a known type",
            Kind::Tum => "tracked poses",
            Kind::Euroc => "inertial samples, pictures or tracked poses",
        };
        let wanted = if self.streams.is_empty() { "a stream".to_owned() } else { self.streams.join(" or ") };
        let mut found: Vec<String> = Vec::new();
        if let Ok(mut reader) = Reader::open(&self.file) {
            while reader.next().is_ok_and(|entry| entry.is_some()) {}
            found = reader.streams().map(|s| format!("{} ({})", s.name, s.type_name())).collect();
            found.sort();
        }
        let found = if found.is_empty() { "none".to_owned() } else { found.join(", ") };
        let file = self.file.display();
        Failure::Work(format!("{file}: expected {wanted} with {holds}, found {found}"))
    }

    fn wants(&self, entry: &Entry<'_>) -> bool {
        let name = &entry.stream.name;
        let below = |own: &String| {
            let own = own.trim_start_matches('/');
            let name = name.trim_start_matches('/');
            own.is_empty()
                || name == own
                || name.strip_prefix(own.trim_end_matches('/')).is_some_and(|rest| rest.starts_with('/'))
        };
        self.streams.is_empty() || self.streams.iter().any(below)
    }

    /// A path for each stream's file, no two alike.
    fn place(&self, stream: &str, ending: &str, taken: &mut BTreeMap<PathBuf, ()>) -> PathBuf {
        let base = file_name(stream);
        let mut path = self.output.join(format!("{base}.{ending}"));
        let mut number = 2;
        while taken.contains_key(&path) {
            path = self.output.join(format!("{base}_{number}.{ending}"));
            number += 1;
        }
        taken.insert(path.clone(), ());
        path
    }

    /// Reads twice: first which columns there are, then their values. A stream has every column that one of its rows has.
    fn tables(&self, reader: &mut Reader) -> Result<Vec<Written>, Failure> {
        let mut shapes: BTreeMap<u16, (String, Shape)> = BTreeMap::new();
        while let Some(entry) = reader.next().map_err(|error| failed(&error))? {
            let Some(cells) = self.row(&entry)? else { continue };
            let (_, shape) = shapes
                .entry(entry.stream.id)
                .or_insert_with(|| (entry.stream.name.clone(), Shape::default()));
            cells.into_iter().enumerate().for_each(|(place, (name, cell))| shape.add(place, name, &cell));
        }
        let mut reader = Reader::open(&self.file).map_err(|error| failed(&error))?;
        let ending = if self.kind == Kind::Csv { "csv" } else { "parquet" };
        let mut taken = BTreeMap::new();
        let mut files = BTreeMap::new();
        for (id, (stream, shape)) in shapes {
            let path = self.place(&stream, ending, &mut taken);
            let table: Box<dyn Table> = match self.kind {
                Kind::Csv => Box::new(CsvTable::new(&path, &shape.columns)?),
                _ => Box::new(ParquetTable::new(&path, &shape.columns)?),
            };
            files.insert(id, (Written { stream, path, rows: 0 }, shape, table));
        }
        while let Some(entry) = reader.next().map_err(|error| failed(&error))? {
            let Some(cells) = self.row(&entry)? else { continue };
            let Some((written, shape, table)) = files.get_mut(&entry.stream.id) else { continue };
            let mut row: Vec<Option<Cell>> = vec![None; shape.columns.len()];
            for (place, (column, cell)) in cells.into_iter().enumerate() {
                if let Some(place) = shape.place(place, &column) {
                    row[place] = Some(cell);
                }
            }
            table.push(row)?;
            written.rows += 1;
        }
        let mut all = Vec::new();
        for (_, (written, _, mut table)) in files {
            table.finish()?;
            all.push(written);
        }
        Ok(all)
    }

    fn row(&self, entry: &Entry<'_>) -> Result<Option<Vec<(String, Cell)>>, Failure> {
        if !self.wants(entry) {
            return Ok(None);
        }
        flat(entry).map_err(|error| {
            Failure::Work(format!("{}, stream {}: {error}", self.file.display(), entry.stream.name))
        })
    }

    /// The poses of every stream that has them; what is not tracked is left out, as the format has no word for it.
    fn trajectories(&self, reader: &mut Reader) -> Result<Vec<(String, Trajectory)>, Failure> {
        let mut all: BTreeMap<u16, (String, Trajectory)> = BTreeMap::new();
        while let Some(entry) = reader.next().map_err(|error| failed(&error))? {
            if !self.wants(&entry) {
                continue;
            }
            let Sample { captured, value: pose, .. } = if entry.is::<Pose>() {
                entry.decode::<Pose>().map_err(|error| failed(&error))?
            } else if entry.is::<RawLocation>() {
                let said = entry.decode::<RawLocation>().map_err(|error| failed(&error))?;
                Sample { captured: said.captured, arrived: said.arrived, value: said.value.read() }
            } else {
                continue;
            };
            let Some(reference_from_device) = pose.reference_from_device() else { continue };
            let (_, trajectory) = all
                .entry(entry.stream.id)
                .or_insert_with(|| (entry.stream.name.clone(), Trajectory::default()));
            // Located twice for one instant: the last word counts.
            if trajectory.poses.last().is_some_and(|(last, _)| *last == captured) {
                trajectory.poses.pop();
            }
            trajectory.poses.push((captured, reference_from_device));
        }
        let mut all: Vec<_> = all.into_values().collect();
        for (_, trajectory) in &mut all {
            trajectory.poses.sort_by_key(|(at, _)| *at);
            trajectory.poses.dedup_by_key(|(at, _)| *at);
        }
        Ok(all)
    }

    fn tum(&self, reader: &mut Reader) -> Result<Vec<Written>, Failure> {
        let mut taken = BTreeMap::new();
        let mut all = Vec::new();
        for (stream, trajectory) in self.trajectories(reader)? {
            let path = self.place(&stream, "tum.txt", &mut taken);
            let file = File::create(&path).map_err(|e| Failure::unwritable(&path, &e))?;
            trajectory.write_tum(BufWriter::new(file)).map_err(|e| Failure::unwritable(&path, &e))?;
            all.push(Written { stream, path, rows: trajectory.poses.len() as u64 });
        }
        Ok(all)
    }

    fn euroc(&self, reader: &mut Reader) -> Result<Vec<Written>, Failure> {
        let mut all = Vec::new();
        let rig = self.output.join("mav0");
        let open = |folder: &str, head: &str| -> Result<(PathBuf, BufWriter<File>), Failure> {
            let folder = rig.join(folder);
            std::fs::create_dir_all(&folder).map_err(|e| Failure::unwritable(&folder, &e))?;
            let path = folder.join("data.csv");
            let mut file = BufWriter::new(File::create(&path).map_err(|e| Failure::unwritable(&path, &e))?);
            writeln!(file, "{head}").map_err(|e| Failure::unwritable(&path, &e))?;
            Ok((path, file))
        };
        let mut tables: BTreeMap<u16, (Written, BufWriter<File>, PathBuf)> = BTreeMap::new();
        let (mut units, mut cameras) = (0, 0);
        while let Some(entry) = reader.next().map_err(|error| failed(&error))? {
            if !self.wants(&entry) || !(entry.is::<Imu>() || entry.is::<Compressed<'_>>()) {
                continue;
            }
            let id = entry.stream.id;
            let (written, file, data) = match tables.entry(id) {
                btree_map::Entry::Occupied(table) => table.into_mut(),
                btree_map::Entry::Vacant(place) => {
                    let (folder, head) = if entry.is::<Imu>() {
                        units += 1;
                        (format!("imu{}", units - 1), IMU_HEAD)
                    } else {
                        cameras += 1;
                        (format!("cam{}", cameras - 1), "#timestamp [ns],filename")
                    };
                    let (path, file) = open(&folder, head)?;
                    let written = Written { stream: entry.stream.name.clone(), path, rows: 0 };
                    place.insert((written, file, rig.join(&folder).join("data")))
                }
            };
            let path = written.path.clone();
            let line = if entry.is::<Imu>() {
                let imu = entry.decode::<Imu>().map_err(|error| failed(&error))?;
                let (g, a) = (imu.value.gyr_rad_s, imu.value.acc_m_s2);
                format!("{},{},{},{},{},{},{}", imu.captured.as_nanos(), g.x, g.y, g.z, a.x, a.y, a.z)
            } else {
                let picture = entry.decode::<Compressed<'_>>().map_err(|error| failed(&error))?;
                if picture.value.0.encoding != "png" {
                    continue;
                }
                std::fs::create_dir_all(&*data).map_err(|e| Failure::unwritable(data, &e))?;
                let name = format!("{}.png", picture.captured.as_nanos());
                let place = data.join(&name);
                std::fs::write(&place, &picture.value.0.data).map_err(|e| Failure::unwritable(&place, &e))?;
                format!("{},{name}", picture.captured.as_nanos())
            };
            writeln!(file, "{line}").map_err(|e| Failure::unwritable(&path, &e))?;
            written.rows += 1;
        }
        for (_, (written, mut file, _)) in tables {
            file.flush().map_err(|e| Failure::unwritable(&written.path, &e))?;
            all.push(written);
        }
        let mut again = Reader::open(&self.file).map_err(|error| failed(&error))?;
        for (index, (stream, trajectory)) in self.trajectories(&mut again)?.into_iter().enumerate() {
            let (path, mut file) = open(&format!("state_groundtruth_estimate{index}"), TRUTH_HEAD)?;
            for (at, pose) in &trajectory.poses {
                let [x, y, z, qx, qy, qz, qw] = components(pose);
                let at: &Timestamp = at;
                writeln!(file, "{},{x},{y},{z},{qw},{qx},{qy},{qz}", at.as_nanos())
                    .map_err(|e| Failure::unwritable(&path, &e))?;
            }
            file.flush().map_err(|e| Failure::unwritable(&path, &e))?;
            all.push(Written { stream, path, rows: trajectory.poses.len() as u64 });
        }
        Ok(all)
    }
}

const IMU_HEAD: &str = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]";
const TRUTH_HEAD: &str =
    "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []";

/// The columns of a stream's table, in the order in which they were first seen.
#[derive(Default)]
struct Shape {
    columns: Vec<(String, Column)>,
    places: HashMap<String, usize>,
}

impl Shape {
    /// Where a column is; mostly where it was in the row.
    fn place(&self, likely: usize, name: &str) -> Option<usize> {
        let is_likely = self.columns.get(likely).is_some_and(|(own, _)| own == name);
        if is_likely { Some(likely) } else { self.places.get(name).copied() }
    }

    fn add(&mut self, likely: usize, name: String, cell: &Cell) {
        let kind = Column::of(cell);
        if let Some(place) = self.place(likely, &name) {
            self.columns[place].1 = self.columns[place].1.with(kind);
        } else {
            self.places.insert(name.clone(), self.columns.len());
            self.columns.push((name, kind));
        }
    }
}
