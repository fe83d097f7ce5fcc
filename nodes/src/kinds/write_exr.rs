//! `write-exr`: pictures and data for other programs, as OpenEXR.

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, FileBytes, Files, Kind, NodeError, Notes, OutputFile, ViewCount, Wired,
};
use scene::io::exr::{self, CameraMatrices, Channel, Depth};
use scene::io::progress::Progress;
use scene::math::color::space::{Conversion, Space};
use scene::types::{Encoding, Images, Linear, Mattes, Picture, Rig};

mod mattes;
mod plate;

use mattes::{add_mattes, more_attributes};
use plate::{Plate, ROUNDING, STORED};

engine::choices! {
    /// Encoding of the written colours.
    pub enum WrittenEncoding {
        /// Keeps the encoding of each picture, so a splat render stays display-encoded.
        Keep,
        /// Linear light with the primaries of Rec.709, which other programs expect in OpenEXR files.
        Linear,
        /// Linear light with the primaries of P3 and the white of D65.
        LinearP3,
        /// Linear light with the primaries of Rec.2020.
        LinearRec2020,
        /// ACEScg: linear light with the primaries AP1.
        AcesCg,
        /// ACES2065-1: linear light with the primaries AP0.
        Aces2065,
    }
}
engine::params! {
    /// Writes pictures as OpenEXR: a single picture, or several as named layers.
    ///
    /// `image` becomes the channels R, G, B (and A), the default layer that viewers show. Each of `layers` is named by
    /// `names`, or after the output that its wire comes from. A layer of colour is written as the channels `name.R`,
    /// `name.G`, `name.B` (and `name.A`), a layer of a single channel as `name`, a layer named `depth` as `depth.Z`, and
    /// a layer named `normal` or `N` as `normal.X`, `normal.Y`, `normal.Z`. If `rig` is wired, the header has the
    /// attributes `worldToCamera` and `worldToNDC`.
    ///
    /// Colours keep their encoding unless `encoding` names a space; all colours are then written in that space. The
    /// attribute `lightharmony:encoding` records the encoding of each layer, and `chromaticities` the primaries.
    /// Other programs ignore the first attribute and treat all colours as linear, so mixed encodings are reported.
    /// The same input gives the same bytes.
    ///
    /// `mattes` are written as Cryptomatte; they are not colours, so `encoding` and `half` do not change them.
    ///
    /// A plate in another colour space would return from the working space with rounding errors of 1e-7. If `plate` and
    /// `stored` are wired, pixels of colour that equal those of the plate are written with the numbers of its file.
    pub struct WriteExr {
        /// The file: `.exr`. Must contain `{view}` if there are several views.
        path: OutputFile, other("\"b.exr\""), inert("the path is not stored in the file");
        /// Names of `layers`, in the order of the wires, such as `background`, `object`, `shadow`, `depth`, `normal`. The
        /// default is the names of the outputs that the wires come from. Without `layers`, the name of `image`.
        names: Vec<String> = Vec::new(), other("[\"B\"]");
        /// True to write colours as 16-bit floats, which take half the space and have about three significant
        /// digits. Samples that overflow are clamped and counted. Data (depth, masks, variance) stays in 32 bits.
        half: bool = false, other("true");
        /// Encoding of the written colours. All but `Keep` un-premultiply display-encoded colours, decode them and
        /// premultiply them again; alpha and data are unchanged. Display-encoded colours are taken as light
        /// relative to the white of the display; no view transform is undone.
        encoding: WrittenEncoding = WrittenEncoding::Keep, other("Linear");
        /// True to write the graph that made the picture into its metadata. The inputs of the graph are identified
        /// by content, not by path.
        recipe: bool = true, other("false"), inert("outside a run there is no recipe");
    }
}
engine::inputs! {
    /// Pictures to write.
    pub struct In {
        /// One picture per view, for the default layer.
        image: Option<Arc<Images>>,
        /// Pictures to write to one file, each as a layer; they must have the same views and size.
        layers: Vec<Arc<Images>>,
        /// Cameras of the views, for the header.
        rig: Option<Arc<Rig>>,
        /// The plate as it was loaded, in linear light.
        plate: Option<Arc<Images>>,
        /// The numbers of the file of the plate, which must be in the space of `encoding`: a `load-image` of the same
        /// file with `encoding: Data`.
        stored: Option<Arc<Images>>,
        /// Mattes of objects, each with a name of its own, written as Cryptomatte: their layers, in 32-bit floats, and
        /// their attributes.
        mattes: Vec<Arc<Mattes>>,
    }
}
engine::outputs! {
    /// Outputs of [`WriteExr`].
    pub struct Out {
        /// One file per view.
        files: Arc<Files>,
    }
}

