//! Runs the program as a user does: the real binary in a folder with a graph, an output folder and a cache.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// A graph of a whole insertion into a small demo scene, with the cheapest value of every knob.
pub const INSERT: &str = r#"Graph(
    version: 1,
    scene: (up: "+z", seed: 3),
    nodes: (
        demo:   DemoScene(place: Courtyard, splats: 4000, width_px: 96, height_px: 54, truth_width_px: 32),
        pose:   Pose(translation: (0.0, 0.0, 0.0), yaw_deg: 30.0),
        placed: Place(object: "demo.object", pose: "pose"),
        probe:  CubeRig(at: "pose", height_metres: 0.3, size_px: 32),
        faces:  SplatRender(splats: "demo.splats", rig: "probe"),
        pano:   Stitch(views: "faces", width_px: 64),
        dark:   PredictExposure(pano: "pano", evs: [-6.0, -3.0], method: Region),
        env:    FuseHdr(base: "pano", brackets: "dark"),
        camera: Camera(eye: (2.0, -2.5, 1.2), target: (0.0, 0.0, 0.2), width_px: 96, height_px: 54, fov_y_deg: 40.0),
        view:   SplatRender(splats: "demo.splats", rig: "camera"),
        trace:  PathTrace(receiver: "demo.proxy", objects: ["placed"], rig: "camera", env: "env", samples: 4),
        shadow: ShadowRatio(without: "trace.without", with: "trace.with", gamma: 0.8, s_min: 0.05, lambda: 1.0),
        final:  Composite(background: "view", object: "trace.object", shadow: "shadow"),
        save:   WriteImage(image: "final", path: "final.png"),
        layers: WriteExr(layers: ["final", "trace.without", "trace.with", "shadow"], path: "layers.exr"),
        light:  WriteReport(report: "env.report", path: "light.json"),
    ),
)
"#;

/// A folder with a graph, an output folder and its own cache.
pub struct Place {
    pub folder: tempfile::TempDir,
}

/// The output of one run, line by line.
pub struct RunLog {
    pub code: i32,
    pub events: Vec<Value>,
    pub errors: String,
}

impl Place {
    pub fn new(graph: &str) -> Self {
        let place = Self { folder: tempfile::tempdir().unwrap() };
        place.write(graph);
        place
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, graph: &str) {
        std::fs::write(self.path("graph.ron"), graph).unwrap();
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lightharmony"));
        command.current_dir(self.folder.path()).args(arguments).env("LIGHTHARMONY_CACHE", self.path("cache"));
        command
    }

    pub fn call(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Runs `lightharmony run graph.ron --json` with additional arguments.
    pub fn run(&self, arguments: &[&str]) -> RunLog {
        let output = self.call(&[&["run", "graph.ron", "--json"], arguments].concat());
        let text = String::from_utf8(output.stdout).unwrap();
        RunLog {
            code: output.status.code().unwrap_or(-1),
            events: text.lines().map(|line| serde_json::from_str(line).unwrap()).collect(),
            errors: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// Every file of the output folder with its bytes.
    pub fn outputs(&self) -> BTreeMap<String, Vec<u8>> {
        files(&self.path("out"))
    }
}

/// The files of a folder, except temporary files that a killed process left. Later runs remove such files, unless
/// they may belong to a live process.
pub fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if !name.ends_with(".lightharmony-temp") {
            found.insert(name, std::fs::read(entry.path()).unwrap());
        }
    }
    found
}

impl RunLog {
    /// Names of the nodes that ended in the given state, in alphabetical order.
    pub fn nodes(&self, state: &str) -> Vec<&str> {
        let of = |event: &&Value| event["event"] == "node" && event["state"] == state;
        let mut names: Vec<&str> =
            self.events.iter().filter(of).filter_map(|event| event["id"].as_str()).collect();
        names.sort_unstable();
        names
    }

    /// Names of the parts of a node that ended in the given state.
    pub fn parts(&self, node: &str, state: &str) -> Vec<&str> {
        let of = |event: &&Value| event["event"] == "part" && event["id"] == node && event["state"] == state;
        self.events.iter().filter(of).filter_map(|event| event["part"].as_str()).collect()
    }

    /// Every note as (node, id, text).
    pub fn notes(&self) -> Vec<(String, String, String)> {
        let mut all = Vec::new();
        for event in self.events.iter().filter(|event| event["event"] == "node") {
            for note in event["notes"].as_array().into_iter().flatten() {
                let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
                all.push((text(&event["id"]), text(&note["id"]), text(&note["text"])));
            }
        }
        all.sort();
        all
    }

    pub fn good(self) -> Self {
        assert_eq!(self.code, 0, "{}", self.errors);
        self
    }
}
