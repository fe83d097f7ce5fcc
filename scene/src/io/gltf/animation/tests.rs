use base64::Engine as _;
use engine::{Context, InputFile, NodeError, Notes, Scene, Up};
use serde_json::{Value, json};

use super::{AfterEnd, Moment};
use crate::io::gltf::Want;
use crate::io::gltf::object::object;
use crate::types::Object;

/// A document under construction, whose accessors all hold floats.
struct Made {
    json: Value,
    bytes: Vec<u8>,
}

impl Made {
    /// A triangle with the corners (0, 0, 0), (1, 0, 0) and (0, 1, 0), for the mesh with the index 0.
    fn new(nodes: Value) -> Self {
        let json = json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes,
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "accessors": [], "bufferViews": [],
        });
        let mut made = Self { json, bytes: Vec::new() };
        made.accessor("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        made
    }

    /// Adds an accessor and returns its index.
    fn accessor(&mut self, shape: &str, numbers: &[f32]) -> usize {
        let width = match shape {
            "SCALAR" => 1,
            "VEC3" => 3,
            _ => 4,
        };
        let list = |json: &mut Value, name: &str, value: Value| {
            let list = json[name].as_array_mut().unwrap_or_else(|| panic!("no {name}"));
            list.push(value);
            list.len() - 1
        };
        let view = json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": 4 * numbers.len()});
        self.bytes.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
        let view = list(&mut self.json, "bufferViews", view);
        let count = numbers.len() / width;
        list(
            &mut self.json,
            "accessors",
            json!({"bufferView": view, "componentType": 5126, "count": count, "type": shape}),
        )
    }

    /// Adds an animation with one channel.
    fn animate(
        &mut self,
        name: &str,
        target: Value,
        interpolation: &str,
        times: &[f32],
        values: (&str, &[f32]),
    ) {
        let (input, output) = (self.accessor("SCALAR", times), self.accessor(values.0, values.1));
        let animation = json!({
            "name": name, "channels": [{"sampler": 0, "target": target}],
            "samplers": [{"input": input, "output": output, "interpolation": interpolation}],
        });
        match self.json.get_mut("animations").and_then(Value::as_array_mut) {
            Some(list) => list.push(animation),
            None => self.json["animations"] = json!([animation]),
        }
    }

    /// The object at a moment, or as stored.
    fn at(&self, moment: Option<Moment<'_>>) -> Result<(Object, Notes), NodeError> {
        let mut json = self.json.clone();
        let text = base64::engine::general_purpose::STANDARD.encode(&self.bytes);
        json["buffers"] = json!([{"byteLength": self.bytes.len(), "uri": format!("data:application/octet-stream;base64,{text}")}]);
        let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
        let (cx, path) = (Context::detached(scene, "."), InputFile("a.gltf".to_owned()));
        let mut notes = Notes::none();
        let bytes = json.to_string();
        object(&path, bytes.as_bytes(), Want::Everything, (None, moment), &cx, &mut notes)
            .map(|read| (read, notes))
    }

    /// The second corner of the triangle at a time of the clip `a`.
    fn corner(&self, seconds: f64) -> [f32; 3] {
        let moment = Moment { clip: "a", seconds, after_end: AfterEnd::Refuse };
        self.at(Some(moment)).unwrap_or_else(|e| panic!("{e}")).0.primitives[0].positions[1]
    }
}

fn near(a: [f32; 3], b: [f32; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6)
}

/// A node and its parent move; without a clip, the nodes stay where the file places them.
#[test]
fn nodes_move_with_their_parents() {
    let mut made = Made::new(json!([{"children": [1], "translation": [0.0, 0.0, 9.0]}, {"mesh": 0}]));
    made.animate(
        "a",
        json!({"node": 0, "path": "translation"}),
        "LINEAR",
        &[0.0, 2.0],
        ("VEC3", &[0.0, 0.0, 0.0, 0.0, 4.0, 0.0]),
    );
    assert_eq!(made.corner(0.5), [1.0, 1.0, 0.0]);
    let (stored, notes) = made.at(None).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(stored.primitives[0].positions[1], [1.0, 0.0, 9.0]);
    assert!(notes.iter().any(|note| note.text.contains("`a`, which are not played")));
}

/// A quarter turn about z in one second, by each interpolation; the tangents of the spline are 0, so it is slower at
/// its ends. This fails if the quaternion of a spline is not normalised.
#[test]
fn rotations_are_interpolated_as_stated() {
    let half = 0.5_f32.sqrt();
    let keys = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, half, half];
    let zero = [0.0; 4];
    let spline = [&zero[..], &keys[..4], &zero, &zero, &keys[4..], &zero].concat();
    let at = |degrees: f64| {
        let (sin, cos) = crate::math::num::sin_cos_deg(degrees);
        [cos as f32, sin as f32, 0.0]
    };
    for (interpolation, values, expected) in [
        ("LINEAR", &keys[..], at(22.5)),
        ("STEP", &keys, at(0.0)),
        // The middle of the weights 27/32 and 5/32 of the two quaternions.
        (
            "CUBICSPLINE",
            &spline,
            at(2.0 * crate::math::num::atan2(5.0 * 0.5_f64.sqrt(), 27.0 + 5.0 * 0.5_f64.sqrt()).to_degrees()),
        ),
    ] {
        let mut made = Made::new(json!([{"mesh": 0}]));
        made.animate(
            "a",
            json!({"node": 0, "path": "rotation"}),
            interpolation,
            &[0.0, 1.0],
            ("VEC4", values),
        );
        assert!(near(made.corner(0.25), expected), "{interpolation}: {:?}", made.corner(0.25));
        assert!(near(made.corner(1.0), [0.0, 1.0, 0.0]));
    }
}

