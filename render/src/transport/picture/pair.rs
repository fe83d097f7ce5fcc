//! Tracing of pixels: the change of the receiver due to the objects, and the objects themselves.

use glam::Vec3;

use super::camera_rays::CameraRays;
use super::crop::Crop;
use super::film::PAIR;
use super::film::R0;
use super::film::TileSums;
use super::r0::first_vertices;
use super::sums::{add, squared_luminance};
use super::tile::{Sample, Tile, TileSampling};
use super::tile_bounds::TileBounds;
use crate::geometry::bvh::{Hit, Ray, Steps};
use crate::transport::path::change::{ChangeSampling, estimates_change, is_paired, rays_towards};
use crate::transport::path::first_vertex::FirstVertex;
use crate::transport::path::integrator::{Integrator, Pass, Scene};
use crate::transport::path::path::Vertex;
use crate::transport::path::rays::Rays;
use crate::transport::scene::receiver::Receiver;

/// Index of the pair of sample dimensions that decides the coverage of blended surfaces for camera rays.
pub(crate) const BLENDED: u32 = 5 << 17;

/// A tile whose pixels are traced with the objects.
pub struct PairTile<'a> {
    /// Image coordinates of the pixels.
    pub pixels: &'a [(u32, u32)],
    /// Range of samples.
    pub range: (u32, u32),
    /// Sums of the same pixels and samples without objects.
    pub r0: &'a [f32],
    /// Bounds of the points of the tile.
    pub bounds: TileBounds,
}

