//! Views: where the eyes are, what they see, and which part of it the lenses hide.

use openxr_sys as sys;

use crate::clock::valid_time;
use crate::fault::{bent_fov, bent_pose};
use crate::ffi::{Buffer, In, Out, XrResult};
use crate::pose::{fov_to_xr, from_raw, to_xr};
use crate::session::Session;
use crate::space;
use crate::system::check_view_configuration;

pub(crate) fn locate_views(
    session: &Session,
    info: In<sys::ViewLocateInfo>,
    mut state: Out<sys::ViewState>,
    mut buffer: Buffer<sys::View>,
) -> XrResult {
    use sys::ViewStateFlags as F;
    let info = info.get()?;
    let state = state.fill()?;
    check_view_configuration(info.view_configuration_type)?;
    let at = valid_time(info.display_time)?;
    let base = space::get(info.space)?;
    if !std::ptr::eq(&*base.session, session) {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    if let Some(said) = session.replay().filter(|_| base.is_local()).and_then(|replay| replay.views(at)) {
        state.view_state_flags = F::from_raw(u64::from(said.validity.0));
        let views = said.views();
        return buffer.give_typed(views.len(), |index, view| {
            let [angle_left, angle_right, angle_up, angle_down] = views[index].fov_rad;
            view.pose = bent_pose(from_raw(&views[index].pose));
            view.fov = bent_fov(sys::Fovf { angle_left, angle_right, angle_up, angle_down });
        });
    }
    let head = session.head(at);
    let base = base.stage_from_space(at);
    let base_from_head = base.pose().zip(head.pose()).map(|(base, head)| base.inverse() * head);
    let seen = matches!((base, head), (crate::motion::Tracked::Seen(_), crate::motion::Tracked::Seen(_)));
    state.view_state_flags = match (base_from_head, seen) {
        (None, _) => F::EMPTY,
        (Some(_), false) => F::ORIENTATION_VALID | F::POSITION_VALID,
        (Some(_), true) => {
            F::ORIENTATION_VALID | F::POSITION_VALID | F::ORIENTATION_TRACKED | F::POSITION_TRACKED
        }
    };
    let eyes = &session.instance.config.profile.eyes;
    buffer.give_typed(eyes.len(), |index, view| {
        let eye = &eyes[index];
        let pose = base_from_head
            .map_or(sys::Posef::IDENTITY, |base_from_head| to_xr(&(base_from_head * eye.head_from_eye)));
        view.pose = bent_pose(pose);
        view.fov = bent_fov(fov_to_xr(&eye.fov));
    })
}

pub(crate) fn get_visibility_mask(
    session: &Session,
    ty: sys::ViewConfigurationType,
    view: u32,
    mask: sys::VisibilityMaskTypeKHR,
    mut out: Out<sys::VisibilityMaskKHR>,
) -> XrResult {
    check_view_configuration(ty)?;
    let out = out.fill()?;
    let eyes = &session.instance.config.profile.eyes;
    let eye = eyes.get(view as usize).ok_or(sys::Result::ERROR_VALIDATION_FAILURE)?;
    let mut eye = eye.clone();
    if session.lock().hides_nothing {
        eye.visible.clear();
    }
    let mesh = match mask {
        sys::VisibilityMaskTypeKHR::HIDDEN_TRIANGLE_MESH => eye.hidden_mesh(),
        sys::VisibilityMaskTypeKHR::VISIBLE_TRIANGLE_MESH => eye.visible_mesh(),
        sys::VisibilityMaskTypeKHR::LINE_LOOP => eye.outline(),
        _ => return Err(sys::Result::ERROR_VALIDATION_FAILURE),
    };
    let vertices: Vec<sys::Vector2f> =
        mesh.vertices.iter().map(|p| sys::Vector2f { x: p.x as f32, y: p.y as f32 }).collect();
    let (vertex_capacity, index_capacity) = (out.vertex_capacity_input, out.index_capacity_input);
    if (vertex_capacity == 0) != (index_capacity == 0) && !vertices.is_empty() {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    // SAFETY: the two counts are fields of the structure that `fill` checked; the application lends room for as many
    // elements as it says.
    let (mut vertex_buffer, mut index_buffer) = unsafe {
        (
            Buffer::new(vertex_capacity, &raw mut out.vertex_count_output, out.vertices),
            Buffer::new(index_capacity, &raw mut out.index_count_output, out.indices),
        )
    };
    let gave_vertices = vertex_buffer.give(&vertices);
    let gave_indices = index_buffer.give(&mesh.indices);
    gave_vertices.and(gave_indices)
}
