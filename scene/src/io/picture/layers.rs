//! OpenEXR and Radiance: the layer that is read, stated colours, and notes.

use engine::Notes;

use super::encoding::FileEncoding;
use crate::error::Error;
use crate::io::exr;
use crate::io::source_colour::SourceColour;

/// The conversion from chromaticities that a file states, if they differ from those of Rec.709.
pub(super) fn stated(
    xy: Option<[[f32; 2]; 4]>,
    encoding: FileEncoding,
    notes: &mut Notes,
) -> Option<SourceColour> {
    let xy = xy.filter(|xy| encoding == FileEncoding::Auto && exr::differ_from_srgb(Some(xy)))?;
    let colour = SourceColour::linear(xy);
    if colour.is_some() {
        notes.decision(
            "primaries-applied",
            "the file states chromaticities other than those of Rec.709; its colours were converted to Rec.709",
        );
    } else {
        notes.warning(
            "profile-ignored",
            "the chromaticities of the file do not define a colour space and are ignored; set `encoding`",
        );
    }
    colour
}

/// Warns about pixels that are not square. `aspect` is the width of a pixel divided by its height.
pub(super) fn report_pixels(aspect: f64, notes: &mut Notes) {
    if aspect.is_nan() || (aspect - 1.0).abs() >= 1e-3 {
        let text =
            format!("the pixels of the file are not square (width / height: {aspect}); this is ignored");
        notes.warning("pixel-aspect-ignored", text);
    }
}

/// Adds notes about parts of an EXR file that are ignored.
pub(super) fn report_choice(file: &exr::Opened<'_>, by_default: bool, notes: &mut Notes) {
    if file.parts() > 1 && by_default {
        notes.warning(
            "one-part-only",
            format!(
                "the file has {} parts, and the part `{}` is read; set `layer` to read another part: {}",
                file.parts(),
                file.part(),
                file.part_names().join(", ")
            ),
        );
    }
    report_pixels(f64::from(file.pixel_aspect()), notes);
    if file.cropped() {
        notes.decision(
            "data-window",
            "the data window differs from the display window; pixels outside the data window are 0",
        );
    }
}

/// Names of the channels of the chosen layer: colour with optional alpha, a vector, or a single channel.
pub(super) fn layer(name: &str, file: &exr::Opened<'_>) -> Result<Vec<String>, Error> {
    let (layer, names) = (file.layer.as_str(), file.names());
    let prefix = if layer.is_empty() { String::new() } else { format!("{layer}.") };
    let all = |letters: &[&str]| {
        let full: Vec<String> = letters.iter().map(|letter| format!("{prefix}{letter}")).collect();
        full.iter().all(|name| names.contains(name)).then_some(full)
    };
    // Its Y alone would be a grey picture.
    let chroma = all(&["RY", "BY"]).is_some();
    let single = || match layer {
        "" if chroma => None,
        "" => names.iter().find(|name| *name == "Y").map(|name| vec![name.clone()]),
        wanted => names.iter().find(|name| *name == wanted).map(|name| vec![name.clone()]),
    };
    let found = all(&["R", "G", "B", "A"])
        .or_else(|| all(&["R", "G", "B"]))
        .or_else(|| all(&["r", "g", "b", "a"]))
        .or_else(|| all(&["r", "g", "b"]))
        .or_else(|| all(&["X", "Y", "Z"]))
        .or_else(|| if chroma { None } else { all(&["Y", "A"]) })
        .or_else(|| if layer.is_empty() { None } else { all(&["Z"]) })
        .or_else(single);
    found.ok_or_else(|| no_layer(name, file, &names, chroma))
}

/// The error about a missing layer, which lists the layers of the file.
fn no_layer(name: &str, file: &exr::Opened<'_>, names: &[String], chroma: bool) -> Error {
    let what = match file.layer.as_str() {
        _ if chroma => {
            "the picture stores luminance and chroma (Y, RY, BY), which cannot be read as colour".to_owned()
        }
        "" => "the picture has neither channels R, G and B nor a channel Y".to_owned(),
        layer => format!("the picture has no layer `{layer}`"),
    };
    let layers: Vec<String> = file.layers().into_iter().take(20).map(|layer| format!("`{layer}`")).collect();
    let mut text = format!("{what}; `layer` may be one of {}", layers.join(", "));
    if file.parts() > 1 {
        text.push_str(&format!(", or a part: {}", file.part_names().join(", ")));
    }
    let of = if file.parts() > 1 {
        format!("the channels of the part `{}`", file.part())
    } else {
        "the channels of the file".to_owned()
    };
    Error::format(name, format!("{text}; {of} are {}", names.join(", ")))
}
