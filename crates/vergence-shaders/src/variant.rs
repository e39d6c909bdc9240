// Shared with the build script, which includes this file: no inner attributes, no imports.

/// The law of reflection of a surface variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Law {
    /// No light.
    Unlit,
    /// GGX and Lambert.
    MetallicRoughness,
    /// Half-vector lobe and Lambert.
    BlinnPhong,
}

/// What a surface variant does with alpha.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Coverage {
    /// Writes 1.
    Opaque,
    /// Writes 1 or discards.
    Mask,
    /// Writes it.
    Blend,
}

/// One way to draw a surface: which lines of `surface.wgsl` exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Variant {
    /// The law of reflection.
    pub law: Law,
    /// What alpha does.
    pub coverage: Coverage,
    /// Samples a base colour texture.
    pub base_color_texture: bool,
    /// Samples a metallic-roughness texture ([`Law::MetallicRoughness`] only).
    pub metallic_roughness_texture: bool,
    /// Samples a normal map (lit only).
    pub normal_texture: bool,
    /// Samples an occlusion texture (lit only).
    pub occlusion_texture: bool,
    /// Samples an emissive texture (lit only).
    pub emissive_texture: bool,
    /// Multiplies vertex colours.
    pub vertex_colors: bool,
    /// Textures use different coordinates: an affine function of two sets for each, instead of one set for all.
    pub many_uvs: bool,
    /// Reads what is the same for a whole draw in the vertex stage and hands it on (lit only; for passes of one view):
    /// for software devices, which read uniform values lane by lane. Elsewhere it is more to hand on, for nothing.
    pub handed_on: bool,
    /// Bounds how far texture coordinates go from pixel to pixel: for software devices with anisotropic filtering, whose
    /// work grows with that.
    pub bounded_footprint: bool,
}

impl Variant {
    /// Whether texture coordinates are needed at all.
    pub fn uses_uv(&self) -> bool {
        self.textures() > 0
    }

    /// Number of textures.
    pub fn textures(&self) -> usize {
        [
            self.base_color_texture,
            self.metallic_roughness_texture,
            self.normal_texture,
            self.occlusion_texture,
            self.emissive_texture,
        ]
        .into_iter()
        .filter(|&used| used)
        .count()
    }

    /// Whether light matters.
    pub fn lit(&self) -> bool {
        self.law != Law::Unlit
    }

    pub(crate) fn key(&self) -> u32 {
        let bits = [
            self.base_color_texture,
            self.metallic_roughness_texture,
            self.normal_texture,
            self.occlusion_texture,
            self.emissive_texture,
            self.vertex_colors,
            self.many_uvs,
            self.handed_on,
            self.bounded_footprint,
        ];
        let flags = bits.iter().enumerate().fold(0, |key, (bit, &set)| key | (u32::from(set) << bit));
        flags | (self.law as u32) << 9 | (self.coverage as u32) << 11
    }

    /// The variant without what only the fragment stage does.
    #[allow(dead_code)]
    pub(crate) fn vertex_only(&self) -> Self {
        Self {
            law: if self.lit() { Law::MetallicRoughness } else { Law::Unlit },
            coverage: Coverage::Opaque,
            base_color_texture: self.uses_uv(),
            metallic_roughness_texture: false,
            occlusion_texture: false,
            emissive_texture: false,
            bounded_footprint: false,
            ..*self
        }
    }

    #[allow(dead_code)]
    fn flags(&self) -> Vec<&'static str> {
        let mut flags = Vec::new();
        let mut add = |set: bool, flag: &'static str| {
            if set {
                flags.push(flag);
            }
        };
        add(!self.lit(), "UNLIT");
        add(self.lit(), "LIT");
        add(self.law == Law::MetallicRoughness, "METALLIC_ROUGHNESS");
        add(self.law == Law::BlinnPhong, "BLINN_PHONG");
        add(self.coverage == Coverage::Mask, "MASK");
        add(self.coverage == Coverage::Blend, "BLEND");
        add(self.coverage != Coverage::Blend, "SOLID");
        add(self.base_color_texture, "BASE_COLOR_TEXTURE");
        add(self.metallic_roughness_texture, "METALLIC_ROUGHNESS_TEXTURE");
        add(self.normal_texture, "NORMAL_TEXTURE");
        add(self.lit() && !self.normal_texture, "SMOOTH");
        add(self.occlusion_texture, "OCCLUSION_TEXTURE");
        add(self.emissive_texture, "EMISSIVE_TEXTURE");
        add(self.lit() && !self.emissive_texture, "EMISSIVE_FACTOR");
        add(self.vertex_colors, "VERTEX_COLORS");
        add(self.uses_uv(), "UV");
        add(self.uses_uv() && !self.many_uvs, "ONE_UV");
        add(self.many_uvs, "MANY_UVS");
        add(self.handed_on, "HANDED_ON");
        add(!self.handed_on, "LOOKED_UP");
        add(self.bounded_footprint, "BOUNDED_FOOTPRINT");
        add(!self.bounded_footprint, "ANY_FOOTPRINT");
        flags
    }

    /// Every variant that makes sense.
    pub fn all_fragment() -> Vec<Self> {
        let mut all = Vec::new();
        for law in [Law::Unlit, Law::MetallicRoughness, Law::BlinnPhong] {
            for coverage in [Coverage::Opaque, Coverage::Mask, Coverage::Blend] {
                for bits in 0..512u32 {
                    let bit = |index: u32| bits >> index & 1 == 1;
                    let variant = Self {
                        law,
                        coverage,
                        base_color_texture: bit(0),
                        metallic_roughness_texture: bit(1),
                        normal_texture: bit(2),
                        occlusion_texture: bit(3),
                        emissive_texture: bit(4),
                        vertex_colors: bit(5),
                        many_uvs: bit(6),
                        handed_on: bit(7),
                        bounded_footprint: bit(8),
                    };
                    if variant.makes_sense() {
                        all.push(variant);
                    }
                }
            }
        }
        all
    }

    /// Every vertex stage that one of [`Variant::all_fragment`] needs.
    #[allow(dead_code)]
    fn all_vertex() -> Vec<Self> {
        let mut all: Vec<Self> = Self::all_fragment().iter().map(Self::vertex_only).collect();
        all.sort_unstable_by_key(Self::key);
        all.dedup();
        all
    }

    fn makes_sense(&self) -> bool {
        let only_lit =
            self.normal_texture || self.occlusion_texture || self.emissive_texture || self.handed_on;
        (self.lit() || !only_lit)
            && (self.law == Law::MetallicRoughness || !self.metallic_roughness_texture)
            && (!self.many_uvs || self.textures() > 1)
            && (!self.bounded_footprint || (self.uses_uv() && self.handed_on == self.lit()))
    }
}
