//! Compares a session that runs with one that was recorded, frame by frame, while it runs.

use serde::Serialize;
use vergence_sense::Said;
use vergence_xr_sim::motion::{HUNG, RUN_ENDED};

use crate::recording::{abandons, is_stop};
use crate::said_log::Outcome;

/// How a replay compares with its recording. Its JSON is an interface.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Comparison {
    /// Frames of the recording.
    pub frames: u64,
    /// Of these, frames in which every call was made and answered alike, bit for bit, failed ones included, and the same
    /// views were submitted. Frames in which a session was lost are compared, too, and not counted.
    pub frames_equal: u64,
    /// Events of the recording.
    pub events: u64,
    /// Of these, events that came alike, in the same place.
    pub events_equal: u64,
    /// Pictures of the recording that have a hash.
    pub images: u64,
    /// Of these, pictures that are alike.
    pub images_equal: u64,
    /// Why pictures were not compared; `None` where they were.
    pub images_not_compared: Option<String>,
    /// Frames of the replay after the last one of the recording. A difference where the recording has its end; one that
    /// was cut off, a part of one, and one whose runtime hung say nothing of what came then.
    pub extra_frames: u64,
    /// Events of the replay after the last one of the recording; as for frames.
    pub extra_events: u64,
    /// The first thing that differs, in words; `None` where nothing does.
    pub first_difference: Option<String>,
}

impl Comparison {
    /// Whether nothing differs.
    pub fn is_equal(&self) -> bool {
        self.first_difference.is_none()
    }
}

/// Hears a session and reads the recording beside it.
pub(crate) struct Verifier {
    expected: Box<dyn Iterator<Item = Vec<Said>> + Send>,
    outcome: Outcome,
    /// Calls that failed are in the recording.
    has_results: bool,
    heard: Vec<Said>,
    /// A frame was waited for and not ended.
    in_frame: bool,
    result: Comparison,
    /// All of the recording was compared.
    is_over: bool,
    /// What the recording lacks at its end, the replay must lack.
    ends_here: bool,
}

fn is_event(said: &Said) -> bool {
    matches!(said, Said::Event(_))
}

fn is_named(said: &Said, name: &str) -> bool {
    matches!(said, Said::Event(event) if event.name == name)
}

impl Verifier {
    /// `outcome` is that of reading `expected`; `images_not_compared` says why the hashes of pictures mean nothing here,
    /// where they do not.
    pub(crate) fn new(
        expected: impl Iterator<Item = Vec<Said>> + Send + 'static,
        outcome: Outcome,
        has_results: bool,
        images_not_compared: Option<String>,
    ) -> Self {
        Self {
            expected: Box::new(expected),
            outcome,
            has_results,
            heard: Vec::with_capacity(64),
            in_frame: false,
            result: Comparison { images_not_compared, ..Comparison::default() },
            is_over: false,
            ends_here: false,
        }
    }

    pub(crate) fn hear(&mut self, said: &Said) {
        let (stops, abandons) = match said {
            Said::Event(event) => (is_stop(event), abandons(event)),
            _ => (false, false),
        };
        let frame_is_lost = abandons && std::mem::take(&mut self.in_frame);
        if frame_is_lost && !stops {
            self.compare();
        }
        if !self.has_results && (is_named(said, RUN_ENDED) || matches!(said, Said::Result(_))) {
            return;
        }
        self.heard.push(said.clone());
        if frame_is_lost && stops {
            self.compare();
        }
        match said {
            Said::Frame { .. } => self.in_frame = true,
            Said::Submitted { .. } => {
                self.in_frame = false;
                self.compare();
            }
            _ => {}
        }
    }

