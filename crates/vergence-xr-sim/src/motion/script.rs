use std::fmt::Display;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use vergence_config::{Angle, Duration, Length};
use vergence_geom::{Rigid, slerp};
use vergence_sense::{ControlState, Hand, RawLocation, Said, Tracking};
use vergence_time::{Span, Timestamp};

use super::track::Track;
use super::{AtEnd, Controller, PoseProvider, Presence, Tracked, held_in_front};
use crate::Error;

/// Times beyond this many seconds are refused: a day.
const LONGEST_S: f64 = 86_400.0;
/// Where the eyes of a standing adult are, metres.
const EYES_M: [f64; 3] = [0.0, 1.6, 0.0];

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

#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum RawTracking {
    Seen,
    Held,
    Lost,
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

/// A script: what the simulated user does when, in keyframes.
///
/// Each value that a keyframe names has a track of its own. Positions, axes and directions go straight from one key to the
/// next, turns on the shortest way; what is on or off changes at its key. Before its first key a pose is as at that key, and
/// a control is at rest.
#[derive(Clone, Debug)]
pub struct Script {
    at_end: AtEnd,
    duration: Span,
    head: Body,
    hands: [Held; 2],
    presence: Track<Presence>,
    render: Track<bool>,
    recentrings: Vec<Timestamp>,
}

#[derive(Clone, Debug, Default)]
struct Body {
    position: Track<Vector3<f64>>,
    rotation: Track<UnitQuaternion<f64>>,
    tracking: Track<RawTracking>,
}

#[derive(Clone, Debug, Default)]
struct Held {
    grip: Body,
    aim: Body,
    connected: Track<bool>,
    trigger: Track<f32>,
    squeeze: Track<f32>,
    stick: Track<[f32; 2]>,
    stick_click: Track<bool>,
    primary: Track<bool>,
    secondary: Track<bool>,
    menu: Track<bool>,
    touches: Track<[bool; 4]>,
}

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

    /// What the user of a recorded session did, to be done again in any other: `frames` as for
    /// [`Replay`](super::Replay), and for each action, by its place, the control that it was read from.
    ///
    /// What stays the same takes no memory; each pose that moves takes 100 bytes per frame. A head and two controllers that
    /// all move take 160 MB for an hour at 90 Hz.
    ///
    /// Motion time 0 is when the session began to run, as the clock said at its first frame. The floor is the recorded one,
    /// where it was known.
    pub fn of_session(frames: impl Iterator<Item = Vec<Said>>, parts: &[Option<Part>]) -> Self {
        let mut script = Self {
            at_end: AtEnd::Stop,
            duration: Span::ZERO,
            head: Body::default(),
            hands: [Held::default(), Held::default()],
            presence: Track::default(),
            render: Track::default(),
            recentrings: Vec::new(),
        };
        let mut began = None;
        let mut stage_from_local = Rigid::translation(0.0, EYES_M[1], 0.0);
        for frame in frames {
            let mut display = None;
            for said in &frame {
                match said {
                    Said::Frame { now, display: shown, .. } => {
                        let began = *began.get_or_insert(*now);
                        let since = shown.since(began).unwrap_or(Span::ZERO);
                        display = Some(Timestamp::from_nanos(since.as_nanos()))
                            // Keys rise; a clock that does not is passed over.
                            .filter(|at| at.as_nanos() > script.duration.as_nanos());
                    }
                    Said::Place { of: vergence_sense::Body::Floor, location, .. } => {
                        if let Some(floor) = location.read().reference_from_device() {
                            stage_from_local = Rigid::translation(0.0, -floor.translation.y, 0.0);
                        }
                    }
                    _ => {}
                }
            }
            let Some(at) = display else { continue };
            script.duration = Span::from_nanos(at.as_nanos());
            let mut given = Given::default();
            for said in &frame {
                script.take(at, said, parts, &stage_from_local, &mut given);
            }
        }
        script
    }

    /// One thing of a frame; of a body that is located twice the first place counts.
    fn take(
        &mut self,
        at: Timestamp,
        said: &Said,
        parts: &[Option<Part>],
        stage_from_local: &Rigid,
        given: &mut Given,
    ) {
        let part = |action: u16| parts.get(usize::from(action)).copied().flatten();
        match said {
            Said::Place { of: vergence_sense::Body::Head, .. } if given.head => {}
            Said::Place { of: vergence_sense::Body::Head, location, .. } => {
                given.head = true;
                self.head.follow(at, location, stage_from_local);
            }
            Said::Place { of: vergence_sense::Body::Action(action, hand), location, .. } => {
                let held = &mut self.hands[hand.index()];
                let body = match part(*action) {
                    Some(Part::Aim) => &mut held.aim,
                    Some(Part::Grip) => &mut held.grip,
                    _ => return,
                };
                body.follow(at, location, stage_from_local);
            }
            Said::Control { action, hand, state, .. } => {
                let held = &mut self.hands[hand.index()];
                let (on, pulled, pushed) = match *state {
                    ControlState::Button(button) => {
                        (button.0, button.0.map(|on| f32::from(u8::from(on))), None)
                    }
                    ControlState::Axis(axis) => (axis.0.map(|pull| pull >= 0.5), axis.0, None),
                    ControlState::Vector2(vector) => (None, None, vector.0),
                };
                match part(*action) {
                    Some(Part::Trigger) => held.trigger.extend(at, pulled),
                    Some(Part::Squeeze) => held.squeeze.extend(at, pulled),
                    Some(Part::Stick) => held.stick.extend(at, pushed),
                    Some(Part::StickClick) => held.stick_click.extend(at, on),
                    Some(Part::Primary) => held.primary.extend(at, on),
                    Some(Part::Secondary) => held.secondary.extend(at, on),
                    Some(Part::Menu) => held.menu.extend(at, on),
                    Some(Part::Aim | Part::Grip) | None => {}
                }
            }
            _ => {}
        }
    }

    /// The instant of the script at motion time `at`.
    fn instant(&self, at: Timestamp) -> Timestamp {
        let (nanos, duration) = (at.as_nanos(), self.duration.as_nanos());
        let looped = self.at_end == AtEnd::Loop && nanos > duration && duration > 0;
        Timestamp::from_nanos(if looped { nanos % duration } else { nanos })
    }
}

