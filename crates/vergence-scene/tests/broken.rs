//! Broken input: truncated and bit-flipped files end in an error that names file and place (or load, where the damage
//! does not matter), without a panic, without a hang, and within the memory that the limits allow.
//!
//! Files are the small ones in `tests/data` and, where `VERGENCE_DATA` is set, those of its `scenes`. The cases are
//! the same in every run; `VERGENCE_FUZZ_S` adds random ones for so many seconds.
#![allow(clippy::unwrap_used)] // helpers of tests are tests, too

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

use peak_alloc::PeakAlloc;
use vergence_scene::{Error, Limits, Scene, load};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Held while memory is counted: the count is the whole process's.
static ALONE: Mutex<()> = Mutex::new(());

/// What a load may allocate: so many bytes, and so many for each byte on disk.
const MEMORY_BYTES: usize = 32_000_000;
const MEMORY_PER_FILE_BYTE: usize = 20;
/// While an image is decoded there may be a JPEG's coefficients or 16 bits per channel, and the 8-bit result.
const BYTES_PER_PIXEL: usize = 16;
/// A load of these files takes milliseconds; a machine may be busy.
const HANG: Duration = Duration::from_secs(60);
/// Damaged copies of each file in `tests/data`, and of each file of `VERGENCE_DATA`.
const CASES: usize = 220;
const CASES_OF_DATA: usize = 40;
/// Larger files are left to the test that loads everything.
const LARGEST_BYTES: u64 = 2 << 20;

/// A scene on disk: the file to load, and the file of its folder that is damaged.
struct Subject {
    scene: PathBuf,
    victim: PathBuf,
    cases: usize,
}

fn subjects() -> Vec<Subject> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let mut subjects: Vec<Subject> = [
        ("Box.glb", "Box.glb"),
        ("BoxInterleaved.glb", "BoxInterleaved.glb"),
        ("SimpleSkin.gltf", "SimpleSkin.gltf"),
        ("tiles.gltf", "tiles.gltf"),
        ("tiles.gltf", "tiles.bin"),
        ("tiles.gltf", "tiles.png"),
        ("tiles.gltf", "tiles.jpg"),
        ("house.obj", "house.obj"),
        ("house.obj", "house.mtl"),
        ("ascii.ply", "ascii.ply"),
        ("little.ply", "little.ply"),
        ("big.ply", "big.ply"),
        ("scene.toml", "scene.toml"),
    ]
    .map(|(scene, victim)| Subject { scene: data.join(scene), victim: data.join(victim), cases: CASES })
    .into();
    if let Some(data) = std::env::var_os("VERGENCE_DATA") {
        let mut open = vec![Path::new(&data).join("scenes/gltf"), Path::new(&data).join("scenes/mesh")];
        while let Some(folder) = open.pop() {
            let mut entries: Vec<PathBuf> =
                std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
            entries.sort();
            for path in entries {
                let extension = path.extension().unwrap_or_default().to_string_lossy().into_owned();
                if path.is_dir() {
                    open.push(path);
                } else if ["glb", "gltf", "obj", "ply"].contains(&extension.as_str())
                    && path.metadata().unwrap().len() <= LARGEST_BYTES
                {
                    subjects.push(Subject { scene: path.clone(), victim: path, cases: CASES_OF_DATA });
                }
            }
        }
    } else {
        eprintln!("skipped: no VERGENCE_DATA, only the files in tests/data are damaged");
        let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
        assert!(
            !required.split(',').any(|word| word == "data"),
            "VERGENCE_REQUIRE asks for data, found no VERGENCE_DATA"
        );
    }
    subjects
}

/// A deterministic stream of numbers (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound.max(1) as u64) as usize
    }
}

