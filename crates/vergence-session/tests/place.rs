//! Where the user is in the scene, and what of it the lenses hide, as the runtime changes its mind: told from the pictures.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod stage;

use std::path::Path;

use stage::{DISC_AHEAD_M, Folder, config, disc, has_vulkan};
use vergence_session::{CaptureConfig, Happening, RunConfig, RunReport, run};
use vergence_xr_sim::Control;
use vergence_xr_sim::fault::{Fault, FaultPlan};

/// The middle of the white disc in the left eye's picture, pixels from its upper left corner, and its pixels; `None`
/// where there is none.
fn disc_in(path: &Path) -> Option<[f64; 3]> {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    let (channels, width) = (info.color_type.samples(), info.width as usize);
    let (mut x, mut y, mut count) = (0.0, 0.0, 0.0);
    for (at, pixel) in pixels[..info.buffer_size()].chunks_exact(channels).enumerate() {
        // The left eye's is the left half.
        if at % width < width / 2 && pixel[..3].iter().all(|&value| value > 200) {
            x += (at % width) as f64 + 0.5;
            y += (at / width) as f64 + 0.5;
            count += 1.0;
        }
    }
    (count > 0.0).then(|| [x / count, y / count, count])
}

/// The row in which a disc is that hangs so far over the eyes: the headset is that of [`Folder::profile`].
fn row(up_m: f64) -> f64 {
    let (up, down) = (44f64.to_radians().tan(), -46f64.to_radians().tan());
    240.0 * (up - up_m / DISC_AHEAD_M) / (up - down)
}

/// Runs, with every picture kept, and `act` after each frame; the left eye's disc in each.
fn discs(
    folder: &Folder,
    config: RunConfig,
    act: impl Fn(u64, &Control),
) -> (RunReport, Vec<Option<[f64; 3]>>) {
    let capture = CaptureConfig { dir: folder.0.join("pictures"), every: Some(1) };
    let config = RunConfig { capture: Some(capture.clone()), ..config };
    let report = run(&disc(false), &config, &mut |happening| {
        if let Happening::Frame { shown, .. } = happening {
            act(shown, &config.control);
        }
    })
    .unwrap();
    assert!(report.validation_messages.is_none_or(|count| count == 0), "{:?}", report.validation_messages);
    let discs = report.pictures.iter().map(|name| disc_in(&capture.dir.join(name))).collect();
    (report, discs)
}

/// The runtime may hide all, and take the mask away again: what was hidden is then drawn.
#[test]
fn what_the_lenses_hide_is_drawn_once_they_hide_nothing() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("mask");
    let path = folder.0.join("masked.toml");
    // Only a corner can be seen: not the disc, which is in the middle.
    let mut profile = std::fs::read_to_string(folder.profile().unwrap()).unwrap();
    profile.push_str("visible = [[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3]]\n");
    std::fs::write(&path, profile).unwrap();
    let config = RunConfig {
        profile: Some(path.to_str().unwrap().to_owned()),
        motion: Some("still".into()),
        ..config(&folder, 30)
    };
    let (report, discs) = discs(&folder, config.clone(), |shown, control| match shown {
        10 => control.set_hidden_area(false),
        20 => control.set_hidden_area(true),
        _ => {}
    });
    assert_eq!((report.frames, report.losses, report.visibility_mask), (30, 0, true));
    let seen: Vec<bool> = discs.iter().map(Option::is_some).collect();
    let first = seen.iter().position(|&is_seen| is_seen).unwrap();
    let after = seen.iter().rposition(|&is_seen| is_seen).unwrap() + 1;
    // The application hears of it with the events of the next frame.
    assert!((10..=12).contains(&first) && (20..=22).contains(&after), "{seen:?}");
    assert!(seen[first..after].iter().all(|&is_seen| is_seen), "{seen:?}");
    let told = report.notices.iter().filter(|notice| notice.contains("hide another part")).count();
    assert_eq!(told, 2, "{:?}", report.notices);
}

/// Who turns away and recentres twice has the scene ahead again at once: no picture shows it in between, as it would be
/// with LOCAL moved and the scene not, or the other way round.
#[test]
fn recentring_brings_the_scene_before_the_eyes_in_one_step() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("recentre");
    let motion = folder.0.join("away.toml");
    let script = r#"
        at-end = "hold"
        [[head]]
        time = "100 ms"
        position = ["0 m", "1.6 m", "0 m"]
        turned = { yaw = "0 deg" }
        [[head]]
        time = "300 ms"
        position = ["0.4 m", "1.1 m", "0.2 m"]
        turned = { yaw = "90 deg" }
        [[headset]]
        time = "500 ms"
        recentre = true
        [[headset]]
        time = "505 ms"
        recentre = true
    "#;
    std::fs::write(&motion, script).unwrap();
    let config = RunConfig { motion: Some(motion.to_str().unwrap().to_owned()), ..config(&folder, 60) };
    let (report, discs) = discs(&folder, config, |_, _| {});
    assert_eq!((report.frames, report.losses), (60, 0));
    assert!(report.notices.iter().any(|notice| notice.contains("recentred")), "{:?}", report.notices);
    let [column, _, _] = discs[0].unwrap();
    let gone = discs.iter().position(Option::is_none).unwrap();
    let back = gone + discs[gone..].iter().position(Option::is_some).unwrap();
    // At 72 Hz the head has turned by frame 22, and 500 ms are 36 frames, with those that are under way.
    assert!(gone < 22 && (35..=41).contains(&back), "{gone} {back}");
    // Ahead, and as far up as before, since the user has sat down and the floor stays where it is.
    for (frame, disc) in discs.iter().enumerate().skip(back) {
        let [x, y, _] = disc.unwrap();
        let is_ahead = (x - column).abs() < 0.5 && (y - row(0.5)).abs() < 0.5;
        assert!(is_ahead, "frame {frame}: {x} {y}, expected {column} {}", row(0.5));
    }
}

/// A floor that the runtime does not know yet is assumed below the eyes of a user of usual height, and is followed once it
/// is known.
#[test]
fn a_floor_that_becomes_known_is_stood_on() {
    if !has_vulkan() {
        return;
    }
    const EYES_M: f64 = 1.2;
    /// Calls; a frame may make several.
    const UNKNOWN: usize = 5;
    let folder = Folder::new("floor");
    let motion = folder.0.join("child.toml");
    let script = format!(
        "at-end = \"hold\"\n[[head]]\ntime = \"0 s\"\nposition = [\"0 m\", \"{EYES_M} m\", \"0 m\"]\n"
    );
    std::fs::write(&motion, script).unwrap();
    let fault = Fault::parse(&format!("xrLocateSpace=NAN_POSE@1-{UNKNOWN}")).unwrap();
    let config = RunConfig {
        motion: Some(motion.to_str().unwrap().to_owned()),
        faults: FaultPlan::new([fault]),
        ..config(&folder, 12)
    };
    let (report, discs) = discs(&folder, config, |_, _| {});
    assert_eq!((report.frames, report.losses), (12, 0));
    // The disc hangs at 1.6 m: level with eyes that are assumed to be there.
    let is_at = |disc: &Option<[f64; 3]>, up_m: f64| (disc.unwrap()[1] - row(up_m)).abs() < 0.5;
    let known = discs.iter().position(|disc| !is_at(disc, 0.0)).unwrap();
    assert!((1..=UNKNOWN).contains(&known), "{known}");
    assert!(discs[known..].iter().all(|disc| is_at(disc, 1.6 - EYES_M)), "{discs:?}");
}
