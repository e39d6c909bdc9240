//! Real files load, with the warnings that they deserve; a scene reads nothing outside of its folder; and laws that
//! tie files to each other.
#![allow(clippy::unwrap_used)] // helpers of tests are tests, too

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use vergence_scene::animation::Sample;
use vergence_scene::model::{Interpolation, Local, WorldTransforms};
use vergence_scene::{Error, Limits, Scene, load};
use vergence_time::Span;

fn small(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// The scenes of `VERGENCE_DATA`; `None`, said, where it is not set.
fn data(name: &str) -> Option<PathBuf> {
    let Some(data) = std::env::var_os("VERGENCE_DATA") else {
        let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
        assert!(
            !required.split(',').any(|word| word == "data"),
            "VERGENCE_REQUIRE asks for data, found no VERGENCE_DATA"
        );
        eprintln!("skipped: no VERGENCE_DATA");
        return None;
    };
    Some(Path::new(&data).join("scenes").join(name))
}

#[track_caller]
fn loaded(path: &Path) -> Scene {
    load(path, &Limits::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn triangles(scene: &Scene) -> usize {
    let shown = scene.nodes.iter().filter_map(|node| node.mesh);
    shown.flat_map(|mesh| &scene.meshes[mesh].primitives).map(|primitive| primitive.indices.len() / 3).sum()
}

const MORPH: &str = "morph targets are not drawn yet: their meshes keep their base shape";

/// Name, triangles drawn, images, skins, clips, warnings.
type Expected = (&'static str, usize, usize, usize, usize, &'static [&'static str]);

const FILES: &[Expected] = &[
    ("gltf/AlphaBlendModeTest.glb", 61, 4, 0, 0, &[]),
    ("gltf/AnimatedMorphCube.glb", 12, 0, 0, 0, &[MORPH]),
    ("gltf/Avocado/Avocado.gltf", 682, 3, 0, 0, &[]),
    ("gltf/Box.glb", 12, 0, 0, 0, &[]),
    ("gltf/BoxInterleaved.glb", 12, 0, 0, 0, &[]),
    ("gltf/CesiumMan.glb", 4672, 1, 1, 1, &[]),
    ("gltf/CornellBox.glb", 36, 0, 0, 0, &[]),
    ("gltf/Fox.glb", 576, 1, 1, 3, &[]),
    ("gltf/InterpolationTest.glb", 110, 1, 0, 9, &[]),
    ("gltf/MetalRoughSpheresNoTextures.glb", 1_040_409, 0, 0, 0, &[]),
    ("gltf/MorphPrimitivesTest.glb", 32, 1, 0, 0, &[MORPH]),
    ("gltf/MorphStressTest.glb", 2412, 3, 0, 0, &[MORPH]),
    ("gltf/NormalTangentTest.glb", 7774, 3, 0, 0, &[]),
    ("gltf/RiggedFigure.glb", 256, 0, 1, 1, &[]),
    ("gltf/SimpleSkin.gltf", 8, 0, 1, 1, &[]),
    ("gltf/SimpleSparseAccessor/SimpleSparseAccessor.gltf", 12, 0, 0, 0, &[]),
    ("gltf/Suzanne/Suzanne.gltf", 3936, 2, 0, 0, &[]),
    ("gltf/TextureLinearInterpolationTest.glb", 642, 2, 0, 0, &[]),
    ("gltf/TextureSettingsTest.glb", 72, 3, 0, 0, &[]),
    ("gltf/TextureTransformTest/TextureTransformTest.gltf", 24, 5, 0, 0, &[]),
    ("gltf/VertexColorTest.glb", 36, 2, 0, 0, &[]),
    ("gltf/colonnade.glb", 190_708, 1, 0, 0, &[]),
    ("mesh/spot/spot_control_mesh.obj", 372, 0, 0, 0, &[]),
    ("mesh/spot/spot_triangulated.obj", 5856, 0, 0, 0, &[]),
    ("mesh/spot_94k.ply", 93_696, 0, 0, 0, &[]),
    ("mesh/spider/spider.obj", 1368, 4, 0, 0, &[]),
    ("mesh/obj_edge/box_longline.obj", 944, 0, 0, 0, &[]),
    ("mesh/obj_edge/concave_polygon.obj", 64, 0, 0, 0, &[]),
    ("mesh/obj_edge/cube_binary_crlf_header.ply", 12, 0, 0, 0, &[]),
    ("mesh/obj_edge/cube_with_vertexcolors.obj", 12, 0, 0, 0, &[]),
    ("mesh/obj_edge/number_formats.obj", 1, 0, 0, 0, &["numbers such as 3.1+e2 are read as 3.1e+2"]),
    ("mesh/obj_edge/testmixed.obj", 12, 0, 0, 0, &["lines are not drawn", "points are not drawn"]),
];

#[test]
fn all_files_of_the_data_set_load_with_the_warnings_they_deserve() {
    let Some(root) = data("") else { return };
    assert_eq!(FILES.iter().filter(|file| file.0.starts_with("gltf")).count(), 22);
    for &(name, count, images, skins, clips, warnings) in FILES {
        let scene = loaded(&root.join(name));
        println!("{name}: {} triangles, warnings: {:?}", triangles(&scene), scene.warnings);
        assert_eq!(triangles(&scene), count, "{name}");
        assert_eq!(
            (scene.images.len(), scene.skins.len(), scene.animations.len()),
            (images, skins, clips),
            "{name}"
        );
        assert_eq!(scene.warnings, warnings, "{name}");
    }
}

#[test]
fn an_interleaved_box_is_a_box() {
    let (plain, interleaved) = (loaded(&small("Box.glb")), loaded(&small("BoxInterleaved.glb")));
    let corners = |scene: &Scene| {
        let primitive = &scene.meshes[0].primitives[0];
        let mut corners: Vec<String> = primitive
            .indices
            .iter()
            .map(|&i| format!("{:?} {:?}", primitive.positions[i as usize], primitive.normals[i as usize]))
            .collect();
        corners.sort();
        corners
    };
    assert_eq!(corners(&plain), corners(&interleaved));
    assert_eq!(corners(&plain).len(), 36);
}

/// A sparse accessor over zeros or over a dense one gives what a dense one with the same values would.
#[test]
fn sparse_equals_dense() {
    let folder = tempfile::tempdir().unwrap();
    let positions: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];
    let moved: [f32; 6] = [5.0, 6.0, 7.0, -1.0, 2.0, 0.5];
    let mut bytes: Vec<u8> = positions.iter().chain(&moved).flat_map(|f| f.to_le_bytes()).collect();
    bytes.extend([1, 0, 3, 0]);
    bytes.extend([0, 1, 2, 0, 2, 3]);
    std::fs::write(folder.path().join("data.bin"), &bytes).unwrap();
    let sparse =
        r#","sparse":{"count":2,"indices":{"bufferView":2,"componentType":5123},"values":{"bufferView":1}}"#;
    let file = |name: &str, accessor: &str| {
        let text = format!(
            r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"mesh":0}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
            "accessors":[{{"componentType":5126,"count":4,"type":"VEC3"{accessor}}},
                {{"bufferView":3,"componentType":5121,"count":6,"type":"SCALAR"}}],
            "bufferViews":[{{"buffer":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":24}},
                {{"buffer":0,"byteOffset":72,"byteLength":4}},{{"buffer":0,"byteOffset":76,"byteLength":6}}],
            "buffers":[{{"uri":"data.bin","byteLength":82}}]}}"#
        );
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let scene = loaded(&path);
        let primitive = &scene.meshes[0].primitives[0];
        // Flat normals give each corner its own vertex.
        primitive.indices.iter().map(|&i| primitive.positions[i as usize]).collect::<Vec<_>>()
    };
    let corner = |i: usize, over: bool| match (i, over) {
        (1, _) => [5.0, 6.0, 7.0],
        (3, _) => [-1.0, 2.0, 0.5],
        (_, false) => [0.0; 3],
        (i, true) => [positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]],
    };
    for (over, view) in [(true, r#","bufferView":0"#), (false, "")] {
        let expected: Vec<[f32; 3]> = [0, 1, 2, 0, 2, 3].map(|i| corner(i, over)).into();
        assert_eq!(file("sparse.gltf", &format!("{view}{sparse}")), expected);
    }
}

/// Values that can be checked by hand: the upper joint turns about z, and the weights fade from one to the other.
#[test]
fn a_simple_skin_has_its_weights_and_turns() {
    let scene = loaded(&small("SimpleSkin.gltf"));
    let primitive = &scene.meshes[0].primitives[0];
    for (position, weights) in primitive.positions.iter().zip(&primitive.weights) {
        assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        // From the lower joint at y = 0.5 to the upper one at 1.5.
        assert!((weights[1] - (position[1] * 0.5)).abs() < 0.3, "{position:?} {weights:?}");
    }
    let mut locals = Vec::new();
    scene.animate(Span::from_millis(1000), &mut locals);
    let joint = scene.skins[0].joints[1];
    match locals[joint] {
        Local::Trs(trs) => assert!((trs.rotation.angle() - std::f64::consts::FRAC_PI_2).abs() < 1e-3),
        other => panic!("{other:?}"),
    }
    // In the bind pose a joint's matrix undoes where the joint is.
    let world = WorldTransforms::at_rest(&scene);
    for (&joint, joint_from_mesh) in scene.skins[0].joints.iter().zip(&scene.skins[0].joint_from_mesh) {
        let product = world.world_from_node[joint] * *joint_from_mesh;
        assert!((product.linear - nalgebra::Matrix3::identity()).norm() < 1e-6);
        assert!(product.translation.norm() < 1e-6);
    }
}

/// Weights as files give them: bytes that do not sum to one, and none at all.
#[test]
fn weights_are_normalised_and_missing_ones_reported() {
    let folder = tempfile::tempdir().unwrap();
    let positions: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut bytes: Vec<u8> = positions.iter().flat_map(|f| f.to_le_bytes()).collect();
    bytes.extend([0, 1, 0, 9, 1, 0, 0, 0, 0, 0, 0, 0]);
    bytes.extend([100, 100, 0, 0, 255, 0, 0, 0, 0, 0, 0, 0]);
    std::fs::write(folder.path().join("data.bin"), &bytes).unwrap();
    let path = folder.path().join("skin.gltf");
    std::fs::write(
        &path,
        r#"{"asset":{"version":"2.0"},"nodes":[{"mesh":0,"skin":0},{},{}],"skins":[{"joints":[1,2]}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0,"JOINTS_0":1,"WEIGHTS_0":2}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
            {"bufferView":1,"componentType":5121,"count":3,"type":"VEC4"},
            {"bufferView":2,"componentType":5121,"normalized":true,"count":3,"type":"VEC4"}],
        "bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":12},
            {"buffer":0,"byteOffset":48,"byteLength":12}],
        "buffers":[{"uri":"data.bin","byteLength":60}]}"#,
    )
    .unwrap();
    let scene = loaded(&path);
    let primitive = &scene.meshes[0].primitives[0];
    assert_eq!(primitive.weights, [[0.5, 0.5, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]);
    // Joint 9 does not exist, but has no weight either.
    assert_eq!(primitive.joints, [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]]);
    assert_eq!(scene.warnings.len(), 1, "{:?}", scene.warnings);
    assert!(scene.warnings[0].contains("1 vertices have no weight"), "{:?}", scene.warnings);
}

