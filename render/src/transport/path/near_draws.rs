//! Light samples of near light for many vertices, drawn together so that memory accesses overlap.

use glam::Vec3;

use super::near_field::{ArrivingLight, NearFieldLight};
use crate::geometry::sampling::Points;
use crate::transport::sky::defensive::{DefensiveSampling, NearLights};
use crate::transport::sky::environment::LightSample;
use crate::transport::sky::light_draws::PlacedDraw;

/// Maximum number of light samples per vertex.
pub(crate) const MOST: usize = 3;

/// Light samples of near light at a vertex.
pub(crate) type NearSamples = [Option<ArrivingLight>; MOST];

/// A vertex: the point from which near light is sampled, and the distributions for its lit side.
pub(crate) type NearVertex<'a> = (Vec3, DefensiveSampling<'a>);

/// Light samples of near light for a batch of vertices.
#[derive(Debug)]
pub struct NearDraws<'a> {
    near: NearFieldLight<'a>,
    /// Numbers of light samples per vertex, in total at most [`MOST`].
    lights: NearLights,
    /// Index of the pair of sample dimensions.
    pair: u32,
    vertices: Vec<NearVertex<'a>>,
    /// Random numbers of the light samples, vertex by vertex.
    points: Vec<Points>,
    bits: Vec<[u32; 2]>,
    /// Samples that have light to choose.
    wanted: Vec<PlacedDraw<'a>>,
    /// Number of each sample in `points` that has light to choose.
    numbers: Vec<usize>,
    directions: Vec<Vec3>,
    texels: Vec<(usize, usize)>,
    arriving: Vec<LightSample>,
    found: Vec<Option<ArrivingLight>>,
}

impl<'a> NearDraws<'a> {
    /// Creates an empty batch.
    pub(crate) fn new(near: NearFieldLight<'a>, lights: NearLights, pair: u32) -> Self {
        Self {
            near,
            lights,
            pair,
            vertices: Vec::new(),
            points: Vec::new(),
            bits: Vec::new(),
            wanted: Vec::new(),
            numbers: Vec::new(),
            directions: Vec::new(),
            texels: Vec::new(),
            arriving: Vec::new(),
            found: Vec::new(),
        }
    }

    /// Takes light samples for a single vertex at sub-samples of `points`, from the pair of sample dimensions
    /// `pair`, into the first entries of the result. Traces one ray for each. Entries are `None` where no light comes
    /// from the lit side.
    pub fn at_one(
        near: NearFieldLight<'a>,
        (point, samples): NearVertex<'a>,
        points: Points,
        lights: NearLights,
        pair: u32,
    ) -> NearSamples {
        let mut draws = Self::new(near, lights, pair);
        draws.push(point, samples, points);
        draws.draw();
        draws.of(0)
    }

    /// Empties the batch. Its next vertices take `lights`, from the pair of sample dimensions `pair`.
    pub(crate) fn restart(&mut self, lights: NearLights, pair: u32) {
        (self.lights, self.pair) = (lights, pair);
        self.vertices.clear();
        self.points.clear();
    }

    /// Adds a vertex at `point` to the batch. `points` are the random numbers of its sample.
    pub(crate) fn push(&mut self, point: Vec3, samples: DefensiveSampling<'a>, points: Points) {
        self.vertices.push((point, samples));
        let lights = self.lights;
        self.points.extend((0..lights.count()).map(|number| lights.points(&points, number)));
    }

    /// Distributions for the lit side of a vertex of the batch.
    pub(crate) fn sampling(&self, vertex: usize) -> &DefensiveSampling<'a> {
        &self.vertices[vertex].1
    }

    /// Draws the light samples of all vertices. Traces one ray for each.
    pub(crate) fn draw(&mut self) {
        let (sky, count) = (self.near.sky, self.lights.count() as usize);
        self.bits.clear();
        sky.bits_each(&self.points, self.pair, &mut self.bits);
        self.wanted.clear();
        self.numbers.clear();
        for (number, bits) in self.bits.iter().enumerate() {
            if let Some(wanted) = self.vertices[number / count].1.choose(sky, (number % count) as u32, *bits)
            {
                self.wanted.push(wanted);
                self.numbers.push(number);
            }
        }
        let (directions, texels) = (&mut self.directions, &mut self.texels);
        directions.clear();
        texels.clear();
        sky.draw_placed(&self.wanted, |drawn| {
            directions.push(drawn.direction);
            texels.push(sky.texel_of(&drawn));
        });
        let chosen = self.numbers.iter().zip(&self.directions).zip(&self.texels);
        self.arriving.clear();
        self.arriving.extend(chosen.map(|((&number, &direction), &texel)| {
            self.vertices[number / count].1.light(direction, &sky.texel_at(texel))
        }));
        self.found.clear();
        self.found.resize(self.points.len(), None);
        for (&number, &light) in self.numbers.iter().zip(&self.arriving) {
            let mut arriving = self.near.arriving(self.vertices[number / count].0, light);
            arriving.0.pdf *= count as f32;
            self.found[number] = Some(arriving);
        }
    }

    /// Light samples of a vertex of the batch, by its number in the order of [`push`](Self::push). Entries are
    /// `None` where no light comes from the lit side.
    pub(crate) fn of(&self, vertex: usize) -> NearSamples {
        let mut samples = [None; MOST];
        let count = self.lights.count() as usize;
        for (sample, found) in samples.iter_mut().zip(&self.found[vertex * count..][..count]) {
            *sample = *found;
        }
        samples
    }
}
