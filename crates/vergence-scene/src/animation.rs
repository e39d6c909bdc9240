//! Animation clips sampled into local transforms.
//!
//! Any time gives an answer: before the first key the first one holds, after the last key the last one; at a key
//! its value comes back bit for bit; of keys at the same time the last one counts. Looping is the caller's, or
//! [`Scene::animate`]'s.

use nalgebra::{Quaternion, UnitQuaternion, Vector3, Vector4};
use vergence_geom::slerp;
use vergence_time::Span;

use crate::model::{Animation, Interpolation, Local, Scene, Track, Values};

/// Where a time falls among the keys of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    /// The value of one key, as it is.
    At(usize),
    /// Between a key and the next one.
    Between {
        /// The earlier key.
        key: usize,
        /// How far towards the next one, 0…1 exclusive.
        fraction: f64,
        /// From the key to the next one, seconds.
        interval_secs: f64,
    },
}

/// What a track gives at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sample {
    /// Metres.
    Translation(Vector3<f64>),
    /// Of unit length.
    Rotation(UnitQuaternion<f64>),
    /// Factors.
    Scale(Vector3<f64>),
}

impl Animation {
    /// Time of the last key, seconds; 0 for a clip without tracks.
    pub fn duration_secs(&self) -> f64 {
        self.tracks.iter().filter_map(|track| track.times_secs.last()).fold(0.0, |a, &b| a.max(f64::from(b)))
    }

    /// Writes what moves at `time_secs` (from the clip's start) into `locals`, one per node of the scene; what
    /// does not move stays. O(tracks · log keys), allocates nothing.
    pub fn sample(&self, time_secs: f64, locals: &mut [Local]) {
        for track in &self.tracks {
            let Some(Local::Trs(trs)) = locals.get_mut(track.node) else { continue };
            match track.sample(time_secs) {
                Some(Sample::Translation(translation)) => trs.translation = translation,
                Some(Sample::Rotation(rotation)) => trs.rotation = rotation,
                Some(Sample::Scale(scale)) => trs.scale = scale,
                None => {}
            }
        }
    }
}

impl Track {
    /// The value at `time_secs`; `None` for a track without keys, or with fewer values than its keys need.
    pub fn sample(&self, time_secs: f64) -> Option<Sample> {
        let place = self.place(time_secs)?;
        match &self.values {
            Values::Translation(keys) => self.vector(keys, place).map(Sample::Translation),
            Values::Scale(keys) => self.vector(keys, place).map(Sample::Scale),
            Values::Rotation(keys) => self.rotation(keys, place).map(Sample::Rotation),
        }
    }

    fn place(&self, time_secs: f64) -> Option<Place> {
        let times = &self.times_secs;
        let last = times.len().checked_sub(1)?;
        // Keys at or before the time; not a number counts as before all of them.
        let passed = times.partition_point(|&key| f64::from(key) <= time_secs);
        let Some(key) = passed.checked_sub(1) else { return Some(Place::At(0)) };
        let start = f64::from(times[key]);
        if key == last || time_secs == start {
            return Some(Place::At(key));
        }
        let interval_secs = f64::from(times[key + 1]) - start;
        Some(Place::Between { key, fraction: (time_secs - start) / interval_secs, interval_secs })
    }

    /// Index of a key's value among the values.
    fn value_index(&self, key: usize) -> usize {
        if self.interpolation == Interpolation::CubicSpline { 3 * key + 1 } else { key }
    }

    fn vector(&self, keys: &[[f32; 3]], place: Place) -> Option<Vector3<f64>> {
        let at = |index: usize| keys.get(index).map(|&v| Vector3::from(v).cast::<f64>());
        let value = |key: usize| at(self.value_index(key));
        match (place, self.interpolation) {
            (Place::At(key), _) | (Place::Between { key, .. }, Interpolation::Step) => value(key),
            (Place::Between { key, fraction, .. }, Interpolation::Linear) => {
                let (a, b) = (value(key)?, value(key + 1)?);
                Some(a * (1.0 - fraction) + b * fraction)
            }
            (Place::Between { key, fraction, interval_secs }, Interpolation::CubicSpline) => {
                let [a, da, b, db] = hermite(fraction, interval_secs);
                Some(value(key)? * a + at(3 * key + 2)? * da + value(key + 1)? * b + at(3 * (key + 1))? * db)
            }
        }
    }

