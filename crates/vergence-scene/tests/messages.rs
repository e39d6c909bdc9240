//! What is said of broken files, word for word: the file, the place in it, what was expected and what was found.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use vergence_scene::{Limits, load};

/// A GLB of which the JSON chunk is this.
fn glb(json: &str) -> Vec<u8> {
    let mut bytes = b"glTF".to_vec();
    bytes.extend(2u32.to_le_bytes());
    bytes.extend((20 + json.len() as u32).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json.as_bytes());
    bytes
}

const VERSION: &str = r#""asset":{"version":"2.0"}"#;

#[test]
fn broken_files_are_told_with_file_place_expected_and_found() {
    let folder = tempfile::tempdir().unwrap();
    let buffer = |uri: &str| {
        format!(
            r#"{{{VERSION},"buffers":[{{"byteLength":36,"uri":"{uri}"}}],"nodes":[{{"mesh":0}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}}]}}"#
        )
    };
    let ply =
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n";
    let cases: Vec<(&str, Vec<u8>, &str)> = vec![
        (
            "cut.glb",
            glb("{}")[..17].into(),
            ": byte 8: expected 22 bytes as the header says, found 17: the file is cut",
        ),
        ("noise.glb", vec![0x8f; 3000], ": byte 0: expected \"glTF\" or a JSON object, found neither"),
        ("text.gltf", b"hello\n".into(), ": byte 0: expected \"glTF\" or a JSON object, found neither"),
        ("json.glb", glb("{\n \"nodes\":[,]}"), ": byte 32: expected glTF, found: expected value"),
        ("json.gltf", b"{\n \"nodes\":[,]}".into(), ":2:11: expected glTF, found: expected value"),
        (
            "old.gltf",
            br#"{"asset":{"version":"1.0"}}"#.into(),
            ": asset.version: expected glTF version \"2.0\", found \"1.0\"",
        ),
        (
            "loop.gltf",
            format!(
                r#"{{{VERSION},"scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[1]}},{{"children":[0]}}]}}"#
            )
            .into(),
            ": nodes[0]: expected a tree, found a node that is its own ancestor",
        ),
        (
            "nodes.gltf",
            format!(r#"{{{VERSION},"scenes":[{{"nodes":[7]}}],"nodes":[{{}}]}}"#).into(),
            ": scenes[0].nodes[0]: expected a node below 1, found 7",
        ),
        (
            "escape.gltf",
            buffer("../x.bin").into(),
            ": buffers[0].uri: expected a file inside the scene's folder, found \"../x.bin\" outside of it",
        ),
        (
            "absent.gltf",
            buffer("x.bin").into(),
            ": buffers[0].uri: expected a file, found \"x.bin\": No such file or directory (os error 2)",
        ),
        (
            "face.obj",
            b"v 0 0 0\nv 1 0 0\nf 1 2 9\n".into(),
            ":3:7: expected the index of one of 2 vertices (from 1, or negative from the last of 2), found \"9\"",
        ),
        ("number.obj", b"v 0 0 x\n".into(), ":1:7: expected a number up to 3.4e38, found \"x\""),
        ("head.ply", ply.into(), ":7:1: expected a line of a PLY header, found the end of the file"),
        (
            "body.ply",
            format!("{ply}end_header\n0 0 0\n").into(),
            ":9:1: expected a number, found the end of the file",
        ),
        ("table.toml", b"[[model]\n".into(), ":1:9: unclosed array table, expected `]`"),
        (
            "escape.toml",
            b"[[model]]\nfile = \"../x.obj\"\n".into(),
            ":2:8: expected a file inside the scene's folder, found \"../x.obj\" outside of it",
        ),
        (
            "itself.toml",
            b"[[model]]\nfile = \"itself.toml\"\n".into(),
            ":2:8: expected a .glb, .gltf, .obj or .ply file, found \"itself.toml\"",
        ),
        (
            "scale.toml",
            b"[[model]]\nscale = nan\nfile = \"x.glb\"\n".into(),
            ":2:9: expected a scale up to 1e9 that leaves something to see, found [NaN, NaN, NaN]",
        ),
        (
            "flat.toml",
            b"[[model]]\nscale = [0, 0, 0]\nfile = \"x.glb\"\n".into(),
            ":2:9: expected a scale up to 1e9 that leaves something to see, found [0.0, 0.0, 0.0]",
        ),
        (
            "unit.toml",
            b"[[model]]\nfile = \"x.glb\"\nposition = [0, \"1 kg\", 0]\n".into(),
            ":3:16: expected a length such as \"1.5 m\" (units: m, km, cm, mm, um), found \"1 kg\"",
        ),
    ];
    assert!(cases.len() >= 20);
    for (name, bytes, said) in cases {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let error = load(&path, &Limits::default()).unwrap_err().to_string();
        assert_eq!(error, format!("{}{said}", path.display()));
    }
}
