//! Whether the sensors of a unit speak of one frame: axes that are swapped, signs that are turned, degrees for radians.
//!
//! A direction that stands still in the world turns back in the frame of the unit as that turns: `dv/dt = −ω × v`, for gravity and for
//! the magnetic field. Each of the 48 ways to name and sign three axes is tried for the gyroscope: the one by which the
//! directions turn is what it says. Gravity is looked at where the specific force is about as long as usual, over turns of a third
//! to one and a half radians; of the field also an offset is fitted.
//!
//! What turning does not tell: `−v` turns as `v` does, so an accelerometer or a magnetometer all of whose axes are negated is not seen
//! (the [dip](FrameCheck::dip_rad) of the field tells which of the two halves of the earth it would be). Nor is whether the gyroscope has its signs
//! turned or all three sensors are left-handed: both look alike.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use vergence_geom::advance;
use vergence_sense::Imu;
use vergence_time::Timestamp;

/// Which reading each of the three axes is taken from, and whether its sign is turned; in text `y,x,-z`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct SignedAxes {
    from: [usize; 3],
    negated: [bool; 3],
}

const NAMES: [&str; 3] = ["x", "y", "z"];

impl SignedAxes {
    /// As they are.
    pub const SAME: Self = Self { from: [0, 1, 2], negated: [false; 3] };

    /// All 48, [`Self::SAME`] first.
    pub fn all() -> impl Iterator<Item = Self> {
        const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        ORDERS.into_iter().flat_map(|from| {
            (0..8).map(move |signs: u8| Self {
                from,
                negated: std::array::from_fn(|axis| signs >> axis & 1 == 1),
            })
        })
    }

    /// The vector with these axes.
    pub fn of(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| {
            let value = vector[self.from[axis]];
            if self.negated[axis] { -value } else { value }
        })
    }

    /// What undoes it.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let mut inverse = Self::SAME;
        for axis in 0..3 {
            inverse.from[self.from[axis]] = axis;
            inverse.negated[self.from[axis]] = self.negated[axis];
        }
        inverse
    }

    /// Every sign the other way.
    #[must_use]
    pub fn opposite(&self) -> Self {
        Self { from: self.from, negated: self.negated.map(|negated| !negated) }
    }

    /// Whether right-handed axes stay right-handed.
    pub fn is_rotation(&self) -> bool {
        let columns = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| self.of(&axis));
        Matrix3::from_columns(&columns).determinant() > 0.0
    }
}

impl Default for SignedAxes {
    fn default() -> Self {
        Self::SAME
    }
}

impl std::fmt::Display for SignedAxes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for axis in 0..3 {
            let comma = if axis > 0 { "," } else { "" };
            let sign = if self.negated[axis] { "-" } else { "" };
            write!(f, "{comma}{sign}{}", NAMES[self.from[axis]])?;
        }
        Ok(())
    }
}

impl std::str::FromStr for SignedAxes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "expected each of x, y and z once, between commas and with a minus where it is turned (such as y,x,-z), found '{text}'"
            )
        };
        let mut axes = Self::SAME;
        let mut seen = [false; 3];
        let mut words = text.split([',', ' ']).filter(|word| !word.is_empty());
        for axis in 0..3 {
            let word = words.next().ok_or_else(wrong)?;
            let bare = word.trim_start_matches(['-', '−', '+']);
            let from = NAMES.iter().position(|name| bare.eq_ignore_ascii_case(name)).ok_or_else(wrong)?;
            if std::mem::replace(&mut seen[from], true) || word.chars().count() > 2 {
                return Err(wrong());
            }
            axes.from[axis] = from;
            axes.negated[axis] = word.starts_with(['-', '−']);
        }
        words.next().map_or(Ok(axes), |_| Err(wrong()))
    }
}

impl TryFrom<String> for SignedAxes {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<SignedAxes> for String {
    fn from(axes: SignedAxes) -> Self {
        axes.to_string()
    }
}

/// The axes of the three sensors of a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorAxes {
    /// Of the gyroscope.
    pub gyr: SignedAxes,
    /// Of the accelerometer.
    pub acc: SignedAxes,
    /// Of the magnetometer.
    pub mag: SignedAxes,
}

