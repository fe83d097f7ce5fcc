//! Panoramas rendered from splats: filling of holes, and encoding.

use std::f64::consts::PI;

use engine::{Context, NodeError, Notes, Up};
use glam::DVec3;
use scene::math::{color, equirect};
use scene::types::{Data, Image, Linear, Panorama, Picture, Srgb};

use super::holes;

engine::choices! {
    /// Content of pixels that show no splats.
    pub enum Holes {
        /// A smooth fill from the surroundings (push-pull over a pyramid; Gortler et al. 1996, section 3.4).
        PushPull,
        /// Black.
        Black,
    }
}

/// Maximum useful ratio of the number of columns of a panorama to the width, in pixels, of the cube-map views from
/// which it is made. More columns would not show more detail.
pub const COLUMNS_A_PIXEL: u32 = 2;

/// A panorama before its holes are filled.
pub struct Unfilled {
    /// Linear light, premultiplied, row by row.
    pub premultiplied: Vec<[f32; 4]>,
    /// Width in pixels; the height is half of it.
    pub width: usize,
    /// True if the panorama is to be display-encoded.
    pub encoded: bool,
    /// Axis of the world that points up.
    pub up: Up,
    /// Point that the panorama was rendered from, in world units.
    pub origin: DVec3,
}

/// Fills the holes of a panorama, encodes it if requested, and reports the holes in `notes`.
pub fn finish(
    found: Unfilled,
    how: Holes,
    hole_alpha: f64,
    notes: &mut Notes,
    cx: &Context,
) -> Result<Panorama, NodeError> {
    let Unfilled { premultiplied, width, encoded, up, origin } = found;
    let height = width / 2;
    let alpha: Vec<f32> = premultiplied.iter().map(|p| p[3].min(1.0)).collect();
    let hole_alpha = hole_alpha as f32;
    let open = alpha.iter().filter(|a| **a < hole_alpha).count();
    let most = alpha.iter().copied().fold(0.0, f32::max);
    if most <= 0.0 {
        notes.degraded("nothing-seen", "no splat is visible in any direction: the panorama is empty");
    } else if open == alpha.len() {
        let text = format!(
            "the largest alpha is {most:.2e}, which is below `hole_alpha` = {hole_alpha}, so all pixels count as holes"
        );
        notes.warning("little-seen", text);
    } else if open > 0 {
        let share: f64 = (0..height)
            .map(|y| {
                let row = &alpha[y * width..(y + 1) * width];
                let holes = row.iter().filter(|a| **a < hole_alpha).count() as f64;
                holes * equirect::pixel_solid_angle(width, height, y)
            })
            .sum();
        let text = if how == Holes::PushPull { "filled from its surroundings" } else { "left black" };
        let percent = 100.0 * share / (4.0 * PI);
        notes.decision(
            "holes",
            format!("{percent:.2} % of the sphere has an alpha below `hole_alpha` and was {text}"),
        );
    }
    let mut linear = match how {
        Holes::PushPull => holes::fill(&premultiplied, width, hole_alpha, cx)?,
        Holes::Black => premultiplied
            .iter()
            .map(|&[r, g, b, a]| {
                // Fades to black over the alphas of a hole, which does not amplify noise.
                let by = if a > 0.0 { (a / hole_alpha).min(1.0) / a } else { 0.0 };
                [r * by, g * by, b * by]
            })
            .collect(),
    };
    if encoded {
        let rows = cx.for_each_tile(height, |y| {
            linear[y * width..(y + 1) * width]
                .iter()
                .map(|c| c.map(color::srgb_from_linear))
                .collect::<Vec<_>>()
        })?;
        linear = rows.concat();
    }
    let samples = linear.into_flattened();
    let image: Picture = if encoded {
        Image::<Srgb>::from_samples(width, height, 3, samples).into()
    } else {
        Image::<Linear>::from_samples(width, height, 3, samples).into()
    };
    let alpha = Image::<Data>::from_samples(width, height, 1, alpha);
    Ok(Panorama { image, alpha, up, origin: Some(origin), turned_deg: 0.0 })
}

/// Converts one row of premultiplied RGBA to premultiplied linear light.
pub fn linear_row(row: &[[f32; 4]], encoded: bool) -> Vec<[f32; 4]> {
    let linear = |c: f32, alpha: f32| color::linear_from_srgb(c / alpha) * alpha;
    let pixels = row.iter().map(|&[r, g, b, a]| {
        let alpha = a.clamp(0.0, 1.0);
        match encoded {
            _ if alpha <= 0.0 => [0.0; 4],
            true => [linear(r, alpha), linear(g, alpha), linear(b, alpha), alpha],
            false => [r, g, b, alpha],
        }
    });
    pixels.collect()
}

/// Checks that the width is even, since a panorama is twice as wide as high.
pub fn check_width(width_px: u32) -> Result<(), NodeError> {
    if width_px.is_multiple_of(2) {
        return Ok(());
    }
    Err(NodeError::new(format!(
        "the width of the panorama, {width_px} px, is odd; its height must be half of its width"
    ))
    .at("width_px")
    .hint("use an even number"))
}
