//! Frames leave the window: what they knew is marginalised into the prior.

use nalgebra::{DVector, SMatrix, SVector};
use vergence_solve::Stack;

use crate::link::{motion_step, pose_step};
use crate::sighting::Way;
use crate::window::Window;

/// What leaves: keyframes and latest frames whole, or only the motion of a frame that stays as a keyframe.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Leaving {
    /// Slots of frames that leave.
    pub(crate) frames: Vec<usize>,
    /// Slots of frames that lose velocity and biases only.
    pub(crate) motions: Vec<usize>,
}

/// Working memory.
#[derive(Debug, Default)]
pub(crate) struct Shrink {
    stack: Stack,
    local: Stack,
}

impl Shrink {
    /// Marginalises; frames, their points, sightings and unknowns are gone afterwards, and the window is numbered anew.
    pub(crate) fn marginalise(&mut self, window: &mut Window, leaving: &Leaving) {
        let count = window.frames.len();
        let gone = |slot: usize| leaving.frames.contains(&slot);
        let stilled = |slot: usize| gone(slot) || leaving.motions.contains(&slot);
        // Whose unknowns take part.
        let (mut poses, mut motions) = (vec![false; count], vec![false; count]);
        for &(id, with_motion) in &window.prior_frames {
            if let Some(slot) = window.slot(id) {
                poses[slot] = true;
                motions[slot] |= with_motion;
            }
        }
        if let Some(slot) = window.anchor.and_then(|a| window.slot(a.frame)) {
            poses[slot] = true;
            motions[slot] = true;
        }
        let linked = |slot: usize| {
            slot > 0
                && window.frames[slot].link.is_some()
                && window.motion_column(slot).is_some()
                && window.motion_column(slot - 1).is_some()
        };
        let taken: Vec<bool> = (0..count).map(|s| linked(s) && (stilled(s) || stilled(s - 1))).collect();
        for slot in (0..count).filter(|s| taken[*s]) {
            for s in [slot - 1, slot] {
                poses[s] = true;
                motions[s] = true;
            }
        }
        for point in window.points.iter().filter(|p| gone(p.host_slot)) {
            poses[point.host_slot] = true;
            point.seen.iter().for_each(|o| poses[o.slot] = true);
        }
        for slot in 0..count {
            poses[slot] |= gone(slot);
            motions[slot] |= stilled(slot);
            motions[slot] &= window.motion_column(slot).is_some();
        }
        // Columns: first what is dropped, then what stays.
        let mut column_of = vec![usize::MAX; 6 * count + 9 * count];
        let mut next = 0;
        let motion_key = |slot: usize| 6 * count + 9 * slot;
        let mut dropped = 0;
        let mut kept = Vec::new();
        for pass in 0..2 {
            for slot in 0..count {
                if poses[slot] && gone(slot) == (pass == 0) {
                    (0..6).for_each(|i| column_of[6 * slot + i] = next + i);
                    next += 6;
                    if pass == 1 {
                        kept.push((window.frames[slot].id, motions[slot] && !stilled(slot)));
                    }
                }
                if motions[slot] && stilled(slot) == (pass == 0) {
                    (0..9).for_each(|i| column_of[motion_key(slot) + i] = next + i);
                    next += 9;
                }
            }
            if pass == 0 {
                dropped = next;
            }
        }
        // A frame that keeps its motion but whose pose takes no part cannot be: links take both.
        let (stack, local) = (&mut self.stack, &mut self.local);
        stack.reset(next);
        let width = next + 1;
        {
            let (step, places) = window.prior_step();
            let to_key = |place: usize| {
                if place < 6 * count {
                    return place;
                }
                let slot = (0..count)
                    .find(|s| window.motion_column(*s).is_some_and(|c| (c..c + 9).contains(&place)))
                    .unwrap_or(0);
                motion_key(slot) + place - window.motion_column(slot).unwrap_or(0)
            };
            let places: Vec<usize> = places.into_iter().map(|p| column_of[to_key(p)]).collect();
            window.prior.append_to(stack, &step, &places);
        }
        let put = |rows: &mut [f64], row: usize, key: usize, values: &dyn Fn(usize) -> f64, n: usize| {
            (0..n).for_each(|i| rows[row * width + column_of[key + i]] += values(i));
        };
        if let Some((anchor, slot)) = window.anchor.and_then(|a| Some((a, window.slot(a.frame)?))) {
            let frame = &window.frames[slot];
            let r = anchor.residual(&frame.pose, &frame.motion_now());
            let j = anchor.derivative(&frame.pose);
            let count = if motions[slot] { 15 } else { 6 };
            let rows = stack.append(count);
            for i in 0..count {
                put(rows, i, 6 * slot, &|c| j[(i, c)], 6);
                if motions[slot] {
                    put(rows, i, motion_key(slot), &|c| j[(i, 6 + c)], 9);
                }
                rows[i * width + next] = r[i];
            }
        }
        for slot in 0..count {
            let frame = &window.frames[slot];
            if let (true, Some(link)) = (taken[slot], &frame.link) {
                let from = &window.frames[slot - 1];
                let r = link.residual((&from.pose, &from.motion_now()), (&frame.pose, &frame.motion_now()));
                let (a, b) = link.derivatives(
                    (&from.line_pose(), &from.line_motion()),
                    (&frame.line_pose(), &frame.line_motion()),
                );
                let rows = stack.append(15);
                for i in 0..15 {
                    for (s, j) in [(slot - 1, &a), (slot, &b)] {
                        put(rows, i, 6 * s, &|c| j[(i, c)], 6);
                        put(rows, i, motion_key(s), &|c| j[(i, 6 + c)], 9);
                    }
                    rows[i * width + next] = r[i];
                }
            }
            if let (Some(sigma), true, true) = (frame.still, stilled(slot), motions[slot]) {
                let r = frame.motion_now().velocity_m_s / sigma;
                let rows = stack.append(3);
                for i in 0..3 {
                    put(rows, i, motion_key(slot), &|c| if c == i { 1.0 / sigma } else { 0.0 }, 3);
                    rows[i * width + next] = r[i];
                }
            }
        }
        for &host in &leaving.frames {
            local_rows(window, host, local);
            let relatives = window.relatives(host);
            let rows = stack.append(local.rows());
            for i in 0..local.rows() {
                let row = local.row(i);
                for (slot, relative) in relatives.iter().enumerate() {
                    let Some(relative) = relative else { continue };
                    let part = SMatrix::<f64, 1, 6>::from_row_slice(&row[3 + 6 * slot..9 + 6 * slot]);
                    if part.iter().all(|x| *x == 0.0) {
                        continue;
                    }
                    let (target, own) = (part * relative.by_target, part * relative.by_host);
                    put(rows, i, 6 * slot, &|c| target[c], 6);
                    put(rows, i, 6 * host, &|c| own[c], 6);
                }
                rows[i * width + next] = row[3 + 6 * count];
            }
        }
        let mut prior = stack.marginalise(dropped);

        // What stays and takes part is held to where it is now; the prior is told about those points.
        let mut step = DVector::zeros(next - dropped);
        for slot in 0..count {
            if poses[slot] && !gone(slot) {
                let frame = &mut window.frames[slot];
                let line = *frame.fixed_pose.get_or_insert(frame.pose);
                let by: SVector<f64, 6> = pose_step(&line, &frame.pose);
                step.fixed_rows_mut::<6>(column_of[6 * slot] - dropped).copy_from(&by);
                if motions[slot] && !stilled(slot) {
                    let now = frame.motion_now();
                    let line = *frame.fixed_motion.get_or_insert(now);
                    let by: SVector<f64, 9> = motion_step(&line, &now);
                    step.fixed_rows_mut::<9>(column_of[motion_key(slot)] - dropped).copy_from(&by);
                }
            }
        }
        prior.move_origin(&-step);
        window.prior = prior;
        window.prior_frames = kept;
        window.anchor = None;
        for &slot in &leaving.motions {
            window.frames[slot].motion = None;
            window.frames[slot].fixed_motion = None;
            window.frames[slot].link = None;
        }
        // A link from a frame that lost its motion has been used.
        for slot in (0..count).filter(|s| taken[*s]) {
            window.frames[slot].link = None;
        }
        let ids: Vec<u64> = leaving.frames.iter().map(|s| window.frames[*s].id).collect();
        window.frames.retain(|f| !ids.contains(&f.id));
        for point in &mut window.points {
            point.seen.retain(|o| !ids.contains(&o.frame));
        }
        window.points.retain(|p| !ids.contains(&p.host) && p.seen.len() > 1);
        window.number();
    }
}

