//! Two beliefs about the field, which differ in what a jump means while nothing turns; turning tells which is right.

use nalgebra::{UnitQuaternion, Vector3};

use super::field::{Calmness, Field, FieldWindow, Jump, TURNING};
use super::params::{VergenceCoefficients, VergenceParams};
use crate::filter::saved::saved;

/// Over this time of turning the deviations are compared, seconds.
const COMPARED_S: f64 = 3.0;
/// A belief whose deviation's mean square is less than this share of the other's takes over, once the other's is beyond the least.
const BETTER: f64 = 0.4;
const LEAST_UT2: f64 = 6.0;
/// How long the better belief must have been so before the other is given up, seconds of turning.
const GIVEN_UP_S: f64 = 5.0;

/// The first takes a jump for a magnet attached or removed: the offset follows. The second takes it for the room, where turning has
/// not confirmed the field: the field follows.
#[derive(Clone, Debug, PartialEq)]
pub struct Fields {
    magnet: Field,
    room: Field,
    /// Whether the second is believed.
    room_leads: bool,
    /// Mean squares of the deviations while turning, first and second, µT².
    apart: [f64; 2],
    /// Seconds of turning that are in them, up to what they are compared over.
    turned_s: f64,
    /// Seconds of turning for which the leader has been the better one.
    led_s: f64,
}

saved!(Fields { magnet, room, room_leads, apart, turned_s, led_s });

impl Fields {
    pub(super) fn new(params: &VergenceParams) -> Self {
        let field = Field::new(params);
        Self {
            magnet: field.clone(),
            room: field,
            room_leads: false,
            apart: [0.0; 2],
            turned_s: 0.0,
            led_s: 0.0,
        }
    }

    const fn leader(&self) -> &Field {
        if self.room_leads { &self.room } else { &self.magnet }
    }

    /// As [`Field::heading_rad`].
    pub(super) fn heading_rad(&self) -> Option<f64> {
        self.leader().heading_rad()
    }

    /// Offset of the magnetometer, microteslas.
    pub(super) fn offset_ut(&self) -> Vector3<f64> {
        self.leader().estimate.x.fixed_rows::<3>(3).into_owned()
    }

    /// Learns from one window.
    pub(super) fn learn(
        &mut self,
        window: &FieldWindow,
        calmness: Calmness,
        params: &VergenceParams,
        c: &VergenceCoefficients,
    ) {
        let magnet = self.magnet.learn(window, calmness, Jump::Magnet, params, c);
        let room = self.room.learn(window, calmness, Jump::Room, params, c);
        let rate = window.mean_rate();
        if rate < TURNING || calmness == Calmness::Settles {
            return;
        }
        let step_s = window.length_s;
        self.turned_s = (self.turned_s + step_s).min(COMPARED_S);
        let share = step_s / self.turned_s;
        for (mean, squared) in self.apart.iter_mut().zip([magnet, room]) {
            *mean += (squared - *mean) * share;
        }
        let (leads, follows) = if self.room_leads { (1, 0) } else { (0, 1) };
        if self.apart[follows] < BETTER * self.apart[leads]
            && self.apart[leads] > LEAST_UT2
            && self.turned_s >= 1.0
        {
            self.room_leads = !self.room_leads;
            self.led_s = 0.0;
        } else if self.apart[leads] <= self.apart[follows] {
            self.led_s += step_s;
        } else {
            self.led_s = 0.0;
        }
        if self.led_s >= GIVEN_UP_S {
            let leader = self.leader().clone();
            (self.magnet, self.room) = (leader.clone(), leader);
            self.apart = [self.apart[leads]; 2];
            self.room_leads = false;
            self.led_s = 0.0;
        }
    }

    /// The level frame was turned by `turn`.
    pub(super) fn turned(&mut self, turn: &UnitQuaternion<f64>) {
        self.magnet.turned(turn);
        self.room.turned(turn);
    }

    /// The heading is lost; the offset is not.
    pub(crate) fn lost(&mut self) {
        let mut leader = self.leader().clone();
        leader.lost();
        *self = Self {
            magnet: leader.clone(),
            room: leader,
            room_leads: false,
            apart: [0.0; 2],
            turned_s: 0.0,
            led_s: 0.0,
        };
    }
}
