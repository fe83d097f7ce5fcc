//! The rate of a film, as written in a graph file.

use engine::ParamType;
use serde::{Deserialize, Serialize};

/// Size of a film in relation to its quality.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Rate {
    /// Constant quality, from 1 to 100: the size follows from the content.
    Quality(f64),
    /// A mean rate in megabits per second, from 0.01 to 1000: the quality follows from the content. It holds for each
    /// segment.
    Mbps(f64),
}

impl Rate {
    /// Checks that the number is within its range.
    pub(crate) fn mistake(self) -> Option<String> {
        let (name, value, low, high) = match self {
            Self::Quality(value) => ("Quality", value, 1.0, 100.0),
            Self::Mbps(value) => ("Mbps", value, 0.01, 1000.0),
        };
        let is_within = (low..=high).contains(&value);
        (!is_within).then(|| format!("`{name}` must be {low} to {high}, but is {value}"))
    }
}

impl ParamType for Rate {
    fn describe() -> String {
        "Quality(1 to 100) | Mbps(0.01 to 1000)".to_owned()
    }

    fn choices() -> Vec<(&'static str, &'static str)> {
        vec![
            ("Quality", "Constant quality, from 1 to 100; the size follows from the content."),
            (
                "Mbps",
                "A mean rate in megabits per second, from 0.01 to 1000; the quality follows from the content. It holds for \
                 each segment.",
            ),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_outside_their_range_are_reported() {
        assert_eq!(Rate::Quality(75.0).mistake(), None);
        assert_eq!(Rate::Mbps(4.0).mistake(), None);
        assert_eq!(Rate::Quality(0.0).mistake().as_deref(), Some("`Quality` must be 1 to 100, but is 0"));
        assert!(Rate::Mbps(1e4).mistake().is_some() && Rate::Mbps(f64::NAN).mistake().is_some());
    }
}
