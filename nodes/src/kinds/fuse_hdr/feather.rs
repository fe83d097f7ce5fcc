//! Feathering: the light added to a region rises gradually from the edge of the region, over an angle that
//! does not depend on the size of the picture.

use std::f64::consts::PI;

use engine::{Context, NodeError};
use render::light::linear::LinearPixels;
use scene::math::equirect::pixel_solid_angle;
use scene::math::num;

use super::fused::Fused;
use super::ledger::{Lights, luminance_of};

impl Lights {
    /// Scales the light added by fusion from 0 at the edge of a light to its full value at an angle of
    /// `feather_deg` from the edge, and then scales each light so that its total stays the same. Angles are
    /// measured between centres of pixels, and columns wrap around.
    pub(super) fn feather(
        &self,
        feather_deg: f64,
        pixels: &LinearPixels,
        fused: &mut [Fused],
        cx: &Context,
    ) -> Result<(), NodeError> {
        let (width, height) = (pixels.width, pixels.height);
        let mut lit = vec![false; fused.len()];
        self.members.iter().flatten().for_each(|&at| lit[at] = true);
        let edges = Edges::new(&lit, width, feather_deg.to_radians());
        let part = |at: usize| {
            let t = (edges.angle(at).to_degrees() / feather_deg).clamp(0.0, 1.0);
            t * t * (3.0 - 2.0 * t)
        };
        let rows = cx.for_each_tile(height, |y| {
            let row = y * width..(y + 1) * width;
            row.map(|at| if lit[at] { part(at) } else { 0.0 }).collect::<Vec<_>>()
        })?;
        let parts = rows.concat();
        for members in &self.members {
            let (mut before, mut after) = (0.0, 0.0);
            for &at in members {
                let added = (fused[at].luminance - luminance_of(pixels, at))
                    * pixel_solid_angle(width, height, at / width);
                before += added;
                after += added * parts[at];
            }
            if after > 0.0 {
                for &at in members {
                    let own = luminance_of(pixels, at);
                    fused[at].luminance = own + (fused[at].luminance - own) * parts[at] * (before / after);
                }
            }
        }
        Ok(())
    }
}

/// Search for the nearest unlit pixel, that is, the nearest pixel that belongs to no light. Within a row, the
/// nearest pixel by columns is also the nearest by angle, so one lookup per row within reach is enough.
struct Edges {
    width: usize,
    /// Upper limit of the returned angles, in radians.
    most: f64,
    /// Number of columns from each pixel to the nearest unlit pixel of its row. `None` if no pixel of the row is
    /// unlit.
    columns: Vec<Option<u32>>,
    /// Sine and cosine of the polar angle of each row.
    rows: Vec<(f64, f64)>,
    /// Cosine of the angle that each number of columns spans, from 0 columns to half a turn.
    turns: Vec<f64>,
}

impl Edges {
    fn new(lit: &[bool], width: usize, most: f64) -> Self {
        let height = lit.len() / width;
        let row = |y: usize| num::sin_cos(PI * (y as f64 + 0.5) / height as f64);
        let turn = |x: usize| num::f64::cos(2.0 * PI * x as f64 / width as f64);
        Self {
            width,
            most,
            columns: lit.chunks_exact(width).flat_map(columns_to_edge).collect(),
            rows: (0..height).map(row).collect(),
            turns: (0..=width / 2).map(turn).collect(),
        }
    }

    /// Angle from a pixel to the nearest unlit pixel, at most `most`, in radians.
    fn angle(&self, at: usize) -> f64 {
        let (x, y, height) = (at % self.width, at / self.width, self.rows.len());
        let (sine, cosine) = self.rows[y];
        let reach = (self.most / PI * height as f64).ceil() as usize;
        let within = y.saturating_sub(reach)..=(y + reach).min(height - 1);
        let nearest = within.fold(num::f64::cos(self.most), |nearest, row| {
            let Some(columns) = self.columns[row * self.width + x] else { return nearest };
            let (sine_there, cosine_there) = self.rows[row];
            nearest.max(sine * sine_there * self.turns[columns as usize] + cosine * cosine_there)
        });
        num::f64::acos(nearest.clamp(-1.0, 1.0))
    }
}

/// Number of columns from each pixel of a row to the nearest unlit pixel of the row, which wraps around. `None` if
/// no pixel of the row is unlit.
fn columns_to_edge(lit: &[bool]) -> Vec<Option<u32>> {
    let width = lit.len();
    let mut nearest = vec![None; width];
    let mut pass = |column: &dyn Fn(usize) -> usize| {
        let mut since = None;
        // Twice around, so that the first columns take the last ones into account.
        for x in (0..2 * width).map(|step| column(step % width)) {
            since = if lit[x] { since.map(|since: u32| since + 1) } else { Some(0) };
            nearest[x] = since.into_iter().chain(nearest[x]).min();
        }
    };
    pass(&|x| x);
    pass(&|x| width - 1 - x);
    nearest
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::Up;

    use render::geometry::sampling::{hash, unit};
    use scene::math::equirect::direction;

    // Compares with the definition, a search over all unlit pixels: at the poles, across the seam, and with rows
    // that are lit completely. This test fails if the second `pass` is left out, or if `width / 2` is changed to
    // `width / 4`.
    #[test]
    fn the_nearest_edge_is_the_nearest_of_all_pixels() {
        let (width, height) = (48, 24);
        for (seed, share, most) in [(1, 0.9, 0.3), (2, 0.98, 1.2), (3, 0.995, 3.0)] {
            let mut lit: Vec<bool> =
                (0..width * height).map(|at| unit(hash(seed, at as u32)) < share).collect();
            lit[3 * width..5 * width].fill(true);
            let toward = |at: usize| {
                let (u, v) = ((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
                direction(Up::PlusZ, u / width as f64, v / height as f64)
            };
            let edges = Edges::new(&lit, width, most);
            for at in (0..lit.len()).filter(|&at| lit[at]) {
                let others = (0..lit.len()).filter(|&other| !lit[other]);
                let cosine = others.map(|other| toward(at).dot(toward(other))).fold(-1.0, f64::max);
                let wanted = num::f64::acos(cosine.min(1.0)).min(most);
                assert!((edges.angle(at) - wanted).abs() < 1e-7, "{at}: {} {wanted}", edges.angle(at));
            }
        }
    }
}
