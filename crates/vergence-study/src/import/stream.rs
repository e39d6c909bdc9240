//! Millions of rows: the table is cut at line ends, pieces are summed side by side, sums are merged in order. Memory is a
//! few pieces and one set of sums per sequence; the answer does not depend on how many threads there are.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::io::Read;
use std::sync::Mutex;
use std::sync::mpsc::sync_channel;

use csv::ByteRecord;
use vergence_stats::Moments;

use super::columns::{Bound, ColumnMap, Sizes, reader_of};
use crate::Error;
use crate::analysis::{Analysis, Key, Left, Row, finished, key_of, summarised};
use crate::convention::{Axis, Conventions, Outliers};
use crate::measure::ends::{Sequence, end_of};
use crate::measure::outlier::is_spatial;
use crate::measure::path::of_path;
use crate::trial::{PathMeasures, Trial};

/// Bytes of a piece. Also bounds the length of a line.
const PIECE: usize = 1 << 20;
/// Most sequences: bounds memory where a column of numbers is taken for names.
const MOST_SEQUENCES: usize = 1 << 18;

/// What streaming gives.
#[derive(Clone, Debug, PartialEq)]
pub struct Streamed {
    /// Without conditional accuracy, which needs all times at once.
    pub analysis: Analysis,
    /// What is doubtful, in sentences.
    pub warnings: Vec<String>,
}

#[derive(Default)]
struct Sums {
    groups: HashMap<Vec<u8>, usize>,
    /// The place of the row before: nearly always that of this one, which then needs no hash.
    last: usize,
    sequences: Vec<(Vec<u8>, One)>,
    left: Left,
    absent: u64,
    rows: u64,
}

#[derive(Clone)]
struct One {
    sequence: Sequence,
    paths: Option<Box<[Moments; 9]>>,
    amplitude: Option<f64>,
    width: Option<f64>,
}

impl One {
    fn merge(&mut self, other: Self) {
        self.sequence.merge(&other.sequence);
        match (&mut self.paths, other.paths) {
            (Some(own), Some(other)) => {
                own.iter_mut().zip(other.iter()).for_each(|(own, other)| own.merge(other))
            }
            (none, Some(other)) => *none = Some(other),
            (_, None) => {}
        }
    }
}

impl Sums {
    fn of(&mut self, key: &[u8], trial: &Trial) -> Result<&mut One, Error> {
        if self.sequences.get(self.last).is_some_and(|(own, _)| own == key) {
            return Ok(&mut self.sequences[self.last].1);
        }
        let place = match self.groups.get(key) {
            Some(place) => *place,
            None => {
                if self.sequences.len() >= MOST_SEQUENCES {
                    return Err(Error::TooMany { what: "sequences", most: MOST_SEQUENCES });
                }
                self.groups.insert(key.to_vec(), self.sequences.len());
                let one = One {
                    sequence: Sequence::default(),
                    paths: None,
                    amplitude: trial.amplitude,
                    width: trial.width,
                };
                self.sequences.push((key.to_vec(), one));
                self.sequences.len() - 1
            }
        };
        self.last = place;
        Ok(&mut self.sequences[place].1)
    }

    fn merge(&mut self, other: Self) -> Result<(), Error> {
        self.left.merge(other.left);
        self.absent += other.absent;
        self.rows += other.rows;
        for (key, one) in other.sequences {
            let blank = Trial { amplitude: one.amplitude, width: one.width, ..Trial::default() };
            let own = self.of(&key, &blank)?;
            own.merge(one);
        }
        Ok(())
    }
}

