//! `vergence log export`: a session log for other people's programs.

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use vergence_log::foreign::{Cell, flat};
use vergence_log::{Entry, Reader};
use vergence_sense::{Pose, RawLocation, Sample};
use vergence_slam::trajectory::Trajectory;

use super::failed;
use super::table::{Column, CsvTable, Draft, ParquetTable, Table};
use crate::failure::Failure;

#[derive(clap::Args)]
pub struct ExportArgs {
    /// What to write
    #[arg(value_enum)]
    kind: Kind,
    /// A session log (.mcap)
    pub file: PathBuf,
    /// Folder for the files; made where it is missing
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
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
pub struct Written {
    pub stream: String,
    pub path: PathBuf,
    pub rows: u64,
}

/// How far the log is read, on a terminal.
pub struct Progress {
    bar: ProgressBar,
    entries: u64,
}

impl Progress {
    fn new() -> Self {
        let bar = ProgressBar::new(0);
        if let Ok(style) = ProgressStyle::with_template("{bar:40} {bytes}/{total_bytes} {eta} {msg}") {
            bar.set_style(style);
        }
        Self { bar, entries: 0 }
    }

    /// What is done with the log from here on.
    fn pass(&self, what: &'static str) {
        self.bar.set_message(what);
    }

    /// The next message of the log.
    pub fn next<'a>(&mut self, reader: &'a mut Reader) -> Result<Option<Entry<'a>>, Failure> {
        if self.entries.is_multiple_of(1024) {
            let (read, all) = reader.progress();
            self.bar.set_length(all);
            self.bar.set_position(read);
        }
        self.entries += 1;
        reader.next().map_err(|error| failed(&error))
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
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
        let mut bar = Progress::new();
        let written = match self.kind {
            Kind::Csv | Kind::Parquet => self.tables(&mut reader, &mut bar)?,
            Kind::Tum => self.tum(&mut reader, &mut bar)?,
            Kind::Euroc => super::euroc::write(&self, &mut reader, &mut bar)?,
        };
        drop(bar);
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

    pub fn wants(&self, entry: &Entry<'_>) -> bool {
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
    fn tables(&self, reader: &mut Reader, bar: &mut Progress) -> Result<Vec<Written>, Failure> {
        bar.pass("columns");
        let mut shapes: BTreeMap<u16, (String, Shape)> = BTreeMap::new();
        while let Some(entry) = bar.next(reader)? {
            let Some(cells) = self.row(&entry)? else { continue };
            let (_, shape) = shapes
                .entry(entry.stream.id)
                .or_insert_with(|| (entry.stream.name.clone(), Shape::default()));
            cells.into_iter().enumerate().for_each(|(place, (name, cell))| shape.add(place, name, &cell));
        }
        let mut reader = Reader::open(&self.file).map_err(|error| failed(&error))?;
        bar.pass("values");
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
        while let Some(entry) = bar.next(&mut reader)? {
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
    pub fn trajectories(
        &self,
        reader: &mut Reader,
        bar: &mut Progress,
    ) -> Result<Vec<(String, Trajectory)>, Failure> {
        bar.pass("poses");
        let mut all: BTreeMap<u16, (String, Trajectory)> = BTreeMap::new();
        while let Some(entry) = bar.next(reader)? {
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

    fn tum(&self, reader: &mut Reader, bar: &mut Progress) -> Result<Vec<Written>, Failure> {
        let mut taken = BTreeMap::new();
        let mut all = Vec::new();
        for (stream, trajectory) in self.trajectories(reader, bar)? {
            let path = self.place(&stream, "tum.txt", &mut taken);
            let mut draft = Draft::create(&path)?;
            trajectory.write_tum(&mut draft).map_err(|e| Failure::unwritable(&path, &e))?;
            draft.keep()?;
            all.push(Written { stream, path, rows: trajectory.poses.len() as u64 });
        }
        Ok(all)
    }
}

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
