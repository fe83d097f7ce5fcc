//! Fewer splats and triangles that look alike, for the place view.

use glam::DVec3;
use scene::types::Splats;

use crate::surface::Surface;

/// Maximum factor by which the standard deviations of a splat are multiplied.
const MOST_LARGER: f32 = 4.0;
/// Part of the median distance from the middle of the capture within which splats count alike.
const NEAR: f64 = 0.25;

/// The middle of a capture, as the median of each coordinate, and the median distance from it.
fn middle(splats: &Splats) -> (DVec3, f64) {
    let means: Vec<DVec3> = (0..splats.len()).map(|index| splats.mean(index)).collect();
    let median = |mut values: Vec<f64>| {
        let at = values.len() / 2;
        *values.select_nth_unstable_by(at, f64::total_cmp).1
    };
    let centre =
        DVec3::from_array([0, 1, 2].map(|axis| median(means.iter().map(|mean| mean[axis]).collect())));
    (centre, median(means.iter().map(|mean| mean.distance(centre)).collect()))
}

/// The weight of each splat: its opacity times the square root of the solid angle of its largest cross-section, as
/// seen from the middle of the capture. With the area instead, the large splats of the surroundings would leave few
/// splats for the ground on which objects stand; with the opacity alone, the surroundings would dissolve.
fn weights(splats: &Splats) -> Vec<f64> {
    let (centre, radius) = middle(splats);
    // Splats that are nearer to the middle than this count alike.
    let near = if radius > 0.0 { NEAR * radius } else { 1.0 };
    let weight = |index: usize| {
        let [a, b, c] = splats.scales[index].map(f64::from);
        let area = (a * b).max(b * c).max(c * a);
        let away = (splats.mean(index).distance_squared(centre) + near * near).sqrt();
        f64::from(splats.opacities[index]) * area.sqrt() / away
    };
    (0..splats.len()).map(weight).collect()
}

/// Chooses about `most` splats. Returns the index of each, and the factor for its standard deviations. A splat is
/// kept with a probability proportional to its weight, at most 1, and enlarged so that the expected sum of opacity
/// times area stays the same (Cook, Halstead, Planck, Ryu 2007, "Stochastic Simplification of Aggregate Detail").
/// The choice is systematic in file order: the running sum of probabilities passes a whole number.
pub fn sampled(splats: &Splats, most: usize) -> Vec<(usize, f32)> {
    let count = splats.len();
    if count <= most {
        return (0..count).map(|index| (index, 1.0)).collect();
    }
    let weights = weights(splats);
    let scale = scale(&weights, most);
    let (mut sum, mut chosen) = (0.5, Vec::with_capacity(most + 1));
    for (index, weight) in weights.iter().enumerate() {
        let probability = (weight * scale).min(1.0);
        let next = sum + probability;
        if next.floor() > f64::floor(sum) && chosen.len() < most {
            chosen.push((index, (1.0 / probability.sqrt()).min(f64::from(MOST_LARGER)) as f32));
        }
        sum = next;
    }
    chosen
}

/// The factor for which the sum of `min(1, weight * factor)` is `most`, by bisection; a little less if the weights
/// are nearly all 0.
fn scale(weights: &[f64], most: usize) -> f64 {
    let sum = |scale: f64| weights.iter().map(|weight| (weight * scale).min(1.0)).sum::<f64>();
    let largest = weights.iter().copied().fold(0.0, f64::max);
    if largest <= 0.0 {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, 1.0 / largest);
    for _ in 0..200 {
        if sum(high) >= most as f64 {
            break;
        }
        (low, high) = (high, high * 2.0);
    }
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if sum(middle) < most as f64 { low = middle } else { high = middle }
    }
    low
}

/// Merges the vertices in each cell of a grid until at most `most` triangles are left (Rossignac and Borrel 1993,
/// "Multi-resolution 3D approximations for rendering complex scenes"). Normals follow from the triangles.
pub fn clustered(surface: &Surface, most: usize) -> Surface {
    let low = surface.positions.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = surface.positions.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let size = (high - low).max_element().max(1e-30);
    let mut cells = 1024.0;
    loop {
        let merged = merged(surface, low, cells / size);
        if merged.triangles.len() <= most || cells < 2.0 {
            return merged;
        }
        cells *= 0.8;
    }
}

