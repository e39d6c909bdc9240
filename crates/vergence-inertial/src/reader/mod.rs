//! Recordings of inertial units and orientation estimates, from text files.

mod broad;
mod euroc;
mod table;
mod tum;

use std::path::{Path, PathBuf};

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use vergence_sense::Imu;
use vergence_time::{Span, Timestamp};

use crate::{Error, Pair, Unit};
use table::Table;

pub use broad::{read_orientations, write_orientations};
pub use tum::read_tum_orientations;

/// What one file holds.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// The samples, in order of time.
    pub samples: Vec<(Timestamp, Imu)>,
    /// Truth for each sample, or nothing for none of them.
    pub truth: Vec<Truth>,
    /// The unit that recorded: that of BROAD where the table is of BROAD's style, else unknown.
    pub unit: Unit,
    /// Columns of the table that nothing is made of.
    pub ignored: Vec<String>,
    /// Rows that were left out, because their time was that of the row before.
    pub repeated: u64,
    /// Rows that were left out, because their time was before that of a row above: at most one in a hundred.
    pub reversed: u64,
}

/// What the cameras saw at one sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// The true orientation in the ENU earth frame, where it was seen.
    pub earth_from_sensor: Option<UnitQuaternion<f64>>,
    /// The same with the digits of the file, whose length is 1 only as far as these go.
    pub as_written: Option<Quaternion<f64>>,
    /// The true position in the ENU earth frame, metres, where it was seen; also where the orientation was not.
    pub position_m: Option<Vector3<f64>>,
    /// Whether this sample is scored.
    pub movement: bool,
}

/// The lowest and highest median rate that a recording may have, hertz: below it orientation cannot be followed, above it the
/// times are in another unit.
pub const RATES_HZ: (f64, f64) = (5.0, 50_000.0);

/// The table of a recording: the file itself, or that of EuRoC's folders.
fn table_of(path: &Path) -> Result<PathBuf, Error> {
    const INSIDE: [&str; 3] = ["data.csv", "imu0/data.csv", "mav0/imu0/data.csv"];
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    INSIDE.into_iter().map(|inner| path.join(inner)).find(|inner| inner.is_file()).ok_or_else(|| {
        Error::Mismatch {
            path: path.to_owned(),
            expected: format!("a folder with {}", INSIDE.join(", or ")),
            found: "none of them".to_owned(),
        }
    })
}

impl Recording {
    /// Reads a recording: a table `t_s,gyr_x,…,acc_z[,mag_x,…][,gt_qw,…][,gt_px,…][,movement]` (rad/s, m/s², µT; BROAD's style; also `t_ms`, `t_us` or
    /// `t_ns`, between commas, semicolons or tabs, columns in any order among others, empty cells for NaN) or
    /// EuRoC's `imu0/data.csv` (or its folder, or one of the two around that: `mav0`, and what has it in it), each also compressed by gzip.
    ///
    /// # Errors
    /// File, line and column of the first fault: missing columns, numbers that are none, time that goes back in more than one row of a hundred,
    /// times of batches, truncated compression, a rate outside of [`RATES_HZ`].
    pub fn read(path: &Path) -> Result<Self, Error> {
        let mut table = Table::open(&table_of(path)?)?;
        let recording = if table.header().first().is_some_and(|name| name.starts_with("#timestamp")) {
            euroc::read(&mut table)?
        } else {
            broad::read(&mut table)?
        };
        let last_line = table.line();
        let Some(period) = recording.period() else {
            return Err(table.content(last_line, 1, "two samples or more", recording.samples.len()));
        };
        let rate_hz = 1.0 / period.as_secs_f64();
        if !(RATES_HZ.0..=RATES_HZ.1).contains(&rate_hz) {
            let whole = recording.samples.last().and_then(|(last, _)| last.since(recording.samples[0].0));
            let mean_hz = (recording.samples.len() - 1) as f64 / whole.map_or(f64::NAN, Span::as_secs_f64);
            if rate_hz > RATES_HZ.1 && mean_hz <= RATES_HZ.1 / 10.0 {
                let expected = "the times at which samples were taken (of the unit's own clock)";
                let found = format!(
                    "batches: most samples are {:.4} ms after the one before, {mean_hz:.1} come in a second",
                    period.as_millis_f64()
                );
                return Err(table.content(last_line, 1, expected, found));
            }
            let expected = format!("a median rate of {} to {} Hz", RATES_HZ.0, RATES_HZ.1);
            return Err(table.content(last_line, 1, &expected, format!("{rate_hz:.3} Hz")));
        }
        Ok(recording)
    }

    /// The median time between samples; `None` where there are fewer than two.
    pub fn period(&self) -> Option<Span> {
        let mut steps: Vec<i64> = self
            .samples
            .windows(2)
            .map(|pair| pair[1].0.as_nanos().saturating_sub(pair[0].0.as_nanos()))
            .collect();
        let middle = steps.len() / 2;
        (!steps.is_empty()).then(|| Span::from_nanos(*steps.select_nth_unstable(middle).1))
    }

    /// Pairs of estimate and truth at the samples that are scored: in movement and seen by the cameras. `estimate` comes from
    /// the file `path` and has one row for each sample, at the same times to a microsecond.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where the rows do not correspond, or this recording has no truth.
    pub fn scored(
        &self,
        estimate: &[(Timestamp, UnitQuaternion<f64>)],
        path: &Path,
    ) -> Result<Vec<Pair>, Error> {
        let mismatch =
            |expected: String, found: String| Error::Mismatch { path: path.to_owned(), expected, found };
        if self.truth.is_empty() {
            return Err(mismatch(
                "a truth with columns gt_qw,gt_qx,gt_qy,gt_qz".to_owned(),
                "none".to_owned(),
            ));
        }
        if estimate.len() != self.samples.len() {
            return Err(mismatch(format!("{} rows", self.samples.len()), format!("{} rows", estimate.len())));
        }
        let mut pairs = Vec::new();
        for (row, ((at, q), ((expected, _), truth))) in
            estimate.iter().zip(self.samples.iter().zip(&self.truth)).enumerate()
        {
            if at.as_nanos().abs_diff(expected.as_nanos()) > 1000 {
                let seconds = |at: &Timestamp| at.as_nanos() as f64 * 1e-9;
                let line = row + 2;
                return Err(mismatch(
                    format!("the time {} s in line {line}", seconds(expected)),
                    format!("{} s", seconds(at)),
                ));
            }
            if let Some(truth) = truth.earth_from_sensor.filter(|_| truth.movement) {
                pairs.push((*at, *q, truth));
            }
        }
        Ok(pairs)
    }

    /// Whether any sample has a magnetic field.
    pub fn has_mag(&self) -> bool {
        self.samples.iter().any(|(_, imu)| imu.mag_ut.is_some())
    }
}
