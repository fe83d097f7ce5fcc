//! Connected regions of a mask on the sphere, and distances to their edge.

use std::collections::BTreeSet;

/// Four-connected regions of an equirectangular mask, whose left edge is adjacent to its right edge. Regions are
/// numbered from 0 in the order of their first pixels, row by row.
pub struct Regions {
    /// Index of the region of each pixel, row by row; `None` for pixels outside the mask.
    pub of: Vec<Option<u32>>,
    /// Number of regions.
    pub count: usize,
}

/// Finds the regions of a mask of `width` columns.
pub fn label(mask: &[bool], width: usize) -> Regions {
    let mut of = vec![None; mask.len()];
    let (mut count, mut stack) = (0_u32, Vec::new());
    for start in 0..mask.len() {
        if !mask[start] || of[start].is_some() {
            continue;
        }
        of[start] = Some(count);
        stack.push(start);
        while let Some(at) = stack.pop() {
            for next in neighbours(at, width, mask.len()).into_iter().flatten() {
                if mask[next] && of[next].is_none() {
                    of[next] = Some(count);
                    stack.push(next);
                }
            }
        }
        count += 1;
    }
    Regions { of, count: count as usize }
}

/// Pixels above, below, left and right of a pixel. Rows wrap around; `None` beyond the first and the last row.
pub fn neighbours(at: usize, width: usize, len: usize) -> [Option<usize>; 4] {
    let x = at % width;
    let row = at - x;
    [
        Some(row + if x == 0 { width - 1 } else { x - 1 }),
        Some(row + if x + 1 == width { 0 } else { x + 1 }),
        at.checked_sub(width),
        Some(at + width).filter(|&below| below < len),
    ]
}

/// The mask grown by `steps` pixels along rows and columns.
pub fn grow(mask: &[bool], width: usize, steps: usize) -> Vec<bool> {
    let mut grown = mask.to_vec();
    for _ in 0..steps {
        let before = grown.clone();
        for (at, cell) in grown.iter_mut().enumerate() {
            *cell = before[at]
                || neighbours(at, width, before.len()).into_iter().flatten().any(|next| before[next]);
        }
    }
    grown
}

/// Returns the pixels of a region, and those within `steps` pixels of it along rows and columns, in ascending
/// order. This is the result of [`grow`], computed in time proportional to the size of the region.
pub fn around(region: &[usize], (width, len): (usize, usize), steps: usize) -> BTreeSet<usize> {
    let mut found: BTreeSet<usize> = region.iter().copied().collect();
    let mut edge = region.to_vec();
    for _ in 0..steps {
        let next = edge.iter().flat_map(|&at| neighbours(at, width, len)).flatten();
        edge = next.filter(|&at| found.insert(at)).collect();
    }
    found
}

/// Distance in pixels from each pixel of the mask to the nearest pixel outside it; 0 for pixels outside the mask.
/// The poles do not count as an edge. Exact Euclidean distance by lower envelopes of parabolas (Felzenszwalb and
/// Huttenlocher, Distance Transforms of Sampled Functions, 2012). Rows are extended by a quarter turn on both
/// sides, so that distances across the left and right edges are found, up to a length of a quarter turn.
pub fn distance_to_edge(mask: &[bool], width: usize) -> Vec<f32> {
    let height = mask.len() / width;
    let far = ((width + height) * (width + height) * 4) as f64;
    let mut squared: Vec<f64> = mask.iter().map(|&inside| if inside { far } else { 0.0 }).collect();
    let mut line = Line::default();
    for x in 0..width {
        line.load((0..height).map(|y| squared[y * width + x]));
        line.transform();
        (0..height).for_each(|y| squared[y * width + x] = line.out[y]);
    }
    let pad = width.div_ceil(4);
    for row in squared.chunks_exact_mut(width) {
        line.load((0..width + 2 * pad).map(|i| row[(i + width - pad % width) % width]));
        line.transform();
        row.copy_from_slice(&line.out[pad..pad + width]);
    }
    squared.iter().map(|d| d.sqrt() as f32).collect()
}

