//! Scripts as files: what stands in them, checked and named in errors.

use std::fmt::Display;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use vergence_config::{Angle, Duration, Length};
use vergence_time::{Span, Timestamp};

use super::{Body, Held, RawTracking, Script};
use crate::Error;
use crate::motion::{AtEnd, Presence};

/// Times beyond this many seconds are refused: a day.
const LONGEST_S: f64 = 86_400.0;

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Raw {
    at_end: AtEnd,
    #[serde(default)]
    duration: Option<Duration>,
    #[serde(default)]
    headset: Vec<RawHeadset>,
    #[serde(default)]
    head: Vec<RawHead>,
    #[serde(default)]
    left: Vec<RawController>,
    #[serde(default)]
    right: Vec<RawController>,
    #[serde(default)]
    left_hand: Vec<RawHand>,
    #[serde(default)]
    right_hand: Vec<RawHand>,
    #[serde(default)]
    gaze: Vec<RawGaze>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct RawHeadset {
    time: Duration,
    #[serde(default)]
    presence: Option<Presence>,
    #[serde(default)]
    render: Option<bool>,
    #[serde(default)]
    recentre: bool,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawHead {
    time: Duration,
    #[serde(default)]
    position: Option<[Length; 3]>,
    #[serde(default)]
    turned: Option<RawTurn>,
    #[serde(default)]
    tracking: Option<RawTracking>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct RawController {
    time: Duration,
    #[serde(default)]
    position: Option<[Length; 3]>,
    #[serde(default)]
    turned: Option<RawTurn>,
    #[serde(default)]
    aim: Option<RawPose>,
    #[serde(default)]
    tracking: Option<RawTracking>,
    #[serde(default)]
    connected: Option<bool>,
    #[serde(default)]
    trigger: Option<f32>,
    #[serde(default)]
    squeeze: Option<f32>,
    #[serde(default)]
    stick: Option<[f32; 2]>,
    #[serde(default)]
    stick_click: Option<bool>,
    #[serde(default)]
    primary: Option<bool>,
    #[serde(default)]
    secondary: Option<bool>,
    #[serde(default)]
    menu: Option<bool>,
    #[serde(default)]
    touched: Option<Vec<RawTouch>>,
}

/// A bare hand: where its palm is, and how far its fingers are curled.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawHand {
    time: Duration,
    #[serde(default)]
    position: Option<[Length; 3]>,
    #[serde(default)]
    turned: Option<RawTurn>,
    #[serde(default)]
    tracking: Option<RawTracking>,
    #[serde(default)]
    curl: Option<RawCurl>,
}

#[derive(serde::Deserialize)]
#[serde(untagged)]
enum RawCurl {
    All(f64),
    Each([f64; 5]),
}

/// Turned against the head.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawGaze {
    time: Duration,
    #[serde(default)]
    turned: Option<RawTurn>,
    #[serde(default)]
    tracking: Option<RawTracking>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPose {
    position: [Length; 3],
    turned: RawTurn,
}

/// Turned about the vertical (to the left positive), then up, then to the left shoulder; or by a quaternion.
#[derive(serde::Deserialize)]
#[serde(untagged)]
enum RawTurn {
    Quaternion([f64; 4]),
    Angles(RawAngles),
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAngles {
    #[serde(default)]
    yaw: Option<Angle>,
    #[serde(default)]
    pitch: Option<Angle>,
    #[serde(default)]
    roll: Option<Angle>,
}

#[derive(Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum RawTouch {
    Trigger,
    Stick,
    Primary,
    Secondary,
}

/// The order of [`Controller::touches`].
const TOUCHES: [RawTouch; 4] = [RawTouch::Trigger, RawTouch::Stick, RawTouch::Primary, RawTouch::Secondary];

impl Script {
    /// The script that `text`, the content of the file `path`, describes.
    ///
    /// # Errors
    /// Where the text is wrong, times do not rise within a list, or a value is none that a headset can have: the file, the
    /// list and what was expected are named.
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let raw: Raw = vergence_config::parse(path, text)?;
        Reader { path, text }.script(raw)
    }
}

/// Resolves raw keyframes, naming the file in errors.
struct Reader<'a> {
    path: &'a Path,
    text: &'a str,
}

