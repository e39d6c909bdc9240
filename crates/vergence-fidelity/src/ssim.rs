use crate::{Error, Picture, convolve::Plane};

/// Standard deviation of the Gaussian window, pixels (Wang 2004).
const SIGMA_PX: f64 = 1.5;
/// The window is 11 × 11 pixels (Wang 2004).
const RADIUS: usize = 5;
/// Keeps the luminance term finite, for a range of 1: `(K1 · 1)²` (Wang 2004).
const C1: f64 = 0.01 * 0.01;
/// Keeps the structure term finite, for a range of 1: `(K2 · 1)²` (Wang 2004).
const C2: f64 = 0.03 * 0.03;
/// Rec. 709 weights, applied to encoded values (luma, not luminance).
const LUMA: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Structural similarity of the sRGB-encoded values: the mean over red, green and blue of each channel's mean SSIM;
/// −1…1, 1 for equal pictures.
///
/// Gaussian window of σ 1.5 px cut to 11 × 11, population covariance, only windows that lie inside of the picture:
/// what scikit-image computes with `gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1,
/// channel_axis=-1`. Source: Wang, Bovik, Sheikh, Simoncelli 2004.
///
/// # Errors
/// Where the sizes differ or a side is shorter than 11 pixels.
pub fn ssim(reference: &Picture, test: &Picture) -> Result<f64, Error> {
    check(reference, test)?;
    let mean = |channel| {
        let plane = |picture: &Picture| picture.channel(channel).map(f64::from).collect();
        mean_ssim(reference, plane(reference), plane(test))
    };
    Ok((0..3).map(mean).sum::<f64>() / 3.0)
}

/// As [`ssim`], of luma only: Rec. 709 weights on the encoded values.
///
/// # Errors
/// As [`ssim`].
pub fn ssim_luma(reference: &Picture, test: &Picture) -> Result<f64, Error> {
    check(reference, test)?;
    let luma = |picture: &Picture| {
        let pixels = picture.rgb().chunks_exact(3);
        pixels.map(|p| p.iter().zip(LUMA).map(|(&v, weight)| weight * f64::from(v)).sum()).collect()
    };
    Ok(mean_ssim(reference, luma(reference), luma(test)))
}

fn check(reference: &Picture, test: &Picture) -> Result<(), Error> {
    reference.same_size(test)?;
    let (width, height) = (reference.width(), reference.height());
    let expected = 2 * RADIUS + 1;
    if width.min(height) < expected { Err(Error::TooSmall { expected, width, height }) } else { Ok(()) }
}

fn mean_ssim(size: &Picture, a: Vec<f64>, b: Vec<f64>) -> f64 {
    let (width, height) = (size.width(), size.height());
    let weights: Vec<f64> =
        (0..=2 * RADIUS).map(|i| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA_PX).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let kernel: Vec<f64> = weights.iter().map(|w| w / sum).collect();
    let mean = |values: Vec<f64>| Plane::new(width, height, values).filtered(&kernel, &kernel).values;
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect();
    let (aa, bb, ab) = (mean(product(&a, &a)), mean(product(&b, &b)), mean(product(&a, &b)));
    let (a, b) = (mean(a), mean(b));
    let mut total = 0.0;
    for y in RADIUS..height - RADIUS {
        for i in y * width + RADIUS..(y + 1) * width - RADIUS {
            let (ma, mb) = (a[i], b[i]);
            let (va, vb, cov) = (aa[i] - ma * ma, bb[i] - mb * mb, ab[i] - ma * mb);
            total += (2.0 * ma * mb + C1) * (2.0 * cov + C2)
                / ((ma * ma + mb * mb + C1) * (va.max(0.0) + vb.max(0.0) + C2));
        }
    }
    total / ((width - 2 * RADIUS) * (height - 2 * RADIUS)) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_pictures_are_one_and_small_ones_are_refused() {
        let black = Picture::from_rgb8(11, 11, &[0; 363]).unwrap();
        assert_eq!(ssim(&black, &black), Ok(1.0));
        let small = Picture::from_rgb8(10, 11, &[0; 330]).unwrap();
        let error = ssim(&small, &small).unwrap_err();
        assert_eq!(error.to_string(), "expected at least 11 x 11 pixels, found 10 x 11");
        assert!(ssim_luma(&black, &small).is_err());
    }
}
