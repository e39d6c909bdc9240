//! Where the wearer of a headset looks, as a source: the same stream as that of an eye tracker on a desk.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use vergence_render::Quality;
use vergence_scene::Scene;
use vergence_sense::{Event, Gaze, Progress, Reading, ReadingKind, Sample, Sink, Source, SourceStream};
use vergence_time::{Clock, Span, Timestamp};

use crate::config::{HeadsetChoice, RunConfig};
use crate::error::Error;
use crate::guest::{Guest, Moment, Offered, Stage, ToldGaze};
use crate::run::{Happening, run_with};
use crate::stop::Stop;

const EVENTS: usize = 0;
const GAZE: usize = 1;
/// So many readings may wait for a reader, several seconds of them; the rest is counted.
const WAITING: usize = 1024;
/// A source that is asked to end does so after this.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

enum Told {
    Begun(Offered),
    /// Nothing where the eyes are not seen.
    Gaze(Sample<Option<Gaze>>),
    /// The session is over.
    Over(Result<(), Error>),
}

/// Where the wearer of a headset looks: a session with nothing in it, which shows darkness and reads the gaze once a frame, on a
/// thread of its own.
///
/// - `events`: `connected` when frames are asked for, `lost` and `found` when the eyes are no longer or again seen, `gap`,
///   `disconnected`;
/// - `gaze`: a [`Gaze`] in the runtime's LOCAL space (y up, −z ahead), captured when the runtime says that it was measured, and
///   where it does not say so, when it arrived. A runtime that predicts says a time to come.
///
/// The source ends where the runtime ends the session, or loses it for good.
pub struct GazeSource {
    told: Receiver<Told>,
    missed: Arc<AtomicU64>,
    stop: Stop,
    thread: Option<JoinHandle<()>>,
    clock: Arc<dyn Clock>,
    streams: [SourceStream; 2],
    headset: String,
    is_seen: Option<bool>,
    is_over: bool,
}

struct Eyes {
    tell: SyncSender<Told>,
    missed: Arc<AtomicU64>,
    clock: Arc<dyn Clock>,
    /// Ours less the runtime's clock: the least that was found, since ours is read later. One machine's clocks do not drift apart.
    ahead: Option<Span>,
}

impl Eyes {
    fn captured(&mut self, told: &ToldGaze, arrived: Timestamp) -> Timestamp {
        let Some((sampled, asked)) = told.times else { return arrived };
        let Some(ahead) = arrived.since(asked) else { return arrived };
        let ahead = self.ahead.map_or(ahead, |least| least.min(ahead));
        self.ahead = Some(ahead);
        sampled.saturating_add(ahead)
    }
}

impl Guest for Eyes {
    fn begins(&mut self, offered: Offered) {
        // Another session may have another clock.
        self.ahead = None;
        let _ = self.tell.try_send(Told::Begun(offered));
    }

    fn follow(&mut self, now: &Moment, _: &mut Stage<'_>) -> bool {
        let arrived = self.clock.now();
        let captured = now.told_gaze.as_ref().map_or(arrived, |told| self.captured(told, arrived));
        let value = now.told_gaze.map(|told| told.in_local);
        match self.tell.try_send(Told::Gaze(Sample { captured, arrived, value })) {
            Ok(()) => true,
            Err(TrySendError::Full(_)) => {
                self.missed.fetch_add(1, Ordering::Relaxed);
                true
            }
            Err(TrySendError::Disconnected(_)) => false,
        }
    }
}

