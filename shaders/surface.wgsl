// Surfaces: every mesh of a scene, lit and textured, for all views in one pass.
//
// Lines between `//#if FLAG` and `//#endif` exist only in variants that set FLAG (vergence-shaders' build script):
// inputs, bindings and texture fetches that a surface does not need are not there at all. `//#include` stands for the
// other file.
//
// Frames: `part` = the part of a mesh that is drawn (origin at its own centre), `eye` = one view, `head` = the
// first view's frame, shared by all views, where shading happens. All matrices were composed in f64 relative to
// the camera: no world coordinate ever reaches this file.

// Set when a pipeline is made (see vergence-shaders): loops over them have a constant length. Lights at infinity come
// first.
const LIGHT_COUNT: u32 = 0xF1E50002u;
const INFINITE_LIGHT_COUNT: u32 = 0xF1E50003u;

const PI: f32 = 3.14159265358979;
// Perceptual roughness below this is drawn as this: the lobe is then a hundredth of a pixel wide, and the powers of
// it below stay far inside of what f32 holds.
const LEAST_ROUGHNESS: f32 = 1e-3;
// How much more than Fresnel at the normal a lobe of any roughness may reflect; kept back from the diffuse part.
const LOBE_MARGIN: f32 = 3e-3;
// Grazing views are shaded as if seen under this cosine.
const LEAST_COSINE: f32 = 1e-4;

//#include view.wgsl
//#if VERTEX
//#include place.wgsl
//#endif

struct Light {
    // xyz·: position in head coordinates (w = 1), or direction towards a light at infinity (w = 0), unit.
    position: vec4f,
    // Linear RGB times intensity; w: 1 / range², 0 where there is none.
    color: vec4f,
    // Where a spot shines to, unit; w: scale of the cone's cosine (0 for other lights).
    axis: vec4f,
    // x: offset of the cone's cosine (1 for other lights).
    cone: vec4f,
}

struct Frame {
    views: array<View, 4>,
    // Irradiance from everywhere; linear RGB.
    ambient: vec4f,
    lights: array<Light, 64>,
}

struct Material {
    base_color: vec4f,
    // w: occlusion strength.
    emissive: vec4f,
    // Metallic-roughness: metallic, roughness, reflectance at normal incidence. Blinn-Phong: specular RGB.
    // w: alpha cutoff.
    law: vec4f,
    // Normal scale; Blinn-Phong: exponent, normalisation.
    more: vec4f,
    // Two rows for each texture (base colour, metallic-roughness, normal, occlusion, emissive): weights of
    // (u₀, v₀, u₁, v₁); offsets follow, two textures per row.
    uv_rows: array<vec4f, 10>,
    uv_offsets: array<vec4f, 3>,
}

// Place and material are windows that move with the draw, and the frame's with the pass, so that every address in the shader is a constant: a
// software device loads such a value once for all lanes.
@group(0) @binding(0) var<uniform> frame: Frame;
//#if VERTEX
@group(0) @binding(1) var<uniform> place: Place;
//#endif
@group(0) @binding(2) var<uniform> material: Material;

//#if BASE_COLOR_TEXTURE
@group(1) @binding(0) var base_color_texture: texture_2d<f32>;
@group(1) @binding(5) var base_color_sampler: sampler;
//#endif
//#if METALLIC_ROUGHNESS_TEXTURE
@group(1) @binding(1) var metallic_roughness_texture: texture_2d<f32>;
@group(1) @binding(6) var metallic_roughness_sampler: sampler;
//#endif
//#if NORMAL_TEXTURE
@group(1) @binding(2) var normal_texture: texture_2d<f32>;
@group(1) @binding(7) var normal_sampler: sampler;
//#endif
//#if OCCLUSION_TEXTURE
@group(1) @binding(3) var occlusion_texture: texture_2d<f32>;
@group(1) @binding(8) var occlusion_sampler: sampler;
//#endif
//#if EMISSIVE_TEXTURE
@group(1) @binding(4) var emissive_texture: texture_2d<f32>;
@group(1) @binding(9) var emissive_sampler: sampler;
//#endif

