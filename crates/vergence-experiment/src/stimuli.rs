//! What the participant sees: targets, cursor and words, as nodes of a scene.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use vergence_geom::{Affine, Rigid};
use vergence_scene::Scene;
use vergence_scene::model::{Label, Local, Material, Mesh, Node, Primitive, Shading};
use vergence_scene::shapes;
use vergence_study::{Geometry, Point, Study, Target};

use crate::course::{Course, Showing};

/// Colours, linear light: apart for colour-blind people too, in hue and in brightness (after Okabe and Ito).
const IDLE: [f32; 4] = [0.16, 0.17, 0.19, 1.0];
const GOAL: [f32; 4] = [0.79, 0.35, 0.0, 1.0];
const START: [f32; 4] = [0.09, 0.46, 0.81, 1.0];
const CURSOR: [f32; 4] = [0.9, 0.9, 0.9, 1.0];
const FLOOR: [f32; 4] = [0.03, 0.035, 0.04, 1.0];
/// Diameter of the cursor's ball, and thickness of its ray, metres.
const CURSOR_M: f64 = 0.008;
const RAY_M: f64 = 0.003;
/// Height and thickness of bars, metres.
const BAR_M: [f64; 2] = [0.15, 0.004];
/// Characters of a line of text.
const LINE: usize = 42;

/// Where words stand, and how large they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Words {
    /// Middle, in task coordinates, metres.
    pub(crate) at: Point,
    /// Height of a capital letter, metres.
    pub(crate) cap_height_m: f32,
}

/// A scene with everything that a study ever shows.
#[derive(Clone, Debug)]
pub(crate) struct Stimuli {
    scene: Arc<Scene>,
    geometry: Geometry,
    flat: bool,
    words_at: Point,
    /// Nodes: all targets, the goal, the same as a start, cursor, ray, then the words.
    targets: usize,
    goal: usize,
    start: usize,
    cursor: usize,
    ray: usize,
    words: usize,
    texts: usize,
    /// Combinations of the other factors, in the order of their words.
    cells: Vec<BTreeMap<String, String>>,
}

impl Stimuli {
    /// Of a study, on a screen (`flat`) or in space; `how` says what selects ("Pull the trigger").
    pub(crate) fn new(study: &Study, flat: bool, how: &str, words: Words) -> Self {
        let mut scene = Scene {
            name: study.name.clone(),
            background: if flat { [0.012, 0.014, 0.016] } else { [0.02, 0.025, 0.03] },
            ambient: [0.9; 3],
            world_from_start: Some(Rigid::identity()),
            ..Scene::default()
        };
        for (name, color) in
            [("target", IDLE), ("goal", GOAL), ("start", START), ("cursor", CURSOR), ("floor", FLOOR)]
        {
            let shading = if flat {
                Shading::Unlit
            } else {
                Shading::MetallicRoughness { metallic: 0.0, roughness: 0.6, texture: None, ior: 1.5 }
            };
            scene.materials.push(Material {
                name: name.into(),
                shading,
                base_color: color,
                ..Material::default()
            });
        }
        let unit = |material: usize| match (study.geometry, flat) {
            (Geometry::Reciprocal | Geometry::Steering | Geometry::Edge | Geometry::Corner, _) => {
                Primitive { material, ..shapes::cuboid([1.0; 3]) }
            }
            (_, true) => upright(Primitive { material, ..shapes::cylinder(0.5, 0.001, 64) }),
            (_, false) => Primitive { material, ..shapes::sphere(0.5, 20) },
        };
        let add = |scene: &mut Scene, name: &str, primitive: Primitive| {
            scene.meshes.push(Mesh { name: name.into(), primitives: vec![primitive] });
            let mesh = Some(scene.meshes.len() - 1);
            scene.nodes.push(Node { mesh, ..Node::at(name, hidden()) });
            scene.nodes.len() - 1
        };
        let count = match study.geometry {
            Geometry::Ring { targets, .. } | Geometry::Ray { targets, .. } => targets as usize,
            Geometry::Reciprocal
            | Geometry::Depth
            | Geometry::Steering
            | Geometry::Edge
            | Geometry::Corner => 2,
        };
        let targets = add(&mut scene, "target", unit(0));
        let mesh = scene.nodes[targets].mesh;
        for _ in 1..count {
            scene.nodes.push(Node { mesh, ..Node::at("target", hidden()) });
        }
        let goal = add(&mut scene, "goal", unit(1));
        let start = add(&mut scene, "start", unit(2));
        let cursor = add(&mut scene, "cursor", Primitive { material: 3, ..shapes::sphere(0.5, 12) });
        let ray = add(&mut scene, "ray", Primitive { material: 3, ..shapes::cuboid([1.0; 3]) });
        let begin = format!("{how} on the blue target to begin.");
        // One for each combination of the other factors' levels, too: who takes part is told which one comes.
        let cells = study.cells();
        let told = |cell: &BTreeMap<String, String>| {
            cell.iter().map(|(name, level)| format!("{name}: {level}\n")).collect::<String>()
        };
        let texts = study
            .instructions
            .iter()
            .flat_map(|one| {
                let text = wrapped(&one.text);
                cells.iter().map(|cell| format!("{text}\n{}\n{begin}", told(cell))).collect::<Vec<_>>()
            })
            .chain(["Have a rest.\nIt goes on by itself.".to_owned(), "That was all. Thank you!".to_owned()]);
        let words_node = scene.nodes.len();
        for text in texts {
            let label = Label {
                text,
                cap_height_m: words.cap_height_m,
                color: [0.85, 0.85, 0.85, 1.0],
                billboard: false,
            };
            scene.labels.push(label);
            let label = Some(scene.labels.len() - 1);
            scene.nodes.push(Node { label, ..Node::at("words", hidden()) });
        }
        if !flat {
            // Something to stand on: without it, people sway.
            let floor = Primitive { material: 4, ..shapes::cuboid([6.0, 0.02, 6.0]) };
            let node = add(&mut scene, "floor", floor);
            scene.nodes[node].parent_from_node =
                Local::Matrix(Affine::from(Rigid::translation(0.0, -0.01, 0.0)));
            scene.add_directional([-0.5, 1.0, 0.8], 2.0);
        }
        Self {
            scene: Arc::new(scene),
            geometry: study.geometry,
            flat,
            words_at: words.at,
            targets,
            goal,
            start,
            cursor,
            ray,
            words: words_node,
            texts: study.instructions.len() * cells.len(),
            cells,
        }
    }

