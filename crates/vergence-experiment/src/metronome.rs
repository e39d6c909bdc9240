//! The metronome of an instruction: clicks at a fixed interval, played by a program that reads samples.
//!
//! Intervals are counted in samples of sound, so that they are as exact as the sound card's clock, whatever this computer is
//! busy with; only the delay of the first click, about a tenth of a second, is the player's. A crate for sound would need
//! ALSA's headers to build; every desktop has a player.

use std::io::Write as _;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use vergence_study::Study;

use crate::error::Error;

/// Samples per second.
const RATE: u32 = 48_000;
/// Samples that are handed over at once: 10 ms.
const PIECE: usize = 480;
/// So far ahead of the clock samples are handed over: a player must not run dry.
const AHEAD: Duration = Duration::from_millis(60);
/// A click: 20 ms of a fading tone.
const CLICK: usize = 960;
const TONE_HZ: f64 = 1000.0;
const LOUDNESS: f64 = 0.5 * i16::MAX as f64;

/// Players that are looked for, in this order.
const PLAYERS: [(&str, &[&str]); 2] = [
    ("paplay", &["--raw", "--rate=48000", "--format=s16le", "--channels=1", "--latency-msec=20"]),
    ("aplay", &["-q", "-t", "raw", "-f", "S16_LE", "-r", "48000", "-c", "1", "-"]),
];

/// What plays the metronome.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Sound {
    /// The first player that is installed.
    #[default]
    Found,
    /// This program with its arguments: it reads 16-bit samples, little end first, one channel, 48 kHz.
    Program(Vec<String>),
    /// Nothing: for whoever hears a metronome of their own. The log says so.
    Silent,
}

impl std::str::FromStr for Sound {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        match text {
            "auto" => Ok(Self::Found),
            "none" => Ok(Self::Silent),
            _ => {
                let words: Vec<String> = text.split_whitespace().map(str::to_owned).collect();
                if words.is_empty() {
                    return Err(Error::Call("expected auto, none or a program, found nothing".into()));
                }
                Ok(Self::Program(words))
            }
        }
    }
}

impl std::fmt::Display for Sound {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Found => f.write_str("auto"),
            Self::Silent => f.write_str("none"),
            Self::Program(words) => f.write_str(&words.join(" ")),
        }
    }
}

/// Plays clicks until it is dropped.
#[derive(Debug)]
pub struct Metronome {
    shared: Arc<Shared>,
    player: Child,
    name: String,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    /// Between clicks, nanoseconds; 0: none.
    period_ns: AtomicU64,
    stop: AtomicBool,
    failed: AtomicBool,
}

impl Metronome {
    /// Starts the player, where an instruction of `study` has a metronome; `None` where none has, or nothing is to be heard.
    ///
    /// # Errors
    /// Where there is no player.
    pub fn of(study: &Study, sound: &Sound) -> Result<Option<Self>, Error> {
        if study.instructions.iter().all(|one| one.metronome.is_none()) {
            return Ok(None);
        }
        match sound {
            Sound::Silent => Ok(None),
            Sound::Program(words) => {
                let (program, arguments) = words.split_first().map_or(("", [].as_slice()), |(a, b)| (a, b));
                Self::start(program, arguments).map(Some)
            }
            Sound::Found => {
                for (program, arguments) in PLAYERS {
                    let arguments: Vec<String> = arguments.iter().map(|&one| one.to_owned()).collect();
                    if let Ok(metronome) = Self::start(program, &arguments) {
                        return Ok(Some(metronome));
                    }
                }
                Err(Error::Call(
                    "this study has a metronome: expected paplay (pulseaudio-utils) or aplay (alsa-utils) to play it, found \
                     neither; --sound PROGRAM names another, --sound none leaves it out, and the log says so"
                        .to_owned(),
                ))
            }
        }
    }

    fn start(program: &str, arguments: &[String]) -> Result<Self, Error> {
        let mut player = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|error| Error::Call(format!("--sound: {program} cannot be started: {error}")))?;
        let shared = Arc::new(Shared::default());
        let thread = player.stdin.take().map(|stdin| {
            let shared = Arc::clone(&shared);
            std::thread::spawn(move || play(stdin, &shared))
        });
        Ok(Self { shared, player, name: program.to_owned(), thread })
    }

    /// Clicks every `period_s` from now on, or not at all. Takes no lock and waits for nothing.
    ///
    /// # Errors
    /// Where the player has ended: movements without their metronome are not those of the study.
    pub fn set(&self, period_s: Option<f64>) -> Result<(), Error> {
        let period_ns = period_s.map_or(0, |seconds| (seconds * 1e9).max(1.0) as u64);
        self.shared.period_ns.store(period_ns, Ordering::Relaxed);
        if self.shared.failed.load(Ordering::Relaxed) {
            return Err(Error::Silent { player: self.name.clone() });
        }
        Ok(())
    }
}

impl Drop for Metronome {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        // A player that takes nothing any more would keep the thread waiting.
        let until = Instant::now() + Duration::from_millis(500);
        while self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
        }
        drop(self.player.kill());
        drop(self.player.wait());
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

