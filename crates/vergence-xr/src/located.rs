//! Where the eyes are.

use openxr::{Fovf, Posef, ViewStateFlags, sys};
use vergence_geom::{Rigid, View};
use vergence_sense::{Pose, Said, Tracking};
use vergence_stream::{How, PoseHistory};
use vergence_time::Timestamp;

use crate::convert;
use crate::error::Error;
use crate::tap::{Call, Ear, raw_views};

/// The eyes of one instant, in LOCAL space, together with what the runtime said, bit for bit.
#[derive(Clone, Copy, Debug)]
pub struct Located {
    raw: [(Posef, Fovf); Self::MOST_VIEWS],
    views: [View; Self::MOST_VIEWS],
    count: usize,
    /// Trust in the positions.
    pub position_tracking: Tracking,
    /// Trust in the orientations.
    pub orientation_tracking: Tracking,
}

impl Located {
    /// Stereo.
    pub const MOST_VIEWS: usize = 2;

    /// One per eye; `world_from_eye` is LOCAL from eye here.
    pub fn views(&self) -> &[View] {
        &self.views[..self.count]
    }

    /// Exactly what the runtime said.
    pub(crate) fn raw(&self, view: usize) -> (Posef, Fovf) {
        self.raw[view]
    }

    /// What the runtime said of one eye: position, orientation (x y z w), and angles (left, right, up, down), as it said
    /// it, in single precision.
    pub fn as_said(&self, view: usize) -> Option<([f32; 7], [f32; 4])> {
        let (pose, fov) = self.raw.get(view).filter(|_| view < self.count)?;
        let (p, q) = (pose.position, pose.orientation);
        Some((
            [p.x, p.y, p.z, q.x, q.y, q.z, q.w],
            [fov.angle_left, fov.angle_right, fov.angle_up, fov.angle_down],
        ))
    }
}

/// Asks for the eyes, and remembers where they were when they were last known.
pub(crate) struct Viewpoints {
    count: usize,
    last: Option<Located>,
    /// What was said last were poses and fields of view, wherever it claimed to be.
    makes_sense: bool,
    /// Of the first eye, where somebody foretells.
    history: Option<PoseHistory>,
}

impl Viewpoints {
    pub(crate) fn new(count: u32) -> Self {
        Self {
            count: (count as usize).min(Located::MOST_VIEWS),
            last: None,
            makes_sense: true,
            history: None,
        }
    }

    /// Whether what the runtime said last were poses and fields of view, wherever it claimed that they are.
    pub(crate) const fn makes_sense(&self) -> bool {
        self.makes_sense
    }

    /// From now on, what the runtime does not know is asked of `history`.
    pub(crate) fn foretell(&mut self, history: PoseHistory) {
        self.history = Some(history);
    }

    /// The motion so far says nothing about what comes.
    pub(crate) fn forget_motion(&mut self) {
        if let Some(history) = &mut self.history {
            history.clear();
        }
    }

    pub(crate) fn locate(
        &mut self,
        session: &openxr::Session<openxr::Vulkan>,
        view_configuration_type: openxr::ViewConfigurationType,
        local: &openxr::Space,
        time: Timestamp,
        ear: &mut Ear,
    ) -> Result<Option<Located>, Error> {
        let info = sys::ViewLocateInfo {
            ty: sys::ViewLocateInfo::TYPE,
            next: std::ptr::null(),
            view_configuration_type,
            display_time: openxr::Time::from_nanos(time.as_nanos()),
            space: local.as_raw(),
        };
        let mut state = sys::ViewState {
            ty: sys::ViewState::TYPE,
            next: std::ptr::null_mut(),
            view_state_flags: ViewStateFlags::EMPTY,
        };
        let mut views = [sys::View {
            ty: sys::View::TYPE,
            next: std::ptr::null_mut(),
            pose: convert::IDENTITY,
            fov: Fovf::default(),
        }; Located::MOST_VIEWS];
        let mut count = 0;
        // SAFETY: the array has as many initialised elements as is said; everything lives through the call.
        let result = unsafe {
            (session.instance().fp().locate_views)(
                session.as_raw(),
                &info,
                &mut state,
                self.count as u32,
                &mut count,
                views.as_mut_ptr(),
            )
        };
        ear.check(Call::LocateViews, result)?;
        ear.hear(|| Said::Views {
            at: time,
            views: raw_views(state.view_state_flags, views.iter().take(self.count).map(|v| (v.pose, v.fov))),
        });
        Ok(self.accept(time, state.view_state_flags, views.map(|view| (view.pose, view.fov))))
    }

