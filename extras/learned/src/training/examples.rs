//! Training examples, and the selection of examples for each network.

use crate::exposure::{Examples, Scale};
use engine::Digest;
use render::geometry::sampling::{hash, unit};
use scene::error::Error;
use scene::math::num;
use scene::types::{Image, Linear};

use super::plan::{Plan, Progress};
use super::procedural;
use super::ridge::{Ridge, Sample};
use super::truth::{Example, Shot, Truth};
use render::light::hidden::network::{AMOUNT, CELL, COLOUR, HUE, LIMITS, OVERVIEW, cautious};

/// Name of the location that a panorama shows. Files whose names differ only in a number at the end, or in
/// `_puresky`, show the same location.
pub fn place(name: &str) -> &str {
    let name = name.strip_suffix("_puresky").unwrap_or(name);
    let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
    if stem.len() < name.len() { stem.trim_end_matches('_') } else { name }
}

/// Number of photographs per panorama; the first is unmodified, at EV 0.
const SHOTS: u32 = 8;
/// Maximum deviation of the exposure from EV 0, in stops.
const STOPS: f64 = 1.2;
/// Maximum number of clipped cells that an example keeps. If there are more, it keeps the [`BRIGHTEST`] cells with
/// the most hidden light, and a random selection of all other cells.
const CELLS: usize = 600;
/// Number of cells that are chosen by their hidden light if an example has more than [`CELLS`] clipped cells.
const BRIGHTEST: usize = 150;
/// Share of the photographs that are taken from the finer panorama. It is 0 until other values have been tested by
/// cross-validation of complete training runs; 0.5 is a candidate.
const FINER: f64 = 0.0;
/// Share of the photographs that have glints. It is 0 until other values have been tested by cross-validation of
/// complete training runs; 0.3 is a candidate.
const GLINTS: f64 = 0.0;
/// Weight of a photograph of a procedural panorama, relative to the weight of a photograph of a real panorama.
const PROCEDURAL: f32 = 0.6;

/// Penalty of the squared weights in the fit of the amount of hidden light.
const PENALTY_AMOUNT: f64 = 0.01;
/// Lower bound of the amounts of hidden light in the fit, as log2 of the ratio of hidden to visible flux. Smaller
/// amounts are raised to this bound.
const LEAST: f64 = -4.0;
/// Penalty of the squared weights in the fit of the colour of hidden light.
const PENALTY_COLOUR: f64 = 0.03;
/// Minimum share of the hidden light of a panorama that a region must have to be used in the fit of the colour.
const COLOURED: f64 = 0.03;

/// All training examples.
pub(super) struct Course {
    /// Real panoramas, which are used for evaluation.
    held: Vec<HeldOut>,
    /// Index of the location that each example shows. `None` for procedural examples.
    places: Vec<Option<usize>>,
    /// Index of each example among the photographs of its panorama. The photograph with index 0 is unmodified.
    shots: Vec<u32>,
    /// Visible unclipped flux of each example.
    open: Vec<f64>,
    /// Regions to which the colour of hidden light is fitted.
    lights: Vec<Light>,
    raw: Examples,
}

/// A region with a known colour of its hidden light.
struct Light {
    /// Index of the example that contains the region.
    example: usize,
    /// Features that predict the colour.
    features: [f32; COLOUR],
    /// log2 of the ratio of red to green light, and of blue to green light.
    hues: [f64; 2],
    /// Weight of the region in the fit: its share of all light of the panorama, times the weight of the example.
    weight: f64,
}

/// Data for the evaluation on a held-out panorama.
pub(super) struct HeldOut {
    pub name: String,
    place: usize,
    /// Unmodified photograph.
    pub plain: Example,
    /// Unmodified photograph of the finer panorama, if there is one.
    pub fine: Option<Example>,
}

