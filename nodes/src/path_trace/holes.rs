//! Holes of the receiver: pixels among others of it that meet none, where no shadow is carried.

use crate::types::{Data, Image};

/// So near to each pixel of a hole there is receiver on all sides: what is farther from it is an opening.
const NEAR_PX: usize = 8;

/// Pixels of a picture of depths, +inf where nothing is met, that have others which meet something as near as that on all four sides.
pub(super) fn holes(depth: &Image<Data>) -> u64 {
    let Image { width, height, .. } = *depth;
    let meets = |x: usize, y: usize| depth.pixel(x, y)[0].is_finite();
    let is_hole = |x: usize, y: usize| {
        let left = (x.saturating_sub(NEAR_PX)..x).any(|x| meets(x, y));
        let right = (x + 1..(x + 1 + NEAR_PX).min(width)).any(|x| meets(x, y));
        let above = (y.saturating_sub(NEAR_PX)..y).any(|y| meets(x, y));
        let below = (y + 1..(y + 1 + NEAR_PX).min(height)).any(|y| meets(x, y));
        left && right && above && below
    };
    let all = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    all.filter(|&(x, y)| !meets(x, y) && is_hole(x, y)).count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a floor under the sky with a hole of 3 by 2 pixels and a window of 20 by 20 the hole is told.
    /// Mutation: `NEAR_PX` 16; `left` left out.
    #[test]
    fn small_gaps_are_holes_and_the_sky_is_not() {
        let open = |x: usize, y: usize| {
            y < 10
                || ((4..7).contains(&x) && (20..22).contains(&y))
                || ((18..38).contains(&x) && (14..34).contains(&y))
        };
        let depths = (0..40 * 40).map(|i| if open(i % 40, i / 40) { f32::INFINITY } else { 2.0 });
        assert_eq!(holes(&Image::from_samples(40, 40, 1, depths.collect())), 6);
        assert_eq!(holes(&Image::from_samples(40, 1, 1, vec![f32::INFINITY; 40])), 0);
    }
}
