//! A HID device as a source.

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Point3, UnitVector3, Vector3};
use vergence_sense::{Event, Gaze, Progress, Reading, Sample, Sink, Source, SourceStream};
use vergence_time::{Clock, ClockKnobs, ClockMap, ClockState, Counter, Span, Timestamp};

use super::descriptor::Layout;
use super::mapping::{MOST_VALUES, Mapping, Plan, Resolved};
use super::node::{Reports, look_up, open};
use crate::config::Config;
use crate::connection::{ClockReport, TRY_AGAIN, own_streams, tell};
use crate::error::Error;
use crate::found::Found;
use crate::values::reading;

/// Longer reports than this there are none.
const MOST_REPORT: usize = 16 << 10;
/// A source that is asked to end does so after this.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// A gap of more is a device that began anew.
const MOST_GAP: u64 = 1 << 15;

/// A clock that is set more often than this in so long is none.
const MOST_JUMPS: u32 = 5;
const CLOCK_WATCH: Span = Span::from_millis(2000);

type Opener = Box<dyn FnMut() -> std::io::Result<Box<dyn Reports>> + Send>;

/// What is known of one stream while it is read.
struct Open {
    resolved: Resolved,
    /// As last seen; of a number that was not seen yet, NaN.
    values: [f64; MOST_VALUES],
    /// Of a gaze: whether it was there when it was last asked for.
    is_seen: Option<bool>,
}

/// A HID device as a source: the streams that a mapping makes of its reports. A device that is unplugged is waited for, under
/// any name that it comes back with.
pub struct HidSource {
    device: Option<Box<dyn Reports>>,
    opener: Opener,
    try_at: Timestamp,
    clock: Arc<dyn Clock>,
    mapping: Mapping,
    streams: Vec<SourceStream>,
    open: Vec<Open>,
    plan: Plan,
    numbered: bool,
    map: Option<ClockMap>,
    report: ClockReport,
    /// Since when the jumps of the device's clock are counted, and how many there were then.
    clock_watched: Option<(Timestamp, u32)>,
    next_sequence: Option<u64>,
    lost: u64,
    buffer: Box<[u8]>,
}

impl HidSource {
    /// Opens `device` with the mapping that fits.
    ///
    /// # Errors
    /// Where there is no mapping for it, it cannot be opened, or its descriptor cannot be understood.
    pub fn open(device: &Found, config: &Config, clock: Arc<dyn Clock>) -> Result<Self, Error> {
        let (now, mapping) =
            look_up(device, config).ok_or_else(|| Error::open(device, "no mapping is for it"))?;
        let first = open(&now.path).map_err(|error| Error::open(device, error))?;
        let (wanted, config) = (device.clone(), config.clone());
        let mut first = Some(first);
        let opener = move || {
            if let Some(first) = first.take() {
                return Ok(Box::new(first) as Box<dyn Reports>);
            }
            let (now, _) = look_up(&wanted, &config).ok_or(std::io::ErrorKind::NotFound)?;
            Ok(Box::new(open(&now.path)?) as Box<dyn Reports>)
        };
        Self::new(device.name.clone(), Box::new(opener), mapping, clock)
    }

