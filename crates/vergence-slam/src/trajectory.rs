//! Poses over time, and the text files that hold them.

use std::io::Write;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion};
use vergence_geom::{Rigid, components};
use vergence_time::{Span, Timestamp};

use crate::Error;

/// Largest text file that is read, bytes.
pub(crate) const MOST_BYTES: u64 = 1 << 30;
/// A whole number from here on is no time in seconds.
const LEAST_NANOS: i64 = 100_000_000_000_000_000;

/// Poses of one body, each later than the one before: `world_from_body`, metres. The world is the file's own (EuRoC and TUM: z up).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// When, and where.
    pub poses: Vec<(Timestamp, Rigid)>,
}

/// How a file says rotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rotations {
    /// Not at all: positions alone.
    None,
    /// As quaternions x y z w (TUM).
    ScalarLast,
    /// As quaternions w x y z (EuRoC).
    ScalarFirst,
}

pub(crate) fn read_text(path: &Path) -> Result<String, Error> {
    let bytes = std::fs::metadata(path).map_err(Error::read(path))?.len();
    if bytes > MOST_BYTES {
        return Err(Error::file(path, format!("at most {MOST_BYTES} bytes"), bytes.to_string()));
    }
    if bytes == 0 {
        return Err(Error::file(path, "a file with something in it", "0 bytes"));
    }
    std::fs::read_to_string(path).map_err(Error::read(path))
}

