//! Pairs of neighbouring points of similar orientation, whose colours are compared.

use std::collections::BTreeMap;

use glam::DVec3;
use render::geometry::sampling::hash;

use super::shading::{Point, Shading};

/// Largest distance between neighbours whose colours may differ by a shadow, as a fraction of the size of the
/// surroundings.
const NEAR: f64 = 0.16;
/// Largest distance between points that are compared for the falloff of lamps, as the same fraction.
const WIDE: f64 = 0.6;
/// Smallest cosine between the normals of two neighbours.
const ALIKE: f64 = 0.95;
/// Maximum number of pairs per point.
const PER_POINT: usize = 4;

/// Number of points among which each point looks for partners within [`WIDE`].
const TRIES: u32 = 64;

/// Indices of two points.
pub(super) type Pair = [u32; 2];

/// Pairs each point with up to four neighbours, chosen by a hash of the two indices so that all distances
/// within [`NEAR`] occur.
pub(super) fn neighbours(shading: &Shading) -> Vec<Pair> {
    let points = &shading.points;
    let reach = NEAR * shading.size;
    let cell = |position: DVec3| (position / reach).floor().to_array().map(|v| v as i64);
    let mut cells: BTreeMap<[i64; 3], Vec<u32>> = BTreeMap::new();
    for (index, point) in points.iter().enumerate() {
        cells.entry(cell(point.position)).or_default().push(index as u32);
    }
    let mut pairs = Vec::with_capacity(points.len() * PER_POINT);
    for (index, point) in points.iter().enumerate() {
        let [x, y, z] = cell(point.position);
        let mut near: Vec<(u32, u32)> = Vec::new();
        for step in 0..27 {
            let at = [x + step % 3 - 1, y + step / 3 % 3 - 1, z + step / 9 - 1];
            let others = cells.get(&at).into_iter().flatten().copied();
            let fits =
                |&other: &u32| other as usize != index && is_alike(point, &points[other as usize], reach);
            near.extend(others.filter(fits).map(|other| (hash(index as u32, other), other)));
        }
        let kept = PER_POINT.min(near.len());
        if kept < near.len() {
            near.select_nth_unstable(kept);
        }
        near.truncate(kept);
        near.sort_unstable();
        pairs.extend(near.into_iter().map(|(_, other)| [index as u32, other]));
    }
    pairs
}

/// Pairs each point with up to four points within [`WIDE`], among points chosen by a hash of its index.
pub(super) fn wide(shading: &Shading) -> Vec<Pair> {
    let points = &shading.points;
    let reach = WIDE * shading.size;
    let partners = |index: u32| {
        let point = &points[index as usize];
        let tries = (0..TRIES).map(move |i| hash(hash(index, i), 0x7769) % points.len() as u32);
        let fits = move |&other: &u32| other != index && is_alike(point, &points[other as usize], reach);
        tries.filter(fits).take(PER_POINT).map(move |other| [index, other])
    };
    (0..points.len() as u32).flat_map(partners).collect()
}

fn is_alike(a: &Point, b: &Point, reach: f64) -> bool {
    a.normal.dot(b.normal) > ALIKE && a.position.distance_squared(b.position) < reach * reach
}
