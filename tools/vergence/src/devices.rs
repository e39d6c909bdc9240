//! `vergence devices`: what is plugged in, and what it says.

use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use vergence_input::Found;
use vergence_log::Breaks;
use vergence_sense::{Pose, Progress, Reading, Sample, Sink, Source, SourceStream};
use vergence_session::{GazeSource, HeadsetChoice, RunConfig};
use vergence_time::{Clock, HostClock, Span};

use crate::bindings::{Actions, Check};
use crate::failure::Failure;

/// Lists the devices that are plugged in, shows what they say
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(clap::Subcommand)]
enum Verb {
    /// What is plugged in, which adapter reads it, what stands in the way and the command that mends it
    List {
        /// How devices are read: HID mappings count here
        #[arg(long, value_name = "FILE")]
        config: Option<PathBuf>,
        /// Prints one JSON array of devices
        #[arg(long)]
        json: bool,
    },
    /// Values, rates, gaps, latency and clock of devices, as they come, and with --bindings what actions are; ends with Ctrl-C
    Monitor(Monitor),
    Bindings(Check),
}

#[derive(clap::Args)]
struct Monitor {
    /// Paths, parts of names, serial:PATH, desktop, gaze or gaze:MOTION; as for `record --device` [default: every device that is
    /// listed and can be read]
    #[arg(value_name = "DEVICE")]
    devices: Vec<String>,
    /// How devices are read: baud rate, streams of devices that do not describe themselves, HID mappings, extra mouse buttons; all keys
    /// are in crates/vergence-input/MAPPING.md
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Shows the actions of these bindings (TOML), too: what they are, how often they changed, conflicts. The file may be changed
    /// meanwhile; its keys are in crates/vergence-action/README.md
    #[arg(long, value_name = "FILE")]
    bindings: Option<PathBuf>,
    /// Ends after so many seconds [default: with Ctrl-C]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    seconds: Option<f64>,
}

/// Reads how long something lasts.
pub fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("expected a positive number of seconds".into()),
    }
}

impl Args {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        match self.verb {
            Verb::List { config, json } => list(config.as_ref(), json),
            Verb::Monitor(monitor) => monitor.run(),
            Verb::Bindings(check) => check.run(),
        }
    }
}

/// From the adapters: a device or a file that is not there is a wrong call.
pub fn failed(error: &vergence_input::Error) -> Failure {
    match error {
        vergence_input::Error::NoDevice { .. } | vergence_input::Error::Config(_) => Failure::call(error),
        _ => Failure::work(error),
    }
}

fn list(config: Option<&PathBuf>, json: bool) -> Result<(), Failure> {
    let config = config.map(|path| vergence_input::Config::read(path)).transpose().map_err(|e| failed(&e))?;
    let config = config.unwrap_or_default();
    let mut found = vergence_input::found(&config);
    // Last: nothing reads them yet.
    found.extend(vergence_input::hid::unmapped(&config));
    if json {
        println!("{}", serde_json::to_string(&found).map_err(|error| Failure::work(&error))?);
        return Ok(());
    }
    if found.is_empty() {
        println!("No gamepad, HID device with a mapping, or USB serial device is plugged in.");
        println!(
            "What is not listed is read by its name: serial:PATH (a port without USB), desktop (keyboard, mouse and touches of a \
             window), gaze (of an OpenXR headset)."
        );
        return Ok(());
    }
    for device in found {
        let ids = device.vendor_id.zip(device.product_id);
        let ids = ids.map_or_else(String::new, |(vendor, product)| format!("  {vendor:04x}:{product:04x}"));
        println!("{:8} {}  {}{ids}", device.adapter, device.path, device.name);
        if !device.streams.is_empty() {
            println!("         {}", device.streams.join(", "));
        }
        if let Some(problem) = device.problem {
            println!("         problem: {problem}");
        }
        if let Some(remedy) = device.remedy {
            println!("         remedy:  {remedy}");
        }
    }
    Ok(())
}

/// Devices that were opened, each with a name of its own for its streams.
pub struct Opened {
    /// Without slashes; unique.
    pub name: String,
    /// What it was found as.
    pub device: Found,
    /// To be asked.
    pub source: Box<dyn Source>,
}

