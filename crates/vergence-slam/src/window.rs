//! The sliding window: latest frames with velocity and biases, keyframes, points, and what is left of everything older.

use nalgebra::{DVector, Matrix3, Matrix3x2, SMatrix, SVector, Vector3};
use vergence_geom::{Rigid, log, right_jacobian_inverse};
use vergence_solve::{Elimination, Kernel, Normal, Prior, Problem};
use vergence_time::Timestamp;

use crate::link::{Link, Motion, motion_step, moved_motion, moved_pose, pose_step};
use crate::params::Params;
use crate::sighting::{Sighting, Way, across};

/// One frame of the window.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub(crate) id: u64,
    pub(crate) time: Timestamp,
    pub(crate) pose: Rigid,
    /// Of the latest frames, where there is an inertial unit.
    pub(crate) motion: Option<Motion>,
    /// Where it was when something that hangs on it was marginalised: derivatives are taken there from then on, else the
    /// prior would gain knowledge that no measurement gave (first-estimates Jacobians).
    pub(crate) fixed_pose: Option<Rigid>,
    pub(crate) fixed_motion: Option<Motion>,
    pub(crate) keyframe: bool,
    /// Sorted by track, then camera.
    pub(crate) seen: Vec<Sighting>,
    /// From the frame before.
    pub(crate) link: Option<Link>,
    /// It stands still: standard deviation of its velocity, m/s.
    pub(crate) still: Option<f64>,
    /// Where it was guessed to be: without an inertial unit, what holds a frame that sees nothing.
    pub(crate) guess: Option<Rigid>,
    before: (Rigid, Option<Motion>),
}

impl Frame {
    pub(crate) fn new(id: u64, time: Timestamp, pose: Rigid, motion: Option<Motion>) -> Self {
        Self {
            id,
            time,
            pose,
            motion,
            fixed_pose: None,
            fixed_motion: None,
            keyframe: false,
            seen: Vec::new(),
            link: None,
            still: None,
            guess: None,
            before: (pose, motion),
        }
    }

    pub(crate) fn line_pose(&self) -> Rigid {
        self.fixed_pose.unwrap_or(self.pose)
    }

    pub(crate) fn line_motion(&self) -> Motion {
        self.fixed_motion.or(self.motion).unwrap_or_default()
    }

    pub(crate) fn motion_now(&self) -> Motion {
        self.motion.unwrap_or_default()
    }
}

/// A sighting of a point by a frame of the window.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    pub(crate) frame: u64,
    pub(crate) slot: usize,
    pub(crate) sighting: Sighting,
}

/// A point of the scene, told from the camera that saw it first.
#[derive(Clone, Debug)]
pub(crate) struct Point {
    pub(crate) track: u64,
    pub(crate) host: u64,
    pub(crate) host_slot: usize,
    pub(crate) camera: u8,
    pub(crate) direction: Vector3<f64>,
    pub(crate) basis: Matrix3x2<f64>,
    pub(crate) inverse_distance: f64,
    pub(crate) seen: Vec<Observation>,
    before: (Vector3<f64>, f64),
}

impl Point {
    pub(crate) fn new(
        track: u64,
        host: u64,
        camera: u8,
        direction: Vector3<f64>,
        inverse_distance: f64,
    ) -> Self {
        let basis = across(&direction);
        let before = (direction, inverse_distance);
        Self {
            track,
            host,
            host_slot: 0,
            camera,
            direction,
            basis,
            inverse_distance,
            seen: Vec::new(),
            before,
        }
    }
}

/// How the window begins: what is known of the first frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Anchor {
    pub(crate) frame: u64,
    pub(crate) pose: Rigid,
    pub(crate) motion: Motion,
    /// About the vertical and about the two level axes, rad.
    pub(crate) yaw_rad: f64,
    pub(crate) tilt_rad: f64,
    pub(crate) position_m: f64,
    pub(crate) velocity_m_s: f64,
    pub(crate) gyr_rad_s: f64,
    pub(crate) acc_m_s2: f64,
}

