//! Measures how often true values lie within the reported standard errors, over twenty seeds. The measured values
//! are the ratio `with / without` of `path-trace`, and the picture of `composite`. Prints the tables of
//! `docs/evidence/trade.md`. Run it as `cargo bench -p lightharmony-testkit --bench coverage` in a checkout next to
//! `shared`; with `-- small`, it only checks that the benchmark runs.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a benchmark prints its results and may panic")]

use std::path::Path;
use std::sync::Arc;

use engine::{
    Artifact, Context, Engine, Graph, Kind, RunOptions, Scene, Source, SourceRoot, Store, Up, Wire,
};
use nodes::kinds::composite::{self, Composite};
use nodes::kinds::path_trace::surroundings::Surroundings;
use nodes::kinds::path_trace::{self, PathTrace};
use nodes::kinds::shadow_ratio::{self, ShadowRatio};
use scene::math::color::luminance;
use scene::types::{Environment, Images, Mesh, Placed, Rig};

/// Numbers of seeds and of samples per pixel with which the scenes are traced.
struct Effort {
    seeds: u64,
    /// Number of seeds, and number of samples per pixel, with which the true values are computed. None of these
    /// seeds is used by a measurement.
    truth: (u64, u32),
    /// Maximum number of samples per pixel in the measurement with an error bound.
    most: u32,
}

const WHOLE: Effort = Effort { seeds: 20, truth: (8, 256), most: 256 };
/// A small amount of work, to check that the benchmark runs.
const SMALL: Effort = Effort { seeds: 2, truth: (2, 8), most: 8 };
/// Value of `max_error` in the measurement with an error bound.
const ASKED: f64 = 0.03;
/// Side of the tiles to which the error bound applies, in pixels.
const TILE: usize = 8;

/// Inputs of the node `trace` in a graph of `tests/tables`, and the background of its picture.
struct TraceInputs {
    receiver: Arc<Mesh>,
    objects: Vec<Arc<Placed>>,
    rig: Arc<Rig>,
    env: Arc<Environment>,
    background: Arc<Images>,
}

/// Value and reported standard error of each pixel. The standard error is 0 if the pixel has no noise.
type Reported = Vec<[f64; 2]>;

impl TraceInputs {
    /// Loads a graph after replacing `before` in its text with `after`, to change the size of its pictures.
    fn load(name: &str, (before, after): (&str, &str)) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/tables");
        let text = std::fs::read_to_string(folder.join(name)).unwrap();
        assert_eq!(text.matches(before).count(), 1, "`{name}` must contain `{before}` exactly once");
        let source = Source::new(name, text.replace(before, after));
        let graph = Graph::parse(source, &nodes::registry(), SourceRoot::new(folder)).unwrap();
        let engine = Engine::new(Store::in_memory(), 2, 1 << 32);
        let wires = |node: &str, port: &str| {
            let node = &graph.nodes[graph.find(node).unwrap()];
            let at = node.kind.inputs.iter().position(|spec| spec.name == port).unwrap();
            node.inputs[at].clone()
        };
        let ports = ["receiver", "objects", "rig", "env"].map(|port| wires("trace", port));
        let background = wires("final", "background");
        let only = ports.iter().chain([&background]).flatten().map(|wire| wire.node).collect();
        let outcome = engine.run(&graph, &RunOptions { only, ..RunOptions::default() }, |_| ());
        assert!(outcome.failures.is_none());
        fn value<A: Artifact>(engine: &Engine, graph: &Graph, wire: Wire) -> Arc<A> {
            Arc::new(engine.value(graph, wire).unwrap())
        }
        let [receiver, objects, rig, env] = &ports;
        Self {
            receiver: value(&engine, &graph, receiver[0]),
            objects: objects.iter().map(|wire| value(&engine, &graph, *wire)).collect(),
            rig: value(&engine, &graph, rig[0]),
            env: value(&engine, &graph, env[0]),
            background: value(&engine, &graph, background[0]),
        }
    }

    /// Renders all views with a seed. Returns the ratio `with / without` and the composited picture.
    fn traced(&self, params: &PathTrace, seed: u64) -> [Reported; 2] {
        let cx =
            Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed, exhaustive: false }, ".");
        let inputs = path_trace::In {
            receiver: self.receiver.clone(),
            objects: self.objects.clone(),
            rig: self.rig.clone(),
            env: self.env.clone(),
            points: None,
        };
        let (traced, _) = PathTrace::run(params, inputs, &cx).unwrap();
        let pair = shadow_ratio::In { without: traced.without.clone(), with: traced.with.clone() };
        let (ratio, _) = ShadowRatio::run(&ShadowRatio::default(), pair, &cx).unwrap();
        let layers = composite::In {
            background: self.background.clone(),
            object: traced.object,
            shadow: Some(ratio.shadow),
            added: None,
            front: None,
            variance: Some(traced.variance.clone()),
        };
        let (made, _) = Composite::run(&Composite::default(), layers, &cx).unwrap();

        let pairs = light(&traced.without).into_iter().zip(light(&traced.with));
        let reported = plane(&traced.variance, 3).into_iter();
        let ratio = pairs.zip(reported).map(|((without, with), variance)| {
            if without > 0.0 { [with / without, variance.sqrt()] } else { [1.0, 0.0] }
        });
        let picture = light(&made.image).into_iter().zip(plane(&made.error, 0));
        [ratio.collect(), picture.map(|(value, error)| [value, error]).collect()]
    }
}

