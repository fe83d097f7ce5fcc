//! `load-environment`: light from a panorama file.

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, FileHead, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot,
};
use glam::DVec3;
use render::light::whole_sphere::{self, turn_in_place};
use scene::io::picture::{floats_of, head_of};
use scene::types::{Environment, Image, Images, Light};

pub use scene::io::picture::FileEncoding;

engine::params! {
    /// Loads an equirectangular panorama of linear light: OpenEXR or Radiance HDR.
    ///
    /// Row 0 of the file is up, and its centre column looks forward: along +Y if `up` of the scene is +z, along -Z
    /// if it is +y, and along +Z if it is -y. `rotation_deg` rotates the light from this orientation.
    pub struct LoadEnvironment {
        /// The file: `.exr` or `.hdr`.
        path: InputFile, other("\"b.hdr\"");
        /// Encoding of the numbers in the file. Spaces of scenes are converted to linear Rec.709; those of displays are
        /// refused.
        encoding: FileEncoding = FileEncoding::Auto, other("AcesCg");
        /// Layer of an OpenEXR file, such as `ViewLayer.Combined`, or a channel. The default is the unnamed layer.
        layer: String = String::new(), other("\"R\"");
        /// Rotates the light about the up axis, counter-clockwise seen from above. Rotations by a fraction of a
        /// pixel interpolate between pixels and preserve the energy of each row.
        rotation_deg: f64 = 0.0, range(-36000, 36000), unit("degrees"), other("90.0");
        /// Factor applied to the radiance.
        scale: f64 = 1.0, range(0, 1e9), other("2.0");
        /// Point where the light was captured. `path-trace` uses it to find the surfaces that lie beyond a light
        /// source; these surfaces let the light of the source pass. Without `origin`, `path-trace` uses the
        /// position of the first camera and adds a note.
        origin: Option<[f64; 3]> = None, other("(0.5, 0.0, 1.0)"), unit("world units");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// The light.
    pub struct Out {
        /// Linear radiance from every direction.
        env: Arc<Environment>,
        /// The same light as a picture, for sinks and comparisons.
        image: Arc<Images>,
    }
}

impl Kind for LoadEnvironment {
    const NAME: &'static str = "load-environment";
    const VERSION: u32 = 10;
    const READS: &'static [ContextField] = &[ContextField::Up];
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(vec![root.file(&p.path)])
    }

    fn estimate_files(_: &Self, files: &[FileHead<'_>]) -> Cost {
        // The file and the picture, whose memory the light takes over. Only grey pictures need a larger copy.
        let of = |file: &FileHead<'_>| {
            let [reading, floats] = floats_of(file);
            let wider = head_of(file).filter(|head| head.channels < 3);
            reading.max(wider.map_or(0, |head| floats.saturating_add(head.pixels().saturating_mul(12))))
        };
        Cost { bytes: files.iter().map(of).max().unwrap_or(0) }
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let picture = whole_sphere::open(&p.path, p.encoding, &p.layer, &mut notes, cx)?;
        let (width, height, _) = picture.size();
        let mut rgb = whole_sphere::linear(&p.path.0, picture).map_err(|e| NodeError::from(e).at("path"))?;
        scale(&mut rgb, p.scale, &mut notes);
        turn_in_place(rgb.as_chunks_mut::<3>().0, width, p.rotation_deg, cx)?;
        let image = Light::from(Image::from_samples(width, height, 3, rgb));
        let picture = image.pictures();
        let env = Arc::new(Environment { image, up: cx.up(), origin: p.origin.map(DVec3::from_array) });
        Ok((Out { env, image: picture }, notes))
    }
}

/// Multiplies the values by `by`. Values below 0 become 0, and values that overflow become the largest float.
fn scale(rgb: &mut [f32], by: f64, notes: &mut Notes) {
    let (mut negative, mut capped) = (0, 0);
    for value in rgb {
        let scaled = f64::from(*value) * by;
        negative += u64::from(scaled < 0.0);
        capped += u64::from(scaled > f64::from(f32::MAX));
        *value = scaled.clamp(0.0, f64::from(f32::MAX)) as f32;
    }
    for (id, count, what) in [
        ("radiance-negative", negative, "of the samples had a value below 0, which was replaced with 0"),
        (
            "radiance-capped",
            capped,
            "of the samples overflowed when scaled, and had to be clamped to the largest 32-bit float",
        ),
    ] {
        notes.count(id, count, what);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // NaN and infinite samples are replaced earlier: see `io/picture.rs`.
    #[test]
    fn impossible_light_is_replaced_and_counted() {
        let mut notes = Notes::none();
        let mut rgb = [-1.0, 2.0, 3e38, 0.0];
        scale(&mut rgb, 2.0, &mut notes);
        assert_eq!(rgb, [0.0, 4.0, f32::MAX, 0.0]);
        assert_eq!(
            notes.iter().map(|note| note.id.as_str()).collect::<Vec<_>>(),
            ["radiance-negative", "radiance-capped"]
        );
    }
}
