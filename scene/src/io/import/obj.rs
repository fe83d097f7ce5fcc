//! Wavefront OBJ: shapes, normals, texture coordinates, vertex colours, and the materials of [`mtl`]. No
//! crate is used: the crate `tobj` reads only UTF-8, no continued lines, and reports no line numbers.

use std::collections::{BTreeMap, HashMap};

use engine::{Context, NodeError, Notes};

use super::glb::{Builder, GlbMesh};
use super::material::materials;
use super::mtl;
use super::text::{Lines, word, words};
use crate::error::Error;
use crate::io::colour_range::Range;
use crate::io::foreign::refuse_foreign;
use crate::io::mesh_format;

/// Names of materials that programs write for faces without a material.
const NO_MATERIAL: [&str; 4] = ["", "None", "(null)", "none"];
/// Index of an attribute that a corner does not have.
const ABSENT: u32 = u32::MAX;

/// Names of the material files, followed by the names of the pictures to which they refer.
pub(super) fn other_files(bytes: &[u8], read: &mut dyn FnMut(&str) -> Option<Vec<u8>>) -> Vec<String> {
    let mut files: Vec<String> = Vec::new();
    for library in mtl::libraries(bytes, read) {
        let Some(text) = &library.bytes else { continue };
        if !files.contains(&library.path) {
            files.push(library.path.clone());
        }
        for texture in mtl::parse(text).materials.into_iter().filter_map(|material| material.texture) {
            let path = library.sibling(&texture.path);
            if !files.contains(&path) && read(&path).is_some() {
                files.push(path);
            }
        }
    }
    files
}

/// The lists of a file, and the triangles of each material.
#[derive(Default)]
struct Shapes {
    positions: Vec<[f32; 3]>,
    /// Empty, or one colour per position; NaN where the file has none.
    colours: Vec<[f32; 3]>,
    uv: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    /// For each name of a material, in order of first use, the corners of its triangles as indices of position,
    /// texture coordinates and normal.
    groups: Vec<(String, Vec<[u32; 3]>)>,
    by_name: BTreeMap<String, usize>,
    current: usize,
    /// Largest index in each of the three lists, and its line.
    largest: [Option<(u32, usize)>; 3],
    points_and_lines: u64,
    free_forms: u64,
}

/// Reads a face index, from 1, or negative from the end of the list. Returns an index from 0.
fn index(word: &str, count: usize) -> Option<u32> {
    let given: i64 = word.parse().ok()?;
    let from_zero = if given < 0 { count as i64 + given } else { given - 1 };
    u32::try_from(from_zero).ok().filter(|index| *index != ABSENT)
}

fn numbers<const N: usize>(words: &[&str]) -> Option<[f32; N]> {
    let mut out = [0.0; N];
    for (out, word) in out.iter_mut().zip(words.get(..N)?) {
        *out = word.parse().ok()?;
    }
    Some(out)
}

impl Shapes {
    fn vertex(&mut self, words: &[&str]) -> Option<()> {
        let mut position: [f32; 3] = numbers(words)?;
        let colour: Option<[f32; 3]> = match words.len() {
            3 => None,
            4 => {
                let [w]: [f32; 1] = numbers(&words[3..])?;
                if w == 0.0 {
                    return None;
                }
                position = position.map(|v| v / w);
                None
            }
            // A seventh number is the opacity.
            6 | 7 => Some(numbers(&words[3..])?),
            _ => return None,
        };
        if let Some(colour) = colour {
            self.colours.resize(self.positions.len(), [f32::NAN; 3]);
            self.colours.push(colour);
        }
        self.positions.push(position);
        Some(())
    }

    fn face(&mut self, line: usize, words: &[&str]) -> Option<()> {
        let counts = [self.positions.len(), self.uv.len(), self.normals.len()];
        let mut corners = Vec::with_capacity(words.len());
        for word in words {
            let mut corner = [ABSENT; 3];
            let mut parts = word.split('/');
            for (k, (to, count)) in corner.iter_mut().zip(counts).enumerate() {
                match parts.next() {
                    Some("") if k > 0 => {}
                    Some(part) => {
                        let found = index(part, count)?;
                        *to = found;
                        let known = self.largest[k].get_or_insert((found, line));
                        if found > known.0 {
                            *known = (found, line);
                        }
                    }
                    None => {}
                }
            }
            if parts.next().is_some() || corner[0] == ABSENT {
                return None;
            }
            corners.push(corner);
        }
        if corners.len() < 3 {
            self.points_and_lines += 1;
            return Some(());
        }
        if self.groups.is_empty() {
            self.use_material("");
        }
        let group = &mut self.groups[self.current].1;
        for pair in corners.windows(2).skip(1) {
            group.extend([corners[0], pair[0], pair[1]]);
        }
        Some(())
    }

    fn use_material(&mut self, name: &str) {
        let next = self.groups.len();
        self.current = *self.by_name.entry(name.to_owned()).or_insert(next);
        if self.current == next {
            self.groups.push((name.to_owned(), Vec::new()));
        }
    }

