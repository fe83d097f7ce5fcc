//! Paths on the receiver alone, many at once.
//!
//! Without objects every vertex of a path is matte, and the same few steps follow each other. The paths of a batch
//! are therefore advanced together, one vertex at a time: the light samples of all of them are drawn together, so
//! that memory accesses overlap. Each path gets the same bits as from [`Integrator::radiance`].
//!
//! [`Integrator::radiance`]: super::integrator::Integrator::radiance

use glam::Vec3;

use super::direct_light::power_heuristic;
use super::first_vertex::FirstVertex;
use super::guide::Guide;
use super::integrator::{Scene, russian_roulette};
use super::near_draws::{MOST, NearDraws, NearSamples};
use super::near_field::NearFieldLight;
use super::path::first_pair;
use super::rays::Rays;
use crate::geometry::bvh::{Hit, Ray};
use crate::geometry::sampling::Points;
use crate::transport::bsdf::{Lobe, Matte};
use crate::transport::scene::block::Block;
use crate::transport::sky::environment::{DrawnDirection, LightSample};
use crate::transport::sky::light_draws::PlacedDraw;

/// Number of paths of a batch: enough to overlap memory accesses, few enough to stay in cache.
pub const TOGETHER: usize = 32;

/// A path, and its current vertex.
#[derive(Debug, Clone, Copy)]
struct ReceiverPath {
    points: Points,
    position: Vec3,
    matte: Matte,
    /// Offset of rays that leave the vertex.
    margin: f32,
    throughput: Vec3,
    /// Radiance of the path so far.
    light: Vec3,
}

/// Paths on the receiver alone.
#[derive(Debug)]
pub struct ReceiverPaths<'a> {
    scene: Scene<'a>,
    paths: Vec<ReceiverPath>,
    /// Indices of the paths that go on.
    alive: Vec<usize>,
    /// Samples of distant light at the current vertices of the paths in `alive`, stored path by path.
    lights: Vec<LightSample>,
    /// For each path in `alive`, the end of its samples in `lights`.
    ends: Vec<usize>,
    points: Vec<Points>,
    bits: Vec<[u32; 2]>,
    wanted: Vec<PlacedDraw<'a>>,
    /// Guide of the light samples after the first vertex, and of scattered rays.
    guide: Option<&'a Guide>,
    /// Samples of near light.
    near: Option<(NearFieldLight<'a>, NearDraws<'a>)>,
    found: Vec<Vec3>,
    /// First vertices of the paths under near light.
    firsts: Vec<FirstVertex>,
    /// Numbers of rays cast.
    pub rays: Rays,
}

impl ReceiverPath {
    /// Moves to a hit.
    fn move_to(&mut self, scene: &Scene<'_>, hit: &Hit) {
        let (position, normal, margin) = scene.receiver.geometry(hit);
        (self.position, self.margin) = (position, margin);
        self.matte = Matte::new(normal, scene.receiver.albedo_at(hit));
    }

    /// Ray that leaves the vertex.
    fn spawn_ray(&self, direction: Vec3) -> Ray {
        let normal = self.matte.normal();
        let side = self.margin.copysign(direction.dot(normal));
        Ray::new(self.position + normal * side, direction)
    }
}

impl<'a> ReceiverPaths<'a> {
    /// Creates an empty batch.
    pub fn new(scene: Scene<'a>) -> Self {
        let near = scene.near().map(|near| (near, NearDraws::new(near, near.lights(true), first_pair(0))));
        Self {
            scene,
            paths: Vec::with_capacity(TOGETHER),
            alive: Vec::with_capacity(TOGETHER),
            lights: Vec::new(),
            ends: Vec::new(),
            points: Vec::new(),
            bits: Vec::new(),
            wanted: Vec::new(),
            guide: None,
            near,
            found: Vec::new(),
            firsts: Vec::new(),
            rays: Rays::default(),
        }
    }

    /// Chooses light samples after the first vertex, and scattered rays, by a guide.
    pub(crate) fn guided(self, guide: Option<&'a Guide>) -> Self {
        Self { guide, ..self }
    }

