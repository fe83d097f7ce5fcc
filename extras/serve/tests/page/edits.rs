//! Edits of the text: what is written, what is refused, and that nothing is lost.

use std::sync::Arc;

use crate::lab::{GRAPH, Lab, digest_of};

#[test]
fn an_edit_changes_the_bytes_of_one_value_and_the_graph_follows() {
    let text = GRAPH.replace('\n', "\r\n").replace("// A small", "\u{feff}// A small");
    let lab = Lab::new(&text);
    lab.idle();
    assert_eq!(lab.set("pose", "yaw_deg", &[], Some("45.5")).status, 200);
    let expected = text.replace("yaw_deg: 30.0", "yaw_deg: 45.5");
    assert_eq!(lab.text(), expected);
    lab.until("the page follows", |lab| lab.digest() == digest_of(&expected));
    assert_eq!(lab.set("camera", "eye", &[1], Some("-3.0")).status, 200);
    let expected = expected.replace("-2.5", "-3.0");
    assert_eq!(lab.text(), expected);
    assert_eq!(lab.set("pose", "scale", &[], Some("2.0")).status, 200);
    assert_eq!(lab.text(), expected.replace("45.5)", "45.5, scale: 2.0)"));
    assert_eq!(lab.set("pose", "scale", &[], None).status, 200);
    assert_eq!(lab.text(), expected);
    for _ in 0..4 {
        assert_eq!(lab.post("/undo", &format!("{{\"digest\":\"{}\"}}", digest_of(&lab.text()))).status, 200);
    }
    assert_eq!(lab.text(), text, "all edits are undone");
    let response = lab.post("/undo", &format!("{{\"digest\":\"{}\"}}", digest_of(&text)));
    assert_eq!((response.status, response.json()["code"].as_str()), (409, Some("nothing")));
    assert_eq!(
        std::fs::read_dir(lab.folder.path()).unwrap().count(),
        4,
        "graph, splats, cache, out; no temporary file"
    );
}

#[test]
fn a_stale_edit_is_refused_and_nothing_is_lost() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let seen = digest_of(GRAPH);
    let theirs = GRAPH.replace("seed: 3", "seed: 4");
    std::fs::write(lab.path(), &theirs).unwrap();
    let edit =
        serde_json::json!({"digest": seen, "node": "pose", "field": "yaw_deg", "value": "1.0"}).to_string();
    for path in ["/set", "/try", "/plan", "/undo"] {
        let body = if path == "/undo" { format!("{{\"digest\":\"{seen}\"}}") } else { edit.clone() };
        let response = lab.post(path, &body);
        assert_eq!((response.status, response.json()["code"].as_str()), (409, Some("stale")), "{path}");
        assert_eq!(response.json()["digest"], digest_of(&theirs).as_str());
    }
    assert_eq!(lab.text(), theirs);
    // The change of the other program can be undone like one of the page.
    assert_eq!(lab.post("/undo", &format!("{{\"digest\":\"{}\"}}", digest_of(&theirs))).status, 200);
    assert_eq!(lab.text(), GRAPH);
    assert_eq!(lab.post("/redo", &format!("{{\"digest\":\"{seen}\"}}")).status, 200);
    assert_eq!(lab.text(), theirs);
}