/// Analyses a table of any length. `threads` is how many pieces are summed side by side; `progress` hears how many bytes
/// were read. `conventions` replace the map's.
///
/// # Errors
/// Where the table is damaged, or the conventions need a whole sequence at once (outlier policies `3sd` and `3mad`, the
/// serial axis).
pub fn stream<R: Read + Send>(
    mut input: R,
    map: &ColumnMap,
    conventions: Option<&Conventions>,
    threads: usize,
    mut progress: impl FnMut(u64),
) -> Result<Streamed, Error> {
    let mut pieces = Pieces::default();
    let Some(first) = pieces.next(&mut input)? else {
        return Err(Error::Header { expected: "the names of the columns" });
    };
    let map = &map.with_delimiter_of(&first);
    let mut reader = reader_of(map, first.as_slice());
    let mut header = ByteRecord::new();
    reader
        .read_byte_record(&mut header)
        .map_err(|_| Error::Header { expected: "the names of the columns" })?;
    let bound = Bound::new(map, &header)?;
    let rest =
        first[usize::try_from(reader.position().byte()).unwrap_or(first.len()).min(first.len())..].to_vec();
    let head_lines = reader.position().line();
    let conventions = conventions.unwrap_or(&bound.conventions).clone();
    let sequential = [Outliers::ThreeSd, Outliers::Mad].contains(&conventions.outliers)
        || conventions.axis == Axis::Serial;
    if sequential {
        return Err(Error::NotStreamed);
    }
    let mut sums = Sums::default();
    std::thread::scope(|scope| -> Result<(), Error> {
        let threads = threads.max(1);
        let (give, take) = sync_channel::<(u64, u64, Vec<u8>)>(1);
        let take = std::sync::Arc::new(Mutex::new(take));
        let (done, results) = sync_channel::<(u64, Result<Sums, Error>)>(threads + 1);
        for _ in 0..threads {
            let (take, done, bound, conventions) = (take.clone(), done.clone(), &bound, &conventions);
            scope.spawn(move || {
                loop {
                    // A poisoned lock means that another worker panicked, which the scope reports.
                    let Ok(Ok((number, line, piece))) = take.lock().map(|take| take.recv()) else { break };
                    let sums = summed(&piece, line, map, bound, conventions);
                    if done.send((number, sums)).is_err() {
                        break;
                    }
                }
            });
        }
        drop((done, take));
        let mut waiting: BTreeMap<u64, Result<Sums, Error>> = BTreeMap::new();
        let mut next = 0;
        let (mut number, mut bytes) = (0, 0u64);
        let mut line = head_lines;
        let mut piece = Some(rest);
        let mut collect =
            |sums: &mut Sums, (number, result): (u64, Result<Sums, Error>)| -> Result<(), Error> {
                waiting.insert(number, result);
                while let Some(result) = waiting.remove(&next) {
                    sums.merge(result?)?;
                    next += 1;
                }
                Ok(())
            };
        while let Some(text) = piece.take() {
            bytes += text.len() as u64;
            progress(bytes);
            let lines = memchr::memchr_iter(b'\n', &text).count() as u64;
            if give.send((number, line, text)).is_err() {
                break;
            }
            (number, line) = (number + 1, line + lines);
            while let Ok(result) = results.try_recv() {
                collect(&mut sums, result)?;
            }
            piece = pieces.next(&mut input)?;
        }
        drop(give);
        for result in results {
            collect(&mut sums, result)?;
        }
        Ok(())
    })?;
    if sums.rows == 0 {
        return Err(Error::Empty { what: "trials" });
    }
    // Sizes that are written differently may be the same.
    let mut named: BTreeMap<Key, One> = BTreeMap::new();
    for (key, one) in sums.sequences {
        let mut trial = Trial { amplitude: one.amplitude, width: one.width, ..Trial::default() };
        bound.name(&key, &mut trial);
        match named.entry(key_of(&trial)) {
            Entry::Vacant(entry) => drop(entry.insert(one)),
            Entry::Occupied(mut entry) => entry.get_mut().merge(one),
        }
    }
    let rows: Vec<Row> = named
        .into_iter()
        .map(|(key, one)| {
            let row = Row {
                key,
                amplitude: one.amplitude,
                width: one.width,
                path: one.paths.map_or_else(PathMeasures::default, |paths| {
                    PathMeasures::from_values(paths.map(|m| m.mean()))
                }),
                ..Row::default()
            };
            finished(row, &one.sequence, &conventions, bound.dimensions)
        })
        .collect();
    let mut warnings = bound.warnings(sums.absent);
    let times: Vec<f64> = rows.iter().filter_map(|row| row.ends.mt_s).collect();
    warnings.extend(super::time_slip(&times));
    let analysis = summarised(rows, &conventions, &bound.length_unit, bound.dimensions, sums.left);
    Ok(Streamed { analysis, warnings })
}