/// Opens the devices that are named or, where none is, every one without a problem.
pub fn open(
    names: &[String],
    config: Option<&PathBuf>,
    clock: &Arc<dyn Clock>,
) -> Result<Vec<Opened>, Failure> {
    let config = config.map(|path| vergence_input::Config::read(path)).transpose().map_err(|e| failed(&e))?;
    open_with(names, &config.unwrap_or_default(), clock)
}

fn open_with(
    names: &[String],
    config: &vergence_input::Config,
    clock: &Arc<dyn Clock>,
) -> Result<Vec<Opened>, Failure> {
    let devices: Vec<Found> = if names.is_empty() {
        vergence_input::found(config).into_iter().filter(|device| device.problem.is_none()).collect()
    } else {
        let each = names.iter().map(|name| match eyes(name) {
            Some(found) => Ok(found),
            None => vergence_input::find(name, config),
        });
        each.collect::<Result<_, _>>().map_err(|error| failed(&error))?
    };
    let mut opened: Vec<Opened> = Vec::new();
    for device in devices {
        if device.adapter == GAZE {
            let source = Box::new(open_gaze(&device.path, clock)?);
            opened.push(Opened { name: unused(&opened, GAZE), device, source });
            continue;
        }
        let source = match vergence_input::open(&device, config, clock.clone()) {
            Ok(source) => source,
            Err(error) if names.is_empty() => {
                eprintln!("vergence: {error}");
                continue;
            }
            Err(error) => return Err(failed(&error)),
        };
        let base: String = device
            .name
            .to_lowercase()
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
            .collect();
        let base = base.trim_matches('_').to_owned();
        let base = if base.is_empty() { device.adapter.to_owned() } else { base };
        let name = unused(&opened, &base);
        opened.push(Opened { name, device, source });
    }
    if opened.is_empty() {
        return Err(Failure::Work(
            "expected a device, found none that can be read: 'vergence devices list' says what there is"
                .into(),
        ));
    }
    Ok(opened)
}

/// `base`, with a number where another device has that name.
fn unused(opened: &[Opened], base: &str) -> String {
    let taken = |name: &str| opened.iter().any(|other| other.name == name);
    let numbered = (2u32..).map(|number| format!("{base}_{number}"));
    let mut names = std::iter::once(base.to_owned()).chain(numbered);
    names.find(|name| !taken(name)).unwrap_or_else(|| base.to_owned())
}

/// Adapter, and name of the streams, of where the wearer of a headset looks.
const GAZE: &str = "gaze";

/// The eyes of who wears a headset: `gaze` the one that the system's OpenXR runtime has, `gaze:MOTION` the simulated one, moved so.
fn eyes(name: &str) -> Option<Found> {
    let is_gaze = name == GAZE || name.strip_prefix(GAZE).is_some_and(|rest| rest.starts_with(':'));
    let found = || Found { streams: vec![GAZE.to_owned()], ..Found::new(GAZE, name.to_owned()) };
    is_gaze.then(found)
}

fn open_gaze(name: &str, clock: &Arc<dyn Clock>) -> Result<GazeSource, Failure> {
    let motion = name.split_once(':').map(|(_, motion)| motion.to_owned());
    let headset = if motion.is_some() { HeadsetChoice::Simulated } else { HeadsetChoice::OpenXr };
    let config = RunConfig { headset, motion, ..RunConfig::default() };
    GazeSource::open(&config, clock.clone())
        .map_err(|error| if error.is_wrong_call() { Failure::call(&error) } else { Failure::work(&error) })
}

/// `true` once Ctrl-C was pressed, the terminal closed, or the process asked to end; a second time ends it at once.
pub fn interrupted() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register_conditional_shutdown(signal, 130, stop.clone())
            .and_then(|_| signal_hook::flag::register(signal, stop.clone()))
            .map_err(|error| Failure::work(&error))?;
    }
    Ok(stop)
}

