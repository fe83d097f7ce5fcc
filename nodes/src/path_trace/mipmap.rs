//! Smaller copies of a texture, for where a ray sees much of it at once.
//!
//! Copy `k + 1` has half the size of copy `k`, rounded up, and holds means of its texels. Colours are averaged as light and
//! coded again, so that all copies read alike. Copies are made when first asked for, on any thread, and are
//! the same whoever makes them.

use std::sync::OnceLock;

use crate::color::{code8, srgb_from_linear};
use crate::types::Texture;

/// The smaller copies of a texture: of its codes as colours, and as plain numbers.
#[derive(Debug, Default)]
pub struct Mipmap {
    colour: OnceLock<Vec<Texture>>,
    number: OnceLock<Vec<Texture>>,
}

impl Mipmap {
    /// The copy `level` steps smaller than `base`, which is copy 0; the smallest beyond the last. `decode` has the
    /// linear values of sRGB codes if these are colours.
    pub fn level<'a>(&'a self, base: &'a Texture, level: usize, decode: Option<&[f32; 256]>) -> &'a Texture {
        if level == 0 {
            return base;
        }
        let slot = if decode.is_some() { &self.colour } else { &self.number };
        let copies = slot.get_or_init(|| {
            let mut copies: Vec<Texture> = Vec::new();
            while let Some(next) = half(copies.last().unwrap_or(base), decode) {
                copies.push(next);
            }
            copies
        });
        copies.get(level - 1).or(copies.last()).unwrap_or(base)
    }
}

/// A texture of half the size, or none for a single texel. Where a side is odd the last texels stand alone.
fn half(texture: &Texture, decode: Option<&[f32; 256]>) -> Option<Texture> {
    let [width, height] = [texture.width, texture.height].map(|n| n as usize);
    if width <= 1 && height <= 1 {
        return None;
    }
    let value = |code: u8| decode.map_or(f32::from(code) / 255.0, |linear| linear[code as usize]);
    let coded = |v: f32| code8(if decode.is_some() { srgb_from_linear(v) } else { v });
    let (w, h) = (width.div_ceil(2), height.div_ceil(2));
    let mut rgba = Vec::with_capacity(w * h * 4);
    for y in 0..h {
        for x in 0..w {
            let columns = [2 * x, (2 * x + 1).min(width - 1)];
            let rows = [2 * y, (2 * y + 1).min(height - 1)];
            for k in 0..4 {
                let texels = rows.iter().flat_map(|y| columns.map(|x| texture.rgba[(y * width + x) * 4 + k]));
                rgba.push(match k {
                    3 => (texels.map(u32::from).sum::<u32>().div_ceil(4)) as u8,
                    _ => coded(texels.map(value).sum::<f32>() * 0.25),
                });
            }
        }
    }
    Some(Texture { width: w as u32, height: h as u32, rgba })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::color::linear_from_srgb8;

    // A chequer of black and white is half the light, which is code 188 and not 128; as numbers it is 128.
    #[test]
    fn colours_are_averaged_as_light() {
        let texel =
            |i: u32| if (i % 5 + i / 5).is_multiple_of(2) { [255, 255, 255, 255] } else { [0, 0, 0, 255] };
        let base = Texture { width: 5, height: 3, rgba: (0..15).flat_map(texel).collect() };
        let mipmap = Mipmap::default();
        let decode = linear_from_srgb8();
        let colour = mipmap.level(&base, 1, Some(&decode));
        assert_eq!((colour.width, colour.height, &colour.rgba[..4]), (3, 2, &[188, 188, 188, 255][..]));
        assert_eq!(mipmap.level(&base, 1, None).rgba[..4], [128, 128, 128, 255]);
        assert_eq!(mipmap.level(&base, 0, None), &base);
        let last = mipmap.level(&base, 9, None);
        assert_eq!((last.width, last.height), (1, 1));
    }
}