    fn compare(&mut self) {
        let heard = std::mem::take(&mut self.heard);
        match self.expected.next() {
            Some(expected) if expected.iter().any(|said| matches!(said, Said::Frame { .. })) => {
                self.compare_frame(&expected, &heard);
            }
            Some(rest) => {
                // Nothing comes after it: how the recording ends is known.
                let end = rest.iter().find_map(|said| match said {
                    Said::Event(event) if event.name == RUN_ENDED => Some(&event.text),
                    _ => None,
                });
                let hung = end.is_some_and(|end| end.starts_with(HUNG));
                self.ends_here = end.is_some() && !hung && self.outcome.is_complete();
                self.compare_rest(&rest, &heard, hung);
            }
            None => {
                self.is_over = true;
                self.compare_extra(&heard);
            }
        }
        self.heard = heard;
        self.heard.clear();
    }

    fn differs(&mut self, what: impl FnOnce() -> String) {
        if self.result.first_difference.is_none() {
            self.result.first_difference = Some(what());
        }
    }

    /// Compares events one by one; how many more came than were expected.
    fn compare_events<'a>(
        &mut self,
        expected: impl Iterator<Item = &'a Said>,
        heard: &[Said],
        place: impl Fn() -> String,
    ) -> u64 {
        let mut heard = heard.iter().filter(|said| is_event(said));
        for a in expected {
            let b = heard.next();
            self.result.events += 1;
            if b.is_some_and(|b| a.is_same(b)) {
                self.result.events_equal += 1;
            } else {
                self.differs(|| format!("{}: expected {}, found {}", place(), word(a), found(b)));
            }
        }
        let mut extra = 0;
        for b in heard {
            extra += 1;
            if self.ends_here {
                self.differs(|| format!("{}: expected no event, found {}", place(), word(b)));
            }
        }
        extra
    }

    /// Whether all calls are alike.
    fn compare_calls(&mut self, expected: &[Said], heard: &[Said], place: impl Fn() -> String) -> bool {
        let has_results = self.has_results;
        let is_call = |said: &&Said| match said {
            Said::Event(_) | Said::Hash(_) => false,
            Said::Result(_) => has_results,
            _ => true,
        };
        let (mut calls, mut calls_heard) = (expected.iter().filter(is_call), heard.iter().filter(is_call));
        for call in 0.. {
            match (calls.next(), calls_heard.next()) {
                (Some(a), Some(b)) if a.is_same(b) => {}
                (None, None) => break,
                (a, b) => {
                    let expected = found(a);
                    self.differs(|| {
                        format!("{}, call {call}: expected {expected}, found {}", place(), found(b))
                    });
                    return false;
                }
            }
        }
        true
    }

    fn compare_frame(&mut self, expected: &[Said], heard: &[Said]) {
        let frame = self.result.frames;
        let before = || format!("before frame {frame}");
        // Before a frame of the recording, one event too many is a difference whatever the end is like.
        let ends_here = std::mem::replace(&mut self.ends_here, true);
        let extra = self.compare_events(expected.iter().filter(|said| is_event(said)), heard, before);
        self.ends_here = ends_here;
        self.result.extra_events += extra;
        let equal = self.compare_calls(expected, heard, || format!("frame {frame}"));
        if expected.iter().any(|said| matches!(said, Said::Submitted { .. })) {
            self.result.frames += 1;
            self.result.frames_equal += u64::from(equal);
        }
        self.compare_images(expected, heard, frame);
    }

    /// What came after the last frame.
    fn compare_rest(&mut self, rest: &[Said], heard: &[Said], hung: bool) {
        let place = || "after the last frame".to_owned();
        // That a runtime hung is not done again.
        let expected = rest.iter().filter(|said| is_event(said) && !(hung && is_named(said, RUN_ENDED)));
        self.result.extra_events += self.compare_events(expected, heard, place);
        if self.ends_here {
            self.compare_calls(rest, heard, place);
        }
        self.result.extra_frames += u64::from(heard.iter().any(|said| matches!(said, Said::Frame { .. })));
    }

    fn compare_extra(&mut self, heard: &[Said]) {
        let nothing = std::iter::empty::<&Said>();
        self.result.extra_events += self.compare_events(nothing, heard, || "after the end".to_owned());
        if heard.iter().any(|said| matches!(said, Said::Frame { .. })) {
            self.result.extra_frames += 1;
            if self.ends_here {
                self.differs(|| "after the end: expected no frame, found one".to_owned());
            }
        }
    }

    fn compare_images(&mut self, expected: &[Said], heard: &[Said], frame: u64) {
        for said in expected {
            let Said::Hash(hash) = said else { continue };
            self.result.images += 1;
            if self.result.images_not_compared.is_some() {
                continue;
            }
            if heard.iter().any(|other| said.is_same(other)) {
                self.result.images_equal += 1;
            } else {
                self.differs(|| format!("frame {frame}: the picture of view {} is another", hash.view));
            }
        }
    }

    /// What is left of the recording, and how it all compares.
    pub(crate) fn finish(mut self) -> Comparison {
        while !self.is_over {
            self.compare();
        }
        self.result
    }
}

