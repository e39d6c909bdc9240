//! Labels as plain data for a renderer: one quad per glyph and one atlas of signed distances.
//!
//! The font is part of the library (a subset of DejaVu Sans: Latin, Greek, arrows, common symbols). Distances are
//! computed from the outlines, when a scene is loaded, for the glyphs that it uses. There is no shaping: one
//! character is one glyph, left to right, with kerning.

use std::collections::BTreeMap;

use nalgebra::Vector2;
use ttf_parser::{Face, GlyphId, OutlineBuilder};

use crate::model::Label;

const FONT: &[u8] = include_bytes!("../assets/DejaVuSans-subset.ttf");

/// Height of a capital letter in the atlas, texels: at 40, corners stay sharp until a letter fills 100 pixels.
const CAP_TEXELS: f32 = 40.0;
/// Distance at which bytes saturate, texels; also the margin around glyphs, so that three mip levels do not bleed.
const RANGE_TEXELS: f32 = 5.0;
/// Largest width of the atlas, texels.
const ATLAS_WIDTH: u32 = 1024;
/// Line segments that stand for one curve of an outline: off by less than 1/100 texel.
const SEGMENTS_PER_CURVE: u32 = 8;

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

impl Text {
    /// Lays out `labels` and computes the distances of their glyphs. About 1 ms per distinct glyph.
    pub fn new(labels: &[Label]) -> Self {
        let font = Font::new();
        let mut glyphs = BTreeMap::new();
        for id in labels.iter().flat_map(|label| label.text.chars()).filter_map(|c| font.glyph(c)) {
            glyphs.entry(id).or_insert_with(|| font.distances(id));
        }
        let (atlas, places) = pack(&glyphs);
        let layouts = labels.iter().map(|label| font.lay_out(label, &glyphs, &places, &atlas)).collect();
        Self { atlas, layouts }
    }

    /// The characters of `labels` that the font does not have; each is drawn as a box.
    pub fn missing(labels: &[Label]) -> Vec<char> {
        let font = Font::new();
        let mut missing: Vec<char> = labels
            .iter()
            .flat_map(|label| label.text.chars())
            .filter(|&c| !c.is_control() && font.face.glyph_index(c).is_none())
            .collect();
        missing.sort_unstable();
        missing.dedup();
        missing
    }
}

struct Font {
    face: Face<'static>,
    /// Texels per font unit.
    scale: f32,
}

/// The distances of one glyph.
struct Glyph {
    /// Texels, margin included; 0 × 0 where nothing is visible.
    width: u32,
    height: u32,
    /// Of the lower left corner from the glyph's origin, texels.
    corner: Vector2<f32>,
    texels: Vec<u8>,
}

impl Font {
    fn new() -> Self {
        let face = Face::parse(FONT, 0).expect("the font is part of the library");
        let scale = CAP_TEXELS / f32::from(face.capital_height().unwrap_or(1493).max(1));
        Self { face, scale }
    }

    /// `None` for characters that take no place.
    fn glyph(&self, c: char) -> Option<GlyphId> {
        (!c.is_control()).then(|| {
            self.face.glyph_index(c).or_else(|| self.face.glyph_index('\u{FFFD}')).unwrap_or(GlyphId(0))
        })
    }

    fn advance_texels(&self, id: GlyphId) -> f32 {
        f32::from(self.face.glyph_hor_advance(id).unwrap_or(0)) * self.scale
    }

    fn kerning_texels(&self, left: GlyphId, right: GlyphId) -> f32 {
        let tables = self.face.tables().kern.map(|kern| kern.subtables);
        tables
            .into_iter()
            .flatten()
            .filter(|table| table.horizontal && !table.variable)
            .find_map(|table| table.glyphs_kerning(left, right))
            .map_or(0.0, |kerning| f32::from(kerning) * self.scale)
    }

    fn line_texels(&self) -> f32 {
        f32::from(self.face.ascender() - self.face.descender() + self.face.line_gap()) * self.scale
    }

