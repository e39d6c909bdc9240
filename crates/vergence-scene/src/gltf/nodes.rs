//! The node hierarchy: checked to be a forest, cut to the default scene, parents put before their children.

use std::path::Path;

use nalgebra::{Matrix4, Quaternion, UnitQuaternion, Vector3};
use vergence_geom::{Affine, Trs};

use super::raw;
use crate::Error;
use crate::model::Local;

/// The nodes to import, in order, and where each raw node went.
pub(super) struct Order {
    /// Raw indices, parents first.
    pub nodes: Vec<usize>,
    /// By raw index: its place in `nodes`.
    pub position: Vec<Option<usize>>,
    /// By raw index.
    pub parents: Vec<Option<usize>>,
}

/// Orders the nodes of the default scene (of all roots where the file has no scenes); joints of skins come along
/// even where they stand outside of it.
pub(super) fn order(path: &Path, root: &raw::Root) -> Result<Order, Error> {
    let count = root.nodes.len();
    let node_at = |index: usize, place: &dyn Fn() -> String| {
        if index < count {
            return Ok(index);
        }
        Err(Error::invalid(path, place(), format!("expected a node below {count}, found {index}")))
    };
    let mut parents = vec![None; count];
    for (parent, node) in root.nodes.iter().enumerate() {
        for (at, &child) in node.children.iter().enumerate() {
            let place = || format!("nodes[{parent}].children[{at}]");
            let child = node_at(child, &place)?;
            if let Some(other) = parents[child].replace(parent) {
                return Err(Error::invalid(
                    path,
                    place(),
                    format!(
                        "expected nodes[{child}] to have one parent, found nodes[{other}] and nodes[{parent}]"
                    ),
                ));
            }
        }
    }
    // Every node has at most one parent, so what cannot be reached from a parentless node is a cycle.
    let all_roots: Vec<usize> = (0..count).filter(|&node| parents[node].is_none()).collect();
    let mut everything = Order { nodes: Vec::new(), position: vec![None; count], parents };
    everything.visit(root, &all_roots);
    if let Some(lost) = everything.position.iter().position(Option::is_none) {
        return Err(Error::invalid(
            path,
            format!("nodes[{lost}]"),
            "expected a tree, found a node that is its own ancestor",
        ));
    }
    let roots = match (root.scene, root.scenes.first()) {
        (Some(index), _) => {
            let scene = root.scenes.get(index).ok_or_else(|| {
                Error::invalid(
                    path,
                    "scene",
                    format!("expected a scene below {}, found {index}", root.scenes.len()),
                )
            })?;
            Some((index, scene))
        }
        (None, Some(first)) => Some((0, first)),
        (None, None) => None,
    };
    let Some((scene_index, scene)) = roots else {
        return Ok(everything);
    };
    let mut order = Order { nodes: Vec::new(), position: vec![None; count], parents: everything.parents };
    let mut is_root = vec![false; count];
    for (at, &node) in scene.nodes.iter().enumerate() {
        let place = || format!("scenes[{scene_index}].nodes[{at}]");
        let node = node_at(node, &place)?;
        if let Some(parent) = order.parents[node] {
            return Err(Error::invalid(
                path,
                place(),
                format!("expected a root node, found nodes[{node}], a child of nodes[{parent}]"),
            ));
        }
        if std::mem::replace(&mut is_root[node], true) {
            return Err(Error::invalid(
                path,
                place(),
                format!("expected each node once, found nodes[{node}] twice"),
            ));
        }
    }
    order.visit(root, &scene.nodes);
    for (skin, raw_skin) in root.skins.iter().enumerate() {
        for (at, &joint) in raw_skin.joints.iter().enumerate() {
            let mut top = node_at(joint, &|| format!("skins[{skin}].joints[{at}]"))?;
            while let Some(parent) = order.parents[top].filter(|_| order.position[top].is_none()) {
                top = parent;
            }
            if order.position[top].is_none() {
                order.visit(root, &[top]);
            }
        }
    }
    Ok(order)
}

impl Order {
    fn visit(&mut self, root: &raw::Root, roots: &[usize]) {
        let mut open: Vec<usize> = roots.iter().rev().copied().collect();
        while let Some(node) = open.pop() {
            self.position[node] = Some(self.nodes.len());
            self.nodes.push(node);
            open.extend(root.nodes[node].children.iter().rev());
        }
    }
}

/// A node's local transform.
pub(super) fn local(path: &Path, index: usize, node: &raw::Node) -> Result<Local, Error> {
    if let Some(matrix) = &node.matrix {
        let matrix = Matrix4::from_column_slice(matrix.as_slice());
        return Affine::from_matrix(&matrix).map(Local::Matrix).ok_or_else(|| {
            Error::invalid(
                path,
                format!("nodes[{index}].matrix"),
                "expected finite numbers and a last row of 0, 0, 0, 1, found others",
            )
        });
    }
    let check = |what: &str, values: &[f64]| {
        // Beyond f32's range nothing can be drawn.
        if values.iter().all(|v| v.abs() <= f64::from(f32::MAX)) {
            return Ok(());
        }
        Err(Error::invalid(
            path,
            format!("nodes[{index}].{what}"),
            format!("expected finite numbers, found {values:?}"),
        ))
    };
    let translation = node.translation.unwrap_or([0.0; 3]);
    let scale = node.scale.unwrap_or([1.0; 3]);
    let [x, y, z, w] = node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
    check("translation", &translation)?;
    check("scale", &scale)?;
    check("rotation", &[x, y, z, w])?;
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-12).ok_or_else(|| {
        Error::invalid(
            path,
            format!("nodes[{index}].rotation"),
            format!("expected a unit quaternion, found {:?}", [x, y, z, w]),
        )
    })?;
    Ok(Local::Trs(Trs { translation: Vector3::from(translation), rotation, scale: Vector3::from(scale) }))
}
