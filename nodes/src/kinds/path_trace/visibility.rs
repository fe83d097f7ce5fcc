//! How the receiver is to treat each sort of ray: the parameters.

use engine::ParamType;
use serde::{Deserialize, Serialize};

use crate::render::transport::scene::block::{LAYERS, MOST_LAYERS};

/// How the receiver blocks light of the environment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum EnvBlock {
    /// Decided by probe rays; see the report.
    Auto,
    /// Like any solid body: right for open scenes.
    Solid,
    /// Not at all.
    Pass,
    /// Rays pass faces seen from the front and stop at backs: in a closed mesh whose normals point into
    /// the room only the outer shell is transparent, furniture casts shadows.
    FrontFace {
        /// A ray that has passed this many front faces reaches the sky.
        #[serde(default = "three")]
        max_layers: u32,
    },
    /// What lies farther than this from the point of capture does not block.
    PassBeyond {
        /// The distance.
        metres: f64,
    },
    /// The indicator as the paper prints it, for comparison: solid to shadow and diffuse rays, not there for
    /// camera and glossy ones. It gives a closed room no light and no shadow; `bounce` and
    /// `object_specular_sees` have no say.
    Paper,
}

fn three() -> u32 {
    LAYERS
}

impl ParamType for EnvBlock {
    fn describe() -> String {
        "Auto | Solid | Pass | FrontFace(max_layers: 3) | PassBeyond(metres: number) | Paper".to_owned()
    }
}

impl EnvBlock {
    /// What its number must be, where it is not so.
    pub fn out_of_range(&self) -> Option<String> {
        match self {
            EnvBlock::PassBeyond { metres } if !metres.is_finite() || *metres < 0.0 => {
                Some(format!("`metres` must be at least 0, and is {metres}"))
            }
            EnvBlock::FrontFace { max_layers } if !(1..=MOST_LAYERS as u32).contains(max_layers) => {
                Some(format!("`max_layers` must lie between 1 and {MOST_LAYERS}, and is {max_layers}"))
            }
            _ => None,
        }
    }
}

engine::choices! {
    /// What a scattered ray finds where it meets the receiver.
    pub enum Bounce {
        /// `Solid` where the receiver blocks like a solid body, else `Env`.
        Auto,
        /// The environment behind it, which already shows the room: each light counts once.
        Env,
        /// The receiver, lit and matte.
        Solid,
    }
}

engine::choices! {
    /// What a reflection in an object shows where it meets the receiver.
    pub enum SpecularSees {
        /// `Env` where the environment was captured in the place or the receiver lets it through, else
        /// `Receiver`.
        Auto,
        /// The environment, which is sharper than a mesh of vertex colours.
        Env,
        /// The receiver.
        Receiver,
    }
}

engine::choices! {
    /// Whether the receiver is the light that the environment shows of it.
    pub enum NearField {
        /// `On` where the environment was captured in a place of which the receiver is a quarter or more, and
        /// `env_block`, `bounce` and `object_specular_sees` are left to `Auto`.
        Auto,
        /// Rays that meet the receiver find what the environment shows in the direction of that place, seen
        /// from the point of capture. The other rules of visibility have no say then.
        On,
        /// The environment is infinitely far.
        Off,
    }
}