impl Kind for WriteExr {
    const NAME: &'static str = "write-exr";
    const VERSION: u32 = 4;
    const READS: &'static [ContextField] = &[ContextField::Recipe, ContextField::Wired];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.path.extension() != "exr" {
            return Err(
                NodeError::new(format!("cannot write OpenEXR as `.{}`", p.path.extension())).at("path")
            );
        }
        for (index, name) in p.names.iter().enumerate() {
            let word =
                !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '-'));
            if !word || p.names[..index].contains(name) {
                return Err(NodeError::new(format!(
                    "the layer name `{name}` is empty, has characters that are not allowed, or is used twice"
                ))
                .at("names")
                .hint("use only letters, digits, `-` and `_`, and use each name only once"));
            }
        }
        Ok(())
    }

    fn check_wires(p: &Self, wired: &Wired) -> Result<(), NodeError> {
        let layers = wired.of("layers");
        if wired.of("plate").len() != wired.of("stored").len() {
            return Err(NodeError::new("`plate` and `stored` are used only together").at("stored").hint(
                "wire the plate to `plate`, and a `LoadImage` of the same file with `encoding: Data` to `stored`",
            ));
        }
        layer_names(p, wired.of("image").len(), layers.len(), layers).map(drop)
    }

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["image", "layers"])
    }

    fn estimate(p: &Self, inputs: &In) -> Cost {
        let layers = || inputs.image.iter().chain(&inputs.layers);
        let bytes = |picture: &Picture| {
            let half = p.half && !matches!(picture, Picture::Data(_));
            (4 * picture.samples().len() as u64, picture.samples().len() as u64 * if half { 2 } else { 4 })
        };
        let pictures = || layers().flat_map(|images| &images.0).map(|image| bytes(&image.picture));
        let views = layers().map(|images| images.0.len()).max().unwrap_or(1).max(1) as u64;
        // The planes of one file, the packed bytes of all files (at most as long as the planes), and a copy of
        // these while they are stored.
        let planes = pictures().map(|(floats, _)| floats).sum::<u64>() / views;
        let packed: u64 = pictures().map(|(_, packed)| packed).sum();
        Cost { bytes: planes.max(packed).saturating_add(packed) }
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let wired: Vec<&Images> = inputs.image.iter().chain(&inputs.layers).map(Arc::as_ref).collect();
        let outputs = cx.wired("layers");
        let names = layer_names(p, usize::from(inputs.image.is_some()), inputs.layers.len(), outputs)?;
        let layers: Vec<(&str, &Images)> = names.into_iter().zip(wired).collect();
        let mut notes = Notes::none();
        let mut files = Vec::new();
        let mut kept = 0;
        if p.encoding == WrittenEncoding::Keep {
            report_encodings(&layers, &mut notes);
        }
        // The first of the layers with the most views.
        let views: &[_] = layers
            .iter()
            .rev()
            .map(|(_, images)| images.0.as_slice())
            .max_by_key(|v| v.len())
            .unwrap_or_default();
        if views.is_empty() {
            return Err(NodeError::new("there is no view to write").at("image"));
        }
        let recipe = cx.recipe().filter(|_| p.recipe);
        let more = more_attributes(&inputs.mattes)?;
        for (index, view) in views.iter().enumerate() {
            let progress = Progress::of(cx, 0.0, 1.0).piece(index, views.len());
            progress.report(0.0)?;
            let (mut channels, mut encodings) = (Vec::new(), Vec::new());
            let (width, height, _) = view.picture.size();
            let plate = match (&inputs.plate, &inputs.stored) {
                (Some(plate), Some(stored)) => Some(Plate::of(&view.name, [plate, stored], (width, height))?),
                _ => None,
            };
            for (name, images) in &layers {
                let other = |what: String| {
                    NodeError::new(what).at("layers").hint("all layers of a file must come from one rig")
                };
                let picture = images.view(&view.name).ok_or_else(|| {
                    let there: Vec<&str> = images.0.iter().map(|image| image.name.as_str()).collect();
                    let there = there.join(", ");
                    other(format!("layer `{name}` has no view `{}`; its views are {there}", view.name))
                })?;
                let (w, h, _) = picture.size();
                if (w, h) != (width, height) {
                    return Err(other(format!(
                        "layer `{name}` is {w}x{h} pixels, but another layer is {width}x{height}"
                    )));
                }
                kept += add_layer(name, picture, plate.as_ref(), p, &mut channels, progress.part(0.0, 0.0))?;
                let name = if name.is_empty() { "image" } else { name };
                let encoding = match p.conversion(picture) {
                    Some(_) => p.encoding.name(),
                    None => picture.encoding(),
                };
                encodings.push(format!("{name}={encoding}"));
            }
            add_mattes(&inputs.mattes, (&view.name, width, height), &mut channels)?;
            let encodings = encodings.join(" ");
            let primaries = p.encoding.space().primaries();
            if let Some(twice) = repeated(&channels) {
                return Err(NodeError::new(format!("two layers have the channel `{twice}`"))
                    .at("names")
                    .hint("the default layer has the channels R, G, B and A, or Y; give the other layers other names"));
            }
            let camera = match &inputs.rig {
                Some(rig) => Some(camera_of(rig, &view.name, (width, height))?),
                None => None,
            };
            let attributes = exr::Attributes { encoding: &encodings, recipe, primaries, camera, more: &more };
            let (bytes, clamped) = exr::write_for(width, height, channels, attributes, progress)?;
            if clamped > 0 {
                let what = format!(
                    "of the samples of `{}` exceeded 65504, the largest 16-bit float, and had to be clamped to it",
                    view.name
                );
                notes.count("half-overflow", clamped, what);
            }
            files.push(FileBytes { view: view.name.clone(), bytes });
        }
        if inputs.plate.is_some() {
            notes.decision("plate-kept", format!("pixels written with the numbers of the plate: {kept}"));
        }
        Ok((Out { files: Arc::new(Files(files)) }, notes))
    }
}

