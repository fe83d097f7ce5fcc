//! Guide of paths: the part of the sky and the bright surfaces that each place of the receiver sees, learnt by rays.
//!
//! In a room, walls block most light samples of the sky. The guide divides the receiver into places. For each place,
//! it finds by shadow rays which cells of the sky are visible. Light samples at the place are then chosen in
//! proportion to light times the visible share of each cell, plus a part that is the same for all cells. Rays from
//! each place also find the surfaces that the sky lights, such as a patch of sun, and half of the scattered rays go
//! where they are. So every direction keeps a density above 0, and the estimate has no bias, whatever was learnt.
//!
//! What is learnt depends on the receiver, the sky, the rules of visibility and the camera only: not on the seed, the
//! number of samples or the number of threads.

use engine::{Context, NodeError};
use glam::Vec3;

use super::incident::IncidentLight;
use super::integrator::Scene;
use super::path::first_pair;
use super::places::Places;
use super::rays::Rays;
use crate::geometry::bvh::{Ray, Steps, each};
use crate::geometry::sampling::Points;
use crate::transport::bsdf::{Lobe, Matte};
use crate::transport::scene::block::Block;
use crate::transport::sky::environment::{Distributions, EnvironmentLight, TIERS};
use crate::transport::sky::light_distribution::LightTable;

/// Number of light samples at the first vertex of a guided path. It is a power of 2.
pub(crate) const FIRST_LIGHTS: u32 = 2;
/// Number of camera paths from which a guide is learnt.
pub const LEARNT_PATHS: u32 = 1024;
/// Maximum number of vertices of each of these paths.
const VERTICES: u32 = 4;
/// Number of light samples that decide whether a guide is of use.
const CHECKED: usize = 1024;
/// Share of the light of unguided samples that must be blocked for a guide to be of use.
const BLOCKED: f64 = 0.5;
/// Maximum number of places.
const MOST_PLACES: usize = 256;
/// Number of bins of normals per side of the octahedral map in the tables of a place.
const COARSE: usize = 8;
/// Maximum memory of the distributions of all places for the normals of one bin, in bytes. There are 128 and 512 cells
/// at most, of four bytes and some padding.
pub const BIN_BYTES: u64 = MOST_PLACES as u64 * 3072;
/// Number of bins of normals of a place.
pub const BINS: u64 = (COARSE * COARSE) as u64;
/// Maximum number of shadow rays from a place to a cell of the sky.
const TRIES: usize = 6;
/// Cells with less than this share of all light are not tested.
const FAINT: f64 = 1e-5;
/// Weight of a cell that seems invisible, relative to the mean visible share of all light of the sky.
const DEFENSIVE: f64 = 0.15;
/// Number of the stream of random points.
const STREAM: u32 = 0x6775_6964;
/// Number of rays that find the light of surfaces around a side of a place.
const FEELERS: u32 = 128;
/// Number of light samples at each surface point that one of the [`FEELERS`] rays hits.
const LANDED_LIGHTS: u32 = 2;
/// Number of sides of a place, by the axis that a normal is nearest to.
const SIDES: usize = 6;
/// Pairs of sample dimensions: of the light samples that decide whether a guide is of use, of the shadow rays, of the
/// rays that find surfaces, and of the light samples there.
const CHECK: u32 = 1 << 20;
const LOOK: u32 = 1 << 21;
const FEEL: u32 = 1 << 22;

/// Point of the receiver from which shadow rays start.
#[derive(Debug, Clone, Copy)]
struct LearntPoint {
    start: Vec3,
    normal: Vec3,
}

/// Light distributions of a place, one table for each tier of the sky.
#[derive(Debug)]
struct SeenSky {
    /// Factor of the weight of each cell.
    factors: [Vec<f32>; TIERS],
    tables: [LightTable; TIERS],
}