    /// Adds a path that starts at a hit of a camera ray. `drawn` contains the light samples of its first vertex; it
    /// is not used under near light.
    pub fn push(&mut self, points: Points, hit: &Hit, drawn: &[DrawnDirection]) {
        let mut path = ReceiverPath {
            points,
            position: Vec3::ZERO,
            matte: Matte::new(Vec3::Z, Vec3::ZERO),
            margin: 0.0,
            throughput: Vec3::ONE,
            light: Vec3::ZERO,
        };
        path.move_to(&self.scene, hit);
        self.alive.push(self.paths.len());
        self.paths.push(path);
        self.lights.extend(drawn.iter().map(|drawn| self.scene.sky.light(drawn)));
        self.ends.push(self.lights.len());
    }

    /// Radiance along the camera ray of each path, in the order of [`push`](Self::push). Empties the batch.
    pub fn radiance(&mut self) -> &[Vec3] {
        self.advance(self.scene.rules.max_bounces);
        self.found.clear();
        self.found.extend(self.paths.iter().map(|path| path.light));
        for (first, light) in self.firsts.iter_mut().zip(&self.found) {
            first.light = Some(*light);
        }
        self.clear();
        &self.found
    }

    /// First vertices of the paths that were traced last, under near light.
    pub fn firsts(&self) -> &[FirstVertex] {
        &self.firsts
    }

    /// First vertices of the paths under near light. Paths that go on are not traced to their ends. Empties the
    /// batch.
    pub fn only_firsts(&mut self) -> &[FirstVertex] {
        self.advance(0);
        for (first, path) in self.firsts.iter_mut().zip(&self.paths) {
            first.light = Some(path.light);
        }
        if self.scene.rules.max_bounces > 0 {
            for &index in &self.alive {
                self.firsts[index].light = None;
            }
        }
        self.clear();
        &self.firsts
    }

    /// Advances the paths until they end, at the latest after `bounces` scatterings.
    fn advance(&mut self, bounces: u32) {
        self.firsts.clear();
        for bounce in 0..=bounces {
            if self.alive.is_empty() {
                break;
            }
            let mut alive = std::mem::take(&mut self.alive);
            match self.near.take() {
                Some(mut near) => {
                    self.advance_near(bounce, &mut near, &mut alive);
                    self.near = Some(near);
                }
                None => self.advance_far(bounce, &mut alive),
            }
            self.alive = alive;
        }
    }

    fn clear(&mut self) {
        self.paths.clear();
        self.alive.clear();
        self.lights.clear();
        self.ends.clear();
    }

    /// Draws one light sample for the current vertex of each path under distant light.
    fn draw(&mut self, bounce: u32, alive: &[usize]) {
        let sky = self.scene.sky;
        self.points.clear();
        self.points.extend(alive.iter().map(|&index| self.paths[index].points));
        self.bits.clear();
        sky.bits_each(&self.points, first_pair(bounce), &mut self.bits);
        self.wanted.clear();
        self.ends.clear();
        for (&index, bits) in alive.iter().zip(&self.bits) {
            let path = &self.paths[index];
            let normal = path.matte.normal();
            let distributions = match self.guide {
                Some(guide) => guide.distributions(sky, path.position, normal),
                None => sky.distributions(Some(normal)),
            };
            if distributions.iter().any(|distribution| distribution.power > 0.0) {
                let numbers = sky.numbers(distributions, None);
                let (tier, point) = sky.tier(numbers, *bits);
                let (distribution, number) = (distributions[tier], numbers[tier]);
                self.wanted.push(PlacedDraw { tier, distribution, number, point });
            }
            self.ends.push(self.wanted.len());
        }
        let lights = &mut self.lights;
        lights.clear();
        sky.draw_placed(&self.wanted, |drawn| lights.push(sky.light(&drawn)));
    }

