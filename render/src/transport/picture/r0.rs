//! Tracing of pixels: the receiver alone.

use glam::Vec3;

use super::film::R0;
use super::film::TileSums;
use super::sums::{add, squared_luminance};
use super::tile::{Sample, Tile};
use super::tile_bounds::TileBounds;
use crate::geometry::bvh::{Hit, Steps};
use crate::transport::path::first_vertex::FirstVertex;
use crate::transport::path::integrator::{Integrator, Pass, Scene};
use crate::transport::path::path::Vertex;
use crate::transport::path::rays::Rays;
use crate::transport::path::receiver_paths::{ReceiverPaths, TOGETHER};

/// Traces the receiver without the objects, over a tile with `each` samples per pixel. Under near light, also
/// returns the first vertices of the samples that show the receiver, in order, unless a part of it is glossy.
pub fn trace_r0(scene: Scene<'_>, tile: &Tile<'_>, each: usize) -> (TileSums, Vec<FirstVertex>) {
    let mut sums_of_tile = TileSums::with_room(tile.samples.len() / each.max(1) * R0);
    let (lights, firsts) = match scene.receiver.is_glossy() {
        true => (glossy_light(scene, tile, &mut sums_of_tile.rays), Vec::new()),
        false => matte_light(scene, tile, &mut sums_of_tile.rays),
    };
    sums_of_tile.rays.camera += tile.samples.len() as u64;
    for lights in lights.chunks_exact(each) {
        let mut sums = [0.0; R0];
        for &light in lights {
            if add(&mut sums, light, &mut sums_of_tile.broken) {
                sums[3] += squared_luminance(light);
            }
        }
        sums[3] = sums[3].sqrt();
        sums_of_tile.push(&sums);
    }
    let hits: Vec<Option<Hit>> = tile.samples.iter().map(|sample| sample.hit).collect();
    let light = sums_of_tile.sums.chunks_exact(R0).map(|sums| Vec3::new(sums[0], sums[1], sums[2]));
    sums_of_tile.bounds = Some(TileBounds::of(scene.receiver, light.zip(hits.chunks_exact(each))));
    (sums_of_tile, firsts)
}

/// Light of the samples of a tile, if a part of the receiver is glossy. Each path is traced alone.
fn glossy_light(scene: Scene<'_>, tile: &Tile<'_>, rays: &mut Rays) -> Vec<Vec3> {
    let light = |sample: &Sample| match sample.hit {
        None => scene.sky.background(sample.ray.direction),
        Some(hit) => {
            let mut integrator = Integrator::new(scene, sample.key, Pass::new(sample.points, false));
            let light = integrator.radiance(Vertex::Receiver(hit), sample.ray);
            *rays += integrator.tally.rays;
            light
        }
    };
    tile.samples.iter().map(light).collect()
}

/// Light of the samples of a tile, if the receiver is matte. Paths are traced many at once. Under near light, also
/// returns the first vertices of the samples that show the receiver, in order.
fn matte_light(scene: Scene<'_>, tile: &Tile<'_>, rays: &mut Rays) -> (Vec<Vec3>, Vec<FirstVertex>) {
    let distributions = tile.distributions();
    let distributions = distributions.as_ref().map(|distributions| distributions.each_ref());
    // Near light is sampled differently.
    let far = scene.rules.near.is_none();
    let first = |sample: &Sample| Some((sample.points, sample.hit.filter(|_| far)?));
    let mut draws = tile.first_draws(distributions, None, tile.samples.iter().map(first));
    let mut paths = ReceiverPaths::new(scene).guided(tile.guide);
    let mut firsts = Vec::with_capacity(if far { 0 } else { tile.samples.len() });
    let mut lights = Vec::with_capacity(tile.samples.len());
    for samples in tile.samples.chunks(TOGETHER) {
        for sample in samples {
            let drawn = draws.next_vertex();
            if let Some(hit) = &sample.hit {
                paths.push(sample.points, hit, drawn);
            }
        }
        let mut found = paths.radiance().iter().copied();
        lights.extend(samples.iter().map(|sample| match sample.hit {
            Some(_) => found.next().unwrap_or_default(),
            None => scene.sky.background(sample.ray.direction),
        }));
        firsts.extend_from_slice(paths.firsts());
    }
    *rays += paths.rays;
    (lights, firsts)
}

/// First vertices, under near light, of the samples of a tile that show the receiver, in order. Their light is not
/// traced. Rays are not counted, since `trace_r0` casts and counts the same rays.
pub(crate) fn first_vertices(scene: Scene<'_>, tile: &Tile<'_>) -> Vec<FirstVertex> {
    if scene.rules.near.is_none() || scene.receiver.is_glossy() {
        return Vec::new();
    }
    Steps::uncounted(|| {
        let mut paths = ReceiverPaths::new(scene);
        let mut firsts = Vec::with_capacity(tile.samples.len());
        for samples in tile.samples.chunks(TOGETHER) {
            for (sample, hit) in samples.iter().filter_map(|sample| Some((sample, sample.hit?))) {
                paths.push(sample.points, &hit, &[]);
            }
            firsts.extend_from_slice(paths.only_firsts());
        }
        firsts
    })
}