struct Vertex {
    @location(0) position: vec3f,
//#if LIT
    @location(1) normal: vec3f,
//#endif
//#if NORMAL_TEXTURE
    @location(2) tangent: vec4f,
//#endif
//#if UV
    @location(3) uv: vec2f,
//#endif
//#if MANY_UVS
    @location(4) uv1: vec2f,
//#endif
//#if VERTEX_COLORS
    @location(5) color: vec4f,
//#endif
}

struct Varying {
    @builtin(position) position: vec4f,
//#if LIT
    @location(1) normal: vec3f,
//#endif
//#if NORMAL_TEXTURE
    @location(2) tangent: vec4f,
//#endif
//#if UV
    @location(3) uv: vec2f,
//#endif
//#if MANY_UVS
    @location(4) uv1: vec2f,
//#endif
//#if VERTEX_COLORS
    @location(5) color: vec4f,
//#endif
//#if HANDED_ON
    // Where the point is, in head coordinates; the eye is at their origin.
    @location(6) in_head: vec3f,
    @location(7) @interpolate(flat) base_color: vec4f,
    @location(8) @interpolate(flat) emissive: vec4f,
    @location(9) @interpolate(flat) law: vec4f,
    @location(10) @interpolate(flat) ambient: vec4f,
    @location(11) @interpolate(flat) to_first_light: vec4f,
    @location(12) @interpolate(flat) first_light_color: vec4f,
//#endif
}

//#if VERTEX
@vertex
fn vertex(in: Vertex, @builtin(view_index) view_index: u32) -> Varying {
    var out: Varying;
    out.position = clip_position(in.position, view_index);
//#if LIT
    let nx = place.rows[0];
    let ny = place.rows[1];
    let nz = place.rows[2];
    out.normal = vec3f(dot(nx.xyz, in.normal), dot(ny.xyz, in.normal), dot(nz.xyz, in.normal));
//#endif
//#if NORMAL_TEXTURE
    // Tangents go with the surface. The rows above are those of the first view, which is the head.
    let tx = place.rows[FIRST_VIEW_ROW].xyz;
    let ty = place.rows[FIRST_VIEW_ROW + 1u].xyz;
    let tz = place.rows[FIRST_VIEW_ROW + 2u].xyz;
    let t = vec3f(dot(tx, in.tangent.xyz), dot(ty, in.tangent.xyz), dot(tz, in.tangent.xyz));
    // Unit length for both: the bitangent is their cross product.
    out.tangent = vec4f(t * inverseSqrt(max(dot(t, t), 1e-30)), in.tangent.w * nx.w);
    out.normal = out.normal * inverseSqrt(max(dot(out.normal, out.normal), 1e-30));
//#endif
//#if UV
    out.uv = in.uv;
//#endif
//#if MANY_UVS
    out.uv1 = in.uv1;
//#endif
//#if VERTEX_COLORS
    out.color = in.color;
//#endif
//#if HANDED_ON
    // What is the same for the whole draw is read here, a few times per triangle: a software device reads a uniform value
    // lane by lane, which costs the fragment stage as much as all of its arithmetic. For passes of one view.
    out.in_head = point_in_head(in.position);
    out.base_color = material.base_color;
    out.emissive = material.emissive;
    out.law = material.law;
    out.ambient = frame.ambient;
    out.to_first_light = frame.lights[0].position;
    out.first_light_color = frame.lights[0].color;
//#endif
    return out;
}
//#endif

//#if FRAGMENT
//#if MANY_UVS
// Texture coordinates of texture `i`: any affine function of both sets.
fn texture_uv(i: u32, uv: vec4f) -> vec2f {
    let offsets = material.uv_offsets[i / 2u];
    let offset = select(offsets.xy, offsets.zw, (i & 1u) == 1u);
    let u = dot(material.uv_rows[2u * i], uv);
    let v = dot(material.uv_rows[2u * i + 1u], uv);
    return vec2f(u, v) + offset;
}
//#endif

//#if LIT
fn unit(v: vec3f) -> vec3f {
    return v * inverseSqrt(max(dot(v, v), 1e-30));
}

// A point of a surface, as seen by an eye; all directions unit, in head coordinates.
struct Seen {
    normal: vec3f,
    to_eye: vec3f,
    nv: f32,
    // What is reflected in all directions alike.
    diffuse: vec3f,
//#if METALLIC_ROUGHNESS
    f0: vec3f,
    alpha: f32,
    alpha2: f32,
    smith_v: f32,
//#endif
//#if BLINN_PHONG
    lobe: vec3f,
    exponent: f32,
//#endif
}

