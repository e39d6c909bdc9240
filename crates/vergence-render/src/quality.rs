use crate::Error;

const DEFAULT_ANISOTROPY: f32 = 4.0;

/// The knobs of the picture. Costs and errors are measured by `vergence trade render`.
#[derive(Clone, Debug, PartialEq)]
pub struct Quality {
    /// Samples per pixel for edges: what the device offers of 1, 2, 4, 8 (lavapipe: 1 and 4). Default 4. More:
    /// smoother edges, more memory and fill; shading stays once per pixel.
    pub msaa: u32,
    /// Texture samples along the line of sight at slanted surfaces: 1 (trilinear) … the device's maximum (16 as a rule). Default
    /// `None`: 4, or what the device has where that is less. More: sharper floors, more texture fetches.
    pub anisotropy: Option<f32>,
    /// Width and height of the picture relative to what the headset recommends, 0.1…2. Default 1. Cost grows with its
    /// square. Applied by who makes the target.
    pub render_scale: f64,
    /// Whether normal maps are used. Default on. Off: flat relief, one fetch and some arithmetic less.
    pub normal_maps: bool,
    /// Nearest distance that is drawn, metres along −z; positive. Default 0.05. Depth is reversed and has no far plane: a smaller
    /// value costs next to no precision (a step in depth is 6e-8 of the distance at any distance).
    pub near_m: f64,
    /// How far the head may move between culling and the late views, metres. Default 0.05. More: a few more parts
    /// at the borders are drawn; too little: they are missing for a frame.
    pub cull_margin_m: f64,
    /// How far it may turn, radians, 0…0.7. Default 0.1 (that is 5 rad/s over 20 ms).
    pub cull_margin_rad: f64,
    /// GPU time per pass is measured. Default on; a microsecond per pass. Not with more than one sample on a software
    /// device: Mesa 25's crashes.
    pub timestamps: bool,
}

impl Default for Quality {
    fn default() -> Self {
        Self {
            msaa: 4,
            anisotropy: None,
            render_scale: 1.0,
            normal_maps: true,
            near_m: 0.05,
            cull_margin_m: 0.05,
            cull_margin_rad: 0.1,
            timestamps: true,
        }
    }
}

impl Quality {
    /// Range of [`Quality::render_scale`].
    pub const RENDER_SCALES: std::ops::RangeInclusive<f64> = 0.1..=2.0;

    /// The anisotropy on a device with `limits`: what was asked for, which [`Quality::check`] may refuse, else the
    /// default as far as the device has it.
    pub fn anisotropy_on(&self, limits: &vergence_gpu::Limits) -> f32 {
        self.anisotropy.unwrap_or_else(|| limits.max_anisotropy.min(DEFAULT_ANISOTROPY))
    }

    /// Whether the values are in their ranges and `limits` can give them.
    ///
    /// # Errors
    /// The first that is not, with what the device can give.
    pub fn check(&self, limits: &vergence_gpu::Limits) -> Result<(), Error> {
        limits.check_msaa(self.msaa)?;
        let anisotropy = self.anisotropy_on(limits);
        if !(1.0..=limits.max_anisotropy).contains(&anisotropy) {
            let expected = format!("1 to {} on {}", limits.max_anisotropy, limits.name);
            return Err(Error::range("anisotropy", expected, anisotropy));
        }
        let scales = Self::RENDER_SCALES;
        if !scales.contains(&self.render_scale) {
            let expected = format!("{} to {}", scales.start(), scales.end());
            return Err(Error::range("render scale", expected, self.render_scale));
        }
        if !(self.near_m > 0.0 && self.near_m.is_finite()) {
            return Err(Error::range("near plane (m)", "positive", self.near_m));
        }
        if !(self.cull_margin_m >= 0.0 && self.cull_margin_m.is_finite()) {
            return Err(Error::range("culling margin (m)", "0 or more", self.cull_margin_m));
        }
        if !(0.0..=0.7).contains(&self.cull_margin_rad) {
            return Err(Error::range("culling margin (rad)", "0 to 0.7", self.cull_margin_rad));
        }
        Ok(())
    }
}