impl Anchor {
    pub(crate) fn residual(&self, pose: &Rigid, motion: &Motion) -> SVector<f64, 15> {
        let turned = self.pose.rotation * log(&(self.pose.rotation.inverse() * pose.rotation));
        let mut r = SVector::<f64, 15>::zeros();
        let way = (pose.translation.vector - self.pose.translation.vector) / self.position_m;
        r.fixed_rows_mut::<3>(0).copy_from(&way);
        r.fixed_rows_mut::<3>(3).copy_from(&turned.component_mul(&self.turn_weights()));
        let step = motion_step(&self.motion, motion);
        r.fixed_rows_mut::<3>(6).copy_from(&(step.fixed_rows::<3>(0) / self.velocity_m_s));
        r.fixed_rows_mut::<3>(9).copy_from(&(step.fixed_rows::<3>(3) / self.gyr_rad_s));
        r.fixed_rows_mut::<3>(12).copy_from(&(step.fixed_rows::<3>(6) / self.acc_m_s2));
        r
    }

    fn turn_weights(&self) -> Vector3<f64> {
        Vector3::new(1.0 / self.tilt_rad, 1.0 / self.yaw_rad, 1.0 / self.tilt_rad)
    }

    pub(crate) fn derivative(&self, pose: &Rigid) -> SMatrix<f64, 15, 15> {
        let mut j = SMatrix::<f64, 15, 15>::zeros();
        let turned = log(&(self.pose.rotation.inverse() * pose.rotation));
        let world = self.pose.rotation.to_rotation_matrix().into_inner();
        let turn = Matrix3::from_diagonal(&self.turn_weights()) * world * right_jacobian_inverse(&turned);
        j.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(1.0 / self.position_m);
        j.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        j.fixed_view_mut::<3, 3>(6, 6).fill_diagonal(1.0 / self.velocity_m_s);
        j.fixed_view_mut::<3, 3>(9, 9).fill_diagonal(1.0 / self.gyr_rad_s);
        j.fixed_view_mut::<3, 3>(12, 12).fill_diagonal(1.0 / self.acc_m_s2);
        j
    }
}

/// How a relative pose (target from host; perturbed on the left) moves with the target's and the host's own steps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Relative {
    pub(crate) by_target: SMatrix<f64, 6, 6>,
    pub(crate) by_host: SMatrix<f64, 6, 6>,
}

impl Relative {
    pub(crate) fn new(target: &Rigid, host: &Rigid) -> (Rigid, Self) {
        let back = target.rotation.inverse().to_rotation_matrix().into_inner();
        let relative = target.inv_mul(host);
        let (mut by_target, mut by_host) = (SMatrix::<f64, 6, 6>::zeros(), SMatrix::<f64, 6, 6>::zeros());
        by_target.fixed_view_mut::<3, 3>(0, 0).copy_from(&-back);
        by_target.fixed_view_mut::<3, 3>(0, 3).copy_from(&relative.translation.vector.cross_matrix());
        by_target.fixed_view_mut::<3, 3>(3, 3).fill_diagonal(-1.0);
        by_host.fixed_view_mut::<3, 3>(0, 0).copy_from(&back);
        by_host.fixed_view_mut::<3, 3>(3, 3).copy_from(&relative.rotation.to_rotation_matrix().into_inner());
        (relative, Self { by_target, by_host })
    }
}

/// Of a guess by images alone, m and rad: only holds what nothing else holds.
const GUESS: f64 = 1.0;
/// Nearest point, 1/m.
pub(crate) const NEAREST: f64 = 100.0;

/// Points of one host.
#[derive(Debug, Default)]
struct Hosted {
    slot: usize,
    points: Vec<usize>,
    elimination: Elimination<6, 3>,
    relatives: Vec<Option<Relative>>,
}

/// Everything that is estimated at once.
#[derive(Debug, Default)]
pub(crate) struct Window {
    pub(crate) frames: Vec<Frame>,
    pub(crate) points: Vec<Point>,
    pub(crate) cameras: Vec<Rigid>,
    pub(crate) anchor: Option<Anchor>,
    pub(crate) prior: Prior,
    /// The frames of the prior, and whether it knows the motion, in the order of its unknowns (poses 6, motions 9).
    pub(crate) prior_frames: Vec<(u64, bool)>,
    pub(crate) params: Params,
    hosted: Vec<Hosted>,
    motion_at: Vec<Option<usize>>,
    dimension: usize,
    ways: Vec<Way>,
    line_ways: Vec<Way>,
    relative_step: Vec<f64>,
    begins: Vec<usize>,
}

