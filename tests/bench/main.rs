//! Tests of `lightharmony bench`: a small set, mistakes in a set, pictures of other methods, the order of distortions.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test may stop at the first surprise")]

mod distortions;
#[allow(dead_code, reason = "other tests use the rest")]
#[path = "../support/program.rs"]
mod program;
mod set;

use set::{CASES, Sets, shown, write};

/// This test fails if a baseline is scored in place of the method, if regions are confused, or if cases are left out.
#[test]
fn a_set_has_scores_by_region_with_intervals_and_a_page() {
    let sets = Sets::new(3);
    let (code, _, plan) = sets.bench(&["--samples", "16", "--plan"]);
    assert_eq!(code, 0, "{plan}");
    assert!(
        plan.contains("cases: 3, scenes: 2, views: 6, tiers: true-light; to do: at most 9 path traces"),
        "{plan}"
    );
    assert!(!sets.place.path("bench/tables.md").exists());
    let (code, stdout, errors) = sets.bench(&["--samples", "16"]);
    assert_eq!(code, 0, "{errors}");
    assert_eq!(
        stdout,
        "bench/tables.md\nbench/tables.csv\nbench/tables.tex\nbench/scores.csv\nbench/index.html\n"
    );
    let psnr = |region, picture| sets.mean(region, picture, "PSNR (dB)");
    // The truth has the same renderer: only noise is left of the method.
    assert!(psnr("shadow", "lightharmony") > psnr("shadow", "no shadow") + 6.0);
    assert!(psnr("object", "lightharmony") > psnr("object", "nothing inserted") + 10.0);
    assert!(psnr("object", "lightharmony") > psnr("object", "LDR light") + 6.0);
    // Soft edges of the object belong to the shadow here, since the truth has a binary mask.
    assert!((psnr("shadow", "no shadow") - psnr("shadow", "nothing inserted")).abs() < 1.0);
    let log = |picture| sets.mean("shadow", picture, "log-ratio error");
    assert!(
        log("lightharmony") < 0.4 * log("nothing inserted"),
        "{} {}",
        log("lightharmony"),
        log("nothing inserted")
    );
    // In dB, the perfect ratio is limited by these edges as the method is; its error of the ratio is that of 8 bits.
    assert!(log("perfect ratio") < log("lightharmony"), "{} {}", log("perfect ratio"), log("lightharmony"));
    // Two scenes: the interval reaches from one to the other. Cases of one scene are one value.
    let scores = sets.output("scores.csv");
    let case = |name: &str| {
        let of = |line: &&str| line.contains(&format!(",{name},")) && line.contains(",lightharmony,object,");
        let values: Vec<f64> =
            scores.lines().filter(of).map(|line| line.split(',').nth(7).unwrap().parse().unwrap()).collect();
        assert_eq!(values.len(), 2, "{scores}");
        (values[0] + values[1]) / 2.0
    };
    let [a, b, c] = CASES.map(|(name, ..)| case(name));
    let yard = (a + b) / 2.0;
    let line = sets.output("tables.csv");
    let line = line
        .lines()
        .find(|line| line.starts_with("true-light,object,lightharmony,PSNR (dB),"))
        .unwrap()
        .to_owned();
    let numbers: Vec<f64> = line.split(',').skip(4).map(|n| n.parse().unwrap()).collect();
    let wanted = [(yard + c) / 2.0, yard.min(c), yard.max(c), 2.0, 3.0];
    assert!(numbers.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-9), "{numbers:?} {wanted:?}");
    let page = sets.output("index.html");
    for part in page.split("src=\"").skip(1) {
        let path = part.split('"').next().unwrap();
        assert!(sets.place.path("bench").join(path).is_file(), "{path}");
    }
    assert!(page.matches("<img").count() == 6 * 7, "{}", page.matches("<img").count());
    assert!(
        sets.output("tables.md").contains("| true-light | yard | 2 | ")
            && sets.output("tables.tex").contains("\\toprule")
    );
    // Nothing is computed twice, and the graph is one for `run`.
    let (code, _, errors) = sets.bench(&["--samples", "16"]);
    assert!(code == 0 && errors.contains("0 ran"), "{errors}");
    let again = sets.place.call(&["run", "bench/graph/bench.ron", "--out", "bench"]);
    assert!(again.status.success() && String::from_utf8_lossy(&again.stderr).contains("0 ran"));
}

