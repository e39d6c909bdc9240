use nalgebra::{Matrix2, UnitQuaternion, Vector2};
use vergence_geom::Camera;

use crate::anchor::Anchor;
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
    /// A patch must say where it is: standard deviation of its place for noise of one grey level, along its weaker direction, at most
    /// this many pixels, 0.005 to 1. Default 0.1. Large: points that slide along edges.
    pub spread_px: f64,
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
            spread_px: 0.1,
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

/// Farthest that the anchor may be from where the patch of the frame before leads, pixels.
const ANCHOR_PX: f64 = 3.0;
/// Smallest area of a patch beside that of its anchor; the inverse is the largest.
const LEAST_SIZE: f64 = 0.4;
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
    /// Its patch as first seen: which of the anchors, and the map from it to the patch of each camera.
    anchor: usize,
    linear: [Matrix2<f64>; CAMERAS],
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
    anchors: Vec<Anchor>,
    /// Anchors that no track has.
    free: Vec<usize>,
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
        check((0.005..=1.0).contains(&k.spread_px), "spread_px", "0.005 to 1", k.spread_px.to_string())?;
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
            anchors: Vec::new(),
            free: Vec::new(),
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
        let free = &mut self.free;
        self.tracks.retain(|track| {
            let keep = tracks.binary_search(&track.id).is_err();
            if !keep {
                free.push(track.anchor);
            }
            keep
        });
    }

    /// Lets go of every point: the next frame is a first one.
    pub fn restart(&mut self) {
        self.free.extend(self.tracks.drain(..).map(|track| track.anchor));
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
        tracks.retain_mut(|track| {
            let kept = self.follow_one(track, &turned, prediction.of(track.id, 0));
            if !kept {
                self.free.push(track.anchor);
            }
            kept
        });
        self.tracks = tracks;
        self.thin_out();
    }

    /// Whether the point of `track` is found again; where, is written into it. `turned` moves pixels as rotation alone does.
    fn follow_one(
        &mut self,
        track: &mut Track,
        turned: &dyn Fn(&Vector2<f64>) -> Option<Vector2<f64>>,
        predicted: Option<Vector2<f64>>,
    ) -> bool {
        let Some(by_rotation) = turned(&track.pixel) else { return false };
        let guess = predicted.unwrap_or(by_rotation + track.drift);
        let turn = (|| {
            const STEP: f64 = 4.0;
            let right = turned(&(track.pixel + Vector2::new(STEP, 0.0)))? - by_rotation;
            let down = turned(&(track.pixel + Vector2::new(0.0, STEP)))? - by_rotation;
            Some(Matrix2::from_columns(&[right / STEP, down / STEP]))
        })();
        let warp = turn.and_then(|turn| turn.try_inverse());
        let (before, now) = (&self.before, &self.now[0]);
        let coarsest = self.knobs.flow.levels - 1;
        let levels = (coarsest, 1.min(coarsest));
        let near = self.flow.approach(before, now, &track.pixel, &guess, levels, warp.as_ref());
        let Some(near) = near else { return false };
        let mut pixel = near.pixel;
        let linear = turn.unwrap_or_else(Matrix2::identity) * track.linear[0];
        let anchor = &mut self.anchors[track.anchor];
        let knobs = &self.knobs;
        let window = knobs.flow.window_px;
        let anchored =
            anchor.find(&now.levels()[0], &pixel, &linear, knobs.flow.iterations, knobs.flow.epsilon_px);
        let sound = |sighting: &crate::anchor::Sighting| {
            let size = sighting.linear.determinant();
            sighting.likeness >= knobs.least_likeness
                && (sighting.pixel - near.pixel).norm() < ANCHOR_PX
                && (LEAST_SIZE..1.0 / LEAST_SIZE).contains(&size)
                && sighting.linear.norm_squared() < 3.0 * size
        };
        match anchored.filter(sound) {
            Some(sighting) => {
                pixel = sighting.pixel;
                track.linear[0] = sighting.linear;
                for other in &mut track.linear[1..] {
                    *other = turn.unwrap_or_else(Matrix2::identity) * *other;
                }
            }
            None => {
                // The patch has changed too much: what it is now is what is followed from here on.
                let found = self.flow.follow(before, now, &track.pixel, &pixel, 0, warp.as_ref());
                let Some(found) = found.filter(|found| found.likeness >= knobs.least_likeness) else {
                    return false;
                };
                pixel = found.pixel;
                let back = warp.and_then(|warp| warp.try_inverse());
                let again =
                    self.flow.follow(now, before, &pixel, &track.pixel, 1.min(coarsest), back.as_ref());
                if !again.is_some_and(|again| (again.pixel - track.pixel).norm() <= knobs.back_px) {
                    return false;
                }
                if !anchor.take(&now.levels()[0], &pixel, window) || anchor.spread_px() > knobs.spread_px {
                    return false;
                }
                track.linear = [Matrix2::identity(); CAMERAS];
            }
        }
        if !self.inside(&pixel) {
            return false;
        }
        track.drift = pixel - by_rotation;
        track.pixel = pixel;
        track.age += 1;
        true
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
        self.free.extend(self.tracks.drain(kept..).map(|track| track.anchor));
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
                        let anchor = self.free.pop().unwrap_or_else(|| {
                            self.anchors.push(Anchor::default());
                            self.anchors.len() - 1
                        });
                        let window = self.knobs.flow.window_px;
                        let taken = self.anchors[anchor].take(&self.now[0].levels()[0], &pixel, window);
                        if !taken || self.anchors[anchor].spread_px() > self.knobs.spread_px {
                            self.free.push(anchor);
                            continue;
                        }
                        self.tracks.push(Track {
                            id: TrackId(self.next),
                            pixel,
                            drift: Vector2::zeros(),
                            age: 0,
                            others: [None; CAMERAS - 1],
                            inverse_m: [None; CAMERAS - 1],
                            anchor,
                            linear: [Matrix2::identity(); CAMERAS],
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
            if known.is_none() {
                track.linear[camera] = track.linear[0];
            }
            let (anchor, knobs) = (&self.anchors[track.anchor], &self.knobs);
            let mut anchored = |from: &Vector2<f64>| {
                let (iterations, epsilon_px) = (knobs.flow.iterations, knobs.flow.epsilon_px);
                let linear = &mut track.linear[camera];
                let found = anchor.find(&there.levels()[0], from, linear, iterations, epsilon_px)?;
                let sound = found.likeness >= knobs.least_likeness && (found.pixel - from).norm() < ANCHOR_PX;
                sound.then(|| {
                    *linear = found.linear;
                    found.pixel
                })
            };
            // What is expected is near enough most of the time.
            let mut seen = expected.and_then(|expected| anchored(&expected));
            if seen.is_none() {
                let followed = self.flow.follow(here, there, &track.pixel, &guess, coarsest, None);
                let followed = followed.filter(|found| found.likeness >= knobs.least_likeness);
                seen = followed.map(|found| anchored(&found.pixel).unwrap_or(found.pixel));
            }
            let Some(seen) = seen else { continue };
            let Some(place) = stereo.place(&track.pixel, &seen) else { continue };
            let inside = seen.x >= margin
                && seen.y >= margin
                && seen.x < size[0] - margin
                && seen.y < size[1] - margin;
            if !inside {
                continue;
            }
            if expected.is_none() {
                let back = self.flow.follow(there, here, &seen, &track.pixel, 1, None);
                if !back.is_some_and(|back| (back.pixel - track.pixel).norm() <= self.knobs.back_px) {
                    continue;
                }
            }
            count.alike += 1;
            off_px += place.off_px;
            if place.off_px <= self.knobs.epipolar_px {
                count.matched += 1;
                track.others[camera - 1] = Some(seen);
                track.inverse_m[camera - 1] = Some(place.inverse_m);
            }
        }
        if count.alike > 0 {
            count.mean_off_px = off_px / f64::from(count.alike);
        }
    }
}
