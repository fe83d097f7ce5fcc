//! Finds splats in front of inserted objects by comparing the depths in a rendered view.

/// Depths and coverages of one view. All lists have one number per pixel.
#[derive(Debug, Clone, Copy)]
pub struct Depths<'a> {
    /// Planar depth of the splats, in world units; +inf where there are no splats.
    pub splats: &'a [f32],
    /// Coverage of the splats, 0 to 1.
    pub coverage: &'a [f32],
    /// Planar depth of the nearest surface of an object or the mesh, in world units; +inf where there is no
    /// surface.
    pub surface: &'a [f32],
    /// Coverage of the inserted objects, 0 to 1.
    pub objects: &'a [f32],
}

/// Minimum coverage at which the splats at a pixel count as solid.
const SOLID: f32 = 0.9;
/// Minimum coverage at which an object counts as visible at a pixel.
const DRAWN: f32 = 0.5;
/// Ratio of the depth of the splats to the depth of an object below which the splats count as in front of the
/// object. It is less than 1 because an object touches the ground that it stands on.
const BEFORE: f32 = 0.85;
/// Minimum number of pixels at which an object must be visible. With fewer pixels, the result is 0.
const PIXELS: u64 = 40;

/// Pixels at which solid splats are in front of an object, as a share of all pixels at which an object is visible;
/// 0 if objects are visible at only a few pixels.
pub fn share(depths: &Depths<'_>) -> f64 {
    let (mut objects, mut before) = (0_u64, 0_u64);
    let mesh = depths.surface.iter().zip(depths.objects);
    let splats = depths.splats.iter().zip(depths.coverage);
    for ((&splat, &coverage), (&surface, &object)) in splats.zip(mesh) {
        if object >= DRAWN && surface.is_finite() {
            objects += 1;
            let solid = coverage >= SOLID && splat.is_finite() && splat > 0.0;
            before += u64::from(solid && splat < BEFORE * surface);
        }
    }
    if objects >= PIXELS { before as f64 / objects as f64 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const N: usize = 100;

    fn of(change: impl Fn(usize) -> [f32; 4]) -> f64 {
        let rows: Vec<[f32; 4]> = (0..N * N).map(change).collect();
        let column = |at: usize| rows.iter().map(|row| row[at]).collect::<Vec<f32>>();
        let [splats, coverage, surface, objects] = [0, 1, 2, 3].map(column);
        share(&Depths { splats: &splats, coverage: &coverage, surface: &surface, objects: &objects })
    }

    /// Depth, at pixel `i`, of a scene that consists of a floor and a wall.
    fn place(i: usize) -> f32 {
        2.0 + (i % N) as f32 * 0.03 + (i / N) as f32 * 0.05
    }

    fn is_object(i: usize) -> bool {
        (40..60).contains(&(i % N)) && (40..60).contains(&(i / N))
    }

    /// Values at pixel `i` if no splats are in front of the object, in this order: depth of the splats, coverage of
    /// the splats, depth of the surface, coverage of the objects.
    fn right(i: usize) -> [f32; 4] {
        if is_object(i) {
            [place(i), 1.0, place(i) * 0.9, 1.0]
        } else {
            [place(i), 1.0, place(i) * 1.03, 0.0]
        }
    }

    /// Opaque splats in front of an object are counted, and semi-transparent splats are not. This test fails if
    /// `splat < BEFORE * surface` is replaced with `splat > BEFORE * surface`.
    #[test]
    fn a_post_before_an_object_is_found_and_haze_is_not() {
        assert_eq!(of(right), 0.0);
        assert_eq!(of(|i| if is_object(i) { [0.5, 0.4, place(i), 1.0] } else { right(i) }), 0.0);
        let post = |i: usize| is_object(i) && i % N < 46;
        assert_eq!(of(|i| if post(i) { [1.0, 1.0, place(i), 1.0] } else { right(i) }), 0.3);
    }
}
