//! Which parts a frame draws, and in which order.

use nalgebra::{Point3, Vector3};
use vergence_geom::{Frustum, View};

use crate::meshes::Meshes;
use crate::pose::{Pose, largest_scale};
use crate::quality::Quality;

/// Something that a frame draws.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Item {
    /// Index into [`Meshes::drawables`].
    Part(u32),
    /// Index into the labels that are drawn.
    Label(u32),
}

/// What a frame draws: parts that cover what is behind them from near to far, then the rest from far to near.
#[derive(Default)]
pub(crate) struct Visible {
    pub covering: Vec<(f64, Item)>,
    pub blended: Vec<(f64, Item)>,
    /// Eyes in the coordinates of each node that has parts whose backs are not drawn; per node, lazily.
    eyes_in_node: Vec<Option<NodeEyes>>,
}

#[derive(Clone, Copy)]
struct NodeEyes {
    eyes: [Point3<f64>; vergence_shaders::MAX_VIEWS as usize],
    slack_m: f64,
}

impl Visible {
    /// Finds what `views` may see: one frustum around all of them, widened by the margins; then parts that show
    /// only their backs to all of them. O(drawables · log).
    pub fn find(
        &mut self,
        meshes: &Meshes,
        pose: &Pose,
        labels: &[(Point3<f64>, f64)],
        views: &[View],
        quality: &Quality,
    ) {
        self.covering.clear();
        self.blended.clear();
        self.eyes_in_node.clear();
        self.eyes_in_node.resize(pose.world.world_from_node.len(), None);
        let frustum = Frustum::enclosing(views, quality.cull_margin_m, quality.cull_margin_rad);
        let middle = middle_of(views);
        for (index, (drawable, (centre, radius_m))) in meshes.drawables.iter().zip(&pose.balls).enumerate() {
            if pose.hidden[drawable.node] || !frustum.may_see_ball(centre, *radius_m) {
                continue;
            }
            if let Some(fronts) = &drawable.fronts
                && fronts.sine < 1.0
            {
                let node_eyes = self.eyes_in_node[drawable.node]
                    .get_or_insert_with(|| NodeEyes::find(pose, drawable.node, views, quality.cull_margin_m));
                let eyes = &node_eyes.eyes[..views.len()];
                let hidden =
                    |eye| fronts.all_backs(&drawable.centre, drawable.radius_m, eye, node_eyes.slack_m);
                if eyes.iter().all(hidden) {
                    continue;
                }
            }
            let distance_m = (centre - middle).norm();
            let item = Item::Part(index as u32);
            if meshes.is_blended(drawable) {
                self.blended.push((distance_m, item));
            } else {
                // The farthest point, not the middle: walls and floors stand behind what is in the room.
                self.covering.push((distance_m + radius_m, item));
            }
        }
        for (index, (centre, radius_m)) in labels.iter().enumerate() {
            if *radius_m >= 0.0 && frustum.may_see_ball(centre, *radius_m) {
                self.blended.push(((centre - middle).norm(), Item::Label(index as u32)));
            }
        }
        self.covering.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        self.blended.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    }
}

impl NodeEyes {
    fn find(pose: &Pose, node: usize, views: &[View], margin_m: f64) -> Self {
        // A node without inverse is flat: an eye that sees no back from anywhere.
        let nowhere = Point3::from(Vector3::repeat(f64::NAN));
        let mut this = Self { eyes: [nowhere; vergence_shaders::MAX_VIEWS as usize], slack_m: 0.0 };
        if let Some(node_from_world) = pose.world.world_from_node[node].try_inverse() {
            for (eye, view) in this.eyes.iter_mut().zip(views) {
                *eye = node_from_world.transform_point(&Point3::from(view.world_from_eye.translation.vector));
            }
            this.slack_m = margin_m * largest_scale(&node_from_world);
        }
        this
    }
}

/// The mean of the eyes.
pub(crate) fn middle_of(views: &[View]) -> Point3<f64> {
    let sum: Vector3<f64> = views.iter().map(|view| view.world_from_eye.translation.vector).sum();
    Point3::from(sum / views.len().max(1) as f64)
}