impl Window {
    pub(crate) fn slot(&self, id: u64) -> Option<usize> {
        self.frames.binary_search_by_key(&id, |f| f.id).ok()
    }

    pub(crate) fn motion_column(&self, slot: usize) -> Option<usize> {
        self.motion_at[slot]
    }

    pub(crate) fn pixel_weight(&self) -> f64 {
        1.0 / (self.params.pixel_px * self.params.pixel_px)
    }

    pub(crate) fn kernel(&self) -> Kernel {
        Kernel::Huber(self.params.huber)
    }

    /// To be called whenever frames or points have changed: numbers them.
    pub(crate) fn number(&mut self) {
        let ids: Vec<u64> = self.frames.iter().map(|f| f.id).collect();
        let slot = |id: u64| ids.binary_search(&id).unwrap_or(usize::MAX);
        for point in &mut self.points {
            point.host_slot = slot(point.host);
            point.seen.iter_mut().for_each(|o| o.slot = slot(o.frame));
            debug_assert!(point.host_slot < ids.len() && point.seen.iter().all(|o| o.slot < ids.len()));
        }
        let mut next = 6 * self.frames.len();
        self.motion_at.clear();
        for frame in &self.frames {
            self.motion_at.push(frame.motion.map(|_| next));
            next += if frame.motion.is_some() { 9 } else { 0 };
        }
        self.dimension = next;
        let hosts = self.frames.len();
        self.hosted.resize_with(hosts, Hosted::default);
        for (slot, hosted) in self.hosted.iter_mut().enumerate() {
            hosted.slot = slot;
            hosted.points.clear();
        }
        for (index, point) in self.points.iter().enumerate() {
            self.hosted[point.host_slot].points.push(index);
        }
    }

    /// The ways from each camera of the host to each camera of each frame: index ((host camera · frames) + frame) · cameras + camera.
    fn ways_from(&mut self, host: usize, line: bool) {
        let into = if line { &mut self.line_ways } else { &mut self.ways };
        into.clear();
        for host_camera in &self.cameras {
            for frame in &self.frames {
                let (target, from) = if line {
                    (frame.line_pose(), self.frames[host].line_pose())
                } else {
                    (frame.pose, self.frames[host].pose)
                };
                let relative = target.inv_mul(&from);
                into.extend(self.cameras.iter().map(|camera| Way::new(&relative, host_camera, camera)));
            }
        }
    }

    pub(crate) fn way_index(&self, host_camera: u8, slot: usize, camera: u8) -> usize {
        (usize::from(host_camera) * self.frames.len() + slot) * self.cameras.len() + usize::from(camera)
    }

    /// Costs of the points of a host; with `line`, their equations too.
    fn points_of(&mut self, host: usize, linearise: Option<f64>) -> f64 {
        if self.hosted[host].points.is_empty() {
            return 0.0;
        }
        self.ways_from(host, false);
        let mut hosted = std::mem::take(&mut self.hosted[host]);
        let (weight, kernel) = (self.pixel_weight(), self.kernel());
        let depth_weight = 1.0 / (self.params.depth_inverse_m * self.params.depth_inverse_m);
        let any_fixed = self.frames.iter().any(|f| f.fixed_pose.is_some());
        if linearise.is_some() {
            hosted.elimination.reset(self.frames.len());
            if any_fixed {
                self.ways_from(host, true);
            }
        }
        let mut cost = 0.0;
        for &index in &hosted.points {
            let point = &self.points[index];
            if linearise.is_some() {
                hosted.elimination.begin_point();
            }
            for o in &point.seen {
                let way = self.way_index(point.camera, o.slot, o.sighting.camera);
                let Some(r) = self.ways[way].residual(&o.sighting, &point.direction, point.inverse_distance)
                else {
                    // Behind the camera: as bad as the worst that still counts, and no derivative.
                    cost += 0.5 * kernel.of(weight * 400.0).0;
                    continue;
                };
                let (half, w) = kernel.of(weight * r.norm_squared());
                cost += 0.5 * half;
                let line = if any_fixed { &self.line_ways } else { &self.ways };
                if linearise.is_some() {
                    let (by_pose, by_point) = line[way].derivatives(
                        &o.sighting,
                        &point.direction,
                        &point.basis,
                        point.inverse_distance,
                    );
                    let block = (o.slot != host).then_some((o.slot, &by_pose));
                    hosted.elimination.add(block, &by_point, &r, w * weight);
                }
                if let Some(measured) = o.sighting.inverse_range() {
                    let (value, ..) =
                        self.ways[way].inverse_range(&point.direction, &point.basis, point.inverse_distance);
                    let r = SVector::<f64, 1>::new(value - measured);
                    let (half, w) = kernel.of(depth_weight * r.x * r.x);
                    cost += 0.5 * half;
                    if linearise.is_some() {
                        let (_, by_pose, by_point) =
                            line[way].inverse_range(&point.direction, &point.basis, point.inverse_distance);
                        let block = (o.slot != host).then_some((o.slot, &by_pose));
                        hosted.elimination.add(block, &by_point, &r, w * depth_weight);
                    }
                }
            }
            if let Some(damping) = linearise {
                hosted.elimination.end_point(damping, 1e-6);
            }
        }
        self.hosted[host] = hosted;
        cost
    }