/// Random parameters of a photograph: exposure, white balance, softness, grain, holes.
fn shot(key: u32, ev: f64) -> Shot {
    let by_chance = |n: u32| f64::from(unit(hash(key, n)));
    let balance = std::array::from_fn(|c| {
        let sum = (0..3).map(|k| by_chance(10 * c as u32 + k + 1)).sum::<f64>() - 1.5;
        num::f64::exp2(0.24 * sum)
    });
    let hole = if by_chance(40) < 0.2 { -1.0 + 0.5 * by_chance(41) } else { -1.0 };
    let grain = if by_chance(42) < 0.5 { 3.0 * by_chance(43) } else { 0.0 };
    let (soft, fine) = (by_chance(44) < 0.4, by_chance(46) < FINER);
    let glints = if by_chance(47) < GLINTS { num::f64::exp2(6.0 * by_chance(48)) as u32 } else { 0 };
    Shot { ev, balance, soft, grain, seed: hash(key, 45), hole, fine, glints }
}

impl Course {
    /// Photographs every panorama, real and procedural. Returns `None` if the training was stopped.
    pub fn new(
        panoramas: Vec<(String, Image<Linear>)>,
        plan: &Plan,
        on_progress: &mut dyn FnMut(Progress) -> bool,
    ) -> Result<Option<Self>, Error> {
        let mut places: Vec<String> = panoramas.iter().map(|(name, _)| place(name).to_owned()).collect();
        places.sort();
        places.dedup();
        let key = hash(plan.seed as u32, (plan.seed >> 32) as u32);
        let total = panoramas.len() + plan.procedural as usize;
        let mut course = Self {
            held: Vec::new(),
            places: Vec::new(),
            shots: Vec::new(),
            open: Vec::new(),
            lights: Vec::new(),
            raw: Examples {
                count: 0,
                cells: CELLS,
                overview: Vec::new(),
                features: Vec::new(),
                log_flux: Vec::new(),
                hidden: Vec::new(),
                near: Vec::new(),
                far: Vec::new(),
                fluxes: Vec::new(),
                weight: Vec::new(),
            },
        };
        for (index, (name, image)) in panoramas.into_iter().enumerate() {
            let place = places.binary_search_by(|p| p.as_str().cmp(place(&name))).unwrap_or_default();
            let truth = Truth::new(image).ok_or_else(|| Error::format(name.as_str(), "contains no light"))?;
            for n in 0..SHOTS {
                let key = hash(hash(key, index as u32), n);
                let among = (f64::from(n) - 1.0 + f64::from(unit(key))) / f64::from(SHOTS - 1);
                let shot = if n == 0 { Shot::plain(0.0) } else { shot(key, STOPS * (2.0 * among - 1.0)) };
                let Some(example) = truth.example(shot) else { continue };
                course.add(&example, 1.0, key);
                course.places.push(Some(place));
                course.shots.push(n);
                if n == 0 {
                    let finer = Shot { fine: true, ..Shot::plain(0.0) };
                    let fine = truth.fine.as_ref().and_then(|_| truth.example(finer));
                    course.held.push(HeldOut { name: name.clone(), place, plain: example, fine });
                }
            }
            if !on_progress(Progress::Examples(index + 1, total)) {
                return Ok(None);
            }
        }
        for index in 0..plan.procedural {
            let key = hash(hash(key, u32::MAX), index);
            let ev = STOPS * (2.0 * f64::from(unit(key)) - 1.0);
            let example =
                Truth::new(procedural::panorama(plan.seed, index)).and_then(|t| t.example(shot(key, ev)));
            if let Some(example) = example {
                course.add(&example, PROCEDURAL, key);
                course.places.push(None);
                course.shots.push(0);
            }
            if !on_progress(Progress::Examples(total - plan.procedural as usize + index as usize + 1, total))
            {
                return Ok(None);
            }
        }
        if course.raw.count == 0 {
            return Err(Error::Mismatch("there is no panorama to learn from".to_owned()));
        }
        Ok(Some(course))
    }