fn summed(
    piece: &[u8],
    first_line: u64,
    map: &ColumnMap,
    bound: &Bound,
    conventions: &Conventions,
) -> Result<Sums, Error> {
    let mut reader = reader_of(map, piece);
    let mut row = ByteRecord::new();
    let mut sums = Sums::default();
    let mut trial = Trial::default();
    let (mut key, mut sizes) = (Vec::new(), Sizes::default());
    loop {
        let line = first_line + reader.position().line() - 1;
        match reader.read_byte_record(&mut row) {
            Ok(true) => {}
            Ok(false) => return Ok(sums),
            Err(_) => return Err(Error::Xml { line, expected: "a row" }),
        }
        if !bound.fill(&row, line, &mut sizes, &mut trial)? {
            sums.absent += 1;
            continue;
        }
        sums.rows += 1;
        if !trial.counts() {
            sums.left.add(&trial);
            continue;
        }
        bound.key(&row, &mut key);
        let end = end_of(&trial, conventions, 0.0);
        let out = match conventions.outliers {
            Outliers::Spatial => is_spatial(&trial, end),
            Outliers::Temporal => trial.temporal_outlier == Some(true),
            Outliers::Misses => trial.error == Some(true),
            _ => false,
        };
        let one = sums.of(&key, &trial)?;
        one.sequence.count(trial.error);
        if out {
            one.sequence.outliers += 1;
            continue;
        }
        one.sequence.push(end, trial.mt_s);
        if let Some(path) = trial.measured.and_then(|_| of_path(&trial, conventions, bound.dimensions)) {
            let paths = one.paths.get_or_insert_with(Box::default);
            for (moments, value) in paths.iter_mut().zip(path.values()) {
                value.into_iter().for_each(|value| moments.push(value));
            }
        }
    }
}

/// Cuts a stream at line ends that are not inside quotes.
#[derive(Default)]
struct Pieces {
    rest: Vec<u8>,
    over: bool,
}

