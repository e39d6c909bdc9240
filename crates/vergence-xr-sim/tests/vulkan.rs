//! Sessions with pictures, through the `openxr` crate on a Vulkan device with validation: swapchains, layers, composition.

#![allow(clippy::unwrap_used, reason = "a test fails where it cannot go on")]
#![allow(unsafe_code, reason = "the runtime is called through its C interface")]

mod vulkan_client;

use std::sync::mpsc::Receiver;

use openxr as xr;
use vergence_geom::{Fov, Rigid};
use vergence_gpu::vk;
use vergence_xr_sim::{Capture, ComposedFrame, Config, Profile, Still};
use vulkan_client::{Client, Picture, Quad};
use xr::SessionState as S;
use xr::sys;

/// Spoils a layer.
type Change<'a> = &'a dyn Fn(&mut vulkan_client::Projection);

/// A headset whose pictures are quick to make on a CPU.
const SMALL: &str = r#"
name = "small"
resolution = [128, 96]
rates = ["90 Hz"]
ipd = "63 mm"
[left]
fov = { left = "-50 deg", right = "40 deg", up = "35 deg", down = "-45 deg" }
"#;
const SIZE: (u32, u32) = (128, 96);

fn small() -> (Config, Receiver<ComposedFrame>) {
    let profile = Profile::parse(std::path::Path::new("small.toml"), SMALL).unwrap();
    let (capture, frames) = Capture::channel();
    (Config { profile, capture: Some(capture), ..Config::default() }, frames)
}

/// Bytes without any pattern, the same on every machine.
fn noise(size: (u32, u32), layers: u32) -> Vec<u8> {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let step = |_| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 24) as u8
    };
    (0..4 * size.0 * size.1 * layers).map(step).collect()
}

#[test]
fn a_session_goes_through_its_states_one_frame_at_a_time_and_ends_cleanly() {
    let (config, frames) = small();
    let Some(mut client) = Client::new(Config { frames: Some(100), ..config }) else { return };
    assert_eq!(client.entered(), [S::IDLE, S::READY]);
    client.begin();
    let mut picture = Picture::new(&client, vk::Format::R8G8B8A8_SRGB, SIZE, 2);
    let depth = Picture::new(&client, vk::Format::D32_SFLOAT, SIZE, 2);
    let mut rendered = Vec::new();
    let mut states = Vec::new();
    while states.last() != Some(&S::STOPPING) {
        let (time, should_render) = client.begin_frame();
        rendered.push(should_render);
        let views = client.views(time);
        if should_render {
            picture.fill(&client, &noise(SIZE, 2));
            depth.touch();
        }
        let layers = should_render.then(|| client.projection(&views, &picture, Some(&depth)));
        client.end_frame(time, layers.as_ref()).unwrap();
        states.extend(client.entered());
        assert!(rendered.len() < 200);
    }
    assert_eq!(states, [S::SYNCHRONIZED, S::VISIBLE, S::FOCUSED, S::VISIBLE, S::SYNCHRONIZED, S::STOPPING]);
    // One frame to synchronize, one to become visible.
    assert_eq!(rendered[..3], [false, false, true]);
    assert_eq!(rendered.iter().filter(|&&rendered| rendered).count(), 100);
    client.session.end().unwrap();
    assert_eq!(client.entered(), [S::IDLE, S::EXITING]);
    let frames: Vec<ComposedFrame> = frames.try_iter().collect();
    assert_eq!(frames.len(), 100);
    assert!(frames.iter().enumerate().all(|(index, frame)| frame.number == index as u64));
    drop((picture, depth));
    client.finish();
}

