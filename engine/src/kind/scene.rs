//! The `scene` block of a graph, and axis values.

use serde::{Deserialize, Serialize};

use crate::kind::param_type::ParamType;

/// The world axis that points up. World coordinates are right-handed. Written `"+y"`, `"-y"` or `"+z"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Up {
    /// `+y`, as in glTF.
    PlusY,
    /// `-y`, common with COLMAP.
    MinusY,
    /// `+z`, as in Blender.
    PlusZ,
}

impl Up {
    /// The spelling in graph files.
    pub const fn name(self) -> &'static str {
        match self {
            Up::PlusY => "+y",
            Up::MinusY => "-y",
            Up::PlusZ => "+z",
        }
    }
}

impl From<Up> for String {
    fn from(up: Up) -> Self {
        up.name().to_owned()
    }
}

impl TryFrom<String> for Up {
    type Error = String;
    fn try_from(name: String) -> Result<Self, String> {
        let known = [Up::PlusY, Up::MinusY, Up::PlusZ];
        known.into_iter().find(|up| up.name() == name).ok_or_else(|| format!("no axis `{name}`"))
    }
}

impl ParamType for Up {
    fn describe() -> String {
        "\"+y\" | \"-y\" | \"+z\"".to_owned()
    }
}

/// The `scene` block of a graph: settings that all nodes share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scene {
    /// The axis that points up.
    pub up: Up,
    /// Length of a world unit in metres.
    pub metres_per_unit: f64,
    /// Seed of all random numbers in the graph.
    pub seed: u64,
    /// True if nodes do all their work, even where a check shows that it has no effect on the output; see
    /// [`crate::Context::exhaustive`].
    pub exhaustive: bool,
}

/// Axis values of a node as (axis, value in RON): `[("yaw", "15.0")]`.
pub type Point = Vec<(String, String)>;
