//! Known distortions of an insertion, each at four strengths, scored as pictures of other methods: the errors must rank
//! by strength.

use crate::set::{CASES, Sets, TRUTH_SAMPLES, nodes, shown, write};

/// A distortion: its name, the region and the metric that must rank it, and the nodes that replace `trace`, `ratio` and
/// `final` at a strength from 1 to 4.
struct Distortion {
    name: &'static str,
    region: &'static str,
    /// Metrics whose error must grow with the strength.
    metrics: &'static [&'static str],
    /// The nodes of a strength, with `{n}` in their names, ending in a node `final{n}`.
    nodes: fn(usize) -> String,
}

/// The object traced at another pose or in other light, as the nodes `o{n}`.
fn traced(pose: &str, env: &str) -> String {
    format!(
        "pose{{n}}: Pose({pose}), placed{{n}}: Place(object: \"object\", pose: \"pose{{n}}\"),
         env{{n}}: LoadEnvironment(path: \"truth/light.exr\", origin: (0.0, 0.0, 0.3), {env}),
         trace{{n}}: PathTrace(receiver: \"mesh\", objects: [\"placed{{n}}\"], rig: \"rig\", env: \"env{{n}}\", samples: {TRUTH_SAMPLES}),
         ratio{{n}}: ShadowRatio(without: \"trace{{n}}.without\", with: \"trace{{n}}.with\", s_max: 4.0),"
    )
}

const AT: &str = "translation: (0.0, 0.0, 0.0), yaw_deg: 20.0";
const SHADOW: &[&str] = &["PSNR (dB)", "FLIP", "log-ratio error"];
const OBJECT: &[&str] = &["PSNR (dB)", "FLIP"];

fn final_of(object: &str, ratio: &str) -> String {
    format!(
        "final{{n}}: Composite(background: \"trace.without\", object: \"{object}\", shadow: \"{ratio}\"),"
    )
}

const DISTORTIONS: [Distortion; 8] = [
    Distortion {
        name: "shadow-light",
        region: "shadow",
        metrics: SHADOW,
        nodes: |n| {
            let lambda = [0.85, 0.6, 0.3, 0.0][n - 1];
            format!(
                "r{{n}}: ShadowRatio(without: \"trace.without\", with: \"trace.with\", lambda: {lambda:?}),"
            ) + &final_of("trace.object", "r{n}")
        },
    },
    Distortion {
        name: "shadow-soft",
        region: "shadow",
        metrics: SHADOW,
        nodes: |n| {
            let gamma = [0.85, 0.6, 0.35, 0.1][n - 1];
            format!(
                "r{{n}}: ShadowRatio(without: \"trace.without\", with: \"trace.with\", gamma: {gamma:?}),"
            ) + &final_of("trace.object", "r{n}")
        },
    },
    Distortion {
        name: "shadow-shifted",
        region: "shadow",
        metrics: SHADOW,
        nodes: |n| {
            let x = [0.03, 0.08, 0.16, 0.32][n - 1];
            traced(&format!("translation: ({x:?}, 0.0, 0.0), yaw_deg: 20.0"), "")
                + &final_of("trace.object", "ratio{n}")
        },
    },
    Distortion {
        name: "shadow-doubled",
        region: "shadow",
        metrics: SHADOW,
        nodes: |n| {
            // The ratio is applied again to a part of itself: S, S^1.x by a second composite of the shadow alone.
            let lambda = [0.2, 0.45, 0.7, 1.0][n - 1];
            format!(
                "r{{n}}: ShadowRatio(without: \"trace.without\", with: \"trace.with\", lambda: {lambda:?}),
                 once{{n}}: Composite(background: \"trace.without\", object: \"nothing.object\", shadow: \"ratio\"),
                 final{{n}}: Composite(background: \"once{{n}}\", object: \"trace.object\", shadow: \"r{{n}}\"),"
            )
        },
    },
    Distortion {
        name: "object-bright",
        region: "object",
        metrics: OBJECT,
        nodes: |n| {
            let scale = [1.15, 1.4, 1.9, 3.0][n - 1];
            traced(AT, &format!("scale: {scale:?}")) + &final_of("trace{n}.object", "ratio")
        },
    },
    Distortion {
        name: "object-dark",
        region: "object",
        metrics: OBJECT,
        nodes: |n| {
            let scale = [0.85, 0.65, 0.4, 0.1][n - 1];
            traced(AT, &format!("scale: {scale:?}")) + &final_of("trace{n}.object", "ratio")
        },
    },
    Distortion {
        name: "light-turned",
        region: "shadow",
        metrics: SHADOW,
        nodes: |n| {
            let turn = [6.0, 15.0, 35.0, 80.0][n - 1];
            traced(AT, &format!("rotation_deg: {turn:?}")) + &final_of("trace{n}.object", "ratio{n}")
        },
    },
    Distortion {
        name: "floating",
        region: "shadow",
        metrics: SHADOW,
        nodes: |n| {
            // Above 0.08 m, the region has no shadow at all.
            let z = [0.004, 0.01, 0.03, 0.08][n - 1];
            traced(&format!("translation: (0.0, 0.0, {z:?}), yaw_deg: 20.0"), "")
                + &final_of("trace{n}.object", "ratio{n}")
        },
    },
];

/// This test fails if regions, the ratio or a metric are computed from other pictures than those of the method, or if the
/// sign of a metric is wrong.
#[test]
fn distortions_rank_by_their_strength() {
    let sets = Sets::new(1);
    let (case, _, position) = CASES[0];
    let mut text = format!(
        "Graph(version: 1, scene: (up: \"+z\", seed: 11), nodes: ({}",
        nodes(position, TRUTH_SAMPLES)
    );
    text.push_str("nothing: PathTrace(receiver: \"mesh\", objects: [\"placed\"], rig: \"rig\", env: \"env\", samples: 1, shadow_only: true),\n");
    for distortion in &DISTORTIONS {
        for strength in 1..=4 {
            let id = format!("_{}_{strength}", distortion.name.replace('-', "_"));
            text.push_str(&(distortion.nodes)(strength).replace("{n}", &id));
            text.push_str(&format!(
                "save{id}: WriteImage(image: \"final{id}\", path: \"{}-{strength}/{case}/{{view}}.png\"),\n",
                distortion.name
            ));
        }
    }
    text.push_str("))");
    let graph = sets.case(case).join("distortions.ron");
    write(&graph, &text);
    let out = sets.place.call(&["run", &shown(&graph), "--out", "others"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let (code, _, errors) = sets.bench(&["--samples", "4", "--methods", "others"]);
    assert_eq!(code, 0, "{errors}");
    let mut wrong = Vec::new();
    for distortion in &DISTORTIONS {
        for metric in distortion.metrics {
            let means: Vec<f64> = (1..=4)
                .map(|strength| {
                    sets.mean(distortion.region, &format!("{}-{strength}", distortion.name), metric)
                })
                .map(|mean| if metric.starts_with("PSNR") { -mean } else { mean })
                .collect();
            if !means.is_sorted_by(|a, b| a < b) {
                wrong.push(format!("{}, {metric}: {means:?}", distortion.name));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
