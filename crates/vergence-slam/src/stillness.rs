//! Whether anything moves at all.

use vergence_time::Timestamp;

use crate::odometry::{FEWEST, seconds};
use crate::sighting::Sighting;

/// Corners that have moved by less than this in the middle have not moved, pixels.
const UNMOVED_PX: f64 = 0.3;
/// What was seen to move stands still again after so long without moving, s.
const CALM_S: f64 = 0.5;
/// Standard deviation of the velocity of what has stood still for a second and longer, m/s: 0.3 pixels are 2 mm on a wall 3 m away.
const STILL_M_S: f64 = 0.003;

/// Where corners were when they were last seen to move. From one frame to the next, what creeps or hovers does not move either: how slow it is
/// known to be hangs on how long nothing has moved.
#[derive(Debug, Default)]
pub(crate) struct Stillness {
    since: Option<Timestamp>,
    /// Then; sorted by track, then camera.
    seen: Vec<Sighting>,
    has_moved: bool,
    moved_px: Vec<f64>,
}

impl Stillness {
    /// Standard deviation of the velocity of a frame that stands still, m/s; `None` where it moves, or nobody knows. `quiet`: the inertial
    /// unit feels nothing but gravity; `seen` is sorted by track, then camera.
    pub(crate) fn judge(&mut self, time: Timestamp, seen: &[Sighting], quiet: bool) -> Option<f64> {
        self.moved_px.clear();
        for s in seen {
            let same = self.seen.binary_search_by_key(&(s.track, s.camera), |b| (b.track, b.camera));
            self.moved_px.extend(same.ok().map(|k| (s.px_by_direction * self.seen[k].direction).norm()));
        }
        let middle = self.moved_px.len() / 2;
        let unmoved = self.moved_px.len() >= 2 * FEWEST
            && *self.moved_px.select_nth_unstable_by(middle, f64::total_cmp).1 < UNMOVED_PX;
        if let (true, true, Some(since)) = (quiet, unmoved, self.since) {
            let calm_s = seconds(since, time);
            self.has_moved &= calm_s < CALM_S;
            return (!self.has_moved).then(|| STILL_M_S / calm_s.clamp(1e-3, 1.0));
        }
        // A unit whose bias is not known yet is not quiet where it stands.
        self.has_moved |= self.since.is_some() && !unmoved;
        self.since = Some(time);
        self.seen.clear();
        self.seen.extend_from_slice(seen);
        None
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use vergence_geom::Lens;

    use super::*;

    /// What a camera sees that has slid so far before a wall 3 m away.
    fn slid(by_m: f64) -> Vec<Sighting> {
        let lens = Lens::pinhole([458.0, 457.0], [376.0, 240.0]).unwrap();
        let pixel = |k: u64| {
            Vector2::new(30.0 * (k % 20) as f64 + 60.0 - 458.0 * by_m / 3.0, 20.0 * (k / 5) as f64 + 40.0)
        };
        (0..80).filter_map(|k| Sighting::new(k, 0, &pixel(k), &lens)).collect()
    }

    fn at(frame: i64) -> Timestamp {
        Timestamp::from_nanos(1_400_000_000_000_000_000 + frame * 50_000_000)
    }

    #[test]
    fn the_longer_it_stands_the_better_its_velocity_is_known() {
        let mut stillness = Stillness::default();
        let found: Vec<_> = (0..60).map(|k| stillness.judge(at(k), &slid(0.0), true)).collect();
        assert_eq!((found[0], found[20], found[59]), (None, Some(STILL_M_S), Some(STILL_M_S)));
        assert!(
            (found[1].unwrap() - 0.06).abs() < 1e-9 && found.windows(2).skip(1).all(|two| two[0] >= two[1])
        );
        // Who is touched begins anew; who was seen to move stands half a second later.
        assert_eq!(stillness.judge(at(60), &slid(0.0), false), None);
        assert_eq!(stillness.judge(at(61), &slid(0.0), true).map(|sigma| sigma > 0.05), Some(true));
        assert_eq!(stillness.judge(at(62), &slid(0.01), true), None);
        let found: Vec<_> = (63..80).map(|k| stillness.judge(at(k), &slid(0.01), true)).collect();
        assert_eq!((found[8], found[9]), (None, Some(STILL_M_S / 0.5)));
    }

    #[test]
    fn what_creeps_is_never_held_to_stand() {
        // 15 mm/s: 0.11 pixels a frame.
        let mut stillness = Stillness::default();
        for k in 0..200 {
            if let Some(sigma) = stillness.judge(at(k), &slid(7.5e-4 * k as f64), true) {
                assert!(sigma > 0.015, "frame {k}: known to {sigma} m/s");
            }
        }
    }

    #[test]
    fn who_sees_little_does_not_know() {
        let mut stillness = Stillness::default();
        for k in 0..20 {
            assert_eq!(stillness.judge(at(k), &slid(0.0)[..2 * FEWEST - 1], true), None);
        }
    }
}
