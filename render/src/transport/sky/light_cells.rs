//! One tier of the sky, divided into cells for sampling.

use std::ops::Range;

use fearless_simd::prelude::*;
use glam::Vec3;
use scene::math::equirect::pixel_solid_angle;

use super::cell_grid::{CellGrid, LightCell};
use super::cone::Cone;
use super::light_distribution::{FINE, LightDistribution, LightTable, accumulate, invert, pad};
use super::texel_grid::TexelGrid;

/// Texel weights prepared for sampling. A sample chooses a cell by a [`LightDistribution`], then a texel of the
/// cell by its weight times its exact solid angle.
#[derive(Debug)]
pub struct LightCells {
    width: usize,
    height: usize,
    /// Cells from which distributions choose.
    pub grid: CellGrid,
    /// Distributions over the cells, one for each bin of normals.
    distributions: LightTable,
    /// First texel column of each cell column, followed by the end of the last cell column.
    columns: Vec<usize>,
    /// First texel row of each cell row, followed by the end of the last cell row.
    rows: Vec<usize>,
    /// Cell row of each texel row, and cell column of each texel column.
    row_of: Vec<u8>,
    column_of: Vec<u8>,
    /// Cumulative probabilities of the texel rows within each cell. For each cell column, the values of all texel
    /// rows are stored one after another.
    down: Vec<f32>,
    /// Cumulative probabilities of the texels of each row within their cell.
    across: Vec<f32>,
}

/// Number of f32 values per cache line.
const LINE: usize = 16;

/// First step of the choice of a texel: a cell, and a texel row of the cell.
#[derive(Debug, Clone, Copy, Default)]
pub struct RowChoice {
    y: u32,
    /// First texel column of the cell, and the end of its columns.
    columns: [u32; 2],
    place: [f64; 2],
    /// Probability of the cell.
    pub probability: f32,
}

/// Divides a line of weights into pieces by repeatedly halving the piece with the largest product of weight
/// and length, so that bright parts get narrow pieces. Returns the starts of the pieces and the end.
fn cut(weights: &[f64], pieces: usize) -> Vec<usize> {
    let mut cuts = vec![0, weights.len()];
    let heavy = |cuts: &[usize]| match cuts[1] - cuts[0] {
        0 | 1 => 0.0,
        length => weights[cuts[0]..cuts[1]].iter().sum::<f64>() * length as f64,
    };
    while cuts.len() <= pieces {
        // The first one if several are equal.
        let costs = cuts.windows(2).map(heavy).enumerate();
        let Some((at, cost)) = costs.reduce(|a, b| if b.1 > a.1 { b } else { a }) else { break };
        if cost <= 0.0 {
            break;
        }
        cuts.insert(at + 1, (cuts[at] + cuts[at + 1]) / 2);
    }
    cuts
}

impl LightCells {
    /// Divides the texels of a tier into at most `most` columns and rows of cells, by their weights. `pdf` is
    /// called with the index of each texel and its density within its cell.
    pub fn new(
        texel_grid: &TexelGrid,
        weights: Vec<f32>,
        most: [usize; 2],
        pdf: &mut dyn FnMut(usize, f32),
    ) -> Self {
        let TexelGrid { width, height, .. } = *texel_grid;
        let (mut of_rows, mut of_columns) = (vec![0.0; height], vec![0.0; width]);
        for (y, of_row) in of_rows.iter_mut().enumerate() {
            let area = pixel_solid_angle(width, height, y);
            for (of_column, weight) in of_columns.iter_mut().zip(&weights[y * width..]) {
                *of_row += f64::from(*weight) * area;
                *of_column += f64::from(*weight) * area;
            }
        }
        let (columns, rows) = (cut(&of_columns, most[0]), cut(&of_rows, most[1]));
        let counts = [columns.len() - 1, rows.len() - 1];
        let cell_of = |starts: &[usize], texels: usize| -> Vec<u8> {
            (0..texels).map(|texel| (starts.partition_point(|&first| first <= texel) - 1) as u8).collect()
        };
        let (row_of, column_of) = (cell_of(&rows, height), cell_of(&columns, width));
        let mut all = Self {
            width,
            height,
            grid: CellGrid::default(),
            distributions: LightTable::new(FINE),
            columns,
            rows,
            row_of,
            column_of,
            down: vec![0.0; counts[0] * height],
            across: weights,
        };
        let mut cells = Vec::with_capacity(counts[0] * counts[1]);
        for row in 0..counts[1] {
            for column in 0..counts[0] {
                cells.push(all.divide(texel_grid, pdf, row, column));
            }
        }
        pad(&mut all.down);
        pad(&mut all.across);
        all.grid = CellGrid::new(&cells, counts[0]);
        all
    }

    /// Distribution for a surface with the given unit normal. `None` means surfaces that are lit from all sides.
    #[inline]
    pub fn distribution(&self, normal: Option<Vec3>) -> &LightDistribution {
        self.distributions.of(&self.grid, normal, None)
    }

    /// Takes the first step of a choice: a cell and a texel row of the cell. The two steps are taken for several
    /// points at once, so that memory accesses overlap.
    #[inline(always)]
    pub fn row<S: Simd>(&self, simd: S, distribution: &LightDistribution, point: [f64; 2]) -> RowChoice {
        let (row, column, place) = distribution.choose(simd, point);
        let probability = distribution.probability(row, column);
        self.row_of_cell(simd, (row, column), place, probability)
    }

