//! INRIA PLY: binary little-endian, one row per splat, before activation.
//!
//! Fields (gaussian-splatting, `scene/gaussian_model.py`, `save_ply`): `x y z`, `f_dc_0..2`, `f_rest_*` channel by
//! channel, `opacity` (logit), `scale_0..2` (log), `rot_0..3` (w x y z). `filter_3D`, which Mip-Splatting and MILo
//! add, is the standard deviation of a smoothing filter that the stored scales and opacities do not include yet.
//! Other fields are ignored.

use engine::{NodeError, Notes};

use super::fixed_rows::{Element, Field, FixedRows};
use super::rows::{Row, RowFault};
use super::{Loaded, Reading};
use crate::error::Error;
use crate::io::ply::Scalar;

/// Positions of the fields of a row.
struct Layout {
    sh_degree: u32,
    mean: [Field; 3],
    dc: [Field; 3],
    /// All of them, in the order of the file: channel by channel.
    rest: Vec<Field>,
    /// Start of these fields, if they are consecutive floats.
    rest_run: Option<usize>,
    opacity: Field,
    scale: [Field; 3],
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
                let hint = if name == "scale_2" {
                    "; 2D splats have none and are not supported"
                } else {
                    "; is this a mesh or a point cloud?"
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
                let what = format!("{other} fields `f_rest_*`; degree 0 to 4 have 0, 9, 24, 45 or 72");
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
        let names = vertex.fields.iter().map(|(name, _)| name);
        Ok(Self {
            sh_degree,
            unused: names.filter(|name| !known(name)).cloned().collect(),
            mean: [need("x")?, need("y")?, need("z")?],
            dc: [need("f_dc_0")?, need("f_dc_1")?, need("f_dc_2")?],
            rest,
            rest_run: in_line.then_some(first),
            opacity: need("opacity")?,
            scale: [need("scale_0")?, need("scale_1")?, need("scale_2")?],
            rotation: [need("rot_0")?, need("rot_1")?, need("rot_2")?, need("rot_3")?],
            filter: find("filter_3D"),
        })
    }

    /// Activates one row, appending its spherical harmonics to `sh`.
    fn row(&self, row: &[u8], max_extent: f64, sh: &mut Vec<[f32; 3]>) -> Result<Row, RowFault> {
        let made = Row::activate(
            self.mean.map(|f| f.get(row)),
            self.rotation.map(|f| f.get(row)),
            self.scale.map(|f| f.get(row)),
            self.opacity.get(row),
            self.filter.map(|f| f.get(row)),
            max_extent,
        )?;
        sh.push(self.dc.map(|f| f.get(row) as f32));
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

/// Loads a file whose header was read.
pub(super) fn load(
    file: &str,
    bytes: &[u8],
    header: &FixedRows,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let vertex = header.find("vertex");
    let faces = header.find("face").map_or(0, |face| face.count);
    if faces > 0 && vertex.is_none_or(|vertex| vertex.find("f_dc_0").is_none()) {
        let what = format!("`{file}` is a mesh of {faces} faces; it holds no splats");
        return Err(NodeError::new(what).hint("`LoadMesh` reads meshes"));
    }
    header.check_binary(file)?;
    let vertex = vertex.ok_or_else(|| Error::format(file, "the PLY file has no element `vertex`"))?;
    let layout = Layout::of(file, vertex)?;
    let rows = vertex.rows(file, bytes)?;
    if layout.filter.is_some() {
        notes.decision("filter-3d", format!("`filter_3D` of `{file}` is applied to scales and opacities"));
    }
    if !layout.unused.is_empty() {
        let text = format!("`{file}`: {} fields are ignored: {}", layout.unused.len(), some(&layout.unused));
        notes.decision("fields-passed-over", text);
    }
    let turn = reading.turn(file, None, false, notes);
    let stride = vertex.stride;
    let parts = reading.rows(vertex.count, turn.as_ref(), |index, sh| {
        let row = rows.get(index * stride..(index + 1) * stride).unwrap_or_default();
        layout.row(row, reading.max_extent, sh)
    })?;
    Ok(Loaded::new(parts, vertex.count, layout.sh_degree))
}

/// The first few names of a list.
fn some(names: &[String]) -> String {
    let mut text = names.iter().take(4).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > 4 {
        text.push_str(", ..");
    }
    text
}
