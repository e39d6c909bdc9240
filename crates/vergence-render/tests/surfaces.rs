//! Textures, normal maps, joints and lights against values computed here, under validation.

mod small;

use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use small::{add, device, disc, draw, draw_at, no_messages, pixel, quad, view_at, with_mesh};
use vergence_geom::{Affine, Trs, project};
use vergence_render::Quality;
use vergence_render::camera::stereo;
use vergence_scene::model::{
    Animation, Image, Interpolation, Light, LightKind, Local, Material, Mip, Node, Sampler, Scene, Shading,
    Skin, Texture, TextureRef, Track, Values, Wrap,
};

const SIZE: (u32, u32) = (256, 256);
const PLAIN: Quality = Quality {
    msaa: 1,
    anisotropy: Some(1.0),
    render_scale: 1.0,
    normal_maps: true,
    near_m: 0.05,
    cull_margin_m: 0.0,
    cull_margin_rad: 0.0,
    timestamps: true,
};
const NEAREST: Sampler =
    Sampler { wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, mag_linear: false, min_linear: false, mip: None };

fn reference(uv_from_uv: [[f32; 3]; 2]) -> TextureRef {
    TextureRef { texture: 0, uv_set: 0, uv_from_uv }
}

/// A square of side 2 with an unlit texture.
fn textured(rgba: &[[u8; 4]], width: u32, sampler: Sampler, uv_from_uv: [[f32; 3]; 2]) -> Scene {
    let material = Material {
        shading: Shading::Unlit,
        base_color_texture: Some(reference(uv_from_uv)),
        ..Material::default()
    };
    let mut scene = with_mesh(quad(2.0), material);
    let height = rgba.len() as u32 / width;
    scene.images.push(Image { name: "test".into(), width, height, rgba: rgba.concat() }.into());
    scene.textures.push(Texture { image: 0, sampler });
    scene
}

/// A view that shows exactly the square of side 2.
fn full() -> vergence_geom::View {
    view_at(0.0, 0.0, 1.0 / 30f64.to_radians().tan())
}

/// The colour at a place of the square, 0…1 from its upper left.
fn at(picture: &[u8], u: f64, v: f64) -> [u8; 4] {
    pixel(picture, SIZE, (u * f64::from(SIZE.0)) as u32, (v * f64::from(SIZE.1)) as u32)
}

fn near(found: [u8; 4], expected: [u8; 3]) -> bool {
    (0..3).all(|k| found[k].abs_diff(expected[k]) <= 1)
}

const R: [u8; 4] = [255, 0, 0, 255];
const G: [u8; 4] = [0, 255, 0, 255];
const B: [u8; 4] = [0, 0, 255, 255];
const W: [u8; 4] = [255; 4];
const K: [u8; 4] = [0, 0, 0, 255];

#[test]
fn textures_repeat_mirror_and_end_as_they_say() {
    let Some(device) = device() else { return };
    // Three copies across and down: the middle one is the picture.
    let thrice = [[3.0, 0.0, -1.0], [0.0, 3.0, -1.0]];
    for (wrap, left, above) in [
        (Wrap::Repeat, [R, G], [R, B]),
        (Wrap::MirroredRepeat, [G, R], [B, R]),
        (Wrap::ClampToEdge, [R, R], [R, R]),
    ] {
        let sampler = Sampler { wrap_u: wrap, wrap_v: wrap, ..NEAREST };
        let picture = &draw(&device, textured(&[R, G, B, W], 2, sampler, thrice), &PLAIN, SIZE, &[full()])[0];
        // The copy left of the picture, its upper row; the copy above, its left column.
        let row = [at(picture, 1.0 / 12.0, 5.0 / 12.0), at(picture, 3.0 / 12.0, 5.0 / 12.0)];
        let column = [at(picture, 5.0 / 12.0, 1.0 / 12.0), at(picture, 5.0 / 12.0, 3.0 / 12.0)];
        assert_eq!((row, column), (left, above), "{wrap:?}");
        assert_eq!(at(picture, 7.0 / 12.0, 7.0 / 12.0), W);
    }
    // Turned by 90° about the corner (KHR_texture_transform: u' = v, v' = 1 − u), the upper left texel comes from below.
    let turned = [[0.0, 1.0, 0.0], [-1.0, 0.0, 1.0]];
    let picture = &draw(&device, textured(&[R, G, B, W], 2, NEAREST, turned), &PLAIN, SIZE, &[full()])[0];
    assert_eq!([at(picture, 0.25, 0.25), at(picture, 0.75, 0.25), at(picture, 0.25, 0.75)], [B, R, W]);
    no_messages(&device);
}

