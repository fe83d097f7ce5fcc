//! Distribution of surface area along a direction, and the evidence that this direction is up. Surface is counted
//! in layers perpendicular to the direction, and in cells of a plan (a view along the direction).

use glam::DVec3;
use serde::Serialize;

use super::axes::across;
use super::patch::{Patch, Patches};

/// Number of layers into which the scene is divided along the direction.
const LAYERS: usize = 96;
/// Number of cells along each side of the plan.
const CELLS: usize = 40;
/// Number of layers into which the column of space above each cell of the plan is divided, from the floor to the
/// top.
const STOREYS: usize = 24;

/// Distribution of surface along a direction, used to judge whether that direction is up. Each field described as a
/// balance has a value between -1 (the opposite direction is probably up) and 1 (this direction is probably up).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Profile {
    /// The direction along which surface is counted.
    pub up: DVec3,
    /// Height of the lowest large layer along `up`, in world units.
    pub floor: f64,
    /// Height of the highest large layer, or of the highest surface if no such layer is above the floor, in world
    /// units.
    pub top: f64,
    /// Score of the floor: the share of all surface that is horizontal and lies in it, minus the share expected by chance. The
    /// score is reduced if there is surface below the floor.
    pub ground: f64,
    /// Score of the highest large layer, called the lid, computed like the score of the floor. It is reduced if
    /// there is surface above the lid.
    pub lid: f64,
    /// Effective number of independent patches of surface in the floor.
    pub observations: f64,
    /// Share of the plan that the floor covers, 0 to 1.
    pub cover: f64,
    /// Share of the plan that the lid covers, 0 to 1.
    pub lid_cover: f64,
    /// Balance between the surface above the floor and the surface below it, including the background.
    pub side: f64,
    /// Balance between the surfaces, except walls, in the lower half of the space from floor to lid and those in
    /// the upper half.
    pub things: f64,
    /// Surfaces counted in `things`, as a share of all surface.
    pub things_share: f64,
    /// Weight of the level surfaces in the lower half of the space from floor to lid minus that in the upper half,
    /// divided by their sum.
    pub levels: f64,
    /// Surfaces counted in `levels`, as a share of all surface.
    pub levels_share: f64,
    /// Mean luma of the upper fifth of the scene minus the mean luma of the floor.
    pub light: f64,
    /// Weight of the background above the centre of the scene minus the weight below it, divided by their sum.
    pub sky: f64,
    /// Weight of the background, as a share of the weight of the surface in the core.
    pub sky_share: f64,
}

impl Profile {
    /// Height of the top above the floor, in world units.
    pub fn height(&self) -> f64 {
        self.top - self.floor
    }

    /// Evidence that this direction and not the opposite one is up, as logarithms of odds.
    pub fn evidence(&self) -> Evidence {
        Evidence {
            ground: 3.0 * (self.ground - self.lid) / (self.ground + self.lid + 0.01) + 1.5 * self.side,
            things: 1.5 * self.things * (self.things_share / 0.05).min(1.0)
                + self.levels * (self.levels_share / 0.02).min(1.0),
            light: 0.7 * (self.light / 0.1).clamp(-1.0, 1.0)
                + 1.5 * self.sky * (self.sky_share / 0.02).min(1.0),
        }
    }
}

/// Evidence that a direction is up, by source, as logarithms of odds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Evidence {
    /// Evidence from a large level surface that has everything else above it.
    pub ground: f64,
    /// Evidence from furniture, which is low, and from table tops and seats, which face up.
    pub things: f64,
    /// Evidence from light: ceilings and sky are brighter than floors, and the background is above the floor.
    pub light: f64,
}

impl Evidence {
    /// The sum of all evidence.
    pub fn sum(&self) -> f64 {
        self.ground + self.things + self.light
    }
}

fn flat(patch: &Patch, up: DVec3) -> bool {
    patch.normal.is_some_and(|n| n.dot(up).abs() > 0.94)
}

/// Surface of a scene in layers perpendicular to a direction.
struct Layers<'p> {
    core: &'p [Patch],
    up: DVec3,
    /// Heights of the lowest and the highest surface, without outliers, in world units.
    low: f64,
    high: f64,
    /// Thickness of a layer, in world units.
    width: f64,
    /// Weight of all surface.
    total: f64,
    /// Total weight of the patches in each layer.
    all: [f64; LAYERS],
    /// Total weight of the horizontal patches in each layer.
    lying: [f64; LAYERS],
}