/// The first name that two channels have.
fn repeated(channels: &[(Channel, Depth)]) -> Option<&str> {
    let mut names: Vec<&str> = channels.iter().map(|(channel, _)| channel.name.as_str()).collect();
    names.sort_unstable();
    names.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0])
}

/// Matrices of the camera of a view. A rig of one camera belongs to every view.
fn camera_of(rig: &Rig, view: &str, size: (usize, usize)) -> Result<CameraMatrices, NodeError> {
    let named = rig.cameras.iter().find(|camera| camera.name == view);
    let only = || rig.cameras.first().filter(|_| rig.cameras.len() == 1);
    let Some(camera) = named.or_else(only) else {
        let there: Vec<&str> = rig.cameras.iter().map(|camera| camera.name.as_str()).collect();
        let what = format!("`rig` has no camera `{view}`; its cameras are {}", there.join(", "));
        return Err(NodeError::new(what).at("rig").hint("wire the rig that the pictures were rendered with"));
    };
    if (camera.width_px as usize, camera.height_px as usize) != size {
        let what = format!(
            "the camera `{}` has {}x{} pixels, but the pictures have {}x{}",
            camera.name, camera.width_px, camera.height_px, size.0, size.1
        );
        return Err(NodeError::new(what).at("rig").hint("wire the rig that the pictures were rendered with"));
    }
    Ok(CameraMatrices::of(camera))
}

