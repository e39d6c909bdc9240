//! Leads one participant through a plan. Pure: fed with readings, reads no clock.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use vergence_study::{
    CursorSample, Geometry, Instruction, Plan, PlannedTrial, Point, Study, Target, Trial, Trigger, layout,
};
use vergence_time::{Span, Timestamp};

use crate::error::Error;
use crate::record::{Place, Record};

/// A movement whose cursor is not known for longer is made again, seconds.
const BLIND_S: f64 = 0.2;
/// So is one in which so much time passes between two readings, seconds: the headset was off, or the session was lost.
const GAP_S: f64 = 0.5;
/// A movement with more samples is made again: nobody moves for that long (11 minutes at 150 Hz, 100 s at 1 kHz), and the log
/// takes no more at once.
const MOST_SAMPLES: usize = 100_000;
/// Samples for which there is room from the beginning: 20 s at 90 Hz.
const ROOM: usize = 1800;

/// What the hand does at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Session time.
    pub at: Timestamp,
    /// Where the cursor is, in the coordinates of [`Target::centre`]; `None` where that is not known.
    pub cursor: Option<Point>,
    /// The trigger (the button of a mouse, a finger on the surface) is pressed.
    pub pressed: bool,
}

/// Where to go now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Centre of the target, as [`Target::centre`].
    pub centre: Point,
    /// Its width, as [`Target::width`].
    pub width: Option<f64>,
    /// It is the start of a sequence: selecting it is no trial.
    pub is_start: bool,
    /// Place of the instruction in [`Study::instructions`].
    pub instruction: usize,
    /// Place in its sequence.
    pub index: u32,
    /// Movement time that the study predicts, seconds.
    pub predicted_s: f64,
}

/// What the participant is to see beside the targets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Showing<'a> {
    /// A sequence is ahead, under this instruction.
    Instruction(&'a Instruction),
    /// Nothing: a movement is under way.
    Movement,
    /// A rest, seconds that are left.
    Break(f64),
    /// All is done.
    Done,
}

/// What a reading led to.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Nothing that has an end.
    Nothing,
    /// The start was selected: the first movement begins.
    Began,
    /// A trial has ended. It has to be on the disk before the next reading is followed.
    Trial(Box<Record>),
    /// The movement under way is made again, from the start: why.
    Interrupted(&'static str),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Start,
    Moving { began: Timestamp, start: Point, left_tunnel: bool },
    Break { until: Timestamp },
    Done,
}

/// Where a participant is in their plan, and what happens next.
#[derive(Clone, Debug)]
pub struct Course {
    study: Study,
    plan: Plan,
    place: Place,
    /// Misses that count, in the sequence under way.
    errors: u32,
    phase: Phase,
    targets: Vec<Target>,
    samples: Vec<CursorSample>,
    was_pressed: bool,
    /// Since when the cursor has been inside of the goal.
    inside_since: Option<Timestamp>,
    latest: Option<Timestamp>,
    seen: Option<Timestamp>,
}

impl Course {
    /// At the beginning of a participant's plan.
    pub fn new(study: &Study, participant: &str) -> Self {
        let mut course = Self {
            study: study.clone(),
            plan: study.plan(participant),
            place: Place::default(),
            errors: 0,
            phase: Phase::Start,
            targets: Vec::new(),
            samples: Vec::with_capacity(ROOM),
            was_pressed: true,
            inside_since: None,
            latest: None,
            seen: None,
        };
        if course.planned().is_none() {
            course.phase = Phase::Done;
        }
        course.lay_out();
        course
    }