    /// Reads what `opener` opens, and asks it again after a loss. `name` is for errors.
    ///
    /// # Errors
    /// Where it cannot be opened, its descriptor cannot be understood, or the mapping finds nothing in it.
    pub fn new(
        name: String,
        mut opener: Opener,
        mapping: Mapping,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, Error> {
        let refuse = |expected, found: String| Error::Descriptor { device: name.clone(), expected, found };
        let device = opener().map_err(|error| refuse("a device that can be opened", error.to_string()))?;
        let descriptor = device.descriptor().map_err(|error| refuse("a descriptor", error.to_string()))?;
        let layout = Layout::parse(&descriptor).map_err(|found| refuse("a report descriptor", found))?;
        let plan = mapping.plan(&layout);
        if plan.streams.is_empty() {
            return Err(refuse("something of the mapping", format!("nothing of '{}'", mapping.name)));
        }
        let mut streams = own_streams();
        streams.extend(plan.streams.iter().map(|resolved| resolved.stream.clone()));
        let open = |resolved: &Resolved| Open {
            resolved: resolved.clone(),
            values: [f64::NAN; MOST_VALUES],
            is_seen: None,
        };
        let least_latency = Span::from_secs_f64(mapping.least_latency_s).unwrap_or(Span::ZERO);
        let map = plan.time.as_ref().and_then(|(place, (nanos, ticks))| {
            let counter = Counter::new(u32::try_from(place.slot.bits).ok()?, *nanos, *ticks).ok()?;
            let most_drift_ppm = mapping.most_drift_ppm;
            Some(ClockMap::new(ClockKnobs { least_latency, most_drift_ppm, ..ClockKnobs::new(counter) }))
        });
        let now = clock.now();
        let mut source = Self {
            device: None,
            opener: Box::new(|| Err(std::io::ErrorKind::NotFound.into())),
            try_at: now,
            clock,
            mapping,
            streams,
            open: plan.streams.iter().map(open).collect(),
            numbered: layout.reports.iter().any(|report| report.id.is_some()),
            plan,
            map,
            report: ClockReport::default(),
            clock_watched: None,
            next_sequence: None,
            lost: 0,
            buffer: vec![0; MOST_REPORT].into_boxed_slice(),
        };
        let mut first = Some(device);
        source.opener = Box::new(move || match first.take() {
            Some(device) => Ok(device),
            None => opener(),
        });
        Ok(source)
    }

    /// How the device's clock stands to ours; `None` where it has none.
    pub fn clock_state(&self) -> Option<ClockState> {
        self.map.as_ref().map(ClockMap::state)
    }

    /// Reports that the sequence numbers say are missing.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Takes one report.
    fn take(&mut self, length: usize, arrived: Timestamp, sink: &mut dyn Sink) {
        let bytes = &self.buffer[..length.min(self.buffer.len())];
        let number = if self.numbered { bytes.first().copied() } else { None };
        let read = |place: &super::mapping::Place| {
            if place.report == number { place.slot.read(bytes) } else { None }
        };
        let raw = |place: &super::mapping::Place| {
            if place.report == number { place.slot.raw(bytes) } else { None }
        };
        let captured = match (&mut self.map, &self.plan.time) {
            (Some(map), Some((place, _))) => raw(place).map(|ticks| map.map(ticks, arrived)),
            _ => None,
        };
        let least = Span::from_secs_f64(-self.mapping.least_latency_s).unwrap_or(Span::ZERO);
        let captured = captured.unwrap_or_else(|| arrived.saturating_add(least));
        if let Some(place) = &self.plan.sequence
            && let Some(sequence) = raw(place)
        {
            let mask = u64::MAX >> (64 - place.slot.bits.clamp(1, 64));
            if let Some(next) = self.next_sequence {
                let gap = sequence.wrapping_sub(next) & mask;
                if gap >= MOST_GAP.min(mask / 2 + 1) {
                    tell(sink, arrived, Event::new("restarted", "sequence numbers begin anew"));
                } else if gap > 0 {
                    self.lost += gap;
                    let (before, after) = (next as f64, gap as f64);
                    let event = Event::new("gap", "sequence numbers are missing");
                    tell(sink, arrived, Event { before, after, ..event });
                }
            }
            self.next_sequence = Some(sequence.wrapping_add(1) & mask);
        }
        for (index, open) in self.open.iter_mut().enumerate() {
            let mut has_first = false;
            for (slot, place) in open.resolved.places.iter().enumerate() {
                if let Some(number) = read(place) {
                    has_first |= slot == 0;
                    open.values[slot] = place.value(number);
                }
            }
            let values = &open.values[..open.resolved.places.len()];
            // Of a reading in two reports, the first one gives it; the rest is as last seen.
            if !has_first || values.iter().any(|value| value.is_nan()) {
                continue;
            }
            let value = if open.resolved.gaze_point {
                let gaze = gaze(values);
                let is_seen = gaze.is_some();
                if open.is_seen.replace(is_seen).unwrap_or(true) != is_seen {
                    let event = if is_seen {
                        Event::new("found", "the eyes are seen")
                    } else {
                        Event::new("lost", "the eyes are not seen")
                    };
                    tell(sink, arrived, event);
                }
                Some(Reading::Gaze(gaze))
            } else {
                reading(open.resolved.stream.kind, values)
            };
            if let Some(value) = value {
                sink.take(
                    self.streams.len() - self.plan.streams.len() + index,
                    Sample { captured, arrived, value },
                );
            }
        }
        if let Some(map) = &self.map {
            let state = map.state();
            let (since, before) = *self.clock_watched.get_or_insert((arrived, state.jumps));
            if state.jumps > before + MOST_JUMPS {
                let text = "the device's times make no clock (another unit than its descriptor says?): those of arrival are taken";
                tell(sink, arrived, Event::new("clock_ignored", text));
                self.map = None;
                return;
            }
            if arrived.since(since).is_some_and(|passed| passed > CLOCK_WATCH) {
                self.clock_watched = Some((arrived, state.jumps));
            }
            self.report.say(state, arrived, sink);
        }
    }
}

/// A gaze out of the point that is looked at on a display and where the eyes are: x to the right, y down, z towards the user. From
/// between the eyes, or from the one that is seen: one at the display's corner is not. `None` where neither is.
fn gaze(values: &[f64]) -> Option<Gaze> {
    let &[x, y, lx, ly, lz, rx, ry, rz] = values else { return None };
    let (left, right) = (Vector3::new(lx, -ly, lz), Vector3::new(rx, -ry, rz));
    let origin = match (lz > 0.0, rz > 0.0) {
        (true, true) => (left + right) * 0.5,
        (true, false) => left,
        (false, true) => right,
        (false, false) => return None,
    };
    let direction = UnitVector3::try_new(Vector3::new(x, -y, 0.0) - origin, 1e-6)?;
    Some(Gaze { origin: Point3::from(origin), direction })
}

impl Source for HidSource {
    fn streams(&self) -> &[SourceStream] {
        &self.streams
    }

