//! A recording as a source of samples, like any device.

use vergence_sense::{Image, Imu, Progress, Reading, ReadingKind, Sample, Sink, Source, SourceStream};
use vergence_time::Timestamp;

use super::Dataset;
use crate::Error;

/// The rig of a recording as a source: `imu0` where there is an inertial unit, and `cam0`, `cam1`, … with grey pictures (`mono8`), in order of
/// time; at one instant the reading comes first. A sample arrives when it was captured.
#[derive(Debug)]
pub struct DatasetSource {
    dataset: Dataset,
    streams: Vec<SourceStream>,
    next_reading: usize,
    next_frame: usize,
    failure: Option<Error>,
}

impl DatasetSource {
    /// From the first sample on.
    pub fn new(dataset: Dataset) -> Self {
        let unit = dataset
            .inertial
            .iter()
            .map(|unit| SourceStream::new("imu0", ReadingKind::Imu).frame("imu0").rate_hz(unit.rate_hz));
        let camera = |n| SourceStream::new(format!("cam{n}"), ReadingKind::Image).frame(format!("cam{n}"));
        let streams = unit.chain((0..dataset.cameras.len()).map(camera)).collect();
        Self { dataset, streams, next_reading: 0, next_frame: 0, failure: None }
    }

    /// Why it ended early, once: a picture that cannot be decoded.
    pub fn failure(&mut self) -> Option<Error> {
        self.failure.take()
    }

    fn reading(&self) -> Option<(Timestamp, Imu)> {
        self.dataset.inertial.as_ref()?.samples.get(self.next_reading).copied()
    }

    fn frame(&mut self, at: Timestamp, sink: &mut dyn Sink) -> Result<(), Error> {
        let first = usize::from(self.dataset.inertial.is_some());
        let pictures = self.dataset.pictures(self.next_frame)?;
        self.next_frame += 1;
        for (camera, picture) in pictures.iter().enumerate() {
            let image = Image {
                width: picture.width as u32,
                height: picture.height as u32,
                step: picture.width as u32,
                encoding: "mono8".into(),
                data: picture.pixels.as_slice().into(),
            };
            sink.take(first + camera, Sample { captured: at, arrived: at, value: Reading::Image(image) });
        }
        Ok(())
    }
}

impl Source for DatasetSource {
    fn streams(&self) -> &[SourceStream] {
        &self.streams
    }

    fn advance(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress {
        let mut gave = false;
        loop {
            let frame = self.dataset.frames.get(self.next_frame).map(|frame| frame.at);
            let reading = self.reading();
            let is_reading = reading.is_some_and(|reading| frame.is_none_or(|frame| reading.0 <= frame));
            match (reading.filter(|_| is_reading), frame) {
                (Some((at, imu)), _) if at < until => {
                    self.next_reading += 1;
                    sink.take(0, Sample { captured: at, arrived: at, value: Reading::Imu(imu) });
                }
                (None, Some(at)) if at < until => {
                    if let Err(error) = self.frame(at, sink) {
                        self.failure = Some(error);
                        self.next_frame = self.dataset.frames.len();
                        self.next_reading = usize::MAX;
                    }
                }
                (None, None) if gave => return Progress::Gave,
                (None, None) => return Progress::Ended,
                _ if gave => return Progress::Gave,
                _ => return Progress::Idle,
            }
            gave = true;
        }
    }
}
