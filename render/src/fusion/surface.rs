//! Surface where the field is 0, by surface nets (Gibson 1998) over cells of several sizes (Ju et al. 2002). Each
//! cell that the surface passes through has a point, which is the mean of the positions where the surface crosses
//! the edges of the cell. Each crossed edge is surrounded by a quadrilateral, whose corners are the points of the
//! four cells at the edge. Cells with a corner that no view shows have no point, so the mesh is open there.

use engine::{Context, NodeError};
use glam::Vec3;

use super::field::{Field, corner};
use super::levels::SIDE;

/// Triangle mesh with points relative to the origin of the field. Triangles are counter-clockwise as seen
/// from empty space.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Surface {
    /// Corners of the triangles, in world units.
    pub points: Vec<Vec3>,
    /// For each point, the level of the cell that contains it.
    pub levels: Vec<u8>,
    /// Indices of the corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// An edge that the surface crosses.
struct Crossing {
    /// Indices of the four cells around the edge, counter-clockwise as seen from its empty end.
    cells: [u32; 4],
    /// Position of the crossing.
    point: Vec3,
}

/// Number of cells in a block.
const CELLS: usize = (SIDE * SIDE * SIDE) as usize;

/// Crossings of the edges that belong to a block. An edge that several blocks share belongs to the finest of them,
/// and among blocks of the same size to the first.
fn crossings(field: &Field<'_>, index: usize) -> Vec<Crossing> {
    let block = &field.blocks[index];
    let (first, step, side) = (block.cube.corner(), block.cube.step(), SIDE as usize);
    let mut found = Vec::new();
    for axis in 0..3 {
        let (across, along) = ((axis + 1) % 3, (axis + 2) % 3);
        let most = |k: usize| if k == axis { side } else { side + 1 };
        for z in 0..most(2) {
            for y in 0..most(1) {
                for x in 0..most(0) {
                    let mut end = [x, y, z];
                    end[axis] += 1;
                    let (from, to) = (corner(x, y, z), corner(end[0], end[1], end[2]));
                    if !block.crosses(from, to) {
                        continue;
                    }
                    let start = [x, y, z];
                    let mut cells = [0_u32; 4];
                    let mut complete = true;
                    for (cell, [i, j]) in cells.iter_mut().zip([[1, 1], [0, 1], [0, 0], [1, 0]]) {
                        let mut at: [i32; 3] = std::array::from_fn(|k| first[k] + start[k] as i32 * step);
                        at[across] -= i;
                        at[along] -= j;
                        let inside = |k: usize, back: i32| {
                            start[k] >= back as usize && start[k] < side + back as usize
                        };
                        let here = inside(across, i) && inside(along, j);
                        let located = if here {
                            let mut cell = start;
                            cell[across] -= i as usize;
                            cell[along] -= j as usize;
                            Some((index, (cell[2] * side + cell[1]) * side + cell[0]))
                        } else {
                            field.locate(at)
                        };
                        let whole = located.filter(|(block, cell)| field.blocks[*block].is_whole(*cell));
                        let Some((other, number)) = whole else {
                            complete = false;
                            break;
                        };
                        let level = field.blocks[other].cube.level;
                        if level < block.cube.level || level == block.cube.level && other < index {
                            complete = false;
                            break;
                        }
                        *cell = (other * CELLS + number) as u32;
                    }
                    if !complete {
                        continue;
                    }
                    let ((a, _), (b, _)) = (block.at(from), block.at(to));
                    let mut point = Vec3::from(std::array::from_fn::<f32, 3, _>(|k| {
                        (first[k] + start[k] as i32 * step) as f32 * field.levels.cell
                    }));
                    point[axis] += a / (a - b) * field.levels.cell_of(block.cube.level);
                    if a >= 0.0 {
                        cells.reverse();
                    }
                    found.push(Crossing { cells, point });
                }
            }
        }
    }
    found
}

impl Surface {
    /// Extracts the surface of a field.
    pub fn of(field: &Field<'_>, cx: &Context) -> Result<Self, NodeError> {
        const GROUP: usize = 64;
        let groups = cx.for_each_tile(field.blocks.len().div_ceil(GROUP), |group| {
            let blocks = group * GROUP..((group + 1) * GROUP).min(field.blocks.len());
            blocks.flat_map(|index| crossings(field, index)).collect::<Vec<_>>()
        })?;
        let mut cells: Vec<u32> = groups.iter().flatten().flat_map(|crossing| crossing.cells).collect();
        cells.sort_unstable();
        cells.dedup();
        // Where the cells of each block begin, which makes the search for a cell faster.
        let mut starts = vec![0_usize; field.blocks.len() + 1];
        for cell in &cells {
            starts[*cell as usize / CELLS + 1] += 1;
        }
        for block in 1..starts.len() {
            starts[block] += starts[block - 1];
        }
        let number = |cell: u32| {
            let block = cell as usize / CELLS;
            let own = &cells[starts[block]..starts[block + 1]];
            (starts[block] + own.partition_point(|other| *other < cell)) as u32
        };
        let (mut sums, mut counts) = (vec![Vec3::ZERO; cells.len()], vec![0.0_f32; cells.len()]);
        let mut quadrangles = Vec::with_capacity(groups.iter().map(Vec::len).sum());
        for group in groups {
            cx.check()?;
            for Crossing { cells, point } in group {
                let corners = cells.map(number);
                for (i, corner) in corners.into_iter().enumerate() {
                    // A large cell may be two of the four.
                    if !corners[..i].contains(&corner) {
                        sums[corner as usize] += point;
                        counts[corner as usize] += 1.0;
                    }
                }
                quadrangles.push(corners);
            }
        }
        let points: Vec<Vec3> = sums.into_iter().zip(counts).map(|(sum, count)| sum / count).collect();
        let levels = cells.iter().map(|cell| field.blocks[*cell as usize / CELLS].cube.level).collect();
        let mut triangles = Vec::with_capacity(2 * quadrangles.len());
        for [a, b, c, d] in quadrangles {
            let length = |p: u32, q: u32| (points[p as usize] - points[q as usize]).length_squared();
            let halves =
                if length(a, c) <= length(b, d) { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] };
            triangles.extend(halves.into_iter().filter(|[p, q, r]| p != q && q != r && r != p));
        }
        Ok(Self { points, levels, triangles })
    }

    /// Removes points without a triangle. Returns the former index of each remaining point.
    pub fn compact(&mut self) -> Vec<u32> {
        let mut numbers = vec![u32::MAX; self.points.len()];
        let mut kept = Vec::new();
        for corner in self.triangles.as_flattened_mut() {
            let number = &mut numbers[*corner as usize];
            if *number == u32::MAX {
                *number = kept.len() as u32;
                kept.push(*corner);
            }
            *corner = *number;
        }
        self.points = kept.iter().map(|i| self.points[*i as usize]).collect();
        self.levels = kept.iter().map(|i| self.levels[*i as usize]).collect();
        kept
    }

    /// Normal of a triangle. Its length is twice the area of the triangle.
    pub fn normal(&self, [a, b, c]: [u32; 3]) -> Vec3 {
        let [a, b, c] = [a, b, c].map(|i| self.points[i as usize]);
        (b - a).cross(c - a)
    }
}
