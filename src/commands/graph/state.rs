//! How the drawing shows the state of a node.

use engine::Fate;

/// The word and the fill colour with which the drawing shows the state of a node.
pub(super) fn state(fate: &Fate) -> (&'static str, &'static str) {
    match fate {
        Fate::Known => ("known", "#cfe8cf"),
        Fate::Lost => ("lost", "#ffe4c0"),
        Fate::Runs(_) => ("runs", "#ffd9a0"),
        Fate::Follows(_) => ("may run", "#fff0cc"),
        Fate::Fails(_) => ("fails", "#f4b6b6"),
        Fate::Unwanted => ("not needed", "#e6e6e6"),
    }
}
