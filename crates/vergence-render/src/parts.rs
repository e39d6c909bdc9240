//! Cuts meshes into parts: what is culled, placed and drawn together.
//!
//! A part is small enough that single precision relative to its own centre is exact to a millionth of its size,
//! that culling it separately pays, and that 16-bit indices reach all of it. Inside, triangles stand in groups
//! that share their vertices, and vertices in the order in which triangles need them: processors of vertices
//! (also a software device's, which looks 1,024 indices back) then compute few of them twice.

use std::collections::HashMap;

use nalgebra::{Point3, Vector3};

/// Triangles whose vertices are looked up together: 1,023 indices.
const GROUP_TRIANGLES: usize = 341;
/// Groups in a part.
const PART_GROUPS: usize = 3;

/// A cut-out of a primitive.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// The middle of its box, mesh coordinates.
    pub centre: Point3<f64>,
    /// Reaches every vertex from the centre, metres.
    pub radius_m: f64,
    /// Directions of its triangles' fronts.
    pub fronts: Cone,
    /// Vertices of the primitive, in the part's order.
    pub vertices: Vec<u32>,
    /// Into `vertices`.
    pub indices: Vec<u16>,
}

/// Directions within an angle of an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cone {
    /// Unit.
    pub axis: Vector3<f64>,
    /// Sine of the half-angle; 1 where the directions fill more than a half-space.
    pub sine: f64,
}

impl Cone {
    /// Whether an eye within `slack_m` of `eye` sees only the backs of triangles whose fronts point into the cone and that lie
    /// within `radius_m` of `centre` (all in mesh coordinates).
    pub fn all_backs(&self, centre: &Point3<f64>, radius_m: f64, eye: &Point3<f64>, slack_m: f64) -> bool {
        let from_eye = centre - eye;
        // The sine of the angle between the line of sight and a triangle's plane is at least that to the axis less the cone.
        self.sine < 1.0
            && self.axis.dot(&from_eye)
                >= self.sine * from_eye.norm() + (1.0 + self.sine) * (radius_m + slack_m)
    }
}

/// Cuts triangles (`indices`, three each, all below `positions.len()`) into parts. O(n log n).
pub(crate) fn cut(positions: &[[f32; 3]], indices: &[u32]) -> Vec<Part> {
    let corner = |index: u32| Point3::from(Vector3::from(positions[index as usize]).cast::<f64>());
    let mut triangles: Vec<(u32, [f32; 3])> = indices
        .chunks_exact(3)
        .enumerate()
        .map(|(number, t)| {
            let [a, b, c] = [0, 1, 2].map(|k| positions[t[k] as usize]);
            (number as u32, [0, 1, 2].map(|k| a[k] / 3.0 + b[k] / 3.0 + c[k] / 3.0))
        })
        .collect();
    let groups = triangles.len().div_ceil(GROUP_TRIANGLES);
    sort_into_groups(&mut triangles, groups);
    triangles
        .chunks(GROUP_TRIANGLES * PART_GROUPS)
        .map(|chunk| {
            let mut part = Part {
                centre: Point3::origin(),
                radius_m: 0.0,
                fronts: Cone { axis: Vector3::z(), sine: 1.0 },
                vertices: Vec::new(),
                indices: Vec::with_capacity(3 * chunk.len()),
            };
            let mut known: HashMap<u32, u16> = HashMap::new();
            for (number, _) in chunk {
                for index in &indices[3 * *number as usize..3 * *number as usize + 3] {
                    let next = part.vertices.len() as u16;
                    let vertex = *known.entry(*index).or_insert(next);
                    if vertex == next {
                        part.vertices.push(*index);
                    }
                    part.indices.push(vertex);
                }
            }
            let (mut least, mut most) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
            for vertex in &part.vertices {
                least = least.inf(&corner(*vertex).coords);
                most = most.sup(&corner(*vertex).coords);
            }
            part.centre = Point3::from((least + most) * 0.5);
            part.radius_m =
                part.vertices.iter().map(|v| (corner(*v) - part.centre).norm()).fold(0.0, f64::max);
            let fronts = chunk.iter().map(|(number, _)| {
                let at = 3 * *number as usize;
                let [a, b, c] = [0, 1, 2].map(|k| corner(indices[at + k]));
                (b - a).cross(&(c - a))
            });
            part.fronts = enclose(fronts);
            part
        })
        .collect()
}

