//! `write-lut`: a view transform as a lookup table for other programs.

use std::sync::Arc;

use engine::{Context, FileBytes, Files, Kind, NodeError, Notes, OutputFile};
use scene::io::cube::CubeLut;
use scene::io::quantise::DisplaySpace;
use scene::math::color::space::{Conversion, Space};
use scene::math::color::view::{Display, View};

engine::params! {
    /// Writes a view transform as a lookup table (`.cube`), so that other programs show pictures as `write-image`
    /// does.
    ///
    /// The inputs of the table are colours encoded in `from`, its outputs codes of `space`. A logarithmic `from`
    /// such as `AcesCct` covers all light that matters; a linear one covers light up to 1 only.
    pub struct WriteLut {
        /// The file: `.cube`.
        path: OutputFile, other("\"b.cube\""), inert("the path is not stored in the file");
        /// View transform.
        view: View = View::AgX, other("Filmic");
        /// Exposure before the view transform; 1 doubles the light.
        exposure: f64 = 0.0, range(-64, 64), unit("stops"), other("1.0");
        /// Colour space of the inputs.
        from: Space = Space::AcesCct, other("LogC4");
        /// Colour space of the outputs.
        space: DisplaySpace = DisplaySpace::Srgb, other("DisplayP3");
        /// Number of entries along each edge of the table.
        size: u32 = 33, range(2, 129), other("17");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`WriteLut`].
    pub struct Out {
        /// List of one file.
        files: Arc<Files>,
    }
}

impl Kind for WriteLut {
    const NAME: &'static str = "write-lut";
    const VERSION: u32 = 2;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.path.extension() != "cube" {
            let what = format!("cannot write a lookup table as `.{}`", p.path.extension());
            return Err(NodeError::new(what).at("path").hint("end the path in `.cube`"));
        }
        if p.path.0.contains("{view}") {
            return Err(NodeError::new("`{view}` is not allowed here: a lookup table is a single file")
                .at("path")
                .hint("remove `{view}` from `path`"));
        }
        Ok(())
    }

    fn run(p: &Self, _inputs: In, _cx: &Context) -> Result<(Out, Notes), NodeError> {
        let light = Conversion::new(p.from, Space::LinearRec709);
        let display = Display::new(p.view, p.exposure, p.space.space());
        let title = format!("{:?} from {:?} to {:?}", p.view, p.from, p.space);
        let text = CubeLut::write(&title, p.size as usize, |code| display.apply(light.apply(code)));
        let file = FileBytes { view: String::new(), bytes: text.into_bytes() };
        Ok((Out { files: Arc::new(Files(vec![file])) }, Notes::none()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::context;

    fn node() -> WriteLut {
        WriteLut {
            path: OutputFile("a.cube".into()),
            view: View::AgX,
            exposure: 0.5,
            from: Space::AcesCct,
            space: DisplaySpace::Srgb,
            size: 33,
        }
    }

    /// The table gives nearly the codes of the view transform itself: within 0.007 for greys, where it is
    /// interpolated along its diagonal, and exactly at its entries.
    #[test]
    fn the_table_is_the_view_transform() {
        let (out, _) = WriteLut::run(&node(), In {}, &context()).unwrap_or_else(|e| panic!("{e}"));
        let lut = CubeLut::read("a.cube", &out.files.0[0].bytes).unwrap_or_else(|e| panic!("{e}"));
        let light = Conversion::new(Space::AcesCct, Space::LinearRec709);
        let display = Display::new(View::AgX, 0.5, Space::Srgb);
        let direct = |code: [f32; 3]| display.apply(light.apply(code));
        for i in 0..=320 {
            let grey = [i as f32 / 320.0; 3];
            let (a, b) = (lut.apply(grey), direct(grey));
            assert!((a[0] - b[0]).abs() < 7e-3, "{grey:?}: {a:?}, {b:?}");
        }
        let entry = [8.0 / 32.0, 16.0 / 32.0, 12.0 / 32.0];
        assert!(lut.apply(entry).iter().zip(direct(entry)).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn other_extensions_and_views_are_refused() {
        for path in ["a.png", "a", "{view}.cube"] {
            assert!(WriteLut::check(&WriteLut { path: OutputFile(path.into()), ..node() }).is_err());
        }
        assert!(WriteLut::check(&node()).is_ok());
    }
}
