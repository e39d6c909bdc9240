//! Labels as plain data for a renderer: one quad per glyph and one atlas of signed distances.

/// Signed distances to the outlines of the glyphs in use: one byte per texel, rows from the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Atlas {
    /// Texels per row; 0 where there is no text.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width · height` bytes. With `t` = byte / 255: the signed distance in texels is `(t − 0.5) · 2 · range_texels`,
    /// positive inside of the glyph.
    pub texels: Vec<u8>,
    /// Distance at which the bytes saturate, in texels.
    pub range_texels: f32,
}

/// A glyph of a label: a rectangle in the label's plane and in the atlas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quad {
    /// Lower left corner, metres, x to the right and y up from the label's origin.
    pub min_m: [f32; 2],
    /// Upper right corner, metres.
    pub max_m: [f32; 2],
    /// Atlas coordinates (0…1, v down) of the lower left corner.
    pub uv_min: [f32; 2],
    /// Atlas coordinates of the upper right corner; its v is smaller.
    pub uv_max: [f32; 2],
}

/// One label laid out, centred on its origin.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layout {
    /// One per visible glyph.
    pub quads: Vec<Quad>,
    /// Size of a texel of the atlas in the label's plane, metres: with it the distance in texels becomes one in metres.
    pub metres_per_texel: f32,
}

/// All texts of a scene, ready to be drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Text {
    /// Shared by all labels.
    pub atlas: Atlas,
    /// One per [`crate::Scene::labels`].
    pub layouts: Vec<Layout>,
}
