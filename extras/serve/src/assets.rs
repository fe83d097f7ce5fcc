//! The files of the page. They contain nothing private.

/// Path, type and content of each file.
const FILES: [(&str, &str, &str); 31] = [
    ("/", "text/html; charset=utf-8", include_str!("../assets/page.html")),
    ("/assets/page.css", "text/css; charset=utf-8", include_str!("../assets/page.css")),
    ("/assets/page.js", SCRIPT, include_str!("../assets/page.js")),
    ("/assets/dom.js", SCRIPT, include_str!("../assets/dom.js")),
    ("/assets/server.js", SCRIPT, include_str!("../assets/server.js")),
    ("/assets/graph.js", SCRIPT, include_str!("../assets/graph.js")),
    ("/assets/fields.js", SCRIPT, include_str!("../assets/fields.js")),
    ("/assets/picture.js", SCRIPT, include_str!("../assets/picture.js")),
    ("/assets/shader.js", SCRIPT, include_str!("../assets/shader.js")),
    ("/assets/edits.js", SCRIPT, include_str!("../assets/edits.js")),
    ("/assets/node.js", SCRIPT, include_str!("../assets/node.js")),
    ("/assets/outputs.js", SCRIPT, include_str!("../assets/outputs.js")),
    ("/assets/keys.js", SCRIPT, include_str!("../assets/keys.js")),
    ("/assets/measures.js", SCRIPT, include_str!("../assets/measures.js")),
    ("/assets/emitters.js", SCRIPT, include_str!("../assets/emitters.js")),
    ("/assets/trade.js", SCRIPT, include_str!("../assets/trade.js")),
    ("/assets/track.js", SCRIPT, include_str!("../assets/track.js")),
    ("/assets/timeline.js", SCRIPT, include_str!("../assets/timeline.js")),
    ("/assets/text.js", SCRIPT, include_str!("../assets/text.js")),
    ("/assets/place.js", SCRIPT, include_str!("../assets/place.js")),
    ("/assets/stage.js", SCRIPT, include_str!("../assets/stage.js")),
    ("/assets/gaze.js", SCRIPT, include_str!("../assets/gaze.js")),
    ("/assets/ground.js", SCRIPT, include_str!("../assets/ground.js")),
    ("/assets/things.js", SCRIPT, include_str!("../assets/things.js")),
    ("/assets/measure.js", SCRIPT, include_str!("../assets/measure.js")),
    ("/assets/pointer.js", SCRIPT, include_str!("../assets/pointer.js")),
    ("/assets/adder.js", SCRIPT, include_str!("../assets/adder.js")),
    ("/assets/starter.js", SCRIPT, include_str!("../assets/starter.js")),
    ("/assets/space.js", SCRIPT, include_str!("../assets/space.js")),
    ("/assets/solid.js", SCRIPT, include_str!("../assets/solid.js")),
    ("/assets/gizmo.js", SCRIPT, include_str!("../assets/gizmo.js")),
];

const SCRIPT: &str = "text/javascript; charset=utf-8";

/// Type and content of the file at a path.
pub fn file(path: &str) -> Option<(&'static str, &'static str)> {
    FILES.iter().find(|(known, ..)| *known == path).map(|(_, kind, content)| (*kind, *content))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names of the scripts that are loaded when they are used.
    const LATER: [&str; 14] = [
        "place", "stage", "gaze", "ground", "things", "pointer", "starter", "space", "solid", "gizmo",
        "trade", "emitters", "measure", "adder",
    ];

    #[test]
    fn the_page_is_small_and_needs_no_network() {
        // The code of the place view, of the trade pane, and of the marks on panoramas is loaded when they are used.
        let is_later = |path: &str| LATER.iter().any(|name| path == format!("/assets/{name}.js"));
        let bytes = |later: bool| -> usize {
            FILES.iter().filter(|(path, ..)| is_later(path) == later).map(|(.., content)| content.len()).sum()
        };
        assert!(bytes(false) < 110_000, "{} bytes", bytes(false));
        assert!(bytes(true) < 110_000, "{} bytes", bytes(true));
        for (path, _, content) in FILES {
            let urls = content
                .match_indices("://")
                .map(|(at, _)| &content[at.saturating_sub(5)..at + 3 + 14.min(content.len() - at - 3)]);
            for url in urls {
                // The namespace of SVG is a name and is not fetched.
                assert!(url.contains("://www.w3.org"), "{path} names {url}");
            }
            for unsafe_way in [
                "innerHTML",
                "outerHTML",
                "insertAdjacentHTML",
                "document.write",
                "eval(",
                "new Function",
                "style=\"",
                "onclick=",
            ] {
                assert!(!content.contains(unsafe_way), "{path} contains {unsafe_way}");
            }
        }
    }
}