#[test]
fn colours_are_filtered_as_light() {
    let Some(device) = device() else { return };
    let linear = Sampler { mag_linear: true, min_linear: true, ..NEAREST };
    let identity = Texture::UNTRANSFORMED;
    let magnified = &draw(
        &device,
        textured(&[K, W], 2, Sampler { wrap_u: Wrap::ClampToEdge, ..linear }, identity),
        &PLAIN,
        SIZE,
        &[full()],
    )[0];
    assert!(near(at(magnified, 0.5, 0.5), [188; 3]), "{:?}", at(magnified, 0.5, 0.5));
    // A stored colour comes out as it is: decoded, then encoded again.
    let grey = [100, 150, 30, 255];
    let flat = &draw(&device, textured(&[grey], 1, linear, identity), &PLAIN, SIZE, &[full()])[0];
    assert!(near(at(flat, 0.3, 0.3), [100, 150, 30]), "{:?}", at(flat, 0.3, 0.3));
    // 512 columns of black and white on 256 pixels: each pixel is the average of two.
    let mipped = Sampler { mip: Some(Mip::Linear), ..linear };
    let stripes: Vec<[u8; 4]> = (0..512 * 512).map(|i| if i % 2 == 0 { K } else { W }).collect();
    let minified = &draw(&device, textured(&stripes, 512, mipped, identity), &PLAIN, SIZE, &[full()])[0];
    for (u, v) in [(0.1, 0.1), (0.5, 0.5), (0.9, 0.3)] {
        assert!(near(at(minified, u, v), [188; 3]), "{:?}", at(minified, u, v));
    }
    no_messages(&device);
}

/// A million times through the texture from edge to edge, one way or both: a pixel covers 4,000 repetitions, and shows the mean.
/// A software device would visit every texel of them, which takes hours.
#[test]
fn a_texture_that_is_far_too_fine_is_its_mean() {
    let Some(device) = device() else { return };
    let mipped = Sampler { mag_linear: true, min_linear: true, mip: Some(Mip::Linear), ..NEAREST };
    let checks: Vec<[u8; 4]> = (0..64 * 64).map(|i| if (i + i / 64) % 2 == 0 { K } else { W }).collect();
    let anisotropic = Quality { anisotropy: Some(device.limits().max_anisotropy.min(16.0)), ..PLAIN };
    for (across, down) in [(1e6, 1e6), (1e6, 1.0), (1.0, 1e6), (1e30, 1e30)] {
        let fine = [[across, 0.0, 0.0], [0.0, down, 0.0]];
        let unlit = textured(&checks, 64, mipped, fine);
        let mut lit = unlit.clone();
        lit.materials[0].shading = Material::default().shading;
        let shown = &draw(&device, unlit, &anisotropic, SIZE, &[full()])[0];
        for (u, v) in [(0.1, 0.1), (0.5, 0.5), (0.9, 0.3)] {
            assert!(near(at(shown, u, v), [188; 3]), "{across} {down}: {:?}", at(shown, u, v));
        }
        // What is lit takes another way through the shader.
        draw(&device, lit, &anisotropic, SIZE, &[full()]);
    }
    no_messages(&device);
}

