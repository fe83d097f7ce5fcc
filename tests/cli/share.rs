//! Tests of sharing a graph: as a bundle, as a picture with its recipe, with a lock.

use std::path::Path;
use std::process::Output;

use crate::Place;

const GRAPH: &str = r#"Graph(version: 1, scene: (up: "+z"), nodes: (
    photo: LoadImage(path: "../photos/small.hdr"), // a remark
    mask:  LoadImage(path: "mask.hdr", encoding: Data),
    save:  WriteImage(image: "photo", path: "deep/view.png"),
    jpeg:  WriteImage(image: "photo", path: "view.jpg"),
    float: WriteExr(layers: ["photo", "mask"], names: ["L", "M"], path: "view.exr"),
    bare:  WriteImage(image: "mask", path: "bare.png", recipe: false),
))
"#;

/// A Radiance picture of 3 x 2 pixels.
fn radiance(shift: u8) -> Vec<u8> {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n".to_vec();
    bytes.extend((0..6).flat_map(|i| [20 * i + shift, 90, 200 - i, 128]));
    bytes
}

/// A folder with a graph that reads a file next to the graph and a file in another folder.
fn place() -> Place {
    let place = Place::new("");
    for folder in ["project", "photos"] {
        std::fs::create_dir_all(place.path(folder)).unwrap();
    }
    std::fs::write(place.path("project/graph.ron"), GRAPH).unwrap();
    std::fs::write(place.path("project/mask.hdr"), radiance(9)).unwrap();
    std::fs::write(place.path("photos/small.hdr"), radiance(0)).unwrap();
    place
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn good(output: Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stdout)
}

/// Checks that the exit code is `code`, and returns the error message.
fn bad(output: Output, code: i32) -> String {
    assert_eq!(output.status.code(), Some(code), "{}{}", text(&output.stdout), text(&output.stderr));
    text(&output.stderr)
}

fn pack(place: &Place, bundle: &str) -> Vec<u8> {
    good(place.call(&["run", "project/graph.ron"]));
    good(place.call(&["pack", "project/graph.ron", bundle, "--results", "all"]));
    std::fs::read(place.path(bundle)).unwrap()
}

#[test]
fn a_bundle_is_verified_and_run_elsewhere() {
    let (here, there) = (place(), Place::new(""));
    let bytes = pack(&here, "a.lhb");
    assert!(bytes == pack(&place(), "b.lhb"), "from another folder and cache: the same bytes");
    std::fs::write(there.path("a.lhb"), &bytes).unwrap();

    let reported = good(there.call(&["verify", "a.lhb", "--all"]));
    assert_eq!(reported.lines().filter(|line| line.starts_with("equal")).count(), 6, "{reported}");
    let listed = good(there.call(&["unpack", "a.lhb", "--list"]));
    assert!(listed.contains("inputs/0/small.hdr") && !there.path("a").exists(), "{listed}");

    // Run as it is, and unpacked.
    good(there.call(&["run", "a.lhb", "--out", "one"]));
    assert_eq!(good(there.call(&["unpack", "a.lhb"])), "a/graph.ron\n");
    good(there.call(&["run", "a/graph.ron", "--out", "two", "--locked"]));
    let mut cold = there.command(&["run", "a.lhb", "--out", "three"]);
    good(cold.env("LIGHTHARMONY_CACHE", there.path("other")).output().unwrap());
    for out in ["one", "two", "three"] {
        for file in ["deep/view.png", "view.jpg", "view.exr", "bare.png"] {
            let read = |place: &Place, folder: &str| std::fs::read(place.path(folder).join(file)).unwrap();
            assert!(read(&here, "out") == read(&there, out), "{out}/{file}");
        }
    }
    // With trusted results nothing runs.
    let mut trusting = there.command(&["unpack", "a.lhb", "c", "--trust-results"]);
    good(trusting.env("LIGHTHARMONY_CACHE", there.path("third")).output().unwrap());
    let mut reported = there.command(&["run", "c/graph.ron", "--json", "--out", "four"]);
    let reported = good(reported.env("LIGHTHARMONY_CACHE", there.path("third")).output().unwrap());
    assert!(reported.contains("\"ran\":0") && there.path("four/deep/view.png").exists(), "{reported}");

    let differences = here.call(&["diff", "project/graph.ron", "a.lhb"]);
    assert_eq!(differences.status.code(), Some(1));
    let differences = text(&differences.stdout);
    assert!(differences.contains("~ photo.path") && differences.contains("results compared: 6, all equal"));
}

