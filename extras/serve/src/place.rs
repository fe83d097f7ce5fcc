//! The place as JSON: what is where in the world, and the nodes that say so.

use std::collections::BTreeMap;

use engine::Wire;
use glam::DMat4;
use scene::math::equirect::axes;
use scene::types::Camera;
use serde_json::{Value, json};

use crate::editor::SharedGraph;
use crate::live::Live;
use crate::starter::AXES;
use crate::thing::{TYPES, Thing};

/// Maximum number of objects, and of cameras, that are listed.
const MOST: usize = 500;

/// The digests of the values that outputs have now.
type Outputs = BTreeMap<(usize, usize), String>;

/// Describes the place of the graph that the page shows; `null` without a graph.
pub fn place(live: &Live) -> Value {
    let known = live.with_state(|state| Some((state.graph.clone()?, state.outputs(&TYPES))));
    let Some((graph, outputs)) = known else { return Value::Null };
    let outputs: Outputs = outputs
        .into_iter()
        .filter_map(|(id, port, digest)| Some(((graph.find(&id)?, port), digest)))
        .collect();
    Survey { live, graph, outputs }.json()
}

struct Survey<'l> {
    live: &'l Live,
    graph: SharedGraph,
    outputs: Outputs,
}

impl Survey<'_> {
    fn json(&self) -> Value {
        let scene = &self.graph.scene;
        let [right, forward, up] = axes(scene.up).map(|axis| axis.to_array());
        let mut json = json!({
            "name": scene.up.name(), "right": right, "forward": forward, "up": up,
            "metres_per_unit": scene.metres_per_unit,
            "start": self.start(), "splats": [], "meshes": [], "objects": [], "cameras": [], "probes": [],
        });
        for (&(node, port), digest) in &self.outputs {
            let wire = Wire { node, port };
            let (list, entries) = match self.type_of(wire) {
                "splats" => ("splats", vec![json!({"digest": digest, "node": self.id(node)})]),
                "mesh" => ("meshes", vec![self.mesh(wire, digest)]),
                "placed" => ("objects", self.object(wire, digest).into_iter().collect()),
                "rig" if self.kind(node) == "CubeRig" => {
                    ("probes", self.probe(wire, digest).into_iter().collect())
                }
                "rig" => ("cameras", self.cameras(wire, digest)),
                _ => continue,
            };
            if let Some(known) = json[list].as_array_mut() {
                let room = MOST.saturating_sub(known.len());
                known.extend(entries.into_iter().take(room));
            }
        }
        json
    }

    /// The objects that can be put into a bare capture; `null` if the graph has one, or was not started from a
    /// capture.
    fn start(&self) -> Value {
        let is_placed = |node: &&std::sync::Arc<engine::Node>| {
            node.kind.outputs.iter().any(|port| port.artifact.name == "placed")
        };
        match &self.live.starter {
            Some(starter) if !self.graph.nodes.iter().any(|node| is_placed(&node)) => {
                let bare = starter.bare(&self.graph);
                json!({
                    "proposals": bare.proposals, "objects": starter.objects(), "up": bare.up, "axes": AXES,
                })
            }
            _ => Value::Null,
        }
    }

    fn id(&self, node: usize) -> &str {
        &self.graph.nodes[node].id
    }

    /// The name of a node in the file; instances along axes have the same.
    fn name(&self, node: usize) -> &str {
        let one = &self.graph.nodes[node];
        if one.point.is_empty() { &one.id } else { one.id.split('/').next().unwrap_or(&one.id) }
    }

    fn kind(&self, node: usize) -> String {
        self.graph.nodes[node].kind.camel_name()
    }

    fn type_of(&self, wire: Wire) -> &'static str {
        self.graph.nodes[wire.node].kind.outputs[wire.port].artifact.name
    }

    fn thing(&self, wire: Wire, digest: &str) -> Option<std::sync::Arc<Thing>> {
        self.live.thing_of(&self.graph, wire, digest)
    }

    fn mesh(&self, Wire { node, port }: Wire, digest: &str) -> Value {
        let is_receiver = self.graph.nodes.iter().any(|below| {
            let inputs = below.kind.inputs.iter().zip(&below.inputs);
            let mut wires = inputs.filter(|(port, _)| port.name == "receiver").flat_map(|(_, wires)| wires);
            wires.any(|wire| wire.node == node && wire.port == port)
        });
        json!({"digest": digest, "node": self.id(node), "receiver": is_receiver})
    }

    /// The first wire into a node whose value has one of these types.
    fn above(&self, node: usize, types: &[&str]) -> Option<Wire> {
        let one = &self.graph.nodes[node];
        let inputs = one.kind.inputs.iter().zip(&one.inputs);
        let mut fitting = inputs.filter(|(port, _)| types.contains(&port.artifact.name));
        fitting.find_map(|(_, wires)| wires.first().copied())
    }

    /// The `Pose` from which the pose of a placed object is derived, for instance through `Snap`.
    fn pose_of(&self, node: usize) -> Option<usize> {
        let mut at = node;
        for _ in 0..self.graph.nodes.len() {
            at = self.above(at, &["pose", "placed"])?.node;
            if self.kind(at) == "Pose" {
                return Some(at);
            }
        }
        None
    }

    fn object(&self, wire: Wire, digest: &str) -> Option<Value> {
        let is_changed = |below: &engine::Node| {
            let gives = below.kind.outputs.iter().any(|port| port.artifact.name == "placed");
            gives && below.inputs.iter().flatten().any(|above| *above == wire)
        };
        if self.graph.nodes.iter().any(|below| is_changed(below)) {
            return None;
        }
        let thing = self.thing(wire, digest)?;
        let Thing::Placed(placed) = &*thing else { return None };
        // The shape of an object that moves is loaded once.
        let shape =
            self.above(wire.node, &["object"]).and_then(|above| self.outputs.get(&(above.node, above.port)));
        let pose = self.pose_of(wire.node);
        Some(json!({
            "node": self.id(wire.node),
            "shape": shape.map_or(digest, String::as_str),
            "matrix": placed.world_from_object.to_cols_array(),
            "pose": pose.map(|pose| self.name(pose)),
            "pose_id": pose.map(|pose| self.id(pose)),
        }))
    }

    fn rig(&self, wire: Wire, digest: &str) -> Vec<Camera> {
        match self.thing(wire, digest).as_deref() {
            Some(Thing::Rig(rig)) => rig.cameras.clone(),
            _ => Vec::new(),
        }
    }

    fn probe(&self, wire: Wire, digest: &str) -> Option<Value> {
        let eye = self.rig(wire, digest).first()?.eye();
        Some(json!({"node": self.id(wire.node), "eye": eye.to_array()}))
    }

    fn cameras(&self, wire: Wire, digest: &str) -> Vec<Value> {
        let describe = |camera: Camera| {
            let matrix = DMat4::from_cols_array(&camera.world_from_camera).to_cols_array();
            json!({
                "node": self.name(wire.node), "id": self.id(wire.node), "kind": self.kind(wire.node), "name": camera.name,
                "width": camera.width_px, "height": camera.height_px,
                "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy, "matrix": matrix,
            })
        };
        self.rig(wire, digest).into_iter().map(describe).collect()
    }
}
