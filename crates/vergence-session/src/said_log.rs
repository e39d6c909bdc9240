//! Reads a session's log back: frame by frame what was said, in the order in which it was said.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use vergence_log::{Entry, Reader};
use vergence_sense::{
    Axis, Body, Button, ControlState, Event, FrameHash, FrameTiming, Hand, Haptic, RawJoints, RawLocation,
    RawViews, Said, Sample, Vector2,
};
use vergence_time::Timestamp;
use vergence_xr_sim::motion::SESSION_BEGINS;

use crate::recording::name;

/// Where a log stopped making sense, for whoever asks afterwards.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trouble(Arc<Mutex<Option<vergence_log::Error>>>);

impl Trouble {
    pub(crate) fn take(&self) -> Option<vergence_log::Error> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// The frames of a log, one list for each: its events, [`Said::Frame`], the answers, [`Said::Submitted`]. The last list may
/// have events only. A frame that is not whole (the recording was cut off, or the session lost within it) is left out.
pub(crate) struct Frames {
    reader: Option<Reader>,
    actions: Arc<Vec<String>>,
    events: Vec<Said>,
    calls: Vec<Said>,
    submitted: Option<RawViews>,
    trouble: Trouble,
}

impl Frames {
    /// `actions` gives actions their places.
    pub(crate) fn open(
        path: &Path,
        actions: Arc<Vec<String>>,
        trouble: Trouble,
    ) -> Result<Self, vergence_log::Error> {
        let reader = Reader::open(path)?;
        Ok(Self {
            reader: Some(reader),
            actions,
            events: Vec::new(),
            calls: Vec::new(),
            submitted: None,
            trouble,
        })
    }

    /// Reads on; whether there is more.
    fn step(&mut self) -> Result<Step, vergence_log::Error> {
        let Some(reader) = &mut self.reader else { return Ok(Step::End) };
        let Some(entry) = reader.next()? else { return Ok(Step::End) };
        match take(&entry, &self.actions)? {
            Taken::Said(Said::Event(event)) => {
                if event.name == SESSION_BEGINS {
                    self.calls.clear();
                    self.submitted = None;
                }
                self.events.push(Said::Event(event));
            }
            Taken::Said(said) => self.calls.push(said),
            Taken::Submitted(views) => self.submitted = Some(views),
            Taken::Timing(timing) => return Ok(Step::Frame(timing)),
            Taken::Nothing => {}
        }
        Ok(Step::More)
    }

    fn frame(&mut self, timing: &FrameTiming) -> Vec<Said> {
        let mut frame = std::mem::take(&mut self.events);
        frame.push(Said::Frame {
            now: timing.wait_returned,
            display: timing.predicted_display,
            period: timing.predicted_period,
            should_render: timing.should_render,
        });
        frame.append(&mut self.calls);
        frame.push(Said::Submitted { display: timing.predicted_display, views: self.submitted.take() });
        frame
    }
}

enum Step {
    More,
    Frame(FrameTiming),
    End,
}

impl Iterator for Frames {
    type Item = Vec<Said>;

    fn next(&mut self) -> Option<Vec<Said>> {
        loop {
            match self.step() {
                Ok(Step::More) => {}
                Ok(Step::Frame(timing)) => return Some(self.frame(&timing)),
                Ok(Step::End) => break,
                Err(error) => {
                    *self.trouble.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                    break;
                }
            }
        }
        self.reader = None;
        let events = std::mem::take(&mut self.events);
        (!events.is_empty()).then_some(events)
    }
}

#[expect(clippy::large_enum_variant, reason = "it is taken apart at once; a box would allocate per message")]
enum Taken {
    Said(Said),
    Submitted(RawViews),
    Timing(FrameTiming),
    /// A stream that is no part of what is replayed.
    Nothing,
}

fn take(entry: &Entry<'_>, actions: &[String]) -> Result<Taken, vergence_log::Error> {
    let place = |of: Body| -> Result<Taken, vergence_log::Error> {
        let Sample { captured, value, .. } = entry.decode::<RawLocation>()?;
        Ok(Taken::Said(Said::Place { of, at: captured, location: value }))
    };
    Ok(match entry.stream.name.as_str() {
        name::EVENTS => Taken::Said(Said::Event(entry.decode::<Event>()?.value)),
        name::TIMING => Taken::Timing(entry.decode::<FrameTiming>()?.value),
        name::HASHES => Taken::Said(Said::Hash(entry.decode::<FrameHash>()?.value)),
        name::SUBMITTED => Taken::Submitted(entry.decode::<RawViews>()?.value),
        name::VIEWS => {
            let Sample { captured, value, .. } = entry.decode::<RawViews>()?;
            Taken::Said(Said::Views { at: captured, views: value })
        }
        name::HEAD => place(Body::Head)?,
        name::FLOOR => place(Body::Floor)?,
        name::GAZE => place(Body::Gaze)?,
        other => {
            if let Some(hand) = Hand::BOTH.into_iter().find(|hand| other == name::JOINTS[hand.index()]) {
                let Sample { captured, value, .. } = entry.decode::<RawJoints>()?;
                return Ok(Taken::Said(Said::Joints { hand, at: captured, joints: value }));
            }
            let Some((action, hand)) = action_of(other, actions) else { return Ok(Taken::Nothing) };
            let control = |at: Timestamp, state| Taken::Said(Said::Control { action, hand, at, state });
            if entry.is::<RawLocation>() {
                place(Body::Action(action, hand))?
            } else if entry.is::<Button>() {
                let Sample { captured, value, .. } = entry.decode::<Button>()?;
                control(captured, ControlState::Button(value))
            } else if entry.is::<Axis>() {
                let Sample { captured, value, .. } = entry.decode::<Axis>()?;
                control(captured, ControlState::Axis(value))
            } else if entry.is::<Vector2>() {
                let Sample { captured, value, .. } = entry.decode::<Vector2>()?;
                control(captured, ControlState::Vector2(value))
            } else if entry.is::<Haptic>() {
                Taken::Said(Said::Haptic { action, hand, haptic: entry.decode::<Haptic>()?.value })
            } else {
                Taken::Nothing
            }
        }
    })
}

/// The action's place and the hand of `/action/NAME/HAND`.
fn action_of(stream: &str, actions: &[String]) -> Option<(u16, Hand)> {
    let (action, hand) = stream.strip_prefix(name::ACTION)?.rsplit_once('/')?;
    let place = actions.iter().position(|known| known == action)?;
    let hand = Hand::BOTH.into_iter().find(|known| known.name() == hand)?;
    Some((u16::try_from(place).ok()?, hand))
}
