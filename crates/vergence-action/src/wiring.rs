//! What a device says, as inputs of a mapper.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_sense::{Gaze, Pose, Sample, SourceStream, TouchPhase, Tracking};
use vergence_time::Timestamp;

use crate::mapper::{InputId, Mapper, Reading};

/// Which part of a stream an input is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    /// All of it.
    Whole,
    /// Of a wheel, the lines away from the user.
    Y,
    /// What is counted from one moment to the next: nothing where nothing more is said.
    Counts,
    /// Of a touch: where, and whether.
    Position,
    Contact,
    /// A button as one way of a cross: left, right, up, down.
    Way(usize),
}

#[derive(Clone, Debug)]
struct Wire {
    name: String,
    part: Part,
    input: Option<InputId>,
}

/// The streams of one device, wired to the inputs that bindings watch:
///
/// | adapter | its streams are called |
/// |---|---|
/// | `gamepad` | `pad.south`, `pad.left_stick`, …: of any pad; `pad.dpad` is made of its four ways |
/// | `desktop` | `key.a`, `mouse.left`, `mouse.move` and `mouse.wheel` (per frame), `mouse.position` (pixels), `touch.down`, `touch.position` |
/// | `gaze`, and any stream `gaze` | `gaze`: from between the eyes, −z along the line of sight |
/// | any | `device.NAME.STREAM`, with NAME as the device's streams are called in a recording, and `.` for `/` |
///
/// Of two devices with one input, the last word counts.
#[derive(Clone, Debug)]
pub struct Wiring {
    adapter: String,
    device: String,
    streams: Vec<Vec<Wire>>,
    /// Left, right, up, down.
    ways: [bool; 4],
    /// What was counted since the last frame; `None` where nothing was since the one before.
    counts: Vec<(InputId, Option<[f64; 2]>)>,
}

/// Lower case words with points between them, as bindings name inputs.
fn words(text: &str) -> String {
    let letter = |c: char| match c.to_ascii_lowercase() {
        c @ ('a'..='z' | '0'..='9') => c,
        '/' | '.' => '.',
        _ => '_',
    };
    text.trim_matches('/').chars().map(letter).collect()
}

const WAYS: [&str; 4] = ["pad.dpad.left", "pad.dpad.right", "pad.dpad.up", "pad.dpad.down"];

/// What a stream is called in bindings.
fn wires(adapter: &str, device: &str, stream: &str) -> Vec<Wire> {
    let stream = words(stream);
    let mut all = Vec::new();
    let mut add = |name: String, part| all.push(Wire { name, part, input: None });
    match (adapter, &stream[..]) {
        ("gamepad", _) => {
            let name = format!("pad.{stream}");
            if let Some(way) = WAYS.iter().position(|own| *own == name) {
                add("pad.dpad".to_owned(), Part::Way(way));
            }
            add(name, Part::Whole);
        }
        ("desktop", "mouse.wheel") => add("mouse.wheel".to_owned(), Part::Y),
        ("desktop", "mouse.move") => add("mouse.move".to_owned(), Part::Counts),
        ("desktop", "pointer") => add("mouse.position".to_owned(), Part::Position),
        ("desktop", "touch") => {
            add("touch.position".to_owned(), Part::Position);
            add("touch.down".to_owned(), Part::Contact);
        }
        ("desktop", _) => add(stream.clone(), Part::Whole),
        (_, "gaze") => add("gaze".to_owned(), Part::Whole),
        _ => {}
    }
    add(format!("device.{}.{stream}", words(device)), Part::Whole);
    all
}

impl Wiring {
    /// The streams of a device; `adapter` and `device` as a list of devices and a recording call them.
    pub fn new(adapter: &str, device: &str, streams: &[SourceStream]) -> Self {
        let mut wiring = Self {
            adapter: adapter.to_owned(),
            device: device.to_owned(),
            streams: Vec::new(),
            ways: [false; 4],
            counts: Vec::new(),
        };
        streams.iter().enumerate().for_each(|(place, stream)| wiring.add(place, stream));
        wiring
    }

