//! Tests that results have the same bytes for any number of threads, any folder and any order.

use crate::{INSERT, Place};

#[test]
fn threads_folders_and_memory_leave_the_bytes_as_they_are() {
    let one = Place::new(INSERT);
    one.run(&["--jobs", "1"]).good();
    let two = Place::new(INSERT);
    two.run(&["--jobs", "2"]).good();
    let five = Place::new(INSERT);
    five.run(&["--jobs", "5", "--memory", "256M"]).good();
    let bytes = one.outputs();
    assert_eq!(bytes.keys().collect::<Vec<_>>(), ["final.png", "layers.exr", "light.json"]);
    assert!(bytes == two.outputs() && bytes == five.outputs());
    assert!(bytes["final.png"].starts_with(b"\x89PNG"));
}

#[test]
fn another_seed_gives_another_picture() {
    let place = Place::new(INSERT);
    place.run(&[]).good();
    let first = place.outputs();
    place.run(&["--set", "scene.seed=4"]).good();
    assert!(place.outputs()["final.png"] != first["final.png"]);
}

#[test]
fn pictures_carry_the_graph_that_made_them_and_no_path() {
    let place = Place::new(INSERT);
    place.run(&[]).good();
    for (name, bytes) in place.outputs() {
        let text = String::from_utf8_lossy(&bytes).into_owned();
        assert!(!text.contains(&*place.folder.path().to_string_lossy()), "{name} holds a path");
        if name != "light.json" {
            assert!(text.contains("PathTrace(") && text.contains("yaw_deg:30.0"), "{name} holds no recipe");
        }
    }
}

#[test]
fn two_processes_on_one_cache_agree() {
    let place = Place::new(INSERT);
    let mut children: Vec<_> = ["a", "b"]
        .iter()
        .map(|out| {
            let mut command = place.command(&["run", "graph.ron", "--out", out]);
            command.stderr(std::process::Stdio::null()).stdout(std::process::Stdio::null()).spawn().unwrap()
        })
        .collect();
    assert!(children.iter_mut().all(|child| child.wait().unwrap().success()));
    let (a, b) = (crate::files(&place.path("a")), crate::files(&place.path("b")));
    assert!(!a.is_empty() && a == b);
}

/// Sixteen processes with one cache compute each key once. Forty loaders and forty sinks are enough for the
/// processes to meet at every stage of a node.
#[test]
fn sixteen_processes_on_one_cache_compute_each_key_once() {
    const NODES: usize = 80;
    let node = |n: usize| {
        format!(
            "a{n}: LoadEnvironment(path: \"light.hdr\", scale: {n}.5), \
             s{n}: WriteExr(image: \"a{n}.image\", path: \"{n}.exr\", recipe: false),"
        )
    };
    let nodes: String = (0..NODES / 2).map(node).collect();
    let place = Place::new(&format!("Graph(version: 1, scene: (up: \"+z\"), nodes: ({nodes}))"));
    let mut light = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n".to_vec();
    light.extend((0..16 * 32).flat_map(|n: u32| [40 + (n % 97) as u8, 90, 60 + (n / 4) as u8, 128]));
    std::fs::write(place.path("light.hdr"), light).unwrap();
    let out = |n: usize| format!("out{n}");
    let start = |n: usize| {
        let mut command = place.command(&["run", "graph.ron", "--json", "--jobs", "2", "--out", &out(n)]);
        command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::null()).spawn().unwrap()
    };
    let children: Vec<_> = (0..16).map(start).collect();
    let mut ran = 0;
    for child in children {
        let reported = child.wait_with_output().unwrap();
        assert!(reported.status.success());
        let text = String::from_utf8(reported.stdout).unwrap();
        let done: serde_json::Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
        ran += done["ran"].as_u64().unwrap() as usize;
    }
    // A loader's values are made again where its sink runs in another process; that does not count as a run.
    assert_eq!(ran, NODES, "each of the keys was computed by one of the processes");
    let first = crate::files(&place.path(&out(0)));
    assert_eq!(first.len(), NODES / 2);
    assert!((1..16).all(|n| crate::files(&place.path(&out(n))) == first));
}