/// Damages `bytes` in one of five ways; says how.
fn damage(bytes: &mut Vec<u8>, random: &mut Random) -> String {
    let length = bytes.len();
    match random.below(8) {
        0 | 1 => {
            let kept = random.below(length);
            bytes.truncate(kept);
            format!("cut after byte {kept}")
        }
        2 => {
            // The beginning holds what counts and offsets are.
            let at = random.below(length.min(512));
            bytes[at] ^= 1 << random.below(8);
            format!("flipped a bit of byte {at}")
        }
        3 => {
            let at = random.below(length);
            bytes[at] = [0, 0xFF, 0x7F, 0x80, b'9', b'-', b'{', b'\n'][random.below(8)];
            format!("set byte {at} to {}", bytes[at])
        }
        4 => {
            let at = random.below(length);
            let end = (at + 1 + random.below(64)).min(length);
            let part: Vec<u8> = bytes[at..end].to_vec();
            bytes.splice(at..at, part);
            format!("doubled bytes {at}..{end}")
        }
        5 => {
            // Digits make numbers larger: counts, indices, sizes.
            let digits: Vec<usize> = (0..length).filter(|&i| bytes[i].is_ascii_digit()).collect();
            if digits.is_empty() {
                bytes[0] ^= 0xFF;
                return "flipped byte 0".into();
            }
            let at = digits[random.below(digits.len())];
            let new = [&b"9"[..], b"99999", b"4294967295", b"18446744073709551615", b"-1", b"1e308", b"0"]
                [random.below(7)];
            bytes.splice(at..=at, new.iter().copied());
            format!("digit at {at} became {}", String::from_utf8_lossy(new))
        }
        _ => {
            let flips = 1 + random.below(8);
            for _ in 0..flips {
                let at = random.below(length);
                bytes[at] ^= 1 << random.below(8);
            }
            format!("flipped {flips} bits")
        }
    }
}

/// Everything that a consumer of a scene may rely on.
fn check_scene(scene: &Scene) {
    for (index, node) in scene.nodes.iter().enumerate() {
        assert!(node.parent.is_none_or(|parent| parent < index));
        assert!(node.mesh.is_none_or(|i| i < scene.meshes.len()));
        assert!(node.skin.is_none_or(|i| i < scene.skins.len()));
        assert!(node.light.is_none_or(|i| i < scene.lights.len()));
        assert!(node.camera.is_none_or(|i| i < scene.cameras.len()));
        assert!(node.label.is_none_or(|i| i < scene.labels.len()));
        if let (Some(mesh), Some(skin)) = (node.mesh, node.skin) {
            let joints = scene.skins[skin].joints.len();
            let primitives = &scene.meshes[mesh].primitives;
            assert!(
                primitives.iter().flat_map(|p| p.joints.iter().flatten()).all(|&j| usize::from(j) < joints)
            );
        }
    }
    for primitive in scene.meshes.iter().flat_map(|mesh| &mesh.primitives) {
        let count = primitive.positions.len();
        assert!(primitive.material < scene.materials.len());
        assert_eq!(primitive.indices.len() % 3, 0);
        assert!(primitive.indices.iter().all(|&i| (i as usize) < count));
        assert_eq!(primitive.normals.len(), count);
        for length in [
            primitive.tangents.len(),
            primitive.uv0.len(),
            primitive.uv1.len(),
            primitive.colors.len(),
            primitive.joints.len(),
            primitive.weights.len(),
        ] {
            assert!(length == 0 || length == count);
        }
        assert!(primitive.positions.iter().flatten().all(|v| v.is_finite()));
        for normal in &primitive.normals {
            let length: f32 = normal.iter().map(|c| c * c).sum();
            assert!((length - 1.0).abs() < 1e-5, "{normal:?}");
        }
        for weights in &primitive.weights {
            assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{weights:?}");
        }
    }
    for material in &scene.materials {
        let uses = [
            material.base_color_texture,
            material.normal_texture,
            material.occlusion_texture,
            material.emissive_texture,
        ];
        assert!(uses.iter().flatten().all(|t| t.texture < scene.textures.len()));
    }
    assert!(scene.textures.iter().all(|t| t.image < scene.images.len()));
    assert!(scene.images.iter().all(|i| i.rgba.len() == 4 * i.width as usize * i.height as usize));
    for track in scene.animations.iter().flat_map(|clip| &clip.tracks) {
        assert!(track.node < scene.nodes.len() && track.sample(0.3).is_some());
    }
    for skin in &scene.skins {
        assert_eq!(skin.joints.len(), skin.joint_from_mesh.len());
        assert!(skin.joints.iter().all(|&joint| joint < scene.nodes.len()));
    }
    assert!(scene.playing.iter().all(|&clip| clip < scene.animations.len()));
}