impl SensorAxes {
    /// Whether nothing is changed.
    pub fn is_same(&self) -> bool {
        *self == Self::default()
    }

    /// The readings in these axes.
    pub fn of(&self, imu: &Imu) -> Imu {
        Imu {
            gyr_rad_s: self.gyr.of(&imu.gyr_rad_s),
            acc_m_s2: self.acc.of(&imu.acc_m_s2),
            mag_ut: imu.mag_ut.map(|mag| self.mag.of(&mag)),
        }
    }
}

/// How a sensor turns against the gyroscope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turning {
    /// The sensor turns as these axes of the gyroscope say; `None` where several ways explain it.
    pub axes: Option<SignedAxes>,
    /// Whether the rates are degrees per second.
    pub degrees: bool,
    /// What is left of the change of the direction with these axes, and with the axes as they are: shares of its square, 1 where turning
    /// explains nothing.
    pub left: [f64; 2],
    /// The turns that were looked at.
    pub turns: usize,
}

/// What turning says of the frames of a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameCheck {
    /// Of the accelerometer; `None` where it turns as the gyroscope says, or nothing is told.
    pub acc: Option<Turning>,
    /// Of the magnetometer.
    pub mag: Option<Turning>,
    /// Whether the accelerometer was seen to turn as the gyroscope says.
    pub acc_agrees: bool,
    /// The same of the magnetometer.
    pub mag_agrees: bool,
    /// How far the field points below the horizon, radians; `None` without one. Positive north of the magnetic equator.
    pub dip_rad: Option<f64>,
}

/// Length of the pieces over which readings are averaged, s.
const PIECE_S: f64 = 0.05;
/// A step that is longer is a gap, s.
const GAP_S: f64 = 0.25;
/// Slower pieces tell nothing against a gyroscope's bias, whatever the unit of the rates, rad/s.
const SLOW_RAD_S: f64 = 0.1;
/// Pieces in motion that are looked at: an hour. More would tell nothing more.
const MOST_PIECES: usize = 72_000;
/// Turns are about so long, rad, not longer than the second, and take at most the third, s: biases would count.
const TURN_RAD: f64 = 0.6;
const LONGEST_TURN_RAD: f64 = 1.5;
const TURN_S: f64 = 3.0;
/// Share of its usual length by which the specific force may be longer or shorter where gravity is read off it.
const MOVED: f64 = 0.1;
/// With fewer turns nothing is said.
const LEAST_TURNS: usize = 20;
/// The best axes leave less than this share of the square of the change …
const EXPLAINED: f64 = 0.1;
/// … those that are wrong more than this, and so many times what the best ones leave.
const WRONG: f64 = 0.5;
const CLEARLY: f64 = 8.0;
/// Axes that leave less than so many times what the best ones do are as good.
const AS_GOOD: f64 = 3.0;
/// Weight of the belief that the magnetometer has no offset, against one turn: it may be as large as the field.
const OFFSET_BELIEF: f64 = 0.01;

struct Piece {
    seconds: f64,
    /// Rates times steps, in the unit of the rates times seconds.
    turn: Vector3<f64>,
    acc: Option<Vector3<f64>>,
    mag: Option<Vector3<f64>>,
    /// Whether it does not follow the piece before.
    begins: bool,
}

/// Sum and count of the finite readings of one sensor.
#[derive(Default)]
struct Mean(Vector3<f64>, f64);

impl Mean {
    fn add(&mut self, reading: &Vector3<f64>) {
        if reading.sum().is_finite() {
            self.0 += reading;
            self.1 += 1.0;
        }
    }

    fn take(&mut self) -> Option<Vector3<f64>> {
        let Self(sum, count) = std::mem::take(self);
        (count > 0.0).then(|| sum / count).filter(|mean| mean.norm() > 0.0)
    }
}

