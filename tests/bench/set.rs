//! A small set of cases: a floor with a wall, a box, a sky with a sun. The truth comes from the program's own light
//! transport, so the set tests the benchmark and not the renderer.

use std::path::{Path, PathBuf};

use scene::io::exr::{self, Channel, Depth};

use crate::program::Place;

/// Size of the pictures.
pub const SIZE: [usize; 2] = [72, 48];
/// Samples per pixel of the truth.
pub const TRUTH_SAMPLES: u32 = 32;

/// A place with the set in the folder `set`.
pub struct Sets {
    pub place: Place,
}

/// The cases: name, scene, position of the object.
pub const CASES: [(&str, &str, [f64; 3]); 3] = [
    ("yard-1", "yard", [0.0, 0.0, 0.0]),
    ("yard-2", "yard", [0.6, 0.3, 0.0]),
    ("street", "street", [-0.3, 0.2, 0.0]),
];

impl Sets {
    /// Makes the set, with the first `cases` of [`CASES`].
    pub fn new(cases: usize) -> Self {
        let sets = Self { place: Place::new("") };
        let names: Vec<&str> = CASES[..cases].iter().map(|(name, ..)| *name).collect();
        let head = serde_json::json!({
            "lightharmony_bench": 1, "name": "tiny", "version": "1.0", "seed": 5, "licence": "CC0-1.0",
            "up": "+z", "metres_per_unit": 1.0, "cases": names,
        });
        for (at, (name, scene, position)) in CASES[..cases].iter().enumerate() {
            let folder = sets.case(name);
            std::fs::create_dir_all(folder.join("truth")).unwrap();
            write(&folder.join("box.obj"), &box_obj());
            write(&folder.join("mesh.ply"), &floor_ply(at));
            write(&folder.join("views.json"), &views().to_string());
            sky(&folder.join("truth/light.exr"), at);
            let case = serde_json::json!({
                "version": 1, "name": name, "scene": scene, "tags": ["sun", scene],
                "object": "box.obj", "pose": {"translation": position, "yaw_deg": 20.0, "scale": 1.0},
                "probe": [position[0], position[1], 0.3], "views": ["view_0", "view_1"], "mesh": "mesh.ply",
            });
            write(&folder.join("case.json"), &case.to_string());
            write(&folder.join("truth.ron"), &truth(*position));
            let out = sets.place.call(&[
                "run",
                &shown(&folder.join("truth.ron")),
                "--out",
                &shown(&folder.join("truth")),
            ]);
            assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
            std::fs::remove_file(folder.join("truth.ron")).unwrap();
        }
        write(&sets.folder().join("set.json"), &head.to_string());
        sets
    }

    /// The folder of the set.
    pub fn folder(&self) -> PathBuf {
        self.place.path("set")
    }

    /// The folder of a case.
    pub fn case(&self, name: &str) -> PathBuf {
        self.folder().join(name)
    }

    /// Runs `bench set` with more arguments. Returns the exit code and both outputs.
    pub fn bench(&self, arguments: &[&str]) -> (i32, String, String) {
        let folder = shown(&self.folder());
        let output = self.place.call(&[&["bench", folder.as_str()], arguments].concat());
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (output.status.code().unwrap_or(-1), text(output.stdout), text(output.stderr))
    }

    /// Text of an output file of `bench`.
    pub fn output(&self, name: &str) -> String {
        std::fs::read_to_string(self.place.path("bench").join(name)).unwrap()
    }

    /// The mean of a metric in `tables.csv`.
    pub fn mean(&self, region: &str, picture: &str, metric: &str) -> f64 {
        let start = format!("true-light,{region},{picture},{metric},");
        let text = self.output("tables.csv");
        let line =
            text.lines().find(|line| line.starts_with(&start)).unwrap_or_else(|| panic!("{start} in {text}"));
        line[start.len()..].split(',').next().unwrap().parse().unwrap()
    }
}

/// A path as an argument.
pub fn shown(path: &Path) -> String {
    path.display().to_string()
}

/// Writes a text file.
pub fn write(path: &Path, text: &str) {
    std::fs::write(path, text).unwrap();
}

