use nalgebra::{Matrix2, UnitQuaternion, Vector2};
use vergence_geom::Camera;

use crate::stereo::Stereo;
use crate::{Corner, Error, FastDetector, Flow, FlowKnobs, Gray, Pyramid};

/// The name of a point that is followed; never given twice by one tracker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TrackId(pub u64);

/// How [`Tracker`] finds and follows points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerKnobs {
    /// How patches are followed.
    pub flow: FlowKnobs,
    /// Side of the cells in which points are kept, pixels, 16 to 256. Default 50. Small: more points, more time, in proportion to
    /// the inverse square.
    pub cell_px: usize,
    /// Points in a cell, 1 to 16. Default 1.
    pub per_cell: usize,
    /// Threshold of FAST, grey levels, 3 to 100, for the first look into a cell. Default 20.
    pub threshold: u8,
    /// Threshold for the second look, where the first saw nothing: 3 to `threshold`. Default 7. Low: points in dim corners, and in
    /// noise.
    pub least_threshold: u8,
    /// A point followed back to the frame before must come to where it was, within this many pixels, 0.05 to 5. Default 0.5.
    pub back_px: f64,
    /// A match between cameras must be within this many pixels of its epipolar line, 0.1 to 10. Default 1.5.
    pub epipolar_px: f64,
    /// Correlation of a patch with what it is followed to, at least: −1 to 1. Default 0.7.
    pub least_likeness: f32,
    /// Nearest distance at which another camera is searched for a new point, metres, 0.02 to 10. Default 0.2.
    pub nearest_m: f64,
}

impl Default for TrackerKnobs {
    fn default() -> Self {
        Self {
            flow: FlowKnobs::default(),
            cell_px: 50,
            per_cell: 1,
            threshold: 20,
            least_threshold: 7,
            back_px: 0.5,
            epipolar_px: 1.5,
            least_likeness: 0.7,
            nearest_m: 0.2,
        }
    }
}

/// What is known of a frame before it is looked at.
#[derive(Clone, Copy, Debug)]
pub struct Prediction<'a> {
    /// Takes directions in the body's frame at the frame before to those at this one (the integrated gyroscope).
    pub now_from_before: UnitQuaternion<f64>,
    /// Where points are expected (track, camera, pixel), in order of track and camera; for those that are missing the rotation and
    /// the point's own motion are taken.
    pub pixels: &'a [(TrackId, usize, Vector2<f64>)],
}

impl Default for Prediction<'_> {
    fn default() -> Self {
        Self { now_from_before: UnitQuaternion::identity(), pixels: &[] }
    }
}

impl Prediction<'_> {
    fn of(&self, track: TrackId, camera: usize) -> Option<Vector2<f64>> {
        let place = self.pixels.binary_search_by(|(id, on, _)| (*id, *on).cmp(&(track, camera))).ok()?;
        Some(self.pixels[place].2)
    }
}

/// One point in one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Whose it is.
    pub track: TrackId,
    /// Where, pixels right and down of the centre of the upper left pixel.
    pub pixel: Vector2<f64>,
    /// In how many frames before this one it was seen by the first camera.
    pub age: u32,
}

/// How matches from the first camera to another went; the first sign of extrinsics that are wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StereoCount {
    /// Points that were looked for.
    pub tried: u32,
    /// Points whose patch was found, alike enough.
    pub alike: u32,
    /// Those of them near their epipolar line.
    pub matched: u32,
    /// Mean distance of the alike ones from their epipolar line, pixels; 0 where there is none.
    pub mean_off_px: f64,
}

/// What one set of pictures says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// For each camera its points, in order of track. A point that another camera sees is seen by the first one, too.
    pub cameras: Vec<Vec<Seen>>,
    /// For each camera how matching went; nothing for the first.
    pub stereo: Vec<StereoCount>,
    /// Points of the frame before.
    pub before: u32,
    /// Those of them that were found again.
    pub kept: u32,
}

/// Most cameras of a rig.
const CAMERAS: usize = 8;

#[derive(Clone, Debug)]
struct Track {
    id: TrackId,
    pixel: Vector2<f64>,
    /// What it moved last beyond what rotation explains.
    drift: Vector2<f64>,
    age: u32,
    others: [Option<Vector2<f64>>; CAMERAS - 1],
    /// Inverse distance along the ray, as last matched, 1/m.
    inverse_m: [Option<f64>; CAMERAS - 1],
}

