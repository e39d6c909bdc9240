#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod report;

pub use report::{Listed, PipelineReport, Report};

use vergence_action::{ActionSet, POINT_AND_GRASP};
use vergence_scene::{Needs, Scene};

/// What the caller wants beyond what the scene shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Requests {
    /// Whether normal maps are drawn (a quality knob).
    pub normal_maps: bool,
    /// The joints of both hands are wanted, as a stream.
    pub hand_joints: bool,
    /// Where the user looks is wanted, as a stream.
    pub eye_gaze: bool,
    /// What the hands do is wanted, also where nothing can be touched.
    pub hands: bool,
}

impl Default for Requests {
    /// Normal maps, no further streams.
    fn default() -> Self {
        Self { normal_maps: true, hand_joints: false, eye_gaze: false, hands: false }
    }
}

/// What a scene requires.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Plan {
    /// What the renderer creates: pipelines, images, skinning, text.
    pub needs: Needs,
    /// What the GPU does every frame, in order.
    pub passes: Vec<Pass>,
    /// What the OpenXR runtime is asked for.
    pub extensions: Vec<Extension>,
    /// What the user can do; empty where nothing can be touched.
    pub actions: ActionSet,
    /// What is read every frame.
    pub streams: Vec<Stream>,
}

/// Something the GPU does every frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Pass {
    /// Moves vertices by joints, once for all views.
    Skin,
    /// Draws surfaces and texts, all views at once.
    Draw,
}

impl Pass {
    /// As GPU times are reported.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Skin => "skinning",
            Self::Draw => "surfaces",
        }
    }

    /// What requires it.
    pub const fn why(self) -> &'static str {
        match self {
            Self::Skin => "joints move vertices",
            Self::Draw => "something is visible",
        }
    }
}

/// An OpenXR extension that is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Extension {
    /// Its registered name.
    pub name: &'static str,
    /// Nothing works without it; else it is used where it is offered.
    pub required: bool,
    /// What requires it.
    pub why: &'static str,
}

/// Something that is read every frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stream {
    /// Where the head is.
    Head,
    /// Where each eye is and what it sees.
    Eyes,
    /// Where the hands are and what they do: the actions of the plan.
    Hands,
    /// The joints of both hands.
    HandJoints,
    /// Where the user looks.
    Gaze,
}

impl Stream {
    /// One word for logs.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Head => "head",
            Self::Eyes => "eyes",
            Self::Hands => "hands",
            Self::HandJoints => "hand-joints",
            Self::Gaze => "gaze",
        }
    }

    /// What requires it.
    pub const fn why(self) -> &'static str {
        match self {
            Self::Head | Self::Eyes => "pictures are drawn from there",
            Self::Hands => "something can be touched",
            Self::HandJoints | Self::Gaze => "asked for",
        }
    }
}

/// Vulkan through OpenXR: without it there is no session.
pub const VULKAN: Extension =
    Extension { name: "XR_KHR_vulkan_enable2", required: true, why: "pictures are drawn with Vulkan" };

const fn where_offered(name: &'static str, why: &'static str) -> Extension {
    Extension { name, required: false, why }
}