/// A row or column of squared distances, with the scratch memory of its lower envelope.
#[derive(Default)]
struct Line {
    values: Vec<f64>,
    out: Vec<f64>,
    roots: Vec<usize>,
    starts: Vec<f64>,
}

impl Line {
    fn load(&mut self, values: impl Iterator<Item = f64>) {
        self.values.clear();
        self.values.extend(values);
    }

    fn transform(&mut self) {
        let Line { values, out, roots, starts } = self;
        roots.clear();
        starts.clear();
        for (q, &value) in values.iter().enumerate() {
            let height = value + (q * q) as f64;
            let start = loop {
                let Some(&root) = roots.last() else { break f64::NEG_INFINITY };
                let crossing = (height - (values[root] + (root * root) as f64)) / (2.0 * (q - root) as f64);
                if crossing > starts[roots.len() - 1] {
                    break crossing;
                }
                roots.pop();
                starts.pop();
            };
            roots.push(q);
            starts.push(start);
        }
        out.clear();
        let mut part = 0;
        for q in 0..values.len() {
            while part + 1 < roots.len() && starts[part + 1] < q as f64 {
                part += 1;
            }
            let root = roots[part];
            let away = q.abs_diff(root) as f64;
            out.push(values[root] + away * away);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: &[&str]) -> (Vec<bool>, usize) {
        (rows.iter().flat_map(|row| row.chars().map(|c| c == '#')).collect(), rows[0].len())
    }

    #[test]
    fn regions_join_across_the_seam_and_not_across_corners() {
        let (mask, width) = mask(&["##...#", ".....#", "..#...", "...#.."]);
        let regions = label(&mask, width);
        assert_eq!(regions.count, 3);
        assert_eq!(regions.of[0], regions.of[11]);
        assert_ne!(regions.of[14], regions.of[21]);
    }

    #[test]
    fn growing_wraps_in_x_only() {
        let (mask, width) = mask(&["#.....", "......", "......"]);
        let grown: String = grow(&mask, width, 1).iter().map(|&m| if m { '#' } else { '.' }).collect();
        assert_eq!(grown, "##...##...........");
    }

    // This test fails if `steps` is one less, or if the edge is not updated.
    #[test]
    fn what_is_around_a_region_is_what_it_grows_to() {
        let (mask, width) = mask(&["#....##.", "........", ".#......", "........", "........", "....##.."]);
        let region: Vec<usize> = (0..mask.len()).filter(|&at| mask[at]).collect();
        for steps in 0..4 {
            let grown = grow(&mask, width, steps);
            let wanted: Vec<usize> = (0..mask.len()).filter(|&at| grown[at]).collect();
            let found: Vec<usize> = around(&region, (width, mask.len()), steps).into_iter().collect();
            assert_eq!(found, wanted, "{steps}");
        }
    }

    // Compared with the definition: the nearest outside pixel of all pixels within a quarter turn.
    #[test]
    fn distances_are_the_nearest_outside_pixel() {
        let (width, height) = (24_usize, 10_usize);
        let mask: Vec<bool> = (0..width * height)
            .map(|i| {
                let (x, y) = ((i % width + 5) % width, i / width);
                (x < 11 && (2..9).contains(&y)) || (x > 18 && y < 3)
            })
            .collect();
        let found = distance_to_edge(&mask, width);
        for (at, found) in found.iter().enumerate() {
            let (x, y) = (at % width, at / width);
            let nearest = (0..mask.len()).filter(|&o| !mask[o]).map(|o| {
                let dx = (o % width).abs_diff(x);
                let dx = dx.min(width - dx) as f64;
                let dy = (o / width).abs_diff(y) as f64;
                (dx * dx + dy * dy).sqrt()
            });
            let nearest = nearest.fold(f64::INFINITY, f64::min);
            assert!((f64::from(*found) - nearest).abs() < 1e-6, "({x}, {y}): {found} {nearest}");
        }
    }
}
