//! Escaping of text for HTML and SVG.

/// Escapes text for use in HTML and SVG, both between tags and in attribute values.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