#[test]
fn a_damaged_or_hostile_bundle_leaves_nothing() {
    let place = place();
    let bytes = pack(&place, "a.lhb");
    let folder = |name: &str| place.path(name);
    for (name, bytes) in [
        ("cut.lhb", bytes[..bytes.len() - 1].to_vec()),
        ("long.lhb", [&bytes[..], b"x"].concat()),
        ("flip.lhb", bytes.iter().enumerate().map(|(i, b)| b ^ u8::from(i == bytes.len() - 3)).collect()),
        ("empty.lhb", Vec::new()),
        ("text.lhb", b"Graph()".to_vec()),
    ] {
        std::fs::write(folder(name), bytes).unwrap();
        for verb in ["unpack", "verify"] {
            let errors = bad(place.call(&[verb, name]), 2);
            assert!(errors.contains(name) && errors.lines().count() == 1, "{verb} {name}: {errors}");
        }
        assert!(!folder(name).with_extension("").exists());
    }
    std::fs::create_dir_all(folder("full/of")).unwrap();
    assert!(bad(place.call(&["unpack", "a.lhb", "full"]), 2).contains("exists already"));
}

#[test]
fn a_picture_is_made_again_where_its_inputs_are_at_hand() {
    let place = place();
    good(place.call(&["run", "project/graph.ron"]));
    let out = |name: &str| std::fs::read(place.path("out").join(name)).unwrap();
    for name in ["deep/view.png", "view.jpg", "view.exr"] {
        let picture = format!("out/{name}");
        let errors = bad(place.call(&["run", &picture, "--out", "again"]), 2);
        assert!(errors.contains("`small.hdr` with the digest") && errors.contains("--inputs"), "{errors}");
        let mut again = place.command(&[
            "run", &picture, "--out", "again", "--inputs", "project", "--inputs", "photos", "--cache",
            "fresh",
        ]);
        good(again.output().unwrap());
        let file = Path::new(name).file_name().unwrap();
        let read = |path: std::path::PathBuf| std::fs::read(path).unwrap();
        assert!(read(place.path("again").join(file)) == read(place.path("out").join(name)), "{name}");
    }
    assert!(bad(place.call(&["run", "out/bare.png"]), 2).contains("has no recipe"));
    assert!(!text(&out("bare.png")).contains("LoadImage"), "a recipe can be left out");

    // Another file of the same name is refused.
    std::fs::write(place.path("photos/small.hdr"), radiance(1)).unwrap();
    let arguments = ["run", "out/view.jpg", "--inputs", "project", "--inputs", "photos"];
    assert!(bad(place.call(&arguments), 2).contains("`small.hdr` with the digest"));
    // Another version of a kind is reported.
    let mut picture = out("view.jpg");
    let place_of = picture.windows(11).position(|w| w == b"load-image ").unwrap();
    picture[place_of + 11] = b'9';
    std::fs::write(place.path("old.jpg"), &picture).unwrap();
    let errors = bad(place.call(&["plan", "old.jpg"]), 2);
    assert!(
        errors.contains("made with version 90 of `load-image`") && errors.contains("--other-versions"),
        "{errors}"
    );
}

#[test]
fn a_untrusted_graph_stays_inside() {
    let (here, place) = (place(), Place::new(""));
    std::fs::write(place.path("a.lhb"), pack(&here, "a.lhb")).unwrap();
    good(place.call(&["unpack", "a.lhb"]));
    std::fs::write(place.path("secret.hdr"), radiance(3)).unwrap();
    let graph = std::fs::read_to_string(place.path("a/graph.ron")).unwrap();
    std::fs::write(place.path("a/graph.ron"), graph.replace("inputs/0/small.hdr", "../secret.hdr")).unwrap();
    let errors = bad(place.call(&["run", "a/graph.ron"]), 2);
    assert!(errors.contains("may not be read") && errors.contains("--inputs"), "{errors}");
    assert!(bad(place.call(&["run", "a/graph.ron", "--locked", "--inputs", "."]), 2).contains("secret.hdr"));
    good(place.call(&["run", "a/graph.ron", "--inputs", "."]));
    std::fs::remove_file(place.path("a/.lightharmony-bundle")).unwrap();
    good(place.call(&["run", "a/graph.ron"]));
    assert!(
        bad(place.call(&["run", "a/graph.ron", "--inputs", "."]), 2).contains("`--inputs` is for bundles")
    );
}