impl Pieces {
    /// The next piece; none after the last.
    fn next(&mut self, input: &mut impl Read) -> Result<Option<Vec<u8>>, Error> {
        if self.over {
            return Ok(None);
        }
        let mut piece = std::mem::take(&mut self.rest);
        piece.reserve(PIECE);
        let wanted = PIECE as u64;
        let read = input
            .by_ref()
            .take(wanted)
            .read_to_end(&mut piece)
            .map_err(|error| Error::Read(error.to_string()))?;
        if (read as u64) < wanted {
            self.over = true;
            return Ok((!piece.is_empty()).then_some(piece));
        }
        let mut quoted = false;
        let mut cut = None;
        if piece.contains(&b'"') {
            for (i, byte) in piece.iter().enumerate() {
                quoted ^= *byte == b'"';
                if *byte == b'\n' && !quoted {
                    cut = Some(i + 1);
                }
            }
        } else {
            cut = piece.iter().rposition(|byte| *byte == b'\n').map(|i| i + 1);
        }
        match cut {
            Some(cut) => {
                self.rest = piece.split_off(cut);
                Ok(Some(piece))
            }
            None => Err(Error::TooMany { what: "bytes in a line", most: PIECE }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::analyse;

    #[test]
    fn pieces_and_memory_agree() {
        // Long enough for three pieces; names in quotes with line ends inside.
        let mut text = String::from("participant,condition,mt_s,dx,dy,amplitude,width\n");
        for i in 0..80_000u32 {
            let noise = f64::from(i.wrapping_mul(2_654_435_761) >> 8) / 1e6;
            text += &format!(
                "\"P\n{}\",c{},{:.3},{:.4},{:.4},10,2\n",
                i % 7,
                i % 3,
                0.5 + noise / 40.0,
                noise / 10.0 - 0.8,
                noise / 20.0
            );
        }
        assert!(text.len() > 3 * PIECE - PIECE / 2);
        let map = ColumnMap::default();
        let whole = super::super::columns::read(&text, &map).unwrap();
        let whole = analyse(&whole.data, &whole.conventions);
        let one = stream(text.as_bytes(), &map, None, 1, |_| {}).unwrap().analysis;
        let three = stream(text.as_bytes(), &map, None, 3, |_| {}).unwrap().analysis;
        assert_eq!(one, three);
        assert_eq!(one.rows.len(), 21);
        for (a, b) in one.rows.iter().zip(&whole.rows) {
            assert_eq!((&a.key, a.n, a.errors), (&b.key, b.n, b.errors));
            assert!((a.ends.xy.tp.unwrap() - b.ends.xy.tp.unwrap()).abs() < 1e-10);
        }
    }

    #[test]
    fn instructions_factors_and_sizes_are_told_apart_in_memory_as_in_a_stream() {
        let mut text = String::from("participant,condition,hand,instruction,mt_s,dx,amplitude,width\n");
        for i in 0..960u32 {
            let noise = f64::from(i.wrapping_mul(2_654_435_761) >> 16) / 65_536.0 - 0.5;
            let (told, hand, size) = (i % 2, i / 2 % 2, i / 4 % 2);
            text += &format!(
                "P{},mouse,{},{},{},{},{},20\n",
                i / 8 % 2,
                ["left", "right"][hand as usize],
                ["fast", "slow"][told as usize],
                0.5 + f64::from(told) + 0.1 * noise,
                (1.0 + f64::from(1 - told)) * noise,
                // The same size, written in two ways.
                ["100", "100.00000001", "200", "200.0"][(2 * size + i / 16 % 2) as usize]
            );
        }
        let map = ColumnMap::parse("m".as_ref(), "[factors]\nhand = \"hand\"").unwrap();
        let whole = super::super::columns::read(&text, &map).unwrap();
        let whole = analyse(&whole.data, &whole.conventions);
        let streamed = stream(text.as_bytes(), &map, None, 2, |_| {}).unwrap().analysis;
        assert_eq!((whole.rows.len(), streamed.rows.len()), (16, 16));
        for (a, b) in whole.rows.iter().zip(&streamed.rows) {
            assert_eq!((&a.key, a.n), (&b.key, 60));
            assert!((a.ends.x.tp.unwrap() - b.ends.x.tp.unwrap()).abs() < 1e-10);
        }
        let levels = whole.stability.unwrap().levels;
        assert_eq!(levels.iter().map(|level| level.name.as_str()).collect::<Vec<_>>(), ["fast", "slow"]);
        assert!(levels[0].sd.unwrap() > 1.9 * levels[1].sd.unwrap());
    }

    #[test]
    fn without_an_amplitude_there_is_no_throughput() {
        let mut text = String::from("participant,mt_s,dx\n");
        (0..20).for_each(|i| text += &format!("P1,0.5,{}\n", i % 5));
        let map = ColumnMap::default();
        let memory = super::super::columns::read(&text, &map).unwrap();
        let streamed = stream(text.as_bytes(), &map, None, 1, |_| {}).unwrap();
        for (analysis, warnings) in [
            (analyse(&memory.data, &memory.conventions), memory.warnings),
            (streamed.analysis, streamed.warnings),
        ] {
            let ends = analysis.rows[0].ends;
            assert_eq!((ends.x.amplitude, ends.x.ide, ends.x.tp), (None, None, None));
            assert!(ends.x.sd.unwrap() > 1.0 && ends.x.we.is_some());
            assert!(warnings[0].contains("no column is the amplitude"), "{warnings:?}");
        }
    }

    #[test]
    fn damage_is_named_with_its_line() {
        let map = ColumnMap::default();
        let table = |bad: &str| format!("participant,mt_s,dx\nP1,0.5,1\n{bad}\nP1,0.5,2\n");
        let error = |bad: &str| stream(table(bad).as_bytes(), &map, None, 2, |_| {}).unwrap_err().to_string();
        assert_eq!(error("P1,x,1"), "line 3, column \"mt_s\": expected a finite number, found \"x\"");
        assert_eq!(error("P1,1"), "line 3: expected 3 cells, found 2");
        assert_eq!(error("P1,-0.5,1"), "line 3, column \"mt_s\": expected a time above zero, found \"-0.5\"");
        assert!(stream("".as_bytes(), &map, None, 2, |_| {}).is_err());
        let sequential = Conventions { outliers: Outliers::ThreeSd, ..Conventions::default() };
        assert_eq!(
            stream(table("P1,1,1").as_bytes(), &map, Some(&sequential), 2, |_| {}),
            Err(Error::NotStreamed)
        );
    }
}
