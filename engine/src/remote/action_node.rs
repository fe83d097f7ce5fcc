//! The node of an action, made from its file and the table of kinds.

use std::sync::Arc;

use cache::Digest;

use crate::graph::node::{Node, Wire, node_of_parameters};
use crate::graph::surroundings::Surroundings;
use crate::kind::contract::Sizes;
use crate::kind::port::{Arity, PortSpec, Wired};
use crate::kind::registry::{KindEntry, Registry};
use crate::kind::scene::{Point, Scene, Up};
use crate::record::record::Output;
use crate::remote::action_file::ActionFile;
use crate::remote::error::ActionError;

/// A checked action.
pub(crate) struct ActionNode {
    /// The node. Its wires start at the values in [`inputs`](Self::inputs): [`Wire::node`] is an index into that
    /// list.
    pub node: Node,
    pub around: Surroundings,
    /// The values that the node reads, grouped by port, and within a port in the order of the wires.
    pub inputs: Vec<Output>,
    /// The key that the action states.
    pub key: Digest,
}

impl ActionNode {
    /// Checks an action against the table of kinds. The key is checked later, since it depends on files.
    ///
    /// # Errors
    /// If the kind, a parameter, a port or a type does not match the table of kinds.
    pub fn new(file: &ActionFile, registry: &Registry) -> Result<Self, ActionError> {
        let kind = known_kind(file, registry)?;
        let (inputs, wires) = wires(file, kind)?;
        let node = node_of_parameters(kind.clone(), &file.parameters, wires).map_err(ActionError::Invalid)?;
        let around = surroundings(file, kind, registry)?;
        Ok(Self { node, around, inputs, key: file.key.0 })
    }

    /// The value at which a wire of the node starts.
    pub fn input(&self, wire: Wire) -> &Output {
        &self.inputs[wire.node]
    }

    /// The sizes of the inputs, from which the work is computed. `files` is the total length of the source files in
    /// bytes.
    pub fn sizes(&self, files: u64) -> Sizes {
        let size =
            |wires: &[Wire]| wires.iter().fold(0, |sum: u64, w| sum.saturating_add(self.input(*w).size));
        let ports = self.node.kind.inputs.iter().zip(&self.node.inputs);
        Sizes { ports: ports.map(|(port, wires)| (port.name, size(wires))).collect(), files }
    }

    /// For each input port, its name and the digests of its values.
    pub fn input_digests(&self) -> Vec<(&'static str, Vec<Digest>)> {
        let digests = |wires: &[Wire]| wires.iter().map(|wire| self.input(*wire).digest).collect();
        let ports = self.node.kind.inputs.iter().zip(&self.node.inputs);
        ports.map(|(port, wires)| (port.name, digests(wires))).collect()
    }
}

fn known_kind<'r>(file: &ActionFile, registry: &'r Registry) -> Result<&'r Arc<KindEntry>, ActionError> {
    let named =
        |name: &str, version: u32, profile: &str| format!("version {version} of `{name}` ({profile})");
    let wanted = || named(&file.kind, file.version, &file.profile);
    let Some(kind) = registry.get(&file.kind).filter(|kind| kind.name == file.kind) else {
        let found = format!("no kind `{}`", file.kind);
        return Err(ActionError::Kind { wanted: wanted(), found });
    };
    if kind.runs_programs {
        return Err(ActionError::Program { kind: kind.name.to_owned() });
    }
    if (kind.version, kind.profile) != (file.version, file.profile.as_str()) {
        let found = named(kind.name, kind.version, kind.profile);
        return Err(ActionError::Kind { wanted: wanted(), found });
    }
    Ok(kind)
}

/// The values that the node reads, and for each port its wires, which start at these values.
fn wires(file: &ActionFile, kind: &KindEntry) -> Result<(Vec<Output>, Vec<Vec<Wire>>), ActionError> {
    let invalid = |why: String| Err(ActionError::Invalid(why));
    let named = file.inputs.iter().map(|(name, _)| name.as_str());
    if !named.eq(kind.inputs.iter().map(|port| port.name)) {
        return invalid(format!("the names of the inputs are not those of `{}`", kind.name));
    }
    let (mut inputs, mut wires) = (Vec::new(), Vec::new());
    for (PortSpec { name, arity, artifact, .. }, (_, values)) in kind.inputs.iter().zip(&file.inputs) {
        let fits = match arity {
            Arity::One => values.len() == 1,
            Arity::Optional => values.len() <= 1,
            Arity::Many => true,
        };
        if !fits {
            return invalid(format!("the input `{name}` has a wrong number of values: {}", values.len()));
        }
        let first = inputs.len();
        for value in values {
            if (value.type_name.as_str(), value.format) != (artifact.name, artifact.format) {
                let (theirs, ours) = ((&value.type_name, value.format), (artifact.name, artifact.format));
                return invalid(format!(
                    "a value of the input `{name}` is of type `{}` in format {}, not `{}` in format {}",
                    theirs.0, theirs.1, ours.0, ours.1
                ));
            }
            let (type_name, format, digest, size) =
                (artifact.name, artifact.format, value.digest.0, value.size);
            inputs.push(Output { type_name, format, digest, size, stored: true });
        }
        wires.push((first..inputs.len()).map(|node| Wire { node, port: 0 }).collect());
    }
    Ok((inputs, wires))
}

fn surroundings(
    file: &ActionFile,
    kind: &KindEntry,
    registry: &Registry,
) -> Result<Surroundings, ActionError> {
    let fields = &file.context;
    let port = |name: &str| -> Result<&'static str, ActionError> {
        let found = kind.inputs.iter().map(|port| port.name).find(|known| *known == name);
        found.ok_or_else(|| ActionError::Invalid(format!("`{}` has no input `{name}`", kind.name)))
    };
    // The names of outputs are those of the table of kinds.
    let output = |name: &String| -> Result<&'static str, ActionError> {
        let mut outputs = registry.iter().flat_map(|kind| &kind.outputs).map(|port| port.name);
        let found = outputs.find(|known| known == name);
        found.ok_or_else(|| ActionError::Invalid(format!("no kind has an output `{name}`")))
    };
    let one = |(name, outputs): &(String, Vec<String>)| -> Result<_, ActionError> {
        Ok((port(name)?, outputs.iter().map(output).collect::<Result<_, _>>()?))
    };
    let wired = fields.wired.iter().flatten().map(one).collect::<Result<_, _>>()?;
    let at = |(name, points): &(String, Vec<Point>)| Ok((port(name)?, points.clone()));
    let points = fields.points.iter().flatten().map(at).collect::<Result<_, ActionError>>()?;
    // The kind cannot read a field that it does not declare; the key shows whether a declared one is absent.
    let scene = Scene {
        up: fields.up.unwrap_or(Up::PlusZ),
        metres_per_unit: fields.metres_per_unit.unwrap_or(1.0),
        seed: fields.seed.unwrap_or(0),
        exhaustive: fields.exhaustive.unwrap_or(false),
    };
    let recipe = fields.recipe.as_deref().map(Arc::from);
    Ok(Surroundings { scene, wired: Wired(wired), points, recipe })
}
