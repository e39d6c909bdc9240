use nalgebra::Vector3;
use vergence_sense::Imu;
use vergence_time::Timestamp;

use super::Recording;
use super::table::Table;
use crate::Error;

/// EuRoC's columns after the time, by their first words.
const COLUMNS: [&str; 6] = ["w_RS_S_x", "w_RS_S_y", "w_RS_S_z", "a_RS_S_x", "a_RS_S_y", "a_RS_S_z"];

pub(super) fn read(table: &mut Table) -> Result<Recording, Error> {
    for (index, name) in COLUMNS.into_iter().enumerate() {
        let found = table.header().get(index + 1).map_or("nothing", String::as_str);
        if !found.starts_with(name) {
            return Err(table.content(1, index + 2, &format!("'{name}'"), format!("'{found}'")));
        }
    }
    if let Some(extra) = table.header().get(7) {
        return Err(table.content(1, 8, "seven columns", format!("'{extra}'")));
    }
    let mut recording = Recording::default();
    let mut values = Vec::new();
    let mut last: Option<Timestamp> = None;
    loop {
        // Whole nanoseconds since 1970 have more digits than a float.
        let mut nanos = None;
        if !table.row(&mut values, |text| nanos = text.parse::<i64>().ok())? {
            return Ok(recording);
        }
        let Some(at) = nanos.map(Timestamp::from_nanos) else {
            return Err(table.content(table.line(), 1, "whole nanoseconds", values[0]));
        };
        if let Some(last) = last.filter(|last| at <= *last) {
            let expected = format!("a time after {} ns", last.as_nanos());
            return Err(table.content(table.line(), 1, &expected, format!("{} ns", at.as_nanos())));
        }
        last = Some(at);
        recording.samples.push((
            at,
            Imu {
                gyr_rad_s: Vector3::new(values[1], values[2], values[3]),
                acc_m_s2: Vector3::new(values[4], values[5], values[6]),
                mag_ut: None,
            },
        ));
    }
}
