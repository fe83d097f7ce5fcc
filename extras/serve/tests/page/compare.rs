//! Differences between outputs, earlier results and picture files.

use serde_json::Value;

use crate::lab::{GRAPH, Lab};

fn colour(state: &Value) -> String {
    let outputs = state["nodes"]["view"]["outputs"].as_array().unwrap();
    let output = outputs.iter().find(|output| output["port"] == "colour").unwrap();
    output["digest"].as_str().unwrap().to_owned()
}

/// The value in a column of the first row of the first table.
fn cell(difference: &Value, column: &str) -> Value {
    let table = &difference["report"]["tables"][0];
    let at = table["columns"].as_array().unwrap().iter().position(|name| {
        let name = name.as_str().unwrap();
        name == column || name.starts_with(&format!("{column} ("))
    });
    table["rows"][0][at.unwrap_or_else(|| panic!("{column}: {table}"))].clone()
}

#[test]
fn a_result_is_compared_with_an_earlier_one() {
    let lab = Lab::new(GRAPH);
    let before = colour(&lab.idle());
    assert_eq!(lab.set("camera", "fov_y_deg", &[], Some("55.0")).status, 200);
    lab.until("the picture follows", |lab| colour(&lab.idle()) != before);
    let now = colour(&lab.idle());
    let path = format!("/difference/{now}/0/{before}/0");
    let found = lab.get(&path).json();
    assert_eq!(found["flip"], serde_json::json!([32, 18]), "{found}");
    let flip = cell(&found, "flip mean").as_f64().unwrap();
    assert!(flip > 0.01, "{found}");
    let map = lab.get(&format!("{path}/flip.f32"));
    assert_eq!(map.header("cache-control"), Some("private, max-age=31536000, immutable"));
    let samples: Vec<f32> =
        map.body.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    assert_eq!(samples.len(), 32 * 18);
    let mean = samples.iter().map(|v| f64::from(*v)).sum::<f64>() / 576.0;
    assert!((mean - flip).abs() < 1e-6, "{mean} {flip}");
    let same = lab.get(&format!("/difference/{now}/0/{now}/0")).json();
    assert_eq!(cell(&same, "flip mean"), 0.0);
}

#[test]
fn what_cannot_be_compared_is_named() {
    let lab = Lab::new(GRAPH);
    let state = lab.idle();
    let now = colour(&state);
    let outputs = state["nodes"]["view"]["outputs"].as_array().unwrap();
    let depth = outputs.iter().find(|output| output["port"] == "depth").unwrap()["digest"].as_str().unwrap();
    let refused = lab.get(&format!("/difference/{now}/0/{depth}/0"));
    assert_eq!((refused.status, &refused.json()["flip"]), (200, &Value::Null));
    assert!(refused.json()["notes"][0].as_str().unwrap().contains("encodings"), "{:?}", refused.json());
    let data = lab.get(&format!("/difference/{depth}/0/{depth}/0")).json();
    assert!(data["flip"].is_null() && data["report"]["tables"][0]["name"] == "ratio", "{data}");
    let zero = "0".repeat(64);
    for path in [
        format!("/difference/{now}/0/{zero}/0"),
        format!("/difference/{now}/7/{now}/0"),
        format!("/difference/{now}/0/x/0"),
        format!("/difference/{depth}/0/{depth}/0/flip.f32"),
        format!("/difference/{now}/0/{depth}/0/flip.f32"),
        format!("/difference/{now}/0/{now}/0/flip.png"),
    ] {
        assert_eq!(lab.get(&path).status, 404, "{path}");
    }
    assert_eq!(lab.get(&format!("/difference/{now}/-1/{now}/0")).status, 400);
}

#[test]
fn picture_files_are_offered_by_handles() {
    let lab = Lab::new(GRAPH);
    let now = colour(&lab.idle());
    let png = lab.get(&format!("/value/{now}/0.png")).body;
    let folder = lab.folder.path();
    std::fs::create_dir(folder.join("truth")).unwrap();
    std::fs::write(folder.join("truth/a.png"), &png).unwrap();
    std::fs::write(folder.join("truth/broken.png"), &png[..40]).unwrap();
    let outside = tempfile::tempdir().unwrap();
    std::fs::write(outside.path().join("private.png"), &png).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink(outside.path(), folder.join("link")).unwrap();
    let list = lab.get("/references").json();
    let id = |name: &str| {
        let list = list.as_array().unwrap().iter();
        list.filter(|one| one["name"] == name).map(|one| one["id"].as_str().unwrap().to_owned()).next()
    };
    assert!(!list.to_string().contains("private"), "links are not followed: {list}");
    let truth = id("truth/a.png").unwrap();
    let found = lab.get(&format!("/difference/{now}/0/{truth}/0")).json();
    assert_eq!(cell(&found, "flip mean"), 0.0, "{found}");
    assert_eq!(lab.get(&format!("/value/{truth}")).json()["pictures"][0]["name"], "a");
    let broken = id("truth/broken.png").unwrap();
    assert_eq!(lab.get(&format!("/value/{broken}")).status, 404);
    // A file that changes gets another handle, and the old one is refused.
    std::fs::write(folder.join("truth/a.png"), [&png[..], b"x"].concat()).unwrap();
    let again = lab.get("/references").json();
    assert!(!again.to_string().contains(&truth));
    assert_eq!(lab.get(&format!("/value/{truth}/0.png")).status, 404);
}
