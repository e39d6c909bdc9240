//! Tables with one row per trial, and the map that says which column is what.

use std::collections::BTreeMap;
use std::path::Path;

use csv::ByteRecord;
use serde::Deserialize;

use super::Imported;
use crate::Error;
use crate::convention::Conventions;
use crate::trial::{DataSet, PathMeasures, Trial};

/// Where a value comes from.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum Column {
    /// A column.
    Name(String),
    /// The same for every row.
    Constant(f64),
    /// Texts joined by `-`.
    Names(Vec<String>),
    /// A column, turned into our unit.
    Scaled(Scaled),
}

/// `value · scale + offset` of a column.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scaled {
    /// Its name.
    pub column: String,
    /// Factor.
    #[serde(default = "one")]
    pub scale: f64,
    /// Added after that.
    #[serde(default)]
    pub offset: f64,
}

fn one() -> f64 {
    1.0
}

/// Which column is what; read from TOML.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColumnMap {
    /// Unit of all lengths, for print.
    #[serde(default)]
    pub length_unit: Option<String>,
    /// 1, 2 or 3; default: as many as end or dx has.
    #[serde(default)]
    pub dimensions: Option<usize>,
    /// Unit of `mt`: s, ms, us or ns; default s.
    #[serde(default)]
    pub time_unit: Option<String>,
    /// Between cells; default: whichever of comma, semicolon and tab the first line has.
    #[serde(default)]
    pub delimiter: Option<char>,
    /// `default`, `fittsstudy`, `3dfitts` or `gofitts`; default `default`.
    #[serde(default)]
    pub preset: Option<String>,
    /// Knobs that differ from the preset.
    #[serde(default)]
    pub conventions: BTreeMap<String, toml::Value>,
    /// Our name = where it comes from. Without any, columns that have our names are taken.
    #[serde(default)]
    pub columns: BTreeMap<String, Column>,
    /// Other factors: name = column.
    #[serde(default)]
    pub factors: BTreeMap<String, String>,
    /// Keep only rows where a column has one of these texts.
    #[serde(default)]
    pub only: BTreeMap<String, Vec<String>>,
}

/// Maps that are shipped.
pub struct Maps;

impl Maps {
    /// Names and texts.
    pub const ALL: [(&'static str, &'static str); 1] =
        [("guiard2011", include_str!("../../maps/guiard2011.toml"))];

    /// The map of that name.
    pub fn named(name: &str) -> Option<Result<ColumnMap, Error>> {
        let (name, text) = Self::ALL.iter().find(|(own, _)| *own == name)?;
        Some(ColumnMap::parse(Path::new(name), text))
    }
}

pub(super) const NUMBERS: [&str; 30] = [
    "mt",
    "amplitude",
    "width",
    "index",
    "from_x",
    "from_y",
    "from_z",
    "to_x",
    "to_y",
    "to_z",
    "start_x",
    "start_y",
    "start_z",
    "end_x",
    "end_y",
    "end_z",
    "dx",
    "dy",
    "dz",
    "ae",
    "tre",
    "tac",
    "mdc",
    "odc",
    "mv",
    "me",
    "mo",
    "submovements",
    "overshoots",
    "attempt",
];
pub(super) const TEXTS: [&str; 5] = ["participant", "session", "block", "condition", "instruction"];
const FLAGS: [&str; 6] = ["error", "hit", "practice", "spatial_outlier", "temporal_outlier", "repeated"];

/// Places in [`NUMBERS`].
mod at {
    pub const MT: usize = 0;
    pub const AMPLITUDE: usize = 1;
    pub const WIDTH: usize = 2;
    pub const INDEX: usize = 3;
    pub const FROM: usize = 4;
    pub const TO: usize = 7;
    pub const START: usize = 10;
    pub const END: usize = 13;
    pub const DX: usize = 16;
    pub const AE: usize = 19;
    pub const PATH: usize = 20;
    pub const ATTEMPT: usize = 29;
}

