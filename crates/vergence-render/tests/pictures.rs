//! Pictures of small scenes made here, under validation: where things are, in which eye, and what was built.

mod small;

use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use small::{device, disc, draw, pixel, quad, view_at, with_mesh};
use vergence_geom::{Fov, Trs, View, project};
use vergence_render::camera::{look_at, stereo};
use vergence_render::{Offscreen, Quality, Renderer, Target};
use vergence_scene::Needs;
use vergence_scene::model::{Alpha, Local, Material, Scene, Shading};
use vergence_time::Span;

const SIZE: (u32, u32) = (512, 512);
/// The bar: the centroid of a 40 px disc against its projection.
const CENTROID_PX: f64 = 0.1;

fn unlit(color: [f32; 4]) -> Material {
    Material { shading: Shading::Unlit, base_color: color, double_sided: true, ..Material::default() }
}

/// Light-weighted mean place of a picture, pixels from its left and upper sides.
fn centroid(picture: &[u8]) -> (f64, f64) {
    let (mut sum, mut x_sum, mut y_sum) = (0.0, 0.0, 0.0);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            // sRGB to linear: coverage is an average of light.
            let v = f64::from(pixel(picture, SIZE, x, y)[0]) / 255.0;
            let light = if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
            sum += light;
            x_sum += light * (f64::from(x) + 0.5);
            y_sum += light * (f64::from(y) + 0.5);
        }
    }
    assert!(sum > 100.0, "the disc is there: {sum}");
    (x_sum / sum, y_sum / sum)
}

#[test]
fn a_disc_is_where_it_projects_in_both_eyes() {
    let Some(device) = device() else { return };
    // Also far from the origin, where single precision is a metre.
    for offset in [Vector3::zeros(), Vector3::new(1e7, -3e6, 2e7)] {
        let fov = Fov { left_rad: -0.6, right_rad: 0.5, up_rad: 0.45, down_rad: -0.55 };
        let head = look_at(&Point3::new(0.3, 1.6, 0.0), &Point3::new(0.5, 1.5, -2.0));
        let mut views = stereo(&head, 0.063, fov);
        let centre = Point3::new(0.45, 1.55, -2.0);
        // 40 px across: the picture is 1.2 tangents wide.
        let radius = 20.0 / f64::from(SIZE.0) * (0.6f64.tan() + 0.5f64.tan()) * 2.0;
        let mut scene = with_mesh(disc(radius as f32), unlit([1.0; 4]));
        let facing = head.rotation;
        scene.nodes[0].parent_from_node =
            Local::Trs(Trs { translation: centre.coords + offset, rotation: facing, ..Trs::identity() });
        for view in &mut views {
            view.world_from_eye.translation.vector += offset;
        }
        let quality = Quality { msaa: 4, ..Quality::default() };
        let pictures = draw(&device, scene, &quality, SIZE, &views);
        let mut found = Vec::new();
        for (picture, view) in pictures.iter().zip(&views) {
            let ndc = project(&fov, &(view.world_from_eye.inverse() * (centre + offset))).unwrap();
            let expected = ((0.5 * ndc.x + 0.5) * f64::from(SIZE.0), (0.5 * ndc.y + 0.5) * f64::from(SIZE.1));
            let (x, y) = centroid(picture);
            let error = (x - expected.0).hypot(y - expected.1);
            assert!(error <= CENTROID_PX, "{offset}: {x} {y}, expected {expected:?}");
            found.push(x);
        }
        assert!(found[0] - found[1] > 5.0, "the left eye sees it further right: {found:?}");
    }
    small::no_messages(&device);
}