    /// Chooses a texel row of a cell, given by its row and column. The probability of the cell is passed on.
    #[inline(always)]
    pub fn row_of_cell<S: Simd>(
        &self,
        simd: S,
        (row, column): (usize, usize),
        [v, u]: [f64; 2],
        probability: f32,
    ) -> RowChoice {
        let (rows, columns) = self.texels_of(row, column);
        let (y, v) = invert(simd, &self.down[column * self.height + rows.start..], rows.len(), v);
        let columns = [columns.start as u32, columns.end as u32];
        RowChoice { y: (rows.start + y) as u32, columns, place: [u, v], probability }
    }

    /// Reads the data that [`texel`](Self::texel) will search, so that the memory accesses of many choices overlap.
    /// The returned sum only keeps the compiler from removing the reads.
    #[inline(always)]
    pub fn look_ahead(&self, &RowChoice { y, columns: [start, end], .. }: &RowChoice) -> f32 {
        let line = &self.across[y as usize * self.width + start as usize..];
        let last = (end - start) as usize - 1;
        line[0] + line[last.min(LINE)] + line[last.min(2 * LINE)]
    }

    /// Completes a choice that [`row`](Self::row) began, by choosing a texel of the row. Returns the column and row
    /// of the texel, and a position within the texel.
    #[inline(always)]
    pub fn texel<S: Simd>(
        &self,
        simd: S,
        &RowChoice { y, columns, place: [u, v], .. }: &RowChoice,
    ) -> ((usize, usize), [f64; 2]) {
        let (y, start, end) = (y as usize, columns[0] as usize, columns[1] as usize);
        let (x, u) = invert(simd, &self.across[y * self.width + start..], end - start, u);
        ((start + x, y), [u, v])
    }

    /// Row and column of the cell that contains a texel.
    #[inline]
    pub fn cell(&self, (x, y): (usize, usize)) -> (usize, usize) {
        (usize::from(self.row_of[y]), usize::from(self.column_of[x]))
    }

    /// Texel rows and columns of a cell.
    #[inline]
    fn texels_of(&self, row: usize, column: usize) -> (Range<usize>, Range<usize>) {
        (self.rows[row]..self.rows[row + 1], self.columns[column]..self.columns[column + 1])
    }

    /// Makes a cell, and computes the probabilities within it.
    fn divide(
        &mut self,
        texel_grid: &TexelGrid,
        pdf: &mut dyn FnMut(usize, f32),
        row: usize,
        column: usize,
    ) -> LightCell {
        let (rows, columns) = self.texels_of(row, column);
        let down = column * self.height..(column + 1) * self.height;
        let mut of_rows = Vec::with_capacity(rows.len());
        let mut cumulative = vec![0.0; rows.len().max(columns.len())];
        let share = |c: &[f32], i: usize| f64::from(c[i]) - if i > 0 { f64::from(c[i - 1]) } else { 0.0 };
        let (mut towards, mut solid_angle) = ([0.0; 3], 0.0);
        for y in rows.clone() {
            let to = &mut self.across[y * self.width..][columns.clone()];
            let weights: Vec<f64> = to.iter().map(|&w| f64::from(w)).collect();
            let sum = accumulate(&weights, &mut cumulative[..columns.len()]);
            for (to, from) in to.iter_mut().zip(&cumulative) {
                *to = *from as f32;
            }
            let area = pixel_solid_angle(self.width, self.height, y);
            solid_angle += area * columns.len() as f64;
            let above = 0.5 * (texel_grid.cosines[y] + texel_grid.cosines[y + 1]);
            let radius = (1.0 - above * above).max(0.0).sqrt();
            for (weight, x) in weights.iter().zip(columns.clone()) {
                let [a, b] = [texel_grid.edges[x], texel_grid.edges[x + 1]];
                let side = 0.5 * radius * weight * area;
                towards[0] += (a.0 + b.0) * side;
                towards[1] += (a.1 + b.1) * side;
                towards[2] += above * weight * area;
            }
            of_rows.push(sum * area);
        }
        let power = accumulate(&of_rows, &mut cumulative[..rows.len()]);
        for (to, from) in self.down[down.clone()][rows.clone()].iter_mut().zip(&cumulative) {
            *to = *from as f32;
        }
        for y in rows.clone() {
            let of_row = share(&self.down[down.clone()][rows.clone()], y - rows.start);
            let of_row = of_row / pixel_solid_angle(self.width, self.height, y);
            for x in columns.clone() {
                let of_texel = share(&self.across[y * self.width..][columns.clone()], x - columns.start);
                pdf(y * self.width + x, (of_row * of_texel) as f32);
            }
        }
        let corner = |x, y| texel_grid.corner(x, y);
        let [left, right, top, bottom] = [columns.start, columns.end, rows.start, rows.end];
        let corners = [corner(left, top), corner(right, top), corner(left, bottom), corner(right, bottom)];
        let axis = match (columns.len(), rows.len()) {
            (1, _) | (_, 1) => corners.into_iter().sum::<Vec3>().normalize_or(texel_grid.axes[2]),
            _ => corner((left + right) / 2, (top + bottom) / 2),
        };
        // Along its edges the angle from a point of a cell is greatest at corners, unless the cell is wide.
        let farthest = corners.iter().map(|corner| corner.dot(axis)).fold(1.0, f32::min) - 1e-5;
        let cosine = if columns.len() * 4 > self.width { -1.0 } else { farthest };
        let towards = texel_grid.to_world(towards.map(|t| if power > 0.0 { t / power } else { 0.0 }));
        LightCell { cone: Cone { axis, cosine }, area: solid_angle, power, towards }
    }
}
