//! Share of the splats in front of the eye that the near plane cuts away.

use glam::DVec3;
use scene::types::{Camera, Splats};

/// Maximum number of splats that are examined. If there are more, they are sampled evenly.
const EXAMINED: usize = 1 << 16;
/// Minimum opacity of splats that count as solid. Fainter splats are haze, which may be cut away.
const SOLID: f32 = 0.5;
/// Minimum share of the solid splats in front of the eye that must be cut away for a warning.
pub(crate) const REPORTED: f64 = 0.02;

/// Numbers of solid splats in front of the eye: those that are cut away, and those that are kept.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Count {
    cut: u64,
    kept: u64,
}

/// Share of the solid splats whose depth `depth(mean)` is at or below `near`. Splats outside the picture or behind
/// the eye, for which `depth` returns `None`, do not count.
fn share(splats: &Splats, near: f64, depth: impl Fn(DVec3) -> Option<f64>) -> f64 {
    let step = splats.len().div_ceil(EXAMINED).max(1);
    let mut count = Count::default();
    for index in (0..splats.len()).step_by(step).filter(|index| splats.opacities[*index] >= SOLID) {
        match depth(splats.mean(index)) {
            Some(depth) if depth <= near => count.cut += 1,
            Some(_) => count.kept += 1,
            None => {}
        }
    }
    let all = count.cut + count.kept;
    if all == 0 { 0.0 } else { count.cut as f64 / all as f64 }
}

/// Share of the solid splats that `near` cuts away in the view of a camera, by planar depth.
pub fn cut_by_camera(splats: &Splats, camera: &Camera, near: f64) -> f64 {
    let view = camera.camera_from_world();
    let (width, height) = (f64::from(camera.width_px), f64::from(camera.height_px));
    share(splats, near, |mean| {
        let p = view.transform_point3(mean);
        let [u, v] = camera.pixel(p)?;
        ((0.0..width).contains(&u) && (0.0..height).contains(&v)).then_some(p.z)
    })
}

/// Share of the solid splats that `near` cuts away in a panorama, by distance.
pub fn cut_by_panorama(splats: &Splats, eye: DVec3, near: f64) -> f64 {
    share(splats, near, |mean| Some((mean - eye).length()))
}

/// Warning about the share of splats that is cut away. `None` if the share is small.
pub fn warning(share: f64, near_m: f64, near: f64, view: &str) -> Option<String> {
    (share >= REPORTED).then(|| {
        format!(
            "`near`, which is {near_m} m ({near} world units), cuts away {:.0} % of the solid splats in front of the \
             eye{view}; use a smaller `near`, or set `metres_per_unit` if a unit of the scene is not a metre",
            100.0 * share
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(depths: &[f64], opacity: f32) -> Splats {
        let mut splats = Splats::empty();
        for &depth in depths {
            splats.means.push([0.0, 0.0, depth as f32]);
            splats.scales.push([0.01; 3]);
            splats.quats.push([1.0, 0.0, 0.0, 0.0]);
            splats.opacities.push(opacity);
            splats.sh.push([0.0; 3]);
        }
        splats
    }

    /// The share counts only solid splats in front of the eye. This test fails if `depth <= near` is replaced with
    /// `depth < 0.0`.
    #[test]
    fn only_solid_splats_before_the_eye_count() {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        let camera = Camera::centred("v", [20, 20], 20.0, axes, DVec3::ZERO);
        let of = |depths: &[f64], opacity| cut_by_camera(&scene(depths, opacity), &camera, 0.2);
        assert_eq!(of(&[0.1, 0.15, 1.0, 2.0], 0.9), 0.5);
        assert_eq!(of(&[-0.1, -3.0, 1.0], 0.9), 0.0, "behind");
        assert_eq!(of(&[0.1, 1.0], 0.1), 0.0, "haze");
        assert_eq!(of(&[], 0.9), 0.0);
        assert_eq!(cut_by_panorama(&scene(&[-0.1, -3.0, 1.0, 5.0], 0.9), DVec3::ZERO, 0.2), 0.25);
        let mut aside = scene(&[0.1, 1.0], 0.9);
        aside.means[0] = [0.3, 0.0, 0.1];
        assert_eq!(cut_by_camera(&aside, &camera, 0.2), 0.0, "outside the picture");
        assert!(warning(0.01, 0.2, 0.2, "").is_none());
        assert!(
            warning(0.5, 0.2, 4.0, " of `v`").is_some_and(|text| text.contains("50 % of the solid splats"))
        );
    }
}