impl TraceInputs {
    /// The results of [`traced`](Self::traced) for several seeds, in order of seed, computed on two threads.
    fn all_traced(&self, params: &PathTrace, seeds: std::ops::Range<u64>) -> Vec<[Reported; 2]> {
        let half = |first| move |seed: &u64| seed % 2 == first;
        let traced = |first: u64| -> Vec<[Reported; 2]> {
            seeds.clone().filter(half(first)).map(|seed| self.traced(params, seed)).collect()
        };
        let (even, odd) = std::thread::scope(|scope| {
            let odd = scope.spawn(|| traced(1));
            (traced(0), odd.join().unwrap())
        });
        let (mut even, mut odd) = (even.into_iter(), odd.into_iter());
        seeds.filter_map(|seed| if seed % 2 == 0 { even.next() } else { odd.next() }).collect()
    }

    /// True error of the ratio in each tile that has noisy pixels. As in the definition of `max_error`, this is the
    /// root mean square error over the noisy pixels of the tile, where the error of a pixel is divided by the true
    /// ratio if that ratio is above 1.
    fn tiles(&self, reported: &Reported, truth: &[f64]) -> Vec<f64> {
        let (mut errors, mut first) = (Vec::new(), 0);
        for camera in &self.rig.cameras {
            let (width, height) = (camera.width_px as usize, camera.height_px as usize);
            for tile in 0..width.div_ceil(TILE) * height.div_ceil(TILE) {
                let (x, y) = (tile % width.div_ceil(TILE) * TILE, tile / width.div_ceil(TILE) * TILE);
                let rows = (y..(y + TILE).min(height)).map(|y| first + y * width);
                let pixels = rows.flat_map(|row| (x..(x + TILE).min(width)).map(move |x| row + x));
                let squares: Vec<f64> = pixels
                    .filter(|&i| reported[i][1] > 0.0)
                    .map(|i| (reported[i][0] - truth[i]) / truth[i].max(1.0))
                    .map(|off| off * off)
                    .collect();
                if !squares.is_empty() {
                    errors.push((squares.iter().sum::<f64>() / squares.len() as f64).sqrt());
                }
            }
            first += width * height;
        }
        errors
    }
}

/// Luminance of each pixel, for all views in order.
fn light(images: &Images) -> Vec<f64> {
    let pixels = images.0.iter().flat_map(|view| view.picture.samples().chunks_exact(view.picture.size().2));
    pixels.map(|p| f64::from(luminance([p[0], p[1], p[2]]))).collect()
}

/// Value of one channel at each pixel, for all views in order.
fn plane(images: &Images, channel: usize) -> Vec<f64> {
    let pixels = images.0.iter().flat_map(|view| view.picture.samples().chunks_exact(view.picture.size().2));
    pixels.map(|p| f64::from(p[channel])).collect()
}

/// Counts of the pixels whose true value lies within 1, 2 and 3 standard errors, and sums from which mean errors
/// are computed.
#[derive(Default)]
struct Tally {
    within: [u64; 3],
    pixels: u64,
    off: f64,
    square: f64,
    reported: f64,
}