#[test]
fn each_texture_has_its_own_coordinates() {
    let Some(device) = device() else { return };
    // Base colour from set 0, emission from set 1, which is upside down.
    let mut scene = textured(&[R, R, K, K], 2, NEAREST, Texture::UNTRANSFORMED);
    scene.images.push(Image { name: "glow".into(), width: 1, height: 2, rgba: [B, K].concat() }.into());
    scene.textures.push(Texture { image: 1, sampler: NEAREST });
    let primitive = &mut scene.meshes[0].primitives[0];
    primitive.uv1 = primitive.uv0.iter().map(|[u, v]| [*u, 1.0 - v]).collect();
    let material = &mut scene.materials[0];
    material.shading = Shading::MetallicRoughness { metallic: 0.0, roughness: 1.0, texture: None, ior: 1.0 };
    material.emissive = [1.0; 3];
    material.emissive_texture =
        Some(TextureRef { texture: 1, uv_set: 1, uv_from_uv: Texture::UNTRANSFORMED });
    scene.ambient = [std::f32::consts::PI; 3];
    let picture = &draw(&device, scene, &PLAIN, SIZE, &[full()])[0];
    let (above, below) = (at(picture, 0.5, 0.25), at(picture, 0.5, 0.75));
    assert!(above[0] > 200 && above[2] < 60, "red above: {above:?}");
    assert!(below[2] == 255 && below[0] < 60, "blue below: {below:?}");
    no_messages(&device);
}

/// A white wall under one light: what the formulas of KHR_lights_punctual and Lambert say, within a code.
#[test]
fn lights_have_the_units_of_the_specification() {
    let Some(device) = device() else { return };
    let srgb = |light: f64| {
        let v = if light <= 0.0031308 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
        (v.clamp(0.0, 1.0) * 255.0).round() as u8
    };
    let wall = Material {
        // An index of 1 reflects nothing at the surface: Lambert only.
        shading: Shading::MetallicRoughness { metallic: 0.0, roughness: 1.0, texture: None, ior: 1.0 },
        base_color: [0.5, 0.5, 0.5, 1.0],
        ..Material::default()
    };
    let spot = |inner: f32, outer: f32| LightKind::Spot { range_m: None, inner_rad: inner, outer_rad: outer };
    let place = Trs { translation: Vector3::new(0.0, 0.0, 2.0), ..Trs::identity() };
    for (kind, expected) in [
        // Lux: irradiance · 0.5 / π.
        (LightKind::Directional, 0.5 * 3.0 / std::f64::consts::PI),
        // Candela over the square of the distance.
        (LightKind::Point { range_m: None }, 0.5 * 3.0 / 4.0 / std::f64::consts::PI),
        // … times 1 − (2/4)⁴.
        (LightKind::Point { range_m: Some(4.0) }, 0.5 * 3.0 / 4.0 / std::f64::consts::PI * 0.9375),
        (spot(0.5, 0.8), 0.5 * 3.0 / 4.0 / std::f64::consts::PI),
    ] {
        let mut scene = with_mesh(quad(2.0), wall.clone());
        scene.lights.push(Light { color: [1.0; 3], intensity: 3.0, kind });
        scene.nodes.push(Node {
            name: "light".into(),
            parent: None,
            parent_from_node: Local::Trs(place),
            mesh: None,
            skin: None,
            light: Some(0),
            camera: None,
            label: None,
        });
        let picture = &draw(&device, scene, &PLAIN, SIZE, &[full()])[0];
        let found = at(picture, 0.5, 0.5);
        assert!(near(found, [srgb(expected); 3]), "{kind:?}: {found:?}, expected {}", srgb(expected));
        if matches!(kind, LightKind::Spot { .. }) {
            // The corner of the wall is 35° off the axis: between 28.6° and 45.8°.
            let cosine = 2.0 / 6f64.sqrt();
            let cone = (cosine - 0.8f64.cos()) / (0.5f64.cos() - 0.8f64.cos());
            let light = 0.5 * 3.0 / 6.0 * cosine / std::f64::consts::PI * cone * cone;
            let found = at(picture, 0.001, 0.001);
            assert!(found[0].abs_diff(srgb(light)) <= 3, "{found:?}, expected {}", srgb(light));
        }
    }
    no_messages(&device);
}

