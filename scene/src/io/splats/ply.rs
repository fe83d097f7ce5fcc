//! INRIA PLY: one row per splat, before activation, in ASCII or binary.
//!
//! Fields (gaussian-splatting, `scene/gaussian_model.py`, `save_ply`): `x y z`, `f_dc_0..2`, `f_rest_*` channel by
//! channel, `opacity` (logit), `scale_0..2` (log), `rot_0..3` (w x y z). 2DGS writes only two scales, and the third
//! scale is then 0; isotropic trainings may write one for all three. Some programs write `red`, `green`, `blue` for `f_dc_*` (nerfstudio's `ply_color_mode: rgb`).
//! `filter_3D`, which Mip-Splatting and MILo add, is the standard deviation of a smoothing filter that the stored
//! scales and opacities do not include yet. Other fields are ignored.

use engine::{NodeError, Notes};

use super::fixed_rows::{Element, Field, FixedRows};
use super::frame::Frame;
use super::loaded::Loaded;
use super::reading::Reading;
use super::rows::{Row, RowFault, SH_C0};
use super::training::{self, vertical_axis};
use crate::error::Error;
use crate::io::colour_range::Range;
use crate::io::ply::{self, Scalar};

/// The constant colour of a row.
enum Colour {
    /// Coefficients of the constant spherical harmonic.
    Coefficients([Field; 3]),
    /// Display colours, and the factor that maps white to 1.
    Display([Field; 3], f64),
}

impl Colour {
    /// The coefficients of a row.
    fn get(&self, row: &[u8]) -> [f32; 3] {
        match self {
            Self::Coefficients(fields) => fields.map(|f| f.get(row) as f32),
            Self::Display(fields, white) => fields.map(|f| ((f.get(row) * white - 0.5) / SH_C0) as f32),
        }
    }
}

/// Positions of the fields of a row.
struct Layout {
    sh_degree: u32,
    mean: [Field; 3],
    colour: Colour,
    /// Fields of the coefficients of degree 1 and above, in the order of the file: channel by channel.
    rest: Vec<Field>,
    /// Start of the fields `rest` in the row, if they are consecutive 32-bit floats.
    rest_run: Option<usize>,
    opacity: Field,
    /// Fields of the scales. Files of 2DGS have only two, since their splats have no thickness; the field is the same for
    /// all three in files with one scale per splat.
    scale: [Option<Field>; 3],
    rotation: [Field; 4],
    filter: Option<Field>,
    /// Names of fields that are not used, in order.
    unused: Vec<String>,
}

impl Layout {
    fn of(file: &str, vertex: &Element) -> Result<Self, Error> {
        let find =
            |name: &str| vertex.find(name).filter(|field| matches!(field.scalar, Scalar::F32 | Scalar::F64));
        let need = |name: &str| {
            find(name).ok_or_else(|| {
                let hint = match vertex.find(name) {
                    Some(field) => {
                        format!(" that holds floats, but one of the type `{}`", field.scalar.name())
                    }
                    None => "; is this a mesh or a point cloud?".to_owned(),
                };
                Error::format(file, format!("the splats have no field `{name}`{hint}"))
            })
        };
        let rest_count = vertex.fields.iter().filter(|(name, _)| name.starts_with("f_rest_")).count();
        let sh_degree = match rest_count {
            0 => 0,
            9 => 1,
            24 => 2,
            45 => 3,
            72 => 4,
            other => {
                let what = format!(
                    "the number of fields `f_rest_*` is {other}; harmonics of degree 0, 1, 2, 3 or 4 need 0, 9, 24, 45 or 72 of them"
                );
                return Err(Error::format(file, what));
            }
        };
        let rest = (0..rest_count).map(|i| need(&format!("f_rest_{i}"))).collect::<Result<Vec<_>, _>>()?;
        let first = rest.first().map_or(0, |field: &Field| field.at);
        let in_line = rest.iter().enumerate().all(|(i, f)| f.scalar == Scalar::F32 && f.at == first + i * 4);
        let known = |name: &str| {
            ["x", "y", "z", "nx", "ny", "nz", "opacity", "filter_3D"].contains(&name)
                || ["f_dc_", "f_rest_", "scale_", "rot_"].iter().any(|prefix| name.starts_with(prefix))
        };
        let display = ["red", "green", "blue"].map(|name| vertex.find(name));
        let colour = match display {
            [Some(r), Some(g), Some(b)] if find("f_dc_0").is_none() => Colour::Display([r, g, b], 1.0),
            _ => Colour::Coefficients([need("f_dc_0")?, need("f_dc_1")?, need("f_dc_2")?]),
        };
        let shown = matches!(colour, Colour::Display(..));
        let known = |name: &str| known(name) || shown && ["red", "green", "blue"].contains(&name);
        let names = vertex.fields.iter().map(|(name, _)| name);
        Ok(Self {
            sh_degree,
            unused: names.filter(|name| !known(name)).cloned().collect(),
            mean: [need("x")?, need("y")?, need("z")?],
            colour,
            rest,
            rest_run: in_line.then_some(first),
            opacity: need("opacity")?,
            scale: match vertex.find("scale_2") {
                None if vertex.find("scale_1").is_none() => [Some(need("scale_0")?); 3],
                None => [Some(need("scale_0")?), Some(need("scale_1")?), None],
                Some(_) => [Some(need("scale_0")?), Some(need("scale_1")?), Some(need("scale_2")?)],
            },
            rotation: [need("rot_0")?, need("rot_1")?, need("rot_2")?, need("rot_3")?],
            filter: find("filter_3D"),
        })
    }