    fn distances(&self, id: GlyphId) -> Glyph {
        let mut outline = Outline { scale: self.scale, ..Outline::default() };
        let Some(bounds) = self.face.outline_glyph(id, &mut outline) else {
            return Glyph { width: 0, height: 0, corner: Vector2::zeros(), texels: Vec::new() };
        };
        let low = |v: i16| (f32::from(v) * self.scale - RANGE_TEXELS).floor();
        let high = |v: i16| (f32::from(v) * self.scale + RANGE_TEXELS).ceil();
        let corner = Vector2::new(low(bounds.x_min), low(bounds.y_min));
        let (width, height) =
            ((high(bounds.x_max) - corner.x) as u32, (high(bounds.y_max) - corner.y) as u32);
        let mut texels = Vec::with_capacity((width * height) as usize);
        for row in (0..height).rev() {
            for column in 0..width {
                let point = corner + Vector2::new(column as f32 + 0.5, row as f32 + 0.5);
                let t = 0.5 + outline.signed_distance(&point) / (2.0 * RANGE_TEXELS);
                texels.push((t.clamp(0.0, 1.0) * 255.0).round() as u8);
            }
        }
        Glyph { width, height, corner, texels }
    }

    fn lay_out(
        &self,
        label: &Label,
        glyphs: &BTreeMap<GlyphId, Glyph>,
        places: &BTreeMap<GlyphId, Vector2<u32>>,
        atlas: &Atlas,
    ) -> Layout {
        let metres_per_texel = label.cap_height_m / CAP_TEXELS;
        let lines: Vec<&str> = label.text.lines().collect();
        // The block reaches from the top of the first line's capitals to the last line's baseline.
        let block = CAP_TEXELS + self.line_texels() * lines.len().saturating_sub(1) as f32;
        let mut quads = Vec::new();
        for (index, line) in lines.iter().enumerate() {
            let mut pen = Vector2::new(0.0, 0.5 * block - CAP_TEXELS - self.line_texels() * index as f32);
            let start = quads.len();
            let mut left: Option<GlyphId> = None;
            for id in line.chars().filter_map(|c| self.glyph(c)) {
                pen.x += left.map_or(0.0, |left| self.kerning_texels(left, id));
                left = Some(id);
                if let (Some(glyph), Some(place)) = (glyphs.get(&id), places.get(&id)) {
                    let size = Vector2::new(glyph.width, glyph.height).map(|v| v as f32);
                    let (min, uv) = (pen + glyph.corner, place.map(|v| v as f32));
                    let to_uv = |x: f32, y: f32| [x / atlas.width as f32, y / atlas.height as f32];
                    quads.push(Quad {
                        min_m: (min * metres_per_texel).into(),
                        max_m: ((min + size) * metres_per_texel).into(),
                        uv_min: to_uv(uv.x, uv.y + size.y),
                        uv_max: to_uv(uv.x + size.x, uv.y),
                    });
                }
                pen.x += self.advance_texels(id);
            }
            let half_width = 0.5 * pen.x * metres_per_texel;
            for quad in &mut quads[start..] {
                quad.min_m[0] -= half_width;
                quad.max_m[0] -= half_width;
            }
        }
        Layout { quads, metres_per_texel }
    }
}

