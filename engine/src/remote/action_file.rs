//! The description of an action as a file.

use cache::Digest;
use ron::ser::PrettyConfig;
use serde::{Deserialize, Serialize};

use crate::graph::node::{Node, Wire};
use crate::graph::surroundings::Surroundings;
use crate::kind::context::{ContextField, ReadSource};
use crate::kind::param_type::Role;
use crate::kind::scene::Point;
use crate::record::action::Action;
use crate::record::record::Output;

/// Name of the file in an action folder.
pub(crate) const NAME: &str = "action.ron";
/// Folder of the values in an action folder.
pub(crate) const BLOBS: &str = "blobs";
/// Folder of the source files in an action folder.
pub(crate) const FILES: &str = "files";
/// The current format of the file.
pub(crate) const FORMAT: u32 = 1;

/// A digest in hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub(crate) struct Hex(pub Digest);

impl From<Hex> for String {
    fn from(hex: Hex) -> Self {
        hex.0.to_string()
    }
}

impl TryFrom<String> for Hex {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        Digest::from_hex(&text).map(Hex).ok_or_else(|| format!("`{text}` is not a digest"))
    }
}

/// A node whose inputs are identified by digests. The file contains everything that the key of the node contains,
/// and nothing else except the names of output files. So nodes with equal keys have equal actions, which a server
/// needs to run only once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename = "Action", deny_unknown_fields)]
pub(crate) struct ActionFile {
    /// [`FORMAT`].
    pub format: u32,
    /// The key of the node. The worker computes the key itself and compares.
    pub key: Hex,
    pub kind: String,
    pub version: u32,
    pub profile: String,
    /// The parameters, each as its name and its canonical text.
    pub parameters: Vec<(String, String)>,
    pub context: ContextFields,
    /// The input ports, each as its name and its values, in the order of the wires.
    pub inputs: Vec<(String, Vec<InputValue>)>,
    pub sources: Vec<InputFile>,
}

/// The context fields that the kind declares. Fields that it does not declare are `None`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct ContextFields {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub up: Option<crate::kind::scene::Up>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metres_per_unit: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exhaustive: Option<bool>,
    /// For each input port, the names of the outputs from which its wires come.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wired: Option<Vec<(String, Vec<String>)>>,
    /// For each input port, the axis values of the nodes from which its wires come.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<Vec<(String, Vec<Point>)>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recipe: Option<String>,
}

/// A value that an input receives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct InputValue {
    #[serde(rename = "type")]
    pub type_name: String,
    pub format: u32,
    pub digest: Hex,
    /// The [`crate::Artifact::size`] of the value, from which the work of the node is computed.
    pub size: u64,
}

/// A source file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct InputFile {
    /// Name as written in the graph.
    pub name: String,
    pub digest: Hex,
    pub bytes: u64,
}

impl ActionFile {
    /// Describes a node whose inputs are known. `output` returns the output at which a wire starts.
    ///
    /// # Panics
    /// If `action` has no key.
    pub fn of<'s>(
        node: &Node,
        around: &Surroundings,
        output: impl Fn(Wire) -> &'s Output,
        action: &Action,
    ) -> Self {
        let kind = &node.kind;
        let reads = |field| kind.reads.contains(&field);
        let scene = &around.scene;
        let owned = |names: &[&'static str]| names.iter().map(|name| (*name).to_owned()).collect();
        let context = ContextFields {
            up: reads(ContextField::Up).then_some(scene.up),
            metres_per_unit: reads(ContextField::MetresPerUnit).then_some(scene.metres_per_unit),
            seed: reads(ContextField::Seed).then_some(scene.seed),
            exhaustive: reads(ContextField::Exhaustive).then_some(scene.exhaustive),
            wired: reads(ContextField::Wired).then(|| {
                around.wired.0.iter().map(|(port, names)| ((*port).to_owned(), owned(names))).collect()
            }),
            points: reads(ContextField::Points).then(|| {
                around.points.iter().map(|(port, points)| ((*port).to_owned(), points.clone())).collect()
            }),
            recipe: reads(ContextField::Recipe)
                .then(|| around.recipe.as_deref().unwrap_or_default().to_owned()),
        };
        let value = |wire: &Wire| {
            let Output { type_name, format, digest, size, .. } = output(*wire);
            InputValue {
                type_name: (*type_name).to_owned(),
                format: *format,
                digest: Hex(*digest),
                size: *size,
            }
        };
        let file = |ReadSource { file, digest, bytes }: &ReadSource| InputFile {
            name: file.name.clone(),
            digest: Hex(*digest),
            bytes: *bytes,
        };
        let ports = kind.inputs.iter().zip(&node.inputs);
        Self {
            format: FORMAT,
            key: Hex(action.digest()),
            kind: kind.name.to_owned(),
            version: kind.version,
            profile: kind.profile.to_owned(),
            parameters: parameters(node),
            context,
            inputs: ports
                .map(|(port, wires)| (port.name.to_owned(), wires.iter().map(value).collect()))
                .collect(),
            sources: action.sources.iter().map(file).collect(),
        }
    }

    /// The text of the file.
    pub fn text(&self) -> String {
        let layout = PrettyConfig::new().struct_names(true).depth_limit(4);
        // All fields have a form in RON.
        ron::ser::to_string_pretty(self, layout).expect("an action can be written") + "\n"
    }

    /// Parses the text of the file.
    ///
    /// # Errors
    /// If the text is not an action of the current format, the reason.
    pub fn parse(text: &str) -> Result<Self, String> {
        // The format is read first, since other formats have other fields.
        #[derive(Deserialize)]
        #[serde(rename = "Action")]
        struct Head {
            format: u32,
        }
        let Head { format } = ron::from_str(text).map_err(|error| error.to_string())?;
        if format != FORMAT {
            return Err(format!(
                "the action has format {format}, but this version of lightharmony reads format {FORMAT}"
            ));
        }
        ron::from_str(text).map_err(|error| error.to_string())
    }
}

/// The parameters of a node. The name of an output file is reduced to its extension, as in the key.
fn parameters(node: &Node) -> Vec<(String, String)> {
    let mut parameters = Vec::with_capacity(node.kind.params.len());
    let mut specs = node.kind.params.iter();
    node.step.visit(&mut |name, value| {
        let is_output = specs.next().is_some_and(|spec| spec.role == Role::Output);
        // Values that are not canonical were rejected by the check.
        let text = match (is_output, value.key_text()) {
            (true, Ok(Some(text))) => Some(format!("{:?}", text.replace('*', "output"))),
            _ => value.text().ok(),
        };
        parameters.extend(text.map(|text| (name.to_owned(), text)));
    });
    parameters
}