/// What was seen of one stream.
#[derive(Clone, Debug, Default)]
struct Seen {
    count: u64,
    since: u64,
    delay_ms: f64,
    value: String,
}

#[derive(Default)]
struct Screen {
    names: Vec<String>,
    seen: BTreeMap<usize, Seen>,
    gaps: Breaks,
    /// The device will never say anything more.
    is_over: bool,
}

impl Sink for Screen {
    fn appears(&mut self, place: usize, stream: &SourceStream) {
        self.names.resize(self.names.len().max(place + 1), String::new());
        stream.name.clone_into(&mut self.names[place]);
    }

    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        let seen = self.seen.entry(stream).or_default();
        seen.count += 1;
        seen.delay_ms = sample.arrived.since(sample.captured).unwrap_or(Span::ZERO).as_millis_f64();
        if let Reading::Event(event) = &sample.value {
            self.gaps.follow(event);
        }
        seen.value = words(&sample.value);
    }
}

/// Numbers in a few words.
pub fn listed(values: &[f64]) -> String {
    let each: Vec<String> = values.iter().map(|value| format!("{value:.4}")).collect();
    each.join(" ")
}

/// A pose in a few words.
pub fn pose_words(pose: &Pose) -> String {
    pose.reference_from_device().map_or_else(
        || "lost".into(),
        |rigid| {
            let (p, q) = (rigid.translation.vector, rigid.rotation.coords);
            format!("{}  {}", listed(p.as_slice()), listed(q.as_slice()))
        },
    )
}

/// A reading in a few words.
pub fn words(reading: &Reading<'_>) -> String {
    let list = listed;
    match reading {
        Reading::Button(button) => match button.0 {
            Some(true) => "pressed".into(),
            Some(false) => "released".into(),
            None => "not offered".into(),
        },
        Reading::Axis(axis) => axis.0.map_or_else(|| "not offered".into(), |value| format!("{value:.4}")),
        Reading::Vector2(vector) => {
            vector.0.map_or_else(|| "not offered".into(), |v| list(&v.map(f64::from)))
        }
        Reading::Touch(touch) => {
            format!("{} {:?} {}", touch.contact, touch.phase, list(&touch.position)).to_lowercase()
        }
        Reading::Scalar(scalar) => scalar.0.to_string(),
        Reading::Imu(imu) => format!(
            "gyr {}  acc {}{}",
            list(imu.gyr_rad_s.as_slice()),
            list(imu.acc_m_s2.as_slice()),
            imu.mag_ut.map_or_else(String::new, |mag| format!("  mag {}", list(mag.as_slice())))
        ),
        Reading::Pose(pose) => pose_words(pose),
        Reading::Gaze(gaze) => gaze.map_or_else(
            || "lost".into(),
            |gaze| format!("{}  {}", list(gaze.origin.coords.as_slice()), list(gaze.direction.as_slice())),
        ),
        Reading::Image(image) => {
            format!("{}x{} {} {} B", image.width, image.height, image.encoding, image.data.len())
        }
        Reading::Event(event) => {
            let number = |value: f64| if value.is_nan() { String::new() } else { format!(" {value}") };
            format!("{} {}{}{}", event.name, event.text, number(event.before), number(event.after))
        }
    }
}

/// A screen, and what the device does by the bindings.
struct Watched<'a> {
    screen: &'a mut Screen,
    actions: Option<(usize, &'a mut Actions)>,
}

impl Sink for Watched<'_> {
    fn appears(&mut self, place: usize, stream: &SourceStream) {
        self.screen.appears(place, stream);
        if let Some((device, actions)) = &mut self.actions {
            actions.appears(*device, place, stream);
        }
    }

    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        if let Some((device, actions)) = &mut self.actions {
            actions.take(*device, stream, &sample);
        }
        self.screen.take(stream, sample);
    }
}

/// Rows that a terminal has.
const ROWS: u16 = 24;