    /// Gathers distant light at the current vertices, and moves the paths to the next ones. Paths that end are
    /// removed from `alive`.
    fn advance_far(&mut self, bounce: u32, alive: &mut Vec<usize>) {
        if bounce > 0 {
            self.draw(bounce, alive);
        }
        let (scene, rules) = (self.scene, self.scene.rules);
        let visibility = rules.visibility(Lobe::Diffuse);
        let lands = bounce < rules.max_bounces && visibility.lands;
        let guide = self.guide;
        let (mut start, mut ends) = (0, self.ends.iter());
        alive.retain(|&index| {
            let path = &mut self.paths[index];
            let end = ends.next().copied().unwrap_or(start);
            let mut lit = Vec3::ZERO;
            for light in &self.lights[start..end] {
                let scatter = path.matte.eval(light.direction);
                if light.radiance == Vec3::ZERO || scatter.value == Vec3::ZERO {
                    continue;
                }
                self.rays.shadow += u64::from(visibility.shadow != Block::Pass);
                if visibility.shadow.passes(scene.receiver, path.spawn_ray(light.direction)) {
                    lit += scatter.value * light.radiance / light.pdf;
                }
            }
            start = end;
            path.light += rules.clamped(bounce, path.throughput * lit);
            // Light samples find all light of the sky, so scattered rays only search for surfaces.
            if !lands {
                return false;
            }
            let pair = first_pair(bounce) + 1;
            let incident = guide.and_then(|guide| guide.incident(path.position, path.matte.normal()));
            let sampled = match incident {
                Some(incident) => incident.sample(&path.matte, &path.points, pair),
                None => path.matte.sample(&path.points, pair),
            };
            let Some((direction, scatter)) = sampled else { return false };
            self.rays.scattered += 1;
            let landed = scene.receiver.bvh.closest(path.spawn_ray(direction), |_| true);
            go_on(path, &scene, bounce, scatter.value / scatter.pdf, landed)
        });
    }

    /// Same as [`advance_far`](Self::advance_far), for near light.
    fn advance_near(
        &mut self,
        bounce: u32,
        (near, draws): &mut (NearFieldLight<'a>, NearDraws<'a>),
        alive: &mut Vec<usize>,
    ) {
        let lights = near.lights(bounce == 0);
        draws.restart(lights, first_pair(bounce));
        for &index in &*alive {
            let path = &self.paths[index];
            draws.push(path.position, near.samples(Some(path.matte.normal()), lights), path.points);
        }
        draws.draw();
        let lights = lights.count();
        self.rays.shadow += u64::from(lights) * alive.len() as u64;
        let (scene, rules) = (self.scene, self.scene.rules);
        let firsts = &mut self.firsts;
        let mut vertex = 0;
        alive.retain(|&index| {
            let path = &mut self.paths[index];
            let (samples, sampling): (NearSamples, _) = (draws.of(vertex), draws.sampling(vertex));
            vertex += 1;
            let (mut lit, mut parts) = (Vec3::ZERO, [Vec3::ZERO; MOST]);
            for (part, sample) in parts.iter_mut().zip(&samples) {
                let Some((light, place)) = sample else { continue };
                let scatter = path.matte.eval(light.direction);
                if light.radiance == Vec3::ZERO || scatter.value == Vec3::ZERO {
                    continue;
                }
                let ray = NearFieldLight::towards(path.spawn_ray(light.direction), place.as_ref());
                self.rays.shadow += 1;
                if near.reaches(ray, place.as_ref()) {
                    let arrived = scatter.value * power_heuristic(light.pdf, scatter.pdf);
                    *part = arrived * light.radiance / light.pdf;
                    lit += *part;
                }
            }
            path.light += rules.clamped(bounce, path.throughput * lit);
            let mut keep = |landed, found| {
                if bounce == 0 {
                    firsts.push(FirstVertex { arriving: samples, lit: parts, landed, found, light: None });
                }
            };
            let sampled = path.matte.sample(&path.points, first_pair(bounce) + 1);
            let Some((direction, scatter)) = sampled else {
                keep(None, None);
                return false;
            };
            let (ray, weight) = (path.spawn_ray(direction), scatter.value / scatter.pdf);
            self.rays.scattered += 2;
            let landed = scene.receiver.bvh.closest(ray, |_| true);
            let found = near.eval(ray, sampling, landed.as_ref(), 0.0);
            keep(landed, found);
            if let Some((light, _)) = found {
                let arrived = light.radiance * power_heuristic(scatter.pdf, lights as f32 * light.pdf);
                path.light += rules.clamped(bounce, path.throughput * weight * arrived);
                return false;
            }
            go_on(path, &scene, bounce, weight, landed)
        });
    }
}

/// Moves a path to the hit of its scattered ray. False if it ends.
fn go_on(path: &mut ReceiverPath, scene: &Scene<'_>, bounce: u32, weight: Vec3, landed: Option<Hit>) -> bool {
    let Some(hit) = landed else { return false };
    let left = russian_roulette(&path.points, bounce, path.throughput * weight, 1.0);
    let Some(throughput) = left else { return false };
    path.throughput = throughput;
    path.move_to(scene, &hit);
    true
}