#[test]
fn the_views_that_were_latched_last_are_drawn() {
    let Some(device) = device() else { return };
    let scene = Arc::new(with_mesh(disc(0.1), unlit([1.0; 4])));
    let quality = Quality { msaa: 1, ..Quality::default() };
    let target = Target::new(SIZE, 2);
    let needs = Needs::of(&scene, true);
    let mut renderer = Renderer::new(&device, &scene, &needs, &quality, &target, 2).unwrap();
    let mut offscreen = Offscreen::new(&device, &target, false).unwrap();
    let early = stereo(&view_at(0.0, 0.0, 1.0).world_from_eye, 0.06, view_at(0.0, 0.0, 1.0).fov);
    // Late by less than the culling margin.
    let late = stereo(&view_at(0.03, 0.0, 1.0).world_from_eye, 0.06, early[0].fov);
    renderer.begin(0, Span::ZERO, &early, &offscreen.attachments()).unwrap();
    renderer.latch(0, &early).unwrap();
    renderer.latch(0, &late).unwrap();
    renderer.submit(0).unwrap();
    let pictures = offscreen.pictures().unwrap();
    for (picture, view) in pictures.iter().zip(&late) {
        let ndc = project(&view.fov, &(view.world_from_eye.inverse() * Point3::origin())).unwrap();
        let (x, _) = centroid(picture);
        assert!((x - (0.5 * ndc.x + 0.5) * f64::from(SIZE.0)).abs() < 0.5, "{x} {ndc}");
    }
    // Calls out of order are refused.
    assert!(renderer.submit(0).is_err() && renderer.latch(0, &late).is_err());
    small::no_messages(&device);
}

#[test]
fn what_is_not_needed_is_not_made() {
    let Some(device) = device() else { return };
    let quality = Quality { msaa: 1, ..Quality::default() };
    let before = device.census();
    let scene = Arc::new(with_mesh(quad(1.0), Material::default()));
    let needs = Needs::of(&scene, true);
    assert!(needs.surfaces.len() == 1 && !needs.skinning && !needs.text && needs.images.is_empty());
    let renderer = Renderer::new(&device, &scene, &needs, &quality, &Target::new((64, 64), 2), 2).unwrap();
    let made = device.census();
    assert_eq!(made.graphics_pipelines - before.graphics_pipelines, 1);
    assert_eq!(made.compute_pipelines - before.compute_pipelines, 0);
    assert_eq!(made.images - before.images, 0, "no texture, no atlas, no samples between");
    assert_eq!(made.samplers - before.samplers, 0);
    drop(renderer);
    assert_eq!(device.census().buffers, before.buffers, "nothing is left behind");
    // An empty scene is a background and nothing else.
    let empty = Arc::new(Scene { background: [0.0, 1.0, 0.0], ..Scene::default() });
    let needs = Needs::of(&empty, true);
    let renderer = Renderer::new(&device, &empty, &needs, &quality, &Target::new((64, 64), 2), 1).unwrap();
    assert_eq!(device.census().graphics_pipelines, before.graphics_pipelines);
    drop(renderer);
    let views = stereo(&view_at(0.0, 0.0, 1.0).world_from_eye, 0.06, view_at(0.0, 0.0, 1.0).fov);
    let pictures = draw(&device, (*empty).clone(), &quality, (64, 64), &views);
    assert_eq!(pixel(&pictures[1], (64, 64), 32, 32), [0, 255, 0, 255]);
    small::no_messages(&device);
}

#[test]
fn nearer_covers_farther_and_glass_lets_through() {
    let Some(device) = device() else { return };
    let mut scene = with_mesh(quad(1.0), unlit([1.0, 0.0, 0.0, 1.0]));
    let at = |z: f64| Local::Trs(Trs { translation: Vector3::new(0.0, 0.0, z), ..Trs::identity() });
    // Green behind red, then blue glass in front of both; the file's order is the wrong one.
    small::add(&mut scene, quad(2.0), unlit([0.0, 1.0, 0.0, 1.0]), at(-0.001));
    let glass = Material { alpha: Alpha::Blend, ..unlit([0.0, 0.0, 1.0, 0.5]) };
    small::add(&mut scene, quad(0.5), glass, at(0.5));
    scene.nodes.reverse();
    let views = [view_at(0.0, 0.0, 3.0), view_at(0.1, 0.0, 3.0)];
    for msaa in [1, 4] {
        let pictures = draw(&device, scene.clone(), &Quality { msaa, ..Quality::default() }, SIZE, &views);
        let at = |x, y| pixel(&pictures[0], SIZE, x, y);
        assert_eq!(at(256, 256), [187, 0, 187, 255], "half blue over red, in linear light (187.5)");
        assert_eq!(at(256, 195), [255, 0, 0, 255]);
        assert_eq!(at(256, 130), [0, 255, 0, 255]);
        assert_eq!(at(5, 5), [0, 0, 0, 255]);
    }
    small::no_messages(&device);
}

