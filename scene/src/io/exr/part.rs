//! Selection of a part of an OpenEXR file.

use exr::meta::header::Header;

/// Name of the part that a header describes; empty if it has no name.
pub(super) fn part_name(header: &Header) -> String {
    header.own_attributes.layer_name.as_ref().map_or_else(String::new, ToString::to_string)
}

/// The layer of the colours of a part: an empty name for colour channels or a grey channel without a layer (not the
/// Y of a vector), and the name of the part if the names of its channels begin with it, as some programs write
/// them. `None` if the part has neither.
fn colours(header: &Header) -> Option<String> {
    let holds = |layer: &str| {
        let prefix = if layer.is_empty() { String::new() } else { format!("{layer}.") };
        let has = |letter: &str| {
            let name = format!("{prefix}{letter}");
            header.channels.list.iter().any(|channel| channel.name.eq(name.as_str()))
        };
        let all = |letters: [&str; 3]| letters.into_iter().all(has);
        all(["R", "G", "B"]) || all(["r", "g", "b"]) || layer.is_empty() && has("Y") && !has("X")
    };
    let name = part_name(header);
    [String::new(), name].into_iter().find(|layer| holds(layer))
}

/// The part of a file that contains a layer, and the name of the layer within the part. An empty name selects the
/// first flat part with colours, whose channels may carry the name of the part, or, if no part has colours, the
/// first flat part. Any other name is the name of a layer in any part, the name of a part, or both, separated by a
/// dot or a slash.
pub fn choose_part<'a>(headers: &'a [Header], layer: &str) -> Option<(&'a Header, String)> {
    let flat = || headers.iter().filter(|header| !header.deep);
    let first = flat().next()?;
    if layer.is_empty() {
        let coloured = flat().find_map(|header| colours(header).map(|layer| (header, layer)));
        return Some(coloured.unwrap_or((first, String::new())));
    }
    let holds = |header: &&Header, name: &str| {
        let channels = header.channels.list.iter().map(|channel| channel.name.to_string());
        channels.into_iter().any(|channel| {
            channel == name || channel.strip_prefix(name).is_some_and(|rest| rest.starts_with('.'))
        })
    };
    if let Some(header) = flat().find(|header| holds(header, layer)) {
        return Some((header, layer.to_owned()));
    }
    for header in flat() {
        let name = part_name(header);
        let Some(rest) = layer.strip_prefix(&*name).filter(|_| !name.is_empty()) else { continue };
        if let [only] = &*header.channels.list
            && rest.is_empty()
        {
            return Some((header, only.name.to_string()));
        }
        if rest.is_empty() {
            return Some((header, colours(header).unwrap_or_default()));
        }
        if let Some(rest) = rest.strip_prefix(['.', '/'])
            && holds(&header, rest)
        {
            return Some((header, rest.to_owned()));
        }
    }
    Some((first, layer.to_owned()))
}
