//! Tests of `action`: one node in another process.

use crate::{INSERT, Place};

/// The trace is computed from its folder alone, in a process with another cache and another working folder, and the
/// next run gives the bytes of a run without this detour.
#[test]
fn a_node_is_computed_in_another_process() {
    let (place, plain) = (Place::new(INSERT), Place::new(INSERT));
    let call = |arguments: &[&str], code: i32| {
        let output = place.call(arguments);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{text}");
        (String::from_utf8_lossy(&output.stdout).into_owned(), text)
    };
    let (key, _) = call(&["action", "write", "graph.ron", "trace", "action"], 0);
    let other = Place::new("");
    let folder = place.path("action");
    let output = other.call(&["action", "run", folder.to_str().unwrap(), "--out", "outputs", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(!other.path("cache").exists(), "a worker needs no cache");
    let lines = String::from_utf8(output.stdout).unwrap();
    let done: serde_json::Value = serde_json::from_str(lines.lines().last().unwrap()).unwrap();
    assert_eq!((done["event"].as_str(), done["key"].as_str()), (Some("done"), Some(key.trim())));
    let outputs = other.path("outputs");
    call(&["action", "take", "action", "--out", outputs.to_str().unwrap()], 0);
    let log = place.run(&[]).good();
    assert!(log.nodes("cached").contains(&"trace") && log.nodes("ran").contains(&"shadow"));
    plain.run(&[]).good();
    assert_eq!(place.outputs(), plain.outputs());

    // Outputs that were changed are refused, and an existing folder is never overwritten.
    let value = std::fs::read_dir(outputs.join("values")).unwrap().next().unwrap().unwrap().path();
    let mut bytes = std::fs::read(&value).unwrap();
    bytes[0] ^= 1;
    std::fs::write(&value, bytes).unwrap();
    let (_, error) = call(&["action", "take", "action", "--out", outputs.to_str().unwrap()], 2);
    assert!(error.contains("does not match the digest"), "{error}");
    let (_, error) = call(&["action", "write", "graph.ron", "trace", "action"], 2);
    assert!(error.contains("cannot create"), "{error}");
    let (_, error) = call(&["action", "run", "action", "--memory", "1K"], 1);
    assert!(error.contains("`path-trace` needs about"), "{error}");
}

#[cfg(not(feature = "remote"))]
#[test]
fn a_build_without_the_feature_names_it() {
    let place = Place::new(INSERT);
    for arguments in [&["run", "graph.ron", "--remote", "grpc://127.0.0.1:1"][..], &["key", "list"]] {
        let output = place.call(arguments);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains("lacks the feature `remote`"), "{text}");
    }
}