impl Monitor {
    fn run(&self) -> Result<(), Failure> {
        let clock: Arc<dyn Clock> = Arc::new(HostClock::start());
        let config = self.config.as_ref().map(|path| vergence_input::Config::read(path)).transpose();
        let mut config = config.map_err(|error| failed(&error))?.unwrap_or_default();
        let mut actions = self.bindings.as_deref().map(Actions::read).transpose()?;
        config.desktop.extra_mouse_buttons |= actions.as_ref().is_some_and(Actions::extra_mouse_buttons);
        let mut opened = open_with(&self.devices, &config, &clock)?;
        if let Some(actions) = &mut actions {
            actions.wire(&opened);
        }
        let stop = interrupted()?;
        let mut screens: Vec<Screen> = opened.iter().map(|_| Screen::default()).collect();
        let start = Instant::now();
        let live = std::io::stdout().is_terminal();
        let (mut drawn_at, mut lines) = (Instant::now(), 0);
        let share = Span::from_millis((100 / i64::try_from(opened.len()).unwrap_or(100)).max(1));
        let mut left = opened.len();
        let is_over = |left: usize| {
            left == 0
                || stop.load(std::sync::atomic::Ordering::Relaxed)
                || self.seconds.is_some_and(|seconds| start.elapsed().as_secs_f64() >= seconds)
        };
        while !is_over(left) {
            if let Some(actions) = &mut actions {
                actions.advance(clock.now());
            }
            for (place, (device, screen)) in opened.iter_mut().zip(&mut screens).enumerate() {
                if screen.is_over {
                    continue;
                }
                let mut watched =
                    Watched { screen: &mut *screen, actions: actions.as_mut().map(|own| (place, own)) };
                let until = clock.now().saturating_add(share);
                while clock.now() < until {
                    match device.source.advance(until, &mut watched) {
                        Progress::Gave => {}
                        Progress::Idle => break,
                        Progress::Ended => {
                            (watched.screen.is_over, left) = (true, left - 1);
                            break;
                        }
                    }
                }
            }
            let elapsed = drawn_at.elapsed().as_secs_f64();
            if left == 0 || elapsed >= if live { 0.25 } else { 1.0 } {
                let mut text = draw(&opened, &mut screens, elapsed);
                if let Some(actions) = &actions {
                    // In sight where not all fits.
                    text = actions.draw() + &text;
                }
                if live {
                    // What is above the top cannot be drawn over.
                    let size = rustix::termios::tcgetwinsize(std::io::stdout());
                    let rows = size.map_or(ROWS, |size| size.ws_row).max(2);
                    text = text.lines().take(usize::from(rows) - 1).flat_map(|line| [line, "\n"]).collect();
                }
                let up = if live && lines > 0 { format!("\x1b[{lines}A\x1b[J") } else { String::new() };
                lines = text.lines().count();
                // A row that is wider than the terminal is cut: one that is wrapped would be two.
                let text = if live { format!("{up}\x1b[?7l{text}\x1b[?7h") } else { text };
                print!("{text}");
                if std::io::stdout().flush().is_err() {
                    // Whoever listened has gone.
                    break;
                }
                drawn_at = Instant::now();
            }
        }
        Ok(())
    }
}

fn draw(opened: &[Opened], screens: &mut [Screen], elapsed: f64) -> String {
    let mut text = format!("  {:24} {:>11} {:>11}  values\n", "stream", "rate", "latency");
    for (device, screen) in opened.iter().zip(screens) {
        let ended = if screen.is_over { ", ended" } else { "" };
        let losses = device.source.losses().into_iter().filter(|(_, count)| *count > 0);
        let losses: String = losses.map(|(way, count)| format!(", {count} {way}")).collect();
        let (name, path, gaps) = (&device.device.name, &device.device.path, screen.gaps.count());
        text += &format!("{name} ({path}), {gaps} gaps{losses}{ended}\n");
        for (place, seen) in &mut screen.seen {
            let stream = device.source.streams().get(*place);
            let (name, unit) = stream.map_or(("?", ""), |stream| (stream.name.as_str(), &*stream.unit));
            let rate = (seen.count - seen.since) as f64 / elapsed;
            seen.since = seen.count;
            text += &format!("  {name:24} {rate:8.1} Hz {:8.2} ms  {} {unit}\n", seen.delay_ms, seen.value);
        }
    }
    text
}
