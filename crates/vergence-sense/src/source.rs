//! Whatever yields samples, and whatever takes them.

use std::borrow::Cow;

use vergence_time::Timestamp;

use crate::{Axis, Button, Event, Gaze, Image, Imu, Pose, Sample, Scalar, Touch, Vector2};

/// Something that yields samples: a device, a simulated one, a data set, a replayed log. Nothing downstream can tell which.
///
/// The direction is one: a source is asked and gives to a sink; it knows neither who records nor who shows.
pub trait Source: Send {
    /// The streams that it yields; a sample names one by its place here. Grows at the end when a device is found to have
    /// more; never shrinks or changes otherwise.
    fn streams(&self) -> &[SourceStream];

    /// Gives to `sink`, in the order of arrival, what arrives before `until` (session time). A device waits for it, and
    /// returns when it has given something or `until` has come; what is computed or read from a file comes at once.
    /// The loss of a device is an event of one of its streams, and no error.
    fn advance(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress;

    /// What of all that the device sent is in no sample, for people: a word for each way, and how many so far.
    fn losses(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }
}

/// Something that takes samples: a recorder, a monitor, an estimator.
pub trait Sink {
    /// A stream is new at the end of the source's [`Source::streams`], after it was asked for the first time; said before its
    /// first sample. Who only counts need not know.
    fn appears(&mut self, place: usize, stream: &SourceStream) {
        let _ = (place, stream);
    }

    /// Takes a sample of the stream that stands at this place of the source's [`Source::streams`]. Must neither wait nor
    /// fail: who cannot keep up counts what it leaves out.
    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>);
}

/// How a source stands after it was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// It has given something; there may be more that arrived before `until`.
    Gave,
    /// There is nothing more that arrives before `until`.
    Idle,
    /// There will never be anything more.
    Ended,
}

/// What one stream of a source is.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceStream {
    /// Levels are separated by slashes, none in front: `gyro`, `stick/left`. Unique in its source.
    pub name: String,
    /// Of every sample.
    pub kind: ReadingKind,
    /// Of the values, where the kind does not say it (`bpm`); empty where it does.
    pub unit: Cow<'static, str>,
    /// Reference frame of coordinates; empty where there is none.
    pub frame: Cow<'static, str>,
    /// Samples per second, where it is declared.
    pub rate_hz: Option<f64>,
}

impl SourceStream {
    /// A stream without unit, frame and declared rate.
    pub fn new(name: impl Into<String>, kind: ReadingKind) -> Self {
        Self { name: name.into(), kind, unit: "".into(), frame: "".into(), rate_hz: None }
    }

    /// Values have this unit.
    #[must_use]
    pub fn unit(self, unit: impl Into<Cow<'static, str>>) -> Self {
        Self { unit: unit.into(), ..self }
    }

    /// Coordinates are in this frame.
    #[must_use]
    pub fn frame(self, frame: impl Into<Cow<'static, str>>) -> Self {
        Self { frame: frame.into(), ..self }
    }

    /// So many samples per second are declared.
    #[must_use]
    pub fn rate_hz(self, rate_hz: f64) -> Self {
        Self { rate_hz: Some(rate_hz), ..self }
    }
}

/// What a sample of a source can be.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "each is documented where it is defined")]
pub enum Reading<'a> {
    Button(Button),
    Axis(Axis),
    Vector2(Vector2),
    Touch(Touch),
    Scalar(Scalar),
    Imu(Imu),
    Pose(Pose),
    /// `None`: the eyes are not seen, as in a blink.
    Gaze(Option<Gaze>),
    Image(Image<'a>),
    Event(Event),
}

/// Which of the [`Reading`]s a stream carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[expect(missing_docs, reason = "as in `Reading`")]
pub enum ReadingKind {
    Button,
    Axis,
    Vector2,
    Touch,
    Scalar,
    Imu,
    Pose,
    Gaze,
    Image,
    Event,
}

impl ReadingKind {
    /// One word for people and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Button => "button",
            Self::Axis => "axis",
            Self::Vector2 => "vector2",
            Self::Touch => "touch",
            Self::Scalar => "scalar",
            Self::Imu => "imu",
            Self::Pose => "pose",
            Self::Gaze => "gaze",
            Self::Image => "image",
            Self::Event => "event",
        }
    }
}

impl Reading<'_> {
    /// Which one it is.
    pub const fn kind(&self) -> ReadingKind {
        match self {
            Self::Button(_) => ReadingKind::Button,
            Self::Axis(_) => ReadingKind::Axis,
            Self::Vector2(_) => ReadingKind::Vector2,
            Self::Touch(_) => ReadingKind::Touch,
            Self::Scalar(_) => ReadingKind::Scalar,
            Self::Imu(_) => ReadingKind::Imu,
            Self::Pose(_) => ReadingKind::Pose,
            Self::Gaze(_) => ReadingKind::Gaze,
            Self::Image(_) => ReadingKind::Image,
            Self::Event(_) => ReadingKind::Event,
        }
    }
}

/// Keeps everything; for tests and for small things. What is borrowed is copied.
impl Sink for Vec<(usize, Sample<Reading<'static>>)> {
    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        let value = match sample.value {
            Reading::Image(image) => Reading::Image(Image {
                encoding: image.encoding.into_owned().into(),
                data: image.data.into_owned().into(),
                ..image
            }),
            Reading::Button(v) => Reading::Button(v),
            Reading::Axis(v) => Reading::Axis(v),
            Reading::Vector2(v) => Reading::Vector2(v),
            Reading::Touch(v) => Reading::Touch(v),
            Reading::Scalar(v) => Reading::Scalar(v),
            Reading::Imu(v) => Reading::Imu(v),
            Reading::Pose(v) => Reading::Pose(v),
            Reading::Gaze(v) => Reading::Gaze(v),
            Reading::Event(v) => Reading::Event(v),
        };
        self.push((stream, Sample { captured: sample.captured, arrived: sample.arrived, value }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_borrowed_is_copied_and_everything_else_stays() {
        let pixels = vec![1, 2, 3];
        let image =
            Image { width: 3, height: 1, step: 3, encoding: "mono8".into(), data: pixels.as_slice().into() };
        let at = Timestamp::from_nanos(7);
        let mut kept = Vec::new();
        for value in [Reading::Image(image), Reading::Axis(Axis(Some(0.5))), Reading::Pose(Pose::LOST)] {
            Sink::take(&mut kept, 2, Sample { captured: at, arrived: at, value });
        }
        drop(pixels);
        let kinds: Vec<ReadingKind> = kept.iter().map(|(_, sample)| sample.value.kind()).collect();
        assert_eq!(kinds, [ReadingKind::Image, ReadingKind::Axis, ReadingKind::Pose]);
        assert!(matches!(&kept[0].1.value, Reading::Image(image) if *image.data == [1, 2, 3]));
    }
}