    /// Reads a file.
    fn read(name: &str, bytes: &[u8], cx: &Context) -> Result<Self, NodeError> {
        let mut shapes = Self::default();
        for (count, (line, text)) in Lines::of(bytes).enumerate() {
            if count % 65_536 == 0 {
                cx.check()?;
            }
            let (keyword, rest) = word(&text);
            let list = || words(rest).collect::<Vec<_>>();
            let read = match keyword {
                "v" => shapes.vertex(&list()),
                "vt" => {
                    let words = list();
                    // A texture may have one dimension.
                    let uv = numbers(&words).or_else(|| numbers(&words).map(|[u]: [f32; 1]| [u, 0.0]));
                    uv.map(|uv| shapes.uv.push(uv))
                }
                "vn" => numbers(&list()).map(|normal| shapes.normals.push(normal)),
                "f" | "fo" => shapes.face(line, &list()),
                "usemtl" => {
                    shapes.use_material(rest);
                    Some(())
                }
                "l" | "p" => {
                    shapes.points_and_lines += 1;
                    Some(())
                }
                "curv" | "curv2" | "surf" => {
                    shapes.free_forms += 1;
                    Some(())
                }
                // Groups, smoothing and whatever else does not change the shape.
                _ => Some(()),
            };
            if read.is_none() {
                let text: String = text.chars().take(80).collect();
                let what = format!("line {line} cannot be read as Wavefront OBJ: `{text}`");
                return Err(Error::format(name, what).into());
            }
        }
        shapes.check(name)?;
        Ok(shapes)
    }

    /// Checks the indices. A face may come before the lists to which it refers.
    fn check(&self, name: &str) -> Result<(), Error> {
        if self.positions.is_empty() {
            return Err(Error::format(
                name,
                "not a Wavefront OBJ file: it has no vertices (lines `v x y z`)",
            ));
        }
        let lists = [
            ("vertex", self.positions.len()),
            ("texture coordinate", self.uv.len()),
            ("normal", self.normals.len()),
        ];
        for (largest, (what, count)) in self.largest.iter().zip(lists) {
            if let Some((index, line)) = largest.filter(|(index, _)| *index as usize >= count) {
                let what = format!(
                    "the face in line {line} refers to {what} {}, which does not exist (number in the file: {count})",
                    u64::from(index) + 1
                );
                return Err(Error::format(name, what));
            }
        }
        Ok(())
    }

    /// Gives vertices without a colour white, where other vertices have colours.
    fn complete_colours(&mut self) {
        if self.colours.is_empty() {
            return;
        }
        let range = Range::of_floats(self.colours.as_flattened().iter().map(|c| f64::from(*c)));
        self.colours.resize(self.positions.len(), [f32::NAN; 3]);
        for colour in self.colours.iter_mut().filter(|colour| colour.iter().any(|c| c.is_nan())) {
            *colour = [range.white as f32; 3];
        }
    }

    /// A mesh of some corners. Corners with the same indices become one vertex.
    fn part(&self, corners: &[[u32; 3]], material: Option<usize>) -> GlbMesh {
        let mut part = GlbMesh { material, ..GlbMesh::default() };
        let has = |k: usize| corners.iter().any(|corner| corner[k] != ABSENT);
        let (has_uv, has_normals) = (has(1), has(2));
        let mut known: HashMap<[u32; 3], u32> = HashMap::new();
        for corner in corners {
            let next = part.positions.len() as u32;
            let at = *known.entry(*corner).or_insert(next);
            part.indices.push(at);
            if at != next {
                continue;
            }
            let [v, vt, vn] = corner.map(|index| index as usize);
            part.positions.push(self.positions[v]);
            if !self.colours.is_empty() {
                part.colours.push(self.colours[v]);
            }
            if has_uv {
                let [u, v] = self.uv.get(vt).copied().unwrap_or_default();
                // Row 0 of a picture is at the top in glTF, and at the bottom here.
                part.uv.push([u, 1.0 - v]);
            }
            if has_normals {
                // A missing normal becomes 0, which is repaired later.
                part.normals.push(self.normals.get(vn).copied().unwrap_or_default());
            }
        }
        part
    }
}

/// Reads shapes and materials.
pub(super) fn read(
    name: &str,
    bytes: &[u8],
    read: &dyn Fn(&str) -> Result<Vec<u8>, NodeError>,
    builder: &mut Builder,
    cx: &Context,
    notes: &mut Notes,
) -> Result<(), NodeError> {
    refuse_foreign(name, bytes)?;
    if let Some(format) = mesh_format::by_content(bytes) {
        return Err(mesh_format::refused(name, format, "OBJ").into());
    }
    let mut shapes = Shapes::read(name, bytes, cx)?;
    shapes.complete_colours();
    let (by_name, complete) = materials(bytes, read, builder, notes);
    let mut unknown = Vec::new();
    for (material, corners) in shapes.groups.iter().filter(|(_, corners)| !corners.is_empty()) {
        let found = by_name.get(material).copied();
        if found.is_none() && !NO_MATERIAL.contains(&material.as_str()) {
            unknown.push(format!("`{material}`"));
        }
        builder.add(&shapes.part(corners, found));
    }
    if complete && !unknown.is_empty() {
        let what = format!("these materials are not defined in any material file: {}", unknown.join(", "));
        if shapes.colours.is_empty() {
            notes.degraded("materials-missing", format!("{what}; the faces that use them are white"));
        } else {
            notes.decision("materials-missing", format!("{what}; the faces have only the vertex colours"));
        }
    }
    notes.count(
        "points-and-lines",
        shapes.points_and_lines,
        "of the elements were points or lines, and were left out",
    );
    if shapes.free_forms > 0 {
        let what = format!("curves and free-form surfaces are left out (number: {})", shapes.free_forms);
        notes.warning("free-forms", what);
    }
    Ok(())
}
