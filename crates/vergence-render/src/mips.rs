//! The levels of a texture: each half as large, averaged in linear light, with the weights of a box that fits
//! also where a size is odd.

use vergence_scene::linear_from_srgb;

/// All levels of an image (8-bit RGBA, rows from the top), from the full one down to one texel, one after the
/// other. `srgb`: red, green and blue are sRGB (alpha never is). Each level is the area average of the one before,
/// kept in single precision on the way and rounded once. O(texels).
pub fn mip_chain(rgba: &[u8], width: u32, height: u32, srgb: bool) -> Vec<u8> {
    let mut bytes = rgba.to_vec();
    let (mut width, mut height) = (width as usize, height as usize);
    let to_linear: Vec<f32> = (0..=255u8)
        .map(|v| if srgb { linear_from_srgb(f32::from(v) / 255.0) } else { f32::from(v) / 255.0 })
        .collect();
    let encode = Encoder::new(srgb);
    let mut level: Vec<[f32; 4]> = rgba
        .chunks_exact(4)
        .map(|t| {
            let color = [t[0], t[1], t[2]].map(|v| to_linear[usize::from(v)]);
            [color[0], color[1], color[2], f32::from(t[3]) / 255.0]
        })
        .collect();
    while width > 1 || height > 1 {
        let across = halve(&level, width, height);
        let half_width = (width / 2).max(1);
        level = transpose(
            &halve(&transpose(&across, half_width, height), height, half_width),
            (height / 2).max(1),
            half_width,
        );
        (width, height) = (half_width, (height / 2).max(1));
        for t in &level {
            bytes.extend([encode.byte(t[0]), encode.byte(t[1]), encode.byte(t[2])]);
            bytes.push((t[3] * 255.0 + 0.5) as u8);
        }
    }
    bytes
}

/// Rows of half the length: each texel the average of the part of the row that it covers.
fn halve(texels: &[[f32; 4]], width: usize, height: usize) -> Vec<[f32; 4]> {
    let half = (width / 2).max(1);
    let mut out = Vec::with_capacity(half * height);
    for row in texels.chunks_exact(width).take(height) {
        if width == 1 {
            out.push(row[0]);
        } else if width.is_multiple_of(2) {
            out.extend(row.chunks_exact(2).map(|t| [0, 1, 2, 3].map(|k| 0.5 * (t[0][k] + t[1][k]))));
        } else {
            // 2h+1 texels become h: the weights of three neighbours slide along the row (Guthe & Heckbert 2005).
            let total = width as f32;
            out.extend((0..half).map(|i| {
                let weights = [(half - i) as f32, half as f32, (i + 1) as f32].map(|w| w / total);
                [0, 1, 2, 3].map(|k| (0..3).map(|j| weights[j] * row[2 * i + j][k]).sum())
            }));
        }
    }
    out
}

fn transpose(texels: &[[f32; 4]], width: usize, height: usize) -> Vec<[f32; 4]> {
    let mut out = Vec::with_capacity(texels.len());
    for x in 0..width {
        out.extend((0..height).map(|y| texels[y * width + x]));
    }
    out
}

/// To the nearest code: for sRGB by the linear values half-way between codes.
struct Encoder {
    thresholds: Option<Vec<f32>>,
}

impl Encoder {
    fn new(srgb: bool) -> Self {
        let thresholds =
            srgb.then(|| (0..255u8).map(|v| linear_from_srgb((f32::from(v) + 0.5) / 255.0)).collect());
        Self { thresholds }
    }

    fn byte(&self, value: f32) -> u8 {
        match &self.thresholds {
            None => (value * 255.0 + 0.5) as u8,
            Some(thresholds) => thresholds.partition_point(|threshold| *threshold <= value) as u8,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_and_white_average_to_half_the_light() {
        let pair = [0, 0, 0, 255, 255, 255, 255, 255];
        assert_eq!(mip_chain(&pair, 2, 1, true)[8..], [188, 188, 188, 255]);
        assert_eq!(mip_chain(&pair, 2, 1, false)[8..], [128, 128, 128, 255]);
    }

    /// The area average is kept on every level, also with odd sizes.
    #[test]
    fn the_last_level_is_the_mean() {
        for (width, height) in [(7u32, 5u32), (8, 8), (1, 13), (300, 1), (3, 2)] {
            let rgba: Vec<u8> = (0..4 * width * height).map(|i| (i * 37 % 251) as u8).collect();
            let chain = mip_chain(&rgba, width, height, false);
            let last = &chain[chain.len() - 4..];
            for (k, found) in last.iter().enumerate() {
                let mean = rgba.iter().skip(k).step_by(4).map(|&v| f64::from(v)).sum::<f64>()
                    / f64::from(width * height);
                assert!((f64::from(*found) - mean).abs() <= 0.51, "{width}x{height}: {found} {mean}");
            }
        }
    }

    #[test]
    fn one_colour_stays_itself() {
        for srgb in [true, false] {
            let rgba: Vec<u8> = [13u8, 200, 255, 77].repeat(5 * 9);
            assert!(mip_chain(&rgba, 5, 9, srgb).chunks_exact(4).all(|t| t == [13, 200, 255, 77]));
        }
    }
}
