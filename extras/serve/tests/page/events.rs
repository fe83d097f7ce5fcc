//! The stream of events: the state first, then every event, and no queue for slow clients.

use std::io::Write;
use std::time::Duration;

use crate::lab::{GRAPH, Lab, digest_of};

#[test]
fn the_state_comes_first_and_then_the_events_of_the_watch() {
    let lab = Lab::new(GRAPH);
    let state = lab.idle();
    assert_eq!(state["digest"], digest_of(GRAPH).as_str());
    assert_eq!(state["nodes"]["view"]["status"], "ran");
    let output = &state["nodes"]["view"]["outputs"][1];
    assert_eq!((&output["port"], &output["type"]), (&"colour".into(), &"image".into()), "{state}");
    assert_eq!(state["history"]["shots"][0]["label"], "start");
    let mut events = lab.events();
    assert_eq!(events.next()["event"], "state");
    assert_eq!(lab.set("camera", "fov_y_deg", &[], Some("50.0")).status, 200);
    assert_eq!(events.until("graph")["digest"], digest_of(&lab.text()).as_str());
    let start = events.until("start");
    assert_eq!(start["node"]["status"], "running");
    let (mut ran, mut outputs) = (Vec::new(), 0);
    loop {
        let event = events.next();
        match event["event"].as_str().unwrap() {
            "node" if event["state"] == "ran" => ran.push(event["id"].as_str().unwrap().to_owned()),
            "idle" => break,
            _ => {}
        }
        outputs +=
            usize::from(event["id"] == "view" && event["node"]["outputs"][1]["digest"] != output["digest"]);
    }
    assert_eq!(ran, ["camera", "view", "save"], "only what the edit affects");
    assert!(outputs > 0, "the new value was announced");
}

#[test]
fn mistakes_have_their_place_and_the_last_result_stays() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let mut events = lab.events();
    std::fs::write(lab.path(), GRAPH.replace("yaw_deg", "yaw_dge")).unwrap();
    let mistakes = events.until("mistakes");
    let mistake = &mistakes["list"][0];
    assert_eq!((&mistake["line"], &mistake["column"]), (&11.into(), &64.into()), "{mistake}");
    assert_eq!(mistake["hints"][0], "did you mean `yaw_deg`?");
    let view = lab.get("/graph").json();
    assert_eq!(view["mistakes"], mistakes["list"]);
    assert!(view["text"].as_str().unwrap().contains("yaw_dge") && view["nodes"].is_array());
    std::fs::write(lab.path(), GRAPH).unwrap();
    lab.until("the mistake is gone", |lab| lab.get("/graph").json()["mistakes"] == serde_json::json!([]));
}

#[test]
fn the_graph_is_described_with_everything_an_editor_needs() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let view = lab.get("/graph").json();
    let ids: Vec<&str> =
        view["nodes"].as_array().unwrap().iter().map(|node| node["id"].as_str().unwrap()).collect();
    assert_eq!(ids, ["demo", "camera", "view", "pose", "save"]);
    let pose = &view["nodes"][3];
    let yaw = &pose["values"]["yaw_deg"];
    assert_eq!((&yaw["value"], &yaw["text"]), (&"30.0".into(), &"30.0".into()));
    let span = yaw["span"].as_array().unwrap();
    assert_eq!(&GRAPH[span[0].as_u64().unwrap() as usize..span[1].as_u64().unwrap() as usize], "30.0");
    assert!(pose["values"]["scale"]["text"].is_null(), "it has its default");
    assert_eq!(pose["line"], 11);
    let params = view["kinds"]["Pose"]["params"].as_array().unwrap();
    let yaw = params.iter().find(|param| param["name"] == "yaw_deg").unwrap();
    assert_eq!((&yaw["type"], &yaw["unit"]), (&"number".into(), &"degrees".into()), "{yaw}");
    assert!(yaw["doc"].as_str().unwrap().len() > 10);
    assert!(view["wires"].as_array().unwrap().contains(&serde_json::json!([0, "splats", 2, "splats"])));
    assert_eq!(view["columns"].as_array().unwrap().len(), 3);
    assert_eq!(view["targets"], serde_json::json!(["save"]));
}