impl ColumnMap {
    /// Reads a map; `path` is for errors.
    ///
    /// # Errors
    /// Where it is no map: file, line, column and what was expected.
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let map: Self = vergence_config::parse(path, text)?;
        if let Some(name) = map.columns.keys().find(|name| !is_known(name)) {
            let offset = text.find(name.as_str()).unwrap_or(0);
            let expected = [NUMBERS.as_slice(), &TEXTS, &FLAGS].concat().join(", ");
            let message = format!("expected one of {expected}, found `{name}`");
            return Err(vergence_config::invalid_at(path, text, offset, &message).into());
        }
        map.resolved().map(|_| map)
    }

    /// The conventions it asks for.
    ///
    /// # Errors
    /// Where a preset, knob, unit or number of dimensions is not known.
    pub fn resolved(&self) -> Result<Conventions, Error> {
        let mut conventions = match self.preset.as_deref().unwrap_or("default") {
            "default" => Conventions::default(),
            "fittsstudy" => Conventions::fittsstudy(),
            "3dfitts" => Conventions::threedfitts(),
            "gofitts" => Conventions::gofitts(),
            other => {
                let expected = "default, fittsstudy, 3dfitts, gofitts".to_owned();
                return Err(Error::Knob { what: "preset", expected, found: other.to_owned() });
            }
        };
        for (knob, value) in &self.conventions {
            match value {
                toml::Value::String(text) => conventions.set(knob, text)?,
                other => conventions.set(knob, &other.to_string())?,
            }
        }
        self.seconds()?;
        if self.dimensions.is_some_and(|d| !(1..=3).contains(&d)) {
            let found = self.dimensions.unwrap_or(0).to_string();
            return Err(Error::Knob { what: "number of dimensions", expected: "1, 2, 3".to_owned(), found });
        }
        Ok(conventions)
    }

    /// Columns of the table whose cells are names, also where they look like numbers.
    pub fn texts(&self) -> Vec<&str> {
        if self.columns.is_empty() {
            return TEXTS.iter().copied().chain(self.factors.values().map(String::as_str)).collect();
        }
        let named = self.columns.iter().filter(|(own, _)| TEXTS.contains(&own.as_str()));
        let columns = named.flat_map(|(_, column)| match column {
            Column::Name(name) => std::slice::from_ref(name),
            Column::Names(names) => names,
            Column::Constant(_) | Column::Scaled(_) => &[],
        });
        let others = self.factors.values().chain(self.only.keys());
        columns.chain(others).map(String::as_str).collect()
    }

    fn seconds(&self) -> Result<f64, Error> {
        match self.time_unit.as_deref().unwrap_or("s") {
            "s" => Ok(1.0),
            "ms" => Ok(1e-3),
            "us" => Ok(1e-6),
            "ns" => Ok(1e-9),
            other => Err(Error::Knob {
                what: "time unit",
                expected: "s, ms, us, ns".to_owned(),
                found: other.to_owned(),
            }),
        }
    }

    /// This map with a delimiter: its own, else the one that `text`, the beginning of a table, has in its first line.
    pub(super) fn with_delimiter_of(&self, text: &[u8]) -> Self {
        let line = text.split(|byte| *byte == b'\n').next().unwrap_or_default();
        // A header in quotes says nothing by what is inside of them.
        let mut quoted = false;
        let outside = line.iter().filter(|byte| {
            quoted ^= **byte == b'"';
            !quoted
        });
        let outside: Vec<u8> = outside.copied().collect();
        let seen = [',', ';', '\t'].into_iter().find(|mark| outside.contains(&(*mark as u8)));
        Self { delimiter: self.delimiter.or(seen), ..self.clone() }
    }

    pub(super) fn delimiter(&self) -> u8 {
        self.delimiter.and_then(|c| u8::try_from(c).ok()).unwrap_or(b',')
    }
}

/// Whether a map may say where `name` comes from.
pub(crate) fn is_known(name: &str) -> bool {
    [NUMBERS.as_slice(), &TEXTS, &FLAGS].iter().any(|list| list.contains(&name))
}

#[derive(Clone, Debug)]
enum Source {
    Cell { place: usize, scale: f64, offset: f64 },
    Constant(f64),
}

