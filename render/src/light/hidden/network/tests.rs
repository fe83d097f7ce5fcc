//! Tests of the rule for suns, and a scene for the tests of this module.

use engine::Up;

use super::*;
use crate::light::hidden::clip::SEEN;
use crate::light::linear::LinearPixels;

/// A panorama of 256 columns whose light is `light` of the column and row; pixels of 1 are clipped.
pub fn scene(light: impl Fn(usize, usize) -> [f32; 3]) -> Scene {
    let rgb: Vec<[f32; 3]> =
        (0..128).flat_map(|y| (0..256).map(move |x| (x, y))).map(|(x, y)| light(x, y)).collect();
    let mask: Vec<bool> = rgb.iter().map(|rgb| rgb.iter().any(|v| *v >= 1.0)).collect();
    let pixels = LinearPixels { width: 256, height: 128, rgb, broken: 0, negative: 0, ceiling: true };
    let alpha = vec![SEEN.max(1.0); mask.len()];
    let up = Up::PlusZ;
    let clipped = Clipped::new(up, &alpha, (&pixels, &mask, 1.0));
    Scene::new(&clipped.grid, up, &clipped.labels, 1.0)
}

/// The rule raises the light of a sun to half of the visible light, and keeps a sun that has more. This test fails if
/// `with_suns` lacks its loop, or if it replaces the predicted light.
#[test]
fn a_sun_has_at_least_half_of_the_visible_light() {
    let scene = scene(|x, y| match (x, y) {
        (60..=61, 32..=33) => [1.0; 3],
        (_, 64..) => [0.3; 3],
        _ => [0.3, 0.45, 0.7],
    });
    assert_eq!(scene.suns, [1.0]);
    let count = scene.cells.len() as f64;
    for (predicted, wanted) in [(0.01, 0.5), (0.49, 0.5), (0.51, 0.51), (1.7, 1.7)] {
        let cells = vec![predicted * scene.open_flux / count; scene.cells.len()];
        let hidden = Hidden { cells, disagreement: vec![0.0] }.with_suns(&scene);
        let sum: f64 = hidden.cells.iter().sum();
        assert!((sum / scene.open_flux - wanted).abs() < 1e-9, "{predicted}: {}", sum / scene.open_flux);
    }
}
