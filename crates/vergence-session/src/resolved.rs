//! The resolved configuration of a session, as its log keeps it: what a replay needs to be the same session.

use nalgebra::{Point2, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use vergence_geom::{Fov, Rigid, components};
use vergence_render::Quality;
use vergence_xr::HEARD_CALLS;
use vergence_xr_sim::Profile;
use vergence_xr_sim::headset::Eye;

use crate::config::RunConfig;

/// Everything that decides what a session is like, as JSON in the log's header. Numbers read back exactly.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Resolved {
    pub(crate) simulated: bool,
    pub(crate) real_time: bool,
    /// The simulated headset; of another one, what it says of its pictures.
    pub(crate) profile: ProfileRecord,
    pub(crate) motion: Option<String>,
    pub(crate) frames: Option<u64>,
    pub(crate) seconds: Option<f64>,
    pub(crate) retries: u32,
    pub(crate) quality: QualityRecord,
    /// Hands were asked for, and the runtime offered them; the simulated headset has them.
    pub(crate) hand_joints: bool,
    /// As for hands.
    pub(crate) eye_gaze: bool,
    pub(crate) refresh_rate_hz: Option<f32>,
    /// Names of the actions, in their places.
    pub(crate) actions: Vec<String>,
    pub(crate) hash_frames: bool,
    /// Calls that failed are in the recording; in those of earlier versions they are not.
    #[serde(default)]
    pub(crate) has_results: bool,
    /// What the simulated headset did wrong while sessions were made, which the recording does not hear: faults as text.
    #[serde(default)]
    pub(crate) faults: Vec<String>,
    /// What another runtime lacked; the simulated headset lacks nothing of it.
    #[serde(default)]
    pub(crate) without_clock: bool,
    /// As above.
    #[serde(default)]
    pub(crate) without_floor: bool,
    /// Views of a frame.
    #[serde(default = "two")]
    pub(crate) views: u32,
    /// What the vergence that recorded was built from.
    pub(crate) build: String,
}

const fn two() -> u32 {
    2
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct QualityRecord {
    msaa: u32,
    anisotropy: Option<f32>,
    render_scale: f64,
    normal_maps: bool,
    near_m: f64,
    cull_margin_m: f64,
    cull_margin_rad: f64,
    timestamps: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ProfileRecord {
    name: String,
    resolution: (u32, u32),
    rates_hz: Vec<f64>,
    ipd_m: f64,
    controllers: String,
    /// Recordings of earlier versions had no hands and no gaze to see.
    #[serde(default)]
    hands: bool,
    #[serde(default)]
    gaze: bool,
    eyes: [EyeRecord; 2],
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct EyeRecord {
    /// x y z qx qy qz qw, metres, in the head's frame.
    head_from_eye: [f64; 7],
    /// Left, right, up, down, radians.
    fov_rad: [f64; 4],
    visible: Vec<[f64; 2]>,
}

impl From<&Quality> for QualityRecord {
    fn from(quality: &Quality) -> Self {
        let Quality {
            msaa,
            anisotropy,
            render_scale,
            normal_maps,
            near_m,
            cull_margin_m,
            cull_margin_rad,
            timestamps,
        } = *quality;
        Self {
            msaa,
            anisotropy,
            render_scale,
            normal_maps,
            near_m,
            cull_margin_m,
            cull_margin_rad,
            timestamps,
        }
    }
}

impl QualityRecord {
    pub(crate) fn quality(&self) -> Quality {
        Quality {
            msaa: self.msaa,
            anisotropy: self.anisotropy,
            render_scale: self.render_scale,
            normal_maps: self.normal_maps,
            near_m: self.near_m,
            cull_margin_m: self.cull_margin_m,
            cull_margin_rad: self.cull_margin_rad,
            timestamps: self.timestamps,
        }
    }
}

impl From<&Profile> for ProfileRecord {
    fn from(profile: &Profile) -> Self {
        let eye = |eye: &Eye| EyeRecord {
            head_from_eye: components(&eye.head_from_eye),
            fov_rad: [eye.fov.left_rad, eye.fov.right_rad, eye.fov.up_rad, eye.fov.down_rad],
            visible: eye.visible.iter().map(|point| [point.x, point.y]).collect(),
        };
        Self {
            name: profile.name.clone(),
            resolution: profile.resolution,
            rates_hz: profile.rates_hz.clone(),
            ipd_m: profile.ipd_m,
            controllers: profile.controllers.clone(),
            hands: profile.hands,
            gaze: profile.gaze,
            eyes: profile.eyes.each_ref().map(eye),
        }
    }
}

impl ProfileRecord {
    pub(crate) fn profile(&self) -> Profile {
        let eye = |eye: &EyeRecord| {
            let [x, y, z, i, j, k, w] = eye.head_from_eye;
            let [left_rad, right_rad, up_rad, down_rad] = eye.fov_rad;
            Eye {
                head_from_eye: Rigid::from_parts(
                    Translation3::new(x, y, z),
                    // As it was, to the last bit.
                    UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k)),
                ),
                fov: Fov { left_rad, right_rad, up_rad, down_rad },
                visible: eye.visible.iter().map(|&[x, y]| Point2::new(x, y)).collect(),
            }
        };
        Profile {
            name: self.name.clone(),
            resolution: self.resolution,
            rates_hz: self.rates_hz.clone(),
            ipd_m: self.ipd_m,
            controllers: self.controllers.clone(),
            hands: self.hands,
            gaze: self.gaze,
            eyes: self.eyes.each_ref().map(eye),
        }
    }
}

impl Resolved {
    pub(crate) fn of(config: &RunConfig, profile: &Profile, simulated: bool, actions: Vec<String>) -> Self {
        Self {
            simulated,
            real_time: config.real_time || config.window,
            profile: profile.into(),
            motion: config.motion.clone(),
            frames: config.frames,
            seconds: config.seconds,
            retries: config.retries,
            quality: (&config.quality).into(),
            hand_joints: config.hand_joints,
            eye_gaze: config.eye_gaze,
            refresh_rate_hz: config.refresh_rate_hz,
            actions,
            hash_frames: false,
            has_results: true,
            without_clock: false,
            without_floor: false,
            views: 2,
            faults: config
                .faults
                .faults()
                .iter()
                .filter(|fault| !HEARD_CALLS.contains(&fault.entry_point()))
                .map(ToString::to_string)
                .collect(),
            build: String::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_reads_back_exactly() {
        for name in ["default", "quest3", "index"] {
            let profile = Profile::open(name).unwrap().with_ipd(0.0631);
            let mut resolved = Resolved::of(&RunConfig::default(), &profile, true, vec!["aim".into()]);
            resolved.quality = (&Quality { render_scale: 1.0 / 3.0, ..Quality::default() }).into();
            let text = serde_json::to_string(&resolved).unwrap();
            let read: Resolved = serde_json::from_str(&text).unwrap();
            assert_eq!(read, resolved);
            assert_eq!(read.profile.profile(), profile);
            assert_eq!(read.quality.quality().render_scale, 1.0 / 3.0);
        }
    }
}
