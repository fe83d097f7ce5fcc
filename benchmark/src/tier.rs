//! Tiers: which parts of a case are true and which are recovered, so that the limit of each part is known.

use std::fmt;

/// A tier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Tier {
    /// True background and true light; the rest is light transport and compositing.
    TrueLight,
    /// True background, and light recovered from the splats.
    RecoveredLight,
    /// The splats as background, and light recovered from them.
    Splats,
}

impl Tier {
    /// All tiers that can be run.
    pub const ALL: [Self; 3] = [Self::TrueLight, Self::RecoveredLight, Self::Splats];

    /// Name on the command line, in tables and in paths.
    pub fn name(self) -> &'static str {
        match self {
            Self::TrueLight => "true-light",
            Self::RecoveredLight => "recovered-light",
            Self::Splats => "splats",
        }
    }

    /// Name within the names of nodes.
    pub(crate) fn id(self) -> &'static str {
        match self {
            Self::TrueLight => "true_light",
            Self::RecoveredLight => "recovered_light",
            Self::Splats => "splats",
        }
    }

    /// Description in one sentence.
    pub fn description(self) -> &'static str {
        match self {
            Self::TrueLight => "True background and true light.",
            Self::RecoveredLight => "True background, and light recovered from the given splats.",
            Self::Splats => "The given splats as background, and light recovered from them.",
        }
    }

    /// True if the tier needs splats.
    pub fn needs_splats(self) -> bool {
        self != Self::TrueLight
    }

    /// The tier with this name.
    ///
    /// # Errors
    /// A text that states the names, or why the tier cannot be run.
    pub fn named(name: &str) -> Result<Self, String> {
        if name == "trained" {
            let why = "the tier `trained` (splats and mesh trained from the photographs) cannot be run yet";
            return Err(format!(
                "{why}; train them with `lightharmony` and give them as `splats` and `mesh` of the cases"
            ));
        }
        let names = Self::ALL.map(Self::name).join(", ");
        let found = Self::ALL.into_iter().find(|tier| tier.name() == name);
        found.ok_or_else(|| format!("`{name}` is not a tier; write one of {names}"))
    }
}

impl fmt::Display for Tier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