/// Follows points through pictures of one or more cameras that see at the same instants.
///
/// Each frame: pyramids; every point of the first camera is followed from the frame before and back; what survives is matched into
/// the other cameras along its epipolar line; empty cells of a grid get a new point, the strongest corner there. Same pictures and
/// predictions, same bits. After the first frames nothing is allocated.
#[derive(Clone, Debug)]
pub struct Tracker {
    knobs: TrackerKnobs,
    rig: Vec<Camera>,
    flow: Flow,
    fast: FastDetector,
    stereo: Vec<Stereo>,
    before: Pyramid,
    now: Vec<Pyramid>,
    tracks: Vec<Track>,
    next: u64,
    started: bool,
    corners: Vec<Corner>,
    occupied: Vec<u16>,
    frame: Frame,
}

impl Tracker {
    /// A tracker of the cameras of `rig`; the first is the one whose points are followed.
    ///
    /// # Errors
    /// A knob outside of its range; no camera, or more than eight.
    pub fn new(rig: &[Camera], knobs: TrackerKnobs) -> Result<Self, Error> {
        let check = |sound: bool, name, expected, found: String| {
            if sound { Ok(()) } else { Err(Error::Knob { name, expected, found }) }
        };
        let k = &knobs;
        check((16..=256).contains(&k.cell_px), "cell_px", "16 to 256", k.cell_px.to_string())?;
        check((1..=16).contains(&k.per_cell), "per_cell", "1 to 16", k.per_cell.to_string())?;
        check((3..=100).contains(&k.threshold), "threshold", "3 to 100", k.threshold.to_string())?;
        let least = (3..=k.threshold).contains(&k.least_threshold);
        check(least, "least_threshold", "3 to threshold", k.least_threshold.to_string())?;
        check((0.05..=5.0).contains(&k.back_px), "back_px", "0.05 to 5", k.back_px.to_string())?;
        check((0.1..=10.0).contains(&k.epipolar_px), "epipolar_px", "0.1 to 10", k.epipolar_px.to_string())?;
        let likeness = (-1.0..=1.0).contains(&k.least_likeness);
        check(likeness, "least_likeness", "-1 to 1", k.least_likeness.to_string())?;
        check((0.02..=10.0).contains(&k.nearest_m), "nearest_m", "0.02 to 10", k.nearest_m.to_string())?;
        check((1..=CAMERAS).contains(&rig.len()), "cameras", "1 to 8", rig.len().to_string())?;
        let flow = Flow::new(knobs.flow)?;
        let pyramid = |camera: &Camera| {
            let [width, height] = camera.size_px.map(|side| side as usize);
            Pyramid::new(width, height, knobs.flow.levels)
        };
        let [width, height] = rig[0].size_px.map(|side| (side as usize).div_ceil(knobs.cell_px));
        Ok(Self {
            flow,
            fast: FastDetector::default(),
            stereo: rig[1..].iter().map(|there| Stereo::new(&rig[0], there)).collect(),
            before: pyramid(&rig[0]),
            now: rig.iter().map(pyramid).collect(),
            tracks: Vec::new(),
            next: 0,
            started: false,
            corners: Vec::new(),
            occupied: vec![0; width * height],
            frame: Frame {
                cameras: vec![Vec::new(); rig.len()],
                stereo: vec![StereoCount::default(); rig.len()],
                ..Frame::default()
            },
            rig: rig.to_vec(),
            knobs,
        })
    }

    /// The settings.
    pub fn knobs(&self) -> &TrackerKnobs {
        &self.knobs
    }

    /// Lets go of points that turned out to be wrong; their cells get new ones with the next frame. `tracks` are in order.
    pub fn forget(&mut self, tracks: &[TrackId]) {
        self.tracks.retain(|track| tracks.binary_search(&track.id).is_err());
    }

    /// Lets go of every point: the next frame is a first one.
    pub fn restart(&mut self) {
        self.tracks.clear();
        self.started = false;
    }

    /// The pyramids of the last frame, one for each camera.
    pub fn pyramids(&self) -> &[Pyramid] {
        &self.now
    }

