// Text: glyph quads from an atlas of signed distances, for all views in one pass.
//
// Frames as in surface.wgsl; `part` is the label (origin at its node, x to the right, y up).

const VIEW_COUNT: u32 = 0xF1E50001u;

struct View {
    clip: vec4f,
    eye_in_head: vec4f,
    ray: vec4f,
    ray_per_x: vec4f,
    ray_per_y: vec4f,
}

struct Views {
    views: array<View, 4>,
}

// As in surface.wgsl.
struct Place {
    rows: array<vec4f, 15>,
}

struct Draw {
    // Linear RGBA.
    color: vec4f,
    // Size of the atlas in texels.
    atlas_width: f32,
    atlas_height: f32,
    // (value − edge) times this is a signed distance in texels.
    texels_per_value: f32,
}

@group(0) @binding(0) var<uniform> frame: Views;
@group(0) @binding(1) var<uniform> place: Place;
@group(1) @binding(0) var atlas: texture_2d<f32>;
@group(1) @binding(1) var atlas_sampler: sampler;
var<immediate> draw: Draw;

struct Varying {
    @builtin(position) position: vec4f,
    @location(0) uv: vec2f,
}

@vertex
fn vertex(
    @location(0) position: vec3f,
    @location(1) uv: vec2f,
    @builtin(view_index) view_index: u32,
) -> Varying {
    const first = 3u;
    var x = place.rows[first];
    var y = place.rows[first + 1u];
    var z = place.rows[first + 2u];
    var clip = frame.views[0].clip;
    for (var v = 1u; v < VIEW_COUNT; v++) {
        let here = v == view_index;
        x = select(x, place.rows[first + 3u * v], here);
        y = select(y, place.rows[first + 3u * v + 1u], here);
        z = select(z, place.rows[first + 3u * v + 2u], here);
        clip = select(clip, frame.views[v].clip, here);
    }
    let p = vec3f(
        dot(x.xyz, position) + x.w,
        dot(y.xyz, position) + y.w,
        dot(z.xyz, position) + z.w,
    );
    var out: Varying;
    let near = frame.views[0].eye_in_head.w;
    out.position = vec4f(p.x * clip.x + p.z * clip.y, p.y * clip.z + p.z * clip.w, near, -p.z);
    out.uv = uv;
    return out;
}

@fragment
fn fragment(in: Varying) -> @location(0) vec4f {
    let distance_texels = (textureSample(atlas, atlas_sampler, in.uv).r - 0.5) * draw.texels_per_value;
    // Texels per pixel here: the edge is smeared over exactly one pixel, whatever the size and the slant.
    let texel = in.uv * vec2f(draw.atlas_width, draw.atlas_height);
    let dx = dpdx(texel);
    let dy = dpdy(texel);
    let texels_per_pixel = sqrt(max(0.5 * (dot(dx, dx) + dot(dy, dy)), 1e-12));
    let coverage = clamp(distance_texels / texels_per_pixel + 0.5, 0.0, 1.0);
    return vec4f(draw.color.rgb, draw.color.a * coverage);
}
