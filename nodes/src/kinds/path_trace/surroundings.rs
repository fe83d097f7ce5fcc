//! The parameter `surroundings`: how the mesh and the panorama together model the place.

use engine::ParamType;
use render::transport::scene::block::{LAYERS, MOST_LAYERS};
use serde::{Deserialize, Serialize};

/// How the mesh and the panorama together model the place around the objects.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Surroundings {
    /// Chosen by probe rays from the point of capture.
    Auto,
    /// Same as `Auto`, but the panorama is always infinitely far away.
    Distant,
    /// The panorama is projected from its point of capture onto the mesh, which emits it (near-field light).
    Projected,
    /// An open scene: the mesh blocks and reflects light like any solid object.
    Open {
        /// True if the mesh reflects light.
        #[serde(default = "yes")]
        bounces: bool,
    },
    /// A closed room: light enters through front faces and is blocked by back faces.
    Room {
        /// Number of front faces after which a ray counts as outside, 1 to [`MOST_LAYERS`].
        #[serde(default = "layers")]
        layers: u32,
        /// True if scattered light is reflected by the mesh.
        #[serde(default)]
        bounces: bool,
    },
    /// The mesh does not block the light of the panorama.
    Transparent {
        /// True if scattered light is reflected by the mesh.
        #[serde(default)]
        bounces: bool,
    },
    /// Only the part of the mesh that is close to the point of capture blocks the light of the panorama.
    Within {
        /// Distance from the point of capture in metres, at least 0.
        metres: f64,
        /// True if scattered light is reflected by the mesh.
        #[serde(default)]
        bounces: bool,
    },
    /// Visibility as printed in the paper, for comparison.
    Paper,
}

fn yes() -> bool {
    true
}

fn layers() -> u32 {
    LAYERS
}

impl Surroundings {
    /// An open scene whose mesh reflects light.
    pub const OPEN: Self = Self::Open { bounces: true };
    /// A closed room whose panorama already shows the light that its walls reflect.
    pub const ROOM: Self = Self::Room { layers: LAYERS, bounces: false };
    /// A mesh that blocks and reflects no light of the panorama.
    pub const TRANSPARENT: Self = Self::Transparent { bounces: false };

    /// Each choice and its documentation.
    pub const CHOICES: [(&'static str, &'static str); 8] = [
        (
            "Auto",
            "Projected, Open, Room or Transparent, chosen by 256 probe rays from the point of capture; a note reports the choice.",
        ),
        ("Distant", "Same as Auto, but the panorama is always infinitely far away (never Projected)."),
        (
            "Projected",
            "The panorama is projected from its point of capture onto the mesh, which emits the light that the \
             panorama shows there (near-field light).",
        ),
        (
            "Open(bounces: true)",
            "An open scene: the mesh blocks the light of the panorama and reflects light like any solid object.",
        ),
        (
            "Room(layers: 3, bounces: false)",
            "A closed room: light enters through front faces and is blocked by back faces, so walls seen from inside are \
             transparent and furniture casts shadows. A ray that has passed `layers` front faces counts as outside.",
        ),
        ("Transparent(bounces: false)", "The mesh does not block the light of the panorama."),
        (
            "Within(metres: number, bounces: false)",
            "The part of the mesh within this distance of the point of capture blocks the light of the panorama; the rest \
             does not.",
        ),
        (
            "Paper",
            "Visibility as printed in the paper, for comparison: the mesh is solid to shadow and diffuse rays, and \
             invisible to camera and glossy rays. A closed room gets no light and no shadow.",
        ),
    ];

    /// Reason why a number is out of range. `None` if all numbers are valid.
    pub fn out_of_range(&self) -> Option<String> {
        match self {
            Self::Within { metres, .. } if !metres.is_finite() || *metres < 0.0 => {
                Some(format!("`metres` is {metres}; it must be at least 0"))
            }
            Self::Room { layers, .. } if !(1..=MOST_LAYERS as u32).contains(layers) => {
                Some(format!("`layers` is {layers}; it must be 1 to {MOST_LAYERS}"))
            }
            _ => None,
        }
    }

    /// True if probe rays are sent from the point of capture to the mesh.
    pub(super) fn probes(&self) -> bool {
        matches!(self, Self::Auto | Self::Distant | Self::Projected | Self::Room { .. })
    }
}

impl ParamType for Surroundings {
    fn describe() -> String {
        Self::CHOICES.map(|(choice, _)| choice).join(" | ")
    }
    fn choices() -> Vec<(&'static str, &'static str)> {
        Self::CHOICES.to_vec()
    }
}