impl Trajectory {
    /// Reads TUM's format (`t x y z qx qy qz qw`) or EuRoC's truth (`#timestamp,…`: nanoseconds, then position and quaternion w x y z); `#`
    /// begins a comment. With spaces, times are seconds, or whole nanoseconds from 1e17 on (1973). With commas, they are whole
    /// nanoseconds in EuRoC's order; where any of them has a decimal point, all are seconds in TUM's order.
    ///
    /// # Errors
    /// File, line and word of the first fault: a number that is none, too few or too many, time that does not grow, a quaternion
    /// that is not of unit length; no poses.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::parse(&read_text(path)?, path)
    }

    /// As [`Trajectory::read`]; a file may say positions only (`t x y z`, as a laser tracker does): then rotations are
    /// [`Rotations::None`], and those of the poses mean nothing.
    ///
    /// # Errors
    /// Those of [`Trajectory::read`]; lines of both kinds.
    pub fn read_places(path: &Path) -> Result<(Self, Rotations), Error> {
        Self::parse_with(&read_text(path)?, path, UnitQuaternion::new_normalize, true)
    }

    /// Reads the same from `text`, and keeps the numbers of each quaternion as they are written: their length is 1 only as far as their
    /// digits go. For writing them elsewhere, not for reckoning with them. Errors begin with `path`.
    ///
    /// # Errors
    /// Those of [`Trajectory::read`].
    pub fn parse_as_written(text: &str, path: &Path) -> Result<Self, Error> {
        Self::parse_with(text, path, UnitQuaternion::new_unchecked, false).map(|(poses, _)| poses)
    }

    pub(crate) fn parse(text: &str, path: &Path) -> Result<Self, Error> {
        Self::parse_with(text, path, UnitQuaternion::new_normalize, false).map(|(poses, _)| poses)
    }

    /// With `places`, lines may end behind the position.
    fn parse_with(
        text: &str,
        path: &Path,
        rotation_of: fn(Quaternion<f64>) -> UnitQuaternion<f64>,
        places: bool,
    ) -> Result<(Self, Rotations), Error> {
        let mut poses: Vec<(Timestamp, Rigid)> = Vec::new();
        let mut rotations = Rotations::ScalarLast;
        let lines =
            || text.lines().map(str::trim).enumerate().filter(|l| !l.1.is_empty() && !l.1.starts_with('#'));
        let seconds =
            lines().any(|(_, line)| line.split_once(',').is_some_and(|(time, _)| time.contains('.')));
        for (index, content) in lines() {
            let wrong = |word: usize, expected: &str, found: &str| {
                let found: String = found.chars().take(40).collect();
                Error::content(path, (index + 1, word), expected, found)
            };
            let commas = content.contains(',');
            let euroc = commas && !seconds;
            let mut words = content
                .split(|c: char| if commas { c == ',' } else { c.is_whitespace() })
                .map(str::trim)
                .filter(|word| !word.is_empty());
            let first = words.next().unwrap_or_default();
            let whole = first.parse::<i64>().ok().filter(|nanos| euroc || *nanos >= LEAST_NANOS);
            let at = match whole {
                Some(nanos) => Some(Timestamp::from_nanos(nanos)),
                None if euroc => None,
                None => Timestamp::from_decimal(first, 9),
            };
            let expected = if euroc { "whole nanoseconds" } else { "a time in seconds" };
            let at = at.ok_or_else(|| wrong(1, expected, first))?;
            let mut values = [0.0; 7];
            let mut count = 0;
            for word in words {
                let Some(value) = values.get_mut(count) else {
                    if commas {
                        break;
                    }
                    return Err(wrong(9, "eight numbers", "more"));
                };
                count += 1;
                let number = word.parse::<f64>().ok().filter(|x| x.is_finite());
                *value = number.ok_or_else(|| wrong(count + 1, "a finite number", word))?;
            }
            if poses.is_empty() {
                rotations = match (places && count == 3, euroc) {
                    (true, _) => Rotations::None,
                    (false, true) => Rotations::ScalarFirst,
                    (false, false) => Rotations::ScalarLast,
                };
            }
            let turned = rotations != Rotations::None;
            let needed = if turned { 7 } else { 3 };
            if count != needed {
                let expected = if turned { "eight numbers" } else { "four numbers, as before" };
                return Err(wrong(count + 1, expected, &(count + 1).to_string()));
            }
            if let Some((last, _)) = poses.last().filter(|(last, _)| at <= *last) {
                let expected = format!("a time after {} ns", last.as_nanos());
                return Err(wrong(1, &expected, &format!("{} ns", at.as_nanos())));
            }
            let [x, y, z, a, b, c, d] = values;
            let rotation = match (turned, euroc) {
                (false, _) => UnitQuaternion::identity(),
                (true, order) => {
                    let q = if order { Quaternion::new(a, b, c, d) } else { Quaternion::new(d, a, b, c) };
                    if (q.norm() - 1.0).abs() > 0.01 {
                        return Err(wrong(5, "a quaternion of unit length", &format!("length {}", q.norm())));
                    }
                    rotation_of(q)
                }
            };
            poses.push((at, Rigid::from_parts(nalgebra::Vector3::new(x, y, z).into(), rotation)));
        }
        if poses.is_empty() {
            return Err(Error::file(path, "poses", "none"));
        }
        Ok((Self { poses }, rotations))
    }

    /// Writes TUM's format, times to the nanosecond, numbers to the last bit.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_tum(&self, mut out: impl Write) -> std::io::Result<()> {
        writeln!(out, "# timestamp tx ty tz qx qy qz qw")?;
        for (at, pose) in &self.poses {
            let nanos = at.as_nanos();
            let sign = if nanos < 0 { "-" } else { "" };
            let (whole, part) = (nanos.unsigned_abs() / 1_000_000_000, nanos.unsigned_abs() % 1_000_000_000);
            let [x, y, z, a, b, c, d] = components(pose);
            writeln!(out, "{sign}{whole}.{part:09} {x} {y} {z} {a} {b} {c} {d}")?;
        }
        out.flush()
    }

    /// The median time from one pose to the next; `None` where there are fewer than two.
    pub fn period(&self) -> Option<Span> {
        let mut steps: Vec<i64> = self
            .poses
            .windows(2)
            .map(|pair| pair[1].0.as_nanos().saturating_sub(pair[0].0.as_nanos()))
            .collect();
        let middle = steps.len() / 2;
        (!steps.is_empty()).then(|| Span::from_nanos(*steps.select_nth_unstable(middle).1))
    }

    /// The length of the way from the first pose to the last, metres.
    pub fn length_m(&self) -> f64 {
        let step = |pair: &[(Timestamp, Rigid)]| {
            (pair[1].1.translation.vector - pair[0].1.translation.vector).norm()
        };
        self.poses.windows(2).map(step).sum()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn parse(text: &str) -> Result<Trajectory, Error> {
        Trajectory::parse(text, Path::new("t.tum"))
    }

    #[test]
    fn both_formats_say_the_same() {
        let tum = parse("# t\n1403715281.26214 1 2 3 0 0 0.6 0.8\n").unwrap();
        let euroc = parse("#timestamp,p\n1403715281262140000,1,2,3,0.8,0,0,0.6,9,9,9\n").unwrap();
        assert_eq!(tum, euroc);
        assert_eq!(tum.poses[0].0.as_nanos(), 1_403_715_281_262_140_000);
        // As spreadsheets and scripts write them.
        for text in
            ["# t,x,y\n1403715281.262140000,1,2,3,0,0,0.6,0.8\n", "1403715281262140000 1 2 3 0 0 0.6 0.8\n"]
        {
            assert_eq!(parse(text).unwrap(), tum, "{text}");
        }
        // One time without a point among times in seconds is in seconds, too.
        let commas = parse("1.5,1,2,3,0,0,0.6,0.8\n2,1,2,3,0,0,0.6,0.8\n").unwrap();
        assert_eq!(commas.poses[1].0.as_nanos(), 2_000_000_000);
        assert_eq!(commas.poses[1].1, tum.poses[0].1);
    }

    #[test]
    fn positions_alone_are_read_where_they_are_wanted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("leica.csv");
        let table = "#timestamp,x,y,z\n1403715281262140000,1,2,3\n1403715281312140000,1,2,4\n";
        std::fs::write(&path, table).unwrap();
        let (places, rotations) = Trajectory::read_places(&path).unwrap();
        assert!(
            rotations == Rotations::None
                && places.poses.len() == 2
                && places.poses[1].1 == Rigid::translation(1.0, 2.0, 4.0)
        );
        let said = Trajectory::read(&path).unwrap_err().to_string();
        assert!(said.contains(":2:4: expected eight numbers, found 4"), "{said}");
        std::fs::write(&path, format!("{table}1403715281362140000,1,2,4,1,0,0,0\n")).unwrap();
        let said = Trajectory::read_places(&path).unwrap_err().to_string();
        assert!(said.contains(":4:8: expected four numbers, as before, found 8"), "{said}");
        std::fs::write(&path, "1 1 2 3 0 0 0.6 0.8\n").unwrap();
        assert_eq!(Trajectory::read_places(&path).unwrap().1, Rotations::ScalarLast);
        std::fs::write(&path, "1403715281262140000,1,2,3,0.8,0,0,0.6\n").unwrap();
        assert_eq!(Trajectory::read_places(&path).unwrap().1, Rotations::ScalarFirst);
    }

    #[test]
    fn faults_have_a_place() {
        for (text, place) in [
            ("1 0 0 0 0 0 x 1\n", "t.tum:1:7: expected a finite number, found x"),
            ("1 0 0\n", "t.tum:1:3: expected eight numbers, found 3"),
            ("1 0 0 0 0 0 0 1 9\n", "t.tum:1:9: expected eight numbers, found more"),
            ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "t.tum:2:1: expected a time after 1000000000 ns"),
            ("1 0 0 0 0 0 0 2\n", "t.tum:1:5: expected a quaternion of unit length, found length 2"),
            ("x 0 0 0 0 0 0 1\n", "t.tum:1:1: expected a time in seconds, found x"),
            ("99999999999 0 0 0 0 0 0 1\n", "t.tum:1:1: expected a time in seconds"),
            ("# nothing\n", "t.tum: expected poses, found none"),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.starts_with(place), "{text}: {error}");
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            start in -4_000_000_000_000_000_000..4_000_000_000_000_000_000i64,
            all in prop::collection::vec((1..2_000_000_000i64, -1e6..1e6f64, -1.0..1.0f64, -1.0..1.0f64), 1..20),
        ) {
            let mut nanos = start;
            let poses = all.into_iter().map(|(step, x, y, angle)| {
                nanos += step;
                let rotation = UnitQuaternion::from_euler_angles(angle, y, x);
                (Timestamp::from_nanos(nanos), Rigid::from_parts(nalgebra::Vector3::new(x, y, -x).into(), rotation))
            }).collect();
            let trajectory = Trajectory { poses };
            let mut bytes = Vec::new();
            trajectory.write_tum(&mut bytes).unwrap();
            let back = parse(std::str::from_utf8(&bytes).unwrap()).unwrap();
            for (a, b) in back.poses.iter().zip(&trajectory.poses) {
                prop_assert_eq!(a.0, b.0);
                prop_assert_eq!(a.1.translation, b.1.translation);
                prop_assert!(a.1.rotation.angle_to(&b.1.rotation) < 1e-7);
            }
        }

        #[test]
        fn damaged_text_never_panics(text in "[-0-9., eE#xn\n]{0,400}") {
            let _ = parse(&text);
            let _ = Trajectory::parse_with(&text, Path::new("t"), UnitQuaternion::new_normalize, true);
        }
    }
}