    fn losses(&self) -> Vec<(&'static str, u64)> {
        vec![("missing", self.lost)]
    }

    fn advance(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress {
        loop {
            let now = self.clock.now();
            let left = until.since(now).map_or(i64::MAX, Span::as_nanos);
            if left <= 0 {
                return Progress::Idle;
            }
            let Some(device) = &mut self.device else {
                if now < self.try_at {
                    self.clock.sleep_until(until.min(self.try_at));
                } else {
                    match (self.opener)() {
                        Ok(device) => {
                            self.device = Some(device);
                            self.next_sequence = None;
                            tell(sink, now, Event::new("connected", ""));
                            return Progress::Gave;
                        }
                        Err(_) => self.try_at = now.saturating_add(TRY_AGAIN),
                    }
                }
                continue;
            };
            // Rounded up: less than a millisecond would not wait at all.
            let longest = Duration::from_millis(left.unsigned_abs().div_ceil(1_000_000)).min(LONGEST_WAIT);
            match device.read(&mut self.buffer, longest) {
                Ok(0) => {}
                Ok(length) => {
                    let arrived = self.clock.now();
                    self.take(length, arrived, sink);
                    return Progress::Gave;
                }
                Err(error) => {
                    log::debug!("HID: {error}");
                    self.device = None;
                    self.try_at = now.saturating_add(TRY_AGAIN);
                    let event = Event::new("disconnected", "the device does not answer any more");
                    tell(sink, self.clock.now(), event);
                    return Progress::Gave;
                }
            }
        }
    }
}