    fn add(&mut self, place: usize, stream: &SourceStream) {
        self.streams.resize(self.streams.len().max(place + 1), Vec::new());
        self.streams[place] = wires(&self.adapter, &self.device, &stream.name);
    }

    /// Takes a stream that appears while the device is read.
    pub fn appears(&mut self, place: usize, stream: &SourceStream, mapper: &Mapper) {
        self.add(place, stream);
        for wire in &mut self.streams[place] {
            wire.input = mapper.input(&wire.name);
        }
    }

    /// Finds the inputs that the mapper's bindings watch: before the first sample, and after each [`Mapper::replace`].
    pub fn connect(&mut self, mapper: &Mapper) {
        self.counts.clear();
        for wire in self.streams.iter_mut().flatten() {
            wire.input = mapper.input(&wire.name);
        }
    }

    /// The names of its inputs, whether they are watched or not.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.streams.iter().flatten().map(|wire| &wire.name[..])
    }

    /// Feeds what a stream says, at the time of its arrival.
    pub fn take(&mut self, stream: usize, sample: &Sample<vergence_sense::Reading<'_>>, mapper: &mut Mapper) {
        use vergence_sense::Reading as Said;
        let at = sample.arrived;
        if let Said::Event(event) = &sample.value {
            if event.name == "disconnected" {
                self.lose(at, mapper);
            }
            return;
        }
        for place in 0..self.streams.get(stream).map_or(0, Vec::len) {
            let Wire { part, input: Some(input), .. } = self.streams[stream][place] else { continue };
            let reading = match (&sample.value, part) {
                (Said::Button(button), Part::Way(way)) => {
                    self.ways[way] = button.0.unwrap_or(false);
                    let [left, right, up, down] = self.ways.map(|is_down| f64::from(u8::from(is_down)));
                    Reading::Vector([right - left, up - down])
                }
                (Said::Button(button), _) => button.0.map_or(Reading::Gone, Reading::Button),
                (Said::Axis(axis), _) => axis.0.map_or(Reading::Gone, |x| Reading::Axis(f64::from(x))),
                (Said::Vector2(vector), Part::Counts | Part::Y) => {
                    let counted = vector.0.unwrap_or_default().map(f64::from);
                    self.count(at, input, counted, part, mapper);
                    continue;
                }
                (Said::Vector2(vector), _) => {
                    vector.0.map_or(Reading::Gone, |v| Reading::Vector(v.map(f64::from)))
                }
                (Said::Touch(touch), Part::Contact) => {
                    Reading::Button(matches!(touch.phase, TouchPhase::Begins | TouchPhase::Moves))
                }
                (Said::Touch(touch), _) if touch.phase == TouchPhase::Cancelled => Reading::Gone,
                (Said::Touch(touch), _) => Reading::Vector(touch.position),
                (Said::Scalar(scalar), _) => Reading::Axis(scalar.0),
                (Said::Pose(pose), _) => Reading::Pose(*pose),
                (Said::Gaze(gaze), _) => {
                    gaze.as_ref().map_or(Reading::Gone, |gaze| Reading::Pose(line_of_sight(gaze)))
                }
                (Said::Imu(_) | Said::Image(_) | Said::Event(_), _) => continue,
            };
            mapper.feed(at, input, reading);
        }
    }

    /// Adds up what is counted within a frame.
    fn count(&mut self, at: Timestamp, input: InputId, counted: [f64; 2], part: Part, mapper: &mut Mapper) {
        let place = self.counts.iter().position(|(own, _)| *own == input).unwrap_or_else(|| {
            self.counts.push((input, None));
            self.counts.len() - 1
        });
        let before = self.counts[place].1.unwrap_or_default();
        let sum = [before[0] + counted[0], before[1] + counted[1]];
        self.counts[place].1 = Some(sum);
        mapper.feed(at, input, if part == Part::Y { Reading::Axis(sum[1]) } else { Reading::Vector(sum) });
    }

    /// Once a frame, before [`Mapper::advance`] and before what the frame's samples say: what was counted in the frame before is no more.
    pub fn begin_frame(&mut self, at: Timestamp, mapper: &mut Mapper) {
        for (input, sum) in &mut self.counts {
            if sum.take().is_some() {
                mapper.feed(at, *input, Reading::Gone);
            }
        }
    }

    /// The device is gone: its inputs are at rest.
    fn lose(&mut self, at: Timestamp, mapper: &mut Mapper) {
        self.ways = [false; 4];
        for input in self.streams.iter().flatten().filter_map(|wire| wire.input) {
            mapper.feed(at, input, Reading::Gone);
        }
    }
}

