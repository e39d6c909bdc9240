// Text: glyph quads from an atlas of signed distances, for all views in one pass.
//
// Frames as in surface.wgsl; `part` is the label (origin at its node, x to the right, y up).

//#include view.wgsl
//#include place.wgsl

struct Views {
    views: array<View, 4>,
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
    var out: Varying;
    out.position = clip_position(position, view_index);
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
    // Ink has depth, so that a runtime that moves pixels by their depth moves it as what it is; the paper has none.
    if (coverage <= 0.0) {
        discard;
    }
    return vec4f(draw.color.rgb, draw.color.a * coverage);
}