#[test]
fn a_mirrored_node_shows_its_front_and_not_its_back() {
    let Some(device) = device() else { return };
    let material = Material { double_sided: false, ..unlit([1.0; 4]) };
    let mut scene = with_mesh(quad(1.0), material);
    let size = (64, 64);
    let quality = Quality { msaa: 1, ..Quality::default() };
    let mirror = |scale: Vector3<f64>| Local::Trs(Trs { scale, ..Trs::identity() });
    let behind = {
        let world_from_eye = look_at(&Point3::new(0.0, 0.0, -2.0), &Point3::origin());
        View { world_from_eye, ..view_at(0.0, 0.0, 2.0) }
    };
    for (scale, front_is_seen) in [
        (Vector3::new(1.0, 1.0, 1.0), true),
        (Vector3::new(-1.0, 1.0, 1.0), true),
        (Vector3::new(-1.0, 1.0, -1.0), false),
        (Vector3::new(1.0, 0.5, -1.0), false),
    ] {
        scene.nodes[0].parent_from_node = mirror(scale);
        let pictures = draw(&device, scene.clone(), &quality, size, &[view_at(0.0, 0.0, 2.0), behind]);
        let seen: Vec<bool> = pictures.iter().map(|p| pixel(p, size, 32, 32)[0] == 255).collect();
        assert_eq!(seen, [front_is_seen, !front_is_seen], "{scale}");
    }
    small::no_messages(&device);
}

#[test]
fn roughness_from_mirror_to_chalk_gives_numbers() {
    let Some(device) = device() else { return };
    let size = (64, 64);
    for roughness in [0.0, 1e-4, 1e-3, 0.03, 0.3, 1.0] {
        for metallic in [0.0, 1.0] {
            let shading = Shading::MetallicRoughness { metallic, roughness, texture: None, ior: 1.5 };
            let material = Material { shading, base_color: [0.5; 4], ..Material::default() };
            let mut scene = with_mesh(quad(1.0), material);
            scene.ambient = [0.2; 3];
            // The light stands in the mirror's direction for the middle of the picture.
            scene.add_directional([0.0, 0.0, 1.0], 1.0);
            scene.nodes[0].parent_from_node = Local::Trs(Trs {
                rotation: UnitQuaternion::from_euler_angles(0.0, 1e-4, 0.0),
                ..Trs::identity()
            });
            let views = [view_at(0.0, 0.0, 2.0)];
            let pictures = draw(&device, scene, &Quality { msaa: 1, ..Quality::default() }, size, &views);
            // NaN would be stored as 0.
            let middle = pixel(&pictures[0], size, 32, 32);
            assert!(middle[0] > 5, "roughness {roughness} metallic {metallic}: {middle:?}");
            assert_eq!(middle[0], middle[1]);
        }
    }
    small::no_messages(&device);
}