/// Where somebody looks, as a pose: its −z points along the line of sight.
fn line_of_sight(gaze: &Gaze) -> Pose {
    let ahead = -Vector3::z();
    // Straight behind, any half turn about an upright axis will do.
    let turn = UnitQuaternion::rotation_between(&ahead, &gaze.direction)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI));
    let q = turn.coords;
    Pose::from_parts(gaze.origin.into(), Tracking::Measured, [q.x, q.y, q.z, q.w], Tracking::Measured)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::Unit;
    use vergence_sense::{Axis, Button, Event, Reading as Said, ReadingKind, Scalar, Touch, Vector2};

    use super::*;
    use crate::{Bindings, Value};

    fn at(ms: i64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    fn said(ms: i64, value: Said<'static>) -> Sample<Said<'static>> {
        Sample { captured: at(ms), arrived: at(ms), value }
    }

    fn mapper(actions: &[(&str, &str, &str)]) -> Mapper {
        let text: String = actions
            .iter()
            .map(|(name, kind, input)| {
                format!("[actions.{name}]\nkind = \"{kind}\"\nbind = [{{ input = \"{input}\" }}]\n")
            })
            .collect();
        Mapper::new(&Bindings::parse(Path::new("b.toml"), &text).unwrap()).unwrap()
    }

    fn wired(adapter: &str, streams: &[(&str, ReadingKind)], mapper: &Mapper) -> Wiring {
        let streams: Vec<_> = streams.iter().map(|(name, kind)| SourceStream::new(*name, *kind)).collect();
        let mut wiring = Wiring::new(adapter, "My-Device 2", &streams);
        wiring.connect(mapper);
        wiring
    }

    fn value<'a>(mapper: &'a Mapper, action: &str) -> &'a Value {
        mapper.value(mapper.action(action).unwrap()).unwrap()
    }

    #[test]
    fn a_pads_cross_is_a_direction_too_and_what_is_gone_rests() {
        let mut mapper = mapper(&[
            ("move", "locator", "pad.dpad"),
            ("jump", "button", "pad.south"),
            ("own", "button", "device.my_device_2.south"),
            ("pull", "valuator", "pad.left_trigger"),
        ]);
        let streams = [
            ("events", ReadingKind::Event),
            ("dpad/left", ReadingKind::Button),
            ("dpad/up", ReadingKind::Button),
            ("south", ReadingKind::Button),
            ("left_trigger", ReadingKind::Axis),
        ];
        let mut pad = wired("gamepad", &streams, &mapper);
        for stream in 1..4 {
            pad.take(stream, &said(10, Said::Button(Button(Some(true)))), &mut mapper);
        }
        pad.take(4, &said(10, Said::Axis(Axis(Some(0.5)))), &mut mapper);
        assert_eq!(value(&mapper, "move"), &Value::Locator([-1.0, 1.0]));
        assert_eq!([value(&mapper, "jump"), value(&mapper, "own")], [&Value::Button(true); 2]);
        assert_eq!(value(&mapper, "pull"), &Value::Valuator(0.5));
        pad.take(1, &said(20, Said::Button(Button(None))), &mut mapper);
        assert_eq!(value(&mapper, "move"), &Value::Locator([0.0, 1.0]));
        pad.take(0, &said(30, Said::Event(Event::new("disconnected", ""))), &mut mapper);
        assert_eq!(value(&mapper, "move"), &Value::Locator([0.0, 0.0]));
        assert_eq!([value(&mapper, "jump"), value(&mapper, "own")], [&Value::Button(false); 2]);
        assert_eq!(value(&mapper, "pull"), &Value::Valuator(0.0));
    }

    #[test]
    fn what_a_mouse_counts_holds_for_a_frame() {
        let mut mapper = mapper(&[
            ("turn", "locator", "mouse.move"),
            ("zoom", "valuator", "mouse.wheel"),
            ("point", "locator", "mouse.position"),
            ("tap", "button", "touch.down"),
        ]);
        let streams = [
            ("mouse/move", ReadingKind::Vector2),
            ("mouse/wheel", ReadingKind::Vector2),
            ("pointer", ReadingKind::Touch),
            ("touch", ReadingKind::Touch),
        ];
        let mut desktop = wired("desktop", &streams, &mapper);
        let counts = |x, y| Said::Vector2(Vector2(Some([x, y])));
        desktop.begin_frame(at(0), &mut mapper);
        desktop.take(0, &said(1, counts(2.0, 1.0)), &mut mapper);
        desktop.take(0, &said(2, counts(3.0, -1.0)), &mut mapper);
        desktop.take(1, &said(2, counts(0.0, 1.0)), &mut mapper);
        assert_eq!(value(&mapper, "turn"), &Value::Locator([5.0, 0.0]));
        assert_eq!(value(&mapper, "zoom"), &Value::Valuator(1.0));
        desktop.begin_frame(at(10), &mut mapper);
        assert_eq!(value(&mapper, "turn"), &Value::Locator([0.0, 0.0]));
        assert_eq!(value(&mapper, "zoom"), &Value::Valuator(0.0));
        let touch = |phase| Said::Touch(Touch { contact: 0, position: [7.0, 8.0], phase });
        desktop.take(2, &said(11, touch(TouchPhase::Hovers)), &mut mapper);
        desktop.take(3, &said(11, touch(TouchPhase::Begins)), &mut mapper);
        assert_eq!(value(&mapper, "point"), &Value::Locator([7.0, 8.0]));
        assert_eq!(value(&mapper, "tap"), &Value::Button(true));
        desktop.take(3, &said(12, touch(TouchPhase::Ends)), &mut mapper);
        assert_eq!(value(&mapper, "tap"), &Value::Button(false));
    }

    #[test]
    fn gaze_and_a_devices_own_streams_are_inputs() {
        let mut mapper =
            mapper(&[("aim", "pose", "gaze"), ("pulse", "valuator", "device.my_device_2.heart.bpm")]);
        let streams = [("gaze", ReadingKind::Gaze)];
        let mut device = wired("serial", &streams, &mapper);
        device.appears(1, &SourceStream::new("heart/bpm", ReadingKind::Scalar), &mapper);
        let direction = Unit::new_normalize(Vector3::new(1.0, 0.0, -1.0));
        let gaze = Gaze { origin: nalgebra::Point3::new(0.0, 1.6, 0.0), direction };
        device.take(0, &said(1, Said::Gaze(Some(gaze))), &mut mapper);
        device.take(1, &said(1, Said::Scalar(Scalar(72.0))), &mut mapper);
        let Value::Pose(pose) = value(&mapper, "aim") else { panic!("a pose") };
        let rigid = pose.reference_from_device().unwrap();
        assert!((rigid.rotation * -Vector3::z() - direction.into_inner()).norm() < 1e-12);
        assert_eq!(rigid.translation.vector.y, 1.6);
        assert_eq!(value(&mapper, "pulse"), &Value::Valuator(72.0));
    }
}
