//! Scripts: what the simulated user does when, in keyframes.

mod file;
mod recorded;

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::{Rigid, slerp};
use vergence_sense::Hand;
use vergence_time::{Span, Timestamp};

use super::hand::grip_from_palm;
use super::track::Track;
use super::{AtEnd, Controller, HandPose, PoseProvider, Presence, Tracked, held_in_front};

pub use recorded::Part;

/// Where the eyes of a standing adult are, metres.
const EYES_M: [f64; 3] = [0.0, 1.6, 0.0];

/// How well a body is tracked, in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum RawTracking {
    Seen,
    Held,
    Lost,
}

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
    bare: [Bare; 2],
    /// In head coordinates.
    gaze: Body,
    /// In stage coordinates, where it was recorded.
    gaze_in_stage: Body,
    presence: Track<Presence>,
    render: Track<bool>,
    recentrings: Vec<Timestamp>,
}

/// The joints of a hand: from its palm and curls, or as they were recorded.
#[derive(Clone, Debug, Default)]
struct Bare {
    palm: Body,
    curls: Track<[f64; 5]>,
    recorded: Track<Option<Box<HandPose>>>,
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
    /// Of somebody who does nothing yet.
    fn empty(at_end: AtEnd) -> Self {
        Self {
            at_end,
            duration: Span::ZERO,
            head: Body::default(),
            hands: [Held::default(), Held::default()],
            bare: [Bare::default(), Bare::default()],
            gaze: Body::default(),
            gaze_in_stage: Body::default(),
            presence: Track::default(),
            render: Track::default(),
            recentrings: Vec::new(),
        }
    }

    /// The instant of the script at motion time `at`.
    fn instant(&self, at: Timestamp) -> Timestamp {
        let (nanos, duration) = (at.as_nanos(), self.duration.as_nanos());
        let looped = self.at_end == AtEnd::Loop && nanos > duration && duration > 0;
        Timestamp::from_nanos(if looped { nanos % duration } else { nanos })
    }
}

impl Body {
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

    fn hand(&self, hand: Hand, at: Timestamp) -> Option<HandPose> {
        let (instant, bare) = (self.instant(at), &self.bare[hand.index()]);
        if !bare.recorded.is_empty() {
            let mixed = bare.recorded.once_begun(instant, |a, b, t| match (a, b) {
                (Some(a), Some(b)) => Some(Box::new(a.between(b, t))),
                _ => a.clone(),
            });
            return mixed.flatten().map(|pose| *pose);
        }
        let held = self.controller(hand, at);
        let grip = held.grip.pose().or_else(|| held_in_front(&self.head(at), hand).grip.pose());
        let usual = grip.unwrap_or_else(Rigid::identity) * grip_from_palm(hand);
        let Some(palm) = bare.palm.at(instant, &usual) else { return HandPose::holding(&held, hand) };
        let curls = bare.curls.between(instant, |a, b, t| {
            std::array::from_fn(|finger| a[finger] + (b[finger] - a[finger]) * t)
        });
        HandPose::around(&palm, hand, curls.unwrap_or_default())
    }

    fn gaze(&self, at: Timestamp) -> Tracked {
        let instant = self.instant(at);
        if let Some(recorded) = self.gaze_in_stage.at(instant, &Rigid::identity()) {
            return recorded;
        }
        let head = self.head(at);
        match self.gaze.at(instant, &Rigid::identity()) {
            None => head,
            Some(Tracked::Lost) => Tracked::Lost,
            Some(Tracked::Held(turn)) => head.pose().map_or(Tracked::Lost, |head| Tracked::Held(head * turn)),
            Some(Tracked::Seen(turn)) => head.map(|head| head * turn),
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use vergence_sense::{ControlState, JOINTS_PER_HAND, RawJoints, RawLocation, Said};

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
    fn hands_curl_and_eyes_turn_against_the_head() {
        use vergence_sense::HandJoint as J;
        let script = script(
            r#"
            at-end = "hold"
            [[head]]
            time = "0 s"
            turned = { yaw = "90 deg" }
            [[gaze]]
            time = "0 s"
            turned = { yaw = "0 deg" }
            [[gaze]]
            time = "1 s"
            turned = { yaw = "-90 deg" }
            [[gaze]]
            time = "2 s"
            tracking = "lost"
            [[right-hand]]
            time = "0 s"
            position = ["0.2 m", "1 m", "-0.3 m"]
            curl = 0.0
            [[right-hand]]
            time = "1 s"
            curl = [0.5, 0.0, 1.0, 1.0, 1.0]
            [[right-hand]]
            time = "2 s"
            tracking = "held"
            [[left-hand]]
            time = "1 s"
            curl = 1.0
            "#,
        );
        let looks = |millis| script.gaze(at(millis)).pose().map(|gaze| gaze.rotation * -Vector3::z());
        for (millis, ahead) in [(0, -Vector3::x()), (1000, -Vector3::z())] {
            assert!((looks(millis).unwrap() - ahead).norm() < 1e-12, "{millis}");
        }
        assert_eq!((looks(2000), script.gaze(at(2000))), (None, Tracked::Lost));
        let joint = |hand: &HandPose, joint: J| hand.joints[joint as usize].0.translation.vector;
        let right = |millis| script.hand(Hand::Right, at(millis)).unwrap();
        assert_eq!(joint(&right(0), J::Palm), Vector3::new(0.2, 1.0, -0.3));
        let reach = |millis, tip| (joint(&right(millis), tip) - joint(&right(millis), J::Wrist)).norm();
        assert!(reach(1000, J::IndexTip) == reach(0, J::IndexTip), "the index finger stays");
        assert!(reach(0, J::LittleTip) > reach(500, J::LittleTip) + 0.01);
        assert!(reach(500, J::LittleTip) > reach(1000, J::LittleTip) + 0.01);
        assert_eq!([0, 2000].map(|millis| right(millis).is_tracked), [true, false]);
        // A hand that is only curled lies where it would hold a controller.
        let left = script.hand(Hand::Left, at(1500)).unwrap();
        let grip = script.controller(Hand::Left, at(1500)).grip.pose().unwrap();
        assert!((joint(&left, J::Palm) - grip.translation.vector).norm() < 1e-12);
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
        let hand = |x: f32| {
            let Said::Place { location, .. } = place(vergence_sense::Body::Head, x + 2.0) else { panic!() };
            let (pose, validity) = (location.pose, location.validity);
            let joints = [vergence_sense::RawJoint { pose, validity, radius_m: 0.01 }; JOINTS_PER_HAND];
            RawJoints { is_active: true, joints }
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
                place(vergence_sense::Body::Gaze, x - 1.0),
                Said::Joints { hand: Hand::Left, at: at(5000 + ms), joints: hand(x) },
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
            assert_eq!(script.gaze(at(ms)).pose().map(|gaze| gaze.translation.x), Some(x - 1.0), "{ms}");
            // Hands that were not seen yet are not seen.
            let thumb = script.hand(Hand::Left, at(ms)).map(|left| left.joints[5].0.translation.x);
            assert_eq!(thumb, (ms >= 10).then_some(x + 2.0), "{ms}");
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
                "at-end = \"hold\"\n[[left-hand]]\ntime = \"0 s\"\ncurl = 1.5",
                "s.toml:4:8: expected 0 to 1, of all fingers or of each, found 1.5",
            ),
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
