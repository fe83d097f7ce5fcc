//! `write-exr`: pictures and data for other programs, as OpenEXR.

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, FileBytes, Files, Kind, NodeError, Notes, OutputFile, ViewCount, Wired,
};
use scene::io::exr::{self, Channel, Depth};
use scene::io::progress::Progress;
use scene::math::color::space::{Conversion, Space};
use scene::types::{Encoding, Images, Linear, Picture};

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
    /// Give either `image`, whose channels become R, G, B (and A), or `layers`. A layer is named by `names`, or
    /// after the output that its wire comes from. A layer of colour is written as the channels `name.R`, `name.G`,
    /// `name.B` (and `name.A`), a layer of a single channel as `name`, and a layer named N as `N.X`, `N.Y`, `N.Z`.
    /// Colours keep their encoding unless `encoding` names a space; all colours are then written in that space. The
    /// attribute `lightharmony:encoding` records the encoding of each layer, and `chromaticities` the primaries.
    /// Other programs ignore the first attribute and treat all colours as linear, so mixed encodings are reported.
    /// The same input gives the same bytes.
    pub struct WriteExr {
        /// The file: `.exr`. Must contain `{view}` if there are several views.
        path: OutputFile, other("\"b.exr\""), inert("the path is not stored in the file");
        /// Names of the layers, in the order of the wires: B, R0, R1, S, O, M, Z, N, variance, or others. The
        /// default is the names of the outputs that the wires come from.
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
        /// One picture per view.
        image: Option<Arc<Images>>,
        /// Pictures to write to one file, each as a layer; they must have the same views and size.
        layers: Vec<Arc<Images>>,
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
    const VERSION: u32 = 3;
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
        for (index, view) in views.iter().enumerate() {
            let progress = Progress::of(cx, 0.0, 1.0).piece(index, views.len());
            progress.report(0.0)?;
            let (mut channels, mut encodings) = (Vec::new(), Vec::new());
            let (width, height, _) = view.picture.size();
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
                add_layer(name, picture, p, &mut channels, progress.part(0.0, 0.0))?;
                let name = if name.is_empty() { "image" } else { name };
                let encoding = match p.conversion(picture) {
                    Some(_) => p.encoding.name(),
                    None => picture.encoding(),
                };
                encodings.push(format!("{name}={encoding}"));
            }
            let encodings = encodings.join(" ");
            let primaries = p.encoding.space().primaries();
            let attributes = exr::Attributes { encoding: &encodings, recipe, primaries };
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
        Ok((Out { files: Arc::new(Files(files)) }, notes))
    }
}

/// Returns the name of each layer, which is given by `names` or is the name of the output that the layer comes
/// from. The layer of `image` has no name unless `names` gives one.
fn layer_names<'a>(
    p: &'a WriteExr,
    images: usize,
    layers: usize,
    outputs: &[&'a str],
) -> Result<Vec<&'a str>, NodeError> {
    let given = || p.names.iter().map(String::as_str).collect();
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
        _ => Err(NodeError::new("`image` and `layers` cannot both be wired").at("layers")),
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