    /// The scene, on whose nodes [`Stimuli::show`] acts.
    pub(crate) fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Tells for each node where it is now; `None`: nowhere. `cursor` is in task coordinates, `world_from_aim` where a ray
    /// comes from, if there is one.
    pub(crate) fn show(
        &self,
        course: &Course,
        world_from_task: &Rigid,
        cursor: Option<Point>,
        world_from_aim: Option<&Rigid>,
        mut put: impl FnMut(usize, Option<&Affine>),
    ) {
        let goal = course.goal();
        let all = course.targets();
        for place in 0..self.goal - self.targets {
            let target = all.get(place).filter(|_| goal.is_some());
            let affine = target.and_then(|target| self.idle(world_from_task, target, place, all));
            put(self.targets + place, affine.as_ref());
        }
        let ahead = goal.map(|goal| {
            let target = Target { centre: goal.centre, width: goal.width };
            self.at(world_from_task, &target, 1.02)
        });
        let is_start = goal.is_some_and(|goal| goal.is_start);
        put(self.goal, ahead.as_ref().filter(|_| !is_start));
        put(self.start, ahead.as_ref().filter(|_| is_start));
        let ball =
            cursor.filter(|_| !self.flat).map(|at| placed(world_from_task, at, Vector3::repeat(CURSOR_M)));
        put(self.cursor, ball.as_ref());
        let beam = cursor.zip(world_from_aim).map(|(at, aim)| {
            let end = world_from_task * nalgebra::Point3::from(at);
            let length = (end.coords - aim.translation.vector).norm();
            let mut place = Affine::from(aim * Rigid::translation(0.0, 0.0, -0.5 * length));
            place.linear *= Matrix3::from_diagonal(&Vector3::new(RAY_M, RAY_M, length));
            place
        });
        put(self.ray, beam.as_ref());
        let shown = match course.showing() {
            Showing::Instruction(one) => {
                let told = course.study().instructions.iter().position(|own| own.name == one.name);
                let cell = course.factors().and_then(|own| self.cells.iter().position(|cell| cell == own));
                told.map(|told| told * self.cells.len() + cell.unwrap_or(0))
            }
            Showing::Movement => None,
            Showing::Break(_) => Some(self.texts),
            Showing::Done => Some(self.texts + 1),
        };
        let words = placed(world_from_task, self.words_at, Vector3::repeat(1.0));
        for node in 0..self.texts + 2 {
            put(self.words + node, Some(&words).filter(|_| shown == Some(node)));
        }
    }