    fn rotation(&self, keys: &[[f32; 4]], place: Place) -> Option<UnitQuaternion<f64>> {
        let at = |index: usize| keys.get(index).map(|&v| Vector4::from(v).cast::<f64>());
        let value = |key: usize| at(self.value_index(key));
        match (place, self.interpolation) {
            (Place::At(key), _) | (Place::Between { key, .. }, Interpolation::Step) => {
                // Keys are of unit length to rounding (importers see to it): normalising would move them.
                let key = value(key)?;
                if (key.norm_squared() - 1.0).abs() < 4e-6 {
                    Some(UnitQuaternion::new_unchecked(Quaternion::from(key)))
                } else {
                    unit(&key)
                }
            }
            (Place::Between { key, fraction, .. }, Interpolation::Linear) => {
                Some(slerp(&unit(&value(key)?)?, &unit(&value(key + 1)?)?, fraction))
            }
            (Place::Between { key, fraction, interval_secs }, Interpolation::CubicSpline) => {
                let [a, da, b, db] = hermite(fraction, interval_secs);
                let (from, to) = (value(key)?, value(key + 1)?);
                let curve = from * a + at(3 * key + 2)? * da + to * b + at(3 * (key + 1))? * db;
                // A curve through the origin has no direction there: the arc has.
                unit(&curve).or_else(|| Some(slerp(&unit(&from)?, &unit(&to)?, fraction)))
            }
        }
    }
}

fn unit(v: &Vector4<f64>) -> Option<UnitQuaternion<f64>> {
    UnitQuaternion::try_new(Quaternion::from(*v), 1e-9)
}

/// Weights of value, out-tangent, next value and its in-tangent of a cubic Hermite segment; tangents are per second.
/// Source: glTF 2.0, appendix C.5.
fn hermite(t: f64, interval_secs: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        2.0 * t3 - 3.0 * t2 + 1.0,
        interval_secs * (t3 - 2.0 * t2 + t),
        -2.0 * t3 + 3.0 * t2,
        interval_secs * (t3 - t2),
    ]
}

impl Scene {
    /// Local transforms of all nodes `time` after the start, with the clips in [`Scene::playing`] running in loops,
    /// into `locals`; allocates only where the scene has grown. O(nodes + tracks · log keys).
    pub fn animate(&self, time: Span, locals: &mut Vec<Local>) {
        locals.clear();
        locals.extend(self.nodes.iter().map(|node| node.parent_from_node));
        for clip in self.playing.iter().filter_map(|&clip| self.animations.get(clip)) {
            let duration_secs = clip.duration_secs();
            let secs = time.as_secs_f64();
            clip.sample(if duration_secs > 0.0 { secs.rem_euclid(duration_secs) } else { 0.0 }, locals);
        }
    }