fn play(mut player: ChildStdin, shared: &Shared) {
    let began = Instant::now();
    let mut clicks = Clicks::default();
    let (mut piece, mut bytes) = ([0i16; PIECE], [0u8; 2 * PIECE]);
    for number in 0u32.. {
        if shared.stop.load(Ordering::Relaxed) {
            return;
        }
        let period_ns = shared.period_ns.load(Ordering::Relaxed);
        clicks.fill(&mut piece, (period_ns > 0).then(|| period_ns as f64 * 1e-9 * f64::from(RATE)));
        for (two, sample) in bytes.chunks_exact_mut(2).zip(piece) {
            two.copy_from_slice(&sample.to_le_bytes());
        }
        if player.write_all(&bytes).and_then(|()| player.flush()).is_err() {
            shared.failed.store(true, Ordering::Relaxed);
            return;
        }
        let due = began + Duration::from_millis(10) * number;
        let early = due.saturating_duration_since(Instant::now() + AHEAD);
        if !early.is_zero() {
            std::thread::sleep(early);
        }
    }
}

/// Clicks as samples.
#[derive(Debug, Default)]
struct Clicks {
    period: Option<f64>,
    /// Samples until the next click.
    left: f64,
    /// Samples of the click under way.
    into: Option<usize>,
}

impl Clicks {
    /// The next samples; `period` in samples. A new period begins with a click.
    fn fill(&mut self, samples: &mut [i16], period: Option<f64>) {
        if self.period != period {
            self.period = period;
            self.left = 0.0;
        }
        for sample in samples {
            if let Some(period) = period {
                if self.left < 0.5 {
                    self.into = Some(0);
                    self.left += period.max(1.0);
                }
                self.left -= 1.0;
            }
            *sample = match &mut self.into {
                Some(into) if *into < CLICK => {
                    let (t, fading) = (*into as f64 / f64::from(RATE), 1.0 - *into as f64 / CLICK as f64);
                    *into += 1;
                    (LOUDNESS * fading * (std::f64::consts::TAU * TONE_HZ * t).cos()) as i16
                }
                _ => 0,
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_study::TEMPLATE;

    /// Where clicks begin: the loudest sample, after silence.
    fn onsets(samples: &[i16]) -> Vec<usize> {
        let loud = LOUDNESS as i16;
        (0..samples.len()).filter(|&i| samples[i] == loud).collect()
    }

    #[test]
    fn clicks_keep_their_period() {
        for period_s in [0.05, 0.213_37, 0.7, 3.0] {
            let period = period_s * f64::from(RATE);
            let mut clicks = Clicks::default();
            let mut heard = vec![0i16; (1000.0 * period) as usize];
            for piece in heard.chunks_mut(PIECE) {
                clicks.fill(piece, Some(period));
            }
            let found = onsets(&heard);
            assert!((999..=1000).contains(&found.len()), "{}", found.len());
            for (i, at) in found.iter().enumerate() {
                // No drift: every click is within a sample of its time.
                assert!((*at as f64 - i as f64 * period).abs() <= 1.0, "{period_s}: click {i} at {at}");
            }
        }
        let mut clicks = Clicks::default();
        let mut heard = vec![0i16; RATE as usize];
        clicks.fill(&mut heard, None);
        assert!(heard.iter().all(|sample| *sample == 0));
    }

    #[test]
    fn a_player_gets_the_clicks_and_its_end_is_noticed() {
        let dir = tempfile::tempdir().unwrap();
        let study = |from: &str, to: &str| Study::parse("t".as_ref(), &TEMPLATE.replace(from, to)).unwrap();
        assert!(Metronome::of(&study("", ""), &Sound::Found).unwrap().is_none());
        let with = study("# metronome = 80", "metronome = 80");
        assert!(Metronome::of(&with, &Sound::Silent).unwrap().is_none());
        let absent = "no-such-player-here".parse().unwrap();
        assert!(Metronome::of(&with, &absent).unwrap_err().is_wrong_call());
        let heard = dir.path().join("heard");
        let player = format!("dd of={} status=none", heard.display());
        let metronome = Metronome::of(&with, &player.parse().unwrap()).unwrap().unwrap();
        metronome.set(Some(0.1)).unwrap();
        let began = Instant::now();
        let length = || std::fs::metadata(&heard).map_or(0, |about| about.len());
        while length() < 2 * 48_000 {
            assert!(began.elapsed() < Duration::from_secs(60), "the player heard {} bytes", length());
            std::thread::sleep(Duration::from_millis(20));
        }
        drop(metronome);
        let bytes = std::fs::read(&heard).unwrap();
        let samples: Vec<i16> =
            bytes.chunks_exact(2).map(|two| i16::from_le_bytes([two[0], two[1]])).collect();
        let found = onsets(&samples);
        assert!(found.len() >= 9 && found.windows(2).all(|pair| pair[1] - pair[0] == 4800), "{found:?}");
        let metronome = Metronome::of(&with, &"true".parse().unwrap()).unwrap().unwrap();
        let began = Instant::now();
        while metronome.set(Some(0.1)).is_ok() {
            assert!(began.elapsed() < Duration::from_secs(60), "nobody notices that the player has ended");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}