impl Plan {
    /// What `scene` requires, and what the caller wants beyond. O(nodes + primitives).
    pub fn of(scene: &Scene, requests: &Requests) -> Self {
        let needs = Needs::of(scene, requests.normal_maps);
        let draws = !needs.surfaces.is_empty() || needs.text;
        let touchable = requests.hands || !scene.touchables.is_empty();
        let mut plan = Self { needs, ..Self::default() };

        if plan.needs.skinning {
            plan.passes.push(Pass::Skin);
        }
        if draws {
            plan.passes.push(Pass::Draw);
        }

        plan.extensions.push(VULKAN);
        if draws {
            plan.extensions.extend([
                where_offered(
                    "XR_KHR_composition_layer_depth",
                    "the runtime corrects late pictures by depth",
                ),
                where_offered("XR_KHR_visibility_mask", "pixels that the lenses hide are not drawn"),
            ]);
        }
        plan.extensions.extend([
            where_offered(
                "XR_KHR_convert_timespec_time",
                "predicted times are checked against the runtime's clock",
            ),
            where_offered("XR_EXT_local_floor", "the user stands on the scene's floor"),
            where_offered("XR_FB_display_refresh_rate", "the display's rate is chosen and reported"),
        ]);
        if touchable {
            plan.actions =
                ActionSet { name: "touch", label: "Point and grasp", actions: POINT_AND_GRASP.to_vec() };
            plan.extensions.push(where_offered("XR_EXT_hand_interaction", "bare hands point and grasp, too"));
        }
        if requests.hand_joints {
            plan.extensions
                .push(where_offered("XR_EXT_hand_tracking", "the joints of the hands are asked for"));
        }
        if requests.eye_gaze {
            plan.extensions
                .push(where_offered("XR_EXT_eye_gaze_interaction", "the direction of gaze is asked for"));
        }

        plan.streams.extend([Stream::Head, Stream::Eyes]);
        plan.streams.extend(touchable.then_some(Stream::Hands));
        plan.streams.extend(requests.hand_joints.then_some(Stream::HandJoints));
        plan.streams.extend(requests.eye_gaze.then_some(Stream::Gaze));
        plan
    }

    /// Whether a stream is in the plan.
    pub fn has_stream(&self, stream: Stream) -> bool {
        self.streams.contains(&stream)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_scene::model::{Local, Material, Mesh, Node, Primitive, Touchable};

    fn node(mesh: Option<usize>) -> Node {
        Node {
            name: String::new(),
            parent: None,
            parent_from_node: Local::Matrix(vergence_geom::Affine::identity()),
            mesh,
            skin: None,
            light: None,
            camera: None,
            label: None,
        }
    }

    fn triangle() -> Scene {
        Scene {
            nodes: vec![node(Some(0))],
            meshes: vec![Mesh {
                name: String::new(),
                primitives: vec![Primitive {
                    positions: vec![[0.0; 3]; 3],
                    normals: vec![[0.0, 0.0, 1.0]; 3],
                    indices: vec![0, 1, 2],
                    ..Primitive::default()
                }],
            }],
            materials: vec![Material::default()],
            ..Scene::default()
        }
    }

    fn names(plan: &Plan) -> Vec<&'static str> {
        plan.extensions.iter().map(|e| e.name).collect()
    }

    #[test]
    fn what_is_not_required_is_not_planned() {
        let plan = Plan::of(&triangle(), &Requests::default());
        assert_eq!(plan.passes, [Pass::Draw]);
        assert!(plan.actions.actions.is_empty() && !plan.has_stream(Stream::Hands));
        for absent in ["XR_EXT_hand_interaction", "XR_EXT_hand_tracking", "XR_EXT_eye_gaze_interaction"] {
            assert!(!names(&plan).contains(&absent), "{absent}");
        }
    }

    #[test]
    fn touch_brings_actions_and_nothing_else_does() {
        let mut scene = triangle();
        scene.touchables.push(Touchable { name: "it".into(), node: 0 });
        let plan = Plan::of(&scene, &Requests::default());
        assert_eq!(plan.actions.actions, POINT_AND_GRASP);
        assert!(names(&plan).contains(&"XR_EXT_hand_interaction") && plan.has_stream(Stream::Hands));
    }

    #[test]
    fn streams_that_are_asked_for_are_opened() {
        let requests = Requests { hand_joints: true, eye_gaze: true, ..Requests::default() };
        let plan = Plan::of(&triangle(), &requests);
        assert!(names(&plan).contains(&"XR_EXT_hand_tracking") && plan.has_stream(Stream::HandJoints));
        assert!(names(&plan).contains(&"XR_EXT_eye_gaze_interaction") && plan.has_stream(Stream::Gaze));
    }

    #[test]
    fn nothing_to_see_needs_no_depth() {
        let plan = Plan::of(&Scene::default(), &Requests::default());
        assert!(!names(&plan).contains(&"XR_KHR_composition_layer_depth"));
        assert!(names(&plan).contains(&VULKAN.name));
    }
}