/// The rows of the points of a host over the relative poses (three columns of the point first, zero after), compressed.
fn local_rows(window: &Window, host: usize, local: &mut Stack) {
    let count = window.frames.len();
    local.reset(3 + 6 * count);
    let width = 4 + 6 * count;
    let (weight, kernel) = (window.pixel_weight(), window.kernel());
    let depth = 1.0 / window.params.depth_inverse_m;
    for point in window.points.iter().filter(|p| p.host_slot == host) {
        let from = local.rows();
        for o in &point.seen {
            let frame = &window.frames[o.slot];
            let camera = &window.cameras[usize::from(o.sighting.camera)];
            let host_camera = &window.cameras[usize::from(point.camera)];
            let now = Way::new(&frame.pose.inv_mul(&window.frames[host].pose), host_camera, camera);
            let line =
                Way::new(&frame.line_pose().inv_mul(&window.frames[host].line_pose()), host_camera, camera);
            let Some(r) = now.residual(&o.sighting, &point.direction, point.inverse_distance) else {
                continue;
            };
            let (_, w) = kernel.of(weight * r.norm_squared());
            let scale = (w * weight).sqrt();
            let (by_pose, by_point) =
                line.derivatives(&o.sighting, &point.direction, &point.basis, point.inverse_distance);
            let rows = local.append(2);
            for i in 0..2 {
                let row = &mut rows[i * width..(i + 1) * width];
                (0..3).for_each(|c| row[c] = by_point[(i, c)] * scale);
                if o.slot != host {
                    (0..6).for_each(|c| row[3 + 6 * o.slot + c] = by_pose[(i, c)] * scale);
                }
                row[width - 1] = r[i] * scale;
            }
            if let Some(measured) = o.sighting.inverse_range() {
                let (value, ..) = now.inverse_range(&point.direction, &point.basis, point.inverse_distance);
                let (_, by_pose, by_point) =
                    line.inverse_range(&point.direction, &point.basis, point.inverse_distance);
                let r = value - measured;
                let scale = depth * kernel.of((depth * r).powi(2)).1.sqrt();
                let row = local.append(1);
                (0..3).for_each(|c| row[c] = by_point[c] * scale);
                if o.slot != host {
                    (0..6).for_each(|c| row[3 + 6 * o.slot + c] = by_pose[c] * scale);
                }
                row[width - 1] = r * scale;
            }
        }
        if local.rows() > from {
            local.eliminate(from, 3);
        }
    }
    local.compress();
}
