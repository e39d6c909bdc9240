// Where a part stands before each eye, and where a point of it is then seen. Included by passes that declare `frame` (with
// `views` in it) and `place`.

// Where a part stands: three rows of head_from_part for normals (first w: sign of the determinant), then for each
// view three rows of eye_from_part.
struct Place {
    rows: array<vec4f, 15>,
}

// In `Place`: the first row of the first view.
const FIRST_VIEW_ROW: u32 = 3u;

// Where a point of the part is for an eye: reversed depth without a far plane, 1 at the near plane, 0 at infinity.
fn clip_position(position: vec3f, view_index: u32) -> vec4f {
    // A choice among values that are the same for the whole draw is cheaper than an index that differs by view.
    var x = place.rows[FIRST_VIEW_ROW];
    var y = place.rows[FIRST_VIEW_ROW + 1u];
    var z = place.rows[FIRST_VIEW_ROW + 2u];
    var clip = frame.views[0].clip;
    for (var v = 1u; v < VIEW_COUNT; v++) {
        let here = v == view_index;
        x = select(x, place.rows[FIRST_VIEW_ROW + 3u * v], here);
        y = select(y, place.rows[FIRST_VIEW_ROW + 3u * v + 1u], here);
        z = select(z, place.rows[FIRST_VIEW_ROW + 3u * v + 2u], here);
        clip = select(clip, frame.views[v].clip, here);
    }
    let p = vec3f(
        dot(x.xyz, position) + x.w,
        dot(y.xyz, position) + y.w,
        dot(z.xyz, position) + z.w,
    );
    let near = frame.views[0].eye_in_head.w;
    return vec4f(p.x * clip.x + p.z * clip.y, p.y * clip.z + p.z * clip.w, near, -p.z);
}

// Where a point of the part is in head coordinates, which are the first view's.
fn point_in_head(position: vec3f) -> vec3f {
    let x = place.rows[FIRST_VIEW_ROW];
    let y = place.rows[FIRST_VIEW_ROW + 1u];
    let z = place.rows[FIRST_VIEW_ROW + 2u];
    return vec3f(dot(x.xyz, position) + x.w, dot(y.xyz, position) + y.w, dot(z.xyz, position) + z.w);
}