/// A part of a controller that an action was read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names of the fields of `Controller`")]
pub enum Part {
    Aim,
    Grip,
    Trigger,
    Squeeze,
    Stick,
    StickClick,
    Primary,
    Secondary,
    Menu,
}

#[derive(Default)]
struct Given {
    head: bool,
}

impl Body {
    /// One more key, where the place of the body was known.
    fn follow(&mut self, at: Timestamp, location: &RawLocation, stage_from_local: &Rigid) {
        let pose = location.read();
        let tracking = match (pose.reference_from_device(), pose.position_tracking) {
            (None, _) => RawTracking::Lost,
            (Some(_), Tracking::Measured) => RawTracking::Seen,
            (Some(_), _) => RawTracking::Held,
        };
        if let Some(local_from_body) = pose.reference_from_device() {
            let stage_from_body = stage_from_local * local_from_body;
            self.position.extend(at, Some(stage_from_body.translation.vector));
            self.rotation.extend(at, Some(stage_from_body.rotation));
        }
        self.tracking.extend(at, Some(tracking));
    }

    /// `None` where the script says nothing of its place.
    fn at(&self, at: Timestamp, otherwise: &Rigid) -> Option<Tracked> {
        if self.position.is_empty() && self.rotation.is_empty() && self.tracking.is_empty() {
            return None;
        }
        let position = self.position.between(at, |a, b, t| a.lerp(b, t));
        let rotation = self.rotation.between(at, slerp);
        let pose = Rigid::from_parts(
            position.map_or(otherwise.translation, Into::into),
            rotation.unwrap_or(otherwise.rotation),
        );
        Some(match self.tracking.held(at) {
            None | Some(RawTracking::Seen) => Tracked::Seen(pose),
            Some(RawTracking::Held) => Tracked::Held(pose),
            Some(RawTracking::Lost) => Tracked::Lost,
        })
    }
}

impl PoseProvider for Script {
    fn head(&self, at: Timestamp) -> Tracked {
        let [x, y, z] = EYES_M;
        let eyes = Rigid::translation(x, y, z);
        self.head.at(self.instant(at), &eyes).unwrap_or(Tracked::Seen(eyes))
    }

    fn controller(&self, hand: Hand, at: Timestamp) -> Controller {
        let instant = self.instant(at);
        let held = &self.hands[hand.index()];
        let on = |track: &Track<bool>| track.held(instant).copied().unwrap_or(false);
        let pulled =
            |track: &Track<f32>| track.once_begun(instant, |a, b, t| a + (b - a) * t as f32).unwrap_or(0.0);
        if held.connected.held(instant) == Some(&false) {
            return Controller::absent();
        }
        let usual = held_in_front(&self.head(at), hand);
        let grip = match usual.grip.pose() {
            Some(pose) => held.grip.at(instant, &pose).unwrap_or(usual.grip),
            None => held.grip.at(instant, &Rigid::identity()).unwrap_or(usual.grip),
        };
        let aim = held.aim.at(instant, &Rigid::identity()).unwrap_or_else(|| super::aim_of(&grip));
        Controller {
            trigger: pulled(&held.trigger),
            squeeze: pulled(&held.squeeze),
            stick: held
                .stick
                .once_begun(instant, |a, b, t| [0, 1].map(|i: usize| a[i] + (b[i] - a[i]) * t as f32))
                .unwrap_or_default(),
            stick_click: on(&held.stick_click),
            primary: on(&held.primary),
            secondary: on(&held.secondary),
            menu: on(&held.menu),
            touches: held.touches.held(instant).copied().unwrap_or_default(),
            ..Controller::idle(grip, aim)
        }
    }