/// A map bound to the header of one table.
#[derive(Clone, Debug)]
pub(super) struct Bound {
    header: Vec<String>,
    numbers: [Option<Source>; NUMBERS.len()],
    /// Cells that are joined, per text.
    texts: [Vec<usize>; TEXTS.len()],
    flags: [Option<usize>; FLAGS.len()],
    factors: Vec<(String, usize)>,
    only: Vec<(usize, Vec<String>)>,
    seconds: f64,
    pub dimensions: usize,
    pub length_unit: String,
    pub conventions: Conventions,
}

/// What the sizes of the row before were, as written and as numbers: nearly always those of the next.
#[derive(Default)]
pub(super) struct Sizes {
    amplitude: Option<(Vec<u8>, Option<f64>)>,
    width: Option<(Vec<u8>, Option<f64>)>,
}

impl Bound {
    pub fn new(map: &ColumnMap, header: &ByteRecord) -> Result<Self, Error> {
        let mut names: Vec<String> =
            header.iter().map(|cell| String::from_utf8_lossy(cell).trim().to_owned()).collect();
        if let Some(first) = names.first_mut() {
            *first = first.trim_start_matches('\u{feff}').to_owned();
        }
        let place =
            |name: &str| names.iter().position(|own| own == name).ok_or_else(|| no_column(name, &names));
        let own = map.columns.is_empty();
        let source = |name: &str| -> Result<Option<Source>, Error> {
            Ok(match map.columns.get(name) {
                Some(Column::Name(column)) => {
                    Some(Source::Cell { place: place(column)?, scale: 1.0, offset: 0.0 })
                }
                Some(Column::Scaled(Scaled { column, scale, offset })) => {
                    Some(Source::Cell { place: place(column)?, scale: *scale, offset: *offset })
                }
                Some(Column::Constant(value)) => Some(Source::Constant(*value)),
                Some(Column::Names(_)) => {
                    let expected = "a column or a number".to_owned();
                    return Err(Error::Knob { what: "column", expected, found: name.to_owned() });
                }
                None if own => {
                    let alias = if name == "mt" { "mt_s" } else { name };
                    let found = names.iter().position(|own| own == name || own == alias);
                    found.map(|place| Source::Cell { place, scale: 1.0, offset: 0.0 })
                }
                None => None,
            })
        };
        let mut numbers: [Option<Source>; NUMBERS.len()] = std::array::from_fn(|_| None);
        for (slot, name) in numbers.iter_mut().zip(NUMBERS) {
            *slot = source(name)?;
        }
        let mut texts: [Vec<usize>; TEXTS.len()] = Default::default();
        for (slot, name) in texts.iter_mut().zip(TEXTS) {
            *slot = match map.columns.get(name) {
                Some(Column::Names(columns)) => columns.iter().map(|c| place(c)).collect::<Result<_, _>>()?,
                Some(Column::Name(column)) => vec![place(column)?],
                Some(_) => {
                    let expected = "a column or a list of columns".to_owned();
                    return Err(Error::Knob { what: "column", expected, found: name.to_owned() });
                }
                None if own => names.iter().position(|own| own == name).into_iter().collect(),
                None => Vec::new(),
            };
        }
        let mut flags = [None; FLAGS.len()];
        for (slot, name) in flags.iter_mut().zip(FLAGS) {
            *slot = match map.columns.get(name) {
                Some(Column::Name(column)) => Some(place(column)?),
                Some(_) => {
                    let expected = "a column".to_owned();
                    return Err(Error::Knob { what: "column", expected, found: name.to_owned() });
                }
                None if own => names.iter().position(|own| own == name),
                None => None,
            };
        }
        for (needed, name) in [(at::MT, "mt"), (at::END, "end_x")] {
            if numbers[needed].is_none() && !(needed == at::END && numbers[at::DX].is_some()) {
                let name = if own && name == "mt" { "mt_s" } else { name };
                return Err(no_column(name, &names));
            }
        }
        let base = if numbers[at::END].is_some() { at::END } else { at::DX };
        let found = (0..3).filter(|i| numbers[base + i].is_some()).count();
        let factors = map.factors.iter().map(|(name, column)| Ok((name.clone(), place(column)?)));
        let factors = factors.collect::<Result<Vec<_>, Error>>()?;
        let only = map.only.iter().map(|(column, texts)| Ok((place(column)?, texts.clone())));
        let only = only.collect::<Result<Vec<_>, Error>>()?;
        Ok(Self {
            numbers,
            texts,
            flags,
            factors,
            only,
            seconds: map.seconds()?,
            dimensions: map.dimensions.unwrap_or(found),
            length_unit: map.length_unit.clone().unwrap_or_else(|| "unit".to_owned()),
            conventions: map.resolved()?,
            header: names,
        })
    }