    /// What can be drawn with at `time`: what the runtime says where it may be read; else, while it lasts, what is foretold;
    /// else what was known last.
    fn accept(
        &mut self,
        time: Timestamp,
        flags: ViewStateFlags,
        mut raw: [(Posef, Fovf); Located::MOST_VIEWS],
    ) -> Option<Located> {
        let last = self.foretold(time).or(self.last);
        self.makes_sense = true;
        let mut position_tracking = Tracking::Measured;
        let mut orientation_tracking = Tracking::Measured;
        let still = View {
            world_from_eye: Rigid::identity(),
            fov: vergence_geom::Fov { left_rad: -0.7, right_rad: 0.7, up_rad: 0.7, down_rad: -0.7 },
        };
        let mut views = [still; Located::MOST_VIEWS];
        for (index, ((pose, fov), view)) in raw.iter_mut().zip(&mut views).take(self.count).enumerate() {
            let said = convert::view_pose(flags, pose);
            let is_said = |flag, found: Tracking| !flags.contains(flag) || found != Tracking::Lost;
            let is_seen = convert::fov(fov).is_some() || !flags.contains(ViewStateFlags::ORIENTATION_VALID);
            self.makes_sense &= is_seen
                && is_said(ViewStateFlags::POSITION_VALID, said.position_tracking)
                && is_said(ViewStateFlags::ORIENTATION_VALID, said.orientation_tracking);
            position_tracking = worse(position_tracking, said.position_tracking);
            orientation_tracking = worse(orientation_tracking, said.orientation_tracking);
            let known = last.map(|last| last.raw(index));
            if said.orientation_tracking == Tracking::Lost {
                pose.orientation = known?.0.orientation;
            }
            if said.position_tracking == Tracking::Lost {
                // Eyes that never had a place are drawn from the origin: better than nothing while only turning is known.
                pose.position = known.map_or(convert::IDENTITY.position, |(pose, _)| pose.position);
            }
            if convert::fov(fov).is_none() {
                *fov = known?.1;
            }
            let all = ViewStateFlags::POSITION_VALID | ViewStateFlags::ORIENTATION_VALID;
            view.world_from_eye = convert::view_pose(all, pose).reference_from_device()?;
            view.fov = convert::fov(fov)?;
        }
        let located = Located { raw, views, count: self.count, position_tracking, orientation_tracking };
        self.last = Some(located);
        if let (Some(history), Tracking::Measured, Tracking::Measured) =
            (&mut self.history, position_tracking, orientation_tracking)
        {
            history.push(time, Pose::tracked(views[0].world_from_eye), None);
        }
        Some(located)
    }

    /// The eyes as they were last known, moved as one to where the first of them is foretold to be at `time`.
    fn foretold(&self, time: Timestamp) -> Option<Located> {
        let mut last = self.last?;
        let answer = self.history.as_ref()?.at(time);
        let How::Predicted { .. } = answer.how else { return None };
        let moved = answer.pose.reference_from_device()? * last.views[0].world_from_eye.inverse();
        for ((pose, _), view) in last.raw.iter_mut().zip(&mut last.views) {
            view.world_from_eye = moved * view.world_from_eye;
            *pose = convert::said(&view.world_from_eye);
        }
        Some(last)
    }
}

fn worse(a: Tracking, b: Tracking) -> Tracking {
    match (a, b) {
        (Tracking::Lost, _) | (_, Tracking::Lost) => Tracking::Lost,
        (Tracking::Inferred, _) | (_, Tracking::Inferred) => Tracking::Inferred,
        _ => Tracking::Measured,
    }
}

/// The views of a frame in world coordinates.
pub fn in_world(world_from_local: &Rigid, located: &Located, views: &mut [View]) {
    for (view, local) in views.iter_mut().zip(located.views()) {
        *view = View { world_from_eye: world_from_local * local.world_from_eye, fov: local.fov };
    }
}

#[cfg(test)]
mod tests {
    use vergence_stream::Reach;
    use vergence_time::Span;

    use super::*;

    const FOV: Fovf = Fovf { angle_left: -0.9, angle_right: 0.7, angle_up: 0.8, angle_down: -0.8 };

    const NOW: Timestamp = Timestamp::from_nanos(0);