    fn presence(&self, at: Timestamp) -> Presence {
        self.presence.held(self.instant(at)).copied().unwrap_or_default()
    }

    fn renders(&self, at: Timestamp) -> bool {
        self.render.held(self.instant(at)).copied().unwrap_or(true)
    }

    fn recentrings(&self, at: Timestamp) -> u64 {
        let instant = self.instant(at);
        let rounds = match (at.as_nanos(), self.duration.as_nanos()) {
            (nanos, duration) if self.at_end == AtEnd::Loop && duration > 0 && nanos > duration => {
                nanos / duration
            }
            _ => 0,
        };
        let so_far = self.recentrings.partition_point(|&time| time <= instant) as u64;
        so_far + rounds as u64 * self.recentrings.len() as u64
    }

    fn end(&self) -> Option<Timestamp> {
        (self.at_end == AtEnd::Stop).then(|| Timestamp::from_nanos(self.duration.as_nanos()))
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
        let mut script = Script {
            at_end: raw.at_end,
            duration: Span::ZERO,
            head: Body::default(),
            hands: [Held::default(), Held::default()],
            presence: Track::default(),
            render: Track::default(),
            recentrings: Vec::new(),
        };
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

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Timestamp {
        Timestamp::from_nanos(millis * 1_000_000)
    }

    fn script(text: &str) -> Script {
        Script::parse(Path::new("s.toml"), text).unwrap()
    }

    #[test]
    fn the_sample_of_the_crate_is_read() {
        for (name, text) in super::super::BUILT_IN_SCRIPTS {
            Script::parse(Path::new(name), text).unwrap();
        }
    }

    #[test]
    fn each_value_has_a_track_of_its_own() {
        let script = script(
            r#"
            at-end = "hold"
            [[head]]
            time = "1 s"
            position = ["0 m", "1.6 m", "0 m"]
            [[head]]
            time = "1.5 s"
            turned = { yaw = "90 deg" }
            [[head]]
            time = "2 s"
            position = ["1 m", "1.6 m", "0 m"]
            tracking = "held"
            "#,
        );
        for (millis, x) in [(0, 0.0), (1000, 0.0), (1250, 0.25), (1500, 0.5), (1999, 0.999)] {
            let Tracked::Seen(pose) = script.head(at(millis)) else { panic!("{millis}") };
            assert!((pose.translation.x - x).abs() < 1e-12, "{millis}");
            assert!((pose.rotation.angle() - std::f64::consts::FRAC_PI_2).abs() < 1e-12, "{millis}");
            // To the left: −z becomes −x.
            assert!((pose.rotation * -Vector3::z() + Vector3::x()).norm() < 1e-12);
        }
        assert!(matches!(script.head(at(5000)), Tracked::Held(pose) if pose.translation.x == 1.0));
    }

    #[test]
    fn controls_rest_before_their_first_key_and_axes_go_straight() {
        let script = script(
            r#"
            at-end = "hold"
            [[right]]
            time = "1 s"
            trigger = 0.0
            stick = [-1, 0]
            primary = true
            touched = ["trigger", "primary"]
            [[right]]
            time = "2 s"
            trigger = 1.0
            stick = [1, 1]
            secondary = true
            [[right]]
            time = "3 s"
            connected = false
            "#,
        );
        let read = |millis| script.controller(Hand::Right, at(millis));
        assert_eq!((read(999).stick, read(999).primary, read(999).touches), ([0.0; 2], false, [false; 4]));
        assert_eq!((read(1500).trigger, read(1500).stick), (0.5, [0.0, 0.5]));
        assert_eq!((read(1500).primary, read(1500).secondary), (true, false));
        assert_eq!(read(1500).touches, [true, false, true, false]);
        assert_eq!((read(2500).trigger, read(2500).secondary, read(2999).connected), (1.0, true, true));
        assert_eq!(read(3000), Controller::absent());
        assert_eq!(script.controller(Hand::Left, at(1500)).trigger, 0.0);
        // Where nothing else is said, controllers are held in front of the head.
        assert_eq!(read(1500).grip, super::super::Still::default().controller(Hand::Right, at(0)).grip);
    }

    #[test]
    fn the_headset_goes_off_and_is_recentred() {
        let text = r#"
            at-end = "END"
            duration = "4 s"
            [[headset]]
            time = "1 s"
            presence = "away"
            recentre = true
            [[headset]]
            time = "2 s"
            presence = "focused"
            render = false
            [[headset]]
            time = "3 s"
            recentre = true
            "#;
        let stop = script(&text.replace("END", "stop"));
        assert_eq!(
            [0, 999, 1000, 2000].map(|ms| stop.presence(at(ms))),
            [Presence::Focused, Presence::Focused, Presence::Away, Presence::Focused]
        );
        assert_eq!([1999, 2000, 9000].map(|ms| stop.renders(at(ms))), [true, false, false]);
        assert_eq!([0, 1000, 2999, 3000, 9000].map(|ms| stop.recentrings(at(ms))), [0, 1, 1, 2, 2]);
        assert_eq!(stop.end(), Some(at(4000)));
        let looped = script(&text.replace("END", "loop"));
        assert_eq!([3500, 4500, 5000, 7000].map(|ms| looped.recentrings(at(ms))), [2, 2, 3, 4]);
        assert_eq!((looped.presence(at(5000)), looped.end()), (Presence::Away, None));
    }

    #[test]
    fn a_recorded_session_is_done_again() {
        let place = |of, x: f32| Said::Place {
            of,
            at: at(0),
            location: RawLocation {
                pose: vergence_sense::RawPose {
                    position_m: [x, 0.0, 0.0],
                    orientation_xyzw: [0.0, 0.0, 0.0, 1.0],
                },
                validity: vergence_sense::Validity::ALL,
                velocity: None,
            },
        };
        // Session time began at 5 s.
        let frame = |ms: i64, x: f32, pull: f32| {
            vec![
                Said::Frame {
                    now: at(5000 + ms - 10),
                    display: at(5000 + ms),
                    period: Span::from_millis(10),
                    should_render: true,
                    raw_display: at(5000 + ms),
                    raw_period: Span::from_millis(10),
                },
                place(vergence_sense::Body::Head, x),
                place(vergence_sense::Body::Head, 9.0),
                place(vergence_sense::Body::Action(0, Hand::Right), x + 1.0),
                Said::Control {
                    action: 1,
                    hand: Hand::Right,
                    at: at(5000 + ms),
                    state: ControlState::Axis(vergence_sense::Axis(Some(pull))),
                },
            ]
        };
        let frames = [frame(10, 0.0, 0.0), frame(20, 1.0, 0.5), frame(15, 7.0, 0.7), frame(30, 2.0, 1.0)];
        let script = Script::of_session(frames.into_iter(), &[Some(Part::Aim), Some(Part::Squeeze)]);
        for (ms, x) in [(0, 0.0), (10, 0.0), (15, 0.5), (20, 1.0), (30, 2.0), (99, 2.0)] {
            let Tracked::Seen(head) = script.head(at(ms)) else { panic!("{ms}") };
            assert_eq!((head.translation.x, head.translation.y), (x, 1.6), "{ms}");
            let hand = script.controller(Hand::Right, at(ms));
            assert_eq!(hand.aim.pose().map(|aim| aim.translation.x), Some(x + 1.0), "{ms}");
        }
        assert_eq!(script.controller(Hand::Right, at(20)).squeeze, 0.5);
        assert_eq!(script.end(), Some(at(30)));
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, said) in [
            ("", "missing field `at-end`"),
            ("at-end = \"hold\"\n[[head]]\ntime = \"1\"", "s.toml:3"),
            (
                "at-end = \"hold\"\n[[head]]\ntime = \"-1 s\"",
                "s.toml:3:8: expected a time of 0 to 86400 s, found -1 s",
            ),
            (
                "at-end = \"hold\"\n[[head]]\ntime = \"1 s\"\n[[head]]\ntime = \"1 s\"",
                "s.toml:5:8: expected a time after 1 s, that of the keyframe before, found 1 s",
            ),
            (
                "at-end = \"hold\"\n[[left]]\ntime = \"0 s\"\ntrigger = nan",
                "s.toml:4:11: expected 0 to 1, found NaN",
            ),
            (
                "at-end = \"hold\"\n[[left]]\ntime = \"0 s\"\nstick = [0, -1.5]",
                "s.toml:4:9: expected -1 to 1, found -1.5",
            ),
            ("at-end = \"hold\"\n[[left]]\ntime = \"0 s\"\ngrab = 1", "unknown field `grab`"),
            (
                "at-end = \"hold\"\n[[head]]\ntime = \"0 s\"\nturned = [0, 0, 0, 2]",
                "s.toml:4:10: expected a unit quaternion x y z w",
            ),
            (
                "at-end = \"hold\"\nduration = \"1 s\"\n[[head]]\ntime = \"2 s\"",
                "s.toml:2:12: expected a duration of at least 2 s, the last keyframe, found 1 s",
            ),
        ] {
            let error = Script::parse(Path::new("s.toml"), text).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