    pub(crate) fn relatives(&self, host: usize) -> Vec<Option<Relative>> {
        let from = self.frames[host].line_pose();
        let relative = |(slot, frame): (usize, &Frame)| {
            (slot != host).then(|| Relative::new(&frame.line_pose(), &from).1)
        };
        self.frames.iter().enumerate().map(relative).collect()
    }

    /// The relative equations of a host in terms of the frames' own unknowns.
    fn expand(&mut self, host: usize, normal: &mut Normal) {
        let relatives = self.relatives(host);
        let hosted = &mut self.hosted[host];
        hosted.relatives = relatives;
        let (hessian, gradient) = hosted.elimination.reduced();
        let block = |a: usize, b: usize| -> SMatrix<f64, 6, 6> {
            if a >= b {
                let found = hessian.fixed_view::<6, 6>(6 * a, 6 * b).into_owned();
                if a == b {
                    found.lower_triangle() + found.lower_triangle().transpose()
                        - SMatrix::from_diagonal(&found.diagonal())
                } else {
                    found
                }
            } else {
                hessian.fixed_view::<6, 6>(6 * b, 6 * a).transpose()
            }
        };
        let seen: Vec<usize> = (0..self.frames.len())
            .filter(|&t| t != host && hessian.fixed_view::<6, 6>(6 * t, 6 * t).iter().any(|x| *x != 0.0))
            .collect();
        let mut of_host = SMatrix::<f64, 6, 6>::zeros();
        for &b in &seen {
            let Some(right) = &hosted.relatives[b] else { continue };
            let mut pulled = SMatrix::<f64, 6, 6>::zeros();
            for &a in &seen {
                let Some(left) = &hosted.relatives[a] else { continue };
                let between = block(a, b);
                pulled += left.by_host.transpose() * between;
                if a >= b {
                    normal.add_block(6 * a, 6 * b, &(left.by_target.transpose() * between * right.by_target));
                }
            }
            normal.add_block(6 * host, 6 * b, &(pulled * right.by_target));
            of_host += pulled * right.by_host;
            let slope = gradient.fixed_rows::<6>(6 * b);
            normal.add_gradient(6 * b, &(right.by_target.transpose() * slope));
            normal.add_gradient(6 * host, &(right.by_host.transpose() * slope));
        }
        normal.add_block(6 * host, 6 * host, &of_host);
    }

    /// Where each unknown of the prior is among the window's, and the step from its point of linearisation.
    pub(crate) fn prior_step(&self) -> (DVector<f64>, Vec<usize>) {
        let mut step = DVector::zeros(self.prior.dimension());
        let mut places = Vec::with_capacity(self.prior.dimension());
        let mut at = 0;
        for &(id, with_motion) in &self.prior_frames {
            let Some(slot) = self.slot(id) else { continue };
            let frame = &self.frames[slot];
            step.fixed_rows_mut::<6>(at).copy_from(&pose_step(&frame.line_pose(), &frame.pose));
            places.extend(6 * slot..6 * slot + 6);
            at += 6;
            if let (true, Some(column)) = (with_motion, self.motion_at[slot]) {
                step.fixed_rows_mut::<9>(at)
                    .copy_from(&motion_step(&frame.line_motion(), &frame.motion_now()));
                places.extend(column..column + 9);
                at += 9;
            }
        }
        debug_assert_eq!(at, self.prior.dimension());
        (step, places)
    }