fn found(said: Option<&Said>) -> String {
    said.map_or_else(|| "nothing".to_owned(), word)
}

fn word(said: &Said) -> String {
    let mut words = format!("{said:?}");
    if words.len() > 400 {
        let mut end = 400;
        while !words.is_char_boundary(end) {
            end -= 1;
        }
        words.truncate(end);
        words.push('…');
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_sense::{CallResult, Event, FrameHash};
    use vergence_time::{Span, Timestamp};
    use vergence_xr_sim::motion::SESSION_BEGINS;

    fn frame(display: i64, state: &'static str, hash: u8) -> Vec<Said> {
        let display = Timestamp::from_nanos(display);
        let period = Span::from_millis(11);
        vec![
            Said::Event(Event::new("session_state", state)),
            Said::Frame {
                now: display,
                display,
                period,
                should_render: true,
                raw_display: display,
                raw_period: period,
            },
            Said::Hash(FrameHash { frame: 0, view: 0, hash: [hash; 32] }),
            Said::Submitted { display, views: None },
        ]
    }

    fn event(name: &'static str, text: &'static str) -> Said {
        Said::Event(Event::new(name, text))
    }

    fn failed(call: &'static str) -> Said {
        let result = "ERROR_RUNTIME_FAILURE".into();
        Said::Result(CallResult { call: call.into(), nth: 1, in_frame: false, code: -2, result })
    }

    /// `expected` was recorded to its end.
    fn compared(expected: Vec<Vec<Said>>, heard: Vec<Vec<Said>>, why_not: Option<&str>) -> Comparison {
        let outcome = Outcome::default();
        outcome.set(None, Some(vergence_log::Ending::Complete));
        let mut verifier = Verifier::new(expected.into_iter(), outcome, true, why_not.map(str::to_owned));
        heard.iter().flatten().for_each(|said| verifier.hear(said));
        verifier.finish()
    }

    #[test]
    fn the_same_is_equal_and_each_difference_is_found() {
        let log = || vec![frame(1, "READY", 1), frame(2, "FOCUSED", 2)];
        let same = compared(log(), log(), None);
        assert_eq!((same.frames, same.frames_equal, same.events, same.events_equal), (2, 2, 2, 2));
        assert_eq!((same.images, same.images_equal, same.is_equal()), (2, 2, true));

        let other = compared(log(), vec![frame(1, "READY", 1), frame(3, "FOCUSED", 2)], None);
        assert_eq!((other.frames_equal, other.events_equal), (1, 2));
        assert!(other.first_difference.unwrap().starts_with("frame 1, call 0: expected Frame"));
        let other = compared(log(), vec![frame(1, "READY", 1), frame(2, "VISIBLE", 2)], None);
        assert_eq!((other.frames_equal, other.events_equal, other.first_difference.is_some()), (2, 1, true));
        let other = compared(log(), vec![frame(1, "READY", 1), frame(2, "FOCUSED", 9)], None);
        assert_eq!((other.frames_equal, other.images_equal), (2, 1));
        assert_eq!(other.first_difference.unwrap(), "frame 1: the picture of view 0 is another");
        let elsewhere = compared(log(), vec![frame(1, "READY", 7), frame(2, "FOCUSED", 9)], Some("a driver"));
        assert_eq!((elsewhere.images, elsewhere.images_equal, elsewhere.is_equal()), (2, 0, true));
        // A session that stops early lacks frames and events.
        let short = compared(log(), vec![frame(1, "READY", 1)], None);
        assert_eq!(
            (short.frames, short.frames_equal, short.events_equal, short.is_equal()),
            (2, 1, 1, false)
        );
    }

    /// Without the mark of its end a recording was cut off: what a session says then is counted.
    #[test]
    fn after_a_recording_that_was_cut_off_nothing_differs() {
        let log = vec![frame(1, "READY", 1), vec![event("session_state", "STOPPING")]];
        let mut heard = log.clone();
        heard.push(frame(2, "EXITING", 1));
        let result = compared(log, heard, None);
        assert_eq!((result.frames, result.frames_equal, result.extra_frames), (1, 1, 1));
        // The farewell of the last session came within one more frame here: the recorded event is there.
        assert_eq!((result.events, result.events_equal, result.is_equal()), (2, 2, true));
        assert_eq!(result.extra_events, 1);
    }

    #[test]
    fn after_the_end_of_a_whole_recording_everything_differs() {
        let end = || vec![event("session_state", "EXITING"), event(RUN_ENDED, "exiting")];
        let log = || vec![frame(1, "READY", 1), end()];
        let same = compared(log(), log(), None);
        assert_eq!((same.events_equal, same.extra_events, same.first_difference), (3, 0, None));
        // One frame more before the end, one event more after it, a call that failed on the way out.
        let more = compared(log(), vec![frame(1, "READY", 1), frame(2, "IDLE", 1), end()], None);
        assert!(more.extra_frames == 1 && !more.is_equal(), "{more:?}");
        let more = compared(log(), vec![frame(1, "READY", 1), end(), vec![event("events_lost", "")]], None);
        assert!(more.first_difference.unwrap().starts_with("after the last frame: expected no event"));
        let more = compared(log(), vec![frame(1, "READY", 1), vec![failed("xrEndFrame")], end()], None);
        assert!(more.first_difference.unwrap().contains("ERROR_RUNTIME_FAILURE"));
        let other =
            compared(log(), vec![frame(1, "READY", 1), vec![event("session_state", "EXITING")]], None);
        assert!(other.first_difference.unwrap().contains(RUN_ENDED), "the end is missing");
        // A runtime that hung does not hang again.
        let hung = vec![frame(1, "READY", 1), vec![event(RUN_ENDED, "hung: xrWaitFrame")]];
        let result = compared(hung, log(), None);
        assert!(result.is_equal() && result.extra_events == 2, "{result:?}");
    }

    /// The frame in which a session was lost is compared, and not counted among the frames.
    #[test]
    fn a_frame_that_was_lost_is_compared() {
        let lost = |call| {
            let mut lost = frame(2, "VISIBLE", 1);
            lost.pop();
            lost.push(failed(call));
            lost
        };
        let again = || {
            let mut again = frame(3, "READY", 1);
            again.insert(0, event(SESSION_BEGINS, ""));
            again
        };
        let log = || vec![frame(1, "READY", 1), lost("xrLocateViews"), again()];
        let same = compared(log(), log(), None);
        assert_eq!((same.frames, same.frames_equal, same.events_equal, same.is_equal()), (2, 2, 4, true));
        let other = compared(log(), vec![frame(1, "READY", 1), lost("xrSyncActions"), again()], None);
        assert!(other.frames_equal == 2 && other.first_difference.unwrap().contains("xrSyncActions"));
    }
}
