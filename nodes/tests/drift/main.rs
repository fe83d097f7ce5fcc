//! Measures the error of every node: the maximum and the 99.9th percentile. The reference is a slow float64
//! implementation that follows the definition of the node or, for nodes that take samples, the same node with a
//! finer setting. `docs/evidence/README.md` lists the nodes that need no such test.
//!
//! All results are deterministic, so `errors.tsv` is the same on every machine. If a line changes, a picture has
//! changed: look at the picture, then update the file with `UPDATE_GOLDEN=1`.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod direct;
mod ground;
mod lights;
mod means;
mod moved;
mod references;
mod scenes;

use std::fmt::Write as _;
use std::path::Path;

use engine::{Artifact, Engine, Graph, RunOptions, Source, SourceRoot, Store, Wire};
use scene::types::{Brackets, Environment, Images, Mesh, Panorama, Placed, Report, Rig, Splats, Views};

/// Permitted difference between metrics and their published definitions. It is not 0, because this crate uses the
/// rounded matrices, white points and curves of published tools.
const CONSTANTS: f64 = 1e-4;

/// Errors of one output.
struct Case {
    name: &'static str,
    against: &'static str,
    /// Maximum permitted error, independent of `errors.tsv`. It allows for the rounding of the format and for
    /// a different order of summation.
    bound: f64,
    errors: Vec<f64>,
}

/// A graph that was run, and the engine that ran it.
struct Run {
    engine: Engine,
    graph: Graph,
}

impl Run {
    fn new() -> Self {
        let engine = Engine::new(Store::in_memory(), 2, 1 << 30);
        let source = Source::new("graph.ron", include_str!("graph.ron"));
        let graph = Graph::parse(source, &nodes::registry(), SourceRoot::new(".")).unwrap();
        let options = RunOptions { only: (0..graph.nodes.len()).collect(), ..RunOptions::default() };
        assert!(engine.run(&graph, &options, |_| ()).failures.is_none());
        Self { engine, graph }
    }

    /// The value of the output `name`, which has the form `node.port`.
    fn value<A: Artifact>(&self, name: &str) -> A {
        let (node, port) = name.split_once('.').unwrap();
        let node = self.graph.find(node).unwrap();
        let port = self.graph.nodes[node].kind.outputs.iter().position(|spec| spec.name == port).unwrap();
        self.engine.value(&self.graph, Wire { node, port }).unwrap()
    }

    /// Samples of a picture of one view, as float64.
    fn picture(&self, name: &str) -> Vec<f64> {
        self.value::<Images>(name).0[0].picture.samples().iter().map(|v| f64::from(*v)).collect()
    }
}

fn apart(a: &[f64], b: &[f64]) -> Vec<f64> {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).collect()
}

/// Absolute differences of `a` and `b`, each divided by the absolute value of `b`, or by `share` of the mean if
/// that is larger.
fn relative(a: &[f64], b: &[f64], share: f64) -> Vec<f64> {
    let least = share * b.iter().map(|b| b.abs()).sum::<f64>() / b.len() as f64;
    a.iter().zip(b).map(|(a, b)| (a - b).abs() / b.abs().max(least)).collect()
}