// The part of light from `to_light` that goes to the eye; `nl`: the cosine at which it falls.
fn reflected(seen: Seen, to_light: vec3f, nl: f32) -> vec3f {
    // The half vector without its length: h2 is its square.
    let half_way = to_light + seen.to_eye;
    let h2 = max(dot(half_way, half_way), 1e-8);
    let nh = dot(seen.normal, half_way);
//#if METALLIC_ROUGHNESS
    // GGX with height-correlated Smith (Heitz 2014), over one division: at most 1 / (alpha2 · 1e-7) = 1e19.
    // |n × h|² instead of 1 − (n·h)²: no cancellation.
    let away = cross(seen.normal, half_way);
    let width = max(nh * nh * seen.alpha2 + dot(away, away), 1e-13);
    let smith_l = sqrt(nl * nl * (1.0 - seen.alpha2) + seen.alpha2);
    let smith = max(nl * seen.smith_v + seen.nv * smith_l, 1e-7);
    let peak = seen.alpha * h2;
    let lobe = (peak * peak * (0.5 / PI)) / (width * width * smith);
    let grazing = 1.0 - min(0.5 * sqrt(h2), 1.0);
    let grazing2 = grazing * grazing;
    let fresnel = seen.f0 + (1.0 - seen.f0) * (grazing2 * grazing2 * grazing);
    return seen.diffuse + fresnel * lobe;
//#endif
//#if BLINN_PHONG
    let cosine2 = clamp(nh * nh / h2, 1e-12, 1.0);
    return seen.diffuse + seen.lobe * pow(cosine2, 0.5 * seen.exponent);
//#endif
}
//#endif

//#if BOUNDED_FOOTPRINT
// Mesa's software device walks over every texel that an anisotropic footprint covers, counting in f32. Beside an edge, where the
// neighbouring pixel lies behind the horizon of the triangle's plane, coordinates and their steps have any size: it would walk for
// hours, or, where adding 1 changes nothing, for ever. What is no number is 0.
const FARTHEST: f32 = 512.0;

// From one pixel to the next at most once through the texture: that is its mean already.
fn bounded(change: vec2f) -> vec2f {
    return select(vec2f(0.0), clamp(change, vec2f(-1.0), vec2f(1.0)), abs(change) <= vec2f(3e38));
}

// A coordinate that is far off, taken back by a multiple of 2: the same place, also of a texture that is mirrored.
fn near(uv: vec2f) -> vec2f {
    let wrapped = select(uv, uv - 2.0 * floor(0.5 * uv), abs(uv) > vec2f(FARTHEST));
    return select(vec2f(0.0), wrapped, abs(uv) <= vec2f(3e38));
}
//#endif