    fn add(&mut self, example: &Example, weight: f32, key: u32) {
        self.add_lights(example, f64::from(weight));
        let raw = &mut self.raw;
        let count = example.scene.cells.len();
        // Kept cells, and the number of cells that each represents.
        let mut order: Vec<usize> = (0..count).collect();
        let mut stands_for = 1.0;
        if count > CELLS {
            order.sort_by(|&a, &b| example.hidden[b].total_cmp(&example.hidden[a]));
            order[BRIGHTEST..].sort_by_key(|&i| hash(key, i as u32));
            order.truncate(CELLS);
            stands_for = (count - BRIGHTEST) as f64 / (CELLS - BRIGHTEST) as f64;
        }
        raw.count += 1;
        raw.overview.extend(example.scene.overview);
        for (rank, &i) in order.iter().enumerate() {
            let (cell, [near, far]) = (&example.scene.cells[i], example.toward[i]);
            let stands_for = if rank < BRIGHTEST { 1.0 } else { stands_for };
            raw.features.extend(cell.features);
            raw.log_flux.push(num::f64::ln((cell.flux * stands_for).max(1e-12)) as f32);
            raw.hidden.push((example.hidden[i] * stands_for) as f32);
            raw.near.push(near as f32);
            raw.far.push(far as f32);
        }
        let cells = raw.count * CELLS;
        raw.features.resize(cells * CELL, 0.0);
        raw.log_flux.resize(cells, -1e9);
        for values in [&mut raw.hidden, &mut raw.near, &mut raw.far] {
            values.resize(cells, 0.0);
        }
        let ([a, b, c], [d, e, f]) = (example.visible, example.truth);
        let hidden = example.hidden.iter().sum();
        raw.fluxes.push([a, b, c, d, e, f, hidden, 0.0].map(|v| v as f32));
        self.open.push(example.scene.open_flux);
        raw.weight.push(weight);
    }

    /// Adds the regions of an example to which the colour is fitted.
    fn add_lights(&mut self, example: &Example, weight: f64) {
        let mut of_region = vec![0.0; example.hidden_rgb.len()];
        for (cell, hidden) in example.scene.cells.iter().zip(&example.hidden) {
            of_region[cell.region] += hidden;
        }
        let total: f64 = of_region.iter().sum();
        for (i, hidden) in of_region.into_iter().enumerate() {
            let rgb = example.hidden_rgb[i];
            if hidden > COLOURED * total && rgb.iter().all(|v| *v > 0.0) {
                self.lights.push(Light {
                    example: self.raw.count,
                    features: example.scene.colours[i],
                    hues: [0, 2].map(|c| num::f64::log2(rgb[c] / rgb[1]).clamp(-HUE, HUE)),
                    weight: weight * hidden / example.truth[0],
                });
            }
        }
    }

    /// Data of each example, one line per example: the index of its location (empty if the panorama is procedural),
    /// the index of the photograph, its weight, visible flux, unclipped flux, hidden flux, and the features of the
    /// whole panorama.
    pub fn numbers(&self) -> String {
        let mut text = "place,photograph,weight,visible,open,hidden".to_owned();
        (0..OVERVIEW).for_each(|k| text += &format!(",n{k}"));
        text.push('\n');
        for (i, numbers) in self.raw.overview.chunks_exact(OVERVIEW).enumerate() {
            let place = self.places[i].map_or(String::new(), |place| place.to_string());
            let ([visible, .., hidden, _], open) = (self.raw.fluxes[i], self.open[i]);
            let (shot, weight) = (self.shots[i], self.raw.weight[i]);
            text += &format!("{place},{shot},{weight},{visible},{open},{hidden}");
            numbers.iter().for_each(|v| text += &format!(",{v}"));
            text.push('\n');
        }
        text
    }

    /// Digest of the training data.
    pub fn digest(&self) -> Digest {
        let raw = &self.raw;
        let values =
            [&raw.overview, &raw.features, &raw.log_flux, &raw.hidden, &raw.near, &raw.far, &raw.weight];
        let digests: String =
            values.iter().map(|v| Digest::of(bytemuck::cast_slice(v)).to_string()).collect();
        Digest::of(digests.as_bytes())
    }

    /// Index of the fold of the cross-validation to which a location belongs.
    fn fold(place: usize, folds: usize) -> usize {
        place % folds
    }

