//! Splats as INRIA writes them: binary little-endian PLY, one row a splat, not yet activated.
//!
//! Fields (gaussian-splatting, `scene/gaussian_model.py`, `save_ply`): `x y z`, `f_dc_0..2`, `f_rest_*`
//! channel by channel, `opacity` (logit), `scale_0..2` (log), `rot_0..3` (w x y z). `filter_3D`, which
//! Mip-Splatting and MILo add, is the standard deviation of a smoothing filter that the stored scales
//! and opacities do not hold yet. Other fields are passed over.

use super::rows::{Row, RowFault};
use crate::Error;

/// Where the fields of a row lie, in bytes from its start.
#[derive(Debug)]
pub struct Layout {
    /// Bytes before the first row.
    pub header: usize,
    /// Rows.
    pub count: usize,
    /// Bytes of a row.
    pub stride: usize,
    /// Degree of the spherical harmonics, 0 to 4.
    pub sh_degree: u32,
    /// Names of fields that are not used, in order.
    pub unused: Vec<String>,
    mean: [Field; 3],
    dc: [Field; 3],
    /// All of them, in the order of the file: channel by channel.
    rest: Vec<Field>,
    opacity: Field,
    scale: [Field; 3],
    rotation: [Field; 4],
    filter: Option<Field>,
}

#[derive(Debug, Clone, Copy)]
struct Field {
    at: usize,
    double: bool,
}

impl Field {
    fn get(self, row: &[u8]) -> f64 {
        // `Layout::read` made sure that every field lies inside the stride; a short slice reads as 0.
        fn bytes<const N: usize>(row: &[u8], at: usize) -> [u8; N] {
            row.get(at..at + N).and_then(|b| b.try_into().ok()).unwrap_or([0; N])
        }
        if self.double {
            f64::from_le_bytes(bytes(row, self.at))
        } else {
            f64::from(f32::from_le_bytes(bytes(row, self.at)))
        }
    }
}

/// Bytes of a header beyond which a file is refused: 128 KiB hold thousands of fields.
const LONGEST_HEADER: usize = 128 * 1024;

impl Layout {
    /// Reads the header and checks that the rows it promises are there.
    pub fn read(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        let wrong = |what: String| Error::format(file, what);
        let mut at = 0;
        let mut next_line = || -> Result<&str, Error> {
            let rest = &bytes[at.min(bytes.len())..bytes.len().min(LONGEST_HEADER)];
            let end = rest.iter().position(|b| *b == b'\n');
            let end = end.ok_or_else(|| wrong("the PLY header has no `end_header`".to_owned()))?;
            at += end + 1;
            let line = std::str::from_utf8(&rest[..end]);
            Ok(line.map_err(|_| wrong("the PLY header is not text".to_owned()))?.trim_end_matches('\r'))
        };
        if next_line()?.trim() != "ply" {
            return Err(wrong("not a PLY file".to_owned()));
        }
        let mut count = None;
        let mut fields: Vec<(String, Field)> = Vec::new();
        let mut stride = 0_usize;
        // Bytes of elements before the splats; only whole rows of fixed size can be passed over.
        let (mut before, mut rows_before, mut element_stride) = (0_usize, 0_usize, 0_usize);
        let mut in_vertex = false;
        loop {
            let line = next_line()?.to_owned();
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words[..] {
                ["end_header"] => break,
                ["format", "binary_little_endian", _] => {}
                ["format", other, ..] => {
                    let feature = format!("PLY format `{other}`; write it as binary_little_endian");
                    return Err(Error::unsupported(file, feature));
                }
                ["element", name, n] => {
                    let n: u64 = n.parse().map_err(|_| wrong(format!("`{line}` has no number of rows")))?;
                    let n =
                        usize::try_from(n).map_err(|_| wrong(format!("{n} rows do not fit in memory")))?;
                    in_vertex = name == "vertex" && count.is_none();
                    if in_vertex {
                        before = before
                            .checked_add(rows_before.saturating_mul(element_stride))
                            .ok_or_else(|| wrong("elements before the splats are too long".to_owned()))?;
                        count = Some(n);
                    } else if count.is_none() {
                        before = before.saturating_add(rows_before.saturating_mul(element_stride));
                        (rows_before, element_stride) = (n, 0);
                    }
                }
                ["property", "list", ..] if count.is_none() || in_vertex => {
                    return Err(Error::unsupported(file, "a list property before or among the splats"));
                }
                ["property", "list", ..] => {}
                ["property", kind, name] => {
                    let size = match kind {
                        "char" | "uchar" | "int8" | "uint8" => 1,
                        "short" | "ushort" | "int16" | "uint16" => 2,
                        "int" | "uint" | "int32" | "uint32" | "float" | "float32" => 4,
                        "double" | "float64" => 8,
                        other => return Err(wrong(format!("property type `{other}`"))),
                    };
                    if in_vertex {
                        let real = matches!(kind, "float" | "float32" | "double" | "float64");
                        if real {
                            fields.push((name.to_owned(), Field { at: stride, double: size == 8 }));
                        }
                        stride += size;
                    } else if count.is_none() {
                        element_stride += size;
                    }
                }
                ["comment" | "obj_info", ..] | [] => {}
                _ => return Err(wrong(format!("PLY header line `{line}`"))),
            }
        }
        let count = count.ok_or_else(|| wrong("the PLY file has no element `vertex`".to_owned()))?;
        let header = at.saturating_add(before);
        let needed = count.checked_mul(stride).and_then(|n| n.checked_add(header));
        match needed {
            Some(needed) if needed <= bytes.len() => {}
            _ => {
                let held = bytes.len().saturating_sub(header) / stride.max(1);
                return Err(wrong(format!(
                    "the header promises {count} splats of {stride} bytes, the file holds {held} ({} bytes)",
                    bytes.len()
                )));
            }
        }
        Self::from_fields(file, fields, header, count, stride)
    }

