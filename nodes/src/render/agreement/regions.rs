//! Connected parts of a view in which splats and mesh disagree: debris of the mesh, and surfaces that it lacks.

use glam::DVec3;

use super::sight::{STEP, Sight};
use super::spots::Spots;

/// Relative difference of depths from which a surface is in front of another or behind it.
const APART: f64 = 0.12;
/// Distance beyond the extents of the mesh up to which a surface is missing, as a share of the distance.
const MARGIN: f64 = 0.02;
/// Share of the outline of a part along which the mesh ends in front of something, from which it floats.
const FLOATS: f64 = 0.65;

/// Parts of the views in which splats and mesh disagree.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Regions {
    /// Largest share of the pixels of a view, or of the views around the object, that they cover.
    pub share: f64,
    /// The view, or empty for the views around the object.
    pub view: String,
    /// Middle of the largest part, in world units.
    pub at: DVec3,
    /// Distance of that part from the eye, in world units.
    pub distance: f64,
}

/// A part of one view.
struct Part {
    pixels: Vec<usize>,
    /// Number of pixels whose eight neighbours are in the part as well.
    inner: usize,
    sight: usize,
}

/// Connected parts of the marked pixels whose depths are continuous.
fn parts(sight: &Sight, index: usize, marked: &[bool], depth: &[f64]) -> Vec<Part> {
    let (width, height) = sight.size();
    let mut label = vec![usize::MAX; marked.len()];
    let mut found: Vec<Part> = Vec::new();
    for start in 0..marked.len() {
        if !marked[start] || label[start] != usize::MAX {
            continue;
        }
        let number = found.len();
        label[start] = number;
        let mut pixels = vec![start];
        let mut next = 0;
        while next < pixels.len() {
            let pixel = pixels[next];
            next += 1;
            for other in neighbours(pixel, width, height).into_iter().flatten() {
                let joined = (depth[other] - depth[pixel]).abs() <= STEP * depth[pixel].min(depth[other]);
                if marked[other] && label[other] == usize::MAX && joined {
                    label[other] = number;
                    pixels.push(other);
                }
            }
        }
        let inside = |&&pixel: &&usize| {
            let (x, y) = (pixel % width, pixel / width);
            let within = x > 0 && y > 0 && x + 1 < width && y + 1 < height;
            within && (0..9).all(|k| label[pixel + (k % 3) + (k / 3) * width - width - 1] == number)
        };
        let inner = pixels.iter().filter(inside).count();
        found.push(Part { pixels, inner, sight: index });
    }
    found
}

/// The pixels left, right, above and below.
fn neighbours(pixel: usize, width: usize, height: usize) -> [Option<usize>; 4] {
    let (x, y) = (pixel % width, pixel / width);
    [
        (x > 0).then(|| pixel - 1),
        (x + 1 < width).then(|| pixel + 1),
        (y > 0).then(|| pixel - width),
        (y + 1 < height).then(|| pixel + width),
    ]
}

/// Largest share of a view, or of all views around the object, that the parts cover.
fn summary(sights: &[Sight], parts: &[Part], depths: impl Fn(usize, usize) -> f64) -> Regions {
    let mut best = Regions::default();
    let mut groups: Vec<Vec<usize>> =
        (0..sights.len()).filter(|&i| sights[i].wanted).map(|index| vec![index]).collect();
    groups.push((0..sights.len()).filter(|&i| !sights[i].wanted).collect());
    for group in groups {
        let all: usize = group.iter().map(|&i| sights[i].depth.len()).sum();
        let own = || parts.iter().filter(|part| group.contains(&part.sight));
        let covered: usize = own().map(|part| part.pixels.len()).sum();
        let share = covered as f64 / all.max(1) as f64;
        let largest = own().reduce(|a, b| if b.pixels.len() > a.pixels.len() { b } else { a });
        if let Some(part) = largest.filter(|_| share > best.share) {
            let sight = &sights[part.sight];
            let points = part.pixels.iter().map(|&pixel| sight.point(pixel, depths(part.sight, pixel)));
            let at = points.sum::<DVec3>() / part.pixels.len() as f64;
            let view = if sight.wanted { sight.camera.name.clone() } else { String::new() };
            best = Regions { share, view, at, distance: (at - sight.camera.eye()).length() };
        }
    }
    best
}