    fn frames_cost(&self, mut normal: Option<&mut Normal>) -> f64 {
        let mut cost = 0.0;
        for (slot, frame) in self.frames.iter().enumerate() {
            if let (Some(link), Some(column), true) = (&frame.link, self.motion_at[slot], slot > 0) {
                let from = &self.frames[slot - 1];
                if let Some(from_column) = self.motion_at[slot - 1] {
                    let (a, b) = ((&from.pose, &from.motion_now()), (&frame.pose, &frame.motion_now()));
                    let r = link.residual(a, b);
                    cost += 0.5 * r.norm_squared();
                    if let Some(normal) = normal.as_deref_mut() {
                        let lines =
                            (from.line_pose(), from.line_motion(), frame.line_pose(), frame.line_motion());
                        let (ja, jb) = link.derivatives((&lines.0, &lines.1), (&lines.2, &lines.3));
                        add_pair(normal, [6 * (slot - 1), from_column], [6 * slot, column], &ja, &jb, &r);
                    }
                }
            }
            if let (Some(sigma), Some(column)) = (frame.still, self.motion_at[slot]) {
                let r = frame.motion_now().velocity_m_s / sigma;
                cost += 0.5 * r.norm_squared();
                if let Some(normal) = normal.as_deref_mut() {
                    normal.add_square(column, &(Matrix3::identity() / sigma), &r, 1.0);
                }
            }
            if let Some(guess) = &frame.guess {
                let r = pose_step(guess, &frame.pose) / GUESS;
                cost += 0.5 * r.norm_squared();
                if let Some(normal) = normal.as_deref_mut() {
                    normal.add_square(6 * slot, &(SMatrix::<f64, 6, 6>::identity() / GUESS), &r, 1.0);
                }
            }
        }
        if let Some((anchor, slot)) = self.anchor.and_then(|a| Some((a, self.slot(a.frame)?))) {
            let frame = &self.frames[slot];
            let r = anchor.residual(&frame.pose, &frame.motion_now());
            let rows = if self.motion_at[slot].is_some() { 15 } else { 6 };
            cost += 0.5 * r.rows(0, rows).norm_squared();
            if let Some(normal) = normal.as_deref_mut() {
                let j = anchor.derivative(&frame.pose);
                normal.add_square(
                    6 * slot,
                    &j.fixed_view::<6, 6>(0, 0).into_owned(),
                    &r.fixed_rows::<6>(0).into_owned(),
                    1.0,
                );
                if let Some(column) = self.motion_at[slot] {
                    normal.add_square(
                        column,
                        &j.fixed_view::<9, 9>(6, 6).into_owned(),
                        &r.fixed_rows::<9>(6).into_owned(),
                        1.0,
                    );
                }
            }
        }
        let (step, places) = self.prior_step();
        cost + match normal {
            Some(normal) => self.prior.add_to(normal, &step, &places),
            None => self.prior.cost(&step),
        }
    }

    fn cost(&mut self) -> f64 {
        let frames = self.frames_cost(None);
        (0..self.frames.len()).map(|host| self.points_of(host, None)).sum::<f64>() + frames
    }

    /// What is left of each sighting of each point, in their order, pixels; `None` behind the camera.
    pub(crate) fn residuals_px(&mut self, into: &mut Vec<Option<f64>>) {
        let mut begins = std::mem::take(&mut self.begins);
        begins.clear();
        let mut count = 0;
        for point in &self.points {
            begins.push(count);
            count += point.seen.len();
        }
        into.clear();
        into.resize(count, None);
        for host in 0..self.frames.len() {
            if self.hosted[host].points.is_empty() {
                continue;
            }
            self.ways_from(host, false);
            for &index in &self.hosted[host].points {
                let point = &self.points[index];
                for (o, into) in point.seen.iter().zip(&mut into[begins[index]..]) {
                    let way = &self.ways[self.way_index(point.camera, o.slot, o.sighting.camera)];
                    let residual = way.residual(&o.sighting, &point.direction, point.inverse_distance);
                    *into = residual.map(|r| r.norm());
                }
            }
        }
        self.begins = begins;
    }
}