    /// Indices of the examples for one network: all examples with hidden light, except those whose location belongs
    /// to `fold`. If `fold` is `None`, no location is excluded.
    pub fn chosen(&self, fold: Option<usize>, folds: usize) -> Vec<usize> {
        let learns = |i: &usize| {
            let ([.., hidden, _], open) = (self.raw.fluxes[*i], self.open[*i]);
            let apart = match (fold, self.places[*i]) {
                (Some(fold), Some(place)) => Self::fold(place, folds) != fold,
                _ => true,
            };
            apart && open > 0.0 && hidden > 0.0
        };
        (0..self.raw.count).filter(learns).collect()
    }

    /// Means and standard deviations, over the chosen examples, of the features of a panorama, of a cell, and of those
    /// that predict colour.
    pub fn scales(&self, chosen: &[usize]) -> [Scale; 3] {
        let among = |i: usize| chosen.binary_search(&i).is_ok();
        let real = |i: usize| among(i / CELLS) && self.raw.log_flux[i] > -1e8;
        let colours: Vec<f32> = self.lights.iter().flat_map(|light| light.features).collect();
        [
            Scale::of(&self.raw.overview, OVERVIEW, among),
            Scale::of(&self.raw.features, CELL, real),
            Scale::of(&colours, COLOUR, |i| among(self.lights[i].example)),
        ]
    }

    /// Model of the total hidden light, fitted to the chosen examples.
    pub fn amount(&self, chosen: &[usize], scales: &[Scale; 3]) -> Ridge {
        let mut overview = self.raw.overview.clone();
        scales[0].apply(&mut overview, LIMITS[0]);
        let sample = |&i: &usize| Sample {
            numbers: &overview[i * OVERVIEW..][..OVERVIEW],
            value: num::f64::log2(f64::from(self.raw.fluxes[i][6]) / self.open[i]).max(LEAST),
            weight: f64::from(self.raw.weight[i]),
        };
        Ridge::fit(&chosen.iter().map(sample).collect::<Vec<_>>(), PENALTY_AMOUNT)
    }

    /// Models of the colour of hidden light, fitted to the regions of the chosen examples: log2 of the ratio of red to
    /// green light, and of blue to green light.
    pub fn colour(&self, chosen: &[usize], scales: &[Scale; 3]) -> [Ridge; 2] {
        let lights: Vec<&Light> =
            self.lights.iter().filter(|light| chosen.binary_search(&light.example).is_ok()).collect();
        let scaled: Vec<Vec<f32>> = lights
            .iter()
            .map(|light| {
                let mut features = light.features.to_vec();
                scales[2].apply(&mut features, LIMITS[2]);
                features
            })
            .collect();
        [0, 1].map(|hue| {
            let samples: Vec<Sample<'_>> = lights
                .iter()
                .zip(&scaled)
                .map(|(light, numbers)| Sample { numbers, value: light.hues[hue], weight: light.weight })
                .collect();
            Ridge::fit(&samples, PENALTY_COLOUR)
        })
    }

    /// All examples, with scaled features, and with the hidden flux that `amount` predicts.
    pub fn scaled(&self, scales: &[Scale; 3], amount: &Ridge) -> Examples {
        let raw = &self.raw;
        let mut scaled = Examples {
            overview: raw.overview.clone(),
            features: raw.features.clone(),
            log_flux: raw.log_flux.clone(),
            hidden: raw.hidden.clone(),
            near: raw.near.clone(),
            far: raw.far.clone(),
            fluxes: raw.fluxes.clone(),
            weight: raw.weight.clone(),
            ..*raw
        };
        scales[0].apply(&mut scaled.overview, LIMITS[0]);
        scales[1].apply(&mut scaled.features, LIMITS[1]);
        let numbers = scaled.overview.chunks_exact(OVERVIEW);
        for ((fluxes, numbers), open) in scaled.fluxes.iter_mut().zip(numbers).zip(&self.open) {
            let hidden = open * num::f64::exp2(amount.of(numbers).clamp(-AMOUNT, AMOUNT));
            fluxes[7] = cautious(hidden, f64::from(fluxes[0])) as f32;
        }
        scaled
    }

    /// Held-out panoramas whose location belongs to `fold`.
    pub fn held_out(&self, fold: usize, folds: usize) -> impl Iterator<Item = &HeldOut> {
        self.held.iter().filter(move |held| Self::fold(held.place, folds) == fold)
    }
}