/// The pieces in motion.
fn pieces(samples: &[(Timestamp, Imu)]) -> Vec<Piece> {
    let mut all: Vec<Piece> = Vec::new();
    let mut begins = true;
    let (mut seconds, mut turn) = (0.0, Vector3::zeros());
    let (mut acc, mut mag) = (Mean::default(), Mean::default());
    for pair in samples.windows(2) {
        let step_s = pair[1].0.since(pair[0].0).map_or(-1.0, |step| step.as_secs_f64());
        let imu = &pair[1].1;
        if !(step_s > 0.0 && step_s <= GAP_S && imu.gyr_rad_s.sum().is_finite()) {
            (seconds, turn, begins) = (0.0, Vector3::zeros(), true);
            (acc, mag) = (Mean::default(), Mean::default());
            continue;
        }
        seconds += step_s;
        turn += imu.gyr_rad_s * step_s;
        acc.add(&imu.acc_m_s2);
        imu.mag_ut.iter().for_each(|reading| mag.add(reading));
        // Half a step: steps of equal length would else make pieces of unequal length by chance.
        if seconds + 0.5 * step_s < PIECE_S {
            continue;
        }
        let piece = Piece { seconds, turn, acc: acc.take(), mag: mag.take(), begins };
        if piece.turn.norm() >= SLOW_RAD_S * seconds {
            all.push(piece);
            begins = false;
            if all.len() >= MOST_PIECES {
                break;
            }
        } else {
            begins = true;
        }
        (seconds, turn) = (0.0, Vector3::zeros());
    }
    all
}

/// The turns, as first and last piece, of a sensor that is read by `read`; `scale` makes radians of the rates.
fn turns(pieces: &[Piece], scale: f64, read: &dyn Fn(&Piece) -> Option<Vector3<f64>>) -> Vec<(usize, usize)> {
    let mut turns = Vec::new();
    let mut open: Option<usize> = None;
    let (mut path, mut seconds) = (0.0, 0.0);
    for (index, piece) in pieces.iter().enumerate() {
        if piece.begins {
            open = None;
        }
        let half = 0.5 * scale * piece.turn.norm();
        if let Some(from) = open {
            path += half;
            seconds += piece.seconds;
            if path > LONGEST_TURN_RAD || seconds > TURN_S {
                open = None;
            } else if path >= TURN_RAD && read(piece).is_some() {
                turns.push((from, index));
                open = None;
            } else {
                path += half;
            }
        }
        if open.is_none() && read(piece).is_some() {
            (open, path, seconds) = (Some(index), half, 0.0);
        }
    }
    turns
}

/// What is left of the change of the direction, sum of squares, if the unit turns as `axes` of the gyroscope say. With `offset`, that of the
/// sensor is fitted.
fn left(
    pieces: &[Piece],
    turns: &[(usize, usize)],
    scale: f64,
    axes: &SignedAxes,
    read: &dyn Fn(&Piece) -> Option<Vector3<f64>>,
    offset: bool,
) -> f64 {
    let mut squares = 0.0;
    let (mut information, mut target) = (Matrix3::zeros(), Vector3::zeros());
    for (from, to) in turns {
        let (Some(before), Some(after)) = (read(&pieces[*from]), read(&pieces[*to])) else { continue };
        let mut from_to = UnitQuaternion::identity();
        for (index, piece) in pieces.iter().enumerate().take(to + 1).skip(*from) {
            let share = if index == *from || index == *to { 0.5 } else { 1.0 };
            from_to = advance(&from_to, &(axes.of(&piece.turn) * (scale * share)));
        }
        let to_from = from_to.inverse().to_rotation_matrix().into_inner();
        let left = after - to_from * before;
        // An offset stands still in the sensor.
        let by = Matrix3::identity() - to_from;
        squares += left.norm_squared();
        information += by.transpose() * by;
        target += by.transpose() * left;
    }
    if !offset {
        return squares;
    }
    information += Matrix3::from_diagonal_element(OFFSET_BELIEF * turns.len() as f64);
    information.cholesky().map_or(squares, |found| squares - target.dot(&found.solve(&target)))
}