    /// Goes on behind trials that were finished earlier, in their order.
    ///
    /// # Errors
    /// Where one is not the next of the plan.
    pub fn resume<'a>(&mut self, records: impl IntoIterator<Item = &'a Record>) -> Result<(), Error> {
        for record in records {
            if record.place != self.place || self.phase == Phase::Done {
                let Place { block, trial, attempt } = record.place;
                let Place { block: b, trial: t, attempt: a } = self.place;
                return Err(Error::Call(format!(
                    "expected trial {} of block {} (attempt {}) next, found trial {} of block {} (attempt {}): something \
                     is missing or there twice; `study status` says what",
                    t + 1,
                    b + 1,
                    a + 1,
                    trial + 1,
                    block + 1,
                    attempt + 1
                )));
            }
            self.advance(record.trial.error == Some(true), None);
        }
        if matches!(self.phase, Phase::Break { .. } | Phase::Moving { .. }) {
            self.phase = Phase::Start;
        }
        Ok(())
    }

    /// The study.
    pub fn study(&self) -> &Study {
        &self.study
    }

    /// Where the next trial is in the plan.
    pub fn place(&self) -> Place {
        self.place
    }

    /// Trials of the plan, repeats not counted, and how many of them are behind.
    pub fn progress(&self) -> (usize, usize) {
        let before: usize =
            self.plan.blocks.iter().take(self.place.block as usize).map(|block| block.trials.len()).sum();
        let all = self.plan.blocks.iter().map(|block| block.trials.len()).sum();
        (before + self.place.trial as usize, all)
    }

    /// Nothing is left to do.
    pub fn is_done(&self) -> bool {
        self.phase == Phase::Done
    }

    /// Where to go now; `None` in breaks and at the end.
    pub fn goal(&self) -> Option<Goal> {
        let planned = self.planned()?;
        let (target, is_start) = match self.phase {
            Phase::Start => (planned.from, true),
            Phase::Moving { .. } => (planned.to, false),
            Phase::Break { .. } | Phase::Done => return None,
        };
        Some(Goal {
            centre: target.centre,
            width: target.width,
            is_start,
            instruction: self.plan.blocks[self.place.block as usize].instruction,
            index: planned.index,
            predicted_s: planned.predicted_s,
        })
    }

    /// All targets of the sequence under way.
    pub fn targets(&self) -> &[Target] {
        if matches!(self.phase, Phase::Start | Phase::Moving { .. }) { &self.targets } else { &[] }
    }

    /// What to show beside them.
    pub fn showing(&self) -> Showing<'_> {
        match self.phase {
            Phase::Start => {
                let instruction =
                    self.plan.blocks.get(self.place.block as usize).map_or(0, |b| b.instruction);
                Showing::Instruction(&self.study.instructions[instruction])
            }
            Phase::Moving { .. } => Showing::Movement,
            Phase::Break { until } => {
                let left = self.latest.and_then(|now| until.since(now)).map_or(0.0, Span::as_secs_f64);
                Showing::Break(left.max(0.0))
            }
            Phase::Done => Showing::Done,
        }
    }

    /// The session of the next trial, counted from 1, as it is written into trials; of the last one where all is done.
    pub fn session(&self) -> String {
        let block = self.plan.blocks.get(self.place.block as usize).or(self.plan.blocks.last());
        (1 + block.map_or(0, |block| block.session)).to_string()
    }

    /// Whether the next trial is the first of a sitting behind others (see [`Study::sessions`]).
    pub fn is_between_sessions(&self) -> bool {
        let session = |block: u32| self.plan.blocks.get(block as usize).map(|block| block.session);
        let Place { block, trial, attempt } = self.place;
        (trial, attempt) == (0, 0)
            && block > 0
            && session(block).is_some_and(|own| session(block - 1) != Some(own))
    }

    /// Where the block stands that is under way or comes next, in the study's order of instructions.
    pub fn instruction(&self) -> Option<&Instruction> {
        let block = self.plan.blocks.get(self.place.block as usize)?;
        self.study.instructions.get(block.instruction)
    }

    /// Levels of the other factors in the next trial.
    pub fn factors(&self) -> Option<&BTreeMap<String, String>> {
        self.planned().map(|planned| &planned.factors)
    }

    /// Dimensions of the ends: 1 on a line, 2 on a plane (`flat`: a screen) and for angles, else 3.
    pub fn dimensions(&self, flat: bool) -> usize {
        match self.study.geometry {
            Geometry::Reciprocal | Geometry::Edge => 1,
            Geometry::Ray { .. } | Geometry::Corner => 2,
            Geometry::Ring { .. } | Geometry::Depth | Geometry::Steering => 2 + usize::from(!flat),
        }
    }

    /// The unit of lengths in records.
    pub fn length_unit(&self) -> &'static str {
        if matches!(self.study.geometry, Geometry::Ray { .. }) { "rad" } else { "m" }
    }

    /// Follows one reading. Times must ascend; where they do not, the movement under way is made again.
    pub fn follow(&mut self, reading: &Reading) -> Step {
        let passed = self.latest.and_then(|latest| reading.at.since(latest)).map_or(0.0, Span::as_secs_f64);
        self.latest = Some(reading.at);
        let pressed = reading.pressed && !self.was_pressed;
        self.was_pressed = reading.pressed;
        match self.phase {
            Phase::Done => Step::Nothing,
            Phase::Break { until } => {
                if passed < 0.0 || reading.at >= until {
                    self.phase = Phase::Start;
                }
                Step::Nothing
            }
            Phase::Start => {
                let Some(cursor) = reading.cursor else { return Step::Nothing };
                let Some(from) = self.planned().map(|planned| planned.from) else { return Step::Nothing };
                let inside = self.is_in(&from, cursor);
                if self.selects(pressed, inside, reading.at) && inside {
                    self.begin(reading.at, cursor);
                    return Step::Began;
                }
                Step::Nothing
            }
            Phase::Moving { .. } => {
                if !(0.0..=GAP_S).contains(&passed) {
                    return self.interrupt("no reading for a while, or a clock that went back");
                }
                self.moved(reading, pressed)
            }
        }
    }

    fn moved(&mut self, reading: &Reading, pressed: bool) -> Step {
        let Phase::Moving { began, start, .. } = self.phase else { return Step::Nothing };
        let at = reading.at;
        let Some(cursor) = reading.cursor else {
            let blind = self.seen.and_then(|seen| at.since(seen)).map_or(0.0, Span::as_secs_f64);
            return if blind > BLIND_S { self.interrupt("the cursor was lost") } else { Step::Nothing };
        };
        self.seen = Some(at);
        if self.samples.len() >= MOST_SAMPLES {
            return self.interrupt("nothing was selected for very long");
        }
        let t_s = at.since(began).map_or(0.0, Span::as_secs_f64);
        self.samples.push(CursorSample { t_s, position: cursor });
        let Some(planned) = self.planned() else { return Step::Nothing };
        let to = planned.to;
        if self.study.geometry == Geometry::Steering {
            let half = 0.5 * to.width.unwrap_or(f64::INFINITY);
            if let Phase::Moving { left_tunnel, .. } = &mut self.phase {
                *left_tunnel |= cursor[1].abs() > half;
            }
            let ahead = to.centre[0].signum();
            if ahead * (cursor[0] - to.centre[0]) < 0.0 {
                return Step::Nothing;
            }
            let error = matches!(self.phase, Phase::Moving { left_tunnel: true, .. });
            return self.end(at, start, cursor, t_s, error);
        }
        let inside = self.is_in(&to, cursor);
        if !self.selects(pressed, inside, at) {
            return Step::Nothing;
        }
        // Of a dwell as of a press: time and end are of the moment of selection, the rest included.
        self.end(at, start, cursor, t_s, !inside)
    }

    /// Whether the target is selected now: by pressing, anywhere, or by resting inside for long enough.
    fn selects(&mut self, pressed: bool, inside: bool, at: Timestamp) -> bool {
        if self.study.trigger != Trigger::Dwell {
            return pressed;
        }
        if !inside {
            self.inside_since = None;
            return false;
        }
        let since = *self.inside_since.get_or_insert(at);
        let rested = at.since(since).map_or(0.0, Span::as_secs_f64) >= self.study.dwell_s;
        if rested {
            self.inside_since = None;
        }
        rested
    }

    fn begin(&mut self, at: Timestamp, start: Point) {
        self.phase = Phase::Moving { began: at, start, left_tunnel: false };
        self.samples.clear();
        self.samples.push(CursorSample { t_s: 0.0, position: start });
        self.seen = Some(at);
        self.inside_since = None;
    }

    fn interrupt(&mut self, why: &'static str) -> Step {
        self.phase = Phase::Start;
        self.inside_since = None;
        Step::Interrupted(why)
    }

    fn end(&mut self, at: Timestamp, start: Point, end: Point, mt_s: f64, error: bool) -> Step {
        let (Some(planned), Phase::Moving { began, .. }) = (self.planned(), self.phase) else {
            return Step::Nothing;
        };
        let block = &self.plan.blocks[self.place.block as usize];
        let instruction = &self.study.instructions[block.instruction];
        let (from, to) = (planned.from.centre, planned.to.centre);
        let said = |point: Point| match self.study.geometry {
            Geometry::Ray { .. } => angles(to, point),
            _ => point,
        };
        let band = |[least, most]: [f64; 2]| {
            let dwell_s = if self.study.trigger == Trigger::Dwell { self.study.dwell_s } else { 0.0 };
            let share = (mt_s - dwell_s) / planned.predicted_s;
            !(least..=most).contains(&share)
        };
        let samples = self.samples.iter().map(|s| CursorSample { position: said(s.position), ..*s });
        let distance = |a: Point, b: Point| (Vector3::from(a) - Vector3::from(b)).norm();
        let trial = Trial {
            participant: self.plan.participant.clone(),
            session: self.session(),
            block: self.block_name(),
            condition: planned.condition.clone(),
            instruction: (self.study.instructions.len() > 1).then(|| instruction.name.clone()),
            factors: planned.factors.clone(),
            index: planned.index,
            practice: planned.practice,
            attempt: self.place.attempt,
            repeated: false,
            amplitude: Some(distance(said(from), said(to))),
            width: planned.to.width,
            from: Some(said(from)),
            to: said(to),
            start: Some(said(start)),
            end: said(end),
            mt_s,
            error: Some(error),
            samples: samples.collect(),
            measured: None,
            spatial_outlier: None,
            temporal_outlier: instruction.band.map(band),
        };
        let record = Record { trial, place: self.place, began, wall_ns: 0 };
        self.advance(error, Some(at));
        if let Phase::Start = self.phase
            && self.place.trial > 0
            && !self.place.trial.is_multiple_of(self.sequence())
        {
            // Within a sequence, the next movement begins where and when this one has ended.
            self.begin(at, end);
        }
        Step::Trial(Box::new(record))
    }

    /// Trials of a sequence.
    fn sequence(&self) -> u32 {
        (self.study.practice + self.study.per_condition).max(1)
    }

    /// Behind the trial under way.
    fn advance(&mut self, error: bool, at: Option<Timestamp>) {
        let Some((practice, block_ends)) = self.planned().map(|planned| {
            let block = &self.plan.blocks[self.place.block as usize];
            (planned.practice, self.place.trial as usize + 1 == block.trials.len())
        }) else {
            return;
        };
        self.errors += u32::from(error && !practice);
        self.phase = Phase::Start;
        let length = self.sequence();
        if !(self.place.trial + 1).is_multiple_of(length) {
            self.place.trial += 1;
            return;
        }
        let share = f64::from(self.errors) / f64::from(self.study.per_condition.max(1));
        self.errors = 0;
        if self.study.repeat_above_error.is_some_and(|most| share > most)
            && self.place.attempt < self.study.most_repeats
        {
            self.place =
                Place { trial: self.place.trial + 1 - length, attempt: self.place.attempt + 1, ..self.place };
        } else if !block_ends {
            self.place = Place { trial: self.place.trial + 1, attempt: 0, ..self.place };
        } else {
            self.place = Place { block: self.place.block + 1, trial: 0, attempt: 0 };
            let rest = Span::from_secs_f64(self.study.break_s).filter(|_| self.study.break_s > 0.0);
            if self.planned().is_none() {
                self.phase = Phase::Done;
            } else if self.is_between_sessions() {
                // The rest is a night.
            } else if let Some((at, rest)) = at.zip(rest) {
                self.phase = Phase::Break { until: at.saturating_add(rest) };
            }
        }
        self.lay_out();
    }

    fn planned(&self) -> Option<&PlannedTrial> {
        self.plan.blocks.get(self.place.block as usize)?.trials.get(self.place.trial as usize)
    }

    fn lay_out(&mut self) {
        self.targets.clear();
        if let Some(size) = self.planned().map(|planned| planned.size) {
            self.targets = layout(self.study.geometry, size.amplitude, size.width.unwrap_or(0.0));
            // The last is the first again.
            self.targets.pop();
        }
    }

    /// The block's number, with the repetition's where conditions are repeated within blocks.
    fn block_name(&self) -> String {
        let number = self.place.block + 1;
        if self.study.repetitions <= 1 {
            return number.to_string();
        }
        let conditions = self.study.conditions().len() as u32;
        format!("{number}.{}", self.place.trial / (conditions * self.sequence()) + 1)
    }

    fn is_in(&self, target: &Target, cursor: Point) -> bool {
        let half = target.width.map(|width| 0.5 * width);
        let off = Vector3::from(cursor) - Vector3::from(target.centre);
        match (self.study.geometry, half) {
            (Geometry::Edge | Geometry::Corner, _) | (_, None) => {
                // Beyond the line, to each side to which the target is away from the middle.
                let sides = if self.study.geometry == Geometry::Corner { 0..2 } else { 0..1 };
                sides.into_iter().all(|i| target.centre[i].signum() * cursor[i] >= target.centre[i].abs())
            }
            (Geometry::Reciprocal, Some(half)) => off[0].abs() <= half,
            (Geometry::Ray { .. }, Some(half)) => {
                let [x, y, _] = angles(target.centre, cursor);
                x.hypot(y) <= half
            }
            (Geometry::Ring { .. } | Geometry::Depth | Geometry::Steering, Some(half)) => off.norm() <= half,
        }
    }
}

