//! What the eyes never see of a picture, as the runtime says.

use openxr::sys;

use crate::connection::Connection;
use crate::error::{Error, check};

/// More than any mask has.
const MOST_MASK_ELEMENTS: u32 = 1_000_000;

/// What the eyes never see of a picture: triangles on the plane one metre ahead (x right, y up).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HiddenArea {
    /// Metres at distance 1: tangents of the angles from the axis.
    pub vertices: Vec<[f32; 2]>,
    /// Three per triangle.
    pub indices: Vec<u32>,
}

/// What the eye of a view never sees; nothing where the runtime's mesh is none.
pub(crate) fn hidden_area(
    connection: &Connection,
    session: &openxr::Session<openxr::Vulkan>,
    view: u32,
) -> Result<HiddenArea, Error> {
    const CALL: &str = "xrGetVisibilityMaskKHR";
    let Some(extension) = &session.instance().exts().khr_visibility_mask else {
        return Ok(HiddenArea::default());
    };
    let mut mask = sys::VisibilityMaskKHR {
        ty: sys::VisibilityMaskKHR::TYPE,
        next: std::ptr::null_mut(),
        vertex_capacity_input: 0,
        vertex_count_output: 0,
        vertices: std::ptr::null_mut(),
        index_capacity_input: 0,
        index_count_output: 0,
        indices: std::ptr::null_mut(),
    };
    let kind = openxr::VisibilityMaskTypeKHR::HIDDEN_TRIANGLE_MESH;
    let ask = |mask: &mut sys::VisibilityMaskKHR| {
        // SAFETY: the session lives; the arrays are null or have as many elements as is said.
        let result = unsafe {
            (extension.get_visibility_mask)(session.as_raw(), connection.view_configuration, view, kind, mask)
        };
        check(CALL, result)
    };
    ask(&mut mask)?;
    if mask.vertex_count_output.max(mask.index_count_output) > MOST_MASK_ELEMENTS {
        log::warn!("the runtime's visibility mask of view {view} is too large; going on without it");
        return Ok(HiddenArea::default());
    }
    let mut points = vec![openxr::Vector2f::default(); mask.vertex_count_output as usize];
    let mut indices = vec![0u32; mask.index_count_output as usize];
    if points.is_empty() || indices.is_empty() {
        return Ok(HiddenArea::default());
    }
    (mask.vertex_capacity_input, mask.vertices) = (mask.vertex_count_output, points.as_mut_ptr());
    (mask.index_capacity_input, mask.indices) = (mask.index_count_output, indices.as_mut_ptr());
    ask(&mut mask)?;
    points.truncate(mask.vertex_count_output as usize);
    indices.truncate(mask.index_count_output as usize);
    let vertices: Vec<[f32; 2]> = points.iter().map(|v| [v.x, v.y]).collect();
    let is_sound = indices.len().is_multiple_of(3)
        && indices.iter().all(|&index| (index as usize) < vertices.len())
        && vertices.iter().flatten().all(|x| x.is_finite());
    if !is_sound {
        log::warn!("the runtime's visibility mask of view {view} is broken; going on without it");
        return Ok(HiddenArea::default());
    }
    Ok(HiddenArea { vertices, indices })
}