    /// Activates one row, appending its spherical harmonics to `sh`.
    fn row(&self, row: &[u8], max_extent: f64, sh: &mut Vec<[f32; 3]>) -> Result<Row, RowFault> {
        let made = Row::activate(
            self.mean.map(|f| f.get(row)),
            self.rotation.map(|f| f.get(row)),
            self.scale.map(|f| f.map_or(f64::NEG_INFINITY, |f| f.get(row))),
            self.opacity.get(row),
            self.filter.map(|f| f.get(row)),
            max_extent,
        )?;
        sh.push(self.colour.get(row));
        let each = self.rest.len() / 3;
        if let Some(start) = self.rest_run {
            // The usual case: consecutive floats.
            let run = row.get(start..start + each * 12).unwrap_or_default();
            let (floats, _) = run.as_chunks::<4>();
            let (red, others) = floats.split_at(each.min(floats.len()));
            let (green, blue) = others.split_at(each.min(others.len()));
            let triples = red.iter().zip(green).zip(blue);
            sh.extend(triples.map(|((r, g), b)| [r, g, b].map(|bytes| f32::from_le_bytes(*bytes))));
            return Ok(made);
        }
        let (red, others) = self.rest.split_at(each);
        let (green, blue) = others.split_at(each);
        let triples = red.iter().zip(green).zip(blue);
        sh.extend(triples.map(|((r, g), b)| [r, g, b].map(|field| field.get(row) as f32)));
        Ok(made)
    }
}

/// Loads a file, given its header.
pub(super) fn load(
    file: &str,
    bytes: &[u8],
    header: &FixedRows,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let vertex = header.find("vertex");
    let vertex = vertex.ok_or_else(|| Error::format(file, "the PLY file has no element `vertex`"))?;
    let mut layout = Layout::of(file, vertex)?;
    let rows = vertex.rows(file, bytes)?;
    if let Colour::Display(fields, white) = &mut layout.colour {
        let range = Range::of(fields[0].scalar, || {
            rows.chunks_exact(vertex.stride.max(1)).flat_map(|row| fields.map(|f| f.get(row)))
        });
        *white = 1.0 / range.white;
        let text = format!("`{file}` has display colours {}, which replace `f_dc_*`", range.words());
        if range.guessed {
            notes.warning("display-colours", text);
        } else {
            notes.decision("display-colours", text);
        }
    }
    if layout.scale[0] == layout.scale[1] {
        let text = format!("`{file}` has one scale per splat, so its splats are spheres");
        notes.decision("one-scale", text);
    }
    if layout.scale[2].is_none() {
        let text = format!("`{file}` has two scales per splat, as 2DGS writes them, so its splats are flat");
        notes.decision("two-scales", text);
    }
    if layout.filter.is_some() {
        notes.decision("filter-3d", format!("`filter_3D` of `{file}` is applied to scales and opacities"));
    }
    if !layout.unused.is_empty() {
        let text = format!(
            "fields of `{file}` that are ignored ({}): {}",
            layout.unused.len(),
            some(&layout.unused)
        );
        notes.decision("fields-passed-over", text);
    }
    if reading.placing.frame == Frame::ByFormat
        && let Some(stated) = vertical_axis(&header.comments).filter(|axis| *axis != reading.placing.up)
    {
        let (stated, up) = (stated.name(), reading.placing.up.name());
        let text = format!(
            "a comment of `{file}` says that {stated} is up, but `up` of the graph's scene is {up}; set `up: \"{stated}\"` \
             in the graph's scene, or set `frame` or `matrix` of this node and rotate the cameras likewise"
        );
        notes.warning("up-differs", text);
    }
    let turn = reading.turn(file, None, false, notes);
    let stride = vertex.stride;
    let parts = reading.rows(vertex.count, turn.as_ref(), |index, sh| {
        let row = rows.get(index * stride..(index + 1) * stride).unwrap_or_default();
        layout.row(row, reading.max_extent, sh)
    })?;
    let mut loaded = Loaded::new(parts, vertex.count, layout.sh_degree);
    loaded.antialiased = training::antialiased(&header.comments, file, notes);
    Ok(loaded)
}

/// Returns an error if the file is a mesh according to its header.
pub(super) fn refuse_mesh(file: &str, header: &ply::Header) -> Result<(), NodeError> {
    let find = |name: &str| header.elements.iter().find(|element| element.name == name);
    let faces = find("face").map_or(0, |face| face.rows);
    let splats =
        |e: &ply::Element| ["f_dc_0", "opacity", "packed_position"].iter().any(|f| e.find(f).is_some());
    if faces == 0 || find("vertex").is_some_and(splats) {
        return Ok(());
    }
    let what = format!("`{file}` is a mesh (faces: {faces}) and contains no splats");
    Err(NodeError::new(what).hint("`LoadMesh` reads meshes"))
}

/// The first few names of a list, as text.
fn some(names: &[String]) -> String {
    let mut text = names.iter().take(4).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > 4 {
        text.push_str(", ..");
    }
    text
}
