//! The place: what is described, the packed values, the ground along a ray, and edits of several values at once.

use serde_json::{Value, json};

use crate::lab::{GRAPH, Lab, Response, digest_of};

pub const SCENE: &str = r#"Graph(
    version: 1,
    scene: (up: "+z", metres_per_unit: 0.5, seed: 3),
    nodes: (
        place:  LoadSplats(path: "demo.ply"),
        floor:  LoadMesh(path: "floor.obj"),
        object: LoadObject(path: "box.gltf"),
        sky:    LoadEnvironment(path: "sky.hdr"),
        pose:   Pose(translation: (1.0, 0.5, 0.3), yaw_deg: 30.0), // above the floor
        stands: Snap(object: "object", pose: "pose", mesh: "floor"),
        placed: Place(object: "object", pose: "stands.pose"),
        probe:  CubeRig(at: "pose", size_px: 16),
        camera: Camera(eye: (4.0, -5.0, 3.0), target: (0.0, 0.0, 1.0), width_px: 16, height_px: 12),
        trace:  PathTrace(receiver: "floor", objects: ["placed"], rig: "camera", env: "sky", samples: 1),
        faces:  SplatRender(splats: "place", rig: "probe"),
        save:   WriteImage(image: "trace.object", path: "object.png"),
        other:  WriteImage(image: "faces.colour", path: "{view}.png"),
    ),
)
"#;

/// A page of the scene, with a tetrahedron as the object and a square as the floor.
pub fn scene() -> Lab {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    write("graph.ron", SCENE.as_bytes());
    write("floor.obj", b"v -4 -4 0\nv 4 -4 0\nv 4 4 0\nv -4 4 0\nf 1 2 3\nf 1 3 4\n");
    let corners: [[f32; 3]; 4] = [[-0.2, 0.0, -0.2], [0.2, 0.0, -0.2], [0.0, 0.0, 0.3], [0.0, 0.6, 0.0]];
    let faces: [[u16; 3]; 4] = [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]];
    let positions = corners.as_flattened().iter().flat_map(|v| v.to_le_bytes());
    let indices = faces.as_flattened().iter().flat_map(|v| v.to_le_bytes());
    write("box.bin", &positions.chain(indices).collect::<Vec<u8>>());
    let object = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-0.2, 0.0, -0.2], "max": [0.2, 0.6, 0.3]},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
        "buffers": [{"uri": "box.bin", "byteLength": 72}],
    });
    write("box.gltf", object.to_string().as_bytes());
    let sky =
        [b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n".as_slice(), &[128, 128, 128, 129].repeat(32)];
    write("sky.hdr", &sky.concat());
    Lab::at(std::sync::Arc::new(folder), None).unwrap()
}