/// Returns the name of each layer, which is given by `names` or is the name of the output that the layer comes
/// from. The layer of `image` has no name unless it is the only layer and `names` gives one.
fn layer_names<'a>(
    p: &'a WriteExr,
    images: usize,
    layers: usize,
    outputs: &[&'a str],
) -> Result<Vec<&'a str>, NodeError> {
    let given = || p.names.iter().map(String::as_str).collect();
    if images == 1 && layers > 0 {
        let mut all = vec![""];
        all.extend(layer_names(p, 0, layers, outputs)?);
        return Ok(all);
    }
    match (images, layers, p.names.len()) {
        (0, 0, _) => {
            Err(NodeError::new("there is no picture to write").at("image").hint("wire `image` or `layers`"))
        }
        (1, 0, 0) => Ok(vec![""]),
        (1, 0, 1) => Ok(given()),
        (_, 0, _) => Err(NodeError::new("`image` is a single layer, but `names` lists several names")
            .at("names")
            .hint("give one name, or wire several layers to `layers`")),
        (0, layers, names) if layers == names => Ok(given()),
        (0, layers, 0) if layers == outputs.len() => {
            match outputs.iter().enumerate().find(|(i, name)| outputs[..*i].contains(name)) {
                Some((_, twice)) => {
                    Err(NodeError::new(format!("two layers come from outputs with the name `{twice}`"))
                        .at("layers")
                        .hint("distinguish them with `names`"))
                }
                None => Ok(outputs.to_vec()),
            }
        }
        (0, layers, names) => Err(NodeError::new(format!(
            "`names` must list one name per layer (names: {names}, layers: {layers})"
        ))
        .at("names")
        .hint("name every layer, in the order of the wires")),
        _ => Err(NodeError::new("`image` is one wire").at("image")),
    }
}

impl WrittenEncoding {
    /// The space of the written colours. With `Keep`, display-encoded colours have the same primaries.
    fn space(self) -> Space {
        match self {
            WrittenEncoding::Keep | WrittenEncoding::Linear => Space::LinearRec709,
            WrittenEncoding::LinearP3 => Space::LinearP3,
            WrittenEncoding::LinearRec2020 => Space::LinearRec2020,
            WrittenEncoding::AcesCg => Space::AcesCg,
            WrittenEncoding::Aces2065 => Space::Aces2065,
        }
    }

    /// Name of the encoding in the file.
    fn name(self) -> &'static str {
        match self {
            WrittenEncoding::Keep | WrittenEncoding::Linear => Linear::NAME,
            WrittenEncoding::LinearP3 => "linear-p3",
            WrittenEncoding::LinearRec2020 => "linear-rec2020",
            WrittenEncoding::AcesCg => "acescg",
            WrittenEncoding::Aces2065 => "aces2065-1",
        }
    }
}

impl WriteExr {
    /// The conversion of the colours of a picture before they are written; `None` if they stay as they are.
    fn conversion(&self, picture: &Picture) -> Option<Conversion> {
        let from = match picture {
            Picture::Srgb(_) => Space::Srgb,
            Picture::Linear(_) => Space::LinearRec709,
            Picture::Data(_) => return None,
        };
        (self.encoding != WrittenEncoding::Keep)
            .then(|| Conversion::new(from, self.encoding.space()))
            .filter(|conversion| !conversion.is_identity())
    }
}

/// Converts a pixel and returns its premultiplied RGB. Grey is the same in all sets of primaries, so only the transfer
/// curve changes it.
fn converted(pixel: &[f32], conversion: &Conversion) -> [f32; 3] {
    let (colours, alpha) = match *pixel {
        [y] => ([y; 3], 1.0),
        [y, a] => ([y; 3], a),
        [r, g, b] => ([r, g, b], 1.0),
        [r, g, b, a, ..] => ([r, g, b], a),
        [] => ([0.0; 3], 0.0),
    };
    if alpha > 0.0 { conversion.apply(colours.map(|v| v / alpha)).map(|v| v * alpha) } else { [0.0; 3] }
}

