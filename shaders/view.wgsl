// One view of a pass, as every pass knows it. Included by them.

// Set when a pipeline is made (see vergence-shaders): loops over it have a constant length.
const VIEW_COUNT: u32 = 0xF1E50001u;

struct View {
    // Scale and offset of the projection: clip.x = x·clip.x + z·clip.y, clip.y = y·clip.z + z·clip.w.
    clip: vec4f,
    // Where the eye is in head coordinates, metres; w: near plane, metres.
    eye_in_head: vec4f,
    // The direction through pixel coordinates (0, 0), of depth 1, and its change per pixel, in head coordinates.
    ray: vec4f,
    ray_per_x: vec4f,
    ray_per_y: vec4f,
}