    /// What is doubtful in a table of which `absent` rows were left out.
    pub fn warnings(&self, absent: u64) -> Vec<String> {
        let mut found = Vec::new();
        if absent > 0 {
            found.push(format!("{absent} rows are not wanted by the map or lack a number it needs"));
        }
        let has = |slot: usize| self.numbers[slot].is_some();
        if !has(at::END) && !has(at::AMPLITUDE) && !has(at::AE) {
            found.push(
                "no column is the amplitude (or ae): there are spreads, and no difficulty or throughput"
                    .to_owned(),
            );
        }
        found
    }

    /// Fills the numbers and flags of `trial` from a row. False where the row is not wanted or lacks a number that is
    /// needed.
    pub fn fill(
        &self,
        row: &ByteRecord,
        line: u64,
        sizes: &mut Sizes,
        trial: &mut Trial,
    ) -> Result<bool, Error> {
        if row.len() != self.header.len() {
            return Err(Error::Row { line, expected: self.header.len(), found: row.len() });
        }
        for (place, texts) in &self.only {
            let cell = trimmed(&row[*place]);
            if !texts.iter().any(|text| text.as_bytes() == cell) {
                return Ok(false);
            }
        }
        let value = |slot: usize| self.value(row, line, slot);
        let Some(mt) = value(at::MT)? else { return Ok(false) };
        if mt <= 0.0 {
            let column = match &self.numbers[at::MT] {
                Some(Source::Cell { place, .. }) => self.header[*place].clone(),
                _ => "mt".to_owned(),
            };
            return Err(Error::Cell { line, column, expected: "a time above zero", found: mt.to_string() });
        }
        trial.mt_s = mt * self.seconds;
        trial.amplitude = self.repeated(row, line, at::AMPLITUDE, &mut sizes.amplitude)?;
        trial.width = self.repeated(row, line, at::WIDTH, &mut sizes.width)?.filter(|width| *width > 0.0);
        let count = |slot: usize| -> Result<u32, Error> {
            Ok(value(slot)?.map_or(0, |count| count.clamp(0.0, 4e9) as u32))
        };
        (trial.index, trial.attempt) = (count(at::INDEX)?, count(at::ATTEMPT)?);
        let point = |slot: usize| -> Result<Option<[f64; 3]>, Error> {
            let Some(x) = value(slot)? else { return Ok(None) };
            Ok(Some([x, value(slot + 1)?.unwrap_or(0.0), value(slot + 2)?.unwrap_or(0.0)]))
        };
        if self.numbers[at::END].is_some() {
            let Some(end) = point(at::END)? else { return Ok(false) };
            trial.end = end;
            trial.from = point(at::FROM)?;
            trial.start = point(at::START)?.or(trial.from);
            let nominal = trial.amplitude.unwrap_or(0.0);
            let begin = trial.from.or(trial.start).unwrap_or_default();
            trial.to = point(at::TO)?.unwrap_or([begin[0] + nominal, begin[1], begin[2]]);
        } else {
            // Ends relative to the target: the axis is x, from 0 to the amplitude. Without one, where a movement began is
            // not known: `from` is any place on the axis.
            let Some(offset) = point(at::DX)? else { return Ok(false) };
            let nominal = trial.amplitude;
            trial.from = Some([nominal.map_or(-1.0, |_| 0.0), 0.0, 0.0]);
            let place = nominal.unwrap_or(0.0);
            trial.to = [place, 0.0, 0.0];
            trial.end = [place + offset[0], offset[1], offset[2]];
            let begin = value(at::AE)?.map(|ae| trial.end[0] - ae).or(nominal.map(|_| 0.0));
            trial.start = begin.map(|x| [x, 0.0, 0.0]);
        }
        let mut path = [None; 9];
        for (i, slot) in path.iter_mut().enumerate() {
            if self.numbers[at::PATH + i].is_some() {
                *slot = value(at::PATH + i)?;
            }
        }
        trial.measured = path.iter().any(Option::is_some).then(|| PathMeasures::from_values(path));
        let flag = |i: usize| -> Result<Option<bool>, Error> {
            let Some(place) = self.flags[i] else { return Ok(None) };
            let cell = String::from_utf8_lossy(&row[place]);
            if cell.trim().is_empty() {
                return Ok(None);
            }
            super::truth(&cell, &self.header[place], line).map(Some)
        };
        trial.error = match (flag(0)?, flag(1)?) {
            (Some(error), _) => Some(error),
            (None, Some(hit)) => Some(!hit),
            (None, None) => {
                let off: f64 = (0..self.dimensions).map(|i| (trial.end[i] - trial.to[i]).powi(2)).sum();
                trial.width.map(|width| off.sqrt() > 0.5 * width)
            }
        };
        trial.practice = flag(2)?.unwrap_or(false);
        trial.spatial_outlier = flag(3)?;
        trial.temporal_outlier = flag(4)?;
        trial.repeated = flag(5)?.unwrap_or(false);
        Ok(true)
    }