fn merged(surface: &Surface, low: DVec3, per_unit: f64) -> Surface {
    let cell = |point: DVec3| ((point - low) * per_unit).to_array().map(|v| v as u32);
    let keys: Vec<[u32; 3]> = surface.positions.iter().map(|point| cell(*point)).collect();
    let mut order: Vec<u32> = (0..keys.len() as u32).collect();
    order.sort_by_key(|&vertex| keys[vertex as usize]);
    let mut out = Surface::default();
    let mut place = vec![0; keys.len()];
    for group in order.chunk_by(|a, b| keys[*a as usize] == keys[*b as usize]) {
        let count = group.len() as f64;
        let sum: DVec3 = group.iter().map(|&vertex| surface.positions[vertex as usize]).sum();
        group.iter().for_each(|&vertex| place[vertex as usize] = out.positions.len() as u32);
        out.positions.push(sum / count);
        out.colours.push(surface.colours[group[0] as usize]);
    }
    let corners = surface.triangles.iter().map(|corners| corners.map(|vertex| place[vertex as usize]));
    out.triangles = corners.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    out.triangles.sort_unstable();
    out.triangles.dedup();
    out
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    /// Splats at the distance 5 from the origin in four directions, as (size, additional distance).
    fn ring(splats: &[(f32, f32)]) -> Splats {
        let n = splats.len();
        let at = |(i, (_, out)): (usize, &(f32, f32))| {
            let away = 5.0 + out;
            [[away, 0.0, 0.0], [-away, 0.0, 0.0], [0.0, away, 0.0], [0.0, -away, 0.0]][i % 4]
        };
        Splats {
            means: splats.iter().enumerate().map(at).collect(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
            scales: splats.iter().map(|&(size, _)| [size; 3]).collect(),
            opacities: vec![0.5; n],
            sh: vec![[0.0; 3]; n],
            ..Splats::empty()
        }
    }

    /// The expected area stays the same. This test fails if splats are not enlarged.
    #[test]
    fn fewer_splats_cover_the_same_area() {
        let sizes: Vec<f32> = (0..10_000).map(|i| if i % 100 == 0 { 1.0 } else { 0.05 }).collect();
        let capture = ring(&sizes.iter().map(|&size| (size, 0.0)).collect::<Vec<_>>());
        let chosen = sampled(&capture, 1_000);
        assert!((990..=1_000).contains(&chosen.len()), "{}", chosen.len());
        let large = chosen.iter().filter(|(index, _)| index % 100 == 0);
        assert!(large.clone().count() == 100 && large.clone().all(|(_, larger)| *larger == 1.0));
        let area = |(index, larger): &(usize, f32)| sizes[*index] * sizes[*index] * larger * larger;
        let (before, after) =
            (sizes.iter().map(|s| s * s).sum::<f32>(), chosen.iter().map(area).sum::<f32>());
        assert!((after / before - 1.0).abs() < 0.02, "{before} {after}");
        assert_eq!(sampled(&capture, 10_000).len(), 10_000);
        assert!(sampled(&ring(&[(0.0, 0.0); 8]), 4).is_empty(), "splats without area are not seen");
    }

    /// This test fails if the weight is the area.
    #[test]
    fn the_middle_of_a_capture_keeps_its_detail() {
        // 9,000 small splats, and 1,000 large ones far away, which seen from the middle are as large.
        let all: Vec<(f32, f32)> =
            (0..10_000).map(|i| if i * 617 % 1009 < 101 { (1.0, 95.0) } else { (0.05, 0.0) }).collect();
        let chosen = sampled(&ring(&all), 2_000);
        let small = chosen.iter().filter(|(index, _)| all[*index].0 < 1.0).count();
        assert!((1_700..=1_900).contains(&small), "{small} of {}", chosen.len());
    }

    #[test]
    fn a_fine_mesh_becomes_coarse_and_keeps_its_shape() {
        let side = 64_u32;
        let mut fine = Surface::default();
        for y in 0..side {
            for x in 0..side {
                fine.positions.push(DVec3::new(f64::from(x), f64::from(y), 0.0));
                fine.colours.push([x as u8, y as u8, 0, 255]);
                if x > 0 && y > 0 {
                    let at = y * side + x;
                    fine.triangles.extend([[at - side - 1, at - side, at], [at - side - 1, at, at - 1]]);
                }
            }
        }
        let coarse = clustered(&fine, 1_000);
        assert!((200..=1_000).contains(&coarse.triangles.len()), "{}", coarse.triangles.len());
        let area = |surface: &Surface| {
            let one = |[a, b, c]: &[u32; 3]| {
                let [a, b, c] = [a, b, c].map(|v| surface.positions[*v as usize]);
                (b - a).cross(c - a).z * 0.5
            };
            surface.triangles.iter().map(one).sum::<f64>()
        };
        let (before, after) = (area(&fine), area(&coarse));
        assert!(after > 0.85 * before && after <= before + 1e-9, "{before} {after}");
    }
}