/// Guide of light samples and scattered rays.
#[derive(Debug)]
pub struct Guide {
    places: Places,
    /// For each place, its distributions. `None` if no light seems to reach the place.
    seen: Vec<Option<SeenSky>>,
    /// For each side of each place, the directions from which surfaces light it. `None` if this is not known.
    incident: Vec<Option<Box<IncidentLight>>>,
    /// Rays that were cast to learn.
    pub(crate) rays: Rays,
}

impl Guide {
    /// Learns from the vertices of paths that start with the given camera rays. `None` if a guide is of no use: under
    /// near light, if a part of the receiver is glossy, or if the receiver blocks little light.
    ///
    /// # Errors
    /// If the run is cancelled.
    pub fn learn(
        scene: Scene<'_>,
        camera: impl Iterator<Item = Ray>,
        cx: Option<&Context>,
    ) -> Result<Option<Self>, NodeError> {
        let block = scene.rules.visibility(Lobe::Diffuse).shadow;
        let unused = scene.rules.near.is_some() || scene.rules.printed || scene.receiver.is_glossy();
        if unused || block == Block::Pass {
            return Ok(None);
        }
        let mut rays = Rays::default();
        let points = Steps::uncounted(|| vertices(&scene, camera, &mut rays));
        if points.is_empty() || !Steps::uncounted(|| is_blocked(&scene, block, &points, &mut rays)) {
            return Ok(None);
        }
        let starts: Vec<Vec3> = points.iter().map(|point| point.start).collect();
        let places = Places::new(&starts, MOST_PLACES);
        let mut members = vec![Vec::new(); places.count];
        for point in &points {
            if let Some(place) = places.of(point.start) {
                members[place].push(*point);
            }
        }
        let looked = each(cx, members.len(), |place| {
            Steps::uncounted(|| SeenSky::from(&scene, block, place as u32, &members[place]))
        })?;
        let mut seen = Vec::with_capacity(looked.len());
        for (sky, shadow) in looked {
            rays.shadow += shadow;
            seen.push(sky);
        }
        if seen.iter().all(Option::is_none) {
            return Ok(None);
        }
        let mut guide = Self { places, seen, incident: Vec::new(), rays };
        if scene.rules.visibility(Lobe::Diffuse).lands && scene.rules.max_bounces > 0 {
            let felt = each(cx, guide.places.count * SIDES, |side| {
                let points: Vec<LearntPoint> = members[side / SIDES]
                    .iter()
                    .filter(|p| side_of(p.normal) == side % SIDES)
                    .copied()
                    .collect();
                Steps::uncounted(|| guide.feel(&scene, block, side as u32, &points))
            })?;
            for (incident, rays) in felt {
                guide.rays += rays;
                guide.incident.push(incident.map(Box::new));
            }
        }
        Ok(Some(guide))
    }

    /// Finds by rays the directions from which surfaces light a side of a place.
    fn feel(
        &self,
        scene: &Scene<'_>,
        block: Block,
        side: u32,
        points: &[LearntPoint],
    ) -> (Option<IncidentLight>, Rays) {
        let (sky, receiver) = (scene.sky, scene.receiver);
        let mut rays = Rays::default();
        if points.is_empty() {
            return (None, rays);
        }
        let mut found = Vec::with_capacity(FEELERS as usize);
        for number in 0..FEELERS {
            let point = points[number as usize % points.len()];
            let random = Points::new(STREAM, side * FEELERS + number);
            let Some(direction) = Matte::new(point.normal, Vec3::ONE).direction(random.pair(FEEL)) else {
                continue;
            };
            rays.scattered += 1;
            let Some(hit) = receiver.bvh.closest(Ray::new(point.start, direction), |_| true) else {
                continue;
            };
            let (start, normal) = (receiver.start(&hit), receiver.facing(&hit));
            let mut light = Vec3::ZERO;
            for k in 0..LANDED_LIGHTS {
                let distributions = self.distributions(sky, start, normal);
                if distributions.iter().all(|distribution| distribution.power <= 0.0) {
                    continue;
                }
                let numbers = sky.numbers(distributions, None);
                let (tier, point) = sky.tier(numbers, random.twig(k, LANDED_LIGHTS).bits(FEEL + 1));
                let sample = sky.light(&sky.draw_one(tier, distributions[tier], numbers[tier], point));
                let cosine = sample.direction.dot(normal);
                if cosine > 0.0 && sample.radiance != Vec3::ZERO {
                    rays.shadow += 1;
                    if block.passes(receiver, Ray::new(start, sample.direction)) {
                        light += sample.radiance * (cosine / sample.pdf);
                    }
                }
            }
            let light = (light * receiver.albedo_at(&hit)).element_sum();
            if light.is_finite() {
                found.push((direction, light));
            }
        }
        (IncidentLight::new(found.into_iter()), rays)
    }