#[test]
fn morph_weights_are_animated() {
    let mut made = Made::new(json!([{"mesh": 0}]));
    let up = made.accessor("VEC3", &[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    let out = made.accessor("VEC3", &[0.0, 0.0, 0.0, 8.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    made.json["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": up}, {"POSITION": out}]);
    let target = json!({"node": 0, "path": "weights"});
    made.animate("a", target.clone(), "LINEAR", &[0.0, 1.0], ("SCALAR", &[0.0, 0.0, 1.0, 0.5]));
    assert_eq!(made.corner(0.5), [3.0, 0.0, 0.5]);
    made.animate("b", target, "LINEAR", &[0.0, 1.0], ("SCALAR", &[0.0, 0.0]));
    let moment = Moment { clip: "b", seconds: 0.0, after_end: AfterEnd::Refuse };
    let error = made.at(Some(moment)).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(
        error.contains("channel 0 of animation 1 has 1 morph weights per key, but the mesh has 2"),
        "{error}"
    );
}

/// A skinned mesh follows a joint that the animation moves.
#[test]
fn skins_follow_animated_joints() {
    let mut made = Made::new(json!([{"mesh": 0, "skin": 0}, {}]));
    made.json["scenes"][0]["nodes"] = json!([0, 1]);
    made.json["skins"] = json!([{"joints": [1]}]);
    let weights = made.accessor("VEC4", &[1.0, 0.0, 0.0, 0.0].repeat(3));
    // Twelve bytes of joint indices, all 0.
    let joints = made.accessor("VEC3", &[0.0; 3]);
    made.json["accessors"][joints] =
        json!({"bufferView": joints, "componentType": 5121, "count": 3, "type": "VEC4"});
    made.json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(joints);
    made.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(weights);
    made.animate(
        "a",
        json!({"node": 1, "path": "scale"}),
        "LINEAR",
        &[1.0, 2.0],
        ("VEC3", &[1.0, 1.0, 1.0, 3.0, 1.0, 1.0]),
    );
    assert_eq!([0.0, 1.0, 1.5, 2.0].map(|t| made.corner(t)[0]), [1.0, 1.0, 2.0, 3.0]);
}

#[test]
fn times_after_the_end_follow_the_rule() {
    let mut made = Made::new(json!([{"mesh": 0}]));
    made.animate(
        "a",
        json!({"node": 0, "path": "translation"}),
        "LINEAR",
        &[0.0, 1.25],
        ("VEC3", &[0.0, 0.0, 0.0, 0.0, 5.0, 0.0]),
    );
    let at = |seconds, after_end| made.at(Some(Moment { clip: "a", seconds, after_end }));
    let height =
        |seconds, rule| at(seconds, rule).unwrap_or_else(|e| panic!("{e}")).0.primitives[0].positions[0][1];
    assert_eq!(height(9.0, AfterEnd::Hold), 5.0);
    assert_eq!(height(3.0, AfterEnd::Repeat), 2.0);
    assert_eq!(height(1.25, AfterEnd::Repeat), 5.0);
    let error = at(1.5, AfterEnd::Refuse).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("animation `a` ends at 1.25 s, before 1.5 s"), "{error}");
    let error = made.at(Some(Moment { clip: "b", seconds: 0.0, after_end: AfterEnd::Hold }));
    let error = error.err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("has no animation `b`; its animations are `a`"), "{error}");
}

/// Channels of extensions and channels without a node are ignored; what breaks the rules is refused by name.
#[test]
fn channels_are_checked() {
    let moment = Some(Moment { clip: "a", seconds: 0.0, after_end: AfterEnd::Hold });
    let with = |target: Value, interpolation: &str, values: &[f32]| {
        let mut made = Made::new(json!([{"mesh": 0, "matrix": glam::Mat4::IDENTITY.to_cols_array()}]));
        made.animate("a", target, interpolation, &[0.0, 1.0], ("VEC3", values));
        made.at(moment)
    };
    let pointer =
        json!({"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": "/materials/0"}}});
    for target in [pointer, json!({"path": "scale"})] {
        let (_, notes) = with(target, "LINEAR", &[1.0; 6]).unwrap_or_else(|e| panic!("{e}"));
        assert!(notes.iter().any(|note| note.id == "animation-ignored"));
    }
    let mut plain = Made::new(json!([{"mesh": 0}]));
    let target = json!({"node": 0, "path": "scale"});
    plain.animate("a", target.clone(), "ODD", &[0.0, 1.0], ("VEC3", &[1.0; 6]));
    plain.animate("b", target.clone(), "STEP", &[0.0, 1.0], ("VEC3", &[1.0; 3]));
    plain.animate("c", json!({"node": 7, "path": "scale"}), "STEP", &[0.0], ("VEC3", &[1.0; 3]));
    plain.animate("d", target.clone(), "STEP", &[0.0], ("VEC3", &[1.0; 3]));
    plain.json["animations"][3]["samplers"][0]["input"] = json!(99);
    let failed = |clip| plain.at(Some(Moment { clip, seconds: 0.0, after_end: AfterEnd::Hold }));
    for (result, says) in [
        (with(target, "LINEAR", &[1.0; 6]), "animates a node that has a matrix"),
        (failed("a"), "has the unknown interpolation `ODD`"),
        (failed("b"), "has 3 values; 2 keys need 6"),
        (failed("c"), "animates a node that does not exist"),
        (failed("d"), "has no accessor `input`"),
    ] {
        let error = result.err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(says), "{error}");
    }
}