/// The description of packed bytes, and the bytes after it.
fn unpacked(response: &Response) -> (Value, &[u8]) {
    assert_eq!(response.status, 200);
    let (length, rest) = response.body.split_at(4);
    let length = u32::from_le_bytes(length.try_into().unwrap()) as usize;
    assert_eq!(length % 4, 0);
    (serde_json::from_slice(&rest[..length]).unwrap(), &rest[length..])
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

#[test]
fn the_place_says_what_is_where() {
    let lab = scene();
    lab.idle();
    let place = lab.get("/place").json();
    assert_eq!(place["metres_per_unit"], 0.5);
    assert_eq!((&place["up"], &place["name"]), (&json!([0.0, 0.0, 1.0]), &json!("+z")));
    let count = |list: &str| place[list].as_array().unwrap().len();
    assert_eq!(["splats", "meshes", "objects", "cameras", "probes"].map(count), [1, 1, 1, 1, 1], "{place}");
    let object = &place["objects"][0];
    assert_eq!((&object["node"], &object["pose"]), (&json!("placed"), &json!("pose")), "through `Snap`");
    // Two units per metre, and y of the file is up.
    let matrix: Vec<f64> = object["matrix"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let length = (0..3).map(|i| matrix[4 + i] * matrix[4 + i]).sum::<f64>().sqrt();
    assert!((length - 2.0).abs() < 1e-9 && (matrix[6] - 2.0).abs() < 1e-9, "{matrix:?}");
    assert!(matrix[14].abs() < 1e-6 && (matrix[12] - 1.0).abs() < 1e-9, "on the floor: {matrix:?}");
    assert_eq!(place["meshes"][0]["receiver"], true);
    assert_eq!(place["cameras"][0]["node"], "camera");
    assert_eq!(place["probes"][0]["node"], "probe");

    let splats = lab.get(&format!("/splats/{}", place["splats"][0]["digest"].as_str().unwrap()));
    let (head, bytes) = unpacked(&splats);
    let count = head["count"].as_u64().unwrap() as usize;
    assert_eq!((bytes.len(), &head["total"]), (count * 32, &head["count"]));
    assert_eq!(count, 3);
    let origin: Vec<f64> = head["origin"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    for (splat, (x, colour)) in bytes.as_chunks::<32>().0.iter().zip([(-0.5, 0), (0.0, 1), (0.5, 2)]) {
        let place = floats(&splat[..12]);
        assert!((f64::from(place[0]) + origin[0] - x).abs() < 1e-6 && splat[12 + colour] > 220, "{splat:?}");
        // The covariance of a sphere, divided by its square radius.
        let halves = splat[20..].as_chunks::<2>().0.iter().map(|v| half::f16::from_le_bytes(*v).to_f32());
        assert_eq!(halves.collect::<Vec<f32>>(), [1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
    }
    assert_eq!(splats.header("cache-control"), Some("private, max-age=31536000, immutable"));
    for (path, normals) in [
        (format!("/object/{}", object["shape"].as_str().unwrap()), true),
        (format!("/mesh/{}", place["meshes"][0]["digest"].as_str().unwrap()), false),
    ] {
        let response = lab.get(&path);
        let (head, bytes) = unpacked(&response);
        let [vertices, triangles] =
            ["vertices", "triangles"].map(|name| head[name].as_u64().unwrap() as usize);
        let each = if normals { 28 } else { 16 };
        assert_eq!(bytes.len(), vertices * each + triangles * 12, "{path}: {head}");
        let corners = &bytes[vertices * each..];
        let highest = corners.as_chunks::<4>().0.iter().map(|corner| u32::from_le_bytes(*corner)).max();
        assert!((highest.unwrap() as usize) < vertices);
    }
    for path in ["/splats/0", "/mesh/graph.ron", &format!("/splats/{}", object["shape"].as_str().unwrap())] {
        assert_eq!(lab.get(path).status, 404, "{path}");
    }
}

#[test]
fn the_ground_lies_where_a_ray_meets_the_mesh_or_the_splats() {
    let lab = scene();
    lab.idle();
    let place = lab.get("/place").json();
    let down = |list: &str, eye: [f64; 3]| {
        let digest = &place[list][0]["digest"];
        let ray = json!({"digest": digest, "eye": eye, "way": [0.0, 0.0, -1.0], "focal_px": 600.0});
        let response = lab.post("/ground", &ray.to_string());
        assert_eq!(response.status, 200);
        response.json()
    };
    // The floor, and a sphere with a standard deviation of 0.22 at a height of 0.2.
    for (list, range) in [("meshes", -1e-9..1e-9), ("splats", 0.2..0.65)] {
        let found = down(list, [0.0, 0.0, 2.0]);
        let height = found["position"][2].as_f64().unwrap_or_else(|| panic!("{found}"));
        assert!(range.contains(&height), "{list}: {found}");
        assert!(found["steep_deg"].as_f64().unwrap() < 20.0, "{found}");
    }
    let found = down("meshes", [1e4, 0.0, 1.4]);
    assert_eq!(
        (&found["position"], &found["why"]),
        (&Value::Null, &json!("there is no surface along this ray"))
    );
    let digest = &place["meshes"][0]["digest"];
    for (eye, way, focal) in [([0.0; 3], [0.0; 3], 1.0), ([0.0; 3], [0.0, 0.0, 1.0], -1.0)] {
        let ray = json!({"digest": digest, "eye": eye, "way": way, "focal_px": focal});
        assert!(lab.post("/ground", &ray.to_string()).json()["why"].is_string());
    }
}

#[test]
fn several_values_of_a_node_are_written_by_one_edit() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let edit = |also: Value| {
        json!({"digest": digest_of(&lab.text()), "node": "camera", "field": "eye", "value": "(1.0, -2.0, 1.5)", "also": also})
            .to_string()
    };
    let both =
        json!([{"field": "target", "value": "(0.0, 0.5, 0.25)"}, {"field": "roll_deg", "value": "5.0"}]);
    assert_eq!(lab.post("/try", &edit(both.clone())).status, 200);
    assert_eq!(lab.text(), GRAPH, "a trial is not written");
    let value = |lab: &Lab, name: &str| {
        let graph = lab.get("/graph").json();
        let nodes = graph["nodes"].as_array().unwrap().clone();
        let camera = nodes.into_iter().find(|node| node["id"] == "camera").unwrap();
        camera["values"][name]["value"].as_str().unwrap().replace(' ', "")
    };
    lab.until("the trial is used", |lab| {
        value(lab, "eye") == "(1.0,-2.0,1.5)" && value(lab, "roll_deg") == "5.0"
    });
    assert_eq!(lab.post("/set", &edit(both)).status, 200);
    let expected = GRAPH
        .replace("eye: (2.0, -2.5, 1.2)", "eye: (1.0, -2.0, 1.5)")
        .replace("target: (0.0, 0.0, 0.2)", "target: (0.0, 0.5, 0.25)")
        .replace("fov_y_deg: 40.0)", "fov_y_deg: 40.0, roll_deg: 5.0)");
    assert_eq!(lab.text(), expected);
    // If one of them is refused, none is written.
    for (also, word) in [
        (json!([{"field": "name", "value": "nothing("}]), "RON"),
        (json!([{"field": "fov_y_deg", "value": "720.0"}]), "invalid"),
        (json!([{"field": "colour", "value": "1.0"}]), "no parameter"),
        (json!(vec![json!({"field": "roll_deg", "value": "1.0"}); 40]), "at most 16"),
    ] {
        let response = lab.post("/set", &edit(also));
        assert_eq!(response.status, 422);
        assert!(response.json().to_string().contains(word), "{}", response.json());
        assert_eq!(lab.text(), expected);
    }
    assert_eq!(lab.post("/undo", &format!("{{\"digest\":\"{}\"}}", digest_of(&expected))).status, 200);
    assert_eq!(lab.text(), GRAPH, "one step back takes all of them");
}