/// Row 17 of the extremes: keys come back, rotations stay of unit length, and cubic splines are smooth across keys
/// where their tangents agree.
#[test]
fn the_interpolation_test_obeys_the_laws_of_animation() {
    let Some(path) = data("gltf/InterpolationTest.glb") else { return };
    let scene = loaded(&path);
    assert_eq!(scene.playing.len(), 9, "the clips move different cubes");
    let coordinates = |sample: Option<Sample>| match sample {
        Some(Sample::Translation(v) | Sample::Scale(v)) => v.push(0.0),
        Some(Sample::Rotation(q)) => {
            assert!((q.norm() - 1.0).abs() < 1e-6);
            q.coords
        }
        None => panic!("no sample"),
    };
    let mut smooth = 0;
    for track in scene.animations.iter().flat_map(|clip| &clip.tracks) {
        let times: Vec<f64> = track.times_secs.iter().map(|&t| f64::from(t)).collect();
        let at = |t: f64| coordinates(track.sample(t));
        assert_eq!(at(times[0] - 1.0), at(times[0]));
        assert_eq!(at(times[times.len() - 1] + 1.0), at(times[times.len() - 1]));
        for i in 0..=1000 {
            let t = times[0] + (times[times.len() - 1] - times[0]) * f64::from(i) / 1000.0;
            assert!(at(t).iter().all(|c| c.is_finite()));
        }
        for &key in &times[1..times.len() - 1] {
            let h = 1e-6;
            let (before, after) = ((at(key) - at(key - h)) / h, (at(key + h) - at(key)) / h);
            let speed = before.norm().max(after.norm());
            match track.interpolation {
                Interpolation::Step => assert_eq!(at(key + h), at(key)),
                Interpolation::CubicSpline if (before - after).norm() <= 1e-4 * speed.max(1.0) => smooth += 1,
                _ => {}
            }
        }
    }
    assert!(smooth >= 3, "{smooth} smooth keys");
}

