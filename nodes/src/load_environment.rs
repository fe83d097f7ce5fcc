//! `load-environment`: light from a panorama file.

use std::sync::Arc;

use engine::{Context, ContextField, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot};

use glam::DVec3;

use crate::Error;
use crate::io::{exr, hdr};
use crate::types::{Environment, Image, Images};

engine::params! {
    /// Loads an equirectangular panorama of linear light: OpenEXR or Radiance HDR.
    ///
    /// Row 0 of the file is up and its centre column looks forward (up +z: +Y; up +y: -Z; up -y: +Z);
    /// `rotation_deg` turns it from there.
    pub struct LoadEnvironment {
        /// The file: `.exr` or `.hdr`.
        path: InputFile, other("\"b.hdr\"");
        /// Turns the light about the up axis, counter-clockwise seen from above. Fractions of a pixel are
        /// interpolated, so that energy is kept row by row.
        rotation_deg: f64 = 0.0, range(-36000, 36000), unit("degrees"), other("90.0");
        /// Multiplies the radiance.
        scale: f64 = 1.0, range(0, 1e9), other("2.0");
        /// The point that the light was captured at. `path-trace` measures from it which surfaces lie behind
        /// the light and let it pass; none: it takes the first camera's place and says so.
        origin: Option<[f64; 3]> = None, other("(0.5, 0.0, 1.0)"), unit("world units");
    }
}
engine::inputs! {
    /// None.
    pub struct In {}
}
engine::outputs! {
    /// The light.
    pub struct Out {
        /// Linear radiance from every direction.
        env: Arc<Environment>,
        /// The same as a picture, for sinks and comparisons.
        image: Arc<Images>,
    }
}

impl Kind for LoadEnvironment {
    const NAME: &'static str = "load-environment";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up];
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(vec![root.file(&p.path)])
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let name = &p.path.0;
        let bytes = cx.read(&p.path).map_err(|e| e.at("path"))?;
        let mut notes = Notes::none();
        let (width, height, mut rgb) =
            decode(name, &bytes, &mut notes).map_err(|e| NodeError::from(e).at("path"))?;
        cx.check()?;
        cx.progress(0.5);
        if width != 2 * height {
            notes.warning(
                "not-two-to-one",
                format!("the picture is {width}x{height}; a whole panorama is twice as wide as high"),
            );
        }
        replace_impossible(&mut rgb, p.scale, &mut notes);
        let turned = turn(&rgb, width, p.rotation_deg, cx)?;
        let image = Image::from_samples(width, height, 3, turned);
        let picture = Arc::new(Images::single("env", image.clone()));
        let env = Arc::new(Environment { image, up: cx.up(), origin: p.origin.map(DVec3::from_array) });
        Ok((Out { env, image: picture }, notes))
    }
}

pub(crate) fn decode(name: &str, bytes: &[u8], notes: &mut Notes) -> Result<(usize, usize, Vec<f32>), Error> {
    if bytes.starts_with(b"#?") {
        let picture = hdr::read(name, bytes)?;
        return Ok((picture.width, picture.height, picture.rgb));
    }
    if !bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return Err(Error::format(
            name,
            "neither an OpenEXR nor a Radiance picture, which hold linear light",
        ));
    }
    let planes = exr::read(name, bytes)?;
    tell(&planes, notes);
    let rgb = rgb_planes(name, &planes)?;
    let samples = (0..planes.width * planes.height).flat_map(|i| rgb.map(|plane| plane[i])).collect();
    Ok((planes.width, planes.height, samples))
}

/// The colour planes `R`, `G`, `B`, or a grey `Y` for all three.
pub(crate) fn rgb_planes<'a>(name: &str, planes: &'a exr::Planes) -> Result<[&'a [f32]; 3], Error> {
    if let Some(grey) = planes.find("Y") {
        return Ok([grey; 3]);
    }
    match ["R", "G", "B"].map(|channel| planes.find(channel)) {
        [Some(r), Some(g), Some(b)] => Ok([r, g, b]),
        _ => {
            let names: Vec<&str> = planes.channels.iter().map(|c| c.name.as_str()).collect();
            Err(Error::format(name, format!("has no channels R, G, B but {}", names.join(", "))))
        }
    }
}

/// Notes on what of an EXR file was passed over.
pub(crate) fn tell(planes: &exr::Planes, notes: &mut Notes) {
    if planes.parts > 1 {
        notes.warning(
            "first-part-only",
            format!("the file has {} parts; only the first flat one is read", planes.parts),
        );
    }
    if planes.cropped {
        notes.decision("data-window", "the data window is not its display window; the rest is 0");
    }
}