fn add_layer(
    name: &str,
    picture: &Picture,
    p: &WriteExr,
    to: &mut Vec<(Channel, Depth)>,
    progress: Progress<'_>,
) -> Result<(), NodeError> {
    let (_, _, channels) = picture.size();
    let letters: &[&str] = match (channels, name) {
        (1, "") => &["Y"],
        (1, _) => &[""],
        (2, _) => &["Y", "A"],
        (3, "N") => &["X", "Y", "Z"],
        (3, _) => &["R", "G", "B"],
        (4, _) => &["R", "G", "B", "A"],
        _ => {
            return Err(NodeError::new(format!("layer `{name}` needs 1 to 4 channels, but has {channels}"))
                .at("layers"));
        }
    };
    let conversion = p.conversion(picture);
    let depth = if p.half && !matches!(picture, Picture::Data(_)) { Depth::Half } else { Depth::Float };
    for (offset, letter) in letters.iter().enumerate() {
        let full = match (name, *letter) {
            ("", letter) => letter.to_owned(),
            (name, "") => name.to_owned(),
            (name, letter) => format!("{name}.{letter}"),
        };
        let mut samples = Vec::with_capacity(picture.samples().len() / channels);
        progress.over(picture.samples(), |pixels| {
            if let Some(conversion) = conversion.as_ref().filter(|_| *letter != "A") {
                let pixels = pixels.chunks_exact(channels);
                samples.extend(pixels.map(|pixel| converted(pixel, conversion)[offset]));
            } else {
                samples.extend(pixels.iter().skip(offset).step_by(channels).copied());
            }
        })?;
        if samples.iter().any(|v| v.is_nan()) {
            return Err(NodeError::new(format!("channel `{full}` contains NaN")).at("layers"));
        }
        to.push((Channel { name: full, samples }, depth));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Scene, Up};
    use scene::math::color::linear_from_srgb;
    use scene::types::{Data, Image, NamedImage, Srgb};

    fn run(p: &WriteExr, inputs: In) -> Result<(Vec<FileBytes>, Notes), NodeError> {
        WriteExr::check(p)?;
        let cx =
            Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
        WriteExr::run(p, inputs, &cx).map(|(out, notes)| (out.files.0.clone(), notes))
    }
    fn node(names: &[&str]) -> WriteExr {
        let names = names.iter().map(|n| (*n).to_owned()).collect();
        let encoding = WrittenEncoding::Keep;
        WriteExr { path: OutputFile("a.exr".into()), names, half: false, encoding, recipe: true }
    }
    fn colour() -> Arc<Images> {
        let samples = (0..24).map(|i| i as f32 * 10_000.0).collect();
        Arc::new(Images::single("v", Image::<Linear>::from_samples(3, 2, 4, samples)))
    }
    fn depth() -> Arc<Images> {
        Arc::new(Images::single("v", Image::<Data>::from_samples(3, 2, 1, vec![f32::INFINITY; 6])))
    }

    #[test]
    fn layers_are_named_and_exact() {
        let layers = vec![colour(), depth(), Arc::new(Images::single("v", Image::<Srgb>::new(3, 2, 3)))];
        let (files, notes) =
            run(&node(&["O", "Z", "B"]), In { image: None, layers }).unwrap_or_else(|e| panic!("{e}"));
        let reported: Vec<&str> = notes.iter().map(|note| &*note.id).collect();
        assert_eq!(reported, ["mixed-encodings"]);
        let back = exr::read("a", &files[0].bytes).unwrap_or_else(|e| panic!("{e}"));
        let names: Vec<&str> = back.channels.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["B.B", "B.G", "B.R", "O.A", "O.B", "O.G", "O.R", "Z"]);
        assert_eq!(back.find("O.G").map(|c| c[5]), Some(210_000.0));
        assert_eq!(back.find("Z"), Some(&[f32::INFINITY; 6][..]));
        let text = b"O=linear Z=data B=srgb";
        assert!(files[0].bytes.windows(text.len()).any(|w| w == text));
    }

    // This test fails if alpha is decoded too, if premultiplied colours are decoded directly, if linear light is
    // decoded again, or if the attribute is not changed.
    #[test]
    fn linear_decodes_what_is_display_encoded_and_nothing_else() {
        let of = |channels, samples: &[f32]| {
            Arc::new(Images::single("v", Image::<Srgb>::from_samples(1, 2, channels, samples.to_vec())))
        };
        let layers = vec![
            of(4, &[0.2, 0.1, -0.05, 0.5, 0.3, 0.3, 0.3, 0.0]),
            of(3, &[0.5, 1.5, 0.0, 1.0, 0.25, 0.75]),
            of(2, &[0.1, 0.5, 1.0, 1.0]),
            Arc::new(Images::single("v", Image::<Linear>::from_samples(1, 2, 1, vec![0.5, 7.0]))),
            Arc::new(Images::single("v", Image::<Data>::from_samples(1, 2, 3, vec![0.25; 6]))),
        ];
        for half in [false, true] {
            let encoding = WrittenEncoding::Linear;
            let p = WriteExr { half, encoding, ..node(&["B", "C", "G", "R0", "S"]) };
            let (files, notes) =
                run(&p, In { image: None, layers: layers.clone() }).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(notes, Notes::none());
            let back = exr::read("a", &files[0].bytes).unwrap_or_else(|e| panic!("{e}"));
            let lin = linear_from_srgb;
            for (name, wanted) in [
                ("B.R", [lin(0.4) * 0.5, 0.0]),
                ("B.G", [lin(0.2) * 0.5, 0.0]),
                ("B.B", [lin(-0.1) * 0.5, 0.0]),
                ("B.A", [0.5, 0.0]),
                ("C.G", [lin(1.5), lin(0.25)]),
                ("G.Y", [lin(0.2) * 0.5, 1.0]),
                ("G.A", [0.5, 1.0]),
                ("R0", [0.5, 7.0]),
                ("S.B", [0.25; 2]),
            ] {
                let found = back.find(name).unwrap_or_else(|| panic!("{name}"));
                for (found, wanted) in found.iter().zip(wanted) {
                    let off = (found - wanted).abs();
                    assert!(
                        off <= if half { 1e-3 * wanted.abs() } else { 1e-7 },
                        "{name}: {found}, {wanted}"
                    );
                }
            }
            let text = b"B=linear C=linear G=linear R0=linear S=data";
            assert!(files[0].bytes.windows(text.len()).any(|w| w == text));
        }
    }

    // This test fails if data is treated as linear light, if layers are listed that are not display-encoded, or if
    // `Linear` causes a warning too.
    #[test]
    fn unlike_encodings_are_reported_by_layer_and_like_ones_are_not() {
        let encoded = || Arc::new(Images::single("v", Image::<Srgb>::new(3, 2, 3)));
        let reported = |encoding, names: &[&str], layers| {
            let p = WriteExr { encoding, ..node(names) };
            let (_, notes) = run(&p, In { image: None, layers }).unwrap_or_else(|e| panic!("{e}"));
            notes.iter().map(|note| note.text.clone()).collect::<Vec<_>>()
        };
        let all = ["B", "R0", "R1", "Z"];
        let layers = || vec![encoded(), colour(), colour(), depth()];
        assert_eq!(
            reported(WrittenEncoding::Keep, &all, layers()),
            [
                "display-encoded layers (`B`) are mixed with linear layers (`R0`, `R1`), and other programs treat all \
              layers as linear; `encoding: Linear` decodes them"
            ]
        );
        assert!(reported(WrittenEncoding::Linear, &all, layers()).is_empty());
        assert!(reported(WrittenEncoding::Keep, &["B", "Z"], vec![encoded(), depth()]).is_empty());
        assert!(reported(WrittenEncoding::Keep, &["R", "Z"], vec![colour(), depth()]).is_empty());
    }

    #[test]
    fn half_counts_what_overflows_and_spares_data() {
        let p = WriteExr { half: true, ..node(&["O", "Z"]) };
        let (files, notes) =
            run(&p, In { image: None, layers: vec![colour(), depth()] }).unwrap_or_else(|e| panic!("{e}"));
        assert!(notes.iter().any(|n| n.id == "half-overflow" && n.text.starts_with("17 ")));
        let back = exr::read("a", &files[0].bytes).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(back.find("O.A").map(|c| c[5]), Some(65_504.0));
        assert_eq!(back.find("Z").map(|c| c[0]), Some(f32::INFINITY));
    }

    #[test]
    fn what_does_not_fit_together_is_refused() {
        let other = Arc::new(Images::single("v", Image::<Data>::new(2, 2, 1)));
        let nan = Arc::new(Images::single("v", Image::<Data>::from_samples(1, 1, 1, vec![f32::NAN])));
        let pair = |a: &str, b: &str| {
            let named =
                |n: &str| NamedImage { name: n.to_owned(), picture: Image::<Data>::new(3, 2, 1).into() };
            Arc::new(Images(vec![named(a), named(b)]))
        };
        let rigs = In { image: None, layers: vec![pair("x", "y"), pair("x", "z")] };
        let Err(reported) = run(&node(&["a", "b"]), rigs) else { panic!("layers of different rigs") };
        assert_eq!(reported.message(), "layer `b` has no view `y`; its views are x, z");
        assert_eq!(reported.advice(), Some("all layers of a file must come from one rig"));
        for (p, inputs) in [
            (node(&[]), In { image: None, layers: vec![] }),
            (node(&["a"]), In { image: None, layers: vec![colour(), depth()] }),
            (node(&["a"]), In { image: Some(depth()), layers: vec![depth()] }),
            (node(&["a", "b"]), In { image: None, layers: vec![colour(), other] }),
            (node(&["a", "b"]), In { image: None, layers: vec![pair("x", "y"), pair("x", "z")] }),
            (node(&["a", "a"]), In { image: None, layers: vec![colour(), depth()] }),
            (node(&[]), In { image: Some(nan), layers: vec![] }),
        ] {
            assert!(run(&p, inputs).is_err());
        }
        assert!(run(&node(&["a", "b"]), In { image: None, layers: vec![pair("x", "y"), depth()] }).is_ok());
    }
}
