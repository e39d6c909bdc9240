use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion};
use vergence_time::{Span, Timestamp};

use crate::Error;

/// Largest file that is read, bytes.
const MOST_BYTES: u64 = 256 << 20;

/// Reads orientations from a trajectory in the TUM format: lines `t x y z qx qy qz qw` (seconds; the world has z up), `#`
/// begins a comment.
///
/// # Errors
/// File, line and column of the first fault: a number that is none, too few or too many of them, time that does not grow, a
/// quaternion that is not of unit length.
pub fn read_tum_orientations(path: &Path) -> Result<Vec<(Timestamp, UnitQuaternion<f64>)>, Error> {
    let read = |source| Error::Read { path: path.to_owned(), source };
    let bytes = std::fs::metadata(path).map_err(read)?.len();
    if bytes > MOST_BYTES {
        return Err(read(std::io::Error::other(format!(
            "expected at most {MOST_BYTES} bytes, found {bytes}"
        ))));
    }
    let text = std::fs::read_to_string(path).map_err(read)?;
    let mut all: Vec<(Timestamp, UnitQuaternion<f64>)> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let content = |column: usize, expected: &str, found: &str| Error::Content {
            path: path.to_owned(),
            line: index as u64 + 1,
            column,
            expected: expected.to_owned(),
            found: found.to_owned(),
        };
        if line.trim().is_empty() || line.trim_start().starts_with('#') {
            continue;
        }
        let mut values = [0.0; 8];
        let mut count = 0;
        for word in line.split_whitespace() {
            let Some(place) = values.get_mut(count) else {
                return Err(content(9, "eight numbers", "more"));
            };
            count += 1;
            let number = word.parse::<f64>().ok().filter(|value| value.is_finite());
            *place = number.ok_or_else(|| content(count, "a finite number", word))?;
        }
        if count < 8 {
            return Err(content(count.max(1), "eight numbers", &format!("{count}")));
        }
        let [t_s, _, _, _, x, y, z, w] = values;
        let time = Span::from_secs_f64(t_s).map(|span| Timestamp::from_nanos(span.as_nanos()));
        let time = time.ok_or_else(|| content(1, "a time in seconds", &t_s.to_string()))?;
        if all.last().is_some_and(|(last, _)| time <= *last) {
            return Err(content(1, "a time that grows", &t_s.to_string()));
        }
        let q = Quaternion::new(w, x, y, z);
        if (q.norm() - 1.0).abs() > 0.01 {
            return Err(content(5, "a quaternion of unit length", &format!("length {}", q.norm())));
        }
        all.push((time, UnitQuaternion::new_normalize(q)));
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<(Timestamp, UnitQuaternion<f64>)>, Error> {
        static FILES: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
        let number = FILES.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("vergence-tum-{}-{number}.txt", std::process::id()));
        std::fs::write(&path, text).unwrap();
        let result = read_tum_orientations(&path);
        std::fs::remove_file(&path).unwrap();
        result
    }

    #[test]
    fn lines_become_orientations_and_faults_are_named() {
        let good = read("# t x y z\n1.5 0 0 0 0 0 0.6 0.8\n\n2 1 2 3 0 0 0 1\n").unwrap();
        assert_eq!(good[0].0, Timestamp::from_nanos(1_500_000_000));
        assert!((good[0].1.k - 0.6).abs() < 1e-15 && good.len() == 2);
        for (text, place) in [
            ("1 0 0 0 0 0 x 1\n", ":1:7: expected a finite number, found x"),
            ("1 0 0\n", ":1:3: expected eight numbers, found 3"),
            ("1 0 0 0 0 0 0 1 9\n", ":1:9: expected eight numbers, found more"),
            ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", ":2:1: expected a time that grows"),
            ("1 0 0 0 0 0 0 2\n", ":1:5: expected a quaternion of unit length"),
            ("NaN 0 0 0 0 0 0 1\n", ":1:1: expected a finite number"),
            ("1e300 0 0 0 0 0 0 1\n", ":1:1: expected a time in seconds"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(place), "{text}: {error}");
        }
    }
}
