//! The sRGB transfer functions of the judge: its own, so that it shares nothing with the renderer that it judges (whose is
//! `vergence_scene::linear_from_srgb`).

/// Linear light of an sRGB-encoded value, both 0…1 (IEC 61966-2-1).
pub fn linear_from_encoded(encoded: f32) -> f32 {
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// The sRGB code of linear light, both 0…1 (IEC 61966-2-1).
pub fn encoded_from_linear(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// f32 rounding through two powers, about ten units in the last place.
    const TOLERANCE: f32 = 1e-6;

    #[test]
    fn the_two_undo_each_other() {
        for code in 0..=255u8 {
            let encoded = f32::from(code) / 255.0;
            assert!((encoded_from_linear(linear_from_encoded(encoded)) - encoded).abs() < TOLERANCE);
        }
        assert_eq!(linear_from_encoded(0.0), 0.0);
        assert!((linear_from_encoded(0.5) - 0.214_041).abs() < TOLERANCE);
    }
}
