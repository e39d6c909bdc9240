//! A session as the application lived it: what the runtime said and was told, call by call, in the order of the calls. A
//! recorder writes it down, a replay says it again, and two sessions are the same where this is.

use vergence_time::{Span, Timestamp};

use crate::{
    Axis, Button, CallResult, Event, FrameHash, Hand, Haptic, RawJoints, RawLocation, RawViews, Vector2,
};

/// What was located.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Body {
    /// The point between the eyes.
    Head,
    /// The floor's origin.
    Floor,
    /// Where the user looks.
    Gaze,
    /// A pose action: its place among the session's actions, and the hand.
    Action(u16, Hand),
}

/// What a control reads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ControlState {
    /// Pressed or not.
    Button(Button),
    /// Pulled.
    Axis(Axis),
    /// Pushed in a plane.
    Vector2(Vector2),
}

/// One call's answer, or what it was told.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "it is lent, not kept; a box would allocate in the frame loop")]
pub enum Said {
    /// Something happened. Events come before the frame after them.
    Event(Event),
    /// A frame was waited for.
    Frame {
        /// The session's clock now.
        now: Timestamp,
        /// When the frame is expected to be seen, after the guard against absurd times.
        display: Timestamp,
        /// The time between frames, after the guard.
        period: Span,
        /// A picture is wanted.
        should_render: bool,
        /// What the runtime gave for `display`.
        raw_display: Timestamp,
        /// What the runtime gave for `period`.
        raw_period: Span,
    },
    /// The eyes were located.
    Views {
        /// For which instant.
        at: Timestamp,
        /// In the space LOCAL.
        views: RawViews,
    },
    /// Something else was located.
    Place {
        /// What.
        of: Body,
        /// For which instant.
        at: Timestamp,
        /// In the space LOCAL.
        location: RawLocation,
    },
    /// A control was read.
    Control {
        /// Place of the action among the session's actions.
        action: u16,
        /// Whose.
        hand: Hand,
        /// For which instant.
        at: Timestamp,
        /// What it reads.
        state: ControlState,
    },
    /// The joints of a hand were located.
    Joints {
        /// Whose.
        hand: Hand,
        /// For which instant.
        at: Timestamp,
        /// In the space LOCAL.
        joints: RawJoints,
    },
    /// A hand was made to feel something.
    Haptic {
        /// Place of the action among the session's actions.
        action: u16,
        /// Whose.
        hand: Hand,
        /// What.
        haptic: Haptic,
    },
    /// A call did not simply succeed.
    Result(CallResult),
    /// The picture of an eye was hashed.
    Hash(FrameHash),
    /// The frame was ended.
    Submitted {
        /// For which instant.
        display: Timestamp,
        /// What the picture was drawn with, in the space LOCAL; `None` where there is no picture.
        views: Option<RawViews>,
    },
}

fn same_numbers(a: f64, b: f64) -> bool {
    a.to_bits() == b.to_bits()
}

impl ControlState {
    fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Button(a), Self::Button(b)) => a == b,
            (Self::Axis(a), Self::Axis(b)) => a.0.map(f32::to_bits) == b.0.map(f32::to_bits),
            (Self::Vector2(a), Self::Vector2(b)) => {
                a.0.map(|v| v.map(f32::to_bits)) == b.0.map(|v| v.map(f32::to_bits))
            }
            _ => false,
        }
    }
}

impl Said {
    /// Whether both say the same, bit for bit. The clock's reading ([`Said::Frame`], `now`) is left out: it says when an
    /// answer came, not what it was.
    pub fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Event(a), Self::Event(b)) => {
                (&a.name, &a.text, a.at) == (&b.name, &b.text, b.at)
                    && same_numbers(a.before, b.before)
                    && same_numbers(a.after, b.after)
            }
            (
                Self::Frame { now: _, display, period, should_render, raw_display, raw_period },
                Self::Frame {
                    now: _,
                    display: d,
                    period: p,
                    should_render: s,
                    raw_display: rd,
                    raw_period: rp,
                },
            ) => (display, period, should_render, raw_display, raw_period) == (d, p, s, rd, rp),
            (Self::Views { at, views }, Self::Views { at: a, views: v }) => at == a && views == v,
            (Self::Place { of, at, location }, Self::Place { of: o, at: a, location: l }) => {
                (of, at, location) == (o, a, l)
            }
            (
                Self::Control { action, hand, at, state },
                Self::Control { action: a, hand: h, at: t, state: s },
            ) => (action, hand, at) == (a, h, t) && state.is_same(s),
            (Self::Joints { hand, at, joints }, Self::Joints { hand: h, at: a, joints: j }) => {
                (hand, at) == (h, a) && joints == j
            }
            (Self::Haptic { action, hand, haptic }, Self::Haptic { action: a, hand: h, haptic: p }) => {
                (action, hand, haptic.duration) == (a, h, p.duration)
                    && haptic.amplitude.to_bits() == p.amplitude.to_bits()
                    && haptic.frequency_hz.map(f32::to_bits) == p.frequency_hz.map(f32::to_bits)
            }
            (Self::Result(a), Self::Result(b)) => {
                (&a.call, a.nth, a.in_frame, a.code) == (&b.call, b.nth, b.in_frame, b.code)
            }
            (Self::Hash(a), Self::Hash(b)) => a == b,
            (Self::Submitted { display, views }, Self::Submitted { display: d, views: v }) => {
                (display, views) == (d, v)
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{RawPose, Validity};

    #[test]
    fn the_same_is_the_same_in_every_bit() {
        let event = |after| Said::Event(Event { after, ..Event::new("refresh_rate", "") });
        assert!(event(f64::NAN).is_same(&event(f64::NAN)));
        assert!(!event(0.0).is_same(&event(-0.0)));
        let frame = |now, display| Said::Frame {
            now: Timestamp::from_nanos(now),
            display: Timestamp::from_nanos(display),
            period: Span::from_millis(11),
            should_render: true,
            raw_display: Timestamp::from_nanos(display),
            raw_period: Span::from_millis(11),
        };
        assert!(frame(1, 5).is_same(&frame(2, 5)) && !frame(1, 5).is_same(&frame(1, 6)));
        let control = |state| Said::Control {
            action: 1,
            hand: Hand::Left,
            at: Timestamp::default(),
            state: ControlState::Axis(Axis(state)),
        };
        assert!(control(Some(f32::NAN)).is_same(&control(Some(f32::NAN))));
        assert!(!control(Some(0.0)).is_same(&control(None)));
        let place = |x| Said::Place {
            of: Body::Head,
            at: Timestamp::default(),
            location: RawLocation {
                pose: RawPose { position_m: [x, 0.0, 0.0], ..RawPose::IDENTITY },
                validity: Validity::ALL,
                velocity: None,
            },
        };
        assert!(place(1.0).is_same(&place(1.0)) && !place(0.0).is_same(&place(-0.0)));
        assert!(!place(1.0).is_same(&frame(1, 1)));
    }
}