fn check_error(error: &Error, folder: &Path) {
    let text = error.to_string();
    assert!(text.contains(&*folder.to_string_lossy()), "an error that names no file: {text}");
    match error {
        Error::Invalid { place, message, .. } => {
            assert!(!place.is_empty() && !message.is_empty(), "an error without a place: {text}");
        }
        Error::TooLarge { place, .. } => assert!(!place.is_empty(), "an error without a place: {text}"),
        Error::Config(_) | Error::Missing { .. } | Error::Io { .. } => {}
    }
}

/// What the watchdog hears.
enum Said {
    /// A case begins.
    Case(String),
    /// All is done: cases, errors among them, largest share of the allowed memory.
    Done(usize, usize, f64),
}

fn run(say: &mpsc::Sender<Said>) {
    let mut cases = 0;
    let mut errors = 0;
    let mut largest_share = 0f64;
    let mut try_one = |subject: &Subject, seed: u64| {
        let folder = tempfile::tempdir().unwrap();
        for entry in std::fs::read_dir(subject.scene.parent().unwrap()).unwrap() {
            let path = entry.unwrap().path();
            // Companions of a scene lie in its folder; of a folder of many scenes the file itself is enough.
            let is_needed = path == subject.scene || path == subject.victim || subject.cases == CASES;
            let is_companion = path.parent().is_some_and(|p| !p.ends_with("gltf") && !p.ends_with("mesh"));
            if path.is_file() && (is_needed || is_companion) {
                std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
            }
        }
        let victim = folder.path().join(subject.victim.file_name().unwrap());
        let mut bytes = std::fs::read(&subject.victim).unwrap();
        let how = damage(&mut bytes, &mut Random(seed));
        // A copy of a read-only file is read-only.
        let _ = std::fs::remove_file(&victim);
        std::fs::write(&victim, &bytes).unwrap();
        drop(bytes);
        let case = format!("{} ({how}, seed {seed})", subject.victim.display());
        say.send(Said::Case(case.clone())).unwrap();
        let on_disk: u64 = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().metadata().unwrap().len())
            .sum();
        let limits = Limits { image_pixels: 1 << 22, ..Limits::default() };
        let scene = folder.path().join(subject.scene.file_name().unwrap());
        let before = MEMORY.current_usage();
        MEMORY.reset_peak_usage();
        let start = Instant::now();
        let result = std::panic::catch_unwind(|| load(&scene, &limits));
        let peak = MEMORY.peak_usage().saturating_sub(before);
        assert!(start.elapsed() < HANG / 4, "{case}: took {:?}", start.elapsed());
        let result = result.unwrap_or_else(|_| panic!("panic while loading {case}"));
        let pixels = result.as_ref().map_or(limits.image_pixels as usize, |scene| {
            scene.images.iter().map(|i| i.width as usize * i.height as usize).sum()
        });
        // Images are decoded one by one; an error may come while one is.
        let allowed = MEMORY_BYTES + MEMORY_PER_FILE_BYTE * on_disk as usize + BYTES_PER_PIXEL * pixels;
        assert!(peak <= allowed, "{case}: allocated {peak} bytes, {allowed} are allowed");
        largest_share = largest_share.max(peak as f64 / allowed as f64);
        cases += 1;
        match result {
            Ok(scene) => check_scene(&scene),
            Err(error) => {
                check_error(&error, folder.path());
                errors += 1;
            }
        }
    };
    let subjects = subjects();
    for subject in &subjects {
        for case in 0..subject.cases {
            try_one(subject, case as u64);
        }
    }
    let more_secs: u64 = std::env::var("VERGENCE_FUZZ_S").ok().and_then(|s| s.parse().ok()).unwrap_or(0);
    let start = Instant::now();
    let mut random =
        Random(std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos() as u64);
    while start.elapsed() < Duration::from_secs(more_secs) {
        try_one(&subjects[random.below(subjects.len())], random.next());
    }
    say.send(Said::Done(cases, errors, largest_share)).unwrap();
}

