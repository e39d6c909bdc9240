//! `xrWaitFrame` on a thread of its own: a runtime that never returns from it must not take the program along.
//!
//! It is the one call that is meant to block, for as long as the runtime likes. No other way leads out of a call that does
//! not return: whoever waits in it is lost. The frame thread waits for the answer instead, and only for so long.
//!
//! Its cost: 4.5 µs of processor time per frame on this thread, the simulated runtime's own part included, where no frame is
//! waited for; 38 µs at 90 Hz by the wall clock, where each frame also wakes a sleeping thread twice (two busy cores, 1,800
//! frames each; nanoseconds by the kernel's own count):
//!
//! ```text
//! vergence run Box.glb --headset simulated --seconds 20 --real-time & sleep 20
//! cat $(dirname $(grep -l xrWaitFrame /proc/$!/task/*/comm))/schedstat
//! ```

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use openxr::sys;

use crate::error::Error;

const CALL: &str = "xrWaitFrame";

pub(crate) type Answer = Result<openxr::FrameState, sys::Result>;

/// Waits for frames. Question and answer go through channels of one place each, which allocate nothing.
pub(crate) struct Waiter {
    /// `None` once nobody answers any more.
    ask: Option<SyncSender<()>>,
    answers: Receiver<Answer>,
    thread: Option<JoinHandle<()>>,
    patience: Duration,
}

impl Waiter {
    /// # Errors
    /// Where the system has no thread left.
    pub(crate) fn start(mut waiter: openxr::FrameWaiter, patience: Duration) -> Result<Self, Error> {
        let (ask, questions) = sync_channel(1);
        let (answer, answers) = sync_channel(1);
        let wait = move || {
            while questions.recv().is_ok() {
                if answer.send(waiter.wait()).is_err() {
                    break;
                }
            }
        };
        let thread = std::thread::Builder::new().name("xrWaitFrame".into()).spawn(wait);
        let thread = thread.map_err(|source| Error::Unsupported {
            what: "thread that waits for frames",
            expected: "one more thread".into(),
            found: source.to_string(),
        })?;
        Ok(Self { ask: Some(ask), answers, thread: Some(thread), patience })
    }

    /// What the runtime answers.
    ///
    /// # Errors
    /// [`Error::Hung`] where it does not answer in time, and from then on.
    pub(crate) fn wait(&mut self) -> Result<Answer, Error> {
        let hung = Error::Hung { call: CALL, waited_s: self.patience.as_secs_f64() };
        let Some(ask) = &self.ask else { return Err(hung) };
        let answer = match ask.send(()) {
            Ok(()) => self.answers.recv_timeout(self.patience),
            Err(_) => Err(RecvTimeoutError::Disconnected),
        };
        match answer {
            Ok(answer) => Ok(answer),
            Err(_) => {
                self.ask = None;
                // It is in the call for ever, and keeps the session with it.
                self.thread = None;
                Err(hung)
            }
        }
    }

    pub(crate) const fn is_hung(&self) -> bool {
        self.ask.is_none()
    }
}

impl Drop for Waiter {
    fn drop(&mut self) {
        self.ask = None;
        // The thread holds the session: it must be gone before that is destroyed. A thread that hangs is not waited for.
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the thread that waits for frames panicked");
        }
    }
}