    /// As [`Self::value`], of a column that says the same for rows on end.
    fn repeated(
        &self,
        row: &ByteRecord,
        line: u64,
        slot: usize,
        last: &mut Option<(Vec<u8>, Option<f64>)>,
    ) -> Result<Option<f64>, Error> {
        let Some(Source::Cell { place, .. }) = &self.numbers[slot] else {
            return self.value(row, line, slot);
        };
        if let Some((cell, value)) = last
            && cell == &row[*place]
        {
            return Ok(*value);
        }
        let value = self.value(row, line, slot)?;
        *last = Some((row[*place].to_vec(), value));
        Ok(value)
    }

    #[inline]
    fn value(&self, row: &ByteRecord, line: u64, slot: usize) -> Result<Option<f64>, Error> {
        let (place, scale, offset) = match &self.numbers[slot] {
            None => return Ok(None),
            Some(Source::Constant(value)) => return Ok(Some(*value)),
            Some(Source::Cell { place, scale, offset }) => (*place, *scale, *offset),
        };
        // The same numbers as the standard library reads, in half of the time.
        match fast_float2::parse::<f64, _>(&row[place]) {
            Ok(value) if value.is_finite() => Ok(Some(value * scale + offset)),
            _ => self
                .odd_value(&row[place], line, place)
                .map(|found| found.map(|value| value * scale + offset)),
        }
    }

    /// Of a cell that is not a finite number from its first byte to its last.
    #[cold]
    fn odd_value(&self, cell: &[u8], line: u64, place: usize) -> Result<Option<f64>, Error> {
        let cell = trimmed(cell);
        match fast_float2::parse::<f64, _>(cell) {
            Ok(value) if value.is_finite() => Ok(Some(value)),
            _ if is_absent(cell) => Ok(None),
            _ => Err(Error::Cell {
                line,
                column: self.header[place].clone(),
                expected: if is_comma_number(cell) {
                    "a finite number with a decimal point (decimal commas are not read)"
                } else {
                    "a finite number"
                },
                found: String::from_utf8_lossy(cell).chars().take(40).collect(),
            }),
        }
    }

    /// The bytes that name the row's sequence, appended to `key` with separators.
    pub fn key(&self, row: &ByteRecord, key: &mut Vec<u8>) {
        key.clear();
        for places in &self.texts {
            for (i, place) in places.iter().enumerate() {
                if i > 0 {
                    key.push(b'-');
                }
                key.extend_from_slice(trimmed(&row[*place]));
            }
            key.push(0);
        }
        for (_, place) in &self.factors {
            key.extend_from_slice(trimmed(&row[*place]));
            key.push(0);
        }
        for slot in [at::AMPLITUDE, at::WIDTH] {
            if let Some(Source::Cell { place, .. }) = &self.numbers[slot] {
                key.extend_from_slice(trimmed(&row[*place]));
            }
            key.push(0);
        }
    }

