//! The joints of a hand from where its palm is and how far each finger is curled.

use nalgebra::{Translation3, Vector3};
use vergence_geom::{Rigid, interpolate};
use vergence_sense::{Hand, JOINTS_PER_HAND};

use super::{Controller, Tracked};

/// A hand that is seen: its joints in the order of [`HandJoint`](vergence_sense::HandJoint).
#[derive(Clone, Debug, PartialEq)]
pub struct HandPose {
    /// Measured now; otherwise what was known last, or a guess.
    pub is_tracked: bool,
    /// Joint coordinates to stage coordinates, with −z along the bone to the tip and y out of the back of the hand, and the
    /// distance of the skin from the joint, metres.
    pub joints: [(Rigid, f64); JOINTS_PER_HAND],
}

impl HandPose {
    /// Each joint on the straight way to where it is in `other`.
    pub(crate) fn between(&self, other: &Self, t: f64) -> Self {
        let mut mixed = self.clone();
        for ((pose, radius_m), (to, to_m)) in mixed.joints.iter_mut().zip(&other.joints) {
            *pose = interpolate(pose, to, t);
            *radius_m += (to_m - *radius_m) * t;
        }
        mixed
    }

    /// A hand of [`BONES_MM`] around its palm; `curls` is each finger's, thumb to little finger, 0 straight to 1 closed.
    /// `None` where nothing is known of the palm.
    pub fn around(stage_from_palm: &Tracked, hand: Hand, curls: [f64; 5]) -> Option<Self> {
        let is_tracked = matches!(stage_from_palm, Tracked::Seen(_));
        let stage_from_palm = stage_from_palm.pose()?;
        // To the thumb's side: to the left of a right hand whose back is up.
        let inward = match hand {
            Hand::Left => 1.0,
            Hand::Right => -1.0,
        };
        let palm = (stage_from_palm, PALM_RADIUS_M);
        let wrist = stage_from_palm * Rigid::translation(0.0, 0.0, WRIST_M);
        let mut joints = [palm; JOINTS_PER_HAND];
        joints[1] = (wrist, WRIST_RADIUS_M);
        let mut place = 2;
        for (finger, (bones, curl)) in BONES_MM.iter().zip(curls).enumerate() {
            let curl = curl.clamp(0.0, 1.0);
            let [x, y, z] = ROOTS_M[finger];
            let spread = Vector3::y() * (-inward * SPREAD_RAD[finger]);
            let mut joint = wrist
                * Rigid::new(Vector3::new(inward * x, y, z), spread)
                // A thumb lies across the palm: its nail looks to the side.
                * if finger == 0 { Rigid::rotation(Vector3::z() * (inward * THUMB_ROLL_RAD)) } else { Rigid::identity() };
            joints[place] = (joint, RADII_M[finger]);
            place += 1;
            let flexions = if finger == 0 { THUMB_FLEXION_RAD } else { FLEXION_RAD };
            for (bone, &millimetres) in bones.iter().enumerate() {
                joint *= Translation3::new(0.0, 0.0, -millimetres * 1e-3);
                if let Some(flexion) = flexions.get(bone).filter(|_| bone + 1 < bones.len()) {
                    joint *= Rigid::rotation(Vector3::x() * (-flexion * curl)).rotation;
                }
                // Fingers grow thinner to their tips.
                joints[place] = (joint, RADII_M[finger] * (1.0 - 0.12 * (bone + 1) as f64));
                place += 1;
            }
        }
        Some(Self { is_tracked, joints })
    }

    /// The hand that holds a controller; `None` where there is none, or nothing is known of it.
    pub(crate) fn holding(controller: &Controller, hand: Hand) -> Option<Self> {
        if !controller.connected {
            return None;
        }
        let (trigger, squeeze) = (f64::from(controller.trigger), f64::from(controller.squeeze));
        let fist = 0.6 + 0.3 * squeeze;
        let stage_from_palm = controller.grip.map(|stage_from_grip| stage_from_grip * grip_from_palm(hand));
        Self::around(&stage_from_palm, hand, [0.3 + 0.3 * squeeze, 0.3 + 0.5 * trigger, fist, fist, fist])
    }
}

/// The "grip" pose of OpenXR from its palm joint: the grip's x comes out of a left palm and goes into a right one, its −z
/// points from the little finger to the thumb of the closed hand.
pub(super) fn grip_from_palm(hand: Hand) -> Rigid {
    let [back, right] = match hand {
        Hand::Left => [-Vector3::x(), -Vector3::z()],
        Hand::Right => [Vector3::x(), Vector3::z()],
    };
    let axes = nalgebra::Matrix3::from_columns(&[right, back, Vector3::y()]);
    let turn = nalgebra::Rotation3::from_matrix_unchecked(axes);
    Rigid::from_parts(Translation3::identity(), nalgebra::UnitQuaternion::from_rotation_matrix(&turn))
}