/// MikkTSpace gives the tangents that the file's author computed with it.
#[test]
fn computed_tangents_agree_with_those_of_a_file() {
    let Some(path) = data("gltf/Avocado/Avocado.gltf") else { return };
    let folder = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(path.parent().unwrap()).unwrap() {
        let entry = entry.unwrap().path();
        std::fs::copy(&entry, folder.path().join(entry.file_name().unwrap())).unwrap();
    }
    let text = std::fs::read_to_string(&path).unwrap();
    let without = folder.path().join("without.gltf");
    std::fs::write(&without, text.replace("\"TANGENT\"", "\"_TANGENT\"")).unwrap();
    let (given, computed) = (loaded(&path), loaded(&without));
    let corners = |scene: &Scene| -> Vec<[f32; 4]> {
        let primitive = &scene.meshes[0].primitives[0];
        primitive.indices.iter().map(|&i| primitive.tangents[i as usize]).collect()
    };
    let (given, computed) = (corners(&given), corners(&computed));
    let agrees = |(a, b): &(&[f32; 4], &[f32; 4])| {
        let cosine = Vector3::new(a[0], a[1], a[2]).dot(&Vector3::new(b[0], b[1], b[2]));
        cosine > 0.95 && a[3] == b[3]
    };
    let share = given.iter().zip(&computed).filter(agrees).count() as f64 / given.len() as f64;
    assert!(share > 0.97, "{:.1} % agree", 100.0 * share);
}

