// Linear-blend skinning: moves vertices by joints once per frame, into the buffer that all views draw from.
//
// Vertices are rows of plain floats: position (3), normal (3), and, where the stride has room, tangent (4).

struct Job {
    // Number of vertices.
    count: u32,
    // Floats per vertex: 3, 6 or 10.
    stride: u32,
    // First float of the source and of the result.
    source: u32,
    result: u32,
    // First vertex in `influences` (two words of joints, then four weights, for each).
    influence: u32,
    // First row in `joints`.
    joint: u32,
}

// Six rows for each joint: three of anchor_from_mesh, three for normals.
@group(0) @binding(0) var<storage, read> joints: array<vec4f>;
@group(0) @binding(1) var<storage, read> influences: array<u32>;
@group(0) @binding(2) var<storage, read> source: array<f32>;
@group(0) @binding(3) var<storage, read_write> result: array<f32>;
var<immediate> job: Job;

@compute @workgroup_size(64)
fn skin(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= job.count) {
        return;
    }
    let influence = 6u * (job.influence + id.x);
    let low = influences[influence];
    let high = influences[influence + 1u];
    let index = vec4u(low & 0xFFFFu, low >> 16u, high & 0xFFFFu, high >> 16u);
    var x = vec4f();
    var y = vec4f();
    var z = vec4f();
    var nx = vec3f();
    var ny = vec3f();
    var nz = vec3f();
    for (var k = 0u; k < 4u; k++) {
        let weight = bitcast<f32>(influences[influence + 2u + k]);
        let joint = job.joint + 6u * index[k];
        x += weight * joints[joint];
        y += weight * joints[joint + 1u];
        z += weight * joints[joint + 2u];
        nx += weight * joints[joint + 3u].xyz;
        ny += weight * joints[joint + 4u].xyz;
        nz += weight * joints[joint + 5u].xyz;
    }
    let origin = job.source + id.x * job.stride;
    let to = job.result + id.x * job.stride;
    let p = vec3f(source[origin], source[origin + 1u], source[origin + 2u]);
    result[to] = dot(x.xyz, p) + x.w;
    result[to + 1u] = dot(y.xyz, p) + y.w;
    result[to + 2u] = dot(z.xyz, p) + z.w;
    if (job.stride >= 6u) {
        let n = vec3f(source[origin + 3u], source[origin + 4u], source[origin + 5u]);
        var turned = vec3f(dot(nx, n), dot(ny, n), dot(nz, n));
        turned *= inverseSqrt(max(dot(turned, turned), 1e-30));
        result[to + 3u] = turned.x;
        result[to + 4u] = turned.y;
        result[to + 5u] = turned.z;
    }
    if (job.stride >= 10u) {
        let t = vec3f(source[origin + 6u], source[origin + 7u], source[origin + 8u]);
        result[to + 6u] = dot(x.xyz, t);
        result[to + 7u] = dot(y.xyz, t);
        result[to + 8u] = dot(z.xyz, t);
        result[to + 9u] = source[origin + 9u];
    }
}
