//! Where samples come from: a text recording, or a stream of a session's log.

use std::path::{Path, PathBuf};

use vergence_inertial::Recording;
use vergence_log::Reader;
use vergence_sense::Imu;

use crate::failure::Failure;

/// Refuses an output that is one of the inputs, or the table of an input that is EuRoC's folder.
pub fn check_out(out: &Path, inputs: &[Option<&PathBuf>]) -> Result<(), Failure> {
    let read: Vec<PathBuf> =
        inputs.iter().copied().flatten().flat_map(|input| [input.clone(), input.join("data.csv")]).collect();
    Failure::unless_own("--out", out, &read)
}

/// Reads the recording at `path`: a session's log where it ends with `.mcap`, from the stream `stream` or the only one of an
/// inertial unit; else text.
pub fn read(path: &Path, stream: Option<&str>) -> Result<Recording, Failure> {
    if path.extension().is_none_or(|extension| extension != "mcap") {
        if let Some(stream) = stream {
            return Err(Failure::Call(format!(
                "{}: expected a session's log (.mcap) to take the stream {stream} from",
                path.display()
            )));
        }
        let recording = Recording::read(path).map_err(|error| Failure::work(&error))?;
        let place = path.display();
        if !recording.ignored.is_empty() {
            log::warn!("{place}: nothing is made of the columns {}", recording.ignored.join(", "));
        }
        if recording.repeated > 0 {
            log::warn!("{place}: {} rows have the time of the row before: left out", recording.repeated);
        }
        return Ok(recording);
    }
    let failed = |error: vergence_log::Error| Failure::work(&error);
    let mut reader = Reader::open(path).map_err(failed)?;
    let mut recording = Recording::default();
    let mut chosen = stream.map(str::to_owned);
    while let Some(entry) = reader.next().map_err(failed)? {
        let name = &entry.stream.name;
        match &chosen {
            Some(chosen) if chosen != name => {
                if stream.is_none() && entry.is::<Imu>() {
                    return Err(Failure::Call(format!(
                        "{}: expected one stream of an inertial unit, found {chosen} and {name}: choose with --stream",
                        path.display()
                    )));
                }
                continue;
            }
            None if !entry.is::<Imu>() => continue,
            None => chosen = Some(name.clone()),
            Some(_) => {}
        }
        let sample = entry.decode::<Imu>().map_err(failed)?;
        recording.samples.push((sample.captured, sample.value));
    }
    if recording.samples.len() < 2 {
        let names: Vec<&str> = reader.streams().map(|info| info.name.as_str()).collect();
        return Err(Failure::Work(format!(
            "{}: expected two samples or more of {}, found {} in the streams {}",
            path.display(),
            chosen.as_deref().unwrap_or("an inertial unit"),
            recording.samples.len(),
            names.join(", ")
        )));
    }
    Ok(recording)
}
