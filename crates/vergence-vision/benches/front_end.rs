//! Time and output of the front end on given pictures, for `tools/compare-front-end`, which sets them beside OpenCV's.
//!
//!     front_end times A.pgm B.pgm POINTS.txt     one line of JSON: medians of CPU time, ms
//!     front_end points PICTURE.pgm...            PICTURE.pgm.orb: x y size angle bits, a line each; 31 × scale is the size
//!
//! Without arguments it makes two pictures itself, so that it runs anywhere.

use std::path::Path;

use nalgebra::Vector2;
use rustix::time::{ClockId, clock_gettime};
use vergence_vision::{FastDetector, MatchKnobs, match_all};
use vergence_vision::{Flow, FlowKnobs, Gray, Orb, OrbKnobs, Pyramid};

struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Picture {
    /// A binary PGM with one byte a pixel.
    fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut words = Vec::new();
        let mut at = 0;
        while words.len() < 4 {
            let end =
                at + bytes[at..].iter().position(u8::is_ascii_whitespace).expect("a header of four words");
            words.push(std::str::from_utf8(&bytes[at..end]).expect("a header in ASCII").to_owned());
            at = end + 1;
        }
        assert!(words[0] == "P5" && words[3] == "255", "{}: expected P5 with 255 levels", path.display());
        let side = |n: usize| words[n].parse().expect("a number of pixels");
        Self { width: side(1), height: side(2), pixels: bytes[at..].to_vec() }
    }

    /// Smooth blobs, moved by `shift` pixels.
    fn made_up(shift: f64) -> Self {
        let (width, height) = (752, 480);
        let shade = |i: usize| {
            let (x, y) = ((i % width) as f64 + shift, (i / width) as f64);
            let wave = |k: f64| {
                ((x * (k * 2.4).cos() + y * (k * 2.4).sin()) * std::f64::consts::TAU / (5.0 + 3.0 * k)).sin()
            };
            let sum: f64 = (1..12).map(|k| wave(f64::from(k))).sum();
            (128.0 + 60.0 * sum.clamp(-2.0, 2.0)) as u8
        };
        Self { width, height, pixels: (0..width * height).map(shade).collect() }
    }

    fn gray(&self) -> Gray<'_> {
        Gray::new(self.width, self.height, self.width, &self.pixels).expect("a whole picture")
    }
}

/// The median CPU time of `work`, ms.
fn median(mut work: impl FnMut()) -> f64 {
    let now = || {
        let time = clock_gettime(ClockId::ThreadCPUTime);
        time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
    };
    let mut times: Vec<f64> = (0..41)
        .map(|_| {
            let before = now();
            work();
            now() - before
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn times(a: &Picture, b: &Picture, points: &[Vector2<f64>]) {
    let (width, height) = (a.width, a.height);
    let mut pyramids = [Pyramid::new(width, height, 4), Pyramid::new(width, height, 4)];
    let mut found = 0;
    let mut lk = |window_px: usize| {
        let mut flow = Flow::new(FlowKnobs { window_px, ..FlowKnobs::default() }).expect("a window in range");
        median(|| {
            pyramids[0].build(&a.gray());
            pyramids[1].build(&b.gray());
            let follow = |p: &&Vector2<f64>| flow.follow(&pyramids[0], &pyramids[1], p, p, 3, None).is_some();
            found = points.iter().filter(follow).count();
        })
    };
    let (lk_21, lk_15) = (lk(21), lk(15));
    let mut fast = FastDetector::default();
    let mut corners = Vec::new();
    let mut detect = |threshold| {
        median(|| {
            corners.clear();
            fast.detect(&a.gray(), threshold, &mut corners);
        })
    };
    let (fast_20, fast_10) = (detect(20), detect(10));
    let mut orb = Orb::new(width, height, OrbKnobs::default()).expect("knobs in range");
    let (mut keypoints, mut first, mut second) = (Vec::new(), Vec::new(), Vec::new());
    orb.detect(&b.gray(), &mut keypoints, &mut second).expect("the announced size");
    let orb_ms = median(|| orb.detect(&a.gray(), &mut keypoints, &mut first).expect("the announced size"));
    let knobs = MatchKnobs { most_bits: 256, ratio: 1.0, mutual: true };
    let mut matches = 0;
    let match_ms = median(|| matches = match_all(&first, &second, &knobs).len());
    println!(
        "{{\"lk_21\": {lk_21:.3}, \"lk_15\": {lk_15:.3}, \"fast_20\": {fast_20:.3}, \"fast_10\": {fast_10:.3}, \
         \"orb\": {orb_ms:.3}, \"match\": {match_ms:.3}, \"followed\": {found}, \"points\": {}, \"matches\": {matches}}}",
        first.len()
    );
}

fn points(path: &Path) {
    let picture = Picture::read(path);
    let mut orb =
        Orb::new(picture.width, picture.height, OrbKnobs::default()).expect("a picture large enough");
    let (mut keypoints, mut descriptors) = (Vec::new(), Vec::new());
    orb.detect(&picture.gray(), &mut keypoints, &mut descriptors).expect("the announced size");
    let mut lines = String::new();
    for (point, descriptor) in keypoints.iter().zip(&descriptors) {
        let [a, b, c, d] = descriptor.0;
        let (p, angle) = (point.pixel, point.angle_rad);
        lines +=
            &format!("{} {} {} {angle} {a:016x}{b:016x}{c:016x}{d:016x}\n", p.x, p.y, 31.0 * point.scale);
    }
    let out = path.with_added_extension("orb");
    std::fs::write(&out, lines).unwrap_or_else(|error| panic!("{}: {error}", out.display()));
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        ["times", a, b, list] => {
            let text = std::fs::read_to_string(list).unwrap_or_else(|error| panic!("{list}: {error}"));
            let point = |line: &str| {
                let (x, y) = line.split_once(' ').expect("two numbers a line");
                Vector2::new(x.parse().expect("a number"), y.parse().expect("a number"))
            };
            let points: Vec<_> = text.lines().map(point).collect();
            times(&Picture::read(a.as_ref()), &Picture::read(b.as_ref()), &points);
        }
        ["points", ref pictures @ ..] => pictures.iter().for_each(|path| points(path.as_ref())),
        _ => {
            let points: Vec<_> = (0..200)
                .map(|i| Vector2::new(40.0 + f64::from(i % 20) * 34.0, 40.0 + f64::from(i / 20) * 40.0))
                .collect();
            times(&Picture::made_up(0.0), &Picture::made_up(2.5), &points);
        }
    }
}
