//! Picture on which lines and numbers are drawn.

use scene::io::png::{Raster, write};

use crate::splat::Rendered;

/// Number of columns and rows of a glyph.
const GLYPH: [usize; 2] = [3, 5];

/// Bitmap of a character, as rows of three bits.
fn glyph(c: char) -> [u8; 5] {
    match c {
        '0' => [7, 5, 5, 5, 7],
        '1' => [2, 6, 2, 2, 7],
        '2' => [7, 1, 7, 4, 7],
        '3' => [7, 1, 3, 1, 7],
        '4' => [5, 5, 7, 1, 1],
        '5' => [7, 4, 7, 1, 7],
        '6' => [7, 4, 7, 5, 7],
        '7' => [7, 1, 2, 2, 2],
        '8' => [7, 5, 7, 5, 7],
        '9' => [7, 5, 7, 1, 7],
        '-' => [0, 0, 7, 0, 0],
        '.' => [0, 0, 0, 0, 2],
        'm' => [0, 5, 7, 7, 5],
        'u' => [0, 5, 5, 5, 7],
        'x' => [0, 5, 2, 5, 0],
        'y' => [5, 5, 7, 1, 7],
        'z' => [7, 1, 2, 4, 7],
        _ => [0; 5],
    }
}

/// Picture of display colours.
#[derive(Debug, Clone)]
pub struct Canvas {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// RGB from 0 to 1, row by row.
    pub rgb: Vec<[f32; 3]>,
}

impl Canvas {
    /// Creates a picture of one colour.
    pub fn new(width: usize, height: usize, rgb: [f32; 3]) -> Self {
        Self { width, height, rgb: vec![rgb; width * height] }
    }

    /// Creates a picture of a rendered view over a dark grey background.
    pub fn of(seen: &Rendered, width: usize, height: usize) -> Self {
        let over =
            |p: &[f32]| [0, 1, 2].map(|k| (p[k] + 0.12 * (1.0 - p[3].clamp(0.0, 1.0))).clamp(0.0, 1.0));
        Self { width, height, rgb: seen.rgba.chunks_exact(4).map(over).collect() }
    }

    /// Mixes a colour into a pixel with the weight `share`. Positions outside the picture are ignored.
    pub fn mix(&mut self, x: i64, y: i64, colour: [f32; 3], share: f32) {
        if x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height {
            let pixel = &mut self.rgb[y as usize * self.width + x as usize];
            *pixel = [0, 1, 2].map(|k| pixel[k] * (1.0 - share) + colour[k] * share);
        }
    }

    /// Draws a straight line, whose colour has the weight `share`.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], colour: [f32; 3], share: f32) {
        let steps = (to[0] - from[0]).abs().max((to[1] - from[1]).abs()).ceil().clamp(1.0, 20_000.0);
        for i in 0..=steps as usize {
            let t = i as f64 / steps;
            let at = [0, 1].map(|k| (from[k] + (to[k] - from[k]) * t).floor() as i64);
            self.mix(at[0], at[1], colour, share);
        }
    }

    /// Draws a number or a unit on a dark background. The upper left corner is at `[x, y]`, and each dot has
    /// `scale` pixels per side.
    pub fn text(&mut self, [x, y]: [i64; 2], text: &str, scale: i64, colour: [f32; 3]) {
        let wide = (GLYPH[0] as i64 + 1) * scale;
        for v in -scale..(GLYPH[1] as i64 + 1) * scale {
            for u in -scale..wide * text.chars().count() as i64 {
                self.mix(x + u, y + v, [0.0; 3], 0.6);
            }
        }
        for (n, c) in text.chars().enumerate() {
            for (row, bits) in glyph(c).into_iter().enumerate() {
                for column in 0..GLYPH[0] {
                    if bits >> (GLYPH[0] - 1 - column) & 1 == 1 {
                        for dot in 0..scale * scale {
                            let at = [
                                n as i64 * wide + column as i64 * scale + dot % scale,
                                row as i64 * scale + dot / scale,
                            ];
                            self.mix(x + at[0], y + at[1], colour, 1.0);
                        }
                    }
                }
            }
        }
    }

    /// Copies another picture into this one, with its upper left corner at `[left, top]`.
    pub fn put(&mut self, other: &Self, [left, top]: [usize; 2]) {
        for y in 0..other.height.min(self.height.saturating_sub(top)) {
            for x in 0..other.width.min(self.width.saturating_sub(left)) {
                self.rgb[(top + y) * self.width + left + x] = other.rgb[y * other.width + x];
            }
        }
    }

    /// Encodes the picture as PNG.
    pub fn png(&self) -> Result<Vec<u8>, scene::error::Error> {
        let code = |v: f32| u16::from(scene::math::color::code8(v));
        let codes = self.rgb.iter().flatten().map(|&v| code(v)).collect();
        let raster = Raster {
            width: self.width,
            height: self.height,
            channels: 3,
            largest: 255,
            codes,
            ignored: Vec::new(),
            colour: None,
        };
        write(&raster, true, &[])
    }
}