    /// Looks at one picture for each camera, all of one instant.
    ///
    /// # Errors
    /// Pictures that are not those of the rig; nothing has changed then.
    pub fn track(&mut self, pictures: &[Gray], prediction: &Prediction) -> Result<&Frame, Error> {
        if pictures.len() != self.rig.len() {
            return Err(Error::Cameras { expected: self.rig.len(), found: pictures.len() });
        }
        for (camera, (picture, expected)) in pictures.iter().zip(&self.rig).enumerate() {
            let found = [picture.width(), picture.height()];
            if found != expected.size_px.map(|side| side as usize) {
                return Err(Error::Size { camera, expected: expected.size_px, found });
            }
        }
        std::mem::swap(&mut self.before, &mut self.now[0]);
        for (pyramid, picture) in self.now.iter_mut().zip(pictures) {
            pyramid.build(picture);
        }
        self.frame.before = self.tracks.len() as u32;
        if self.started {
            self.follow(prediction);
        }
        self.started = true;
        self.frame.kept = self.tracks.len() as u32;
        let old = self.tracks.len();
        self.replenish();
        self.frame.stereo.fill(StereoCount::default());
        for camera in 1..self.rig.len() {
            self.match_into(camera, old, prediction);
        }
        for (camera, list) in self.frame.cameras.iter_mut().enumerate() {
            list.clear();
            list.extend(self.tracks.iter().filter_map(|track| {
                let pixel = if camera == 0 { Some(track.pixel) } else { track.others[camera - 1] };
                pixel.map(|pixel| Seen { track: track.id, pixel, age: track.age })
            }));
        }
        Ok(&self.frame)
    }

    /// How far from the edge of the picture a point must stay.
    fn margin(&self) -> f64 {
        (self.knobs.flow.window_px / 2 + 1) as f64
    }

    fn inside(&self, pixel: &Vector2<f64>) -> bool {
        let (margin, [width, height]) = (self.margin(), self.rig[0].size_px.map(f64::from));
        pixel.x >= margin && pixel.y >= margin && pixel.x < width - margin && pixel.y < height - margin
    }

    fn follow(&mut self, prediction: &Prediction) {
        let camera = self.rig[0];
        let body_from_camera = camera.body_from_camera.rotation;
        let now_from_before = body_from_camera.inverse() * prediction.now_from_before * body_from_camera;
        let turned = |pixel: &Vector2<f64>| {
            let ray = camera.lens.unproject(pixel)?;
            camera.lens.project(&(now_from_before * ray.into_inner()))
        };
        let mut tracks = std::mem::take(&mut self.tracks);
        let coarsest = self.knobs.flow.levels - 1;
        tracks.retain_mut(|track| {
            let Some(by_rotation) = turned(&track.pixel) else { return false };
            let guess = prediction.of(track.id, 0).unwrap_or(by_rotation + track.drift);
            let warp = (|| {
                const STEP: f64 = 4.0;
                let right = turned(&(track.pixel + Vector2::new(STEP, 0.0)))? - by_rotation;
                let down = turned(&(track.pixel + Vector2::new(0.0, STEP)))? - by_rotation;
                Matrix2::from_columns(&[right / STEP, down / STEP]).try_inverse()
            })();
            let (before, now) = (&self.before, &self.now[0]);
            let Some(found) = self.flow.follow(before, now, &track.pixel, &guess, coarsest, warp.as_ref())
            else {
                return false;
            };
            if found.likeness < self.knobs.least_likeness || !self.inside(&found.pixel) {
                return false;
            }
            let back = warp.and_then(|warp| warp.try_inverse());
            let Some(again) =
                self.flow.follow(now, before, &found.pixel, &track.pixel, 1.min(coarsest), back.as_ref())
            else {
                return false;
            };
            if (again.pixel - track.pixel).norm() > self.knobs.back_px {
                return false;
            }
            track.drift = found.pixel - by_rotation;
            track.pixel = found.pixel;
            track.age += 1;
            true
        });
        self.tracks = tracks;
        self.thin_out();
    }

    fn cell(&self, pixel: &Vector2<f64>) -> usize {
        let [width, height] = self.rig[0].size_px.map(|side| (side as usize).div_ceil(self.knobs.cell_px));
        let column = (pixel.x as usize / self.knobs.cell_px).min(width - 1);
        let row = (pixel.y as usize / self.knobs.cell_px).min(height - 1);
        row * width + column
    }

    /// Of points that have run together only the oldest stays.
    fn thin_out(&mut self) {
        let near = self.knobs.cell_px as f64 / (2.0 * (self.knobs.per_cell as f64).sqrt()) * 0.3;
        let mut kept = 0;
        for k in 0..self.tracks.len() {
            let pixel = self.tracks[k].pixel;
            // Tracks are in order of age.
            if self.tracks[..kept].iter().all(|other| (other.pixel - pixel).norm_squared() > near * near) {
                self.tracks.swap(kept, k);
                kept += 1;
            }
        }
        self.tracks.truncate(kept);
    }