/// This test fails if a mistake hides another one, or if its file or field is not named.
#[test]
fn all_mistakes_of_a_set_are_reported_together() {
    let sets = Sets::new(2);
    let change = |path: &str, from: &str, to: &str| {
        let path = sets.folder().join(path);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{text}");
        write(&path, &text.replace(from, to));
    };
    change("set.json", "\"seed\":5", "\"seed\":-1");
    change("set.json", "\"yard-2\"", "\"yard-2\",\"gone\",\"9x\",\"yard-2\"");
    change("set.json", "\"licence\"", "\"license\"");
    change("yard-1/case.json", "\"scale\":1.0", "\"scale\":0.0");
    change("yard-1/case.json", "\"probe\":[0.0,0.0,0.3]", "\"probe\":[0.0,0.0]");
    change("yard-1/case.json", "\"box.obj\"", "\"../../box.obj\"");
    change("yard-1/case.json", "\"mesh.ply\"", "\"no.ply\"");
    change("yard-1/case.json", "\"version\":1", "\"version\":2");
    change("yard-2/case.json", "\"name\":\"yard-2\"", "\"name\":\"yard-3\"");
    change("yard-2/case.json", "\"tags\"", "\"tag\"");
    change("yard-2/views.json", "view_1.png", "view_7.png");
    change("yard-2/views.json", "\"h\":48", "\"h\":0");
    std::fs::remove_file(sets.case("yard-1").join("truth/view_0/with.exr")).unwrap();
    write(&sets.case("yard-1").join("truth/view_1/alpha.exr"), "not a picture");
    std::fs::copy(
        sets.case("yard-1").join("truth/light.exr"),
        sets.case("yard-1").join("truth/view_1/depth.exr"),
    )
    .unwrap();
    std::fs::copy(
        sets.case("yard-2").join("truth/view_0/depth.exr"),
        sets.case("yard-2").join("truth/light.exr"),
    )
    .unwrap();
    let (code, stdout, errors) = sets.bench(&[]);
    assert_eq!((code, stdout.as_str()), (2, ""));
    let wanted = [
        "set.json, `seed`: takes a whole number of at least 0, not `-1`",
        "set.json, `cases`: `9x` is not a name",
        "set.json, `cases`: `yard-2` appears twice",
        "set.json, `licence`: is missing",
        "set.json, `license`: is not a field of this file; did you mean `licence`?",
        "gone/case.json: cannot be read",
        "yard-1/case.json, `pose.scale`: takes a number above 0, not `0.0`",
        "yard-1/case.json, `probe`: takes 3 numbers in [ ], not `[0.0,0.0]`",
        "yard-1/case.json, `object`: `../../box.obj` leads out of the set",
        "yard-1/case.json, `mesh`: `no.ply` does not exist",
        "yard-1/case.json, `version`: version 2 is not supported",
        "yard-1/truth/view_0/with.exr: does not exist",
        "yard-1/truth/view_1/alpha.exr: is not a picture",
        "yard-1/truth/view_1/depth.exr: has 64x32 pixels, but its camera in `views.json` has 72x48",
        "yard-2/case.json, `name`: is `yard-3`, but the folder is `yard-2`",
        "yard-2/case.json, `tags`: is missing",
        "yard-2/case.json, `tag`: is not a field of this file; did you mean `tags`?",
        "yard-2/views.json, `frames`: no frame has the `file_path` `view_1.png`",
        "yard-2/views.json, `h`: the frame `view_0` has no size",
        "yard-2/truth/light.exr: has 72x48 pixels; the width must be twice the height",
    ];
    for text in wanted {
        assert!(errors.contains(text), "{text} in\n{errors}");
    }
    // `yard-2` is named twice, and so are its mistakes.
    let lines =
        errors.lines().filter(|line| line.starts_with("  ")).collect::<std::collections::BTreeSet<_>>().len();
    assert_eq!(lines, wanted.len(), "{errors}");
}