#[test]
fn damaged_files_end_in_an_error_with_file_and_place() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let (say, hear) = mpsc::channel();
    let worker = std::thread::spawn(move || run(&say));
    let mut current = String::new();
    loop {
        match hear.recv_timeout(HANG) {
            Ok(Said::Case(case)) => current = case,
            Ok(Said::Done(cases, errors, share)) => {
                println!(
                    "{cases} damaged files, {errors} errors, at most {:.0} % of the allowed memory",
                    100.0 * share
                );
                assert!(cases >= 2000, "{cases}");
                assert!(errors > cases / 4, "the damage is too harmless: {errors} errors in {cases} cases");
                break;
            }
            Err(mpsc::RecvTimeoutError::Timeout) => panic!("no end after {HANG:?}: {current}"),
            Err(mpsc::RecvTimeoutError::Disconnected) => break,
        }
    }
    if let Err(panic) = worker.join() {
        std::panic::resume_unwind(panic);
    }
}

/// Small files that ask for a lot: each is refused before the memory is taken.
#[test]
fn small_files_that_ask_for_much_are_refused() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let mesh = |accessor: &str, primitives: usize| {
        let primitive = r#"{"attributes":{"POSITION":0}}"#;
        let primitives = vec![primitive; primitives].join(",");
        format!(
            r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{primitives}]}}],
            "accessors":[{accessor}],"bufferViews":[{{"buffer":0,"byteLength":120000}}],
            "buffers":[{{"uri":"zero.bin","byteLength":120000}}]}}"#
        )
    };
    std::fs::write(folder.path().join("zero.bin"), vec![0; 120_000]).unwrap();
    let cases = [
        (
            "zeros.gltf",
            mesh(
                r#"{"componentType":5126,"count":4000000000,"type":"VEC3","sparse":{"count":0,
                "indices":{"bufferView":0,"componentType":5121},"values":{"bufferView":0}}}"#,
                1,
            ),
        ),
        ("shared.gltf", mesh(r#"{"bufferView":0,"componentType":5126,"count":10000,"type":"VEC3"}"#, 2000)),
        (
            "objects.gltf",
            format!(r#"{{"asset":{{"version":"2.0"}},"nodes":[{}]}}"#, vec!["{}"; 2_000_000].join(",")),
        ),
        ("polygons.obj", format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{}", "f 1 2 3\n".repeat(3_000_000))),
    ];
    for (name, text) in cases {
        let path = folder.path().join(name);
        std::fs::write(&path, &text).unwrap();
        let on_disk = text.len() + 120_000;
        drop(text);
        let before = MEMORY.current_usage();
        MEMORY.reset_peak_usage();
        let result = load(&path, &Limits::default());
        let peak = MEMORY.peak_usage().saturating_sub(before);
        let allowed = MEMORY_BYTES + MEMORY_PER_FILE_BYTE * on_disk;
        assert!(peak <= allowed, "{name}: allocated {peak} bytes, {allowed} are allowed");
        if name.ends_with("gltf") {
            assert!(
                matches!(result, Err(Error::TooLarge { .. })),
                "{name}: {:?}",
                result.map(|scene| scene.name)
            );
        }
    }
}
