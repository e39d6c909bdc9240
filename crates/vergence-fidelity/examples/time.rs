//! How long each measure takes for two pictures of 1024 × 1024 pixels: `cargo run --release --example time`.

use std::time::Instant;

use vergence_fidelity::{DEFAULT_PIXELS_PER_DEGREE, Picture, flip, rmse, ssim};

fn main() -> Result<(), vergence_fidelity::Error> {
    let side = 1024;
    let pixels = |seed: usize| -> Vec<u8> {
        (0..3 * side * side).map(|i| ((i / 97 + seed * i) % 251) as u8).collect()
    };
    let (a, b) = (Picture::from_rgb8(side, side, &pixels(0))?, Picture::from_rgb8(side, side, &pixels(1))?);
    let time = |name: &str, f: &dyn Fn() -> Result<f64, vergence_fidelity::Error>| {
        let start = Instant::now();
        let value = f()?;
        println!("{name}: {value:.6} in {:.0} ms", start.elapsed().as_secs_f64() * 1e3);
        Ok(())
    };
    time("rmse", &|| rmse(&a, &b))?;
    time("ssim", &|| ssim(&a, &b))?;
    time("flip", &|| Ok(flip(&a, &b, DEFAULT_PIXELS_PER_DEGREE)?.mean))
}