/// Puts glyphs on shelves, highest first; gives the atlas and each visible glyph's upper left corner.
fn pack(glyphs: &BTreeMap<GlyphId, Glyph>) -> (Atlas, BTreeMap<GlyphId, Vector2<u32>>) {
    let mut order: Vec<(&GlyphId, &Glyph)> = glyphs.iter().filter(|(_, glyph)| glyph.width > 0).collect();
    order.sort_by_key(|(id, glyph)| (std::cmp::Reverse(glyph.height), **id));
    let area: u32 = order.iter().map(|(_, glyph)| glyph.width * glyph.height).sum();
    let widest = order.iter().map(|(_, glyph)| glyph.width).max().unwrap_or(0);
    let width = (area as f32).sqrt().ceil() as u32;
    let width = width.next_multiple_of(4).min(ATLAS_WIDTH).max(widest);
    let mut places = BTreeMap::new();
    let (mut corner, mut shelf_height) = (Vector2::new(0u32, 0u32), 0);
    for (id, glyph) in &order {
        if corner.x + glyph.width > width {
            corner = Vector2::new(0, corner.y + shelf_height);
            shelf_height = 0;
        }
        places.insert(**id, corner);
        corner.x += glyph.width;
        shelf_height = shelf_height.max(glyph.height);
    }
    let height = corner.y + shelf_height;
    let mut texels = vec![0; (width * height) as usize];
    for (id, glyph) in order {
        let place = places[id];
        for (row, line) in glyph.texels.chunks_exact(glyph.width as usize).enumerate() {
            let start = ((place.y + row as u32) * width + place.x) as usize;
            texels[start..start + line.len()].copy_from_slice(line);
        }
    }
    (Atlas { width, height, texels, range_texels: RANGE_TEXELS }, places)
}

/// A glyph's outline as line segments, in texels.
#[derive(Default)]
struct Outline {
    scale: f32,
    start: Vector2<f32>,
    pen: Vector2<f32>,
    segments: Vec<[Vector2<f32>; 2]>,
}

impl Outline {
    fn to(&mut self, point: Vector2<f32>) {
        if point != self.pen {
            self.segments.push([self.pen, point]);
        }
        self.pen = point;
    }

    /// Distance to the outline, positive inside (non-zero winding).
    fn signed_distance(&self, point: &Vector2<f32>) -> f32 {
        let mut nearest = f32::INFINITY;
        let mut winding = 0;
        for [a, b] in &self.segments {
            let (along, offset) = (b - a, point - a);
            let t = (offset.dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
            nearest = nearest.min((offset - along * t).norm_squared());
            let side = along.perp(&offset);
            if a.y <= point.y && b.y > point.y && side > 0.0 {
                winding += 1;
            } else if a.y > point.y && b.y <= point.y && side < 0.0 {
                winding -= 1;
            }
        }
        if winding == 0 { -nearest.sqrt() } else { nearest.sqrt() }
    }
}

impl OutlineBuilder for Outline {
    fn move_to(&mut self, x: f32, y: f32) {
        self.start = Vector2::new(x, y) * self.scale;
        self.pen = self.start;
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.to(Vector2::new(x, y) * self.scale);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let (from, via, end) = (self.pen, Vector2::new(x1, y1) * self.scale, Vector2::new(x, y) * self.scale);
        for step in 1..=SEGMENTS_PER_CURVE {
            let t = step as f32 / SEGMENTS_PER_CURVE as f32;
            self.to(from * ((1.0 - t) * (1.0 - t)) + via * (2.0 * t * (1.0 - t)) + end * (t * t));
        }
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let (from, end) = (self.pen, Vector2::new(x, y) * self.scale);
        let (first, second) = (Vector2::new(x1, y1) * self.scale, Vector2::new(x2, y2) * self.scale);
        for step in 1..=SEGMENTS_PER_CURVE {
            let t = step as f32 / SEGMENTS_PER_CURVE as f32;
            let s = 1.0 - t;
            self.to(from * (s * s * s)
                + first * (3.0 * s * s * t)
                + second * (3.0 * s * t * t)
                + end * (t * t * t));
        }
    }