/// Warns about display-encoded layers next to linear ones.
fn report_encodings(layers: &[(&str, &Images)], notes: &mut Notes) {
    let of = |is: fn(&Picture) -> bool| {
        let found = layers.iter().filter(|(_, images)| images.0.iter().any(|image| is(&image.picture)));
        found.map(|(name, _)| format!("`{name}`")).collect::<Vec<_>>().join(", ")
    };
    let encoded = of(|picture| matches!(picture, Picture::Srgb(_)));
    let linear = of(|picture| matches!(picture, Picture::Linear(_)));
    if !encoded.is_empty() && !linear.is_empty() {
        let text = format!("display-encoded layers ({encoded}) are mixed with linear layers ({linear})");
        notes.warning(
            "mixed-encodings",
            format!("{text}, and other programs treat all layers as linear; `encoding: Linear` decodes them"),
        );
    }
}

/// Adds the channels of a layer. Returns the number of pixels that have the numbers of the plate.
fn add_layer(
    name: &str,
    picture: &Picture,
    plate: Option<&Plate<'_>>,
    p: &WriteExr,
    to: &mut Vec<(Channel, Depth)>,
    progress: Progress<'_>,
) -> Result<u64, NodeError> {
    let (_, _, channels) = picture.size();
    let letters: &[&str] = match (channels, name) {
        (1, "") => &["Y"],
        (1, "depth") => &["Z"],
        (1, _) => &[""],
        (2, _) => &["Y", "A"],
        (3, "N" | "normal") => &["X", "Y", "Z"],
        (3, _) => &["R", "G", "B"],
        (4, _) => &["R", "G", "B", "A"],
        _ => {
            return Err(NodeError::new(format!("layer `{name}` needs 1 to 4 channels, but has {channels}"))
                .at("layers"));
        }
    };
    let conversion = p.conversion(picture);
    let plate = plate.filter(|_| matches!(picture, Picture::Linear(_)));
    let mut kept = 0;
    let depth = if p.half && !matches!(picture, Picture::Data(_)) { Depth::Half } else { Depth::Float };
    for (offset, letter) in letters.iter().enumerate() {
        let full = match (name, *letter) {
            ("", letter) => letter.to_owned(),
            (name, "") => name.to_owned(),
            (name, letter) => format!("{name}.{letter}"),
        };
        let mut samples: Vec<f32> = Vec::with_capacity(picture.samples().len() / channels);
        let mut unlike = None;
        progress.over(picture.samples(), |pixels| {
            let letter_of_colour = *letter != "A" && channels >= 3;
            if let Some(plate) = plate.filter(|_| letter_of_colour) {
                for pixel in pixels.chunks_exact(channels) {
                    let at = samples.len();
                    let own = match &conversion {
                        Some(conversion) => converted(pixel, conversion),
                        None => [pixel[0], pixel[1], pixel[2]],
                    };
                    let Some(stored) = plate.colours(at, pixel) else {
                        samples.push(own[offset]);
                        continue;
                    };
                    let size = stored.iter().fold(0.0_f32, |size, v| size.max(v.abs()));
                    if (stored[offset] - own[offset]).abs() > ROUNDING * size {
                        unlike.get_or_insert((at, own, stored));
                    }
                    samples.push(stored[offset]);
                    kept += u64::from(offset == 0);
                }
            } else if let Some(conversion) = conversion.as_ref().filter(|_| *letter != "A") {
                let pixels = pixels.chunks_exact(channels);
                samples.extend(pixels.map(|pixel| converted(pixel, conversion)[offset]));
            } else {
                samples.extend(pixels.iter().skip(offset).step_by(channels).copied());
            }
        })?;
        if let Some((at, own, stored)) = unlike {
            let (x, y) = (at % picture.size().0, at / picture.size().0);
            let what = format!(
                "the plate is {own:?} in the space of `encoding` at pixel ({x}, {y}), but `stored` is {stored:?}"
            );
            return Err(NodeError::new(what).at("stored").hint(STORED));
        }
        if samples.iter().any(|v| v.is_nan()) {
            return Err(NodeError::new(format!("channel `{full}` contains NaN")).at("layers"));
        }
        to.push((Channel { name: full, samples }, depth));
    }
    Ok(kept)
}

#[cfg(test)]
mod tests;