/// Traces the receiver with the objects, and the objects themselves, over a tile. Only the change is traced, and
/// added to the sums without objects. If `crop` finds that the change is small enough to be left out, it is not
/// traced. `traced` contains the camera hits of the tile and its first vertices under near light, if they are
/// already traced. The sums and counts do not depend on this: rays that the receiver alone needs too are not
/// counted.
pub fn trace_pair(
    scene: Scene<'_>,
    camera_rays: &CameraRays<'_>,
    crop: Option<&Crop>,
    tile: &PairTile<'_>,
    traced: Option<(Tile<'_>, Vec<FirstVertex>)>,
) -> TileSums {
    let PairTile { pixels, range, r0, bounds } = *tile;
    let mut sums_of_tile = TileSums::with_room(pixels.len() * PAIR);
    let objects = scene.objects;
    let Some((low, high)) = objects.bvh.bounds() else {
        // Without objects no ray is cast.
        for known in r0.chunks_exact(R0) {
            let mut sums = [0.0; PAIR];
            sums[..3].copy_from_slice(&rgb(known));
            sums_of_tile.push(&sums);
        }
        sums_of_tile.untouched = pixels.len() as u64;
        return sums_of_tile;
    };
    if let Some(bound) = crop.and_then(|crop| crop.bound(&scene, &bounds, camera_rays.ground.max_shift())) {
        let cropped = (!bounds.is_empty()).then_some(bound);
        return TileSums { cropped, ..trace_objects(scene, camera_rays, tile) };
    }
    let (tile, firsts) = traced.unwrap_or_else(|| {
        let tile = Steps::uncounted(|| Tile::new(scene, camera_rays, pixels, range));
        let firsts = first_vertices(scene, &tile);
        (tile, firsts)
    });
    let mut firsts = firsts.iter();
    let rays = rays_towards(&scene);
    let place = |s: &Sample| {
        let hit = s.hit?;
        let shift = shift(&scene, camera_rays, &hit, s.ray);
        Some((s.ray.origin + s.ray.direction * (hit.t + shift), hit, shift))
    };
    // Under near light, and for glossy receivers, whole paths are traced.
    let far = !is_paired(&scene);
    let tile_sampling =
        if far { tile.change_sampling(tile.samples.iter().filter_map(|s| Some(place(s)?.0))) } else { None };
    let distributions = if far && tile_sampling.is_none() { tile.distributions() } else { None };
    let (distributions, lights, probability) = match &tile_sampling {
        Some(TileSampling { distributions, lights, probability }) => {
            (Some(distributions.each_ref()), Some(*lights), *probability)
        }
        None => (distributions.as_ref().map(|distributions| distributions.each_ref()), None, 1.0),
    };
    let first = |sample: &Sample| {
        let hit = sample.hit.filter(|_| far && estimates_change(&sample.points, probability))?;
        Some((sample.points, hit))
    };
    let mut draws = tile.first_draws(distributions, lights, tile.samples.iter().map(first));
    let samples = tile.samples.chunks_exact((range.1 - range.0) as usize);
    for ((samples, pixel), without) in samples.zip(pixels).zip(r0.chunks_exact(R0)) {
        let mut sums = [0.0; PAIR];
        let mut change = [0.0; 3];
        let mut touched = false;
        let shows = camera_rays.may_show(objects, *pixel);
        for sample in samples {
            let (ray, landed, drawn) = (sample.ray, place(sample), draws.next_vertex());
            let reach = landed.map_or(f32::INFINITY, |(_, hit, shift)| hit.t + shift);
            if shows {
                show(scene, camera_rays, sample, |_| reach, &mut sums, &mut sums_of_tile);
            }
            let Some((start, hit, shift)) = landed else { continue };
            let known = firsts.next();
            let mut integrator = Integrator::new(scene, sample.key, Pass::new(sample.points, true));
            let lift = ray.direction * shift;
            let reach = ChangeSampling { drawn, known, probability, start, objects: [low, high], rays, lift };
            let light = integrator.change(hit, ray, &reach);
            sums_of_tile.rays += integrator.tally.rays;
            touched |= light != Vec3::ZERO;
            if add(&mut change, light, &mut sums_of_tile.broken) {
                sums[3] += squared_luminance(light);
            }
        }
        for (k, known) in rgb(without).into_iter().enumerate() {
            // Rounded as `known` is, so that fully blocked light leaves exactly 0.
            sums[k] = (known + f64::from(change[k] as f32)).max(0.0);
        }
        sums_of_tile.untouched += u64::from(!touched);
        for k in [3, 8] {
            sums[k] = sums[k].sqrt();
        }
        sums_of_tile.push(&sums);
    }
    sums_of_tile
}

/// Traces only the objects, over pixels for which the change of the receiver is cropped.
fn trace_objects(
    scene: Scene<'_>,
    camera_rays: &CameraRays<'_>,
    &PairTile { pixels, range, r0, .. }: &PairTile<'_>,
) -> TileSums {
    let mut sums_of_tile =
        TileSums { untouched: pixels.len() as u64, ..TileSums::with_room(pixels.len() * PAIR) };
    for (&pixel, without) in pixels.iter().zip(r0.chunks_exact(R0)) {
        let mut sums = [0.0; PAIR];
        sums[..3].copy_from_slice(&rgb(without));
        let shows = camera_rays.may_show(scene.objects, pixel);
        for number in if shows { range.0..range.1 } else { 0..0 } {
            let (points, key, ray) = camera_rays.sample(pixel, number);
            let sample = Sample { points, key, ray, hit: None };
            let reach = |rays: &mut Rays| {
                rays.camera += 1;
                let landed = scene.camera_hit(ray);
                landed.map_or(f32::INFINITY, |hit| hit.t + shift(&scene, camera_rays, &hit, ray))
            };
            show(scene, camera_rays, &sample, reach, &mut sums, &mut sums_of_tile);
        }
        sums[8] = sums[8].sqrt();
        sums_of_tile.push(&sums);
    }
    sums_of_tile
}

/// Adds the light of the objects in a sample. `reach` computes the distance beyond which the receiver hides them.
fn show(
    scene: Scene<'_>,
    camera_rays: &CameraRays<'_>,
    sample: &Sample,
    reach: impl FnOnce(&mut Rays) -> f32,
    sums: &mut [f64; PAIR],
    of_tile: &mut TileSums,
) {
    let (ray, objects) = (sample.ray, scene.objects);
    let front = objects.front(ray, sample.points.bits(BLENDED)[0], &mut of_tile.rays.camera);
    let before = |front: &Hit| front.t - objects.slack(front, ray.direction);
    let front = front.filter(|(front, _)| before(front) <= reach(&mut of_tile.rays));
    let Some((front, behind_back)) = front else { return };
    let pass = Pass { spread: camera_rays.spread, ..Pass::new(sample.points, true) };
    let mut integrator = Integrator::new(scene, sample.key, pass);
    let light = integrator.radiance(Vertex::Object(front), ray);
    of_tile.rays += integrator.tally.rays;
    let cut = integrator.tally.cut;
    // Inside a shape that is inside out there is no light, however long the paths are.
    of_tile.behind += u64::from(behind_back && (cut || light == Vec3::ZERO));
    of_tile.cut += u64::from(cut && !behind_back);
    if add(&mut sums[4..], light, &mut of_tile.broken) {
        sums[7] += 1.0;
        sums[8] += squared_luminance(light);
    }
}

/// RGB sums of a pixel without objects.
fn rgb(r0: &[f32]) -> [f64; 3] {
    std::array::from_fn(|k| f64::from(r0[k]))
}

impl Scene<'_> {
    /// Hit of a camera ray on the receiver.
    pub fn camera_hit(&self, ray: Ray) -> Option<Hit> {
        if self.rules.printed { None } else { self.receiver.bvh.closest(ray, |_| true) }
    }
}

/// Distance by which a camera hit on the receiver is moved along its ray to the support of an object.
pub(crate) fn shift(scene: &Scene<'_>, camera_rays: &CameraRays<'_>, hit: &Hit, ray: Ray) -> f32 {
    shift_on(scene.receiver, camera_rays, hit, ray)
}

/// As [`shift`], for a receiver without light.
pub(crate) fn shift_on(receiver: &Receiver, camera_rays: &CameraRays<'_>, hit: &Hit, ray: Ray) -> f32 {
    let position = ray.origin + ray.direction * hit.t;
    camera_rays.ground.shift(position, receiver.normal(hit.triangle), ray.direction)
}