#[test]
fn a_hidden_area_stays_empty_in_its_view_only() {
    let Some(device) = device() else { return };
    let scene = Arc::new(with_mesh(quad(4.0), unlit([1.0; 4])));
    let quality = Quality { msaa: 1, ..Quality::default() };
    let target = Target::new(SIZE, 2);
    let mut renderer =
        Renderer::new(&device, &scene, &Needs::of(&scene, true), &quality, &target, 1).unwrap();
    let mut offscreen = Offscreen::new(&device, &target, true).unwrap();
    // The left half of the right eye.
    let corners = vec![[-10.0, -10.0], [0.0, -10.0], [0.0, 10.0], [-10.0, 10.0]];
    let areas = [(Vec::new(), Vec::new()), (corners, vec![0, 1, 2, 0, 2, 3])];
    renderer.visibility_mask(&areas).unwrap();
    let views = [view_at(0.0, 0.0, 2.0), view_at(0.0, 0.0, 2.0)];
    renderer.begin(0, Span::ZERO, &views, &offscreen.attachments()).unwrap();
    renderer.latch(0, &views).unwrap();
    renderer.submit(0).unwrap();
    let pictures = offscreen.pictures().unwrap();
    assert_eq!(pixel(&pictures[0], SIZE, 100, 256)[0], 255);
    assert_eq!(pixel(&pictures[1], SIZE, 100, 256)[0], 0);
    assert_eq!(pixel(&pictures[1], SIZE, 400, 256)[0], 255);
    let depths = offscreen.depths().unwrap();
    let depth_m = quality.near_m / f64::from(depths[0][(256 * SIZE.0 + 100) as usize]);
    assert!((depth_m - 2.0).abs() < 2e-6, "{depth_m}");
    // Empty lists take it away.
    renderer.visibility_mask(&[]).unwrap();
    renderer.begin(0, Span::ZERO, &views, &offscreen.attachments()).unwrap();
    renderer.latch(0, &views).unwrap();
    renderer.submit(0).unwrap();
    let pictures = offscreen.pictures().unwrap();
    assert_eq!(pixel(&pictures[1], SIZE, 100, 256)[0], 255);
    small::no_messages(&device);
}

#[test]
fn only_an_anisotropy_that_was_asked_for_is_refused() {
    let Some(device) = device() else { return };
    let without = vergence_gpu::Limits { max_anisotropy: 1.0, ..device.limits().clone() };
    let (default, asked) = (Quality::default(), Quality { anisotropy: Some(2.0), ..Quality::default() });
    assert!(default.check(&without).is_ok());
    assert_eq!((default.anisotropy_on(&without), default.anisotropy_on(device.limits())), (1.0, 4.0));
    let error = asked.check(&without).unwrap_err().to_string();
    assert!(error.starts_with("anisotropy: expected 1 to 1 on ") && error.ends_with("found 2"), "{error}");
}

#[test]
fn a_frame_that_was_not_submitted_is_begun_anew() {
    let Some(device) = device() else { return };
    let scene = Arc::new(with_mesh(quad(4.0), unlit([1.0; 4])));
    let quality = Quality { msaa: 1, ..Quality::default() };
    let target = Target::new(SIZE, 1);
    let mut renderer =
        Renderer::new(&device, &scene, &Needs::of(&scene, true), &quality, &target, 1).unwrap();
    let mut offscreen = Offscreen::new(&device, &target, true).unwrap();
    let (away, views) = ([view_at(100.0, 0.0, 2.0)], [view_at(0.0, 0.0, 2.0)]);
    renderer.begin(0, Span::ZERO, &away, &offscreen.attachments()).unwrap();
    assert!(renderer.latch(0, &[]).is_err());
    // Begun, then latched, and never submitted.
    renderer.begin(0, Span::ZERO, &away, &offscreen.attachments()).unwrap();
    renderer.latch(0, &away).unwrap();
    renderer.begin(0, Span::ZERO, &views, &offscreen.attachments()).unwrap();
    assert!(renderer.submit(0).is_err(), "what was latched belongs to the dropped frame");
    renderer.latch(0, &views).unwrap();
    renderer.submit(0).unwrap();
    assert_eq!(pixel(&offscreen.pictures().unwrap()[0], SIZE, 256, 256)[0], 255);
    small::no_messages(&device);
}