/// A picture that was drawn for the pose, the field of view and the size of the display is shown as it is, bit by bit.
#[test]
fn the_composed_picture_is_the_submitted_one_where_nothing_differs() {
    for format in [vk::Format::R8G8B8A8_SRGB, vk::Format::B8G8R8A8_SRGB] {
        let (config, frames) = small();
        let Some(mut client) = Client::new(config) else { return };
        let bytes = noise(SIZE, 2);
        let mut picture = Picture::new(&client, format, SIZE, 2);
        client.show(&mut picture, &bytes, |views| views.to_vec());
        let frame = frames.try_iter().last().unwrap();
        assert_eq!(frame.size, SIZE);
        let half = bytes.len() / 2;
        for (eye, submitted) in [&bytes[..half], &bytes[half..]].into_iter().enumerate() {
            let mut submitted = submitted.to_vec();
            if format == vk::Format::B8G8R8A8_SRGB {
                submitted.chunks_exact_mut(4).for_each(|texel| texel.swap(0, 2));
            }
            assert!(frame.eyes[eye].rgba == submitted, "{format:?}, eye {eye}");
        }
        let ipd =
            frame.eyes[0].view_in_local.world_from_eye.inverse() * frame.eyes[1].view_in_local.world_from_eye;
        assert!((ipd.translation.vector - nalgebra::Vector3::new(0.063, 0.0, 0.0)).norm() < 1e-12);
        drop(picture);
        client.finish();
    }
}

