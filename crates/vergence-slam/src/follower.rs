//! A rig that is followed as its samples come: a live one, a replayed one and a recorded one give the same poses.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use vergence_geom::Camera;
use vergence_sense::{Imu, Reading, ReadingKind, Sample, Sink, SourceStream};
use vergence_time::{Span, Timestamp};
use vergence_vision::{Gray, TrackerKnobs};

use crate::dataset::{Depth, Opening, Picture, Rig};
use crate::playback::Mode;
use crate::{Error, Estimate, Params, Tracking};

/// Pictures are made smaller by at most this.
pub const MOST_REDUCED: usize = 8;
/// Frames that wait for a picture or a reading; what waits longer is done without it.
const MOST_WAITING: usize = 16;
/// Readings that wait for a frame: ten seconds at 1 kHz.
const MOST_READINGS: usize = 10_000;

/// The mean of each square of `by` pixels; what is left over at the right and below is cut off.
fn reduce(picture: &Picture, by: usize, into: &mut Picture) {
    (into.width, into.height) = (picture.width / by, picture.height / by);
    into.pixels.clear();
    let area = (by * by) as u32;
    for row in 0..into.height {
        let rows = &picture.pixels[row * by * picture.width..(row + 1) * by * picture.width];
        into.pixels.extend((0..into.width).map(|column| {
            let square = rows.chunks_exact(picture.width).map(|line| &line[column * by..(column + 1) * by]);
            let sum: u32 = square.flatten().map(|pixel| u32::from(*pixel)).sum();
            ((sum + area / 2) / area) as u8
        }));
    }
}

/// Pictures of one instant.
#[derive(Debug)]
struct Waiting {
    at: Timestamp,
    pictures: Vec<Option<Picture>>,
}

impl Waiting {
    fn is_whole(&self) -> bool {
        self.pictures.iter().all(Option::is_some)
    }
}

/// Follows a rig. Readings and pictures may come in any order that each of their streams keeps to: a frame is followed once all its
/// cameras' pictures are there and the first reading at or after its time is.
#[derive(Debug)]
pub struct Follower {
    name: PathBuf,
    mode: Mode,
    tracking: Tracking,
    reduce: usize,
    reduced: Vec<Picture>,
    cameras: usize,
    readings: VecDeque<(Timestamp, Imu)>,
    waiting: VecDeque<Waiting>,
    /// The last frame that was followed, and the last reading that was given to it.
    done: Option<Timestamp>,
    given: Option<Timestamp>,
    ended: bool,
    incomplete: u64,
    pair_within: Span,
}

impl Follower {
    /// For the sensors of `rig` that `mode` names. The unit's noise is the rig's own; everything else is `params`. Pictures are made smaller
    /// first, by a whole number of 1 to [`MOST_REDUCED`] along each side; knobs in pixels are in those of the smaller pictures. Errors begin
    /// with `name`.
    ///
    /// # Errors
    /// A mode that needs what the rig does not have; a knob outside of its range.
    pub fn new(
        name: &Path,
        rig: &Rig,
        mode: Mode,
        knobs: TrackerKnobs,
        params: Params,
        reduce: usize,
    ) -> Result<Self, Error> {
        let most = if mode == Mode::Rgbd { 1 } else { MOST_REDUCED };
        if !(1..=most).contains(&reduce) {
            let expected = if most == 1 { "1 with depth" } else { "1 to 8" };
            return Err(Error::Knob { name: "reduce", expected, found: reduce as f64 });
        }
        let lacks = |expected: &str, found: &str| Err(Error::file(name, expected, found));
        if mode.inertial() && rig.inertial.is_none() {
            return lacks("an inertial unit, for an inertial mode", "none");
        }
        if mode.stereo() && rig.cameras.len() < 2 {
            return lacks("two cameras, for a stereo mode", "one");
        }
        let cameras: &[Camera] = if mode.stereo() { &rig.cameras } else { &rig.cameras[..1] };
        let smaller = |camera: &Camera| {
            let lens = camera.lens.scaled(1.0 / reduce as f64);
            let lens = lens.map_err(|source| Error::Lens { path: name.to_owned(), source })?;
            Ok(Camera { lens, size_px: camera.size_px.map(|side| side / reduce as u32), ..*camera })
        };
        let cameras: Vec<Camera> = cameras.iter().map(smaller).collect::<Result<_, Error>>()?;
        let params = Params { inertial: rig.inertial.map(|i| i.0).filter(|_| mode.inertial()), ..params };
        Ok(Self {
            name: name.to_owned(),
            mode,
            tracking: Tracking::new(&cameras, knobs, params)?,
            reduce,
            reduced: vec![Picture::default(); if reduce > 1 { cameras.len() } else { 0 }],
            cameras: cameras.len(),
            readings: VecDeque::new(),
            waiting: VecDeque::new(),
            done: None,
            given: None,
            ended: false,
            incomplete: 0,
            pair_within: Opening::default().pair_within,
        })
    }