/// How a sensor turns; whether it was seen to turn as the gyroscope says.
fn turning(
    pieces: &[Piece],
    read: &dyn Fn(&Piece) -> Option<Vector3<f64>>,
    offset: bool,
) -> (Option<Turning>, bool) {
    for (scale, degrees) in [(1.0, false), (1f64.to_radians(), true)] {
        let turns = turns(pieces, scale, read);
        if turns.len() < LEAST_TURNS {
            continue;
        }
        let change = |(from, to): &(usize, usize)| {
            let both = read(&pieces[*from]).zip(read(&pieces[*to]));
            both.map_or(0.0, |(before, after)| (after - before).norm_squared())
        };
        let all: f64 = turns.iter().map(change).sum::<f64>().max(f64::MIN_POSITIVE);
        let mut found: Vec<(f64, SignedAxes)> = SignedAxes::all()
            .map(|axes| (left(pieces, &turns, scale, &axes, read, offset) / all, axes))
            .collect();
        let as_is = found[0].0;
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (best, axes) = found[0];
        if best > EXPLAINED {
            continue;
        }
        if as_is <= EXPLAINED && !degrees {
            return (None, true);
        }
        if !degrees && (as_is < WRONG || as_is < CLEARLY * best) {
            continue;
        }
        let only = found[1].0 > AS_GOOD * best;
        let found = Turning { axes: only.then_some(axes), degrees, left: [best, as_is], turns: turns.len() };
        return (Some(found), false);
    }
    (None, false)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Looks at how gravity and field turn in `samples`, in order of time. O(samples), and 100 times the pieces of 50 ms in the first hour of
/// motion.
pub fn check_frames(samples: &[(Timestamp, Imu)]) -> FrameCheck {
    let pieces = pieces(samples);
    let usual = median(pieces.iter().filter_map(|piece| piece.acc).map(|acc| acc.norm()).collect());
    let usual = usual.unwrap_or(0.0);
    let gravity = |piece: &Piece| piece.acc.filter(|acc| (acc.norm() - usual).abs() <= MOVED * usual);
    let (acc, acc_agrees) = turning(&pieces, &gravity, false);
    let (mag, mag_agrees) = turning(&pieces, &|piece| piece.mag, true);
    // Of all samples: a unit that never turns has a field, too. A thousand are enough.
    let stride = samples.len() / 1000 + 1;
    let dip = |(_, imu): &(Timestamp, Imu)| {
        let (acc, mag) = (imu.acc_m_s2.try_normalize(1e-9)?, imu.mag_ut?.try_normalize(1e-9)?);
        Some(-acc.dot(&mag).clamp(-1.0, 1.0).asin()).filter(|dip| dip.is_finite())
    };
    let dip_rad = median(samples.iter().step_by(stride).filter_map(dip).collect());
    FrameCheck { acc, mag, acc_agrees, mag_agrees, dip_rad }
}

impl FrameCheck {
    /// What is wrong and what would mend it, in sentences; `--turn` is what the tools call the axes.
    pub fn warnings(&self) -> Vec<String> {
        let spaced = |axes: &SignedAxes| axes.to_string().replace(',', ", ");
        let several =
            "another order or other signs of the axes explain it, turns about more axes would tell which";
        let degrees = |sensor: &str, turning: &Turning| {
            let also = turning.axes.filter(|axes| *axes != SignedAxes::SAME);
            let also = also.map_or(String::new(), |axes| format!(", and as ({}) of it", spaced(&axes)));
            format!(
                "the {sensor} turns by a 57th of what the gyroscope says{also}: expected rates in rad/s, found deg/s"
            )
        };
        match (&self.acc, &self.mag) {
            (None, None) => Vec::new(),
            (Some(turning), _) if turning.degrees => vec![degrees("accelerometer", turning)],
            (_, Some(turning)) if turning.degrees => vec![degrees("magnetometer", turning)],
            (Some(acc), Some(mag)) if acc.axes == mag.axes => vec![match acc.axes {
                None => {
                    format!("accelerometer and magnetometer do not turn as the gyroscope says: {several}")
                }
                Some(axes) => format!(
                    "accelerometer and magnetometer turn as ({}) of the gyroscope: {}",
                    spaced(&axes),
                    gyroscope(&axes)
                ),
            }],
            (acc, mag) => {
                let mut all = Vec::new();
                for (name, short, turning) in
                    [("accelerometer", "acc", acc.as_ref()), ("magnetometer", "mag", mag.as_ref())]
                {
                    let Some(turning) = turning else { continue };
                    let Some(axes) = turning.axes else {
                        all.push(format!("the {name} does not turn as the gyroscope says: {several}"));
                        continue;
                    };
                    // What the third sensor says decides between this one and the gyroscope.
                    let alone = if short == "acc" { !self.mag_agrees } else { !self.acc_agrees };
                    let mend = if axes.is_rotation() {
                        let right = axes.inverse();
                        let or = if alone {
                            format!("; or the gyroscope is wrong: --turn gyr={axes}")
                        } else {
                            String::new()
                        };
                        format!(
                            "--turn {short}={right} (or {}: turning does not tell them apart){or}",
                            right.opposite()
                        )
                    } else {
                        gyroscope(&axes)
                    };
                    all.push(format!("the {name} turns as ({}) of the gyroscope: {mend}", spaced(&axes)));
                }
                all
            }
        }
    }
}

/// What mends a gyroscope that the others turn as `axes` of.
fn gyroscope(axes: &SignedAxes) -> String {
    let handed = if axes.is_rotation() {
        ""
    } else {
        " where the signs of the gyroscope are turned; where all three sensors are left-handed, turn one and the same axis of all of them"
    };
    format!("--turn gyr={axes}{handed}")
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use proptest::prelude::*;
    use vergence_time::Span;

    use super::*;
    use crate::model::ImuModel;
    use crate::motion::{Earth, Wander, WanderParams};

    type Samples = Vec<(Timestamp, Imu)>;

    /// A minute of a consumer's unit that is turned by hand.
    fn recorded(seed: u64, tilt_rad: f64) -> Samples {
        let params = WanderParams {
            tilt_rad,
            turn_rad: 1.5,
            way_m: 0.05,
            frequency_hz: 0.35,
            ..WanderParams::default()
        };
        let motion = Wander::new(seed, &params).unwrap();
        let mut model = ImuModel::consumer(200.0, seed);
        model.gyr.bias = Vector3::new(0.05, -0.03, 0.02);
        model.mag = model.mag.map(|mag| crate::model::Triad { bias: Vector3::new(20.0, -35.0, 8.0), ..mag });
        let all = model.record(&motion, &Earth::MID_LATITUDE, Span::from_millis(60_000));
        all.map(|sample| (sample.captured, sample.value)).collect()
    }

    fn changed(samples: &Samples, change: impl Fn(&Imu) -> Imu) -> Samples {
        samples.iter().map(|(at, imu)| (*at, change(imu))).collect()
    }

    #[test]
    fn axes_have_names_and_inverses() {
        let all: Vec<SignedAxes> = SignedAxes::all().collect();
        assert_eq!((all.len(), all[0]), (48, SignedAxes::SAME));
        let vector = Vector3::new(1.0, 2.0, 3.0);
        for (index, axes) in all.iter().enumerate() {
            assert_eq!(axes.to_string().parse(), Ok(*axes));
            assert_eq!(axes.inverse().of(&axes.of(&vector)), vector);
            assert_eq!(axes.opposite().of(&vector), -axes.of(&vector));
            assert!(!all[..index].contains(axes));
        }
        assert_eq!(all.iter().filter(|axes| axes.is_rotation()).count(), 24);
        assert_eq!("y x −z".parse::<SignedAxes>().unwrap().of(&vector), Vector3::new(2.0, 1.0, -3.0));
        for wrong in ["", "x,y", "x,x,z", "x,y,w", "x,y,z,x", "--x,y,z", "1,2,3"] {
            assert!(wrong.parse::<SignedAxes>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_unit_whose_sensors_agree_is_not_warned_of() {
        for (seed, tilt_rad) in [(1, 1.6), (2, 1.6), (3, 0.4), (4, 0.0)] {
            let check = check_frames(&recorded(seed, tilt_rad));
            assert_eq!((check.acc, check.mag), (None, None), "{seed}");
            assert!(check.dip_rad.is_some_and(|dip| dip > 0.5), "{check:?}");
        }
        assert!(check_frames(&recorded(1, 1.6)).acc_agrees && check_frames(&recorded(1, 1.6)).mag_agrees);
        assert_eq!(check_frames(&[]), FrameCheck::default());
    }

    static HAND: LazyLock<Samples> = LazyLock::new(|| recorded(5, 1.6));

    #[test]
    fn degrees_are_told_from_radians() {
        let degrees = changed(&HAND, |imu| Imu { gyr_rad_s: imu.gyr_rad_s.map(f64::to_degrees), ..*imu });
        let warnings = check_frames(&degrees).warnings();
        assert!(
            warnings.len() == 1 && warnings[0].ends_with("expected rates in rad/s, found deg/s"),
            "{warnings:?}"
        );
    }

    #[test]
    fn turns_about_one_axis_do_not_say_which() {
        let one = |rate: Vector3<f64>, at: i64| {
            let q = UnitQuaternion::from_scaled_axis(Vector3::z() * (at as f64 * 1e-9 * rate.z));
            let mag_ut = Some(q.inverse() * Vector3::new(0.0, 16.0, -42.0));
            let gyr_rad_s = Vector3::new(0.0, 0.0, -rate.z);
            (Timestamp::from_nanos(at), Imu { gyr_rad_s, acc_m_s2: Vector3::z() * 9.81, mag_ut })
        };
        let samples: Samples = (0..12_000).map(|k| one(Vector3::z(), k * 5_000_000)).collect();
        let check = check_frames(&samples);
        assert_eq!(check.acc, None, "gravity does not turn");
        assert!(check.mag.is_some_and(|mag| mag.axes.is_none() && mag.left[1] > 1.0), "{check:?}");
        assert!(check.warnings()[0].contains("would tell which"));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn other_axes_are_named_with_what_mends_them(index in 1usize..48, sensor in 0usize..3) {
            let axes = SignedAxes::all().nth(index).unwrap();
            let wrong = match sensor {
                0 => SensorAxes { gyr: axes, ..SensorAxes::default() },
                1 => SensorAxes { acc: axes, ..SensorAxes::default() },
                _ => SensorAxes { mag: axes, ..SensorAxes::default() },
            };
            let check = check_frames(&changed(&HAND, |imu| wrong.of(imu)));
            let warnings = check.warnings();
            if sensor > 0 && axes == SignedAxes::SAME.opposite() {
                prop_assert!(warnings.is_empty(), "turning does not tell: {warnings:?}");
                return Ok(());
            }
            prop_assert_eq!(warnings.len(), 1);
            let (name, right) = match sensor {
                0 => ("--turn gyr=", axes.inverse()),
                // Of a mirrored sensor, its opposite is the one that turns.
                1 => ("--turn acc=", axes.inverse()),
                _ => ("--turn mag=", axes.inverse()),
            };
            let mends = [format!("{name}{right}"), format!("(or {right}:")];
            prop_assert!(mends.iter().any(|mend| warnings[0].contains(mend)), "{right}: {warnings:?}");
            // What is warned of mends it.
            let mended = changed(&HAND, |imu| match sensor {
                0 => Imu { gyr_rad_s: right.of(&wrong.of(imu).gyr_rad_s), ..wrong.of(imu) },
                1 => Imu { acc_m_s2: right.of(&wrong.of(imu).acc_m_s2), ..wrong.of(imu) },
                _ => Imu { mag_ut: imu.mag_ut.map(|mag| right.of(&axes.of(&mag))), ..*imu },
            });
            prop_assert_eq!(check_frames(&mended).warnings(), Vec::<String>::new());
        }
    }
}