#[test]
fn of_edits_at_the_same_time_one_is_written_and_the_others_are_refused() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let digest = digest_of(GRAPH);
    let send = |value: usize| {
        let edit = serde_json::json!({"digest": digest, "node": "pose", "field": "yaw_deg", "value": format!("{value}.0")});
        lab.post("/set", &edit.to_string()).status
    };
    let answers: Vec<u16> = std::thread::scope(|scope| {
        let threads: Vec<_> = (100..108).map(|value| scope.spawn(move || send(value))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(answers.iter().filter(|status| **status == 200).count(), 1, "{answers:?}");
    assert_eq!(answers.iter().filter(|status| **status == 409).count(), 7, "{answers:?}");
    let winner = answers.iter().position(|status| *status == 200).unwrap() + 100;
    assert_eq!(lab.text(), GRAPH.replace("yaw_deg: 30.0", &format!("yaw_deg: {winner}.0")));
}

#[test]
fn what_must_be_edited_in_the_text_is_refused_with_the_reason() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    for (node, field, at, value, why) in [
        ("pose", "translation", &[][..], "(0.0, 0.0, 0.0)", "takes its value from `Param(\"height\")`"),
        ("pose", "translation", &[2], "1.0", "takes its value from `Param(\"height\")`"),
        ("view", "splats", &[], "\"demo.proxy\"", "is a wire"),
        ("save", "path", &[], "\"b.png\"", "names a file"),
        ("pose", "yaw", &[], "1.0", "no parameter `yaw`"),
        ("nobody", "yaw_deg", &[], "1.0", "does not define"),
        ("pose", "yaw_deg", &[], "1.0), other: Pose(yaw_deg: 2.0", "not a value"),
        ("pose", "translation", &[7], "1.0", "is not set"),
    ] {
        let response = lab.set(node, field, at, Some(value));
        assert_eq!(response.status, 422, "{node}.{field}");
        assert!(response.json()["why"].as_str().unwrap().contains(why), "{}", response.json());
    }
    let response = lab.set("pose", "yaw_deg", &[], Some("Word"));
    assert_eq!((response.status, response.json()["code"].as_str()), (422, Some("invalid")));
    let mistake = &response.json()["mistakes"][0];
    assert_eq!(mistake["line"], 11, "{mistake}");
    assert_eq!(lab.text(), GRAPH);
    assert_eq!(
        lab.set("pose", "translation", &[0], Some("1.0")).status,
        200,
        "the numbers around it are free"
    );
    assert_eq!(
        lab.set("parameters", "height", &[], Some("1.5")).status,
        200,
        "and so is the parameter itself"
    );
}

#[test]
fn a_graph_of_a_bundle_is_never_written() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("graph.ron"), GRAPH).unwrap();
    std::fs::write(folder.path().join(".lightharmony-bundle"), "").unwrap();
    let lab = Lab::at(Arc::new(folder), None).unwrap();
    lab.idle();
    let response = lab.set("pose", "yaw_deg", &[], Some("1.0"));
    assert_eq!((response.status, response.json()["code"].as_str()), (403, Some("confined")));
    assert_eq!(lab.post("/undo", &format!("{{\"digest\":\"{}\"}}", digest_of(GRAPH))).status, 403);
    assert_eq!(lab.get("/graph").json()["confined"], true);
    assert_eq!(lab.text(), GRAPH);
}

#[test]
fn a_deleted_graph_is_named_and_can_come_back() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let mut events = lab.events();
    let digest = digest_of(GRAPH);
    std::fs::remove_file(lab.path()).unwrap();
    let edit =
        serde_json::json!({"digest": digest, "node": "pose", "field": "yaw_deg", "value": "1.0"}).to_string();
    let response = lab.post("/set", &edit);
    assert_eq!((response.status, response.json()["code"].as_str()), (410, Some("gone")));
    assert!(response.json()["why"].as_str().unwrap().contains("was deleted or moved"));
    assert!(!lab.path().exists(), "it is not created again");
    let mistakes = events.until("mistakes");
    assert!(mistakes["text"].as_str().unwrap().contains("cannot read the graph"), "{mistakes}");
    assert!(lab.get("/graph").json()["nodes"].is_array(), "the last good graph stays visible");
    std::fs::write(lab.path(), GRAPH).unwrap();
    lab.until("it is back", |lab| lab.digest() == digest && lab.get("/graph").json()["problem"].is_null());
    assert_eq!(lab.set("pose", "yaw_deg", &[], Some("1.0")).status, 200);
}