impl<'p> Layers<'p> {
    fn of(patches: &'p Patches, up: DVec3) -> Self {
        let core = patches.core.as_slice();
        let total: f64 = core.iter().map(|p| p.weight).sum();
        let mut heights: Vec<(f64, f64)> = core.iter().map(|p| (p.middle.dot(up), p.weight)).collect();
        heights.sort_by(|a, b| a.0.total_cmp(&b.0));
        let at = |share: f64| {
            let mut sum = 0.0;
            for (h, w) in &heights {
                sum += w;
                if sum >= share * total {
                    return *h;
                }
            }
            heights.last().map_or(0.0, |h| h.0)
        };
        // An object on a bare floor is a small share of the surface, and dust far below the floor is a small share of
        // the splats.
        let ends = [heights.len() / 200, heights.len() - 1 - heights.len() / 200];
        let [first, last] = ends.map(|i| heights[i].0);
        let (low, high) = (at(0.004).min(first), at(0.996).max(last));
        // Thinner layers than the noise of a floor would cut it in two.
        let width = ((high - low) / LAYERS as f64).max(0.002 * patches.radius);
        let (all, lying) = ([0.0; LAYERS], [0.0; LAYERS]);
        let mut layers = Self { core, up, low, high, width, total, all, lying };
        for p in core {
            let layer = layers.layer(p);
            layers.all[layer] += p.weight;
            if flat(p, up) {
                layers.lying[layer] += p.weight;
            }
        }
        layers
    }

    fn layer(&self, p: &Patch) -> usize {
        let at = (p.middle.dot(self.up) - self.low) / self.width;
        if at < 0.0 { 0 } else { (at as usize).min(LAYERS - 1) }
    }

    /// Score and index of the layer that is most probably the floor, if searched from below, or the lid.
    fn largest(&self, from_below: bool) -> (f64, usize) {
        let (all, total) = (&self.all, self.total);
        let lying_total: f64 = self.lying.iter().sum();
        let window =
            |of: &[f64; LAYERS], k: usize| of[k.saturating_sub(1)..(k + 2).min(LAYERS)].iter().sum::<f64>();
        let mut best = (0.0, if from_below { 0 } else { LAYERS - 1 });
        for k in 0..LAYERS {
            let outer: f64 = if from_below {
                all[..k.saturating_sub(1)].iter().sum()
            } else {
                all[(k + 2).min(LAYERS)..].iter().sum()
            };
            let chance = lying_total / total * window(all, k);
            let score =
                (window(&self.lying, k) - 0.7 * chance) / total * (1.0 - 4.0 * outer / total).max(0.0);
            if score > best.0 {
                best = (score, k);
            }
        }
        best
    }

    /// Median height of the surface that lies flat in a layer, in world units.
    fn middle_of(&self, k: usize) -> f64 {
        let height = |p: &Patch| p.middle.dot(self.up);
        let inside = |p: &&Patch| flat(p, self.up) && self.layer(p).abs_diff(k) <= 1;
        let mut lying: Vec<(f64, f64)> =
            self.core.iter().filter(inside).map(|p| (height(p), p.weight)).collect();
        lying.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = 0.5 * lying.iter().map(|p| p.1).sum::<f64>();
        let mut sum = 0.0;
        let middle = lying.iter().find(|p| {
            sum += p.1;
            sum >= half
        });
        middle.map_or(self.low + (k as f64 + 0.5) * self.width, |p| p.0)
    }
}

/// Computes the profile of a scene along a direction.
pub(super) fn profile(patches: &Patches, up: DVec3) -> Profile {
    let layers = Layers::of(patches, up);
    let Layers { core, low, high, width, total, .. } = layers;
    let (ground, floor_layer) = layers.largest(true);
    let (lid, lid_layer) = layers.largest(false);
    let mut found = Profile { up, ground, lid, ..Profile::default() };
    found.floor = if ground > 0.0 { layers.middle_of(floor_layer) } else { low };
    found.top = if lid > 0.0 && lid_layer > floor_layer { layers.middle_of(lid_layer) } else { high };
    let within = |h: f64| (h - found.floor).abs() < 2.0 * width;
    let (sum, squares) = core
        .iter()
        .filter(|p| flat(p, up) && within(p.middle.dot(up)))
        .fold((0.0, 0.0), |(sum, squares), p| (sum + p.weight, squares + p.weight * p.weight));
    found.observations = if squares > 0.0 { sum * sum / squares } else { 0.0 };
    let around = patches.core.iter().chain(&patches.far).fold([0.0; 2], |mut sum, p| {
        let over = p.middle.dot(up) - found.floor;
        if over.abs() > (3.0 * width).max(0.01 * patches.radius) {
            sum[usize::from(over < 0.0)] += p.weight;
        }
        sum
    });
    measure_plan(&mut found, patches, width, total);
    let sky: [f64; 2] = patches.far.iter().fold([0.0; 2], |mut sum, p| {
        let v = (p.middle - patches.centre).normalize().dot(up);
        if v > 0.25 {
            sum[1] += p.weight;
        } else if v < -0.25 {
            sum[0] += p.weight;
        }
        sum
    });
    found.sky = balance([sky[1], sky[0]]);
    found.sky_share = (sky[0] + sky[1]) / total;
    // The balance counts less if there is little surface on both sides of the floor.
    found.side = balance(around) * ((around[0] + around[1]) / total / 0.02).min(1.0);
    found
}

