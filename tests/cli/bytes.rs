//! The same bytes whatever the threads, the folder and the order of things.

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