#[test]
fn no_way_leads_around_the_mark_of_a_bundle() {
    let (here, place) = (place(), Place::new(""));
    std::fs::write(place.path("a.lhb"), pack(&here, "a.lhb")).unwrap();
    std::fs::write(place.path("secret.hdr"), radiance(3)).unwrap();
    good(place.call(&["unpack", "a.lhb"]));
    // A graph below the folder of the bundle, which reads inside it and not outside.
    let deep = |path: &str| {
        let graph = format!(
            "Graph(version: 1, scene: (up: \"+z\"), nodes: (p: LoadImage(path: \"{path}\"), s: WriteImage(image: \"p\", path: \"p.png\"),))"
        );
        std::fs::create_dir_all(place.path("a/deep")).unwrap();
        std::fs::write(place.path("a/deep/e.ron"), graph).unwrap();
        place.call(&["run", "a/deep/e.ron"])
    };
    good(deep("../mask.hdr"));
    assert!(bad(deep("../../secret.hdr"), 2).contains("may not be read"));
    let secret = place.path("secret.hdr");
    assert!(bad(deep(secret.to_str().unwrap()), 2).contains("may not be read"));
    // A graph of the user that would read it on behalf of the bundle.
    std::fs::write(place.path("a/over.ron"), "Overlay(nodes: (p: (path: \"secret.hdr\")))").unwrap();
    for (name, text) in [
        ("one.ron", "Graph(version: 1, include: [\"a/graph.ron\"], nodes: ())"),
        ("two.ron", "Graph(version: 1, scene: (up: \"+z\"), nodes: (x: Subgraph(graph: \"a/graph.ron\"),))"),
    ] {
        std::fs::write(place.path(name), text).unwrap();
        let errors = bad(place.call(&["check", name]), 2);
        assert!(
            errors.contains("`a/graph.ron` belongs to an unpacked bundle") && errors.contains("remove"),
            "{errors}"
        );
    }
    let own = "Graph(version: 1, scene: (up: \"+z\"), nodes: (p: LoadImage(path: \"secret.hdr\"),))";
    std::fs::write(place.path("own.ron"), own).unwrap();
    let errors = bad(place.call(&["check", "own.ron", "--overlay", "a/over.ron"]), 2);
    assert!(errors.contains("`a/over.ron` belongs to an unpacked bundle"), "{errors}");
    // An untrusted graph that includes a forbidden file is refused with the reason.
    std::fs::write(place.path("a/deep/e.ron"), "Graph(version: 1, include: [\"../../own.ron\"], nodes: ())")
        .unwrap();
    assert!(bad(place.call(&["check", "a/deep/e.ron"]), 2).contains("`../../own.ron` may not be read"));
    std::fs::remove_file(place.path("a/.lightharmony-bundle")).unwrap();
    good(place.call(&["check", "own.ron", "--overlay", "a/over.ron"]));
    good(place.call(&["check", "one.ron", "--only", "bare"]));
}

