//! Reads a session's log back: frame by frame what was said, in the order in which it was said.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use vergence_log::{Ending, Entry, Reader};
use vergence_sense::{
    Axis, Body, Button, CallResult, ControlState, Event, FrameHash, FrameTiming, Hand, Haptic, RawJoints,
    RawLocation, RawViews, Said, Sample, Vector2,
};
use vergence_time::Timestamp;
use vergence_xr_sim::motion::SESSION_BEGINS;

use crate::recording::name;

/// Most of what may be said for one frame: a log that says more without a frame's times (another program's, or a part
/// without them) is none that can be replayed.
const MOST_SAID: usize = 1 << 16;

/// How reading a log ended, for whoever asks afterwards.
#[derive(Clone, Debug, Default)]
pub(crate) struct Outcome(Arc<Mutex<(Option<vergence_log::Error>, Option<Ending>)>>);

impl Outcome {
    /// Where the log stopped making sense, where it did.
    pub(crate) fn trouble(&self) -> Option<vergence_log::Error> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).0.clone()
    }

    /// Whether the log was read to its end, and that is the end of a recording.
    pub(crate) fn is_complete(&self) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).1 == Some(Ending::Complete)
    }

    pub(crate) fn set(&self, trouble: Option<vergence_log::Error>, ending: Option<Ending>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = (trouble, ending);
    }
}

/// The frames of a log, one list for each: what came before it, [`Said::Frame`], what came in it, [`Said::Submitted`]; that
/// in which a session was lost has no end. The last list may have no frame. One that a kill cut off is left out.
pub(crate) struct Frames {
    reader: Option<Reader>,
    actions: Arc<Vec<String>>,
    said: Vec<Said>,
    /// Where in `said` the frame begins that is under way.
    begun: Option<usize>,
    submitted: Option<RawViews>,
    outcome: Outcome,
    path: PathBuf,
    /// The next message's number, by stream.
    next: BTreeMap<u16, u32>,
}

impl Frames {
    /// `actions` gives actions their places.
    pub(crate) fn open(
        path: &Path,
        actions: Arc<Vec<String>>,
        outcome: Outcome,
    ) -> Result<Self, vergence_log::Error> {
        let (reader, path) = (Some(Reader::open(path)?), path.to_owned());
        Ok(Self {
            reader,
            actions,
            said: Vec::new(),
            begun: None,
            submitted: None,
            outcome,
            path,
            next: BTreeMap::new(),
        })
    }

    /// Reads on; whether there is more.
    fn step(&mut self) -> Result<Step, vergence_log::Error> {
        let Some(reader) = &mut self.reader else { return Ok(Step::End) };
        if self.said.len() >= MOST_SAID {
            return Err(vergence_log::Error::Request(format!(
                "{}: expected times of frames in stream {}, found {MOST_SAID} messages without",
                reader.path().display(),
                name::TIMING
            )));
        }
        let Some(entry) = reader.next()? else {
            self.outcome.set(None, reader.ending());
            return Ok(Step::End);
        };
        let taken = take(&entry, &self.actions)?;
        // What was dropped while recording cannot be said again, and what comes after it rests on it.
        let dropped = match &taken {
            Taken::Nothing => lost_at_end(&entry)?,
            _ => {
                let next = entry.sequence.wrapping_add(1);
                let expected = self.next.insert(entry.stream.id, next).unwrap_or(entry.sequence);
                let missing = entry.sequence.wrapping_sub(expected);
                (missing > 0).then(|| format!("number {} after {}", entry.sequence, expected.wrapping_sub(1)))
            }
        };
        if let Some(found) = dropped {
            return Err(vergence_log::Error::Damaged {
                path: self.path.clone(),
                at: entry.place.offset,
                expected: "all messages",
                found: format!("{found} in stream {}: some were dropped while recording", entry.stream.name),
            });
        }
        match taken {
            Taken::Said(said) => {
                // Logs of earlier versions do not tell frames in which a session was lost.
                if matches!(&said, Said::Event(event) if event.name == SESSION_BEGINS) {
                    self.forget_frame();
                }
                let in_frame = match &said {
                    Said::Event(_) => false,
                    Said::Result(result) => result.in_frame,
                    _ => true,
                };
                if in_frame {
                    self.begun.get_or_insert(self.said.len());
                }
                self.said.push(said);
            }
            Taken::Submitted(views) => self.submitted = Some(views),
            Taken::Timing(timing) => return Ok(Step::Frame(timing)),
            Taken::Nothing => {}
        }
        Ok(Step::More)
    }