/// Bones from the first joint of a finger to its tip, the thumb first, millimetres: mean lengths of adults after Buryanov and
/// Kotiuk, "Proportions of Hand Segments" (Int. J. Morphol. 28(3), 2010); the last with the soft tissue of the tip.
pub const BONES_MM: [&[f64]; 5] = [
    &[46.2, 31.6, 27.3],
    &[68.1, 39.8, 22.4, 19.7],
    &[64.6, 44.6, 26.3, 21.4],
    &[58.0, 41.4, 25.7, 21.3],
    &[53.7, 32.7, 18.1, 19.7],
];

// What those tables lack: round numbers for a hand that looks like one.
/// Where the metacarpals begin, from the wrist: to the thumb's side, up, back; metres.
const ROOTS_M: [[f64; 3]; 5] = [
    [0.022, -0.012, -0.014],
    [0.016, 0.0, -0.030],
    [0.003, 0.002, -0.032],
    [-0.010, 0.0, -0.031],
    [-0.021, -0.003, -0.028],
];
/// How far each finger points to the thumb's side, radians.
const SPREAD_RAD: [f64; 5] = [0.70, 0.10, 0.0, -0.10, -0.20];
const THUMB_ROLL_RAD: f64 = 1.0;
/// How far the joints of a closed finger are bent, from the knuckle on, radians.
const FLEXION_RAD: [f64; 3] = [1.4, 1.7, 1.1];
const THUMB_FLEXION_RAD: [f64; 3] = [0.8, 1.2, 0.0];
const RADII_M: [f64; 5] = [0.013, 0.012, 0.012, 0.011, 0.010];
const PALM_RADIUS_M: f64 = 0.016;
const WRIST_RADIUS_M: f64 = 0.025;
/// From the palm joint, the middle of the middle finger's metacarpal, back to the wrist, metres.
const WRIST_M: f64 = 0.032 + 0.5 * 0.0646;

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_sense::HandJoint as J;

    fn at(hand: &HandPose, joint: J) -> Vector3<f64> {
        hand.joints[joint as usize].0.translation.vector
    }

    #[test]
    fn bones_keep_their_lengths_however_a_hand_is_curled() {
        for curl in [0.0, 0.3, 1.0] {
            let hand = HandPose::around(&Tracked::Seen(Rigid::identity()), Hand::Right, [curl; 5]).unwrap();
            let mut first = 2;
            for bones in BONES_MM {
                for (bone, millimetres) in bones.iter().enumerate() {
                    let [a, b] =
                        [first + bone, first + bone + 1].map(|at| hand.joints[at].0.translation.vector);
                    assert!(((b - a).norm() - millimetres * 1e-3).abs() < 1e-12, "{curl} {first} {bone}");
                }
                first += bones.len() + 1;
            }
            assert_eq!(first, JOINTS_PER_HAND);
        }
    }

    #[test]
    fn a_flat_hand_points_ahead_and_a_closed_one_bends_to_its_palm() {
        let palm = Tracked::Seen(Rigid::identity());
        let flat = HandPose::around(&palm, Hand::Right, [0.0; 5]).unwrap();
        assert_eq!(at(&flat, J::Palm), Vector3::zeros());
        assert!(at(&flat, J::Wrist).z > 0.05 && at(&flat, J::MiddleTip).z < -0.1);
        // The back of the hand is up: a right hand's thumb is to the left.
        assert!(at(&flat, J::ThumbTip).x < -0.03 && at(&flat, J::LittleTip).x > 0.02);
        let left = HandPose::around(&palm, Hand::Left, [0.0; 5]).unwrap();
        for ((right, _), (left, _)) in flat.joints.iter().zip(&left.joints) {
            let [r, l] = [right.translation.vector, left.translation.vector];
            assert!((r - Vector3::new(-l.x, l.y, l.z)).norm() < 1e-12, "hands are mirror images");
        }
        let fist = HandPose::around(&palm, Hand::Right, [1.0; 5]).unwrap();
        assert!(at(&fist, J::MiddleTip).y < -0.02, "{}", at(&fist, J::MiddleTip));
        assert!(at(&fist, J::MiddleTip).z > at(&flat, J::MiddleProximal).z - 0.03);
        // What is behind a hand's own limits is at them.
        assert_eq!(HandPose::around(&palm, Hand::Right, [7.0; 5]).unwrap(), fist);
        assert_eq!(HandPose::around(&Tracked::Lost, Hand::Right, [0.0; 5]), None);
    }

    /// "+X: the normal of the palm, away from a left one, into a right one; −Z: from the little finger to the thumb."
    #[test]
    fn the_hand_lies_around_the_grip() {
        for (hand, side) in [(Hand::Left, 1.0), (Hand::Right, -1.0)] {
            let controller = Controller::idle(Tracked::Seen(Rigid::identity()), Tracked::Lost);
            let held = HandPose::holding(&controller, hand).unwrap();
            let (palm, _) = held.joints[J::Palm as usize];
            assert!(
                (palm.rotation * Vector3::y() - Vector3::x() * -side).norm() < 1e-12,
                "{hand:?}: its back"
            );
            let across = at(&held, J::IndexProximal) - at(&held, J::LittleProximal);
            assert!(across.z < -0.03, "{hand:?}: {across}");
            assert!((palm.rotation.coords.norm() - 1.0).abs() < 1e-12);
        }
        assert_eq!(HandPose::holding(&Controller::absent(), Hand::Left), None);
    }
}
