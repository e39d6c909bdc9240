//! A tree of boxes over triangles: binned surface-area heuristic (Wald 2007), boxes in `f32` rounded outwards, so
//! that a box strictly contains what is in it and nothing has to be widened when it is traversed.

use nalgebra::Vector3;

/// Triangles in a leaf, at most (unless they cannot be told apart).
const LEAF: usize = 4;
/// Places at which a node may be split along each axis.
const BINS: usize = 16;
/// From this depth on nodes are split in the middle of their order: the tree stays below 32 levels more.
const SAH_DEPTH: u32 = 40;
/// Room for every level of the deepest tree.
const STACK: usize = 80;

/// A box, corners in `f32`.
#[derive(Clone, Copy)]
pub(super) struct Box3 {
    min: [f32; 3],
    max: [f32; 3],
}

impl Box3 {
    const EMPTY: Self = Self { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3] };

    /// The box around `points`, widened by one unit in the last place.
    pub fn around(points: &[[f32; 3]]) -> Self {
        let mut around = Self::EMPTY;
        for point in points {
            around.add(&Self { min: *point, max: *point });
        }
        Self { min: around.min.map(f32::next_down), max: around.max.map(f32::next_up) }
    }

    fn add(&mut self, other: &Self) {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
        }
    }

    fn centre(&self, axis: usize) -> f64 {
        0.5 * (f64::from(self.min[axis]) + f64::from(self.max[axis]))
    }

    /// Half of the surface; 0 where empty.
    fn half_area(&self) -> f64 {
        let size = |axis: usize| (f64::from(self.max[axis]) - f64::from(self.min[axis])).max(0.0);
        let [x, y, z] = [size(0), size(1), size(2)];
        x * y + y * z + z * x
    }

    /// Where a ray enters, if it does before `within`. `inverse` is one over its direction; an infinite component is
    /// right, because what is in the box never touches its faces.
    fn entry(&self, origin: &Vector3<f64>, inverse: &Vector3<f64>, within: f64) -> Option<f64> {
        let (mut near, mut far) = (f64::NEG_INFINITY, within);
        for axis in 0..3 {
            let a = (f64::from(self.min[axis]) - origin[axis]) * inverse[axis];
            let b = (f64::from(self.max[axis]) - origin[axis]) * inverse[axis];
            near = near.max(a.min(b));
            // Three roundings may make the far side seem nearer than it is (Ize 2013).
            far = far.min(a.max(b) * (1.0 + 4.0 * f64::EPSILON));
        }
        (near <= far && far >= 0.0).then_some(near)
    }
}

struct Node {
    bounds: Box3,
    /// Of a leaf: its first triangle; else its first child, whose sibling comes next.
    first: u32,
    /// Triangles of a leaf; 0 for others.
    count: u32,
}

/// The tree; triangles are known by their place in `order`.
pub(super) struct Tree {
    nodes: Vec<Node>,
    /// Which box of the caller's each triangle is.
    pub order: Vec<u32>,
}

impl Tree {
    /// Builds a tree over at least one box. O(n log n).
    pub fn new(boxes: &[Box3]) -> Self {
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        let mut nodes = vec![Node { bounds: Box3::EMPTY, first: 0, count: boxes.len() as u32 }];
        let mut open = vec![(0usize, 0u32)];
        while let Some((index, depth)) = open.pop() {
            let (first, count) = (nodes[index].first as usize, nodes[index].count as usize);
            let range = &mut order[first..first + count];
            for &item in range.iter() {
                nodes[index].bounds.add(&boxes[item as usize]);
            }
            if count <= LEAF {
                continue;
            }
            let left = if depth < SAH_DEPTH { split(boxes, range) } else { count / 2 };
            let children = nodes.len();
            for (first, count) in [(first, left), (first + left, count - left)] {
                nodes.push(Node { bounds: Box3::EMPTY, first: first as u32, count: count as u32 });
            }
            (nodes[index].first, nodes[index].count) = (children as u32, 0);
            open.extend([(children, depth + 1), (children + 1, depth + 1)]);
        }
        Self { nodes, order }
    }

    /// The box around everything: middle and half diagonal.
    pub fn ball(&self) -> (Vector3<f64>, f64) {
        let bounds = &self.nodes[0].bounds;
        let centre = Vector3::new(bounds.centre(0), bounds.centre(1), bounds.centre(2));
        (centre, (Vector3::from(bounds.max).cast::<f64>() - centre).norm())
    }

    /// Calls `meet` for the triangles (places in `order`) whose boxes a ray enters before `within`; `meet` answers
    /// with the new `within`.
    pub fn traverse(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        mut within: f64,
        mut meet: impl FnMut(usize, f64) -> f64,
    ) {
        let inverse = direction.map(|d| 1.0 / d);
        let entry = |node: u32, within: f64| self.nodes[node as usize].bounds.entry(origin, &inverse, within);
        let mut stack = [(0u32, 0.0f64); STACK];
        let mut height = 0;
        if let Some(near) = entry(0, within) {
            stack[0] = (0, near);
            height = 1;
        }
        while height > 0 {
            height -= 1;
            let (index, near) = stack[height];
            if near > within {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for triangle in node.first..node.first + node.count {
                    within = meet(triangle as usize, within);
                }
                continue;
            }
            let (a, b) = (node.first, node.first + 1);
            let children = [(a, entry(a, within)), (b, entry(b, within))];
            let nearer_last = if children[0].1 <= children[1].1 { [1, 0] } else { [0, 1] };
            for child in nearer_last {
                if let (node, Some(near)) = children[child] {
                    stack[height] = (node, near);
                    height += 1;
                }
            }
        }
    }
}

/// Puts the boxes that go left first; how many those are (never none, never all).
fn split(boxes: &[Box3], items: &mut [u32]) -> usize {
    let centre = |item: u32, axis: usize| boxes[item as usize].centre(axis);
    let mut best: Option<(f64, usize, f64)> = None;
    for axis in 0..3 {
        let (low, high) = items.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &item| {
            (low.min(centre(item, axis)), high.max(centre(item, axis)))
        });
        let per_unit = BINS as f64 / (high - low);
        if !(high > low && per_unit.is_finite()) {
            continue;
        }
        let mut bins = [(Box3::EMPTY, 0usize); BINS];
        for &item in items.iter() {
            let bin = (((centre(item, axis) - low) * per_unit) as usize).min(BINS - 1);
            bins[bin].0.add(&boxes[item as usize]);
            bins[bin].1 += 1;
        }
        let mut right = [(0.0, 0usize); BINS];
        let (mut bounds, mut count) = (Box3::EMPTY, 0);
        for bin in (1..BINS).rev() {
            bounds.add(&bins[bin].0);
            count += bins[bin].1;
            right[bin] = (bounds.half_area(), count);
        }
        let (mut bounds, mut count) = (Box3::EMPTY, 0);
        for bin in 1..BINS {
            bounds.add(&bins[bin - 1].0);
            count += bins[bin - 1].1;
            if count == 0 || right[bin].1 == 0 {
                continue;
            }
            let cost = bounds.half_area() * count as f64 + right[bin].0 * right[bin].1 as f64;
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, low + bin as f64 / per_unit));
            }
        }
    }
    let half = items.len() / 2;
    let Some((_, axis, at)) = best else { return half };
    // Order of items within a side does not matter.
    let mut left = 0;
    for i in 0..items.len() {
        if centre(items[i], axis) < at {
            items.swap(left, i);
            left += 1;
        }
    }
    if left == 0 || left == items.len() { half } else { left }
}