#[test]
fn nothing_is_written_over_what_a_graph_reads() {
    let place = Place::new("");
    std::fs::write(place.path("small.hdr"), radiance(0)).unwrap();
    let node = |name: &str, of: &str, to: &str| {
        format!("{name}: LoadImage(path: \"{of}\"), s{name}: WriteImage(image: \"{name}\", path: \"{to}\"),")
    };
    let graph = |include: &str, nodes: &str| {
        format!("Graph(version: 1, include: {include}, scene: (up: \"+z\"), nodes: ({nodes}))")
    };
    place.write(&graph("[]", &node("p", "small.hdr", "p.png")));
    good(place.call(&["run", "graph.ron", "--out", "."]));
    std::fs::write(place.path("part.ron"), graph("[]", &node("q", "./p.png", "q.png"))).unwrap();
    place.write(&graph("[\"part.ron\"]", &node("p", "small.hdr", "{view}.png")));
    std::fs::write(place.path("over.ron"), "Overlay(nodes: (q: (encoding: Srgb)))").unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink("p.png", place.path("link.png")).unwrap();
    let read = ["graph.ron", "part.ron", "over.ron", "small.hdr", "p.png"];
    let bytes = || read.map(|name| std::fs::read(place.path(name)).unwrap());
    let before = bytes();
    for name in read {
        let way = place.path("out").join("..").join(name);
        for verb in ["lock --to", "run --trace", "pack", "report --out", "tune --max-error flip=0.1 --out"] {
            let (verb, rest) = verb.split_once(' ').unwrap_or((verb, ""));
            let mut arguments = vec![verb, "graph.ron", "--overlay", "over.ron"];
            arguments.extend(rest.split_whitespace().chain([way.to_str().unwrap()]));
            let errors = bad(place.call(&arguments), 2);
            assert!(errors.contains("is the graph or a file that it reads"), "{arguments:?}: {errors}");
        }
    }
    for (path, out) in [("p.png", "."), ("./p.png", "out/.."), ("link.png", ".")] {
        let set = format!("sq.path={path}");
        if cfg!(unix) || path != "link.png" {
            let run = ["run", "graph.ron", "--out", out, "--set", &set, "--only", "sq"];
            let errors = bad(place.call(&run), 2);
            assert!(errors.contains("which the graph reads") && errors.contains("`sq`"), "{errors}");
        }
    }
    // Known only once it runs: the view is named `image`.
    place.write(&graph("[]", &node("p", "small.hdr", "{view}.png")));
    good(place.call(&["run", "graph.ron", "--out", "."]));
    let made = std::fs::read_dir(place.folder.path()).unwrap().flatten().map(|entry| entry.file_name());
    let made: Vec<String> = made.filter_map(|name| name.into_string().ok()).collect();
    let view = made
        .iter()
        .find(|name| name.ends_with(".png") && !["p.png", "link.png"].contains(&&***name))
        .unwrap();
    place.write(&graph("[\"part.ron\"]", &node("p", view, "{view}.png")));
    let errors = bad(place.call(&["run", "graph.ron", "--out", ".", "--set", "sp.recipe=false"]), 1);
    assert!(errors.contains("which the graph reads"), "{errors}");
    std::fs::write(place.path("graph.ron"), &before[0]).unwrap();
    assert!(before == bytes());
}

#[test]
fn a_locked_run_refuses_what_differs() {
    let place = place();
    good(place.call(&["run", "project/graph.ron"]));
    assert!(bad(place.call(&["run", "project/graph.ron", "--locked"]), 2).contains("graph.lock"));
    let reported = good(place.call(&["lock", "project/graph.ron"]));
    assert!(
        reported.ends_with("graph.lock (inputs: 2, kinds: 3, nodes with a result: 6 of 6)\n"),
        "{reported}"
    );
    good(place.call(&["run", "project/graph.ron", "--locked", "--cache", "fresh"]));
    std::fs::write(place.path("photos/small.hdr"), radiance(1)).unwrap();
    let errors = bad(place.call(&["run", "project/graph.ron", "--locked"]), 2);
    assert!(errors.contains("`../photos/small.hdr` has the digest"), "{errors}");
    std::fs::write(place.path("photos/small.hdr"), radiance(0)).unwrap();
    // The same inputs, but another result.
    let set = ["run", "project/graph.ron", "--locked", "--set", "jpeg.quality=50"];
    assert!(bad(place.call(&set), 1).contains("the result of `jpeg.files` has the digest"));
}

#[test]
fn what_differs_is_reported_in_the_terms_of_pictures() {
    let place = place();
    good(place.call(&["run", "project/graph.ron"]));
    let same = place.call(&["diff", "project/graph.ron", "project/graph.ron"]);
    assert_eq!(good(same), "the graphs are equal\nresults compared: 6, all equal\n");
    good(place.call(&["run", "project/graph.ron", "--set", "mask.encoding=Linear"]));
    let other = ["diff", "project/graph.ron", "project/graph.ron", "--set-b", "mask.encoding=Linear"];
    let reported = text(&place.call(&other).stdout);
    assert!(reported.starts_with("~ mask.encoding Data -> Linear\nfirst mask.image: "), "{reported}");
    assert!(reported.contains("then  bare.files: mask: PSNR 12.82 dB, 18 samples differ"), "{reported}");
}