impl Tally {
    fn add(&mut self, reported: &Reported, truth: &[f64]) {
        for ([value, error], truth) in reported.iter().zip(truth).filter(|([_, error], _)| *error > 0.0) {
            let apart = value - truth;
            for (within, times) in self.within.iter_mut().zip([1.0, 2.0, 3.0]) {
                *within += u64::from(apart.abs() <= times * error);
            }
            (self.off, self.square, self.reported) =
                (self.off + apart, self.square + apart * apart, self.reported + error * error);
            self.pixels += 1;
        }
    }

    fn cells(&self, seeds: u64) -> String {
        let n = self.pixels as f64;
        let shares = self.within.map(|within| format!("{:.1} %", 100.0 * within as f64 / n));
        let ratio = (self.reported / self.square).sqrt();
        format!("{} | {} | {ratio:.2} | {:+.4}", self.pixels / seeds, shares.join(" | "), self.off / n)
    }
}

fn main() {
    let small = std::env::args().any(|word| word == "small");
    let Effort { seeds, truth: (truth_seeds, truth_samples), most } = if small { SMALL } else { WHOLE };
    println!(
        "| output | scene | samples | pixels with noise | within 1 | within 2 | within 3 | reported / true error | mean error |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let demo = ("width_px: 160, height_px: 120", "width_px: 64, height_px: 48");
    let beyond = Surroundings::Within { metres: 1.1, bounces: false };
    let scenes = [
        ("demo", TraceInputs::load("demo.ron", demo), beyond, Some(0.02)),
        (
            "bench case",
            TraceInputs::load("plaza.ron", ("resolution: 0.25", "resolution: 0.1")),
            Surroundings::Auto,
            None,
        ),
    ];
    let (mut rows, mut held): ([Vec<String>; 2], Vec<String>) = Default::default();
    for (name, place, surroundings, contact_metres) in scenes {
        let params = |samples, max_error| PathTrace {
            samples,
            max_error,
            surroundings,
            contact_metres,
            ..PathTrace::default()
        };
        let mut truth: [Vec<f64>; 2] = Default::default();
        for reported in place.all_traced(&params(truth_samples, None), 1000..1000 + truth_seeds) {
            for (truth, reported) in truth.iter_mut().zip(reported) {
                truth.resize(reported.len(), 0.0);
                truth
                    .iter_mut()
                    .zip(reported)
                    .for_each(|(sum, [value, _])| *sum += value / truth_seeds as f64);
            }
        }
        for (said, params) in [
            ("4", params(4, None)),
            ("16", params(16, None)),
            ("up to 256, `max_error: 0.03`", params(most, Some(ASKED))),
        ] {
            let mut tallies: [Tally; 2] = Default::default();
            let mut tiles = Vec::new();
            for reported in place.all_traced(&params, 0..seeds) {
                tiles.extend(place.tiles(&reported[0], &truth[0]));
                for ((tally, reported), truth) in tallies.iter_mut().zip(&reported).zip(&truth) {
                    tally.add(reported, truth);
                }
            }
            for (rows, tally) in rows.iter_mut().zip(&tallies) {
                rows.push(format!("{name} | {said} | {} |", tally.cells(seeds)));
            }
            if params.max_error.is_some() {
                let share = |times: f64| {
                    let within = tiles.iter().filter(|error| **error <= times * ASKED).count();
                    format!("{:.1} %", 100.0 * within as f64 / tiles.len() as f64)
                };
                let worst = tiles.iter().copied().fold(0.0, f64::max);
                let shares = [share(1.0), share(1.5), share(2.0)].join(" | ");
                held.push(format!("{name} | {} | {shares} | {worst:.3} |", tiles.len() as u64 / seeds));
            }
        }
    }
    for (of, rows) in ["ratio", "picture"].iter().zip(&rows) {
        rows.iter().for_each(|row| println!("| {of} | {row}"));
    }
    println!(
        "\n| scene | tiles with noise | true error of the ratio within 0.03 | within 0.045 | within 0.06 | worst of all |"
    );
    println!("|---|---|---|---|---|---|");
    held.iter().for_each(|row| println!("| {row}"));
}