    /// Sets the texts of `trial` from a key of its.
    pub fn name(&self, key: &[u8], trial: &mut Trial) {
        let mut parts = key.split(|byte| *byte == 0).map(|part| String::from_utf8_lossy(part).into_owned());
        let mut next = || parts.next().unwrap_or_default();
        trial.participant = next();
        trial.session = next();
        trial.block = next();
        trial.condition = next();
        trial.instruction = Some(next()).filter(|text| !text.is_empty());
        trial.factors = self.factors.iter().map(|(name, _)| (name.clone(), next())).collect();
        if self.texts[3].is_empty() {
            let size = |name: &str, value: Option<f64>| value.map(|value| format!("{name}{value}"));
            let mut parts: Vec<String> = Vec::new();
            parts.extend(trial.instruction.clone());
            parts.extend(trial.factors.values().cloned());
            parts.extend(size("A", trial.amplitude));
            parts.extend(size("W", trial.width));
            trial.condition = if parts.is_empty() { "all".to_owned() } else { parts.join("-") };
        }
        if trial.participant.is_empty() {
            trial.participant = "unknown".to_owned();
        }
    }
}

/// `1,5`.
fn is_comma_number(cell: &[u8]) -> bool {
    let text = String::from_utf8_lossy(cell);
    text.matches(',').count() == 1 && text.replace(',', ".").parse::<f64>().is_ok_and(f64::is_finite)
}

fn no_column(column: &str, names: &[String]) -> Error {
    const MOST: usize = 300;
    let mut header = names.join(", ");
    if let Some((cut, _)) = header.char_indices().nth(MOST) {
        header.truncate(cut);
        header.push('…');
    }
    Error::NoColumn { column: column.to_owned(), header }
}

fn trimmed(cell: &[u8]) -> &[u8] {
    cell.trim_ascii()
}

fn is_absent(cell: &[u8]) -> bool {
    matches!(cell, b"" | b"NaN" | b"nan" | b"NA" | b"null")
}

pub(super) fn reader_of<R: std::io::Read>(map: &ColumnMap, reader: R) -> csv::Reader<R> {
    csv::ReaderBuilder::new().has_headers(false).flexible(true).delimiter(map.delimiter()).from_reader(reader)
}

