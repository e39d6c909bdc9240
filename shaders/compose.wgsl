// Composition: draws one layer that an application submitted into the picture of one eye.
//
// Eye coordinates: x right, y up, −z forward. The picture's rows go down, as do those of the source.

struct Layer {
    // Source coordinates from eye coordinates: the columns of the rotation; the fourth components together are the place
    // of the eye in source coordinates (used by quads only, metres).
    x: vec4f,
    y: vec4f,
    z: vec4f,
    // Tangents of left, right, up, down of the eye's picture.
    eye: vec4f,
    // Left, right, up, down of the source: tangents for a projection, metres for a quad.
    source: vec4f,
    // Source rectangle in its image: offset and size, in texture coordinates.
    rect: vec4f,
    // Half a texel of the source image in texture coordinates.
    half_texel: vec2f,
    array_layer: u32,
    flags: u32,
}

const QUAD: u32 = 1u;
const IGNORE_ALPHA: u32 = 2u;
const STRAIGHT_ALPHA: u32 = 4u;

@group(0) @binding(0) var source_image: texture_2d_array<f32>;
@group(0) @binding(1) var source_sampler: sampler;
var<immediate> layer: Layer;

struct Varying {
    @builtin(position) position: vec4f,
    // Where in the picture: 0…1 from the upper left corner.
    @location(0) place: vec2f,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Varying {
    // One triangle that covers the picture.
    let place = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return Varying(vec4f(2.0 * place - 1.0, 0.0, 1.0), place);
}

@fragment
fn fragment(in: Varying) -> @location(0) vec4f {
    let tangent = vec2f(mix(layer.eye.x, layer.eye.y, in.place.x), mix(layer.eye.z, layer.eye.w, in.place.y));
    let ray = layer.x.xyz * tangent.x + layer.y.xyz * tangent.y - layer.z.xyz;
    let is_quad = (layer.flags & QUAD) != 0u;
    let eye = vec3f(layer.x.w, layer.y.w, layer.z.w);
    var point = ray.xy / -ray.z;
    if is_quad {
        point = eye.xy - ray.xy * (eye.z / ray.z);
    }
    let uv = vec2f(
        (point.x - layer.source.x) / (layer.source.y - layer.source.x),
        (point.y - layer.source.z) / (layer.source.w - layer.source.z),
    );
    // Only what lies ahead is seen, and a quad only from its front.
    let hit = ray.z < 0.0 && (!is_quad || eye.z > 0.0) && all(uv >= vec2f(0.0)) && all(uv <= vec2f(1.0));
    if !hit {
        discard;
    }
    let low = layer.rect.xy + layer.half_texel;
    let high = layer.rect.xy + layer.rect.zw - layer.half_texel;
    let at = clamp(layer.rect.xy + uv * layer.rect.zw, low, high);
    var color = textureSampleLevel(source_image, source_sampler, at, layer.array_layer, 0.0);
    if (layer.flags & IGNORE_ALPHA) != 0u {
        color.a = 1.0;
    } else if (layer.flags & STRAIGHT_ALPHA) != 0u {
        color = vec4f(color.rgb * color.a, color.a);
    }
    return color;
}