#[cfg(unix)]
#[test]
fn an_error_of_writing_leaves_the_old_text() {
    use std::os::unix::fs::PermissionsExt;
    let lab = Lab::new(GRAPH);
    lab.idle();
    // Root may write everywhere, so a folder in place of the temporary file cannot be tested; a folder without
    // permission can, for other users.
    std::fs::set_permissions(lab.folder.path(), std::fs::Permissions::from_mode(0o555)).unwrap();
    let response = lab.set("pose", "yaw_deg", &[], Some("1.0"));
    std::fs::set_permissions(lab.folder.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
    if response.status != 200 {
        assert_eq!((response.status, response.json()["code"].as_str()), (507, Some("unwritten")));
        assert!(response.json()["why"].as_str().unwrap().contains("cannot write"));
        assert_eq!(lab.text(), GRAPH);
    }
}

#[test]
fn history_token_and_port_survive_a_restart() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    assert_eq!(lab.set("pose", "yaw_deg", &[], Some("1.0")).status, 200);
    assert_eq!(lab.set("pose", "yaw_deg", &[], Some("2.0")).status, 200);
    let (folder, token, cookie, port) = (lab.folder.clone(), lab.token.clone(), lab.cookie.clone(), lab.port);
    drop(lab);
    let theirs = GRAPH.replace("yaw_deg: 30.0", "yaw_deg: 2.0").replace("seed: 3", "seed: 5");
    std::fs::write(folder.path().join("graph.ron"), &theirs).unwrap();
    let lab = Lab::at(folder, None).unwrap();
    assert_eq!((&lab.token, &lab.cookie, lab.port), (&token, &cookie, port), "an open page reconnects");
    for expected in [
        theirs.replace("seed: 5", "seed: 3"),
        GRAPH.replace("yaw_deg: 30.0", "yaw_deg: 1.0"),
        GRAPH.to_owned(),
    ] {
        let undo = lab.post("/undo", &format!("{{\"digest\":\"{}\"}}", digest_of(&lab.text())));
        assert_eq!(undo.status, 200);
        assert_eq!(lab.text(), expected);
    }
    #[cfg(unix)]
    for entry in std::fs::read_dir(lab.folder.path().join("cache/pages")).unwrap() {
        use std::os::unix::fs::PermissionsExt;
        let entry = entry.unwrap();
        assert_eq!(entry.metadata().unwrap().permissions().mode() & 0o777, 0o600, "{:?}", entry.path());
    }
}

#[test]
fn a_port_in_use_is_named() {
    let lab = Lab::new(GRAPH);
    let folder = Arc::new(tempfile::tempdir().unwrap());
    std::fs::write(folder.path().join("graph.ron"), GRAPH).unwrap();
    let error = Lab::at(folder, Some(lab.port)).err().unwrap().to_string();
    assert!(
        error.contains(&format!("the port {} is in use", lab.port)) && error.contains("--port"),
        "{error}"
    );
    // Without `--port`, another one is taken.
    let other = Lab::at(lab.folder.clone(), None).unwrap();
    assert_ne!(other.port, lab.port);
}

#[test]
fn keys_of_a_track_are_replaced_as_a_whole() {
    let graph = GRAPH.replace("yaw_deg: 30.0", "yaw_deg: Track(\"turn\", [(0, 1.0), (30, 7.0)])");
    let lab = Lab::new(&graph);
    lab.idle();
    let more = "Track(\"turn\", [(0, 1.0), (15, 2.5), (30, 7.0)])";
    assert_eq!(lab.set("pose", "yaw_deg", &[], Some(more)).status, 200);
    assert_eq!(lab.text(), graph.replace("Track(\"turn\", [(0, 1.0), (30, 7.0)])", more));
    let text = lab.text();
    lab.until("the graph follows", |lab| lab.digest() == digest_of(&text));
    for refused in [
        "30.0",
        "Track(\"other\", [(0, 1.0)])",
        "Track(\"turn\", [(0, Param(\"height\"))])",
        "Track(\"turn\", [(30, 1.0), (0, 7.0)])",
        "Track(\"turn\", [(0, 1.0)]), scale: Track(\"turn\", [(0, 1.0)])",
    ] {
        assert_eq!(lab.set("pose", "yaw_deg", &[], Some(refused)).status, 422, "{refused}");
        assert_eq!(lab.text(), text);
    }
    assert_eq!(lab.set("pose", "yaw_deg", &[0], Some("1.0")).status, 422, "one key alone is not replaced");
}
