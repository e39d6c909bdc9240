// Visibility mask: what the lens hides of each view gets the nearest depth, so that nothing is drawn there.
//
// Each vertex belongs to one view; in the others its triangle has no area.

//#include view.wgsl

struct Views {
    views: array<View, 4>,
}

struct Draw {
    // The first view of the pass.
    first_view: u32,
}

@group(0) @binding(0) var<uniform> frame: Views;
var<immediate> draw: Draw;

// xy: where the vertex lies in the plane z = −1 of its eye; z: the index of its view.
@vertex
fn vertex(@location(0) vertex: vec3f, @builtin(view_index) index_in_pass: u32) -> @builtin(position) vec4f {
    let clip = frame.views[index_in_pass].clip;
    let here = u32(vertex.z + 0.5) == index_in_pass + draw.first_view;
    let position = vec4f(vertex.x * clip.x - clip.y, vertex.y * clip.z - clip.w, 1.0, 1.0);
    return select(vec4f(2.0, 2.0, 1.0, 1.0), position, here);
}