/// Not a number and below 0 become 0, infinities the largest half, where they most likely come from.
fn replace_impossible(rgb: &mut [f32], scale: f64, notes: &mut Notes) {
    let (mut lost, mut capped, mut negative) = (0, 0, 0);
    for value in rgb {
        let mut v = f64::from(*value);
        if v.is_nan() {
            lost += 1;
            v = 0.0;
        } else if v < 0.0 {
            negative += 1;
            v = 0.0;
        } else if v.is_infinite() {
            capped += 1;
            v = 65_504.0;
        }
        *value = (v * scale).min(f64::from(f32::MAX)) as f32;
    }
    for (id, count, what) in [
        ("radiance-not-a-number", lost, "samples are not numbers and were set to 0"),
        ("radiance-negative", negative, "samples lie below 0 and were set to 0"),
        ("radiance-infinite", capped, "samples are infinite and were set to 65504, the largest half"),
    ] {
        if count > 0 {
            notes.count(id, count, what);
        }
    }
}

/// Moves every row to the left by the turn: light of forward goes to the left of forward.
pub(crate) fn turn(rgb: &[f32], width: usize, degrees: f64, cx: &Context) -> Result<Vec<f32>, NodeError> {
    let shift = (degrees / 360.0).rem_euclid(1.0) * width as f64;
    let (whole, part) = (shift.floor() as usize % width, (shift - shift.floor()) as f32);
    if whole == 0 && part == 0.0 {
        return Ok(rgb.to_vec());
    }
    let rows = cx.for_each_tile(rgb.len() / (width * 3), |y| {
        let row = &rgb[y * width * 3..(y + 1) * width * 3];
        let mut out = Vec::with_capacity(row.len());
        for x in 0..width {
            let (a, b) = ((x + whole) % width * 3, (x + whole + 1) % width * 3);
            for c in 0..3 {
                let (near, far) = (row[a + c], row[b + c]);
                out.push(if part == 0.0 { near } else { near * (1.0 - part) + far * part });
            }
        }
        out
    })?;
    Ok(rows.concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::equirect;
    use crate::pose::yaw;
    use engine::{Scene, Up};

    fn detached(up: Up) -> Context {
        Context::detached(Scene { up, metres_per_unit: 1.0, seed: 0 }, ".")
    }

    // A light in front, turned by yaw, must lie where the yaw of a pose would put it.
    #[test]
    fn turns_as_a_pose_does() {
        let (width, height) = (72, 36);
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            let mut rgb = vec![0.0; width * height * 3];
            rgb[(18 * width + 36) * 3] = 1.0;
            let turned = turn(&rgb, width, 25.0, &detached(up)).unwrap_or_else(|e| panic!("{e}"));
            let at = turned.iter().position(|v| *v > 0.9).unwrap_or_default() / 3;
            let seen = |x: usize| equirect::direction(up, (x as f64 + 0.5) / 72.0, (18.5) / 36.0);
            let expected: DVec3 = yaw(equirect::axes(up), 25.0) * seen(36);
            assert!((seen(at % width) - expected).length() < 1e-9, "{up:?}");
        }
    }

    #[test]
    fn any_turn_keeps_the_energy_of_rows() {
        let rgb: Vec<f32> = (0..32 * 2 * 3).map(|i| (i * 37 % 11) as f32).collect();
        for degrees in [0.0, 1.7, 360.0, -723.4] {
            let turned = turn(&rgb, 32, degrees, &detached(Up::PlusZ)).unwrap_or_else(|e| panic!("{e}"));
            for row in 0..2 {
                let sum = |v: &[f32]| v[row * 96..(row + 1) * 96].iter().sum::<f32>();
                assert!((sum(&turned) - sum(&rgb)).abs() < 1e-3);
            }
        }
        assert_eq!(turn(&rgb, 32, 720.0, &detached(Up::PlusZ)).unwrap_or_default(), rgb);
    }

    #[test]
    fn impossible_light_is_replaced_and_counted() {
        let mut notes = Notes::none();
        let mut rgb = [f32::NAN, -1.0, f32::INFINITY, 2.0, 3e38, 0.0];
        replace_impossible(&mut rgb, 2.0, &mut notes);
        assert_eq!(rgb, [0.0, 0.0, 131_008.0, 4.0, f32::MAX, 0.0]);
        assert_eq!(notes.iter().count(), 3);
    }
}