    /// Directions from which surfaces light a point of the receiver. `None` if they are not known.
    #[inline]
    pub(crate) fn incident(&self, position: Vec3, normal: Vec3) -> Option<&IncidentLight> {
        let side = self.places.of(position)? * SIDES + side_of(normal);
        self.incident.get(side)?.as_deref()
    }

    /// Maximum memory use in bytes, with distributions for all bins of normals.
    pub(crate) fn bytes(&self) -> u64 {
        let incident = self.incident.iter().flatten().count() * size_of::<IncidentLight>();
        self.seen.iter().flatten().count() as u64 * (BINS * BIN_BYTES / MOST_PLACES as u64) + incident as u64
    }

    /// Light distributions for a point of the receiver.
    #[inline]
    pub fn distributions<'a>(
        &'a self,
        sky: &'a EnvironmentLight,
        position: Vec3,
        normal: Vec3,
    ) -> Distributions<'a> {
        match self.places.of(position).and_then(|place| self.seen[place].as_ref()) {
            Some(SeenSky { factors, tables }) => {
                [0, 1].map(|k| tables[k].of(&sky.tiers[k].grid, Some(normal), Some(&factors[k])))
            }
            None => sky.distributions(Some(normal)),
        }
    }
}

/// Number of the axis, with its sign, that a normal is nearest to.
#[inline]
fn side_of(normal: Vec3) -> usize {
    let size = normal.abs();
    let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 2 - usize::from(size.y >= size.z) };
    2 * axis + usize::from(normal[axis] < 0.0)
}

/// Vertices on the receiver of paths without light samples.
fn vertices(scene: &Scene<'_>, camera: impl Iterator<Item = Ray>, rays: &mut Rays) -> Vec<LearntPoint> {
    let lands = scene.rules.visibility(Lobe::Diffuse).lands;
    let most = if lands { VERTICES.min(scene.rules.max_bounces + 1) } else { 1 };
    let mut points = Vec::new();
    for (number, camera_ray) in camera.enumerate() {
        let random = Points::new(STREAM, number as u32);
        let mut ray = camera_ray;
        for bounce in 0..most {
            *(if bounce == 0 { &mut rays.camera } else { &mut rays.scattered }) += 1;
            let Some(hit) = scene.receiver.bvh.closest(ray, |_| true) else { break };
            let (start, normal) = (scene.receiver.start(&hit), scene.receiver.facing(&hit));
            if !start.is_finite() {
                break;
            }
            points.push(LearntPoint { start, normal });
            let sampled = Matte::new(normal, Vec3::ONE).sample(&random, first_pair(bounce) + 1);
            let Some((direction, _)) = sampled else { break };
            ray = Ray::new(start, direction);
        }
    }
    points
}