/// Adds the equations of a residual of two frames (each: columns of pose and of motion).
fn add_pair(
    normal: &mut Normal,
    a: [usize; 2],
    b: [usize; 2],
    ja: &SMatrix<f64, 15, 15>,
    jb: &SMatrix<f64, 15, 15>,
    r: &SVector<f64, 15>,
) {
    let halves = |j: &SMatrix<f64, 15, 15>| {
        (j.fixed_columns::<6>(0).into_owned(), j.fixed_columns::<9>(6).into_owned())
    };
    let ((ap, am), (bp, bm)) = (halves(ja), halves(jb));
    normal.add_block(a[0], a[0], &ap.tr_mul(&ap));
    normal.add_block(b[0], b[0], &bp.tr_mul(&bp));
    normal.add_block(a[1], a[1], &am.tr_mul(&am));
    normal.add_block(b[1], b[1], &bm.tr_mul(&bm));
    normal.add_block(b[0], a[0], &bp.tr_mul(&ap));
    normal.add_block(b[1], a[1], &bm.tr_mul(&am));
    normal.add_block(a[1], a[0], &am.tr_mul(&ap));
    normal.add_block(b[1], b[0], &bm.tr_mul(&bp));
    normal.add_block(a[1], b[0], &am.tr_mul(&bp));
    normal.add_block(b[1], a[0], &bm.tr_mul(&ap));
    normal.add_gradient(a[0], &ap.tr_mul(r));
    normal.add_gradient(b[0], &bp.tr_mul(r));
    normal.add_gradient(a[1], &am.tr_mul(r));
    normal.add_gradient(b[1], &bm.tr_mul(r));
}

impl Problem for Window {
    fn dimension(&self) -> usize {
        self.dimension
    }

    fn linearise(&mut self, damping: f64, normal: &mut Normal) -> f64 {
        let mut cost = self.frames_cost(Some(normal));
        for host in 0..self.frames.len() {
            if !self.hosted[host].points.is_empty() {
                cost += self.points_of(host, Some(damping));
                self.expand(host, normal);
            }
        }
        cost
    }

    fn step(&mut self, by: &[f64]) -> f64 {
        for (slot, frame) in self.frames.iter_mut().enumerate() {
            frame.before = (frame.pose, frame.motion);
            frame.pose = moved_pose(&frame.pose, &by[6 * slot..]);
            if let (Some(motion), Some(column)) = (&mut frame.motion, self.motion_at[slot]) {
                *motion = moved_motion(motion, &by[column..]);
            }
        }
        let mut relative_step = std::mem::take(&mut self.relative_step);
        for hosted in &self.hosted {
            if hosted.points.is_empty() {
                continue;
            }
            let part = |slot: usize| SVector::<f64, 6>::from_column_slice(&by[6 * slot..6 * slot + 6]);
            relative_step.clear();
            for (slot, relative) in hosted.relatives.iter().enumerate() {
                let step = relative
                    .as_ref()
                    .map_or(SVector::zeros(), |r| r.by_target * part(slot) + r.by_host * part(hosted.slot));
                relative_step.extend_from_slice(step.as_slice());
            }
            for (number, &index) in hosted.points.iter().enumerate() {
                let step = hosted.elimination.point_step(number, &relative_step);
                let point = &mut self.points[index];
                point.before = (point.direction, point.inverse_distance);
                point.direction = (point.direction + point.basis * step.fixed_rows::<2>(0)).normalize();
                point.basis = across(&point.direction);
                point.inverse_distance = (point.inverse_distance + step.z).clamp(0.0, NEAREST);
            }
        }
        self.relative_step = relative_step;
        self.cost()
    }

    fn undo(&mut self) {
        for frame in &mut self.frames {
            (frame.pose, frame.motion) = frame.before;
        }
        for point in &mut self.points {
            (point.direction, point.inverse_distance) = point.before;
            point.basis = across(&point.direction);
        }
    }
}