#[test]
fn tangents_are_computed_where_a_normal_map_needs_them() {
    let Some(path) = data("gltf/NormalTangentTest.glb") else { return };
    let scene = loaded(&path);
    for primitive in scene.meshes.iter().flat_map(|mesh| &mesh.primitives) {
        assert_eq!(primitive.tangents.len(), primitive.positions.len());
        let across =
            |(t, n): (&[f32; 4], &[f32; 3])| Vector3::new(t[0], t[1], t[2]).dot(&Vector3::from(*n)).abs();
        let worst = primitive.tangents.iter().zip(&primitive.normals).map(across).fold(0.0f32, f32::max);
        assert!(worst < 1e-3, "tangents lie in the surface: {worst}");
    }
}

/// One cube in three formats: the same shape.
#[test]
fn ply_in_either_byte_order_and_obj_say_the_same() {
    let (little, big) = (loaded(&small("little.ply")), loaded(&small("big.ply")));
    let (a, b) = (&little.meshes[0].primitives[0], &big.meshes[0].primitives[0]);
    assert_eq!(
        (&a.positions, &a.normals, &a.uv0, &a.indices),
        (&b.positions, &b.normals, &b.uv0, &b.indices)
    );
    assert_eq!(a.indices.len() / 3, 4, "a concave pentagon and a triangle");
    assert_eq!(little.warnings, ["PLY elements \"edge\" are not drawn"]);
    let ascii = loaded(&small("ascii.ply"));
    assert_eq!(triangles(&ascii), 3);
    assert_eq!(ascii.meshes[0].primitives[0].colors[0], [1.0, 0.0, 0.0, 1.0]);
}

#[test]
fn an_obj_with_everything_reads_as_meant() {
    let scene = loaded(&small("house.obj"));
    assert_eq!(scene.nodes[0].name, "house");
    let names: Vec<&str> =
        scene.meshes[0].primitives.iter().map(|p| scene.materials[p.material].name.as_str()).collect();
    assert_eq!(names, ["wall", "roof"]);
    assert_eq!(triangles(&scene), 3 + 1 + 2);
    assert_eq!((scene.images.len(), scene.images[0].width), (1, 16));
    assert_eq!(scene.warnings, ["numbers with a decimal comma are read as if it were a point"]);
    // The lower left corner of the texture is at (0, 1) in the model.
    assert_eq!(scene.meshes[0].primitives[0].uv0[0], [0.0, 1.0]);
}

