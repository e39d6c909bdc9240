use std::io::Write;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use vergence_sense::Imu;
use vergence_time::{Span, Timestamp};

use super::table::Table;
use super::{Recording, Truth};
use crate::{Error, Unit};

/// What the column of times may be called, one of them, and its seconds.
const TIMES: [(&str, f64); 4] = [("t_s", 1.0), ("t_ms", 1e-3), ("t_us", 1e-6), ("t_ns", 1e-9)];
/// Columns that must be there, in any order.
const NEEDED: [&str; 6] = ["gyr_x", "gyr_y", "gyr_z", "acc_x", "acc_y", "acc_z"];
const MAG: [&str; 3] = ["mag_x", "mag_y", "mag_z"];
const TRUTH: [&str; 4] = ["gt_qw", "gt_qx", "gt_qy", "gt_qz"];
const POSITION: [&str; 3] = ["gt_px", "gt_py", "gt_pz"];

/// Where columns of these names stand; `None` where none of them is there.
fn places<const N: usize>(table: &Table, names: [&str; N]) -> Result<Option<[usize; N]>, Error> {
    let mut places = [0; N];
    let mut found = 0;
    for (place, name) in places.iter_mut().zip(names) {
        if let Some(index) = table.header().iter().position(|column| column == name) {
            *place = index;
            found += 1;
        }
    }
    if found == 0 {
        return Ok(None);
    }
    match names.iter().find(|name| !table.header().iter().any(|column| column == *name)) {
        Some(missing) => {
            let column = table.header().len();
            Err(table.content(
                1,
                column,
                &format!("a column '{missing}'"),
                format!("'{}'", table.header().join(",")),
            ))
        }
        None => Ok(Some(places)),
    }
}

/// The instant of a time in seconds.
fn instant(table: &Table, t_s: f64, column: usize) -> Result<Timestamp, Error> {
    let span = Span::from_secs_f64(t_s);
    let span = span.ok_or_else(|| table.content(table.line(), column, "a time in seconds", t_s))?;
    Ok(Timestamp::from_nanos(span.as_nanos()))
}

/// Whether an instant is later than the one before; one that is earlier is an error.
fn is_later(table: &Table, at: Timestamp, column: usize, before: Option<Timestamp>) -> Result<bool, Error> {
    let seconds = |at: Timestamp| at.as_nanos() as f64 * 1e-9;
    match before {
        Some(before) if at < before => {
            let expected = format!("a time after {} s", seconds(before));
            Err(table.content(table.line(), column, &expected, format!("{} s", seconds(at))))
        }
        before => Ok(before != Some(at)),
    }
}