/// Decoded as the sRGB standard (IEC 61966-2-1) says, 0…1.
fn linear(code: u8) -> f64 {
    let c = f64::from(code) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Encoded as the sRGB standard says.
fn encoded(linear: f64) -> u8 {
    let c = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (255.0 * c).round() as u8
}

/// A round spot with smooth edges (a Gaussian of 4 pixels) on black, in both layers.
fn spot(size: (u32, u32), centre: (f64, f64)) -> Vec<u8> {
    let mut bytes = Vec::new();
    for _layer in 0..2 {
        for y in 0..size.1 {
            for x in 0..size.0 {
                let (dx, dy) = (f64::from(x) + 0.5 - centre.0, f64::from(y) + 0.5 - centre.1);
                let code = encoded((-(dx * dx + dy * dy) / (2.0 * 16.0)).exp());
                bytes.extend([code, code, code, 255]);
            }
        }
    }
    bytes
}

/// Where the light of a picture is: its centroid, in pixels from the upper left corner.
fn centroid(rgba: &[u8], size: (u32, u32)) -> (f64, f64) {
    let (mut sum, mut x_sum, mut y_sum) = (0.0, 0.0, 0.0);
    for (index, texel) in rgba.chunks_exact(4).enumerate() {
        let light = linear(texel[0]);
        let (x, y) = (index as u32 % size.0, index as u32 / size.0);
        sum += light;
        x_sum += light * (f64::from(x) + 0.5);
        y_sum += light * (f64::from(y) + 0.5);
    }
    (x_sum / sum, y_sum / sum)
}

/// A direction in an eye, from a place in its picture; and back.
fn direction(fov: &Fov, size: (u32, u32), place: (f64, f64)) -> nalgebra::Vector3<f64> {
    let [l, r, u, d] = fov.tangents();
    let (x, y) = (place.0 / f64::from(size.0), place.1 / f64::from(size.1));
    nalgebra::Vector3::new(l + (r - l) * x, u + (d - u) * y, -1.0)
}

fn place(fov: &Fov, size: (u32, u32), direction: &nalgebra::Vector3<f64>) -> (f64, f64) {
    let ndc = vergence_geom::project(fov, &nalgebra::Point3::from(*direction)).unwrap();
    (0.5 * (ndc.x + 1.0) * f64::from(size.0), 0.5 * (ndc.y + 1.0) * f64::from(size.1))
}

/// The light that falls on each place of the picture when the spot is seen through `source_place`.
fn expected(
    fov: &Fov,
    centre: (f64, f64),
    source_place: impl Fn(&nalgebra::Vector3<f64>) -> (f64, f64),
) -> Vec<u8> {
    let light = |index: u32| {
        let (x, y) = (index % SIZE.0, index / SIZE.0);
        let (u, v) = source_place(&direction(fov, SIZE, (f64::from(x) + 0.5, f64::from(y) + 0.5)));
        let (dx, dy) = (u - centre.0, v - centre.1);
        let code = encoded((-(dx * dx + dy * dy) / (2.0 * 16.0)).exp());
        [code, code, code, 255]
    };
    (0..SIZE.0 * SIZE.1).flat_map(light).collect()
}

/// A spot that was drawn for a head turned by a degree appears where it is in the world. The bound is what colours
/// of 8 bits and filter weights of 8 bits (Vulkan asks for 4) leave.
#[test]
fn a_layer_drawn_for_another_pose_is_turned_to_the_true_one() {
    const CENTROID_PX: f64 = 0.02;
    for (yaw_deg, pitch_deg, centre) in
        [(1.0, 0.0, (64.0, 48.0)), (0.0, -1.0, (40.3, 60.2)), (-1.0, 1.0, (90.0, 30.0))]
    {
        let (config, frames) = small();
        let profile = config.profile.clone();
        let Some(mut client) = Client::new(config) else { return };
        let turn = Rigid::rotation(nalgebra::Vector3::y() * f64::to_radians(yaw_deg))
            * Rigid::rotation(nalgebra::Vector3::x() * f64::to_radians(pitch_deg));
        let mut picture = Picture::new(&client, vk::Format::R8G8B8A8_SRGB, SIZE, 2);
        client.show(&mut picture, &spot(SIZE, centre), |views| {
            views
                .iter()
                .map(|view| xr::View { pose: vulkan_client::turned(&view.pose, &turn), fov: view.fov })
                .collect()
        });
        let frame = frames.try_iter().last().unwrap();
        for (eye, composed) in frame.eyes.iter().enumerate() {
            let fov = profile.eyes[eye].fov;
            let back = turn.inverse();
            let truth = centroid(&expected(&fov, centre, |seen| place(&fov, SIZE, &(back * seen))), SIZE);
            let found = centroid(&composed.rgba, SIZE);
            let moved = (truth.0 - centre.0).hypot(truth.1 - centre.1);
            assert!(moved > 0.8, "the test must not be vacuous: {moved}");
            let error = (found.0 - truth.0).hypot(found.1 - truth.1);
            assert!(error < CENTROID_PX, "{yaw_deg} {pitch_deg} eye {eye}: {found:?}, expected {truth:?}");
        }
        drop(picture);
        client.finish();
    }
}

/// A layer with another field of view and size, in a format that is not shown directly.
#[test]
fn another_field_of_view_is_mapped_into_the_picture() {
    let size = (200, 150);
    let fov = Fov::symmetric(110f64.to_radians(), 1.4).unwrap();
    let (config, frames) = small();
    let profile = config.profile.clone();
    let Some(mut client) = Client::new(config) else { return };
    let mut picture = Picture::new(&client, vk::Format::R8G8B8A8_UNORM, size, 2);
    let centre = (110.0, 70.0);
    let drawn = spot(size, centre);
    // The numbers of a UNORM format are light as they are.
    let light: Vec<u8> = drawn.iter().map(|&code| (255.0 * linear(code)).round() as u8).collect();
    client.show(&mut picture, &light, |views| {
        let angles = [fov.left_rad, fov.right_rad, fov.up_rad, fov.down_rad].map(|angle| angle as f32);
        let [angle_left, angle_right, angle_up, angle_down] = angles;
        let fov = xr::Fovf { angle_left, angle_right, angle_up, angle_down };
        views.iter().map(|view| xr::View { pose: view.pose, fov }).collect()
    });
    let frame = frames.try_iter().last().unwrap();
    for (eye, composed) in frame.eyes.iter().enumerate() {
        let seen = expected(&profile.eyes[eye].fov, centre, |seen| place(&fov, size, seen));
        let truth = centroid(&seen, SIZE);
        let found = centroid(&composed.rgba, SIZE);
        let error = (found.0 - truth.0).hypot(found.1 - truth.1);
        assert!(error < 0.05, "eye {eye}: {found:?}, expected {truth:?}");
    }
    drop(picture);
    client.finish();
}

/// A red square of 40 cm, half a metre ahead of each eye's head, over nothing.
#[test]
fn a_quad_is_where_it_was_put() {
    let (config, frames) = small();
    let profile = config.profile.clone();
    let Some(mut client) = Client::new(Config { motion: Box::new(Still::default()), ..config }) else {
        return;
    };
    let mut picture = Picture::new(&client, vk::Format::R8G8B8A8_SRGB, (16, 16), 1);
    let red: Vec<u8> = [255, 0, 0, 255].repeat(256);
    client.show_quad(&mut picture, &red, [0.05, 0.0, -0.5], [0.4, 0.4]);
    let frame = frames.try_iter().last().unwrap();
    for (eye, composed) in frame.eyes.iter().enumerate() {
        let eye_in_head = profile.eyes[eye].head_from_eye.translation.vector;
        let middle = nalgebra::Vector3::new(0.05, 0.0, -0.5) - eye_in_head;
        let truth = place(&profile.eyes[eye].fov, SIZE, &middle);
        let found = centroid(&composed.rgba, SIZE);
        // Edges are not smoothed: half a pixel on each side.
        assert!((found.0 - truth.0).hypot(found.1 - truth.1) < 0.5, "{found:?} {truth:?}");
        let lit = composed.rgba.chunks_exact(4).filter(|texel| texel[0] == 255).count() as f64;
        let [l, r, u, d] = profile.eyes[eye].fov.tangents();
        let area = (0.4 / 0.5) * (0.4 / 0.5) / ((r - l) * (u - d)) * f64::from(SIZE.0 * SIZE.1);
        assert!((lit / area - 1.0).abs() < 0.05, "{lit} {area}");
        assert!(composed.rgba.chunks_exact(4).all(|texel| texel[1] == 0 && texel[2] == 0 && texel[3] == 255));
    }
    drop(picture);
    client.finish();
}

/// Layers lie upon one another in the order in which they are submitted, not by distance; for the eyes that they name; and
/// what shines through is added up in linear light.
#[test]
fn quads_lie_in_their_order_for_their_eyes_with_their_alpha() {
    use sys::CompositionLayerFlags as F;
    let (config, frames) = small();
    let Some(mut client) = Client::new(Config { motion: Box::new(Still::default()), ..config }) else {
        return;
    };
    let picture = |client: &Client| Picture::new(client, vk::Format::R8G8B8A8_SRGB, (4, 4), 1);
    let mut pictures: Vec<Picture> = (0..4).map(|_| picture(&client)).collect();
    let [ground, straight, multiplied, far] = &mut pictures[..] else { unreachable!() };
    // Half of full light is the code 188.
    let half = encoded(0.5);
    let [green, red, half_red, blue] =
        [[0, 255, 0, 255], [255, 0, 0, 128], [half, 0, 0, 128], [0, 0, 255, 255]].map(|c| c.repeat(16));
    let quad = |bytes, at, side: f32, eyes, flags| Quad { bytes, at, size: [side, side], eyes, flags };
    let (both, left, right) = (xr::EyeVisibility::BOTH, xr::EyeVisibility::LEFT, xr::EyeVisibility::RIGHT);
    let alpha = F::BLEND_TEXTURE_SOURCE_ALPHA;
    client.show_quads(&mut [
        (ground, quad(&green, [0.0, 0.0, -1.0], 4.0, both, F::EMPTY)),
        (straight, quad(&red, [0.0, 0.0, -1.0], 4.0, left, alpha | F::UNPREMULTIPLIED_ALPHA)),
        (multiplied, quad(&half_red, [0.0, 0.0, -1.0], 4.0, right, alpha)),
        // Behind all the others, and shown upon them.
        (far, quad(&blue, [0.0, 0.0, -5.0], 1.0, both, F::EMPTY)),
    ]);
    let frame = frames.try_iter().last().unwrap();
    for (eye, composed) in frame.eyes.iter().enumerate() {
        let texel = |x: f64, y: f64| {
            let start = 4 * (y as usize * SIZE.0 as usize + x as usize);
            [composed.rgba[start], composed.rgba[start + 1], composed.rgba[start + 2]]
        };
        let fov = composed.view_in_local.fov;
        let middle = place(&fov, SIZE, &nalgebra::Vector3::new(0.0, 0.0, -5.0));
        assert_eq!(texel(middle.0, middle.1), [0, 0, 255], "eye {eye}");
        let aside = place(&fov, SIZE, &nalgebra::Vector3::new(0.3, 0.2, -1.0));
        let [r, g, b] = texel(aside.0, aside.1);
        assert!(r.abs_diff(half) <= 1 && g.abs_diff(half) <= 1 && b == 0, "eye {eye}: {r} {g} {b}");
    }
    drop(pictures);
    client.finish();
}

#[test]
fn images_are_taken_and_given_back_in_order() {
    let Some(client) = Client::new(Config::default()) else { return };
    let out_of_order = sys::Result::ERROR_CALL_ORDER_INVALID;
    let chain = client.swapchain(vk::Format::R8G8B8A8_SRGB, SIZE, 2).unwrap();
    assert_eq!(chain.enumerate_images().unwrap().len(), 3);
    // The client crate keeps the order itself: around it.
    let (fp, raw) = (client.instance.fp(), chain.as_raw());
    let wait_info = sys::SwapchainImageWaitInfo {
        ty: sys::SwapchainImageWaitInfo::TYPE,
        next: std::ptr::null(),
        timeout: xr::Duration::INFINITE,
    };
    let done = sys::Result::SUCCESS;
    // SAFETY: the swapchain lives, and every pointer is null or to a local.
    let acquire = || unsafe {
        let mut index = u32::MAX;
        ((fp.acquire_swapchain_image)(raw, std::ptr::null(), &mut index), index)
    };
    // SAFETY: as above.
    let wait = || unsafe { (fp.wait_swapchain_image)(raw, &wait_info) };
    // SAFETY: as above.
    let release = || unsafe { (fp.release_swapchain_image)(raw, std::ptr::null()) };
    assert_eq!((wait(), release()), (out_of_order, out_of_order));
    assert_eq!([acquire(), acquire(), acquire()], [(done, 0), (done, 1), (done, 2)]);
    assert_eq!((acquire().0, release()), (out_of_order, out_of_order));
    assert_eq!((wait(), wait(), release()), (done, out_of_order, done));
    assert_eq!(acquire(), (done, 0));
    let refused = client.swapchain(vk::Format::R8_UNORM, SIZE, 2).err();
    assert_eq!(refused, Some(sys::Result::ERROR_SWAPCHAIN_FORMAT_UNSUPPORTED));
    let refused = client.swapchain(vk::Format::R8G8B8A8_SRGB, (0, 4), 2).err();
    assert_eq!(refused, Some(sys::Result::ERROR_VALIDATION_FAILURE));
    drop(chain);
    client.finish();
}

#[test]
fn layers_that_are_none_are_refused() {
    let (config, _frames) = small();
    let Some(mut client) = Client::new(config) else { return };
    let mut picture = Picture::new(&client, vk::Format::R8G8B8A8_SRGB, SIZE, 2);
    client.begin();
    let (time, _) = client.begin_frame();
    let views = client.views(time);
    let submit = |client: &mut Client, picture: &Picture, change: Change| {
        let mut layer = client.projection(&views, picture, None);
        change(&mut layer);
        client.end_frame(time, Some(&layer)).err()
    };
    // Nothing was released yet.
    assert_eq!(submit(&mut client, &picture, &|_| ()), Some(sys::Result::ERROR_LAYER_INVALID));
    picture.fill(&client, &noise(SIZE, 2));
    let cases: [(sys::Result, Change); 6] = [
        (sys::Result::ERROR_SWAPCHAIN_RECT_INVALID, &|l| l.views[1].sub_image.image_rect.extent.width += 1),
        (sys::Result::ERROR_SWAPCHAIN_RECT_INVALID, &|l| l.views[0].sub_image.image_rect.offset.y = -1),
        (sys::Result::ERROR_VALIDATION_FAILURE, &|l| l.views[0].sub_image.image_array_index = 2),
        (sys::Result::ERROR_POSE_INVALID, &|l| l.views[0].pose.orientation.w = f32::NAN),
        (sys::Result::ERROR_VALIDATION_FAILURE, &|l| l.view_count = 1),
        (sys::Result::ERROR_HANDLE_INVALID, &|l| l.space = sys::Space::default()),
    ];
    for (code, change) in cases {
        assert_eq!(submit(&mut client, &picture, change), Some(code));
    }
    assert_eq!(submit(&mut client, &picture, &|_| ()), None);
    drop(picture);
    client.finish();
}
