//! Our measures against values recorded from scikit-image and NVIDIA's flip-evaluator (`references/oracle.py`).

use vergence_fidelity::{Error, Picture, flip, psnr_db, rmse, ssim, ssim_luma};

const WIDTH: usize = 256;
const HEIGHT: usize = 192;
/// What two implementations of the same definition may differ by: f32 against f64, not another definition.
const TOLERANCE: f64 = 1e-4;
/// For sums without any filter.
const TIGHT: f64 = 1e-7;

fn reference() -> Vec<u8> {
    let mut bytes = Vec::with_capacity(3 * WIDTH * HEIGHT);
    for y in 0..HEIGHT as i64 {
        for x in 0..WIDTH as i64 {
            let mut rgb = [
                255 * x / (WIDTH as i64 - 1),
                255 * y / (HEIGHT as i64 - 1),
                20 + 200 * ((x / 8 + y / 8) & 1),
            ];
            if (x - 80).pow(2) + (y - 96).pow(2) < 40 * 40 {
                rgb = [200, 40, 30];
            }
            if x >= 150 && y >= 100 {
                rgb = [255 * ((x * x / 64) & 1); 3];
            }
            bytes.extend(rgb.map(|v| v as u8));
        }
    }
    bytes
}

fn noisy(bytes: &[u8]) -> Vec<u8> {
    let noise = |i: usize| {
        let mut h = (i as u32).wrapping_mul(2_654_435_761);
        h ^= h >> 15;
        h = h.wrapping_mul(2_246_822_519);
        h ^= h >> 13;
        (h.to_le_bytes().map(i32::from).iter().sum::<i32>() - 510).div_euclid(18)
    };
    bytes.iter().enumerate().map(|(i, &v)| (i32::from(v) + noise(i)).clamp(0, 255) as u8).collect()
}

fn shifted(bytes: &[u8]) -> Vec<u8> {
    let pixel = |i: usize| if i.is_multiple_of(WIDTH) { i } else { i - 1 };
    (0..WIDTH * HEIGHT).flat_map(|i| bytes[3 * pixel(i)..3 * pixel(i) + 3].to_vec()).collect()
}

fn dimmed(bytes: &[u8]) -> Vec<u8> {
    bytes.iter().map(|&v| (u32::from(v) * 3 / 4) as u8).collect()
}

fn turned(bytes: &[u8]) -> Vec<u8> {
    bytes.chunks_exact(3).flat_map(|p| [p[1], p[2], p[0]]).collect()
}

#[test]
fn our_measures_equal_the_recorded_ones() {
    let record: serde_json::Value = serde_json::from_str(include_str!("../references/values.json")).unwrap();
    let original = reference();
    let draw = |name: &str| match name.split('_').next().unwrap() {
        "reference" => original.clone(),
        "noise" => noisy(&original),
        "shift" => shifted(&original),
        "dim" => dimmed(&original),
        "turn" => turned(&original),
        other => panic!("unknown picture {other}"),
    };
    for (name, sum) in record["byte_sums"].as_object().unwrap() {
        let ours: u64 = draw(name).iter().map(|&v| u64::from(v)).sum();
        assert_eq!(ours, sum.as_u64().unwrap(), "{name} is not the picture that was measured");
    }
    let picture = |bytes: &[u8]| Picture::from_rgb8(WIDTH, HEIGHT, bytes).unwrap();
    let a = picture(&original);
    let pairs = record["pairs"].as_object().unwrap();
    assert!(pairs.len() >= 6);
    type Measure = fn(&Picture, &Picture) -> Result<f64, Error>;
    let measures: [(&str, Measure, f64); 4] = [
        ("rmse", rmse, TIGHT),
        ("psnr_db", psnr_db, 1e-5),
        ("ssim", ssim, TOLERANCE),
        ("ssim_luma", ssim_luma, TOLERANCE),
    ];
    for (name, values) in pairs {
        let b = picture(&draw(name));
        let recorded = |key: &str| values[key].as_f64().unwrap();
        for (key, measure, tolerance) in measures {
            let ours = measure(&a, &b).unwrap();
            println!("{name:>13} {key:>9}: ours {ours:.6}, recorded {:.6}", recorded(key));
            assert!((ours - recorded(key)).abs() <= tolerance, "{name} {key}");
        }
        let ours = flip(&a, &b, recorded("ppd")).unwrap().mean;
        println!("{name:>13}      flip: ours {ours:.6}, recorded {:.6}", recorded("flip"));
        assert!((ours - recorded("flip")).abs() <= TOLERANCE, "{name} flip");
    }
}
