//! The inertial unit in a gamepad as a source.

use std::sync::Arc;
use std::time::Duration;

use evdev::AbsoluteAxisCode;
use nalgebra::Vector3;
use vergence_sense::{Event, Imu, Progress, Reading, ReadingKind, Sample, Sink, Source, SourceStream};
use vergence_time::{Clock, ClockKnobs, ClockMap, Counter, Span, Timestamp};

use super::reading::{Connection, OpenNode, stamped};
use crate::connection::{CLOCK_RESIDUAL, ClockReport, own_streams, tell};
use crate::error::Error;
use crate::found::Found;

const SYN: u16 = 0;
const ABS: u16 = 3;
const MSC: u16 = 4;
const MSC_TIMESTAMP: u16 = 5;
/// In the unit of the axes' resolution.
const G_M_S2: f64 = 9.806_65;

/// The motion sensors of a gamepad as a source: angular velocity and acceleration in the pad's axes as its driver has them (of
/// PlayStation pads x to the right, y up, z towards the person), captured by the pad's own clock, which counts
/// microseconds, where it has one.
pub struct MotionSource {
    connection: Connection,
    node: Option<OpenNode>,
    clock: Arc<dyn Clock>,
    streams: Vec<SourceStream>,
    /// Acceleration, then angular velocity; only what changes comes.
    values: [i32; 6],
    /// What one is worth: m/s², rad/s.
    scales: [f64; 6],
    map: ClockMap,
    report: ClockReport,
    ticks: Option<u32>,
}

impl MotionSource {
    /// Opens the unit.
    ///
    /// # Errors
    /// Where it is gone, or may not be opened.
    pub fn open(device: &Found, clock: Arc<dyn Clock>) -> Result<Self, Error> {
        let (connection, _) =
            Connection::open(device, clock.now()).map_err(|error| Error::open(device, error))?;
        let mut streams = own_streams();
        streams.push(SourceStream::new("imu", ReadingKind::Imu));
        Ok(Self {
            connection,
            node: None,
            clock,
            streams,
            values: [0; 6],
            scales: [0.0; 6],
            map: ClockMap::new(ClockKnobs::new(Counter::MICROS_32)),
            report: ClockReport::default(),
            ticks: None,
        })
    }

    fn connect(&mut self, until: Timestamp, sink: &mut dyn Sink) -> bool {
        let Some((_, open)) = self.connection.again(until, &*self.clock) else { return false };
        let units = [G_M_S2, 1f64.to_radians()];
        for (AbsoluteAxisCode(axis), info) in open.device.get_absinfo().into_iter().flatten() {
            let axis = usize::from(axis);
            if axis < 6 {
                self.values[axis] = info.value();
                self.scales[axis] = units[axis / 3] / f64::from(info.resolution().max(1));
            }
        }
        self.node = Some(open);
        self.ticks = None;
        tell(sink, self.clock.now(), Event::new("connected", ""));
        true
    }

    fn say(&mut self, stamped: Timestamp, arrived: Timestamp, sink: &mut dyn Sink) {
        // The kernel's stamp is nearer to the wire than our reading of it.
        let captured = match self.ticks.take() {
            Some(ticks) => self.map.map(u64::from(ticks), stamped),
            None => stamped,
        };
        let three = |from: usize| {
            Vector3::from_fn(|row, _| f64::from(self.values[from + row]) * self.scales[from + row])
        };
        let value = Reading::Imu(Imu { gyr_rad_s: three(3), acc_m_s2: three(0), mag_ut: None });
        sink.take(CLOCK_RESIDUAL + 1, Sample { captured, arrived, value });
        self.report.say(self.map.state(), arrived, sink);
    }
}

impl Source for MotionSource {
    fn streams(&self) -> &[SourceStream] {
        &self.streams
    }

    fn advance(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress {
        loop {
            let left = until.since(self.clock.now()).map_or(i64::MAX, Span::as_nanos);
            if left <= 0 {
                return Progress::Idle;
            }
            let Some(mut node) = self.node.take() else {
                if self.connect(until, sink) {
                    return Progress::Gave;
                }
                continue;
            };
            let waited = node.wait(Duration::from_nanos(left.unsigned_abs()));
            let mut gave = false;
            let read = match waited {
                Ok(false) => Ok(()),
                Ok(true) => node.device.fetch_events().map(|events| {
                    let arrived = self.clock.now();
                    for event in events {
                        match (event.event_type().0, event.code()) {
                            (ABS, axis @ 0..6) => self.values[usize::from(axis)] = event.value(),
                            (MSC, MSC_TIMESTAMP) => self.ticks = Some(event.value().cast_unsigned()),
                            (SYN, 0) => {
                                let at = stamped(event.timestamp(), arrived);
                                self.say(at, arrived, sink);
                                gave = true;
                            }
                            _ => {}
                        }
                    }
                }),
                Err(error) => Err(error),
            };
            match read {
                Err(error) if error.kind() != std::io::ErrorKind::WouldBlock => {
                    log::debug!("motion: {error}");
                    drop(node);
                    let now = self.clock.now();
                    self.connection.lost(now);
                    tell(sink, now, Event::new("disconnected", "the pad does not answer any more"));
                    return Progress::Gave;
                }
                _ => self.node = Some(node),
            }
            if gave {
                return Progress::Gave;
            }
        }
    }
}
