//! Holes in the receiver mesh: regions of an image that do not show the receiver, where no shadow can fall.

use scene::types::{Data, Image};

/// Number of pixels of a depth image that are in holes. A hole is a region of infinite depth that does not touch
/// the border. The sky above a place is not a hole, but a window that is completely visible is one.
pub fn holes(depth: &Image<Data>) -> u64 {
    let Image { width, height, .. } = *depth;
    // Missing pixels not yet visited.
    let mut open: Vec<bool> = depth.samples.iter().map(|depth| !depth.is_finite()).collect();
    let (mut found, mut waiting) = (0, Vec::new());
    for first in 0..width * height {
        if !std::mem::take(&mut open[first]) {
            continue;
        }
        let (mut pixels, mut at_edge) = (0, false);
        waiting.push(first);
        while let Some(at) = waiting.pop() {
            let (x, y) = (at % width, at / width);
            pixels += 1;
            if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
                at_edge = true;
            }
            let neighbours = [
                (x > 0).then(|| at - 1),
                (x + 1 < width).then_some(at + 1),
                (y > 0).then(|| at - width),
                (y + 1 < height).then_some(at + width),
            ];
            waiting.extend(neighbours.into_iter().flatten().filter(|&next| std::mem::take(&mut open[next])));
        }
        found += if at_edge { 0 } else { pixels };
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regions that are surrounded by receiver are holes; the sky, and a region that is cut by the border, are not.
    /// Tested with a floor that has holes of 3 by 2 and of 20 by 20 pixels, at several image sizes. This test fails
    /// if `at_edge` is never set, or if the search does not step up.
    #[test]
    fn what_is_surrounded_is_a_hole_and_the_sky_is_not() {
        for scale in [1, 2, 5] {
            let within = |at: usize, from: usize, to: usize| (from * scale..to * scale).contains(&at);
            let open = |x: usize, y: usize| {
                within(y, 0, 10)
                    || (within(x, 4, 7) && within(y, 20, 22))
                    || (within(x, 18, 38) && within(y, 14, 34))
                    || (within(x, 10, 12) && within(y, 36, 40))
            };
            let side = 40 * scale;
            let depth = |i: usize| if open(i % side, i / side) { f32::INFINITY } else { 2.0 };
            let depths = (0..side * side).map(depth).collect();
            let expected = (406 * scale * scale) as u64;
            assert_eq!(holes(&Image::from_samples(side, side, 1, depths)), expected);
        }
        assert_eq!(holes(&Image::from_samples(40, 1, 1, vec![f32::INFINITY; 40])), 0);
    }

    /// A hole in the shape of a U is one region.
    #[test]
    fn a_winding_hole_is_whole() {
        let picture = ["#######", "#.###.#", "#.###.#", "#.....#", "#######"].concat();
        let depths = picture.chars().map(|c| if c == '.' { f32::INFINITY } else { 1.0 }).collect();
        assert_eq!(holes(&Image::from_samples(7, 5, 1, depths)), 9);
        let open_above = picture.replacen("#######", "#.#####", 1);
        let depths = open_above.chars().map(|c| if c == '.' { f32::INFINITY } else { 1.0 }).collect();
        assert_eq!(holes(&Image::from_samples(7, 5, 1, depths)), 0);
    }
}
