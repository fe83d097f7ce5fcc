//! Connected parts of a view in which splats and mesh disagree: floating debris of the mesh, and surfaces that the
//! mesh lacks.

use glam::DVec3;

use super::sight::{STEP, Sight};
use super::spots::Spots;

/// Minimum relative difference of depth between two surfaces for one to count as in front of the other.
const APART: f64 = 0.12;
/// Maximum distance outside the bounding box of the mesh at which a surface can still count as missing, as a share
/// of the distance from the eye to the surface.
const MARGIN: f64 = 0.02;
/// Depth of the mesh, as a multiple of the depth of the near plane, up to which splats at the same place may be cut by
/// the near plane.
const CLIPPED: f64 = 1.5;
/// A part of the mesh counts as floating if the mesh next to it is farther away along at least this share of its
/// outline.
const FLOATS: f64 = 0.65;

/// Distance, as a multiple of [`Spots::grain`], up to which splats show a surface beyond its edge, since they are
/// blurred: two and a half standard deviations.
const BEYOND: f64 = 1.25;
/// Maximum of this distance in pixels.
const BEYOND_PX: usize = 24;

/// Parts of the views in which splats and mesh disagree.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Regions {
    /// Share of the pixels that the parts cover, in the view where this share is largest. The views around the
    /// objects count as one view.
    pub share: f64,
    /// Name of the view to which `share` refers; empty for the views around the objects.
    pub view: String,
    /// Middle of the largest part, in world coordinates.
    pub at: DVec3,
    /// Distance of the largest part from the eye, in world units.
    pub distance: f64,
}

/// A connected part of one view in which splats and mesh disagree.
struct Component {
    pixels: Vec<usize>,
    /// Number of pixels of the part whose eight neighbours are also in the part.
    inner: usize,
    sight: usize,
}

/// Connected parts of the marked pixels of a view. Two neighbouring pixels are connected if their depths are
/// similar.
fn parts(sight: &Sight, index: usize, marked: &[bool], depth: &[f64]) -> Vec<Component> {
    let (width, height) = sight.size();
    let mut label = vec![usize::MAX; marked.len()];
    let mut found: Vec<Component> = Vec::new();
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
        found.push(Component { pixels, inner, sight: index });
    }
    found
}

/// The pixels to the left, to the right, above and below; `None` for those outside the picture.
fn neighbours(pixel: usize, width: usize, height: usize) -> [Option<usize>; 4] {
    let (x, y) = (pixel % width, pixel / width);
    [
        (x > 0).then(|| pixel - 1),
        (x + 1 < width).then(|| pixel + 1),
        (y > 0).then(|| pixel - width),
        (y + 1 < height).then(|| pixel + width),
    ]
}

/// Summarizes the parts: finds the view in which the parts cover the largest share of the pixels, and the largest
/// part in this view. All views around the objects count as one view.
fn summary(sights: &[Sight], parts: &[Component], depths: impl Fn(usize, usize) -> f64) -> Regions {
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

/// True for each pixel of each view that belongs to one of the parts.
fn pixels(sights: &[Sight], parts: &[Component]) -> Vec<Vec<bool>> {
    let mut marked: Vec<Vec<bool>> = sights.iter().map(|sight| vec![false; sight.depth.len()]).collect();
    for part in parts {
        part.pixels.iter().for_each(|&pixel| marked[part.sight][pixel] = true);
    }
    marked
}

/// Finds parts of the mesh that float in front of the surfaces that the splats show: along most of their outline,
/// the mesh next to them is farther away. A part that closes a window or a hole of the capture does not float,
/// since it is connected to its surroundings. Also returns, for each view, the pixels of these parts.
pub(super) fn debris(
    sights: &[Sight],
    depths: &[Vec<f64>],
    spots: &Spots,
    tolerance: f64,
) -> (Regions, Vec<Vec<bool>>) {
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
            // Splats before the near plane are not drawn, so nothing is known about the mesh there.
            let is_drawn = own > CLIPPED * sight.near;
            own.is_finite() && is_drawn && ((sight.clear[pixel] && before()) || sight.empty[pixel])
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
    (summary(sights, &floating, |sight, pixel| depths[sight][pixel]), pixels(sights, &floating))
}

/// Finds surfaces of the splats within the bounding box `[low, high]` of the mesh where the mesh has no surface or
/// only a surface farther from the eye. Also returns, for each view, the pixels of these surfaces.
pub(super) fn missing(
    sights: &[Sight],
    depths: &[Vec<f64>],
    spots: &Spots,
    [low, high]: [DVec3; 2],
    tolerance: f64,
) -> (Regions, Vec<Vec<bool>>) {
    let mut lacking = Vec::new();
    let mut usable: Vec<Vec<bool>> = sights.iter().map(|sight| vec![false; sight.depth.len()]).collect();
    spots.list.iter().for_each(|spot| usable[spot.sight][spot.pixel] = true);
    for (index, (sight, mesh)) in sights.iter().zip(depths).enumerate() {
        let (width, height) = sight.size();
        // True if the mesh has the surface right next to the pixel, and the splats show it beyond its edge.
        let is_beyond_an_edge = |pixel: usize, apart: f64| {
            let (splats, stretch) = (sight.depth[pixel], sight.ray(pixel).length());
            let reach = (BEYOND * spots.grain * sight.camera.fx / splats) as usize;
            let (reach, x, y) = (reach.min(BEYOND_PX), pixel % width, pixel / width);
            let rows = y.saturating_sub(reach)..(y + reach + 1).min(height);
            let columns = x.saturating_sub(reach)..(x + reach + 1).min(width);
            rows.flat_map(|row| columns.clone().map(move |column| row * width + column))
                .any(|other| (mesh[other] - splats).abs() * stretch <= apart)
        };
        let lacks = |pixel: usize| {
            let (own, splats) = (mesh[pixel], sight.depth[pixel]);
            let ray = sight.ray(pixel);
            let far = (splats * ray.length()).max(spots.distance);
            // The distance along the ray to a slanted surface is longer than the distance along its normal.
            let cosine = sight.normal(pixel).map_or(0.5, |normal| normal.dot(ray).abs() / ray.length());
            let least = (2.0 * tolerance * far).max(1.5 * spots.grain);
            let behind = own > splats * (1.0 + APART) && (own - splats) * ray.length() * cosine > least;
            let point = sight.point(pixel, splats);
            let margin = MARGIN * far;
            usable[index][pixel]
                && behind
                && point.cmpge(low - DVec3::splat(margin)).all()
                && point.cmple(high + DVec3::splat(margin)).all()
                && !is_beyond_an_edge(pixel, least)
        };
        let marked: Vec<bool> = (0..mesh.len()).map(lacks).collect();
        let own = parts(sight, index, &marked, &sight.depth);
        // Parts with few inner pixels are edges or thin, and are ignored.
        lacking.extend(own.into_iter().filter(|part| part.inner * 3 >= part.pixels.len()));
    }
    (summary(sights, &lacking, |sight, pixel| sights[sight].depth[pixel]), pixels(sights, &lacking))
}