/// Where a point is seen from the origin, in radians to the right of and above another one (azimuthal equidistant about
/// that): distances from it are exact angles.
fn angles(centre: Point, point: Point) -> Point {
    let ahead = Vector3::from(centre).try_normalize(0.0).unwrap_or(-Vector3::z());
    let Some(seen) = Vector3::from(point).try_normalize(0.0) else { return [0.0; 3] };
    let right = ahead.cross(&Vector3::y()).try_normalize(1e-9).unwrap_or(Vector3::x());
    let up = right.cross(&ahead);
    let (x, y) = (seen.dot(&right), seen.dot(&up));
    let off = x.hypot(y);
    let angle = off.atan2(seen.dot(&ahead));
    if off > 0.0 { [angle * x / off, angle * y / off, 0.0] } else { [angle, 0.0, 0.0] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use vergence_study::TEMPLATE;

    fn study(change: impl Fn(String) -> String) -> Study {
        Study::parse("t.toml".as_ref(), &change(TEMPLATE.to_owned())).unwrap()
    }

    fn at(ms: i64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    /// Clicks where `aim` says, every half second; the records until the course is done or `most` trials have ended.
    fn clicked(
        course: &mut Course,
        from_ms: i64,
        most: usize,
        aim: impl Fn(&Goal, usize) -> Point,
    ) -> Vec<Record> {
        let mut records = Vec::new();
        let mut ms = from_ms;
        while records.len() < most && !course.is_done() {
            let Some(goal) = course.goal() else {
                course.follow(&Reading { at: at(ms), cursor: None, pressed: false });
                ms += 100;
                continue;
            };
            let cursor = Some(aim(&goal, records.len()));
            for step in 0..5 {
                let reading = Reading { at: at(ms + 100 * step), cursor, pressed: step == 4 };
                if let Step::Trial(record) = course.follow(&reading) {
                    records.push(*record);
                }
            }
            ms += 500;
        }
        records
    }

    #[test]
    fn a_session_is_the_plan() {
        let study = study(|text| text.replace("60 s", "1 s"));
        let mut course = Course::new(&study, "P07");
        let records = clicked(&mut course, 0, usize::MAX, |goal, _| goal.centre);
        let plan = study.plan("P07");
        let planned: Vec<&PlannedTrial> = plan.blocks.iter().flat_map(|block| &block.trials).collect();
        assert_eq!((records.len(), course.progress()), (540, (540, 540)));
        for (record, planned) in records.iter().zip(planned) {
            let trial = &record.trial;
            assert_eq!(
                (&trial.condition, trial.index, trial.to),
                (&planned.condition, planned.index, planned.to.centre)
            );
            assert!(trial.error == Some(false) && trial.start == trial.from && trial.end == trial.to);
            assert!((trial.mt_s - 0.5).abs() < 1e-12 || trial.index == 0, "{}", trial.mt_s);
            assert!(trial.samples.len() > 4 && trial.samples[0].t_s == 0.0);
            assert_eq!(trial.samples.last().map(|s| s.t_s), Some(trial.mt_s));
        }
        assert!(matches!(course.showing(), Showing::Done));
    }

    #[test]
    fn misses_count_and_sequences_with_too_many_are_repeated_once() {
        let study = study(|text| text);
        let mut course = Course::new(&study, "P01");
        let beside = |goal: &Goal, _| {
            let off = if goal.is_start { 0.0 } else { 0.6 * goal.width.unwrap() };
            [goal.centre[0] + off, goal.centre[1], goal.centre[2]]
        };
        let records = clicked(&mut course, 0, 45, beside);
        assert!(records.iter().all(|record| record.trial.error == Some(true)));
        let attempts: Vec<u32> = records.iter().step_by(15).map(|record| record.place.attempt).collect();
        assert_eq!(attempts, [0, 1, 0]);
        assert_eq!((records[15].place.trial, records[30].place.trial), (0, 15));
    }

    #[test]
    fn a_start_that_is_missed_begins_nothing() {
        let study = study(|text| text);
        let mut course = Course::new(&study, "P01");
        let far = Some([1.0, 1.0, 1.0]);
        for ms in 0..50 {
            let reading = Reading { at: at(100 * ms), cursor: far, pressed: ms % 2 == 1 };
            assert_eq!(course.follow(&reading), Step::Nothing);
        }
        assert!(course.goal().unwrap().is_start);
    }

    #[test]
    fn who_is_interrupted_makes_the_movement_again() {
        let study = study(|text| text);
        for (gap_ms, blind) in [(600, false), (-50, false), (250, true)] {
            let mut course = Course::new(&study, "P01");
            let done = clicked(&mut course, 0, 3, |goal, _| goal.centre);
            let (place, now) = (course.place(), 10_000);
            // The fourth movement is under way since 2 s.
            let went_on = Reading { at: at(2_100), cursor: Some([0.0; 3]), pressed: false };
            assert_eq!(course.follow(&went_on), Step::Nothing, "{done:?}");
            let cursor = (!blind).then_some([0.0; 3]);
            let reading = Reading { at: at(2_100 + gap_ms), cursor, pressed: true };
            assert!(matches!(course.follow(&reading), Step::Interrupted(_)), "{gap_ms} {blind}");
            assert!(course.goal().unwrap().is_start && course.place() == place);
            let goes_on = clicked(&mut course, now, 1, |goal, _| goal.centre);
            assert_eq!((goes_on[0].place, goes_on[0].trial.samples[0].t_s), (place, 0.0));
            assert!(goes_on[0].began >= at(now));
        }
    }

    #[test]
    fn resting_selects_and_time_and_end_are_of_that_moment() {
        let study = study(|text| text.replace("by = \"trigger\"", "by = \"dwell\""));
        let mut course = Course::new(&study, "P01");
        let mut ended = None;
        for ms in (0..4_000).step_by(10) {
            let goal = course.goal().unwrap();
            // Reaches the target 300 ms after the start was selected.
            let cursor = Some(if goal.is_start || ms >= 500 + 300 { goal.centre } else { [0.0; 3] });
            if let Step::Trial(record) = course.follow(&Reading { at: at(ms), cursor, pressed: false }) {
                ended = Some(record);
                break;
            }
        }
        let ended = ended.unwrap();
        assert!(
            (ended.trial.mt_s - 0.8).abs() < 1e-9 && ended.trial.error == Some(false),
            "{}",
            ended.trial.mt_s
        );
        assert_eq!(ended.trial.samples.last().map(|sample| sample.position), Some(ended.trial.end));
    }

    #[test]
    fn who_walks_away_makes_the_movement_again() {
        let study = study(|text| text);
        let mut course = Course::new(&study, "P01");
        let done = clicked(&mut course, 0, 2, |goal, _| goal.centre);
        let place = course.place();
        let went = (1..=MOST_SAMPLES as i64 + 1).map(|ms| {
            course.follow(&Reading {
                at: at(done.len() as i64 * 500 + 400 + ms),
                cursor: Some([0.0; 3]),
                pressed: false,
            })
        });
        let steps: Vec<Step> = went.filter(|step| *step != Step::Nothing).collect();
        assert!(matches!(steps[..], [Step::Interrupted(_)]), "{steps:?}");
        assert!(course.goal().unwrap().is_start && course.place() == place);
    }

    #[test]
    fn sittings_end_between_sessions() {
        let study = study(|text| text.replace("# sessions = 2", "sessions = 2"));
        let mut course = Course::new(&study, "P07");
        let first = clicked(&mut course, 0, 540, |goal, _| goal.centre);
        assert!(course.is_between_sessions() && !course.is_done() && course.goal().unwrap().is_start);
        assert!(first.iter().all(|record| record.trial.session == "1"));
        let mut later = Course::new(&study, "P07");
        later.resume(&first).unwrap();
        assert!(later.is_between_sessions());
        let second = clicked(&mut later, 0, usize::MAX, |goal, _| goal.centre);
        assert!(second.len() == 540 && second.iter().all(|record| record.trial.session == "2"));
        assert!(later.is_done() && !later.is_between_sessions() && later.progress() == (1080, 1080));
    }

    #[test]
    fn edges_and_corners_have_no_far_side() {
        for (kind, inside, beside) in [("edge", [9.0, 7.0], [0.05, 7.0]), ("corner", [9.0, 9.0], [9.0, 0.05])]
        {
            let study = study(|text| {
                let text = text.replace("kind = \"ring\"", &format!("kind = \"{kind}\""));
                text.replace("widths = [\"0.01 m\", \"0.02 m\", \"0.03 m\", \"0.04 m\"]", "")
            });
            let aim = |goal: &Goal, off: [f64; 2]| {
                let [x, y, _] = goal.centre;
                [x.signum() * off[0], if kind == "corner" { y.signum() * off[1] } else { off[1] }, 0.0]
            };
            let at = |goal: &Goal, n: usize| {
                aim(goal, if goal.is_start || n.is_multiple_of(2) { inside } else { beside })
            };
            let records = clicked(&mut Course::new(&study, "P01"), 0, 8, at);
            for (n, record) in records.iter().enumerate() {
                assert_eq!((record.trial.error, record.trial.width), (Some(n % 2 == 1), None), "{kind} {n}");
            }
        }
    }

    #[test]
    fn a_tunnel_is_left_or_not() {
        let steering = study(|text| text.replace("kind = \"ring\"", "kind = \"steering\""));
        for (off, error) in [(0.0, false), (1.0, true)] {
            let mut course = Course::new(&steering, "P01");
            let from = course.goal().unwrap();
            for (ms, pressed) in [(0, false), (10, true), (20, false)] {
                course.follow(&Reading { at: at(ms), cursor: Some(from.centre), pressed });
            }
            let to = course.goal().unwrap();
            assert_eq!(to.centre[0], -from.centre[0]);
            let middle =
                Reading { at: at(100), cursor: Some([0.0, off * to.width.unwrap(), 0.0]), pressed: false };
            assert_eq!(course.follow(&middle), Step::Nothing);
            let there = Reading { at: at(210), cursor: Some(to.centre), pressed: false };
            let Step::Trial(record) = course.follow(&there) else {
                panic!("the end of the tunnel ends the trial")
            };
            assert_eq!((record.trial.error, record.trial.mt_s), (Some(error), 0.2));
        }
    }

    #[test]
    fn rays_are_recorded_in_radians() {
        let rays = study(|text| {
            let text = text.replace("kind = \"ring\"", "kind = \"ray\"");
            let text =
                text.replace("[\"0.15 m\", \"0.25 m\", \"0.35 m\"]", "[\"10 deg\", \"30 deg\", \"60 deg\"]");
            text.replace(
                "[\"0.01 m\", \"0.02 m\", \"0.03 m\", \"0.04 m\"]",
                "[\"1 deg\", \"2 deg\", \"3 deg\", \"4 deg\"]",
            )
        });
        let mut course = Course::new(&rays, "P01");
        assert_eq!((course.length_unit(), course.dimensions(false)), ("rad", 2));
        // A hand's breadth beside the middle, at twice the distance: the same direction.
        let records = clicked(&mut course, 0, 15, |goal, _| goal.centre.map(|x| 2.0 * x));
        for record in &records {
            let trial = &record.trial;
            assert!(trial.error == Some(false) && trial.to.iter().all(|x| x.abs() < 1e-12), "{trial:?}");
            assert!(trial.end.iter().all(|x| x.abs() < 1e-12));
            let (Some(from), Some(amplitude)) = (trial.from, trial.amplitude) else { panic!("{trial:?}") };
            assert!((from[0].hypot(from[1]) - amplitude).abs() < 1e-12);
        }
        // Opposite targets of an odd ring are nearly the diameter apart, and their angle is that of the vectors.
        let first = &records[0];
        let planned = &rays.plan("P01").blocks[0].trials[0];
        let (a, b) = (planned.from.centre, planned.to.centre);
        let angle = Vector3::from(a).angle(&Vector3::from(b));
        assert!((first.trial.amplitude.unwrap() - angle).abs() < 1e-9);
    }

    #[test]
    fn a_course_goes_on_where_it_was_left() {
        let study = study(|text| text.replace("60 s", "1 s"));
        let aim = |goal: &Goal, n: usize| {
            let off = if goal.is_start || !n.is_multiple_of(3) { 0.0 } else { 0.7 * goal.width.unwrap() };
            [goal.centre[0], goal.centre[1] + off, goal.centre[2]]
        };
        let whole = clicked(&mut Course::new(&study, "P03"), 0, usize::MAX, aim);
        for cut in [0, 1, 14, 15, 16, 179, 180, 300, whole.len()] {
            let mut course = Course::new(&study, "P03");
            course.resume(&whole[..cut]).unwrap();
            assert_eq!(course.is_done(), cut == whole.len());
            assert_eq!(whole.get(cut).map_or(course.place(), |next| next.place), course.place(), "{cut}");
        }
        let mut course = Course::new(&study, "P03");
        let error = course.resume(&whole[1..3]).unwrap_err().to_string();
        assert!(error.contains("expected trial 1 of block 1"), "{error}");
    }

    proptest! {
        /// Whatever the readings, nothing panics and places ascend.
        #[test]
        fn any_readings_are_followed(readings in proptest::collection::vec((any::<i32>(), any::<bool>(), any::<bool>(), -1.0f64..1.0), 0..200)) {
            let mut course = Course::new(&study(|text| text), "P05");
            let mut last = course.place();
            for (ms, seen, pressed, x) in readings {
                let cursor = seen.then(|| course.goal().map_or([x; 3], |goal| if x > 0.0 { goal.centre } else { [x; 3] }));
                course.follow(&Reading { at: at(i64::from(ms)), cursor, pressed });
                prop_assert!(course.place() >= last || course.place().attempt > last.attempt);
                last = course.place();
                let _ = (course.showing(), course.targets());
            }
        }
    }
}