/// True if the receiver blocks so much light of light samples that a guide is of use.
fn is_blocked(scene: &Scene<'_>, block: Block, points: &[LearntPoint], rays: &mut Rays) -> bool {
    let (mut all, mut passed) = (0.0, 0.0);
    for (number, point) in points.iter().step_by(points.len().div_ceil(CHECKED)).enumerate() {
        let random = Points::new(STREAM, number as u32).bits(CHECK);
        let Some(light) = scene.sky.sample_one(Some(point.normal), random) else { continue };
        let cosine = light.direction.dot(point.normal).max(0.0);
        let brought = f64::from(light.radiance.element_sum() * cosine / light.pdf);
        if brought.is_finite() && brought > 0.0 {
            all += brought;
            rays.shadow += 1;
            if block.passes(scene.receiver, Ray::new(point.start, light.direction)) {
                passed += brought;
            }
        }
    }
    passed < (1.0 - BLOCKED) * all
}

impl SeenSky {
    /// Finds by shadow rays from some of the points of a place which cells of the sky are visible. Also returns the
    /// number of rays. `None` if no cell is visible.
    fn from(scene: &Scene<'_>, block: Block, place: u32, points: &[LearntPoint]) -> (Option<Self>, u64) {
        let sky = scene.sky;
        let total: f64 = sky.tiers.iter().map(|tier| tier.grid.power()).sum();
        let tries = points.len().min(TRIES);
        let mut rays = 0;
        let mut look = |tier: usize, cell: usize, power: f64| {
            if power <= FAINT * total {
                return None;
            }
            let columns = sky.tiers[tier].grid.columns;
            let (mut tried, mut passed) = (0_u32, 0_u32);
            for k in 0..tries {
                let point = points[k * points.len() / tries];
                let random = Points::new(STREAM, ((place * TRIES as u32 + k as u32) << 10) | cell as u32);
                let random = random.bits(LOOK + tier as u32);
                let direction = sky.direction_in(tier, (cell / columns, cell % columns), random);
                if direction.dot(point.normal) > 0.0 {
                    tried += 1;
                    passed += u32::from(block.passes(scene.receiver, Ray::new(point.start, direction)));
                }
            }
            rays += u64::from(tried);
            (tried > 0).then(|| passed as f32 / tried as f32)
        };
        let shares = [0, 1].map(|tier| {
            let powers = sky.tiers[tier].grid.powers();
            powers.enumerate().map(|(cell, power)| look(tier, cell, power)).collect::<Vec<_>>()
        });
        let shares = [0, 1].map(|tier| spread(&shares[tier], sky.tiers[tier].grid.columns));
        let (mut visible, mut known) = (0.0, 0.0);
        for (tier, shares) in sky.tiers.iter().zip(&shares) {
            for (power, share) in tier.grid.powers().zip(shares) {
                if let Some(share) = share {
                    visible += power * f64::from(*share);
                    known += power;
                }
            }
        }
        if visible <= 0.0 {
            return (None, rays);
        }
        let mean = visible / known;
        let factor = |share: &Option<f32>| (share.map_or(mean, f64::from) + DEFENSIVE * mean) as f32;
        let factors = shares.map(|shares| shares.iter().map(factor).collect());
        (Some(Self { factors, tables: [COARSE; TIERS].map(LightTable::new) }), rays)
    }
}

/// Visible shares of cells, row by row, raised to at least half of the share of each neighbour, since few rays miss
/// what is at the edge of a window. Columns wrap around.
fn spread(shares: &[Option<f32>], columns: usize) -> Vec<Option<f32>> {
    let rows = shares.len() / columns;
    let at = |row: usize, column: usize| shares[row * columns + column % columns].unwrap_or(0.0);
    let spread = |(cell, share): (usize, &Option<f32>)| {
        let (row, column) = (cell / columns, cell % columns);
        let mut most = at(row, column + 1).max(at(row, column + columns - 1));
        if row > 0 {
            most = most.max(at(row - 1, column));
        }
        if row + 1 < rows {
            most = most.max(at(row + 1, column));
        }
        share.map(|share| share.max(0.5 * most))
    };
    shares.iter().enumerate().map(spread).collect()
}
