use crate::{Error, Picture};

/// Root of the mean square difference of the sRGB-encoded values, over all pixels and channels; 0…1.
///
/// # Errors
/// Where the sizes differ.
pub fn rmse(reference: &Picture, test: &Picture) -> Result<f64, Error> {
    reference.same_size(test)?;
    let differences = reference.rgb().iter().zip(test.rgb()).map(|(a, b)| f64::from(a - b));
    Ok((differences.map(|d| d * d).sum::<f64>() / reference.rgb().len() as f64).sqrt())
}

/// Peak signal to noise ratio in decibels, `−20 log₁₀ RMSE`; infinite for equal pictures.
///
/// # Errors
/// Where the sizes differ.
pub fn psnr_db(reference: &Picture, test: &Picture) -> Result<f64, Error> {
    Ok(-20.0 * rmse(reference, test)?.log10())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_pictures_are_infinitely_good() {
        let a = Picture::from_rgb8(1, 1, &[1, 2, 3]).unwrap();
        assert_eq!((rmse(&a, &a), psnr_db(&a, &a)), (Ok(0.0), Ok(f64::INFINITY)));
        let b = Picture::from_rgb8(1, 1, &[1, 2, 33]).unwrap();
        assert!((rmse(&a, &b).unwrap() - 30.0 / 255.0 / 3f64.sqrt()).abs() < 1e-7);
        let c = Picture::from_rgb8(2, 1, &[0; 6]).unwrap();
        assert_eq!(rmse(&a, &c).unwrap_err().to_string(), "expected a picture of 1 x 1 pixels, found 2 x 1");
    }
}