#[test]
fn a_scene_file_reads_as_meant() {
    let scene = loaded(&small("scene.toml"));
    let place = |name: &str| {
        let node = scene.nodes.iter().position(|node| node.name == name).unwrap();
        WorldTransforms::at_rest(&scene).world_from_node[node]
    };
    assert_eq!(place("tile").translation.x, 1e7);
    assert_eq!(scene.labels.len(), 1);
    let names: Vec<&str> = scene.touchables.iter().map(|t| t.name.as_str()).collect();
    assert_eq!(names, ["lamp", "house"]);
    assert!(scene.world_from_start.is_some_and(|start| start.translation.z == 1.2));
    // A floor that was turned by −90° looks up.
    let up = place("floor").linear * Vector3::z();
    assert!((up - Vector3::y()).norm() < 1e-12, "{up}");
    assert_eq!(scene.playing.len(), 1);
    assert!(
        scene.warnings[0].starts_with("tiles.gltf: the glTF extension \"EXT_unheard_of\""),
        "{:?}",
        scene.warnings
    );
}

#[test]
fn what_is_required_but_unknown_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.gltf");
    let text = r#"{"asset":{"version":"2.0"},"extensionsUsed":["KHR_draco_mesh_compression"],
        "extensionsRequired":["KHR_draco_mesh_compression"]}"#;
    std::fs::write(&path, text).unwrap();
    let error = load(&path, &Limits::default()).unwrap_err().to_string();
    assert!(
        error.contains("extensionsRequired[0]") && error.contains("KHR_draco_mesh_compression"),
        "{error}"
    );
    std::fs::write(&path, r#"{"asset":{"version":"2.0"},"nodes":[{"children":[1]},{"children":[0]}]}"#)
        .unwrap();
    let error = load(&path, &Limits::default()).unwrap_err().to_string();
    assert!(error.contains("its own ancestor"), "{error}");
}

/// A file that shows nothing is legal, and hardly what was meant.
#[test]
fn nothing_to_see_is_said() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("a.obj", "v 0 0 0\n"),
        ("a.toml", "ambient = [1, 1, 1]\n"),
        ("a.gltf", r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],"nodes":[{}]}"#),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let scene = loaded(&path);
        assert!(
            scene.warnings.iter().any(|said| said.contains("nothing to see")),
            "{name}: {:?}",
            scene.warnings
        );
        assert!(!scene.shows_something());
    }
    let path = folder.path().join("empty.glb");
    std::fs::write(&path, "").unwrap();
    let error = load(&path, &Limits::default()).unwrap_err().to_string();
    assert!(error.ends_with("empty.glb: byte 0: expected glTF, found an empty file"), "{error}");
}

/// Whether the only picture is the one that stands for pictures that are not there, with one warning.
fn is_stand_in(scene: &Scene) -> bool {
    let warned = scene.warnings.iter().filter(|warning| warning.contains("is not there")).count();
    warned == 1 && scene.images.len() == 1 && scene.images[0].rgba.starts_with(&[255, 0, 255, 255])
}

/// A texture that is missing is no reason to show nothing, in whatever format; what is wrong is said with its place.
#[test]
fn squares_stand_for_a_texture_that_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let bytes = "A".repeat(48);
    let gltf = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],
        "materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}},"normalTexture":{{"index":0}}}}],
        "textures":[{{"source":0}}],"images":[{{"uri":"lost.png"}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[0,0,0]}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}}],
        "buffers":[{{"uri":"data:application/octet-stream;base64,{bytes}","byteLength":36}}]}}"#
    );
    std::fs::write(at("a.gltf"), gltf).unwrap();
    std::fs::write(at("a.mtl"), "newmtl m\nmap_Kd lost.png\nnorm lost.png\n").unwrap();
    std::fs::write(at("a.obj"), "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    std::fs::write(at("a.toml"), "[material.m]\ntexture = \"lost.png\"\nnormal_texture = \"lost.png\"\n")
        .unwrap();
    for (name, place) in
        [("a.gltf", "a.gltf: images[0].uri: "), ("a.obj", "a.mtl:2:8: "), ("a.toml", "a.toml:2:11: ")]
    {
        let scene = loaded(&at(name));
        assert!(is_stand_in(&scene), "{name}: {:?}", scene.warnings);
        assert!(
            scene.warnings[0].contains(place) && scene.warnings[0].contains("lost.png"),
            "{:?}",
            scene.warnings
        );
        let material = scene.materials.iter().find(|m| m.base_color_texture.is_some()).unwrap();
        assert!(material.normal_texture.is_none(), "{name}: directions cannot be stood in for");
    }
}