fn cases(run: &Run) -> Vec<Case> {
    let (views, pano) = (run.value::<Views>("faces.views"), run.value::<Panorama>("pano.pano"));
    let brackets = run.value::<Brackets>("dark.brackets");
    let env: Vec<f64> = run.picture("env.image");
    let [without, with] = ["trace.without", "trace.with"].map(|name| run.picture(name));
    let (view, object) = (run.picture("view.colour"), run.picture("trace.object"));
    let (shadow, finished) = (run.picture("shadow.shadow"), run.picture("final.image"));
    let ratio = references::Ratio { epsilon: 1e-4, min_energy: 1e-3, gamma: 0.8, s_min: 0.05, lambda: 0.9 };
    let composite = references::composite(&view, &object, &shadow);
    let masks = ["object", "shadow", "rest", "contact"].map(|port| run.picture(&format!("masks.{port}")));
    let (stitched, seen) = references::stitch(&views, pano.image.size().0);
    let seam = |(k, error): (usize, f64)| (seen[k / 3] > 0.999).then_some(error);
    let panorama: Vec<f64> = pano.image.samples().iter().map(|v| f64::from(*v)).collect();
    let shown = references::shown(&finished, &view);
    let scores = references::scores(&shown, 64);
    let reported = references::scores_of(&run.value::<Report>("score.report"));
    let camera = &run.value::<Rig>("demo.rig").cameras[0];
    let splatted = scenes::splatted(&run.value::<Splats>("demo.splats"), camera);
    let nearest =
        scenes::nearest(&run.value::<Mesh>("demo.proxy"), &run.value::<Placed>("placed.placed"), camera);
    let around = run.value::<Panorama>("around.pano");
    let (belt, known) =
        scenes::belt(&run.value::<Splats>("demo.splats"), around.origin.expect("it is of a pose"), 96);
    let rows = run.picture("around.image");
    let off = apart(&rows[3 * 96 * 8..3 * 96 * 40], &belt).into_iter().enumerate();
    let around = off.filter_map(|(k, error)| (known[k / 3] > 0.999).then_some(error)).collect();
    let stands = ground::found(&run.value::<Mesh>("demo.proxy"), &run.value::<Placed>("raised.placed"), 0.5);
    let direct = direct::Direct::new(256);
    let [sun, shade, top] = [&direct.without, &direct.with, &direct.object];
    let layers = means::Layers {
        width: 64,
        without: without.clone(),
        with: with.clone(),
        object: object.clone(),
        depth: run.picture("trace.depth"),
        normal: run.picture("trace.normal"),
        variance: run.picture("trace.variance"),
    };
    let cleaned = ["clean.without", "clean.with", "clean.object"].map(|name| run.picture(name)).concat();
    let lights = [run.value::<Environment>("env.env"), run.value("demo.truth_env")];
    let exact = |name, bound, errors| Case { name, against: "float64", bound, errors };
    let finer = |name, against, bound, errors| Case { name, against, bound, errors };
    vec![
        finer(
            "stitch",
            "float64, 12x12 samples per pixel",
            0.05,
            apart(&panorama, &stitched).into_iter().enumerate().filter_map(seam).collect(),
        ),
        exact(
            "predict-exposure, exposures",
            1e-6,
            apart(&references::taken(&brackets), &references::exposed(&pano, &brackets)),
        ),
        exact("fuse-hdr, relative", 1e-6, relative(&env, &references::fuse(&pano, &brackets), 0.01)),
        exact("shadow-ratio", 1e-6, apart(&shadow, &ratio.of(&without, &with, 64))),
        exact(
            "alpha-shadow",
            1e-6,
            apart(&run.picture("grey.shadow"), &references::grey(&without, &with, 0.9)),
        ),
        exact("composite", 1e-6, apart(&finished, &composite)),
        exact("region-masks", 0.0, apart(&masks.concat(), &references::masks(&object, &shadow, 64))),
        exact("compare", 1e-9, apart(&reported[..4], &scores[..4])),
        exact("compare, FLIP and CIEDE2000 reported", CONSTANTS, apart(&reported[4..], &scores[4..])),
        exact(
            "compare, FLIP",
            CONSTANTS,
            apart(&run.picture("score.flip"), &references::flip(&shown[0], &shown[1], 64)),
        ),
        exact(
            "score-env",
            1e-9,
            apart(&lights::reported(&run.value("lights.report")), &lights::scores(&lights[0], &lights[1])),
        ),
        exact("splat-render, EWA as published", 1e-5, apart(&view, &splatted)),
        exact("splat-panorama, EWA as published", 1e-4, around),
        exact(
            "snap, metres and normal",
            1e-5,
            apart(&ground::reported(&run.value("stands.report")), &stands),
        ),
        // If no surface is hit, both are infinite.
        exact(
            "path-trace depth, relative",
            1e-5,
            relative(&layers.depth, &nearest, 0.0).into_iter().filter(|off| !off.is_nan()).collect(),
        ),
        exact("denoise, relative", 1e-4, relative(&cleaned, &layers.averaged(), 0.01)),
        finer(
            "path-trace direct R0, relative",
            "float64, all directions",
            1.0,
            relative(&sun[0], &sun[1], 0.5),
        ),
        finer(
            "path-trace direct R1, relative",
            "float64, all directions",
            1.0,
            relative(&shade[0], &shade[1], 0.5),
        ),
        finer(
            "path-trace direct object, relative",
            "float64, all directions",
            1.0,
            relative(&top[0], &top[1], 0.5),
        ),
        finer("splat-render, arithmetic", "F64", 1e-4, apart(&view, &run.picture("double.colour"))),
        finer(
            "splat-panorama, arithmetic",
            "F64",
            0.01,
            apart(&run.picture("around.image"), &run.picture("exact.image")),
        ),
        finer("splat-render", "F64, all splats", 0.1, apart(&view, &run.picture("finer.colour"))),
        finer(
            "path-trace R0, relative",
            "64 samples",
            10.0,
            relative(&without, &run.picture("traced.without"), 0.5),
        ),
        finer(
            "path-trace R1, relative",
            "64 samples",
            10.0,
            relative(&with, &run.picture("traced.with"), 0.5),
        ),
        finer("path-trace object", "64 samples", 1e3, apart(&object, &run.picture("traced.object"))),
        finer(
            "denoise R1, relative",
            "64 samples, as traced",
            10.0,
            relative(&run.picture("clean.with"), &run.picture("traced.with"), 0.5),
        ),
    ]
}

