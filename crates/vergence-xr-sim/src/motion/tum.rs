use std::path::Path;

use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use vergence_geom::Rigid;
use vergence_time::Timestamp;

use super::Sample;
use crate::Error;

/// Largest trajectory that is read, in bytes: three hours at 1 kHz.
pub const MAX_TRAJECTORY_BYTES: u64 = 1 << 30;

/// How far the norm of a quaternion may be from 1: files carry six decimals.
const NORM_TOLERANCE: f64 = 1e-3;

/// Reads a trajectory in the TUM format: lines of `time_s x y z qx qy qz qw`, `#` starts a comment.
///
/// # Errors
/// Where the file cannot be read or a line is wrong (see [`parse_tum`]).
pub fn read_tum(path: &Path) -> Result<Vec<Sample>, Error> {
    let failed = |source| Error::Trajectory { path: path.to_owned(), source, hint: String::new() };
    let found = std::fs::metadata(path).map_err(failed)?.len();
    if found > MAX_TRAJECTORY_BYTES {
        let message = format!("expected at most {MAX_TRAJECTORY_BYTES} bytes, found {found}");
        return Err(failed(std::io::Error::new(std::io::ErrorKind::FileTooLarge, message)));
    }
    parse_tum(path, &std::fs::read_to_string(path).map_err(failed)?)
}

/// Parses a trajectory in the TUM format, naming `path` in errors.
///
/// Times are kept to the nanosecond (decimal arithmetic: a Unix time in `f64` would be off by 200 ns). Poses are
/// given as they are in the file: `world_from_body`, whatever the axes of either. Quaternions are normalised.
///
/// # Errors
/// Where a line does not have eight finite numbers, a quaternion is not of unit length within 1e-3, times do not
/// rise strictly, or there is no pose at all.
pub fn parse_tum(path: &Path, text: &str) -> Result<Vec<Sample>, Error> {
    let mut samples: Vec<Sample> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let wrong = |expected, found: &str| Error::Tum {
            path: path.to_owned(),
            line: index + 1,
            expected,
            found: shorten(found),
        };
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let mut words = line.split_whitespace();
        let time = words.next().unwrap_or_default();
        let at = Timestamp::from_decimal(time, 9).ok_or_else(|| wrong("a time in seconds", time))?;
        let mut numbers = [0.0; 7];
        for number in &mut numbers {
            let word = words.next().ok_or_else(|| wrong("eight numbers: t x y z qx qy qz qw", line))?;
            *number = word
                .parse::<f64>()
                .ok()
                .filter(|n| n.is_finite())
                .ok_or_else(|| wrong("a finite number", word))?;
        }
        if words.next().is_some() {
            return Err(wrong("eight numbers: t x y z qx qy qz qw", line));
        }
        let [x, y, z, i, j, k, w] = numbers;
        let quaternion = Quaternion::new(w, i, j, k);
        if (quaternion.norm() - 1.0).abs() > NORM_TOLERANCE {
            return Err(wrong("a quaternion of length 1", line));
        }
        if samples.last().is_some_and(|last| last.at >= at) {
            return Err(wrong("a time later than that of the line before", time));
        }
        let pose = Rigid::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_normalize(quaternion));
        samples.push(Sample { at, world_from_body: pose });
    }
    if samples.is_empty() {
        let line = text.lines().count().max(1);
        let path = path.to_owned();
        return Err(Error::Tum {
            path,
            line,
            expected: "at least one pose",
            found: "the end of the file".into(),
        });
    }
    Ok(samples)
}

fn shorten(text: &str) -> String {
    let short: String = text.chars().take(60).collect();
    if short.len() < text.len() { format!("\"{short}…\"") } else { format!("\"{short}\"") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_keep_their_nanoseconds() {
        let samples = parse_tum(
            Path::new("t"),
            "# c\n1520530308.18968 1 2 3 0 0 0 1 # tail\n\n1520530308.189680001 1 2 3 0 0 0 -1\n",
        )
        .unwrap();
        assert_eq!(samples[0].at.as_nanos(), 1_520_530_308_189_680_000);
        assert_eq!(samples[1].at.as_nanos(), 1_520_530_308_189_680_001);
        for (word, nanos) in [
            ("-0.5", -500_000_000),
            ("1.0000000005", 1_000_000_001),
            ("2.5e-1", 250_000_000),
            (".25", 250_000_000),
        ] {
            assert_eq!(Timestamp::from_decimal(word, 9), Some(Timestamp::from_nanos(nanos)), "{word}");
        }
    }

    #[test]
    fn what_is_wrong_is_named_with_file_and_line() {
        let good = "0 0 0 0 0 0 0 1\n";
        for (text, said) in [
            ("1 2 3\n", "a.txt:2: expected eight numbers"),
            ("1 0 0 0 0 0 0 1 9\n", "a.txt:2: expected eight numbers"),
            ("x 0 0 0 0 0 0 1\n", "a.txt:2: expected a time in seconds, found \"x\""),
            ("1 0 0 NaN 0 0 0 1\n", "a.txt:2: expected a finite number, found \"NaN\""),
            ("1 0 0 0 0 0 0 2\n", "a.txt:2: expected a quaternion of length 1"),
            ("0 0 0 0 0 0 0 1\n", "a.txt:2: expected a time later"),
            ("99999999999999999999 0 0 0 0 0 0 1\n", "a.txt:2: expected a time in seconds"),
        ] {
            let error = parse_tum(Path::new("a.txt"), &format!("{good}{text}")).unwrap_err().to_string();
            assert!(error.starts_with(said), "{error}");
        }
        let empty = parse_tum(Path::new("a.txt"), "# nothing\n").unwrap_err().to_string();
        assert_eq!(empty, "a.txt:1: expected at least one pose, found the end of the file");
    }
}