/// Whatever a file names: absolute paths, `..`, links, and devices are refused; nothing is read.
#[test]
fn a_scene_cannot_read_outside_of_its_folder() {
    let outer = tempfile::tempdir().unwrap();
    let secret = outer.path().join("secret.bin");
    std::fs::write(&secret, [0u8; 64]).unwrap();
    let folder = outer.path().join("scene");
    std::fs::create_dir(&folder).unwrap();
    let mut ways = vec![
        "../secret.bin".to_owned(),
        "./x/../../secret.bin".to_owned(),
        "%2e%2e/secret.bin".to_owned(),
        secret.to_string_lossy().into_owned(),
        "/dev/zero".to_owned(),
        "file:///etc/passwd".to_owned(),
        String::new(),
        ".".to_owned(),
        // Long enough that asking the system about each step would take minutes.
        "models/../".repeat(100_000),
    ];
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(&secret, folder.join("link.bin")).unwrap();
        std::os::unix::fs::symlink(outer.path(), folder.join("up")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", folder.join("zero.bin")).unwrap();
        ways.extend(["link.bin".to_owned(), "up/secret.bin".to_owned(), "zero.bin".to_owned()]);
    }
    for way in &ways {
        let gltf = folder.join("scene.gltf");
        let text = format!(
            r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}}],"buffers":[{{"uri":{way:?},"byteLength":36}}]}}"#
        );
        std::fs::write(&gltf, text).unwrap();
        let toml = folder.join("scene.toml");
        std::fs::write(&toml, format!("[[model]]\nfile = {way:?}\n")).unwrap();
        let material = folder.join("material.toml");
        std::fs::write(&material, format!("[material.a]\ntexture = {way:?}\n")).unwrap();
        for path in [gltf, toml, material] {
            match load(&path, &Limits::default()) {
                Err(Error::Invalid { message, .. }) => assert!(
                    message.contains("inside the scene's folder")
                        || message.contains("expected a file")
                        || message.contains("expected a path of at most 4096 bytes"),
                    "{way}: {message}"
                ),
                // A name that is no way out, and of nothing.
                Err(Error::Missing { .. }) => {}
                Ok(scene) if is_stand_in(&scene) => {}
                other => panic!("{way} in {}: {:?}", path.display(), other.map(|scene| scene.name)),
            }
        }
        // A texture of an OBJ is warned of, and squares stand for it: the shape can be drawn.
        std::fs::write(folder.join("a.mtl"), format!("newmtl m\nmap_Kd {way}\n")).unwrap();
        std::fs::write(folder.join("a.obj"), "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
            .unwrap();
        let scene = loaded(&folder.join("a.obj"));
        assert!(is_stand_in(&scene), "{way}: {:?}", scene.warnings);
    }
    // A model in a folder below may use what lies beside that folder: it is still the scene's.
    std::fs::create_dir(folder.join("models")).unwrap();
    std::fs::write(folder.join("shared.mtl"), "newmtl m\nKd 1 0 0\n").unwrap();
    std::fs::write(
        folder.join("models/a.obj"),
        "mtllib ../shared.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    )
    .unwrap();
    std::fs::write(folder.join("scene.toml"), "[[model]]\nfile = \"models/a.obj\"\n").unwrap();
    let scene = loaded(&folder.join("scene.toml"));
    assert_eq!(scene.materials[1].base_color[0], 1.0, "{:?}", scene.warnings);
}

#[test]
fn the_sample_room_loads_without_a_warning() {
    let scene = loaded(&Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/room.toml"));
    assert_eq!(scene.warnings, Vec::<String>::new());
    assert!(scene.touchables.len() >= 8 && scene.labels.len() >= 8 && scene.playing.len() == 1);
    // Something stands at hand distance: within 70 cm of the user's shoulders.
    let world = WorldTransforms::at_rest(&scene);
    let shoulders = Vector3::new(0.0, 1.3, 0.0);
    let near = |node: usize| (world.world_from_node[node].translation - shoulders).norm() < 0.95;
    assert!(scene.touchables.iter().filter(|touchable| near(touchable.node)).count() >= 3);
}