/// Balance between two weights: 1 if only the first is present, -1 if only the second is, and 0 if neither is.
fn balance([a, b]: [f64; 2]) -> f64 {
    if a + b > 0.0 { (a - b) / (a + b) } else { 0.0 }
}

/// Measures what the plan of the scene shows: the share that the floor and the lid cover, the surfaces between
/// them, and their light. `found` has the heights of floor and lid, `width` is the thickness of a layer, and
/// `total` the weight of all surface.
fn measure_plan(found: &mut Profile, patches: &Patches, width: f64, total: f64) {
    let (core, up) = (&patches.core, found.up);
    let [x, y] = across(up);
    let cell = |p: &Patch| {
        let v = p.middle - patches.centre;
        let at = |axis: DVec3| {
            ((v.dot(axis) / patches.radius * 0.5 + 0.5) * CELLS as f64).clamp(0.0, CELLS as f64 - 1.0)
                as usize
        };
        at(y) * CELLS + at(x)
    };
    let near = 2.0 * width;
    let mut columns = vec![[0.0; STOREYS]; CELLS * CELLS];
    let mut floors = vec![[0.0; 2]; CELLS * CELLS];
    let storey = |h: f64| ((h - found.floor) / found.height().max(1e-12) * STOREYS as f64) as usize;
    for p in core {
        let h = p.middle.dot(up);
        let c = cell(p);
        if flat(p, up) && (h - found.floor).abs() < near {
            floors[c][0] += p.weight;
        } else if flat(p, up) && (h - found.top).abs() < near {
            floors[c][1] += p.weight;
        }
        if h > found.floor + near && h < found.top - near {
            columns[c][storey(h).min(STOREYS - 1)] += p.weight;
        }
    }
    let mean = total / (CELLS * CELLS) as f64 * 0.02;
    let used = |c: usize| floors[c][0] + floors[c][1] + columns[c].iter().sum::<f64>() > mean;
    let plan = (0..CELLS * CELLS).filter(|&c| used(c)).count().max(1) as f64;
    found.cover = floors.iter().filter(|f| f[0] > mean).count() as f64 / plan;
    found.lid_cover = floors.iter().filter(|f| f[1] > mean).count() as f64 / plan;
    // Columns that are full are walls.
    let is_wall: Vec<bool> =
        columns.iter().map(|c| c.iter().filter(|v| **v > 0.0).count() >= STOREYS * 6 / 10).collect();
    let (mut things, mut levels) = ([0.0; 2], [0.0; 2]);
    let (mut lid_light, mut floor_light) = ([0.0; 2], [0.0; 2]);
    for p in core {
        let h = p.middle.dot(up);
        let share = (h - found.floor) / found.height().max(1e-12);
        if (h - found.floor).abs() < near && flat(p, up) {
            floor_light[0] += p.weight * p.luma();
            floor_light[1] += p.weight;
        }
        if share > 0.8 {
            lid_light[0] += p.weight * p.luma();
            lid_light[1] += p.weight;
        }
        if h > found.floor + near && h < found.top - near && !is_wall[cell(p)] {
            let upper = usize::from(share > 0.5);
            things[upper] += p.weight;
            if flat(p, up) {
                levels[upper] += p.weight;
            }
        }
    }
    found.things = balance(things);
    found.things_share = (things[0] + things[1]) / total;
    found.levels = balance(levels);
    found.levels_share = (levels[0] + levels[1]) / total;
    let mean = |[sum, weight]: [f64; 2]| if weight > 0.0 { sum / weight } else { 0.5 };
    found.light = mean(lid_light) - mean(floor_light);
}