    fn all() -> ViewStateFlags {
        ViewStateFlags::POSITION_VALID
            | ViewStateFlags::ORIENTATION_VALID
            | ViewStateFlags::POSITION_TRACKED
            | ViewStateFlags::ORIENTATION_TRACKED
    }

    fn at(x: f32) -> Posef {
        Posef { position: openxr::Vector3f { x, y: 1.6, z: 0.0 }, ..convert::IDENTITY }
    }

    #[test]
    fn what_is_shown_is_what_the_runtime_said_bit_for_bit() {
        let mut viewpoints = Viewpoints::new(2);
        // Not of unit length: our own views are normalised, what is handed back is not touched.
        let tilted =
            Posef { orientation: openxr::Quaternionf { x: 0.0, y: 0.600_01, z: 0.0, w: 0.8 }, ..at(0.1) };
        let located = viewpoints.accept(NOW, all(), [(tilted, FOV), (at(0.2), FOV)]).unwrap();
        assert_eq!((located.raw(0), located.raw(1)), ((tilted, FOV), (at(0.2), FOV)));
        assert!((located.views()[0].world_from_eye.rotation.quaternion().norm() - 1.0).abs() < 1e-12);
        assert_eq!(located.views()[1].world_from_eye.translation.x, f64::from(0.2f32));
    }

    #[test]
    fn lost_eyes_stay_where_they_were() {
        let mut viewpoints = Viewpoints::new(2);
        let nonsense =
            Posef { position: openxr::Vector3f { x: f32::NAN, y: 0.0, z: 0.0 }, ..convert::IDENTITY };
        assert!(viewpoints.accept(NOW, ViewStateFlags::EMPTY, [(nonsense, FOV); 2]).is_none());
        viewpoints.accept(NOW, all(), [(at(-0.03), FOV), (at(0.03), FOV)]).unwrap();
        let lost = viewpoints.accept(NOW, ViewStateFlags::EMPTY, [(nonsense, Fovf::default()); 2]).unwrap();
        assert_eq!((lost.raw(0), lost.raw(1)), ((at(-0.03), FOV), (at(0.03), FOV)));
        assert_eq!(lost.position_tracking, Tracking::Lost);
    }

    #[test]
    fn turning_without_a_place_is_drawn_from_the_origin() {
        let mut viewpoints = Viewpoints::new(1);
        let flags = ViewStateFlags::ORIENTATION_VALID | ViewStateFlags::ORIENTATION_TRACKED;
        let located = viewpoints.accept(NOW, flags, [(at(9.0), FOV); 2]).unwrap();
        assert_eq!(located.views().len(), 1);
        assert_eq!(located.views()[0].world_from_eye.translation.vector.norm(), 0.0);
    }

    #[test]
    fn lost_eyes_go_on_together_for_a_while_where_somebody_foretells() {
        let mut viewpoints = Viewpoints::new(2);
        let reach = Reach { ahead: Span::from_millis(30), ..Reach::default() };
        viewpoints.foretell(PoseHistory::new(&reach));
        let frame = |k: i64| Timestamp::from_nanos(k * 10_000_000);
        for k in 0..3 {
            let x = 0.01 * k as f32;
            viewpoints.accept(frame(k), all(), [(at(x), FOV), (at(x + 0.06), FOV)]).unwrap();
        }
        let lost = |viewpoints: &mut Viewpoints, k| {
            let located =
                viewpoints.accept(frame(k), ViewStateFlags::EMPTY, [(at(9.0), Fovf::default()); 2]).unwrap();
            assert_eq!(located.orientation_tracking, Tracking::Lost);
            let [left, right] = [0, 1].map(|eye| located.views()[eye].world_from_eye.translation.x);
            assert!((right - left - 0.06).abs() < 1e-6, "{left} {right}");
            assert_eq!(located.raw(0).0.position.x, left as f32);
            left
        };
        for (k, x) in [(3, 0.03), (4, 0.04), (5, 0.05), (6, 0.05), (60, 0.05)] {
            let found = lost(&mut viewpoints, k);
            assert!((found - x).abs() < 1e-6, "{k}: {found}");
        }
        viewpoints.accept(frame(61), all(), [(at(0.5), FOV), (at(0.56), FOV)]).unwrap();
        viewpoints.accept(frame(62), all(), [(at(0.6), FOV), (at(0.66), FOV)]).unwrap();
        viewpoints.forget_motion();
        assert!((lost(&mut viewpoints, 63) - 0.6).abs() < 1e-6);
    }
}
