//! Polygons to triangles by clipping ears: concave ones come out right, broken ones come out at all.

use nalgebra::{Vector2, Vector3};

/// Tests of a point against a triangle that one polygon may take for each of its corners; what is left then is cut
/// as a fan. A simple polygon of n corners takes about n/4 of them, a hopeless one n².
const TESTS_PER_CORNER: usize = 2000;

/// Cuts the polygon with the given corners (metres, at least 3) into triangles, each a triple of indices into
/// `corners`, wound as the polygon is. Corners may coincide (a hole joined to the outline by a cut). Calls `emit` for
/// `corners.len() − 2` triangles.
pub(crate) fn triangulate(corners: &[[f32; 3]], mut emit: impl FnMut([usize; 3])) {
    let count = corners.len();
    if count < 3 {
        return;
    }
    let flat = if count > 3 { flattened(corners) } else { None };
    let Some(flat) = flat else {
        (1..count - 1).for_each(|i| emit([0, i, i + 1]));
        return;
    };
    let turn = |a: usize, b: usize, c: usize| (flat[b] - flat[a]).perp(&(flat[c] - flat[b]));
    // A convex polygon is a fan; most faces are.
    if (0..count).all(|i| turn(i, (i + 1) % count, (i + 2) % count) >= 0.0) && winds_once(&flat) {
        (1..count - 1).for_each(|i| emit([0, i, i + 1]));
        return;
    }
    let mut left: Vec<usize> = (0..count).collect();
    let mut tests = TESTS_PER_CORNER.saturating_mul(count);
    let (mut at, mut failures) = (0, 0);
    while left.len() > 3 {
        let n = left.len();
        let [a, b, c] = [left[(at + n - 1) % n], left[at % n], left[(at + 1) % n]];
        let area = turn(a, b, c);
        let is_ear = area > 0.0 && {
            tests = tests.saturating_sub(n);
            !left.iter().any(|&p| {
                let point = flat[p];
                let is_corner = point == flat[a] || point == flat[b] || point == flat[c];
                !is_corner
                    && (flat[b] - flat[a]).perp(&(point - flat[a])) >= 0.0
                    && (flat[c] - flat[b]).perp(&(point - flat[b])) >= 0.0
                    && (flat[a] - flat[c]).perp(&(point - flat[c])) >= 0.0
            })
        };
        // A corner without area may go at any time; after a whole round without an ear, so may any.
        if is_ear || area == 0.0 || failures > n {
            emit([a, b, c]);
            left.remove(at % n);
            failures = 0;
            // Going back one corner spreads the cuts less, but looks again at what has just become an ear.
            at = (at + left.len() - 1) % left.len();
        } else {
            failures += 1;
            at = (at + 1) % n;
        }
        if tests == 0 {
            break;
        }
    }
    (1..left.len() - 1).for_each(|i| emit([left[0], left[i], left[i + 1]]));
}

/// The corners in the polygon's plane (that of Newell's normal), counter-clockwise; `None` where it has no area.
fn flattened(corners: &[[f32; 3]]) -> Option<Vec<Vector2<f64>>> {
    let origin = Vector3::from(corners[0]).cast::<f64>();
    let points: Vec<Vector3<f64>> =
        corners.iter().map(|&c| Vector3::from(c).cast::<f64>() - origin).collect();
    let next = points.iter().cycle().skip(1);
    let normal: Vector3<f64> = points.iter().zip(next).map(|(a, b)| a.cross(b)).sum();
    if normal.amax() == 0.0 || !normal.amax().is_finite() {
        return None;
    }
    // Dropping the longest axis of the normal keeps the shape up to an affine map, without rounding.
    let axis = normal.iamax();
    let (u, v) =
        if normal[axis] > 0.0 { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
    Some(points.iter().map(|p| Vector2::new(p[u], p[v])).collect())
}

/// Whether a polygon that always turns left goes round once (a pentagram does so twice).
fn winds_once(flat: &[Vector2<f64>]) -> bool {
    let count = flat.len();
    let edge = |i: usize| flat[(i + 1) % count] - flat[i % count];
    let total: f64 = (0..count)
        .map(|i| {
            let (a, b) = (edge(i), edge(i + 1));
            a.perp(&b).atan2(a.dot(&b))
        })
        .sum();
    (total / std::f64::consts::TAU).round() as i64 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn areas(corners: &[[f32; 3]]) -> (Vec<[usize; 3]>, f64, f64) {
        let mut triangles = Vec::new();
        triangulate(corners, |t| triangles.push(t));
        let at = |i: usize| Vector3::from(corners[i]).cast::<f64>();
        let normal = |t: &[usize; 3]| (at(t[1]) - at(t[0])).cross(&(at(t[2]) - at(t[0]))) * 0.5;
        let total: Vector3<f64> = triangles.iter().map(normal).sum();
        let sum_of_sizes: f64 = triangles.iter().map(|t| normal(t).norm()).sum();
        (triangles, total.norm(), sum_of_sizes)
    }

    /// The signed areas add up whatever the triangles; the sizes do so only where none is turned over.
    #[track_caller]
    fn is_cut_well(corners: &[[f32; 3]]) {
        let (triangles, signed, sizes) = areas(corners);
        assert_eq!(triangles.len(), corners.len() - 2);
        assert!((signed - sizes).abs() <= 1e-6 * sizes, "{signed} {sizes}: {triangles:?}");
    }

    #[test]
    fn concave_polygons_come_out_without_overlap() {
        let dart = [[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.2, 0.0], [-1.0, 1.0, 0.0]];
        for start in 0..4 {
            let mut turned = dart;
            turned.rotate_left(start);
            is_cut_well(&turned);
            turned.reverse();
            is_cut_well(&turned);
        }
        // A comb in a slanted plane.
        let comb: Vec<[f32; 3]> = (0..20)
            .map(|i| [i as f32, if i % 2 == 0 { 0.0 } else { 3.0 }, 0.5 * i as f32])
            .chain([[19.0, 5.0, 9.5], [0.0, 5.0, 0.0]])
            .collect();
        is_cut_well(&comb);
        // A square with a square hole, joined by a cut whose ends appear twice.
        let ring = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]
            .map(|(x, z)| [x as f32, 7.0, z as f32]);
        is_cut_well(&ring);
        assert!((areas(&ring).1 - 12.0).abs() < 1e-9);
    }

    #[test]
    fn broken_polygons_still_end() {
        let round_and_round: Vec<[f32; 3]> = (0..4000)
            .map(|i| [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]][i % 4])
            .map(|[x, y]| [x, y, 0.0])
            .collect();
        assert_eq!(areas(&round_and_round).0.len(), 3998);
        let bow_tie = [[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert_eq!(areas(&bow_tie).0.len(), 2);
        assert_eq!(areas(&[[1.0; 3]; 9]).0.len(), 7);
        assert_eq!(areas(&[[f32::MAX; 3], [-f32::MAX, 0.0, 1.0], [0.0; 3], [1.0, 2.0, 3.0]]).0.len(), 2);
    }
}