impl GazeSource {
    /// Begins a session on the headset that `config` names, and returns when it has begun; what is put on later is waited for.
    /// Of the configuration count which headset and what moves it; `clock` stamps.
    ///
    /// # Errors
    /// Where there is no headset, or it does not see the eyes.
    pub fn open(config: &RunConfig, clock: Arc<dyn Clock>) -> Result<Self, Error> {
        let stop = Stop::default();
        let config = RunConfig {
            headset: config.headset,
            profile: config.profile.clone(),
            motion: config.motion.clone(),
            wait_s: config.wait_s,
            // As long as the user likes.
            patience_s: f64::MAX,
            real_time: true,
            eye_gaze: true,
            quality: Quality { render_scale: *Quality::RENDER_SCALES.start(), msaa: 1, ..Quality::default() },
            stop: stop.clone(),
            ..RunConfig::default()
        };
        let is_simulated = config.headset == HeadsetChoice::Simulated;
        let (tell, told) = sync_channel(WAITING);
        let missed = Arc::new(AtomicU64::new(0));
        let mut eyes = Eyes { tell: tell.clone(), missed: missed.clone(), clock: clock.clone(), ahead: None };
        let run = move || {
            // Sentences of the session are for who shows a scene.
            let mut watch = |happening: Happening<'_>| {
                if let Happening::Said(sentence) = happening {
                    log::info!("{sentence}");
                }
            };
            let ended = run_with(&Arc::new(Scene::default()), &config, &mut eyes, &mut watch);
            // Who no longer listens need not hear.
            let _ = tell.send(Told::Over(ended.map(drop)));
        };
        let thread = std::thread::Builder::new().name("gaze".to_owned()).spawn(run).map_err(|error| {
            Error::Call(format!("the gaze is not read: no thread can be started: {error}"))
        })?;
        let source = Self {
            told,
            missed,
            stop,
            thread: Some(thread),
            clock,
            streams: [
                SourceStream::new("events", ReadingKind::Event),
                SourceStream::new("gaze", ReadingKind::Gaze).frame("local"),
            ],
            headset: if is_simulated { "simulated headset" } else { "headset" }.to_owned(),
            is_seen: None,
            is_over: false,
        };
        match source.told.recv() {
            Ok(Told::Begun(Offered { gaze: true, .. }) | Told::Gaze(..)) => Ok(source),
            Ok(Told::Over(Err(error))) => Err(error),
            Ok(Told::Begun(_) | Told::Over(Ok(()))) | Err(_) => Err(Error::Call(format!(
                "expected a headset that sees where its wearer looks, found a {} that does not say it",
                source.headset
            ))),
        }
    }

    /// Takes what one frame said; whether it gave something.
    fn take(&mut self, told: Sample<Option<Gaze>>, sink: &mut dyn Sink) -> bool {
        let Sample { captured, arrived, value } = told;
        let is_seen = value.is_some();
        let happened = match self.is_seen.replace(is_seen) {
            None => Some(Event::new("connected", "")),
            Some(was) if was == is_seen => None,
            Some(_) if is_seen => Some(Event::new("found", "the eyes are seen")),
            Some(_) => Some(Event::new("lost", "the eyes are not seen")),
        };
        if let Some(event) = happened {
            tell(sink, arrived, event);
        }
        sink.take(GAZE, Sample { captured, arrived, value: Reading::Gaze(value) });
        true
    }
}

fn tell(sink: &mut dyn Sink, at: Timestamp, event: Event) {
    sink.take(EVENTS, Sample { captured: at, arrived: at, value: Reading::Event(event) });
}

impl Source for GazeSource {
    fn streams(&self) -> &[SourceStream] {
        &self.streams
    }

    fn advance(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress {
        if self.is_over {
            return Progress::Ended;
        }
        loop {
            let left = until.since(self.clock.now()).map_or(i64::MAX, Span::as_nanos);
            if left <= 0 {
                return Progress::Idle;
            }
            let longest = Duration::from_nanos(left.unsigned_abs()).min(LONGEST_WAIT);
            let mut gave = false;
            match self.told.recv_timeout(longest) {
                // Begun anew, after a loss.
                Ok(Told::Begun(_)) | Err(RecvTimeoutError::Timeout) => {}
                Ok(Told::Gaze(told)) => gave = self.take(told, sink),
                Ok(Told::Over(ended)) => {
                    let why =
                        ended.err().map_or_else(|| "the session has ended".to_owned(), |e| e.to_string());
                    let event = Event { text: why.into(), ..Event::new("disconnected", "") };
                    tell(sink, self.clock.now(), event);
                    (self.is_over, gave) = (true, true);
                }
                Err(RecvTimeoutError::Disconnected) => {
                    self.is_over = true;
                    return Progress::Ended;
                }
            }
            let missed = self.missed.swap(0, Ordering::Relaxed);
            if missed > 0 {
                let event = Event::new("gap", "readings came faster than they were read");
                tell(sink, self.clock.now(), Event { after: missed as f64, ..event });
                gave = true;
            }
            if gave {
                return Progress::Gave;
            }
        }
    }
}

impl Drop for GazeSource {
    fn drop(&mut self) {
        self.stop.stop();
        // The thread never waits for us: what it tells beyond the queue is left out, but its last word it sends until heard.
        while matches!(self.told.recv(), Ok(Told::Begun(_) | Told::Gaze(..))) {}
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