    /// The clips that can run together: each one whose tracks move nothing that an earlier one moves.
    pub fn compatible_clips(&self) -> Vec<usize> {
        let mut moved = std::collections::HashSet::new();
        let property = |track: &Track| (track.node, std::mem::discriminant(&track.values));
        (0..self.animations.len())
            .filter(|&clip| {
                let tracks = &self.animations[clip].tracks;
                let is_free = tracks.iter().all(|track| !moved.contains(&property(track)));
                if is_free {
                    moved.extend(tracks.iter().map(property));
                }
                is_free
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn track(interpolation: Interpolation, times_secs: &[f32], values: Values) -> Track {
        Track { node: 0, times_secs: times_secs.to_vec(), interpolation, values }
    }

    fn translation(track: &Track, time_secs: f64) -> Vector3<f64> {
        match track.sample(time_secs) {
            Some(Sample::Translation(v)) => v,
            other => panic!("{other:?}"),
        }
    }

    /// Row 18 of the extremes.
    #[test]
    fn time_is_clamped_and_keys_come_back_bit_for_bit_and_duplicates_take_the_last() {
        let keys: Vec<[f32; 3]> = (0..5).map(|i| [0.1 * i as f32, 1.0 / (1.0 + i as f32), -7.3]).collect();
        let exact = |i: usize| Vector3::from(keys[i]).cast::<f64>();
        let linear =
            track(Interpolation::Linear, &[0.5, 1.0, 1.0, 1.0, 2.0], Values::Translation(keys.clone()));
        for (time, key) in [(-1e300, 0), (0.0, 0), (0.5, 0), (1.0, 3), (2.0, 4), (1e300, 4)] {
            assert_eq!(translation(&linear, time), exact(key), "at {time}");
        }
        for time in [f64::NAN, f64::NEG_INFINITY] {
            assert_eq!(translation(&linear, time), exact(0));
        }
        assert_eq!(translation(&linear, f64::INFINITY), exact(4));
        // Just before the duplicates the first of them counts.
        assert!((translation(&linear, 1.0 - 1e-12) - exact(1)).norm() < 1e-9);
        assert_eq!(translation(&linear, 1.5), (exact(3) + exact(4)) * 0.5);
        let one = track(Interpolation::CubicSpline, &[3.0], Values::Translation(keys[..3].to_vec()));
        for time in [0.0, 3.0, 9.0] {
            assert_eq!(translation(&one, time), exact(1));
        }
        assert_eq!(track(Interpolation::Step, &[], Values::Scale(vec![])).sample(0.0), None);
    }

    #[test]
    fn a_step_holds_until_the_next_key() {
        let step = track(
            Interpolation::Step,
            &[0.0, 1.0],
            Values::Translation(vec![[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]),
        );
        assert_eq!(translation(&step, 1.0 - 1e-9).x, 1.0);
        assert_eq!(translation(&step, 1.0).x, 2.0);
    }

    /// Tangents are per second: a cubic through its own values and derivatives comes back exactly, whatever the
    /// distance of the keys.
    #[test]
    fn a_cubic_is_reproduced() {
        let (f, df) = (|t: f64| t * t * t - 2.0 * t, |t: f64| 3.0 * t * t - 2.0);
        let times = [0.0f32, 0.5, 3.0];
        let values = times
            .iter()
            .flat_map(|&t| {
                let (v, d) = (f(f64::from(t)) as f32, df(f64::from(t)) as f32);
                [[d; 3], [v; 3], [d; 3]]
            })
            .collect();
        let spline = track(Interpolation::CubicSpline, &times, Values::Translation(values));
        for i in 0..=300 {
            let t = f64::from(i) * 0.01;
            assert!((translation(&spline, t).x - f(t)).abs() < 1e-12, "at {t}");
        }
    }

    #[test]
    fn a_rotation_curve_through_the_origin_still_has_a_direction() {
        let spline = track(
            Interpolation::CubicSpline,
            &[0.0, 1.0],
            Values::Rotation(vec![
                [0.0; 4],
                [0.0, 0.0, 0.0, 1.0],
                [0.0; 4],
                [0.0; 4],
                [0.0, 0.0, 0.0, -1.0],
                [0.0; 4],
            ]),
        );
        match spline.sample(0.5) {
            Some(Sample::Rotation(q)) => assert!((q.norm() - 1.0).abs() < 1e-15),
            other => panic!("{other:?}"),
        }
    }

    proptest! {
        #[test]
        fn no_track_gives_anything_but_finite_numbers(
            mut times in proptest::collection::vec(-1e30f32..1e30, 1..6),
            seed in proptest::collection::vec([-1e30f32..1e30, -1.0f32..1.0, 0.0f32..1.0, -1e-30f32..1e-30], 18),
            time in prop_oneof![any::<f64>(), -1e30..1e30f64],
            kind in 0..3,
        ) {
            times.sort_by(f32::total_cmp);
            let interpolation =
                [Interpolation::Step, Interpolation::Linear, Interpolation::CubicSpline][kind as usize];
            let vectors: Vec<[f32; 3]> = seed.iter().map(|&[a, b, c, _]| [a, b, c]).collect();
            for values in [Values::Translation(vectors.clone()), Values::Rotation(seed.clone())] {
                match track(interpolation, &times, values).sample(time) {
                    Some(Sample::Translation(v) | Sample::Scale(v)) => prop_assert!(v.iter().all(|c| c.is_finite())),
                    Some(Sample::Rotation(q)) => prop_assert!((q.norm() - 1.0).abs() < 1e-5, "{q:?}"),
                    None => {}
                }
            }
        }
    }
}