pub(super) fn read(text: &str, map: &ColumnMap) -> Result<Imported, Error> {
    let map = &map.with_delimiter_of(text.as_bytes());
    let mut reader = reader_of(map, text.as_bytes());
    let mut row = ByteRecord::new();
    let damaged = |error: csv::Error| Error::Xml {
        line: error.position().map_or(0, csv::Position::line),
        expected: "a row",
    };
    if !reader.read_byte_record(&mut row).map_err(damaged)? {
        return Err(Error::Header { expected: "the names of the columns" });
    }
    let bound = Bound::new(map, &row)?;
    let mut trials = Vec::new();
    let (mut key, mut sizes, mut absent) = (Vec::new(), Sizes::default(), 0u64);
    while reader.read_byte_record(&mut row).map_err(damaged)? {
        let line = row.position().map_or(0, csv::Position::line);
        let mut trial = Trial::default();
        if bound.fill(&row, line, &mut sizes, &mut trial)? {
            bound.key(&row, &mut key);
            bound.name(&key, &mut trial);
            trials.push(trial);
        } else {
            absent += 1;
        }
    }
    if trials.is_empty() {
        return Err(Error::Empty { what: "trials" });
    }
    let warnings = bound.warnings(absent);
    let data = DataSet { length_unit: bound.length_unit.clone(), dimensions: bound.dimensions, trials };
    Ok(Imported { data, conventions: bound.conventions, warnings })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn maps_say_what_is_wrong_and_where() {
        let parse = |text: &str| ColumnMap::parse(Path::new("m.toml"), text).unwrap_err().to_string();
        assert!(
            parse("[columns]\nmt = \"t\"\nendx = \"x\"\n").starts_with("m.toml:3:1: expected one of mt, ")
        );
        assert!(parse("time_unit = \"h\"").contains("s, ms, us, ns"));
        assert!(parse("[columns]\nmt = true").starts_with("m.toml:2"));
        assert!(parse("[conventions]\naxis = \"up\"").contains("nominal, start, serial"));
        for (name, _) in Maps::ALL {
            Maps::named(name).unwrap().unwrap();
        }
    }

    #[test]
    fn rows_become_trials() {
        let map = "time_unit = \"ms\"\n[columns]\nparticipant = \"p\"\nmt = \"t\"\nend_x = { column = \"x\", scale = 0.001 }\nto_x = 0.1\nfrom_x = 0\nwidth = 0.01\ncondition = [\"p\", \"c\"]\n[only]\nc = [\"1\"]";
        let map = ColumnMap::parse(Path::new("m"), map).unwrap();
        let imported = read("p,c,t,x\nA,1,500,104\nA,2,500,104\nA,1,,104\nA,1,250,106\n", &map).unwrap();
        let trials = &imported.data.trials;
        assert_eq!((trials.len(), trials[0].mt_s, trials[0].condition.as_str()), (2, 0.5, "A-1"));
        assert_eq!(
            (trials[0].error, trials[1].error, imported.data.dimensions),
            (Some(false), Some(true), 1)
        );
        assert_eq!(imported.warnings.len(), 1);
        let error = read("p,c,t,x\nA,1,None,104\n", &map).unwrap_err();
        assert_eq!(error.to_string(), "line 2, column \"t\": expected a finite number, found \"None\"");
        let error = read("p,c,t,x\nA,1,4\n", &map).unwrap_err();
        assert_eq!(error.to_string(), "line 2: expected 4 cells, found 3");
        assert!(read("p,c,x\nA,1,4\n", &map).unwrap_err().to_string().contains("\"t\""));
    }

    #[test]
    fn our_own_names_need_no_map() {
        let imported = read(
            "participant,condition,mt_s,dx,amplitude,width\nP1,a,0.5,1,10,4\nP1,a,0.6,-3,10,4\n",
            &ColumnMap::default(),
        )
        .unwrap();
        assert_eq!((imported.data.trials[0].error, imported.data.trials[1].error), (Some(false), Some(true)));
        assert_eq!(imported.data.trials[0].end, [11.0, 0.0, 0.0]);
    }

    #[test]
    fn semicolons_and_tabs_are_seen_and_decimal_commas_named() {
        let table = "participant,\"co,nd\",mt_s,dx,amplitude,width\nP1,a,0.5,1,10,4\nP1,a,0.6,-3,10,4\n";
        let own = read(table, &ColumnMap::default()).unwrap();
        for mark in [";", "\t"] {
            let other = table.replace(',', mark);
            assert_eq!(read(&other, &ColumnMap::default()).unwrap().data, own.data);
            let streamed = super::super::stream(other.as_bytes(), &ColumnMap::default(), None, 2, |_| {});
            assert_eq!(streamed.unwrap().analysis.counts.trials, 2);
        }
        let comma = "participant;mt_s;dx\nP1;0,5;1\n";
        let error = read(comma, &ColumnMap::default()).unwrap_err().to_string();
        assert!(error.starts_with("line 2, column \"mt_s\"") && error.contains("decimal commas"), "{error}");
        let error = read("who|mt_s|dx\n", &ColumnMap::default()).unwrap_err().to_string();
        assert!(error.contains("expected a column \"mt_s\", found who|mt_s|dx ("), "{error}");
    }

    #[test]
    fn what_nobody_recorded_is_not_known() {
        let without = read("participant,mt_s,dx\nP1,0.5,1\nP1,0.6,2\n", &ColumnMap::default()).unwrap();
        assert_eq!(without.data.trials[0].error, None);
        let analysis = crate::analysis::analyse(&without.data, &without.conventions);
        assert_eq!((analysis.error_rate(), analysis.rows[0].ends.error_rate), (None, None));
        assert!(analysis.accuracy.is_empty());
        // Of a half it is known.
        let half = "participant,mt_s,dx,error\nP1,0.5,1,1\nP1,0.6,2,\nP1,0.6,2,0\n";
        let half = read(half, &ColumnMap::default()).unwrap();
        let analysis = crate::analysis::analyse(&half.data, &half.conventions);
        assert_eq!((analysis.error_rate(), analysis.counts.trials), (Some(0.5), 3));
    }

    proptest! {
        #[test]
        fn any_table_is_an_answer(text in "[a-z0-9,\\n\" .]{0,80}") {
            let _ = read(&text, &ColumnMap::default());
            let _ = read(&format!("mt,dx\n{text}"), &ColumnMap::default());
        }
    }
}