/// A cone around directions of any length; those without a length have no front and do not count.
fn enclose(directions: impl Iterator<Item = Vector3<f64>> + Clone) -> Cone {
    let units = directions.filter_map(|d| d.try_normalize(0.0));
    let sum: Vector3<f64> = units.clone().sum();
    let Some(axis) = sum.try_normalize(1e-9) else { return Cone { axis: Vector3::z(), sine: 1.0 } };
    let cosine = units.map(|d| axis.dot(&d)).fold(1.0, f64::min);
    // A cone of almost a half-space is never seen from behind only.
    let sine = if cosine > 0.05 { (1.0 - cosine * cosine).max(0.0).sqrt() } else { 1.0 };
    Cone { axis, sine }
}

/// Orders triangles so that each run of `GROUP_TRIANGLES` is compact: halves along the longest side of the box of
/// their middles, again and again; inside a group the file's order stays, which is often a good one.
fn sort_into_groups(triangles: &mut [(u32, [f32; 3])], groups: usize) {
    if groups <= 1 {
        triangles.sort_unstable_by_key(|triangle| triangle.0);
        return;
    }
    let (mut least, mut most) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for (_, middle) in triangles.iter() {
        for k in 0..3 {
            least[k] = least[k].min(middle[k]);
            most[k] = most[k].max(middle[k]);
        }
    }
    let axis = (0..3).max_by(|&a, &b| (most[a] - least[a]).total_cmp(&(most[b] - least[b]))).unwrap_or(0);
    // Parts are whole on both sides, where there is more than one.
    let whole = if groups > PART_GROUPS { PART_GROUPS } else { 1 };
    let left = (groups.div_ceil(whole) / 2).max(1) * whole;
    let at = left * GROUP_TRIANGLES;
    triangles.select_nth_unstable_by(at, |a, b| a.1[axis].total_cmp(&b.1[axis]).then(a.0.cmp(&b.0)));
    let (before, after) = triangles.split_at_mut(at);
    sort_into_groups(before, left);
    sort_into_groups(after, groups - left);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sphere of 2·n² triangles.
    fn sphere(n: u32) -> (Vec<[f32; 3]>, Vec<u32>) {
        let mut positions = Vec::new();
        for i in 0..=n {
            for j in 0..=n {
                let (theta, phi) = (
                    f64::from(i) / f64::from(n) * std::f64::consts::PI,
                    f64::from(j) / f64::from(n) * std::f64::consts::TAU,
                );
                let p = [theta.sin() * phi.cos(), theta.cos(), -theta.sin() * phi.sin()];
                positions.push(p.map(|x| x as f32));
            }
        }
        let mut indices = Vec::new();
        for i in 0..n {
            for j in 0..n {
                let (a, b) = (i * (n + 1) + j, (i + 1) * (n + 1) + j);
                indices.extend([a, b, a + 1, a + 1, b, b + 1]);
            }
        }
        (positions, indices)
    }

    #[test]
    fn every_triangle_is_in_one_part_with_its_winding() {
        let (positions, indices) = sphere(60);
        let parts = cut(&positions, &indices);
        assert!(parts.len() > 5);
        let mut found: Vec<[u32; 3]> = parts
            .iter()
            .flat_map(|p| p.indices.chunks_exact(3).map(|t| [0, 1, 2].map(|k| p.vertices[t[k] as usize])))
            .collect();
        let mut expected: Vec<[u32; 3]> = indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        found.sort_unstable();
        expected.sort_unstable();
        assert_eq!(found, expected);
        for part in &parts {
            for vertex in &part.vertices {
                let p = Point3::from(Vector3::from(positions[*vertex as usize]).cast::<f64>());
                assert!((p - part.centre).norm() <= part.radius_m * (1.0 + 1e-12));
            }
        }
    }

    /// A part is called all backs only where every triangle of it is turned away, and that happens.
    #[test]
    fn only_what_is_turned_away_is_dropped() {
        let (positions, indices) = sphere(120);
        let parts = cut(&positions, &indices);
        let mut dropped = 0;
        for eye in [Point3::new(3.0, 0.5, 1.0), Point3::new(-20.0, 0.0, 3.0), Point3::new(0.2, 0.1, 0.0)] {
            for part in &parts {
                if part.fronts.all_backs(&part.centre, part.radius_m, &eye, 0.01) {
                    dropped += 1;
                    for t in part.indices.chunks_exact(3) {
                        let [a, b, c] = [0, 1, 2].map(|k| {
                            let index = part.vertices[t[k] as usize] as usize;
                            Point3::from(Vector3::from(positions[index]).cast::<f64>())
                        });
                        assert!((b - a).cross(&(c - a)).dot(&(a - eye)) >= 0.0);
                    }
                }
            }
        }
        assert!(dropped > parts.len() / 4, "{dropped} of {}", parts.len());
    }
}