    fn frame(&mut self, timing: &FrameTiming) -> Vec<Said> {
        let mut frame = std::mem::take(&mut self.said);
        let begun = self.begun.take().unwrap_or(frame.len());
        frame.insert(
            begun,
            Said::Frame {
                now: timing.wait_returned,
                display: timing.predicted_display,
                period: timing.predicted_period,
                should_render: timing.should_render,
                raw_display: timing.raw_display,
                raw_period: timing.raw_period,
            },
        );
        let views = self.submitted.take();
        if timing.ended {
            frame.push(Said::Submitted { display: timing.predicted_display, views });
        }
        frame
    }

    /// A frame whose times are missing is none; what happened in it did happen.
    fn forget_frame(&mut self) {
        self.submitted = None;
        if self.begun.take().is_some() {
            self.said.retain(|said| match said {
                Said::Event(_) => true,
                Said::Result(result) => !result.in_frame,
                _ => false,
            });
        }
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
                    self.outcome.set(Some(error), None);
                    break;
                }
            }
        }
        self.reader = None;
        self.forget_frame();
        let rest = std::mem::take(&mut self.said);
        (!rest.is_empty()).then_some(rest)
    }
}

/// What the recorder says to have lost behind the last message of each stream.
fn lost_at_end(entry: &Entry<'_>) -> Result<Option<String>, vergence_log::Error> {
    if entry.stream.name != name::RECORDER || !entry.is::<Event>() {
        return Ok(None);
    }
    let Event { name, text, after, .. } = entry.decode::<Event>()?.value;
    // Of a stream that it names, the numbers say it, where it is one that is replayed.
    Ok((name == "dropped" && text.is_empty())
        .then(|| format!("{after} messages that are missing at the end")))
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
        name::RESULTS => Taken::Said(Said::Result(entry.decode::<CallResult>()?.value)),
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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;
    use vergence_log::{Header, Options, Recorder, StreamDesc, Times};
    use vergence_time::Span;

    /// Three frames with an event each; that of frame `large` does not fit into the recorder's queue.
    fn read(large: Option<usize>) -> (usize, Outcome) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.mcap");
        let options = Options { queue_bytes: 64 << 10, ..Options::default() };
        let mut recorder = Recorder::create(&path, &Header::default(), &options).unwrap();
        let events = recorder.stream::<Event>(&StreamDesc::new(name::EVENTS)).unwrap();
        let timings = recorder.stream::<FrameTiming>(&StreamDesc::new(name::TIMING)).unwrap();
        for frame in 0..3 {
            let at = Timestamp::from_nanos(frame as i64);
            let text = if large == Some(frame) { "x".repeat(100 << 10) } else { String::new() };
            let event = Event { text: text.into(), ..Event::new("session_state", "") };
            recorder.write(&events, Times::at(at), &event);
            let timing = FrameTiming {
                frame: frame as u64,
                wait_returned: at,
                begun: at,
                submitted: None,
                predicted_display: at,
                predicted_period: Span::from_millis(11),
                should_render: false,
                presented: None,
                raw_display: at,
                raw_period: Span::from_millis(11),
                ended: true,
            };
            recorder.write(&timings, Times::at(at), &timing);
        }
        assert_eq!(recorder.finish().unwrap().dropped, u64::from(large.is_some()));
        let outcome = Outcome::default();
        let frames = Frames::open(&path, Arc::default(), outcome.clone()).unwrap();
        let is_frame = |said: &Vec<Said>| said.iter().any(|said| matches!(said, Said::Frame { .. }));
        (frames.filter(is_frame).count(), outcome)
    }

    #[test]
    fn a_log_that_lacks_messages_is_not_whole() {
        let (frames, outcome) = read(None);
        assert!(frames == 3 && outcome.is_complete() && outcome.trouble().is_none());
        // Seen at the next message of its stream, or at the end where there is none.
        for (large, expected) in [(1, 2), (2, 3)] {
            let (frames, outcome) = read(Some(large));
            assert!(frames == expected && !outcome.is_complete(), "{large}: {frames} frames");
            let said = outcome.trouble().unwrap().to_string();
            assert!(said.contains("dropped while recording"), "{said}");
        }
    }
}