#[test]
fn a_new_folder_runs_and_shells_know_the_verbs() {
    let place = Place::new("");
    assert_eq!(good(place.call(&["init", "new"])), "new/graph.ron\n");
    assert!(bad(place.call(&["init", "new"]), 2).contains("exists already"));
    // Most folders of a repository have such a file.
    std::fs::create_dir(place.path("old")).unwrap();
    std::fs::write(place.path("old/.gitignore"), "mine\n").unwrap();
    let reported = place.call(&["init", "old"]);
    assert!(text(&reported.stderr).contains("old/.gitignore exists already and is kept"));
    assert_eq!(good(reported), "old/graph.ron\n");
    assert_eq!(std::fs::read_to_string(place.path("old/.gitignore")).unwrap(), "mine\n");
    good(place.call(&["check", "new/graph.ron"]));
    for shell in ["bash", "zsh", "fish"] {
        assert!(good(place.call(&["completions", shell])).contains("unpack"));
    }
    assert!(good(place.call(&["manual"])).contains(".TH lightharmony 1"));
    good(place.call(&["manual", "--to", "man"]));
    assert!(place.path("man/lightharmony-verify.1").exists());
}

#[test]
fn a_bundle_without_values_is_no_damage_and_reports_of_what_was_asked_for() {
    let place = place();
    good(place.call(&["run", "project/graph.ron", "--only", "save"]));
    let packed = place.call(&["pack", "project/graph.ron", "a.lhb", "--only", "save"]);
    assert!(packed.stderr.is_empty(), "{}", text(&packed.stderr));
    let packed = place.call(&["pack", "project/graph.ron", "b.lhb"]);
    assert!(
        text(&packed.stderr).starts_with("warning: no result is known for mask, bare, float, jpeg"),
        "{}",
        text(&packed.stderr)
    );
    good(place.call(&["run", "project/graph.ron"]));
    good(place.call(&["pack", "project/graph.ron", "c.lhb", "--results", "none"]));
    for seed in ["0", "1", "2", "3"] {
        let reported = place.call(&["verify", "c.lhb", "--sample", "1", "--seed", seed]);
        assert!(reported.stderr.is_empty(), "{}", text(&reported.stderr));
        assert!(good(reported).contains("nodes recomputed: 1, with bit-identical results: 1;"));
    }
    good(place.call(&["unpack", "c.lhb", "c", "--trust-results", "--cache", "trusting"]));
    let reported = place.call(&["run", "c/graph.ron", "--cache", "trusting", "--out", "again"]);
    assert!(!text(&reported.stderr).contains("cache-damage"), "{}", text(&reported.stderr));
    assert_eq!(reported.status.code(), Some(0));
}

#[test]
fn a_difference_says_what_was_not_compared_and_pictures_need_no_files() {
    let place = place();
    good(place.call(&["run", "project/graph.ron"]));
    let reported =
        place.call(&["diff", "project/graph.ron", "project/graph.ron", "--set-b", "jpeg.quality=50"]);
    let printed = text(&reported.stdout);
    assert!(printed.contains("results compared: 5, all equal\n"), "{printed}");
    assert!(
        printed.ends_with(
            "no result is known for these nodes of the second graph: jpeg; run this graph first\n"
        ),
        "{printed}"
    );

    std::fs::copy(place.path("out/deep/view.png"), place.path("t1.png")).unwrap();
    std::fs::copy(place.path("out/deep/view.png"), place.path("t2.png")).unwrap();
    let printed = good(place.call(&["diff", "t1.png", "t2.png"]));
    assert_eq!(printed, "the graphs are equal\npictures: equal\n");
    good(place.call(&["run", "project/graph.ron", "--only", "save", "--set", "save.recipe=false"]));
    let printed = good(place.call(&["diff", "t1.png", "out/deep/view.png"]));
    assert_eq!(printed, "`out/deep/view.png` contains no recipe\npictures: equal\n");
    std::fs::write(place.path("photos/small.hdr"), radiance(1)).unwrap();
    good(place.call(&["run", "project/graph.ron", "--only", "save", "--set", "photo.encoding=Linear"]));
    let reported = place.call(&["diff", "t1.png", "out/deep/view.png"]);
    let printed = text(&reported.stdout);
    assert_eq!(reported.status.code(), Some(1));
    assert!(printed.contains("~ n0.encoding Auto -> Linear\n"), "{printed}");
    assert!(
        printed.contains("~ n0.the content of small.hdr ") && printed.contains("\npictures: "),
        "{printed}"
    );
}
