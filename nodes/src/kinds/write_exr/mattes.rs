//! Cryptomatte in the written file.

use std::sync::Arc;

use engine::NodeError;
use scene::io::exr::{Channel, Depth, cryptomatte};
use scene::types::Mattes;

/// Attributes of all mattes, as pairs of name and text.
pub(super) fn more_attributes(mattes: &[Arc<Mattes>]) -> Result<Vec<(String, String)>, NodeError> {
    let mut names: Vec<&str> = mattes.iter().map(|one| one.layer.as_str()).collect();
    names.sort_unstable();
    if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        let what = format!("two mattes have the name `{}`", twice[0]);
        return Err(NodeError::new(what)
            .at("mattes")
            .hint("set `layer` of one `ObjectMattes` to another name"));
    }
    Ok(mattes.iter().flat_map(|one| cryptomatte::attributes(one)).collect())
}

/// Adds the channels of the mattes of a view, which has the given name, width and height.
pub(super) fn add_mattes(
    mattes: &[Arc<Mattes>],
    (name, width, height): (&str, usize, usize),
    to: &mut Vec<(Channel, Depth)>,
) -> Result<(), NodeError> {
    for one in mattes {
        let wrong = |what: String| {
            NodeError::new(what).at("mattes").hint("all layers of a file must come from one rig")
        };
        let Some(view) = one.view(name) else {
            let there: Vec<&str> = one.views.iter().map(|view| view.name.as_str()).collect();
            let there = there.join(", ");
            return Err(wrong(format!("`{}` has no view `{name}`; its views are {there}", one.layer)));
        };
        if (view.width, view.height) != (width, height) {
            let size = format!("{}x{}", view.width, view.height);
            return Err(wrong(format!("`{}` is {size} pixels, but the view is {width}x{height}", one.layer)));
        }
        // Identifiers are bits of 32-bit floats.
        to.extend(cryptomatte::channels(one, view).into_iter().map(|channel| (channel, Depth::Float)));
    }
    Ok(())
}