    fn close(&mut self) {
        self.to(self.start);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(text: &str) -> Label {
        Label { text: text.into(), cap_height_m: 0.04, color: [1.0; 4], billboard: false }
    }

    /// The signed distance, in metres, at a point of the label's plane; far outside where there is no quad.
    fn distance_m(text: &Text, x: f32, y: f32) -> f32 {
        let layout = &text.layouts[0];
        let inside = |q: &&Quad| x >= q.min_m[0] && x < q.max_m[0] && y >= q.min_m[1] && y < q.max_m[1];
        let value = |quad: &Quad| {
            let u = (x - quad.min_m[0]) / (quad.max_m[0] - quad.min_m[0]);
            let v = (y - quad.min_m[1]) / (quad.max_m[1] - quad.min_m[1]);
            let column = (quad.uv_min[0] + u * (quad.uv_max[0] - quad.uv_min[0])) * text.atlas.width as f32;
            let row = (quad.uv_min[1] + v * (quad.uv_max[1] - quad.uv_min[1])) * text.atlas.height as f32;
            let row = row.min(text.atlas.height as f32 - 1.0);
            let texel = text.atlas.texels[row as usize * text.atlas.width as usize + column as usize];
            (f32::from(texel) / 255.0 - 0.5) * 2.0 * text.atlas.range_texels * layout.metres_per_texel
        };
        layout.quads.iter().filter(inside).map(value).fold(f32::NEG_INFINITY, f32::max)
    }

    /// A capital I is a bar as high as a capital letter, in the middle.
    #[test]
    fn a_capital_letter_has_the_height_that_was_asked_for_and_is_centred() {
        let text = Text::new(&[label("I")]);
        let tolerance = text.layouts[0].metres_per_texel;
        let inside: Vec<f32> =
            (-300..300).map(|i| i as f32 * 1e-4).filter(|&y| distance_m(&text, 0.0, y) > 0.0).collect();
        let (bottom, top) = (inside[0], inside[inside.len() - 1]);
        assert!((top - 0.02).abs() < tolerance && (bottom + 0.02).abs() < tolerance, "{bottom} to {top}");
        let inside: Vec<f32> =
            (-300..300).map(|i| i as f32 * 1e-4).filter(|&x| distance_m(&text, x, 0.0) > 0.0).collect();
        let (left, right) = (inside[0], inside[inside.len() - 1]);
        assert!((left + right).abs() < 2.0 * tolerance && right - left < 0.01, "{left} to {right}");
    }

    #[test]
    fn an_o_has_a_hole_and_lines_stand_below_each_other() {
        assert!(distance_m(&Text::new(&[label("O")]), 0.0, 0.0) < 0.0);
        let text = Text::new(&[label("II\nI")]);
        let quads = &text.layouts[0].quads;
        assert_eq!(quads.len(), 3);
        assert!(quads[2].max_m[1] < quads[0].max_m[1] - 0.04);
        // Two lines: as much above the middle as below it.
        let margin = RANGE_TEXELS * text.layouts[0].metres_per_texel;
        let (top, bottom) = (quads[0].max_m[1] - margin, quads[2].min_m[1] + margin);
        let tolerance = 2.0 * text.layouts[0].metres_per_texel;
        assert!((top + bottom).abs() < tolerance, "{top} {bottom}");
        let (left, right) = (quads[0].min_m[0], quads[1].max_m[0]);
        assert!((left + right).abs() < tolerance, "the first line is centred: {left} {right}");
    }

    #[test]
    fn what_the_font_lacks_is_a_box_and_said_once() {
        let labels = [label("a\u{4E00}b\u{4E00}\n\u{1F600}")];
        assert_eq!(Text::missing(&labels), ['\u{4E00}', '\u{1F600}']);
        assert_eq!(Text::new(&labels).layouts[0].quads.len(), 5);
        assert_eq!(Text::missing(&[label("ÄÖÜß αβγ → ± µm 90°")]), []);
    }

    #[test]
    fn no_text_is_no_atlas() {
        for labels in [&[][..], &[label(" \n ")]] {
            let text = Text::new(labels);
            assert_eq!((text.atlas.width, text.atlas.height, text.atlas.texels.len()), (0, 0, 0));
            assert_eq!(text.layouts.len(), labels.len());
        }
    }
}