/// The nodes that load a case from the folder of its files and trace it, for the graphs of this file.
pub fn nodes(position: [f64; 3], samples: u32) -> String {
    let [x, y, z] = position;
    format!(
        "rig: LoadCameras(path: \"views.json\"), mesh: LoadMesh(path: \"mesh.ply\"), object: LoadObject(path: \"box.obj\"),
         pose: Pose(translation: ({x:?}, {y:?}, {z:?}), yaw_deg: 20.0), placed: Place(object: \"object\", pose: \"pose\"),
         env: LoadEnvironment(path: \"truth/light.exr\", origin: ({x:?}, {y:?}, 0.3)),
         trace: PathTrace(receiver: \"mesh\", objects: [\"placed\"], rig: \"rig\", env: \"env\", samples: {samples}),
         ratio: ShadowRatio(without: \"trace.without\", with: \"trace.with\", s_max: 4.0),"
    )
}

/// The graph that makes the truth of a case.
fn truth(position: [f64; 3]) -> String {
    format!(
        "Graph(version: 1, scene: (up: \"+z\", seed: 11), nodes: ({}
         with: Composite(background: \"trace.without\", object: \"trace.object\", shadow: \"ratio\"),
         masks: RegionMasks(object: \"trace.object\"),
         a: WriteExr(image: \"trace.without\", path: \"{{view}}/without.exr\", recipe: false),
         b: WriteExr(image: \"with\", path: \"{{view}}/with.exr\", recipe: false),
         c: WriteExr(layers: [\"masks.object\"], names: [\"Y\"], path: \"{{view}}/alpha.exr\", recipe: false),
         d: WriteExr(layers: [\"trace.depth\"], names: [\"Z\"], path: \"{{view}}/depth.exr\", recipe: false)))",
        nodes(position, TRUTH_SAMPLES)
    )
}

/// Two cameras that look at the origin from the front, as `transforms.json` of nerfstudio.
fn views() -> serde_json::Value {
    let frame = |name: &str, eye: [f64; 3]| {
        let unit = |v: [f64; 3]| {
            let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            v.map(|x| x / length)
        };
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        // The camera looks along -z, with y up.
        let back = unit([eye[0], eye[1], eye[2] - 0.2]);
        let right = unit(cross([0.0, 0.0, 1.0], back));
        let up = cross(back, right);
        let row = |i: usize| [right[i], up[i], back[i], eye[i]];
        serde_json::json!({
            "file_path": format!("{name}.png"), "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
        })
    };
    let [w, h] = SIZE;
    serde_json::json!({
        "w": w, "h": h, "fl_x": 82.0, "fl_y": 82.0, "cx": w as f64 / 2.0, "cy": h as f64 / 2.0,
        "frames": [frame("view_0", [1.4, -2.2, 1.3]), frame("view_1", [-1.2, -2.4, 1.6])],
    })
}

/// A floor of 8 m and a wall behind it, coarse, with vertex colours. `which` changes the colour of the floor.
fn floor_ply(which: usize) -> String {
    let colours = [[150, 150, 150], [170, 140, 120], [120, 130, 160]];
    let [r, g, b] = colours[which % 3];
    let floor =
        [[-4, -4, 0], [4, -4, 0], [4, 4, 0], [-4, 4, 0]].map(|[x, y, z]| format!("{x} {y} {z} {r} {g} {b}"));
    let wall =
        [[-4, 3, 0], [4, 3, 0], [4, 3, 2], [-4, 3, 2]].map(|[x, y, z]| format!("{x} {y} {z} 180 90 70"));
    format!(
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
         property uchar green\nproperty uchar blue\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n{}\n{}\n\
         4 0 1 2 3\n4 4 5 6 7\n",
        floor.join("\n"),
        wall.join("\n")
    )
}

/// A box of 0.4 m by 0.4 m by 0.6 m, y up, on its origin.
fn box_obj() -> String {
    let mut text = String::new();
    for y in [0.0, 0.6] {
        for (x, z) in [(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)] {
            text.push_str(&format!("v {x} {y} {z}\n"));
        }
    }
    text + "f 1 2 3 4\nf 8 7 6 5\nf 1 5 6 2\nf 2 6 7 3\nf 3 7 8 4\nf 4 8 5 1\n"
}

/// A sky with a sun, as a panorama of 64x32 pixels. `which` moves the sun.
fn sky(path: &Path, which: usize) {
    let (width, height) = (64, 32);
    let sun = [[20, 8], [44, 9], [12, 7]][which % 3];
    let plane = |sky: f32, sun_light: f32| -> Vec<f32> {
        let pixel = |at: usize| {
            let (x, y) = (at % width, at / width);
            let is_sun = (sun[0]..sun[0] + 2).contains(&x) && (sun[1]..sun[1] + 2).contains(&y);
            if is_sun {
                sun_light
            } else if y < height / 2 {
                sky
            } else {
                0.2
            }
        };
        (0..width * height).map(pixel).collect()
    };
    let channels = [("R", 0.35, 60.0), ("G", 0.4, 55.0), ("B", 0.5, 45.0)]
        .map(|(name, sky, sun)| (Channel { name: name.to_owned(), samples: plane(sky, sun) }, Depth::Float));
    let (bytes, _) = exr::write(width, height, channels.into(), "linear", None).unwrap();
    std::fs::write(path, bytes).unwrap();
}