#[test]
fn a_normal_map_turns_the_light() {
    let Some(device) = device() else { return };
    let with_normal = |texel: [u8; 4], quality: &Quality| {
        let mut scene = textured(&[texel], 1, NEAREST, Texture::UNTRANSFORMED);
        let material = &mut scene.materials[0];
        material.shading =
            Shading::MetallicRoughness { metallic: 0.0, roughness: 1.0, texture: None, ior: 1.0 };
        material.normal_texture = material.base_color_texture.take();
        scene.meshes[0].primitives[0].tangents = vec![[1.0, 0.0, 0.0, 1.0]; 4];
        // From the right.
        scene.add_directional([1.0, 0.0, 1.0], 2.0);
        at(&draw(&device, scene, quality, SIZE, &[full()])[0], 0.5, 0.5)[0]
    };
    let flat = with_normal([128, 128, 255, 255], &PLAIN);
    let right = with_normal([218, 128, 218, 255], &PLAIN);
    let left = with_normal([37, 128, 218, 255], &PLAIN);
    assert!(right > flat + 20 && left < 10, "{left} {flat} {right}");
    let without = with_normal([218, 128, 218, 255], &Quality { normal_maps: false, ..PLAIN });
    assert!(without.abs_diff(flat) <= 1, "{without} {flat}");
    no_messages(&device);
}

/// Two moving joints, far from the origin: the blend of their matrices, in f64, says where the disc is.
#[test]
fn joints_put_vertices_where_double_precision_does() {
    let Some(device) = device() else { return };
    let far = Vector3::new(3e6, -1e5, 2e6);
    let (size, weights, secs) = ((512, 512), [0.3f32, 0.7, 0.0, 0.0], 0.75);
    let mut scene = Scene::default();
    let material = Material { shading: Shading::Unlit, ..Material::default() };
    let mut figure = disc(0.06);
    figure.positions.iter_mut().for_each(|p| p[0] += 0.2);
    figure.joints = vec![[0, 1, 0, 0]; figure.positions.len()];
    figure.weights = vec![weights; figure.positions.len()];
    add(&mut scene, figure, material, Local::Trs(Trs::identity()));
    // The mesh's node is ignored: joints place a skinned mesh.
    scene.nodes[0].parent_from_node =
        Local::Trs(Trs { translation: Vector3::repeat(77.0), ..Trs::identity() });
    scene.nodes[0].skin = Some(0);
    for translation in [far, far + Vector3::new(0.1, 0.2, 0.0)] {
        let node = scene.nodes[0].clone();
        let parent_from_node = Local::Trs(Trs { translation, ..Trs::identity() });
        scene.nodes.push(Node { mesh: None, skin: None, parent_from_node, ..node });
    }
    let joint_from_mesh = [
        Affine { linear: Matrix3::identity(), translation: Vector3::new(-0.05, 0.02, 0.0) },
        Affine { linear: Matrix3::identity() * 1.25, translation: Vector3::new(0.0, -0.03, 0.01) },
    ];
    scene.skins.push(Skin {
        name: String::new(),
        joints: vec![1, 2],
        joint_from_mesh: joint_from_mesh.to_vec(),
    });
    let half_turn = [0.0, 0.0, 0.5f32.sqrt(), 0.5f32.sqrt()];
    scene.animations.push(Animation {
        name: String::new(),
        tracks: vec![Track {
            node: 2,
            times_secs: vec![0.0, 1.0],
            interpolation: Interpolation::Linear,
            values: Values::Rotation(vec![[0.0, 0.0, 0.0, 1.0], half_turn]),
        }],
    });
    scene.playing = vec![0];
    let turned = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.75 * std::f64::consts::FRAC_PI_2);
    let joints = [
        Trs { translation: far, ..Trs::identity() },
        Trs { translation: far + Vector3::new(0.1, 0.2, 0.0), rotation: turned, ..Trs::identity() },
    ];
    let centre = Point3::new(f64::from(0.2f32), 0.0, 0.0);
    let mut truth = Vector3::zeros();
    for ((joint, inverse), weight) in joints.iter().zip(joint_from_mesh).zip(weights) {
        truth += f64::from(weight) * (joint.to_affine() * inverse).transform_point(&centre).coords;
    }
    let mut eye = view_at(0.1, 0.1, 2.0);
    eye.world_from_eye.translation.vector += far;
    let views = stereo(&eye.world_from_eye, 0.063, eye.fov);
    let pictures = draw_at(&device, scene, &Quality { msaa: 4, ..PLAIN }, size, &views, secs);
    for (picture, view) in pictures.iter().zip(&views) {
        let ndc = project(&view.fov, &(view.world_from_eye.inverse() * Point3::from(truth))).unwrap();
        let (mut sum, mut x_sum, mut y_sum) = (0.0, 0.0, 0.0);
        for (x, y) in (0..size.1).flat_map(|y| (0..size.0).map(move |x| (x, y))) {
            let v = f64::from(pixel(picture, size, x, y)[0]) / 255.0;
            let light = if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
            sum += light;
            x_sum += light * (f64::from(x) + 0.5);
            y_sum += light * (f64::from(y) + 0.5);
        }
        let (x, y) = (x_sum / sum, y_sum / sum);
        let expected = ((0.5 * ndc.x + 0.5) * 512.0, (0.5 * ndc.y + 0.5) * 512.0);
        assert!((x - expected.0).hypot(y - expected.1) < 0.1, "{x} {y}, expected {expected:?}");
    }
    no_messages(&device);
}