#[test]
fn checksums_name_each_file_that_differs() {
    let sets = Sets::new(1);
    let (code, _, errors) = sets.bench(&["--check"]);
    assert!(code == 2 && errors.contains("SHA256SUMS: cannot be read"), "{errors}");
    // As `sha256sum` prints for an empty file and for the text "a".
    write(&sets.folder().join("about.txt"), "");
    let empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
    write(
        &sets.folder().join("SHA256SUMS"),
        &format!("{empty}  about.txt\n{empty}  set.json\n{empty}  gone\nzz  x\n"),
    );
    let (_, _, errors) = sets.bench(&["--check"]);
    for text in [
        "set.json: has the digest",
        "gone: is listed in SHA256SUMS, but does not exist",
        "SHA256SUMS: does not list `yard-1/case.json`",
        "SHA256SUMS, `line 4`: is not a digest",
    ] {
        assert!(errors.contains(text), "{text} in {errors}");
    }
    assert!(!errors.contains("about.txt"), "{errors}");
}

#[test]
fn mistakes_of_the_command_line_are_refused_with_a_remedy() {
    let sets = Sets::new(2);
    let folder = sets.place.path("others");
    std::fs::create_dir_all(folder.join("blender/yard-1")).unwrap();
    write(&sets.place.path("none.ron"), "Graph(version: 1, nodes: (a: Pose()))");
    let others = shown(&folder);
    for (arguments, text) in [
        (&["--case", "yard-3"][..], "did you mean `yard-"),
        (&["--tier", "trained"], "cannot be run yet"),
        (&["--tier", "true"], "is not a tier; write one of true-light, recovered-light, splats"),
        (&["--tier", "splats"], "yard-1 (splats): the case has no splats; add them"),
        (&["--graph", "none.ron"], "it has no node `final`"),
        (&["--methods", &others], "has no case with pictures of all views"),
        (&["--set", "trace.sample=4"], "did you mean `samples`?"),
        (&["--set", "samples"], "is not a setting"),
    ] {
        let (code, _, errors) = sets.bench(arguments);
        assert!(code == 2 && errors.contains(text), "{text} in {errors}");
    }
}

/// This test fails if a setting reaches one case only, or if the built-in graph is run in place of another.
#[test]
fn any_graph_is_a_method_and_settings_reach_it_in_all_cases() {
    let sets = Sets::new(2);
    let graph = "Graph(version: 1, parameters: (rig: Required, background: Required, placed: Required, mesh: Required, env: Required),
        nodes: (trace: PathTrace(receiver: Param(\"mesh\"), objects: [Param(\"placed\")], rig: Param(\"rig\"), env: Param(\"env\"),
        samples: 4), final: Composite(background: Param(\"background\"), object: \"trace.object\")))";
    write(&sets.place.path("bare.ron"), graph);
    let (code, _, errors) =
        sets.bench(&["--graph", "bare.ron", "--samples", "4", "--set", "trace.shadow_only=true"]);
    assert_eq!(code, 0, "{errors}");
    // Without an object nothing is inserted, in every case.
    for region in ["object", "shadow"] {
        let psnr = |picture| sets.mean(region, picture, "PSNR (dB)");
        assert_eq!(psnr("bare"), psnr("nothing inserted"));
        assert_ne!(psnr("bare"), psnr("perfect ratio"));
    }
}
