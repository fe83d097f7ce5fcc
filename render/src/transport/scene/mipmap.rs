//! Mipmaps: smaller copies of a texture for footprints that cover many texels.
//!
//! Level `k + 1` has half the size of level `k`, rounded up, and contains means of its texels. Colours are
//! averaged in linear light and encoded again. Colours of cut-out or blended textures are weighted by alpha,
//! since transparent texels have arbitrary colours. Levels are built on first use, on any thread, with the
//! same result.

use std::sync::OnceLock;

use scene::math::color::{code8, srgb_from_linear};
use scene::types::Texture;

/// Kind of average over the texels of a texture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Texels {
    /// Mean of numbers that are not colours.
    Numbers,
    /// Mean of sRGB-encoded colours.
    Colours,
    /// Mean of sRGB-encoded colours weighted by alpha.
    CoveredColours,
    /// Maximum of colours instead of the mean.
    Peaks,
}

/// Levels of a texture for each kind of average.
#[derive(Debug, Default)]
pub struct Mipmap([OnceLock<Vec<Texture>>; 4]);

impl Mipmap {
    /// Level `level` of a texture, or its last level if there are fewer. `base` is level 0. `decode` contains the
    /// linear values of the sRGB codes.
    pub fn level<'a>(
        &'a self,
        base: &'a Texture,
        level: usize,
        (texels, decode): (Texels, &[f32; 256]),
    ) -> &'a Texture {
        if level == 0 {
            return base;
        }
        let copies = self.0[texels as usize].get_or_init(|| {
            let mut copies: Vec<Texture> = Vec::new();
            while let Some(next) = half(copies.last().unwrap_or(base), texels, decode) {
                copies.push(next);
            }
            copies
        });
        copies.get(level - 1).or(copies.last()).unwrap_or(base)
    }
}

/// Texture of half the size, rounded up. If a dimension is odd, the last row or column is averaged with itself.
/// `None` if the texture has a single texel.
fn half(texture: &Texture, texels: Texels, decode: &[f32; 256]) -> Option<Texture> {
    let [width, height] = [texture.width, texture.height].map(|n| n as usize);
    if width <= 1 && height <= 1 {
        return None;
    }
    let number = texels == Texels::Numbers;
    let value = |code: u8| if number { f32::from(code) / 255.0 } else { decode[code as usize] };
    let coded = |v: f32| code8(if number { v } else { srgb_from_linear(v) });
    let (w, h) = (width.div_ceil(2), height.div_ceil(2));
    let mut rgba = Vec::with_capacity(w * h * 4);
    for y in 0..h {
        for x in 0..w {
            let columns = [2 * x, (2 * x + 1).min(width - 1)];
            let rows = [2 * y, (2 * y + 1).min(height - 1)];
            let four = [0, 1, 2, 3].map(|i| (rows[i / 2] * width + columns[i % 2]) * 4);
            let alpha = four.map(|at| texture.rgba[at + 3]);
            let cover = alpha.iter().map(|&a| f32::from(a)).sum::<f32>();
            for k in 0..3 {
                let each = four.iter().zip(alpha).map(|(at, alpha)| (value(texture.rgba[at + k]), alpha));
                rgba.push(coded(match texels {
                    // Where alpha is 0 the plain mean is used.
                    Texels::CoveredColours if cover > 0.0 => {
                        each.map(|(v, alpha)| v * f32::from(alpha)).sum::<f32>() / cover
                    }
                    Texels::Peaks => each.map(|(v, _)| v).fold(0.0, f32::max),
                    _ => each.map(|(v, _)| v).sum::<f32>() * 0.25,
                }));
            }
            rgba.push(alpha.map(u32::from).iter().sum::<u32>().div_ceil(4) as u8);
        }
    }
    Some(Texture { width: w as u32, height: h as u32, rgba })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::math::color::linear_from_srgb8;

    // A checkerboard of black and white has half the light, which is code 188 and not 128; as numbers it is 128.
    #[test]
    fn colours_are_averaged_as_light() {
        let texel =
            |i: u32| if (i % 5 + i / 5).is_multiple_of(2) { [255, 255, 255, 255] } else { [0, 0, 0, 255] };
        let base = Texture { width: 5, height: 3, rgba: (0..15).flat_map(texel).collect() };
        let mipmap = Mipmap::default();
        let decode = linear_from_srgb8();
        let colour = mipmap.level(&base, 1, (Texels::Colours, &decode));
        assert_eq!((colour.width, colour.height, &colour.rgba[..4]), (3, 2, &[188, 188, 188, 255][..]));
        let numbers = (Texels::Numbers, &decode);
        assert_eq!(mipmap.level(&base, 1, numbers).rgba[..4], [128, 128, 128, 255]);
        assert_eq!(mipmap.level(&base, 0, numbers), &base);
        let last = mipmap.level(&base, 9, numbers);
        assert_eq!((last.width, last.height), (1, 1));
    }

    // Stripes of green next to transparent texels that are white: the mean is green, with half the coverage. This
    // test fails if `cover > 0.0` is replaced with `false` (the colour becomes 225, 240, 221).
    #[test]
    fn what_is_not_there_has_no_colour() {
        let texel = |i: u32| if i.is_multiple_of(2) { [60, 160, 40, 255] } else { [255, 255, 255, 0] };
        let base = Texture { width: 8, height: 8, rgba: (0..64).flat_map(texel).collect() };
        let (mipmap, decode) = (Mipmap::default(), linear_from_srgb8());
        for level in 1..=3 {
            let copy = mipmap.level(&base, level, (Texels::CoveredColours, &decode));
            assert!(copy.rgba.chunks(4).all(|texel| texel == [60, 160, 40, 128]), "{:?}", copy.rgba);
        }
        let nothing = Texture { width: 2, height: 1, rgba: vec![9, 9, 9, 0, 9, 9, 9, 0] };
        let copy = Mipmap::default();
        assert_eq!(copy.level(&nothing, 1, (Texels::CoveredColours, &decode)).rgba, [9, 9, 9, 0]);
    }
}