pub(super) fn read(table: &mut Table) -> Result<Recording, Error> {
    let time = TIMES.into_iter().find_map(|(name, seconds)| {
        let place = table.header().iter().position(|column| column == name)?;
        Some((place, seconds))
    });
    let (Some((time, seconds)), Some(needed)) = (time, places(table, NEEDED)?) else {
        let expected = "columns t_s (or t_ms, t_us, t_ns), gyr_x to gyr_z in rad/s and acc_x to acc_z in m/s² (or a EuRoC header '#timestamp [ns],…')";
        return Err(table.content(1, 1, expected, format!("'{}'", table.header().join(","))));
    };
    let mut recording = Recording::default();
    let known = [&NEEDED[..], &TIMES.map(|(name, _)| name), &MAG, &TRUTH, &POSITION, &["movement"]].concat();
    for (index, name) in table.header().iter().enumerate() {
        if table.header()[..index].contains(name) {
            return Err(table.content(1, index + 1, "each column once", format!("'{name}' a second time")));
        }
        if !known.contains(&name.as_str()) {
            recording.ignored.push(name.clone());
        }
    }
    if seconds == 1.0 && recording.ignored.is_empty() {
        recording.unit = Unit::Broad;
    }
    let mag = places(table, MAG)?;
    let truth = places(table, TRUTH)?;
    let position = places(table, POSITION)?;
    let movement = places(table, ["movement"])?;
    let mut values = Vec::new();
    let mut last = None;
    let mut backwards = None;
    loop {
        let mut nanos = None;
        if !table.row(&mut values, |text| nanos = text.parse().ok().map(Timestamp::from_nanos))? {
            // A pair that was swapped on its way is no reason to refuse all others; a clock that was set is.
            let few = recording.reversed * 100 <= recording.samples.len() as u64;
            return match backwards.filter(|_| !few) {
                Some(error) => Err(error),
                None => Ok(recording),
            };
        }
        // Nanoseconds since 1970 have more digits than a float.
        let at = match nanos.filter(|_| time == 0 && seconds == 1e-9) {
            Some(at) => at,
            None => instant(table, values[time] * seconds, time + 1)?,
        };
        match is_later(table, at, time + 1, last) {
            Ok(true) => {}
            Ok(false) => {
                recording.repeated += 1;
                continue;
            }
            Err(error) => {
                recording.reversed += 1;
                backwards.get_or_insert(error);
                continue;
            }
        }
        last = Some(at);
        let vector = |[x, y, z]: [usize; 3]| Vector3::new(values[x], values[y], values[z]);
        let imu = Imu {
            gyr_rad_s: vector([needed[0], needed[1], needed[2]]),
            acc_m_s2: vector([needed[3], needed[4], needed[5]]),
            mag_ut: mag.map(vector),
        };
        recording.samples.push((at, imu));
        if let Some([w, x, y, z]) = truth {
            let q = Quaternion::new(values[w], values[x], values[y], values[z]);
            // NaN is where the cameras lost the board, or a marker that its orientation needs.
            let earth_from_sensor =
                UnitQuaternion::try_new(q, 1e-6).filter(|q| q.coords.iter().all(|v| v.is_finite()));
            recording.truth.push(Truth {
                earth_from_sensor,
                as_written: earth_from_sensor.map(|_| q),
                position_m: position.map(vector).filter(|p| p.iter().all(|v| v.is_finite())),
                movement: movement.is_none_or(|[place]| values[place] != 0.0),
            });
        }
    }
}

/// Reads `t_s,qw,qx,qy,qz`: orientations that take sensor-frame vectors to the earth frame.
///
/// # Errors
/// File, line and column of the first fault.
pub fn read_orientations(path: &Path) -> Result<Vec<(Timestamp, UnitQuaternion<f64>)>, Error> {
    let mut table = Table::open(path)?;
    if table.header() != ["t_s", "qw", "qx", "qy", "qz"] {
        return Err(table.content(
            1,
            1,
            "the header 't_s,qw,qx,qy,qz'",
            format!("'{}'", table.header().join(",")),
        ));
    }
    let (mut all, mut values, mut last) = (Vec::new(), Vec::new(), None);
    while table.row(&mut values, |_| {})? {
        let at = instant(&table, values[0], 1)?;
        if !is_later(&table, at, 1, last)? {
            return Err(table.content(
                table.line(),
                1,
                "each time once",
                format!("{} s a second time", values[0]),
            ));
        }
        last = Some(at);
        let q = Quaternion::new(values[1], values[2], values[3], values[4]);
        let Some(q) = UnitQuaternion::try_new(q, 1e-6).filter(|q| q.coords.iter().all(|v| v.is_finite()))
        else {
            let found = values[1..5].iter().map(f64::to_string).collect::<Vec<_>>().join(",");
            return Err(table.content(
                table.line(),
                2,
                "a quaternion of four finite numbers, not all zero",
                found,
            ));
        };
        all.push((at, q));
    }
    Ok(all)
}

/// Writes `t_s,qw,qx,qy,qz`, with times to the nanosecond.
///
/// # Errors
/// Those of `out`.
pub fn write_orientations(
    mut out: impl Write,
    rows: impl Iterator<Item = (Timestamp, UnitQuaternion<f64>)>,
) -> std::io::Result<()> {
    writeln!(out, "t_s,qw,qx,qy,qz")?;
    for (at, q) in rows {
        let nanos = at.as_nanos();
        let sign = if nanos < 0 { "-" } else { "" };
        let (whole, part) = (nanos.unsigned_abs() / 1_000_000_000, nanos.unsigned_abs() % 1_000_000_000);
        writeln!(out, "{sign}{whole}.{part:09},{:.12},{:.12},{:.12},{:.12}", q.w, q.i, q.j, q.k)?;
    }
    out.flush()
}
