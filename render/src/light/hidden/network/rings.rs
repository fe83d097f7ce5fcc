//! Light around each clipped region, by distance from its edge.
//!
//! The glow around a light, and the colour of the last pixels before it clips, depend on how bright it is and on its
//! colour.

use crate::light::regions::neighbours;

/// Number of rings around each region.
pub const RINGS: usize = 6;
/// Distance of the outer edge of each ring from the region, in cells along rows and columns.
const REACH: [usize; RINGS] = [1, 3, 6, 11, 20, 35];

/// Unclipped light of each cell: its solid angle and its mean RGB.
pub struct Open<'a> {
    pub size: &'a [f64],
    pub rgb: &'a [[f64; 3]],
}

/// Mean RGB of the unclipped light in each ring around each region. `regions` holds the cells of each region. A cell
/// counts for the nearest region, or for all regions at the smallest distance. A ring without unclipped cells has the
/// light of the next inner ring, and the innermost ring then has the mean light of the panorama.
pub fn rings(regions: &[Vec<usize>], width: usize, open: &Open<'_>) -> Vec<[[f64; 3]; RINGS]> {
    let len = open.size.len();
    let mut reached = vec![false; len];
    let mut front: Vec<(usize, usize)> = Vec::new();
    for (region, cells) in regions.iter().enumerate() {
        for &cell in cells {
            reached[cell] = true;
            front.push((cell, region));
        }
    }
    // Sums of solid angle times red, green, blue and 1.
    let mut sums = vec![[[0.0; 4]; RINGS]; regions.len()];
    let mut inner = 0;
    for (ring, outer) in REACH.into_iter().enumerate() {
        for _ in inner..outer {
            let next = front.iter().flat_map(|&(cell, region)| {
                neighbours(cell, width, len).into_iter().flatten().map(move |cell| (cell, region))
            });
            let mut next: Vec<(usize, usize)> = next.filter(|&(cell, _)| !reached[cell]).collect();
            next.sort_unstable();
            next.dedup();
            for &(cell, region) in &next {
                reached[cell] = true;
                add(&mut sums[region][ring], open, cell);
            }
            front = next;
        }
        inner = outer;
    }
    let mut all = [0.0; 4];
    (0..len).for_each(|cell| add(&mut all, open, cell));
    let all = mean(all).unwrap_or_default();
    let filled = |sums: [[f64; 4]; RINGS]| {
        let mut last = all;
        sums.map(|sum| {
            last = mean(sum).unwrap_or(last);
            last
        })
    };
    sums.into_iter().map(filled).collect()
}

fn add(sum: &mut [f64; 4], open: &Open<'_>, cell: usize) {
    let (size, [r, g, b]) = (open.size[cell], open.rgb[cell]);
    sum.iter_mut().zip([r, g, b, 1.0]).for_each(|(sum, v)| *sum += size * v);
}

fn mean([r, g, b, size]: [f64; 4]) -> Option<[f64; 3]> {
    (size > 0.0).then(|| [r, g, b].map(|v| v / size))
}

#[cfg(test)]
mod tests {
    use super::*;

    // Two regions of one cell in a row of ten columns, in light that grows from column to column. Cells at
    // the same distance from both count for both. This test fails if `reached` is not checked.
    #[test]
    fn a_ring_holds_the_light_at_its_distance() {
        let (width, height) = (10, 3);
        let size: Vec<f64> = (0..width * height).map(|at| if at / width == 1 { 1.0 } else { 0.0 }).collect();
        let rgb: Vec<[f64; 3]> =
            (0..width * height).map(|at| [(at % width) as f64, 1.0, 2.0 * (at % width) as f64]).collect();
        let found = rings(&[vec![width + 2], vec![width + 6]], width, &Open { size: &size, rgb: &rgb });
        let red = |region: usize| found[region].map(|[r, _, _]| r);
        // Nearest cells of column 2: columns 1 and 3, then 0, 4 and 9. Nearest cells of column 6: 5 and 7, then 4
        // and 8, then 9.
        assert!((red(0)[0] - 2.0).abs() < 1e-12 && (red(1)[0] - 6.0).abs() < 1e-12, "{found:?}");
        assert!((red(0)[1] - 13.0 / 3.0).abs() < 1e-12, "{found:?}");
        assert!((red(1)[1] - 21.0 / 3.0).abs() < 1e-12, "{found:?}");
        assert_eq!(found[0][5], found[0][1], "rings without cells have the light of the ring inside them");
        assert!(
            found.iter().flatten().all(|[r, g, b]| (g - 1.0).abs() < 1e-12 && (b - 2.0 * r).abs() < 1e-12)
        );
    }

    // Without unclipped cells, all rings are black.
    #[test]
    fn nothing_unclipped_is_black() {
        let found = rings(&[vec![0]], 4, &Open { size: &[0.0; 8], rgb: &[[1.0; 3]; 8] });
        assert_eq!(found, vec![[[0.0; 3]; RINGS]]);
    }
}