    /// With pictures of one instant that may be farther apart than a millisecond: [`Opening::pair_within`].
    #[must_use]
    pub fn pairing_within(mut self, span: Span) -> Self {
        self.pair_within = span;
        self
    }

    /// The tracker and the estimator.
    pub fn tracking(&self) -> &Tracking {
        &self.tracking
    }

    /// Frames that were left out since a camera's picture was missing.
    pub fn incomplete(&self) -> u64 {
        self.incomplete
    }

    /// One reading of the inertial unit, in its own frame.
    pub fn imu(&mut self, at: Timestamp, imu: &Imu) {
        if !self.mode.inertial() {
            return;
        }
        // Who sees nothing for so long is blind: the oldest are not needed to go on.
        if self.readings.len() >= MOST_READINGS {
            self.readings.pop_front();
        }
        self.readings.push_back((at, *imu));
    }

    /// One picture of a camera; pictures of one instant (within a millisecond, or [`Self::pairing_within`]) make a frame. Those of cameras that take no part, and those that are not later than
    /// what was followed, are left out.
    pub fn picture(&mut self, camera: usize, at: Timestamp, picture: Picture) {
        if camera >= self.cameras || self.done.is_some_and(|done| at <= done) {
            return;
        }
        let within = self.pair_within.as_nanos().unsigned_abs();
        let together = |frame: &Waiting| frame.at.as_nanos().abs_diff(at.as_nanos()) <= within;
        let place =
            match self.waiting.iter().position(|frame| together(frame) && frame.pictures[camera].is_none()) {
                Some(place) => place,
                None => {
                    let place = self.waiting.partition_point(|frame| frame.at < at);
                    self.waiting.insert(place, Waiting { at, pictures: vec![None; self.cameras] });
                    place
                }
            };
        let frame = &mut self.waiting[place];
        frame.pictures[camera] = Some(picture);
        // A frame has its first camera's time.
        if camera == 0 {
            frame.at = at;
        }
    }

    /// Nothing more comes: what waits for readings waits no longer.
    pub fn end(&mut self) {
        self.ended = true;
    }

    /// Follows the next frame that is ready; `None` where there is none.
    ///
    /// # Errors
    /// Pictures that are not those of the rig; cameras that sit otherwise than the calibration says.
    pub fn follow(&mut self) -> Result<Option<Estimate>, Error> {
        // A frame that lacks a picture when a later one is whole will not get it.
        let Some(whole) = self.waiting.iter().position(Waiting::is_whole) else {
            while self.waiting.len() > MOST_WAITING || (self.ended && !self.waiting.is_empty()) {
                self.waiting.pop_front();
                self.incomplete += 1;
            }
            return Ok(None);
        };
        let at = self.waiting[whole].at;
        let read = self.readings.back().map(|last| last.0).max(self.given).is_some_and(|last| last >= at);
        if self.mode.inertial() && !read && !self.ended && self.waiting.len() <= MOST_WAITING {
            return Ok(None);
        }
        self.incomplete += self.waiting.drain(..whole).count() as u64;
        let Some(frame) = self.waiting.pop_front() else { return Ok(None) };
        while !self.has_read(at) {
            let Some((time, imu)) = self.readings.pop_front() else { break };
            self.reading(time, &imu);
        }
        let pictures: Vec<Picture> = frame.pictures.into_iter().flatten().collect();
        self.frame(at, &pictures, None).map(Some)
    }

    /// Follows a frame of which everything is there, readings included.
    pub(crate) fn frame(
        &mut self,
        at: Timestamp,
        pictures: &[Picture],
        depth: Option<&Depth>,
    ) -> Result<Estimate, Error> {
        self.done = Some(at);
        for (picture, into) in pictures.iter().zip(&mut self.reduced) {
            reduce(picture, self.reduce, into);
        }
        let pictures = if self.reduce > 1 { &self.reduced } else { pictures };
        let grays: Result<Vec<Gray>, _> =
            pictures.iter().map(|p| Gray::new(p.width, p.height, p.width, &p.pixels)).collect();
        let estimate = self.tracking.frame(at, &grays?, depth)?;
        match self.tracking.misfit() {
            None => Ok(estimate),
            Some(misfit) => Err(Error::Mounting { name: self.name.clone(), misfit }),
        }
    }

