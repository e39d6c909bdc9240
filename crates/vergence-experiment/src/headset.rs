//! A study in a headset, real or simulated.

use std::cell::RefCell;
use std::sync::Arc;

use nalgebra::{Point3, Translation3, Vector3};
use vergence_geom::{Ray, Rigid};
use vergence_sense::Hand;
use vergence_session::{
    Guest, Happening, HeadsetChoice, Moment, PoseProvider, RunConfig, RunReport, Stage, run_with,
};
use vergence_study::{Geometry, Plane, Point, Study, Trigger};
use vergence_time::Timestamp;

use crate::conduct::{Conduct, Ended};
use crate::course::{Reading, Step};
use crate::error::Error;
use crate::input::Input;
use crate::stimuli::{Stimuli, Words};
use crate::wearer::{Actor, TIP_M, Wearer};

/// The task's centre is so far below the eyes, metres: arms tire at eye height. Rays are centred on the eyes.
const BELOW_EYES_M: f64 = 0.2;
/// A simulated person who ends no trial for so long is lost, seconds.
const LOST_S: f64 = 120.0;

/// What a sitting in a headset needs to know beside its study.
#[derive(Clone, Debug)]
pub struct InHeadset {
    /// Which headset, and everything else about the run. [`HeadsetChoice::Auto`] is refused: a study never falls back.
    pub run: RunConfig,
    /// What moves the cursor.
    pub input: Input,
    /// On the simulated headset: the runtime asks for pictures. Without, nothing is drawn, and everything else happens.
    pub pictures: bool,
    /// On the simulated headset: from when to when its wearer takes it off, session time.
    pub away: Option<(Timestamp, Timestamp)>,
    /// Stops after so many trials.
    pub most_trials: Option<u64>,
}

/// Whether a study can be done so, before anything is opened.
///
/// # Errors
/// Which task or input does not go with which headset.
pub fn check(study: &Study, how: &InHeadset) -> Result<(), Error> {
    let refuse = |text: String| Err(Error::Call(text));
    match (how.run.headset, &how.input) {
        (HeadsetChoice::Auto, _) => refuse("--headset: expected openxr or simulated, found neither".into()),
        (HeadsetChoice::Simulated, Input::Simulated(_))
        | (HeadsetChoice::OpenXr, Input::Controller | Input::Hand) => {
            if study.geometry.is_unbounded() {
                return refuse(
                    "a task at the edges or corners of a screen needs one: --headset desktop".into(),
                );
            }
            Ok(())
        }
        (HeadsetChoice::OpenXr, Input::Gaze) if matches!(study.geometry, Geometry::Ray { .. }) => Ok(()),
        (HeadsetChoice::OpenXr, Input::Gaze) => {
            refuse("--input gaze: expected a task with kind = \"ray\": a gaze has no depth".into())
        }
        (headset, input) => refuse(format!(
            "--input {input}: expected {}, found {input}",
            if headset == HeadsetChoice::Simulated {
                "simulated:SEED on the simulated headset"
            } else {
                "controller, hand or gaze on a real headset"
            }
        )),
    }
}

