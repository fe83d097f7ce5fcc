//! Lights that rise gradually from their edge, over an angle that does not depend on the size of the picture.

use engine::{Context, NodeError, Up};

use super::Fused;
use super::ledger::{Lights, luminance_of};
use crate::equirect::{direction, pixel_solid_angle};
use crate::light::linear::LinearPixels;
use crate::num;

impl Lights {
    /// What fusion added grows from 0 at the edge of a light to its whole at `feather_deg` within, and the light is
    /// scaled so that it gives as much as before. Angles are between centres of pixels; columns wrap.
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
        let part = |at: usize| {
            let angle = angle_to_edge(at, &lit, width, feather_deg.to_radians());
            let t = (angle.to_degrees() / feather_deg).clamp(0.0, 1.0);
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

/// The least angle from a pixel to one that is not lit, or `most` where there is none within it. In radians.
fn angle_to_edge(at: usize, lit: &[bool], width: usize, most: f64) -> f64 {
    let height = lit.len() / width;
    let toward = |x: usize, y: usize| {
        direction(Up::PlusZ, (x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64)
    };
    let (x, y) = (at % width, at / width);
    let own = toward(x, y);
    let row_angle = std::f64::consts::PI / height as f64;
    let reach = (most / row_angle).ceil() as usize;
    let (first, last) = (y.saturating_sub(reach), (y + reach).min(height - 1));
    // Columns lie closest where a row within reach is nearest to a pole.
    let (high, _) = num::sin_cos(row_angle * (first as f64 + 0.5));
    let (low, _) = num::sin_cos(row_angle * (last as f64 + 0.5));
    let column_angle = 2.0 * row_angle * height as f64 / width as f64 * high.min(low);
    let columns = ((most / column_angle).ceil() as usize).min(width / 2);
    let mut nearest = num::f64::cos(most);
    for row in first..=last {
        for step in 0..=2 * columns {
            let column = (x + width + step - columns) % width;
            if !lit[row * width + column] {
                nearest = nearest.max(own.dot(toward(column, row)));
            }
        }
    }
    num::f64::acos(nearest.clamp(-1.0, 1.0))
}