    /// Gives a reading to the estimator at once.
    pub(crate) fn reading(&mut self, at: Timestamp, imu: &Imu) {
        self.tracking.imu(at, imu);
        self.given = Some(at);
    }

    /// The first reading at or past a frame closes its last span: whether it was given.
    pub(crate) fn has_read(&self, at: Timestamp) -> bool {
        self.given.is_some_and(|last| last >= at)
    }
}

/// What a stream is to a rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Unit,
    Camera(usize),
    Other,
}

impl Role {
    /// By the last part of its name: `imu0`; `cam0`, `cam1`, ….
    fn of(stream: &SourceStream) -> Self {
        let name = stream.name.rsplit('/').next().unwrap_or_default();
        let camera = name.strip_prefix("cam").and_then(|number| number.parse().ok());
        match (stream.kind, camera) {
            (ReadingKind::Imu, _) if name == "imu0" => Self::Unit,
            (ReadingKind::Image, Some(camera)) => Self::Camera(camera),
            _ => Self::Other,
        }
    }
}

type Ready<'a> = Box<dyn FnMut(&mut Follower) -> Result<bool, Error> + 'a>;

/// Feeds a [`Follower`] from a source whose streams are called `imu0`, `cam0`, `cam1`, … (whatever stands before the last slash).
pub struct Feed<'a> {
    follower: Follower,
    roles: Vec<Role>,
    /// Follows the frames that are ready; called after each picture and reading. Says whether more is wanted.
    ready: Ready<'a>,
    enough: bool,
    failure: Option<Error>,
}

impl<'a> Feed<'a> {
    /// For a source with these streams; `ready` is called after each sample, until it wants no more.
    pub fn new(
        follower: Follower,
        streams: &[SourceStream],
        ready: impl FnMut(&mut Follower) -> Result<bool, Error> + 'a,
    ) -> Self {
        Self {
            follower,
            roles: streams.iter().map(Role::of).collect(),
            ready: Box::new(ready),
            enough: false,
            failure: None,
        }
    }

    /// Whether nothing more is taken: something went wrong, or no more is wanted.
    pub fn is_over(&self) -> bool {
        self.enough || self.failure.is_some()
    }

    /// Nothing more comes: follows what still waits.
    ///
    /// # Errors
    /// The first thing that went wrong.
    pub fn finish(mut self) -> Result<Follower, Error> {
        if let Some(failure) = self.failure {
            return Err(failure);
        }
        self.follower.end();
        if !self.enough {
            (self.ready)(&mut self.follower)?;
        }
        Ok(self.follower)
    }

    fn sample(&mut self, role: Role, sample: Sample<Reading<'_>>) -> Result<(), Error> {
        match (role, sample.value) {
            (Role::Unit, Reading::Imu(imu)) => self.follower.imu(sample.captured, &imu),
            (Role::Camera(camera), Reading::Image(image)) if camera < self.follower.cameras => {
                let name =
                    self.follower.name.join(format!("cam{camera} at {} ns", sample.captured.as_nanos()));
                self.follower.picture(camera, sample.captured, Picture::of(&image, &name)?);
            }
            _ => return Ok(()),
        }
        self.enough = !(self.ready)(&mut self.follower)?;
        Ok(())
    }
}

impl Sink for Feed<'_> {
    fn appears(&mut self, place: usize, stream: &SourceStream) {
        if self.roles.len() <= place {
            self.roles.resize(place + 1, Role::Other);
        }
        self.roles[place] = Role::of(stream);
    }

    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        let role = self.roles.get(stream).copied().unwrap_or(Role::Other);
        if !self.is_over() && role != Role::Other {
            self.failure = self.sample(role, sample).err();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reduced_pictures_are_means() {
        let picture = Picture { width: 5, height: 4, pixels: (0..20).collect() };
        let mut small = Picture::default();
        reduce(&picture, 2, &mut small);
        assert_eq!(small, Picture { width: 2, height: 2, pixels: vec![3, 5, 13, 15] });
        reduce(&picture, 1, &mut small);
        assert_eq!(small, picture);
    }

    #[test]
    fn streams_are_known_by_the_last_part_of_their_names() {
        let role = |name: &str, kind| Role::of(&SourceStream::new(name, kind));
        assert_eq!(role("rig/cam1", ReadingKind::Image), Role::Camera(1));
        assert_eq!(role("imu0", ReadingKind::Imu), Role::Unit);
        assert_eq!(role("imu0", ReadingKind::Scalar), Role::Other);
        assert_eq!(role("camera", ReadingKind::Image), Role::Other);
    }
}