#[test]
fn a_value_is_tried_without_being_written() {
    let lab = Lab::new(GRAPH);
    let before = lab.idle()["nodes"]["view"]["outputs"][1]["digest"].clone();
    let mut events = lab.events();
    let digest = digest_of(GRAPH);
    let edit = |at: &[usize], value: &str| {
        serde_json::json!({"digest": digest, "node": "camera", "field": "eye", "at": at, "value": value})
            .to_string()
    };
    assert_eq!(lab.post("/try", &edit(&[0], "2.5")).status, 200);
    let now = || lab.idle()["nodes"]["view"]["outputs"][1]["digest"].clone();
    lab.until("the picture follows", |_| now() != before);
    assert_eq!(lab.text(), GRAPH, "nothing is written");
    assert_eq!(events.until("history")["history"]["shots"].as_array().unwrap().len(), 1);
    assert_eq!(lab.post("/try", &edit(&[], "(2.5, -2.5, 1.2)")).status, 200);
    assert_eq!(lab.post("/try", "null").status, 200);
    lab.until("the picture of the text is back", |_| now() == before);
    // A page that leaves takes its trial with it.
    assert_eq!(lab.post("/try", &edit(&[0], "3.0")).status, 200);
    lab.until("the picture follows again", |_| now() != before);
    drop(events);
    lab.until("the trial ends with the last page", |_| now() == before);
}

#[test]
fn a_plan_names_what_an_edit_would_run() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let digest = digest_of(GRAPH);
    let plan = |node: &str, field: &str, value: &str| {
        let edit = serde_json::json!({"digest": digest, "node": node, "field": field, "value": value});
        lab.post("/plan", &edit.to_string()).json()["nodes"].clone()
    };
    assert_eq!(plan("camera", "fov_y_deg", "50.0"), serde_json::json!(["camera", "view", "save"]));
    assert_eq!(plan("camera", "fov_y_deg", "40.0"), serde_json::json!([]));
    assert_eq!(lab.text(), GRAPH);
}

#[test]
fn a_client_that_does_not_read_holds_nothing_up() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let mut slow = lab.connect();
    write!(slow, "GET /events HTTP/1.1\r\nHost: {}\r\nCookie: {}\r\n\r\n", lab.host(), lab.cookie).unwrap();
    let mut events = lab.events();
    events.next();
    // More events than a client may be behind, each with the whole history.
    for turn in 0..60 {
        assert_eq!(lab.set("pose", "yaw_deg", &[], Some(&format!("{turn}.5"))).status, 200);
    }
    lab.until("the last text is shown", |lab| lab.digest() == digest_of(&lab.text()));
    std::thread::sleep(Duration::from_millis(200));
    // The slow client still gets a state from which it can go on.
    slow.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let mut slow = std::io::BufReader::new(slow);
    let last = digest_of(&lab.text());
    let mut line = String::new();
    while !(line.contains(&last) && line.starts_with("data: ")) {
        line.clear();
        assert!(std::io::BufRead::read_line(&mut slow, &mut line).unwrap() > 0, "the stream ended");
    }
}

#[test]
fn the_number_of_pages_is_bounded() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let mut pages: Vec<_> = (0..16).map(|_| lab.events()).collect();
    pages.iter_mut().for_each(|page| assert_eq!(page.next()["event"], "state"));
    assert_eq!(lab.get("/events").status, 503);
    pages.pop();
    // The server notices at the next event.
    assert_eq!(lab.set("pose", "yaw_deg", &[], Some("1.0")).status, 200);
    lab.until("there is room again", |lab| {
        let mut stream = lab.connect();
        write!(stream, "GET /events HTTP/1.1\r\nHost: {}\r\nCookie: {}\r\n\r\n", lab.host(), lab.cookie)
            .unwrap();
        let mut line = String::new();
        std::io::BufRead::read_line(&mut std::io::BufReader::new(stream), &mut line).unwrap();
        line.contains("200")
    });
}