    fn from_fields(
        file: &str,
        fields: Vec<(String, Field)>,
        header: usize,
        count: usize,
        stride: usize,
    ) -> Result<Self, Error> {
        let find = |name: &str| fields.iter().find(|(known, _)| known == name).map(|(_, field)| *field);
        let need = |name: &str| {
            find(name).ok_or_else(|| {
                let hint = if find("packed_position").is_some() {
                    "; compressed PLY must be expanded first"
                } else if name == "scale_2" {
                    "; 2D splats have none and are not supported"
                } else {
                    "; is this a mesh or a point cloud?"
                };
                Error::format(file, format!("the splats have no field `{name}`{hint}"))
            })
        };
        let rest_count = fields.iter().filter(|(name, _)| name.starts_with("f_rest_")).count();
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
        let known = |name: &str| {
            ["x", "y", "z", "nx", "ny", "nz", "opacity", "filter_3D"].contains(&name)
                || ["f_dc_", "f_rest_", "scale_", "rot_"].iter().any(|prefix| name.starts_with(prefix))
        };
        Ok(Self {
            header,
            count,
            stride,
            sh_degree,
            unused: fields.iter().map(|(name, _)| name).filter(|name| !known(name)).cloned().collect(),
            mean: [need("x")?, need("y")?, need("z")?],
            dc: [need("f_dc_0")?, need("f_dc_1")?, need("f_dc_2")?],
            rest,
            opacity: need("opacity")?,
            scale: [need("scale_0")?, need("scale_1")?, need("scale_2")?],
            rotation: [need("rot_0")?, need("rot_1")?, need("rot_2")?, need("rot_3")?],
            filter: find("filter_3D"),
        })
    }

    /// True when the file holds a smoothing filter that is applied as it is read.
    pub fn has_filter(&self) -> bool {
        self.filter.is_some()
    }

    /// The rows, each of `stride` bytes.
    pub fn rows<'a>(&self, bytes: &'a [u8]) -> &'a [u8] {
        bytes.get(self.header..self.header + self.count * self.stride).unwrap_or(&[])
    }

    /// Activates one row, appending its spherical harmonics to `sh`.
    pub fn row(&self, row: &[u8], max_extent: f64, sh: &mut Vec<[f32; 3]>) -> Result<Row, RowFault> {
        let made = Row::activate(
            self.mean.map(|f| f.get(row)),
            self.rotation.map(|f| f.get(row)),
            self.scale.map(|f| f.get(row)),
            self.opacity.get(row),
            self.filter.map(|f| f.get(row)),
            max_extent,
        )?;
        let start = sh.len();
        sh.push(self.dc.map(|f| f.get(row) as f32));
        let each = self.rest.len() / 3;
        for i in 0..each {
            sh.push([0, 1, 2].map(|channel| self.rest[channel * each + i].get(row) as f32));
        }
        if sh[start..].as_flattened().iter().all(|c| c.is_finite()) {
            Ok(made)
        } else {
            sh.truncate(start);
            Err(RowFault::NotFinite)
        }
    }
}