    /// Puts the strongest corners into cells that have too few points.
    fn replenish(&mut self) {
        const REACH: usize = 3;
        let cell_px = self.knobs.cell_px;
        let [width, height] = self.rig[0].size_px.map(|side| side as usize);
        self.occupied.fill(0);
        for k in 0..self.tracks.len() {
            let cell = self.cell(&self.tracks[k].pixel);
            self.occupied[cell] += 1;
        }
        let margin = self.margin() as usize;
        let columns = width.div_ceil(cell_px);
        let near = cell_px as f64 / (2.0 * (self.knobs.per_cell as f64).sqrt());
        for cell in 0..self.occupied.len() {
            let wanted = self.knobs.per_cell;
            let mut have = self.occupied[cell] as usize;
            if have >= wanted {
                continue;
            }
            let left = (cell % columns * cell_px).max(margin);
            let top = (cell / columns * cell_px).max(margin);
            let right = ((cell % columns + 1) * cell_px).min(width.saturating_sub(margin));
            let bottom = ((cell / columns + 1) * cell_px).min(height.saturating_sub(margin));
            if right <= left || bottom <= top {
                continue;
            }
            let picture = self.now[0].levels()[0].gray();
            let (x, y) = (left - REACH, top - REACH);
            let Some(part) = picture.part(x, y, right - left + 2 * REACH, bottom - top + 2 * REACH) else {
                continue;
            };
            for threshold in [self.knobs.threshold, self.knobs.least_threshold] {
                self.corners.clear();
                self.fast.detect(&part, threshold, &mut self.corners);
                // Strongest first; among equals the upper left.
                self.corners.sort_unstable_by_key(|corner| (255 - corner.score, corner.y, corner.x));
                for k in 0..self.corners.len() {
                    if have >= wanted {
                        break;
                    }
                    let corner = self.corners[k];
                    let pixel = Vector2::new(f64::from(corner.x) + x as f64, f64::from(corner.y) + y as f64);
                    let clear =
                        self.tracks.iter().all(|track| (track.pixel - pixel).norm_squared() > near * near);
                    if clear && self.rig[0].lens.unproject(&pixel).is_some() {
                        self.tracks.push(Track {
                            id: TrackId(self.next),
                            pixel,
                            drift: Vector2::zeros(),
                            age: 0,
                            others: [None; CAMERAS - 1],
                            inverse_m: [None; CAMERAS - 1],
                        });
                        self.next += 1;
                        have += 1;
                    }
                }
                if have >= wanted {
                    break;
                }
            }
        }
    }

    /// Finds the points of the first camera in another one; those from `old` on are new.
    fn match_into(&mut self, camera: usize, old: usize, prediction: &Prediction) {
        let stereo = &mut self.stereo[camera - 1];
        let (here, there) = (&self.now[0], &self.now[camera]);
        let count = &mut self.frame.stereo[camera];
        let size = self.rig[camera].size_px.map(f64::from);
        let margin = (self.knobs.flow.window_px / 2 + 1) as f64;
        let mut off_px = 0.0;
        for (k, track) in self.tracks.iter_mut().enumerate() {
            let known = track.inverse_m[camera - 1].take();
            track.others[camera - 1] = None;
            let Some(ray) = self.rig[0].lens.unproject(&track.pixel).map(|ray| ray.into_inner()) else {
                continue;
            };
            let expected = prediction
                .of(track.id, camera)
                .or_else(|| known.and_then(|inverse_m| stereo.at(&ray, inverse_m)));
            let (guess, coarsest) = match expected {
                Some(guess) => (guess, 1),
                // What was not found once is looked for again now and then only.
                None if k < old && track.age % 4 != 1 => continue,
                None => {
                    match stereo.search(&mut self.flow, here, there, &track.pixel, self.knobs.nearest_m) {
                        Some(guess) => (guess, 2),
                        None => continue,
                    }
                }
            };
            count.tried += 1;
            let Some(found) = stereo.follow(&mut self.flow, here, there, &track.pixel, &guess, coarsest)
            else {
                continue;
            };
            if found.likeness < self.knobs.least_likeness {
                continue;
            }
            let inside = found.pixel.x >= margin
                && found.pixel.y >= margin
                && found.pixel.x < size[0] - margin
                && found.pixel.y < size[1] - margin;
            if !inside {
                continue;
            }
            if expected.is_none() {
                let back = self.flow.follow(there, here, &found.pixel, &track.pixel, 1, None);
                if !back.is_some_and(|back| (back.pixel - track.pixel).norm() <= self.knobs.back_px) {
                    continue;
                }
            }
            count.alike += 1;
            off_px += found.off_px;
            if found.off_px <= self.knobs.epipolar_px {
                count.matched += 1;
                track.others[camera - 1] = Some(found.pixel);
                track.inverse_m[camera - 1] = Some(found.inverse_m);
            }
        }
        if count.alike > 0 {
            count.mean_off_px = off_px / f64::from(count.alike);
        }
    }
}