@fragment
fn fragment(
    in: Varying,
//#if LIT
    @builtin(front_facing) front_facing: bool,
    @builtin(view_index) view_index: u32,
//#endif
) -> @location(0) vec4f {
//#if MANY_UVS
    let uvs = vec4f(in.uv, in.uv1);
    let uv_base_color = texture_uv(0u, uvs);
    let uv_metallic_roughness = texture_uv(1u, uvs);
    let uv_normal = texture_uv(2u, uvs);
    let uv_occlusion = texture_uv(3u, uvs);
    let uv_emissive = texture_uv(4u, uvs);
//#endif
//#if ONE_UV
    let uv_base_color = in.uv;
    let uv_metallic_roughness = in.uv;
    let uv_normal = in.uv;
    let uv_occlusion = in.uv;
    let uv_emissive = in.uv;
//#endif
//#if HANDED_ON
    var base = in.base_color;
    let material_emissive = in.emissive;
    let law = in.law;
    let everywhere_light = in.ambient.rgb;
//#endif
//#if LOOKED_UP
    var base = material.base_color;
    let material_emissive = material.emissive;
    let law = material.law;
    let everywhere_light = frame.ambient.rgb;
//#endif
//#if BASE_COLOR_TEXTURE
//#if ANY_FOOTPRINT
    base *= textureSample(base_color_texture, base_color_sampler, uv_base_color);
//#endif
//#if BOUNDED_FOOTPRINT
    base *= textureSampleGrad(base_color_texture, base_color_sampler, near(uv_base_color), bounded(dpdx(uv_base_color)), bounded(dpdy(uv_base_color)));
//#endif
//#endif
//#if VERTEX_COLORS
    base *= in.color;
//#endif
//#if METALLIC_ROUGHNESS_TEXTURE
//#if ANY_FOOTPRINT
    let metallic_roughness =
        textureSample(metallic_roughness_texture, metallic_roughness_sampler, uv_metallic_roughness).bg;
//#endif
//#if BOUNDED_FOOTPRINT
    let metallic_roughness =
        textureSampleGrad(metallic_roughness_texture, metallic_roughness_sampler, near(uv_metallic_roughness), bounded(dpdx(uv_metallic_roughness)), bounded(dpdy(uv_metallic_roughness))).bg;
//#endif
//#endif
//#if NORMAL_TEXTURE
//#if ANY_FOOTPRINT
    var bump = textureSample(normal_texture, normal_sampler, uv_normal).xyz * 2.0 - 1.0;
//#endif
//#if BOUNDED_FOOTPRINT
    var bump = textureSampleGrad(normal_texture, normal_sampler, near(uv_normal), bounded(dpdx(uv_normal)), bounded(dpdy(uv_normal))).xyz * 2.0 - 1.0;
//#endif
//#endif
//#if OCCLUSION_TEXTURE
//#if ANY_FOOTPRINT
    let open = textureSample(occlusion_texture, occlusion_sampler, uv_occlusion).r;
//#endif
//#if BOUNDED_FOOTPRINT
    let open = textureSampleGrad(occlusion_texture, occlusion_sampler, near(uv_occlusion), bounded(dpdx(uv_occlusion)), bounded(dpdy(uv_occlusion))).r;
//#endif
//#endif
//#if EMISSIVE_TEXTURE
//#if ANY_FOOTPRINT
    let glow = textureSample(emissive_texture, emissive_sampler, uv_emissive).rgb;
//#endif
//#if BOUNDED_FOOTPRINT
    let glow = textureSampleGrad(emissive_texture, emissive_sampler, near(uv_emissive), bounded(dpdx(uv_emissive)), bounded(dpdy(uv_emissive))).rgb;
//#endif
//#endif
//#if MASK
    if (base.a < law.w) {
        discard;
    }
//#endif
//#if UNLIT
    var color = base.rgb;
//#endif
//#if LIT
//#if HANDED_ON
    let p = in.in_head;
    let to_eye = -unit(p);
//#endif
//#if LOOKED_UP
    var eye = frame.views[0].eye_in_head.xyz;
    var ray = frame.views[0].ray.xyz;
    var ray_per_x = frame.views[0].ray_per_x.xyz;
    var ray_per_y = frame.views[0].ray_per_y.xyz;
    for (var v = 1u; v < VIEW_COUNT; v++) {
        let here = v == view_index;
        eye = select(eye, frame.views[v].eye_in_head.xyz, here);
        ray = select(ray, frame.views[v].ray.xyz, here);
        ray_per_x = select(ray_per_x, frame.views[v].ray_per_x.xyz, here);
        ray_per_y = select(ray_per_y, frame.views[v].ray_per_y.xyz, here);
    }
    // The point that this pixel shows: position.w is 1 / depth.
    let along = ray + in.position.x * ray_per_x + in.position.y * ray_per_y;
    let p = eye + along * (1.0 / in.position.w);
    let to_eye = -unit(along);
//#endif
//#if NORMAL_TEXTURE
    bump = vec3f(bump.xy * material.more.x, bump.z);
    let bitangent = cross(in.normal, in.tangent.xyz) * in.tangent.w;
    var normal = unit(in.tangent.xyz * bump.x + bitangent * bump.y + in.normal * bump.z);
//#endif
//#if SMOOTH
    var normal = unit(in.normal);
//#endif
    normal = select(-normal, normal, front_facing);
    let nv = max(dot(normal, to_eye), LEAST_COSINE);
//#if METALLIC_ROUGHNESS
    var metallic = law.x;
    var roughness = law.y;
//#if METALLIC_ROUGHNESS_TEXTURE
    metallic *= metallic_roughness.x;
    roughness *= metallic_roughness.y;
//#endif
    roughness = max(roughness, LEAST_ROUGHNESS);
    let alpha = roughness * roughness;
    let alpha2 = alpha * alpha;
    let f0 = mix(vec3f(law.z), base.rgb, metallic);
    let diffuse = base.rgb * ((1.0 - metallic) * (1.0 / PI));
    let smith_v = sqrt(nv * nv * (1.0 - alpha2) + alpha2);
    // What is reflected of the same light from everywhere: Fresnel at the normal, less for rough surfaces (Lagarde 2011).
    let rim = 1.0 - nv;
    let rim2 = rim * rim;
    let everywhere = f0 + (max(vec3f(1.0 - roughness), f0) - f0) * (rim2 * rim2 * rim);
    var ambient = diffuse + everywhere * (vec3f(1.0 / PI) - diffuse);
    // What the lobe reflects towards this eye, of light from everywhere, is not left for the diffuse part: Fresnel at the
    // normal and a little more. Once per pixel, and cheaper than Fresnel at each half-way vector, which alone would
    // give out up to 15 % more light than comes in (the white furnace of tests/extremes).
    let taken = f0 + (1.0 - f0) * (rim2 * rim2 * rim) + LOBE_MARGIN;
    let left = diffuse * max(1.0 - taken, vec3f(0.0));
//#endif
//#if BLINN_PHONG
    let diffuse = base.rgb * (1.0 / PI);
    var ambient = diffuse;
    let exponent = material.more.y;
    let lobe = law.xyz * material.more.z;
//#endif
//#if OCCLUSION_TEXTURE
    ambient *= 1.0 + material_emissive.w * (open - 1.0);
//#endif
    var color = everywhere_light * ambient;
    let seen = Seen(
        normal,
        to_eye,
        nv,
//#if METALLIC_ROUGHNESS
        left,
        f0,
        alpha,
        alpha2,
        smith_v,
//#endif
//#if BLINN_PHONG
        diffuse,
        lobe,
        exponent,
//#endif
    );
    for (var i = 0u; i < INFINITE_LIGHT_COUNT; i++) {
//#if HANDED_ON
        var to_light = in.to_first_light.xyz;
        var light_color = in.first_light_color.rgb;
        if (i > 0u) {
            to_light = frame.lights[i].position.xyz;
            light_color = frame.lights[i].color.rgb;
        }
//#endif
//#if LOOKED_UP
        let to_light = frame.lights[i].position.xyz;
        let light_color = frame.lights[i].color.rgb;
//#endif
        let nl = clamp(dot(normal, to_light), 0.0, 1.0);
        color += reflected(seen, to_light, nl) * light_color * nl;
    }
    for (var i = INFINITE_LIGHT_COUNT; i < LIGHT_COUNT; i++) {
        // One formula for points and spots: without a cone its factor is 1, without a range the window's.
        let light_color = frame.lights[i].color;
        let axis = frame.lights[i].axis;
        let offset = frame.lights[i].position.xyz - p;
        let distance2 = max(dot(offset, offset), 1e-8);
        let inverse = inverseSqrt(distance2);
        let to_light = offset * inverse;
        let reach = distance2 * light_color.w;
        let window = clamp(1.0 - reach * reach, 0.0, 1.0);
        let cone = clamp(-dot(axis.xyz, to_light) * axis.w + frame.lights[i].cone.x, 0.0, 1.0);
        let nl = clamp(dot(normal, to_light), 0.0, 1.0);
        let fades = nl * inverse * inverse * window * cone * cone;
        color += reflected(seen, to_light, nl) * light_color.rgb * fades;
    }
//#if EMISSIVE_TEXTURE
    color += material_emissive.rgb * glow;
//#endif
//#if EMISSIVE_FACTOR
    color += material_emissive.rgb;
//#endif
    // A mirror of the sun is bright but finite.
    color = min(color, vec3f(65504.0));
//#endif
//#if BLEND
    return vec4f(color, base.a);
//#endif
//#if SOLID
    return vec4f(color, 1.0);
//#endif
}
//#endif
