//! Means over a neighbourhood of each cell of a panorama. The neighbourhoods have about the same width in degrees
//! at every latitude.

/// Number of fields that are averaged together.
pub const FIELDS: usize = 8;

/// Values of the fields in each cell of a panorama, row by row.
#[derive(Clone)]
pub struct Fields {
    pub width: usize,
    pub values: Vec<[f64; FIELDS]>,
}

impl Fields {
    /// Blurs the fields with two passes of a box filter. At the horizon, each box reaches `radius / 2` cells to
    /// both sides, so the total reach is `radius`. Rows wrap around, and their boxes are widened by 1 /
    /// cos(latitude). Columns continue across a pole on the opposite meridian.
    pub fn blurred(&self, radius: usize) -> Self {
        let half = (radius / 2).max(1);
        let once = self.along_rows(half).along_columns(half);
        once.along_rows(half).along_columns(half)
    }

    fn along_rows(&self, radius: usize) -> Self {
        let (width, height) = (self.width, self.values.len() / self.width);
        let mut out = self.clone();
        let mut sums = Vec::with_capacity(2 * width + 2);
        for (y, row) in out.values.chunks_exact_mut(width).enumerate() {
            let (sine, _) =
                scene::math::num::sin_cos(std::f64::consts::PI * (y as f64 + 0.5) / height as f64);
            let reach = ((radius as f64 / sine).round() as usize).min((width - 1) / 2);
            let source = &self.values[y * width..][..width];
            running_sums(&mut sums, (0..width + 2 * reach).map(|x| source[(x + width - reach) % width]));
            window(row.iter_mut(), &sums, reach);
        }
        out
    }

    fn along_columns(&self, radius: usize) -> Self {
        let (width, height) = (self.width, self.values.len() / self.width);
        let reach = radius.min((height - 1) / 2);
        let mut out = self.clone();
        let mut sums = Vec::with_capacity(height + 2 * reach + 1);
        for x in 0..width {
            let behind = (x + width / 2) % width;
            let at = |y: usize| {
                let (y, x) = match y.checked_sub(reach) {
                    None => (reach - 1 - y, behind),
                    Some(y) if y < height => (y, x),
                    Some(y) => (2 * height - 1 - y, behind),
                };
                self.values[y * width + x]
            };
            running_sums(&mut sums, (0..height + 2 * reach).map(at));
            window(out.values[x..].iter_mut().step_by(width), &sums, reach);
        }
        out
    }
}

fn running_sums(sums: &mut Vec<[f64; FIELDS]>, values: impl Iterator<Item = [f64; FIELDS]>) {
    sums.clear();
    let mut sum = [0.0; FIELDS];
    sums.push(sum);
    for value in values {
        sum.iter_mut().zip(value).for_each(|(s, v)| *s += v);
        sums.push(sum);
    }
}

/// Writes, for each position of a line, the mean of the `2 reach + 1` values around it. `sums` are the prefix sums
/// of the line after it was extended by `reach` on both sides.
fn window<'a>(to: impl Iterator<Item = &'a mut [f64; FIELDS]>, sums: &[[f64; FIELDS]], reach: usize) {
    let size = (2 * reach + 1) as f64;
    for ((to, low), high) in to.zip(sums).zip(&sums[2 * reach + 1..]) {
        for k in 0..FIELDS {
            to[k] = ((high[k] - low[k]) / size).max(0.0);
        }
    }
}