impl Reader<'_> {
    /// That the value of `key`, as in `head.2.time`, is wrong.
    fn wrong(&self, key: &str, expected: impl Display, found: impl Display) -> Error {
        Error::value(self.path, self.text, key, &format!("expected {expected}, found {found}"))
    }

    fn script(&self, raw: Raw) -> Result<Script, Error> {
        let mut script = Script::empty(raw.at_end);
        let mut last = Timestamp::default();
        for (at, _, key) in self.timed("headset", raw.headset, |key| key.time)? {
            script.presence.extend(at, key.presence);
            script.render.extend(at, key.render);
            script.recentrings.extend(key.recentre.then_some(at));
            last = last.max(at);
        }
        for (at, place, key) in self.timed("head", raw.head, |key| key.time)? {
            self.place(&mut script.head, at, &place, key.position, key.turned, key.tracking)?;
            last = last.max(at);
        }
        for (at, place, key) in self.timed("gaze", raw.gaze, |key| key.time)? {
            self.place(&mut script.gaze, at, &place, None, key.turned, key.tracking)?;
            last = last.max(at);
        }
        let lists = [("left-hand", raw.left_hand), ("right-hand", raw.right_hand)];
        for ((list, keys), bare) in lists.into_iter().zip(&mut script.bare) {
            for (at, place, key) in self.timed(list, keys, |key| key.time)? {
                self.place(&mut bare.palm, at, &place, key.position, key.turned, key.tracking)?;
                bare.curls.extend(at, key.curl.map(|curl| self.curls(&place, &curl)).transpose()?);
                last = last.max(at);
            }
            // A hand that is only curled is where it would hold a controller.
            if !bare.curls.is_empty() && bare.palm.tracking.is_empty() {
                bare.palm.tracking.extend(Timestamp::default(), Some(RawTracking::Seen));
            }
        }
        let lists = [("left", raw.left), ("right", raw.right)];
        for ((list, keys), held) in lists.into_iter().zip(&mut script.hands) {
            for (at, place, key) in self.timed(list, keys, |key| key.time)? {
                self.hold(held, at, &place, key)?;
                last = last.max(at);
            }
        }
        script.duration = match raw.duration {
            Some(duration) => {
                let duration = self.time("duration", duration)?;
                if duration < last {
                    return Err(self.wrong(
                        "duration",
                        format!("a duration of at least {} s, the last keyframe", seconds(last)),
                        format!("{} s", seconds(duration)),
                    ));
                }
                Span::from_nanos(duration.as_nanos())
            }
            None => Span::from_nanos(last.as_nanos()),
        };
        Ok(script)
    }

    fn time(&self, key: &str, time: Duration) -> Result<Timestamp, Error> {
        let found = time.seconds();
        match Span::from_secs_f64(found).filter(|_| (0.0..=LONGEST_S).contains(&found)) {
            Some(span) => Ok(Timestamp::from_nanos(span.as_nanos())),
            None => Err(self.wrong(key, format!("a time of 0 to {LONGEST_S} s"), format!("{found} s"))),
        }
    }

    /// The keyframes with their times, which rise, and the keys that lead to them.
    fn timed<K>(
        &self,
        list: &str,
        keys: Vec<K>,
        time: impl Fn(&K) -> Duration,
    ) -> Result<Vec<(Timestamp, String, K)>, Error> {
        let mut timed: Vec<(Timestamp, String, K)> = Vec::with_capacity(keys.len());
        for (index, key) in keys.into_iter().enumerate() {
            let place = format!("{list}.{index}");
            let at = self.time(&format!("{place}.time"), time(&key))?;
            if let Some((before, ..)) = timed.last().filter(|(before, ..)| *before >= at) {
                return Err(self.wrong(
                    &format!("{place}.time"),
                    format!("a time after {} s, that of the keyframe before", seconds(*before)),
                    format!("{} s", seconds(at)),
                ));
            }
            timed.push((at, place, key));
        }
        Ok(timed)
    }

    fn place(
        &self,
        body: &mut Body,
        at: Timestamp,
        place: &str,
        position: Option<[Length; 3]>,
        turned: Option<RawTurn>,
        tracking: Option<RawTracking>,
    ) -> Result<(), Error> {
        body.position.extend(at, position.map(|p| Vector3::from(p.map(Length::metres))));
        body.rotation.extend(at, turned.map(|turned| self.turn(place, &turned)).transpose()?);
        body.tracking.extend(at, tracking);
        Ok(())
    }

    fn curls(&self, place: &str, curl: &RawCurl) -> Result<[f64; 5], Error> {
        let curls = match *curl {
            RawCurl::All(curl) => [curl; 5],
            RawCurl::Each(curls) => curls,
        };
        match curls.into_iter().find(|curl| !(0.0..=1.0).contains(curl)) {
            Some(found) => {
                Err(self.wrong(&format!("{place}.curl"), "0 to 1, of all fingers or of each", found))
            }
            None => Ok(curls),
        }
    }

    fn turn(&self, place: &str, turned: &RawTurn) -> Result<UnitQuaternion<f64>, Error> {
        match turned {
            RawTurn::Angles(angles) => {
                let about = |axis, angle: Option<Angle>| {
                    UnitQuaternion::from_axis_angle(&axis, angle.map_or(0.0, Angle::radians))
                };
                Ok(about(Vector3::y_axis(), angles.yaw)
                    * about(Vector3::x_axis(), angles.pitch)
                    * about(Vector3::z_axis(), angles.roll))
            }
            RawTurn::Quaternion([i, j, k, w]) => {
                let quaternion = Quaternion::new(*w, *i, *j, *k);
                // A comparison with NaN is false.
                if (quaternion.norm() - 1.0).abs() <= 1e-3 {
                    Ok(UnitQuaternion::new_normalize(quaternion))
                } else {
                    let found = format!("{i} {j} {k} {w}");
                    Err(self.wrong(&format!("{place}.turned"), "a unit quaternion x y z w", found))
                }
            }
        }
    }

    fn hold(&self, held: &mut Held, at: Timestamp, place: &str, key: RawController) -> Result<(), Error> {
        self.place(&mut held.grip, at, place, key.position, key.turned, key.tracking)?;
        if let Some(aim) = key.aim {
            let place = format!("{place}.aim");
            self.place(&mut held.aim, at, &place, Some(aim.position), Some(aim.turned), None)?;
        }
        // What is not tracked does not point either.
        if !held.aim.position.is_empty() {
            held.aim.tracking.clone_from(&held.grip.tracking);
        }
        let within = |name: &str, low: f32, value: Option<f32>| match value {
            Some(found) if !(low..=1.0).contains(&found) => {
                Err(self.wrong(&format!("{place}.{name}"), format!("{low} to 1"), found.to_string()))
            }
            value => Ok(value),
        };
        held.connected.extend(at, key.connected);
        held.trigger.extend(at, within("trigger", 0.0, key.trigger)?);
        held.squeeze.extend(at, within("squeeze", 0.0, key.squeeze)?);
        if let Some(stick) = key.stick {
            for part in stick {
                within("stick", -1.0, Some(part))?;
            }
            held.stick.extend(at, Some(stick));
        }
        held.stick_click.extend(at, key.stick_click);
        held.primary.extend(at, key.primary);
        held.secondary.extend(at, key.secondary);
        held.menu.extend(at, key.menu);
        held.touches.extend(at, key.touched.map(|touched| TOUCHES.map(|touch| touched.contains(&touch))));
        Ok(())
    }
}

fn seconds(at: Timestamp) -> f64 {
    Span::from_nanos(at.as_nanos()).as_secs_f64()
}