    /// A target that is not the goal.
    fn idle(&self, world_from_task: &Rigid, target: &Target, place: usize, all: &[Target]) -> Option<Affine> {
        if self.geometry != Geometry::Steering {
            return Some(self.at(world_from_task, target, 1.0));
        }
        // The walls of the tunnel.
        let length = 2.0 * all.first()?.centre[0].abs();
        let side = if place == 0 { 0.5 } else { -0.5 };
        let at = [0.0, side * target.width?, 0.0];
        Some(placed(world_from_task, at, Vector3::new(length, 0.002, BAR_M[1])))
    }

    fn at(&self, world_from_task: &Rigid, target: &Target, larger: f64) -> Affine {
        let width = target.width.unwrap_or(BAR_M[1]);
        let (at, size) = match self.geometry {
            Geometry::Reciprocal => (target.centre, Vector3::new(width, BAR_M[0], BAR_M[1])),
            Geometry::Steering => (target.centre, Vector3::new(0.002, width, BAR_M[1])),
            Geometry::Edge => {
                let mut at = target.centre;
                at[0] += at[0].signum() * 0.5 * BAR_M[0];
                (at, Vector3::new(BAR_M[0], 3.0 * BAR_M[0], BAR_M[1]))
            }
            Geometry::Corner => {
                let mut at = target.centre;
                at.iter_mut().take(2).for_each(|at| *at += at.signum() * 0.5 * BAR_M[0]);
                (at, Vector3::new(BAR_M[0], BAR_M[0], BAR_M[1]))
            }
            Geometry::Ray { distance, .. } => {
                (target.centre, Vector3::repeat(2.0 * distance * (0.5 * width).tan()))
            }
            Geometry::Ring { .. } | Geometry::Depth => (target.centre, Vector3::repeat(width)),
        };
        // In front of the targets that stand at the same place.
        placed(
            world_from_task,
            at,
            if self.flat { Vector3::new(size.x, size.y, size.z * 4.0 * larger) } else { size * larger },
        )
    }
}

/// Not yet anywhere: what is not put is not shown.
fn hidden() -> Local {
    Local::Matrix(Affine::from(Rigid::identity()))
}

fn placed(world_from_task: &Rigid, at: Point, size: Vector3<f64>) -> Affine {
    let [x, y, z] = at;
    let mut place = Affine::from(world_from_task * Rigid::translation(x, y, z));
    place.linear *= Matrix3::from_diagonal(&size);
    place
}

/// A cylinder turned so that its end faces +z.
fn upright(mut primitive: Primitive) -> Primitive {
    let turned = |[x, y, z]: [f32; 3]| [x, -z, y];
    primitive.positions.iter_mut().for_each(|p| *p = turned(*p));
    primitive.normals.iter_mut().for_each(|n| *n = turned(*n));
    primitive
}

/// Lines of about the same length.
fn wrapped(text: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut().filter(|line| line.chars().count() + word.chars().count() < LINE) {
            Some(line) => {
                line.push(' ');
                line.push_str(word);
            }
            None => lines.push(word.to_owned()),
        }
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_study::TEMPLATE;

    #[test]
    fn each_node_is_told_and_the_goal_is_one() {
        let study = Study::parse("t".as_ref(), TEMPLATE).unwrap();
        let course = Course::new(&study, "P01");
        let words = Words { at: [0.0, 0.3, 0.0], cap_height_m: 0.02 };
        for flat in [false, true] {
            let stimuli = Stimuli::new(&study, flat, "Click", words);
            let mut shown = vec![None; stimuli.scene().nodes.len()];
            let world_from_task = Rigid::translation(0.0, 1.4, -0.6);
            stimuli.show(&course, &world_from_task, Some([0.0; 3]), None, |node, at| {
                shown[node] = Some(at.copied())
            });
            let told = shown.iter().filter(|node| node.is_some()).count();
            assert_eq!(told, 15 + 4 + 5);
            let visible = shown.iter().flatten().flatten().count();
            // 15 targets, the start, words, and in space the cursor.
            assert_eq!(visible, 15 + 1 + 1 + usize::from(!flat));
            let start = shown[stimuli.start].flatten().unwrap();
            let goal = course.goal().unwrap();
            assert!(
                (start.translation - Vector3::from(goal.centre) - Vector3::new(0.0, 1.4, -0.6)).norm()
                    < 1e-12
            );
            assert!((start.linear[(0, 0)] / goal.width.unwrap() - 1.0).abs() < 0.03);
        }
    }

    #[test]
    fn lines_are_wrapped() {
        let text = wrapped("Be as fast as you can, even if you miss. And then be faster still.");
        assert!(text.lines().all(|line| line.len() <= LINE) && text.lines().count() == 2, "{text}");
        assert_eq!(wrapped(""), "");
    }
}
