//! Decodes PNG and JPEG within limits, and stands in for pictures that are not there.

use std::fmt::Display;
use std::io::Cursor;
use std::path::Path;

use image::{ImageDecoder, ImageReader};

use crate::Error;
use crate::import::Import;
use crate::model::{Image, Scene, Shading, TextureRef};

/// Decodes `bytes` (PNG or JPEG, told by its content) to 8-bit RGBA. `place` is where `path` holds or names it.
pub(crate) fn decode(
    import: &mut Import<'_>,
    path: &Path,
    place: impl Display,
    name: &str,
    bytes: &[u8],
) -> Result<Image, Error> {
    let invalid =
        |message: String| Error::invalid(path, &place, format!("expected a PNG or JPEG image, {message}"));
    let reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|error| invalid(format!("found {error}")))?;
    if reader.format().is_none() {
        return Err(invalid("found an unknown format".into()));
    }
    let mut decoder = reader.into_decoder().map_err(|error| invalid(format!("found: {error}")))?;
    let (width, height) = decoder.dimensions();
    import.charge_pixels(path, &place, width, height)?;
    if width == 0 || height == 0 {
        return Err(invalid(format!("found {width} x {height} pixels")));
    }
    // Deflate packs at most 1032 to 1: a header that promises more than the bytes can hold is not believed.
    if u64::from(width) * u64::from(height) / 8 > 1032 * bytes.len() as u64 {
        return Err(invalid(format!("found {width} x {height} pixels in {} bytes", bytes.len())));
    }
    let mut limits = image::Limits::no_limits();
    limits.max_alloc = Some(decoder.total_bytes().saturating_mul(2).saturating_add(1 << 22));
    decoder.set_limits(limits).map_err(|error| invalid(format!("found: {error}")))?;
    let decoded =
        image::DynamicImage::from_decoder(decoder).map_err(|error| invalid(format!("found: {error}")))?;
    Ok(Image { name: name.to_owned(), width, height, rgba: decoded.into_rgba8().into_raw() })
}

/// Squares of the stand-in along each side, and pixels along the side of each.
const SQUARES: usize = 8;
const SQUARE_PX: usize = 4;

/// What is drawn instead of the picture `name`, for the reason `error`: squares that nobody takes for a surface.
pub(crate) fn stand_in(import: &mut Import<'_>, name: &str, error: &Error) -> Image {
    import.warn(format!("a picture is not there; squares of magenta and black stand for it: {error}"));
    let side = SQUARES * SQUARE_PX;
    let pixel = |at: usize| {
        let (row, column) = (at / side / SQUARE_PX, at % side / SQUARE_PX);
        if (row + column).is_multiple_of(2) { MAGENTA } else { BLACK }
    };
    let rgba = (0..side * side).flat_map(pixel).collect();
    Image { name: name.to_owned(), width: side as u32, height: side as u32, rgba }
}

const MAGENTA: [u8; 4] = [255, 0, 255, 255];
const BLACK: [u8; 4] = [0, 0, 0, 255];

/// Whether the picture is a [`stand_in`].
fn is_stand_in(image: &Image) -> bool {
    let side = (SQUARES * SQUARE_PX) as u32;
    let row = |first: [u8; 4], second: [u8; 4]| [[first; SQUARE_PX], [second; SQUARE_PX]].concat().concat();
    (image.width, image.height) == (side, side) && image.rgba.starts_with(&row(MAGENTA, BLACK))
}

/// A stand-in says that a colour is missing; as directions or roughness it would only be noise, and is left out.
pub(crate) fn keep_stand_ins_for_colours(scene: &mut Scene) {
    let Scene { materials, textures, images, .. } = scene;
    let stands_in = |texture: &TextureRef| {
        let image = textures.get(texture.texture).and_then(|texture| images.get(texture.image));
        image.is_some_and(|image| is_stand_in(image))
    };
    for material in materials {
        if let Shading::MetallicRoughness { texture, .. } = &mut material.shading {
            texture.take_if(|texture| stands_in(texture));
        }
        material.normal_texture.take_if(|texture| stands_in(texture));
        material.occlusion_texture.take_if(|texture| stands_in(texture));
    }
}