/// Runs a sitting that was begun, until everything is done, `most_trials` are, or something ends it.
///
/// # Errors
/// No headset, one that is lost for good, or a disk that takes no more. What was finished is on the disk, and the folder
/// knows why the sitting ended.
pub fn in_headset(
    conduct: Conduct,
    how: &InHeadset,
    watch: &mut dyn FnMut(Happening<'_>),
    progress: &mut dyn FnMut(usize, usize),
) -> Result<(Ended, RunReport), Error> {
    check(conduct.study(), how)?;
    let study = conduct.study().clone();
    let wearer = match how.input {
        Input::Simulated(seed) => {
            let actor = Actor::new(&study, conduct.participant(), seed, false)?;
            Some(Wearer::new(actor, &study, how.pictures, how.away))
        }
        _ => None,
    };
    let select = match (study.trigger, &how.input) {
        (Trigger::Dwell, _) => "Rest",
        (Trigger::Tap, _) => "Tap",
        (Trigger::Trigger, Input::Hand) => "Pinch",
        (Trigger::Trigger, _) => "Pull the trigger",
    };
    let reach =
        study.sizes.iter().map(|size| 0.5 * (size.amplitude + size.width.unwrap_or(0.0))).fold(0.0, f64::max);
    let words = match study.geometry {
        Geometry::Ray { distance, .. } => {
            Words { at: [0.0, 0.0, -distance], cap_height_m: (0.022 * distance) as f32 }
        }
        _ => Words { at: [0.0, reach + 0.08, -0.05], cap_height_m: 0.013 },
    };
    let stimuli = Stimuli::new(&study, false, select, words);
    let scene = Arc::clone(stimuli.scene());
    let said = RefCell::new(Vec::new());
    let mut seat = Seat {
        conduct,
        stimuli,
        study,
        wearer,
        gaze: how.input == Input::Gaze,
        most_trials: how.most_trials,
        world_from_task: None,
        hand: Hand::Right,
        last_trial_s: None,
        failure: None,
        said: &said,
        progress,
    };
    let config = RunConfig {
        eye_gaze: how.run.eye_gaze || seat.gaze,
        // Who is seen by nobody shows no first frame, and a study waits for its participant.
        patience_s: if how.pictures { how.run.patience_s } else { 1e9 },
        ..how.run.clone()
    };
    let ran = run_with(&scene, &config, &mut seat, &mut |happening| {
        if let Happening::Said(sentence) = happening {
            said.borrow_mut().push(sentence.to_owned());
        }
        watch(happening);
    });
    let Seat { mut conduct, failure, .. } = seat;
    for sentence in said.take() {
        conduct.happened("headset", &sentence);
    }
    let why = match (&failure, &ran) {
        (Some(error), _) => error.to_string(),
        (None, Err(error)) => error.to_string(),
        (None, Ok(_)) if config.stop.is_stopped() => "asked to stop".to_owned(),
        (None, Ok(_)) if conduct.is_enough(how.most_trials) => conduct.why_enough(),
        (None, Ok(_)) => "the session was ended".to_owned(),
    };
    let ended = conduct.finish(Some(&why));
    if let Some(error) = failure {
        return Err(error);
    }
    let report = ran.map_err(Error::from)?;
    Ok((ended?, report))
}

/// The participant's place in the run.
struct Seat<'a> {
    conduct: Conduct,
    stimuli: Stimuli,
    study: Study,
    wearer: Option<Wearer>,
    gaze: bool,
    most_trials: Option<u64>,
    /// Where the task stands; `None` until the head has been seen.
    world_from_task: Option<Rigid>,
    /// The hand that acts: the one that selected last.
    hand: Hand,
    last_trial_s: Option<f64>,
    failure: Option<Error>,
    said: &'a RefCell<Vec<String>>,
    progress: &'a mut dyn FnMut(usize, usize),
}

