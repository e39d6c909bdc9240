//! What a session keeps of itself while it runs: what every call said goes to the recording, to the comparison with an
//! earlier recording, or to both. Nothing of this exists where neither is asked for.

use std::any::Any;
use std::time::Instant;

use vergence_sense::{FrameHash, Said};
use vergence_time::{Span, Timestamp};
use vergence_xr::{Client, Tap};

use crate::recording::Recording;
use crate::report::Milliseconds;
use crate::tally::Series;
use crate::verify::Verifier;

/// Hears the session.
pub(crate) struct Book {
    pub(crate) recording: Option<Recording>,
    pub(crate) verifier: Option<Verifier>,
    /// Whether pictures are hashed.
    pub(crate) hashes: bool,
    /// Frames that were ended so far.
    frames: u64,
    /// A frame was waited for.
    is_timed: bool,
    /// Host time spent here in the frame under way, nanoseconds.
    spent_ns: u64,
    /// The same of the frames before.
    spent: Series,
}

impl Book {
    pub(crate) fn new(recording: Option<Recording>, verifier: Option<Verifier>, hashes: bool) -> Self {
        Self {
            recording,
            verifier,
            hashes,
            frames: 0,
            is_timed: false,
            spent_ns: 0,
            spent: Series::default(),
        }
    }

    /// The frame under way: those before it that were ended, over all sessions of a run.
    pub(crate) fn frame(&self) -> u64 {
        self.frames
    }

    fn spent_so_far(&self) -> Span {
        Span::from_nanos(i64::try_from(self.spent_ns).unwrap_or(i64::MAX))
    }

    /// Host time per frame that was spent here, microseconds.
    pub(crate) fn cost_us(&self) -> Milliseconds {
        let Milliseconds { p50, p95, p99, max } = self.spent.percentiles();
        Milliseconds { p50: p50 * 1e3, p95: p95 * 1e3, p99: p99 * 1e3, max: max * 1e3 }
    }

    /// What the frame that was ended cost and how old its pose was: host time, which is kept and never compared.
    pub(crate) fn diagnose(&mut self, cpu: Span, pose_age: Span) {
        let spent = self.spent_so_far();
        if let Some(recording) = &mut self.recording {
            recording.diagnose(cpu, pose_age, spent);
        }
    }
}

impl Tap for Book {
    fn hear(&mut self, said: &Said) {
        let began = Instant::now();
        if matches!(said, Said::Frame { .. }) {
            if std::mem::replace(&mut self.is_timed, true) {
                self.spent.add(self.spent_so_far());
            }
            self.spent_ns = 0;
        }
        let frame = self.frame();
        if let Some(recording) = &mut self.recording {
            recording.hear(said, frame);
        }
        if let Some(verifier) = &mut self.verifier {
            verifier.hear(said);
        }
        self.frames += u64::from(matches!(said, Said::Submitted { .. }));
        self.spent_ns += u64::try_from(began.elapsed().as_nanos()).unwrap_or(u64::MAX);
    }
}

/// The book that a session's client writes, where there is one.
pub(crate) fn of(client: &mut Client) -> Option<&mut Book> {
    client.tap_mut().and_then(|tap| (tap as &mut dyn Any).downcast_mut())
}

/// Takes the book from a session that is over.
pub(crate) fn take(client: &mut Client) -> Option<Box<Book>> {
    client.take_tap().and_then(|tap| (tap as Box<dyn Any>).downcast().ok())
}

/// Hashes a picture.
pub(crate) fn hash(frame: u64, view: u32, bytes: &[u8]) -> FrameHash {
    FrameHash { frame, view, hash: *blake3::hash(bytes).as_bytes() }
}

/// A clock that says how late after a frame was waited for it is, on the session's clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SessionNow {
    session: Timestamp,
    host: Instant,
    /// The session's clock stands still between frames.
    is_virtual: bool,
}

impl SessionNow {
    pub(crate) fn new(session: Timestamp, is_virtual: bool) -> Self {
        Self { session, host: Instant::now(), is_virtual }
    }

    pub(crate) fn read(&self) -> Timestamp {
        if self.is_virtual {
            return self.session;
        }
        let passed = i64::try_from(self.host.elapsed().as_nanos()).unwrap_or(i64::MAX);
        self.session.saturating_add(Span::from_nanos(passed))
    }
}