/// Largest value and 99.9th percentile.
fn summary(errors: &[f64]) -> [f64; 2] {
    let mut sorted = errors.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len() - 1;
    [sorted[last], sorted[last - last / 1000]]
}

/// Formats an error with four digits. An error below 1e-12 is only rounding in float64 sums, and is shown as
/// `<1e-12`.
fn digits(error: f64) -> String {
    match error {
        0.0 => "0".to_owned(),
        _ if error < 1e-12 => "<1e-12".to_owned(),
        _ => format!("{error:.3e}"),
    }
}

#[test]
fn no_error_drifts() {
    let (mut text, mut wrong) = ("node\treference\tvalues\tlargest\t99.9 %\n".to_owned(), String::new());
    for Case { name, against, bound, errors } in cases(&Run::new()) {
        let [largest, most] = summary(&errors);
        if largest.is_nan() || largest > bound {
            writeln!(wrong, "{name} is off by {largest}, which may be {bound}").unwrap();
        }
        let [largest, most] = [largest, most].map(digits);
        writeln!(text, "{name}\t{against}\t{}\t{largest}\t{most}", errors.len()).unwrap();
    }
    assert!(wrong.is_empty(), "{wrong}\n{text}");
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/drift/errors.tsv");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        return std::fs::write(file, text).unwrap();
    }
    let known = std::fs::read_to_string(file).unwrap();
    for (line, known) in text.lines().zip(known.lines()) {
        assert_eq!(line, known, "if it is meant, run with UPDATE_GOLDEN=1");
    }
    assert_eq!(text.lines().count(), known.lines().count());
}

/// The light of each pixel agrees with the sum over all directions, within the noise that the reported variance of
/// the pixel predicts. The mean of the differences is 0 within its standard error.
#[test]
fn direct_light_is_that_of_all_directions() {
    let direct = direct::Direct::new(64);
    let luminance = |v: &Vec<f64>| v.chunks_exact(3).map(references::luminance).collect::<Vec<_>>();
    for ([traced, expected], variance) in [&direct.without, &direct.with].into_iter().zip(&direct.variance) {
        let off = luminance(traced).into_iter().zip(luminance(expected)).zip(variance);
        let off: Vec<f64> =
            off.filter(|(_, variance)| **variance > 0.0).map(|((a, b), v)| (a - b) / v.sqrt()).collect();
        let n = off.len() as f64;
        let (mean, square) = (off.iter().sum::<f64>() / n, off.iter().map(|z| z * z).sum::<f64>() / n);
        assert!(n > 100.0 && mean.abs() < 4.0 / n.sqrt(), "{mean} of {n}");
        assert!(square < 1.3, "{square}");
    }
    // The top of the box sees all of the sky, so its light is limited by the samples alone.
    let [traced, expected] = direct.object.map(|light| light.iter().sum::<f64>());
    assert!((traced / expected - 1.0).abs() < 0.01, "{traced} {expected}");
}
