//! `load-image`: pictures from files.

use std::sync::Arc;

use engine::{Context, Cost, FileHead, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot};
use scene::io::picture::{decode_turned, floats_of};
use scene::io::progress::Progress;
use scene::types::view::check_name;
use scene::types::{Images, NamedImage};

pub use scene::io::picture::{FileEncoding, Orientation};

engine::params! {
    /// Loads pictures: PNG, JPEG, TIFF, OpenEXR or Radiance HDR.
    ///
    /// Integer codes become numbers from 0 to 1. Colours in spaces other than sRGB and linear Rec.709 are converted:
    /// those of displays to sRGB, those of scenes to linear Rec.709. `encoding` declares the space if the file does not
    /// state it or states a wrong one, and replaces what the file states; with `Data`, numbers are kept as they are. Straight alpha (PNG, TIFF) is premultiplied.
    pub struct LoadImage {
        /// Path of the file.
        path: InputFile, other("\"b.png\"");
        /// Further files, one per view, for example for the other cameras of a rig.
        more: Vec<InputFile> = Vec::new(), other("[\"photo.png\"]");
        /// Encoding of the numbers in the files.
        encoding: FileEncoding = FileEncoding::Auto, other("Data");
        /// Orientation of photographs. Cameras of COLMAP belong to photographs as they are stored.
        orientation: Orientation = Orientation::Upright, other("Stored"), inert("the picture is stored upright");
        /// Layer of an OpenEXR file: `R0` reads the channels `R0.R`, `R0.G` and `R0.B`, and `Z` reads the channel
        /// `Z`. The default is the unnamed layer.
        layer: String = String::new(), other("\"Z\""), inert("only OpenEXR has layers");
        /// Names of the views, one per file. The default is the file name without folder and extension.
        names: Vec<String> = Vec::new(), other("[\"left\"]");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`LoadImage`].
    pub struct Out {
        /// The pictures, one view per file.
        image: Arc<Images>,
    }
}

impl Kind for LoadImage {
    const NAME: &'static str = "load-image";
    const VERSION: u32 = 10;
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(p.files().map(|file| root.file(file)).collect())
    }

    fn estimate_files(_: &Self, files: &[FileHead<'_>]) -> Cost {
        // Files are read one after the other, while the earlier ones are held.
        let (mut held, mut most) = (0_u64, 0_u64);
        for file in files {
            let [reading, floats] = floats_of(file);
            most = most.max(held.saturating_add(reading));
            held = held.saturating_add(floats);
        }
        Cost { bytes: most }
    }

    fn check(p: &Self) -> Result<(), NodeError> {
        let files = 1 + p.more.len();
        if !p.names.is_empty() && p.names.len() != files {
            let what =
                format!("`names` must list one name per file (names: {}, files: {files})", p.names.len());
            return Err(NodeError::new(what).at("names"));
        }
        p.names.iter().try_for_each(|name| check_name(name).map_err(|e| e.at("names")))
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let mut views: Vec<NamedImage> = Vec::with_capacity(1 + p.more.len());
        for (index, file) in p.files().enumerate() {
            let progress = Progress::of(cx, 0.0, 1.0).piece(index, 1 + p.more.len());
            progress.report(0.0)?;
            let field = if index == 0 { "path" } else { "more" };
            let bytes = cx.read(file).map_err(|e| e.at(field))?;
            let picture =
                decode_turned(p.encoding, p.orientation, &p.layer, &file.0, &bytes, &mut notes, progress)
                    .map_err(|e| NodeError::from(e).at(field))?;
            let stem = file.0.rsplit(['/', '\\']).next().unwrap_or_default();
            let stem = stem.rsplit_once('.').map_or(stem, |(stem, _)| stem);
            let name = p.names.get(index).map_or(stem, String::as_str).to_owned();
            if views.iter().any(|view| view.name == name) {
                let error = NodeError::new(format!("two views have the name `{name}`"));
                return Err(error.at("more").hint("distinguish them with `names`"));
            }
            views.push(NamedImage { name, picture });
        }
        Ok((Out { image: Arc::new(Images(views)) }, notes))
    }
}

impl LoadImage {
    fn files(&self) -> impl Iterator<Item = &InputFile> {
        std::iter::once(&self.path).chain(&self.more)
    }
}