impl Seat<'_> {
    /// Puts the task in front of the eyes, upright.
    fn place(&mut self, now: &Moment) -> Option<Rigid> {
        if self.world_from_task.is_none() {
            let head = now.world_from_head?;
            let upright = Rigid::from_parts(head.translation, vergence_geom::yaw(&head.rotation));
            let task = match self.study.geometry {
                Geometry::Ray { .. } => Translation3::identity(),
                _ => Translation3::new(0.0, -BELOW_EYES_M, -self.study.distance),
            };
            self.world_from_task = Some(upright * task);
        }
        self.world_from_task
    }

    /// The cursor in task coordinates.
    fn cursor(&self, now: &Moment, world_from_task: &Rigid) -> Option<Point> {
        let aim = now.world_from_aim[self.hand.index()].as_ref();
        let point = match self.study.geometry {
            Geometry::Ray { distance, .. } => {
                let along = |aim: &Rigid| Ray {
                    origin: Point3::from(aim.translation.vector),
                    direction: aim.rotation * -Vector3::z_axis(),
                };
                let ray = if self.gaze { now.gaze? } else { along(aim?) };
                on_sphere(&ray, &world_from_task.translation.vector.into(), distance)?
            }
            _ => aim? * Point3::new(0.0, 0.0, -TIP_M),
        };
        let own = world_from_task.inverse() * point;
        Some([own.x, own.y, own.z])
    }

    /// Whether something selects now. Tapping is going through the plane of the task, else into the target.
    fn pressed(&mut self, now: &Moment, cursor: Option<Point>) -> bool {
        if self.study.trigger != Trigger::Tap || matches!(self.study.geometry, Geometry::Ray { .. }) {
            return now.selects[self.hand.index()];
        }
        let Some(cursor) = cursor else { return false };
        let is_upright = matches!(
            self.study.geometry,
            Geometry::Reciprocal | Geometry::Steering | Geometry::Ring { plane: Plane::Xy, .. }
        );
        if is_upright {
            return cursor[2] <= 0.0;
        }
        self.conduct.course().goal().is_some_and(|goal| {
            let off = Vector3::from(cursor) - Vector3::from(goal.centre);
            off.norm() <= 0.5 * goal.width.unwrap_or(0.0)
        })
    }

    fn act(&mut self, now: &Moment, stage: &mut Stage<'_>) -> Result<bool, Error> {
        for sentence in self.said.take() {
            self.conduct.happened("headset", &sentence);
        }
        let Some(world_from_task) = self.place(now) else { return Ok(true) };
        for hand in Hand::BOTH {
            let other_rests = !now.selects[self.hand.index()];
            if now.selects[hand.index()] && other_rests && !self.gaze {
                self.hand = hand;
            }
        }
        let cursor = self.cursor(now, &world_from_task);
        let pressed = self.pressed(now, cursor);
        let step = self.conduct.follow(&Reading { at: now.display, cursor, pressed })?;
        let seconds = now.display.as_nanos() as f64 * 1e-9;
        let last = *self.last_trial_s.get_or_insert(seconds);
        match &step {
            Step::Trial(_) => {
                self.last_trial_s = Some(seconds);
                stage.tick(self.hand);
                let (done, all) = self.conduct.course().progress();
                (self.progress)(done, all);
            }
            Step::Began => stage.tick(self.hand),
            Step::Nothing | Step::Interrupted(_) => {}
        }
        if let Some(wearer) = &self.wearer {
            wearer.see(&self.study, self.conduct.course().goal().as_ref(), &world_from_task)?;
            if seconds - last > LOST_S + self.study.break_s {
                return Err(Error::Lost { seconds: seconds - last });
            }
        }
        let is_ray = matches!(self.study.geometry, Geometry::Ray { .. }) && !self.gaze;
        let aim = now.world_from_aim[self.hand.index()].as_ref().filter(|_| is_ray);
        self.stimuli.show(self.conduct.course(), &world_from_task, cursor, aim, |node, place| {
            stage.show(node, place.is_some());
            if let Some(place) = place {
                stage.place(node, place);
            }
        });
        Ok(!(self.conduct.course().is_done() || self.conduct.is_enough(self.most_trials)))
    }
}

impl Guest for Seat<'_> {
    fn wearer(&mut self) -> Option<Arc<dyn PoseProvider>> {
        self.wearer.clone().map(|wearer| Arc::new(wearer) as Arc<dyn PoseProvider>)
    }

    fn follow(&mut self, now: &Moment, stage: &mut Stage<'_>) -> bool {
        if self.failure.is_some() {
            return false;
        }
        match self.act(now, stage) {
            Ok(goes_on) => goes_on,
            Err(error) => {
                self.failure = Some(error);
                false
            }
        }
    }
}

/// Where a ray leaves the ball around `centre`: ahead of it; `None` where it passes by.
fn on_sphere(ray: &Ray, centre: &Point3<f64>, radius_m: f64) -> Option<Point3<f64>> {
    let from_centre = ray.origin - centre;
    let along = from_centre.dot(&ray.direction);
    let square = along * along - from_centre.norm_squared() + radius_m * radius_m;
    let distance = square.sqrt() - along;
    (distance.is_finite() && distance > 0.0).then(|| ray.at(distance))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_leave_the_ball_ahead() {
        let ray = |origin: [f64; 3], direction: [f64; 3]| Ray {
            origin: Point3::from(origin),
            direction: nalgebra::Unit::new_normalize(Vector3::from(direction)),
        };
        let centre = Point3::new(0.0, 1.6, 0.0);
        let hit = on_sphere(&ray([0.2, 1.3, -0.3], [0.1, 0.3, -1.0]), &centre, 2.0).unwrap();
        assert!(((hit - centre).norm() - 2.0).abs() < 1e-12 && hit.z < -1.0);
        assert_eq!(on_sphere(&ray([5.0, 1.6, 0.0], [1.0, 0.0, 0.0]), &centre, 2.0), None);
        assert_eq!(on_sphere(&ray([0.0, 9.0, 0.0], [1.0, 0.0, 0.0]), &centre, 2.0), None);
    }
}