/// Parts of the mesh in front of what the splats show, that float: along most of their outline the mesh behind is
/// farther off. What closes a window or a hole of the capture is joined to its surroundings.
pub(super) fn debris(sights: &[Sight], depths: &[Vec<f64>], spots: &Spots, tolerance: f64) -> Regions {
    let mut floating = Vec::new();
    for (index, (sight, mesh)) in sights.iter().zip(depths).enumerate() {
        let in_front = |pixel: usize| {
            let (own, splats) = (mesh[pixel], sight.depth[pixel]);
            let stretch = sight.ray(pixel).length();
            let far = (splats * stretch).max(spots.distance);
            let before = || {
                own < splats * (1.0 - APART)
                    && (splats - own) * stretch > (2.0 * tolerance * far).max(1.5 * spots.grain)
            };
            own.is_finite() && ((sight.clear[pixel] && before()) || sight.empty[pixel])
        };
        let marked: Vec<bool> = (0..mesh.len()).map(in_front).collect();
        let (width, height) = sight.size();
        for part in parts(sight, index, &marked, mesh).into_iter().filter(|part| part.inner > 0) {
            let (mut ends, mut joined) = (0_usize, 0_usize);
            for &pixel in &part.pixels {
                for other in neighbours(pixel, width, height).into_iter().flatten() {
                    let change = mesh[other] / mesh[pixel] - 1.0;
                    if change > STEP {
                        ends += 1;
                    } else if change >= -STEP && !marked[other] {
                        joined += 1;
                    }
                }
            }
            if ends as f64 >= FLOATS * (ends + joined).max(1) as f64 {
                floating.push(part);
            }
        }
    }
    summary(sights, &floating, |sight, pixel| depths[sight][pixel])
}

/// Surfaces of the splats within the extents of the mesh where it has nothing, or only something behind.
pub(super) fn missing(
    sights: &[Sight],
    depths: &[Vec<f64>],
    spots: &Spots,
    [low, high]: [DVec3; 2],
    tolerance: f64,
) -> Regions {
    let mut lacking = Vec::new();
    let mut usable: Vec<Vec<bool>> = sights.iter().map(|sight| vec![false; sight.depth.len()]).collect();
    spots.list.iter().for_each(|spot| usable[spot.sight][spot.pixel] = true);
    for (index, (sight, mesh)) in sights.iter().zip(depths).enumerate() {
        let lacks = |pixel: usize| {
            let (own, splats) = (mesh[pixel], sight.depth[pixel]);
            let ray = sight.ray(pixel);
            let far = (splats * ray.length()).max(spots.distance);
            // A surface seen at a slant is farther away along the ray than along its normal.
            let cosine = sight.normal(pixel).map_or(0.5, |normal| normal.dot(ray).abs() / ray.length());
            let least = (2.0 * tolerance * far).max(1.5 * spots.grain);
            let behind = own > splats * (1.0 + APART) && (own - splats) * ray.length() * cosine > least;
            let point = sight.point(pixel, splats);
            let margin = MARGIN * far;
            usable[index][pixel]
                && behind
                && point.cmpge(low - DVec3::splat(margin)).all()
                && point.cmple(high + DVec3::splat(margin)).all()
        };
        let marked: Vec<bool> = (0..mesh.len()).map(lacks).collect();
        let own = parts(sight, index, &marked, &sight.depth);
        // Edges and thin parts have few pixels inside.
        lacking.extend(own.into_iter().filter(|part| part.inner * 3 >= part.pixels.len()));
    }
    summary(sights, &lacking, |sight, pixel| sights[sight].depth[pixel])
}
