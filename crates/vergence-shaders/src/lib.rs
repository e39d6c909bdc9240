#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod variant;

use std::sync::LazyLock;

pub use variant::{Coverage, Law, Variant};

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));

/// Largest number of views in one pass: the length of the array in the shaders.
pub const MAX_VIEWS: u32 = 4;
/// Largest number of lights: the length of the array in the shaders.
pub const MAX_LIGHTS: u32 = 64;
/// Threads per workgroup of [`SKIN_SKIN`].
pub const SKIN_GROUP: u32 = 64;

const VIEW_COUNT: u32 = 0xF1E5_0001;
const LIGHT_COUNT: u32 = 0xF1E5_0002;
const INFINITE_LIGHT_COUNT: u32 = 0xF1E5_0003;

static BLOB: LazyLock<Vec<u32>> = LazyLock::new(|| {
    let bytes = include_bytes!(concat!(env!("OUT_DIR"), "/shaders.spv"));
    bytes.chunks_exact(4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]])).collect()
});

/// How many lights there are of each kind; those at infinity come first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lights {
    /// Directional: from infinity.
    pub infinite: u32,
    /// Points and spots.
    pub placed: u32,
}

/// One entry point, as it was compiled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shader {
    entry: &'static str,
    start: usize,
    end: usize,
}

/// SPIR-V, ready for a pipeline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Module {
    entry: &'static str,
    words: Vec<u32>,
}

impl Shader {
    /// The SPIR-V for `views` views (1…[`MAX_VIEWS`]) and `lights` points and spots (0…[`MAX_LIGHTS`]), held at
    /// these ends; shaders without such loops ignore them.
    pub fn module(&self, views: u32, lights: u32) -> Module {
        self.lit_by(views, Lights { infinite: 0, placed: lights })
    }

    fn lit_by(&self, views: u32, lights: Lights) -> Module {
        let mut words = BLOB[self.start..self.end].to_vec();
        let all = lights.infinite.saturating_add(lights.placed).min(MAX_LIGHTS);
        set_counts(&mut words, views.clamp(1, MAX_VIEWS), lights.infinite.min(all), all);
        Module { entry: self.entry, words }
    }
}

impl Module {
    /// Name of the entry point.
    pub fn entry(&self) -> &'static str {
        self.entry
    }

    /// The module.
    pub fn words(&self) -> &[u32] {
        &self.words
    }
}

/// The vertex stage of a surface; `None` for a variant that makes no sense (see [`Variant::all_fragment`]).
pub fn surface_vertex(variant: &Variant, views: u32) -> Option<Module> {
    Some(find(SURFACE_VERTEX_VARIANTS, variant.vertex_only().key(), "vertex")?.module(views, 0))
}

/// The fragment stage of a surface; `None` for a variant that makes no sense (see [`Variant::all_fragment`]).
pub fn surface_fragment(variant: &Variant, views: u32, lights: Lights) -> Option<Module> {
    Some(find(SURFACE_FRAGMENT_VARIANTS, variant.key(), "fragment")?.lit_by(views, lights))
}

fn find(table: &[(u32, u32, u32)], key: u32, entry: &'static str) -> Option<Shader> {
    let row = table.binary_search_by_key(&key, |row| row.0).ok()?;
    let (_, start, end) = table[row];
    Some(Shader { entry, start: start as usize, end: end as usize })
}

/// Replaces the counts where they are declared as constants (`OpConstant`, opcode 43, four words).
fn set_counts(words: &mut [u32], views: u32, infinite: u32, lights: u32) {
    const HEADER_WORDS: usize = 5;
    const OP_CONSTANT_OF_ONE_WORD: u32 = 4 << 16 | 43;
    let mut at = HEADER_WORDS;
    while at < words.len() {
        if words[at] == OP_CONSTANT_OF_ONE_WORD {
            match words[at + 3] {
                VIEW_COUNT => words[at + 3] = views,
                LIGHT_COUNT => words[at + 3] = lights,
                INFINITE_LIGHT_COUNT => words[at + 3] = infinite,
                _ => {}
            }
        }
        at += (words[at] >> 16).max(1) as usize;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMAGE_SAMPLE_IMPLICIT_LOD: u32 = 87;
    const IMAGE_SAMPLE_EXPLICIT_LOD: u32 = 88;
    const KILL: u32 = 252;

    fn count(words: &[u32], opcode: u32) -> usize {
        let (mut at, mut found) = (5, 0);
        while at < words.len() {
            found += usize::from(words[at] & 0xFFFF == opcode);
            at += (words[at] >> 16) as usize;
        }
        found
    }

    /// A surface fetches exactly the textures it has, and only a mask discards.
    #[test]
    fn a_variant_holds_what_it_needs_and_nothing_else() {
        for variant in Variant::all_fragment() {
            let fragment = surface_fragment(&variant, 2, Lights { infinite: 1, placed: 2 }).unwrap();
            let (fetch, other) = if variant.bounded_footprint {
                (IMAGE_SAMPLE_EXPLICIT_LOD, IMAGE_SAMPLE_IMPLICIT_LOD)
            } else {
                (IMAGE_SAMPLE_IMPLICIT_LOD, IMAGE_SAMPLE_EXPLICIT_LOD)
            };
            assert_eq!(count(fragment.words(), fetch), variant.textures(), "{variant:?}");
            assert_eq!(count(fragment.words(), other), 0, "{variant:?}");
            assert_eq!(count(fragment.words(), KILL) > 0, variant.coverage == Coverage::Mask, "{variant:?}");
            assert!(surface_vertex(&variant, 2).is_some(), "{variant:?}");
        }
    }

    #[test]
    fn counts_are_written_once_and_nowhere_else() {
        let plain = Variant::all_fragment().into_iter().find(|v| v.law == Law::MetallicRoughness).unwrap();
        let a = surface_fragment(&plain, 2, Lights { infinite: 1, placed: 2 }).unwrap();
        let b = surface_fragment(&plain, 4, Lights { infinite: 3, placed: 4 }).unwrap();
        let differing = a.words().iter().zip(b.words()).filter(|(a, b)| a != b).count();
        assert_eq!(differing, 3);
        assert!(!b.words().contains(&VIEW_COUNT) && !b.words().contains(&LIGHT_COUNT));
    }

    #[test]
    fn nonsense_is_refused() {
        let plain = Variant::all_fragment()[0];
        assert!(surface_fragment(&Variant { normal_texture: true, ..plain }, 2, Lights::default()).is_none());
    }
}
