//! Compares a session that runs with one that was recorded, frame by frame, while it runs.

use serde::Serialize;
use vergence_sense::{Body, Said};

/// How a replay compares with its recording. Its JSON is an interface.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Comparison {
    /// Frames of the recording.
    pub frames: u64,
    /// Of these, frames in which every call was made and answered alike, bit for bit, and the same views were submitted.
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
    heard: Vec<Said>,
    result: Comparison,
    /// Frames and events that the recording does not have are no difference after its end.
    is_over: bool,
}

fn is_event(said: &Said) -> bool {
    matches!(said, Said::Event(_))
}

/// What the simulated headset cannot give is not compared.
fn is_call(said: &Said) -> bool {
    !matches!(said, Said::Event(_) | Said::Hash(_) | Said::Joints { .. } | Said::Place { of: Body::Gaze, .. })
}

impl Verifier {
    /// `images_not_compared` says why the hashes of pictures mean nothing here, where they do not.
    pub(crate) fn new(
        expected: impl Iterator<Item = Vec<Said>> + Send + 'static,
        images_not_compared: Option<String>,
    ) -> Self {
        let result = Comparison { images_not_compared, ..Comparison::default() };
        Self { expected: Box::new(expected), heard: Vec::with_capacity(64), result, is_over: false }
    }

    pub(crate) fn hear(&mut self, said: &Said) {
        self.heard.push(said.clone());
        if matches!(said, Said::Submitted { .. }) {
            self.compare();
        }
    }

    fn compare(&mut self) {
        match self.expected.next() {
            Some(expected) => self.compare_with(&expected),
            None => self.is_over = true,
        }
        self.heard.clear();
    }

    fn differs(&mut self, what: impl FnOnce() -> String) {
        if self.result.first_difference.is_none() {
            self.result.first_difference = Some(what());
        }
    }

    fn compare_with(&mut self, expected: &[Said]) {
        let heard = std::mem::take(&mut self.heard);
        let frame = self.result.frames;
        // A list without a frame is what was left at the end.
        let whole = expected.iter().any(|said| matches!(said, Said::Frame { .. }));

        let (mut events, mut events_heard) =
            (expected.iter().filter(|s| is_event(s)), heard.iter().filter(|s| is_event(s)));
        loop {
            match (events.next(), events_heard.next()) {
                (Some(a), Some(b)) if a.is_same(b) => {
                    self.result.events += 1;
                    self.result.events_equal += 1;
                }
                (Some(a), b) => {
                    self.result.events += 1;
                    self.differs(|| {
                        format!("before frame {frame}: expected {}, found {}", word(a), found(b))
                    });
                }
                (None, Some(b)) => {
                    // After the end of a recording that was cut off, a session still says farewell.
                    if whole {
                        self.differs(|| {
                            format!("before frame {frame}: expected no event, found {}", word(b))
                        });
                    }
                }
                (None, None) => break,
            }
        }
        if !whole {
            return;
        }

        self.result.frames += 1;
        let (mut calls, mut calls_heard) =
            (expected.iter().filter(|s| is_call(s)), heard.iter().filter(|s| is_call(s)));
        let mut equal = true;
        for call in 0.. {
            match (calls.next(), calls_heard.next()) {
                (Some(a), Some(b)) if a.is_same(b) => {}
                (None, None) => break,
                (a, b) => {
                    equal = false;
                    let expected = found(a);
                    self.differs(|| {
                        format!("frame {frame}, call {call}: expected {expected}, found {}", found(b))
                    });
                    break;
                }
            }
        }
        self.result.frames_equal += u64::from(equal);
        self.compare_images(expected, &heard, frame);
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
    use vergence_sense::{Event, FrameHash};
    use vergence_time::{Span, Timestamp};

    fn frame(display: i64, state: &'static str, hash: u8) -> Vec<Said> {
        let display = Timestamp::from_nanos(display);
        vec![
            Said::Event(Event::new("session_state", state)),
            Said::Frame { now: display, display, period: Span::from_millis(11), should_render: true },
            Said::Hash(FrameHash { frame: 0, view: 0, hash: [hash; 32] }),
            Said::Submitted { display, views: None },
        ]
    }

    fn compared(expected: Vec<Vec<Said>>, heard: Vec<Vec<Said>>, why_not: Option<&str>) -> Comparison {
        let mut verifier = Verifier::new(expected.into_iter(), why_not.map(str::to_owned));
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

    #[test]
    fn after_the_end_of_a_recording_nothing_differs() {
        let log = vec![frame(1, "READY", 1), vec![Said::Event(Event::new("session_state", "STOPPING"))]];
        let mut heard = log.clone();
        heard.push(frame(2, "EXITING", 1));
        let result = compared(log, heard, None);
        assert_eq!((result.frames, result.frames_equal), (1, 1));
        // The farewell of the last session came within one more frame here: the recorded event is there.
        assert_eq!((result.events, result.events_equal, result.is_equal()), (2, 2, true));
    }
}