#[test]
fn a_scene_plays_the_clips_it_says_and_no_others() {
    let Some(device) = device() else { return };
    let Some(fox) = small::data("gltf/Fox.glb") else { return };
    let scene = vergence_scene::load(&fox, &vergence_scene::Limits::default()).unwrap();
    assert!(scene.animations.len() >= 2 && scene.playing == [0]);
    // The file's unit makes the fox some 150 m long.
    let at_times = |playing: &[usize]| {
        [0.0, 0.3].map(|secs| {
            let mut scene = scene.clone();
            scene.light_if_dark();
            scene.playing = playing.to_vec();
            draw_at(&device, scene, &PLAIN, SIZE, &[view_at(0.0, 40.0, 250.0)], secs).remove(0)
        })
    };
    let (none, first, second) = (at_times(&[]), at_times(&[0]), at_times(&[1]));
    assert!(none[0].chunks(4).any(|texel| texel != &none[0][..4]), "the fox is in the picture");
    assert!(none[0] == none[1], "a scene without a playing clip stands still");
    assert!(first[0] != first[1] && second[0] != second[1], "clips move");
    assert!(first[1] != second[1] && first[1] != none[1], "each clip is another pose");
    no_messages(&device);
}

#[test]
fn joints_and_weights_of_another_length_are_an_error() {
    let Some(device) = device() else { return };
    let target = vergence_render::Target::new(SIZE, 1);
    let found = |joints: usize, weights: usize, node: usize| {
        let mut square = quad(2.0);
        square.joints = vec![[0; 4]; joints];
        square.weights = vec![[1.0, 0.0, 0.0, 0.0]; weights];
        let mut scene = with_mesh(square, Material::default());
        scene.nodes[0].skin = Some(0);
        let joint_from_mesh = vec![Affine { linear: Matrix3::identity(), translation: Vector3::zeros() }];
        scene.skins.push(Skin { name: String::new(), joints: vec![node], joint_from_mesh });
        let needs = vergence_scene::Needs::of(&scene, true);
        let made = vergence_render::Renderer::new(&device, &scene.into(), &needs, &PLAIN, &target, 1);
        made.err().map(|error| error.to_string())
    };
    assert_eq!(found(4, 4, 0), None);
    for (joints, weights, expected) in [
        (3, 4, "joints: expected none or one for each of 4 vertices, found 3"),
        (5, 4, "joints: expected none or one for each of 4 vertices, found 5"),
        (4, 1, "weights: expected none or one for each of 4 vertices, found 1"),
    ] {
        assert_eq!(found(joints, weights, 0).as_deref(), Some(expected));
    }
    assert_eq!(found(4, 4, 7).as_deref(), Some("scene: expected nodes below 1, found 7"));
    no_messages(&device);
}
