//! USD in text (`.usda`) with prims of `ParticleField3DGaussianSplat` (OpenUSD 26.03, `usdVol`): scales and opacities
//! are activated, quaternions are w x y z, harmonics follow each other splat by splat. References are not followed.

use std::collections::BTreeMap;

use engine::{NodeError, Notes, Up};
use glam::{DMat3, DMat4, DVec3};

use super::frame::Turn;
use super::loaded::Loaded;
use super::reading::Reading;
use super::rows::{Row, RowFault, sh_rest};
use crate::error::Error;
use crate::types::frame::Similarity;

/// First bytes of a file.
pub(super) const MAGIC: &[u8] = b"#usda";
/// First bytes of binary USD.
pub(super) const BINARY: &[u8] = b"PXR-USDC";

const PRIM: &str = "ParticleField3DGaussianSplat";
const COEFFICIENTS: &str = "radiance:sphericalHarmonicsCoefficients";
/// Metres per unit of a file that does not specify it, as defined by USD.
const CENTIMETRE: f64 = 0.01;
/// Maximum depth of nested prims.
const DEEPEST: usize = 256;

/// A prim that is being read: its type, its transforms by name, the order of these transforms, and its lists of
/// numbers.
#[derive(Default)]
struct Prim {
    kind: String,
    abstract_class: bool,
    operations: BTreeMap<String, Vec<f32>>,
    order: Vec<String>,
    lists: BTreeMap<String, Vec<f32>>,
    degree: Option<u32>,
}

/// The splats of one prim, with the transform of the prim and its parents.
struct Field {
    lists: BTreeMap<String, Vec<f32>>,
    degree: Option<u32>,
    matrix: DMat4,
}

/// Reader of tokens.
struct Scan<'a> {
    file: &'a str,
    text: &'a str,
    at: usize,
}

impl<'a> Scan<'a> {
    fn bad(&self, what: &str) -> Error {
        let line = self.text.as_bytes().iter().take(self.at).filter(|b| **b == b'\n').count() + 1;
        Error::format(self.file, format!("{what} in line {line}"))
    }

    fn rest(&self) -> &'a str {
        self.text.get(self.at..).unwrap_or_default()
    }

    /// Skips white space, separators and comments.
    fn blanks(&mut self) {
        loop {
            let rest = self.rest();
            let trimmed = rest.trim_start_matches(|c: char| c.is_whitespace() || c == ';');
            self.at += rest.len() - trimmed.len();
            if !trimmed.starts_with('#') {
                return;
            }
            self.at += trimmed.find('\n').unwrap_or(trimmed.len());
        }
    }

    fn take(&mut self, text: &str) -> bool {
        let found = self.rest().starts_with(text);
        self.at += if found { text.len() } else { 0 };
        found
    }

    /// Reads a word, up to white space or punctuation.
    fn word(&mut self) -> &'a str {
        let rest = self.rest();
        let end = rest.find(|c: char| c.is_whitespace() || "=(){}\"@".contains(c)).unwrap_or(rest.len());
        self.at += end;
        &rest[..end]
    }

    /// Reads the text between quotes at the current position.
    fn quoted(&mut self) -> Result<&'a str, Error> {
        let fence = if self.take("\"\"\"") { "\"\"\"" } else { "\"" };
        if fence == "\"" && !self.take("\"") {
            return Err(self.bad("quotes are missing around a name"));
        }
        let rest = self.rest();
        let end = rest.find(fence).ok_or_else(|| self.bad("a string is not closed"))?;
        self.at += end + fence.len();
        Ok(&rest[..end])
    }

    /// Skips a group in brackets, including strings in it. The current position is the first bracket.
    fn balanced(&mut self) -> Result<&'a str, Error> {
        let (start, mut depth) = (self.at, 0_usize);
        loop {
            let rest = self.rest();
            let found = rest.find(|c: char| "()[]{}\"#@".contains(c));
            self.at += found.ok_or_else(|| self.bad("a bracket is not closed"))?;
            match self.text.as_bytes().get(self.at) {
                Some(b'"') => {
                    self.quoted()?;
                    continue;
                }
                Some(b'#') => {
                    self.blanks();
                    continue;
                }
                Some(b'(' | b'[' | b'{') => depth += 1,
                Some(b')' | b']' | b'}') => depth = depth.saturating_sub(1),
                _ => {}
            }
            self.at += 1;
            if depth == 0 {
                return Ok(&self.text[start..self.at]);
            }
        }
    }

    /// Reads the numbers in brackets, or the single number, at the current position.
    fn numbers(&mut self) -> Result<Vec<f32>, Error> {
        let inner = if self.rest().starts_with(['[', '(']) { self.balanced()? } else { self.word() };
        let words = inner.split(|c: char| c.is_whitespace() || "()[],".contains(c)).filter(|w| !w.is_empty());
        words.map(|word| word.parse().map_err(|_| self.bad(&format!("`{word}` is not a number")))).collect()
    }
}

/// The value of the setting `name` in the metadata at the start of the file.
fn setting<'a>(metadata: &'a str, name: &str) -> Option<&'a str> {
    let line = metadata
        .lines()
        .find_map(|line| line.trim().strip_prefix('(').unwrap_or(line.trim()).strip_prefix(name))?;
    Some(line.trim_start().strip_prefix('=')?.trim().trim_end_matches(')').trim().trim_matches('"'))
}

/// The transform of a prim, composed of its operations in their order.
fn local(scan: &Scan<'_>, prim: &Prim) -> Result<DMat4, Error> {
    let mut matrix = DMat4::IDENTITY;
    for name in &prim.order {
        let values: Vec<f64> =
            prim.operations.get(name).into_iter().flatten().map(|v| f64::from(*v)).collect();
        let step = match (name.split(':').nth(1).unwrap_or_default(), &values[..]) {
            // Rows of a matrix that is multiplied from the left are the columns of one from the right.
            ("transform", m) if m.len() == 16 => DMat4::from_cols_array(m.try_into().unwrap_or(&[0.0; 16])),
            ("translate", &[x, y, z]) => DMat4::from_translation(DVec3::new(x, y, z)),
            ("scale", &[x, y, z]) => DMat4::from_scale(DVec3::new(x, y, z)),
            _ => {
                let what = format!("the USD transform `{name}`; write it as a matrix, `xformOp:transform`");
                return Err(Error::unsupported(scan.file, what));
            }
        };
        matrix *= step;
    }
    Ok(matrix)
}

/// Reads all prims of splats.
fn fields(scan: &mut Scan<'_>) -> Result<Vec<Field>, Error> {
    let (mut open, mut found): (Vec<Prim>, Vec<Field>) = (Vec::new(), Vec::new());
    loop {
        scan.blanks();
        if scan.rest().is_empty() {
            return if open.is_empty() { Ok(found) } else { Err(scan.bad("a prim is not closed")) };
        }
        if scan.take("}") {
            let prim = open.pop().ok_or_else(|| scan.bad("a closing bracket has no opening bracket"))?;
            if prim.kind == PRIM && !prim.abstract_class && !open.iter().any(|p| p.abstract_class) {
                let mut matrix = DMat4::IDENTITY;
                for one in open.iter().chain([&prim]) {
                    matrix *= local(scan, one)?;
                }
                found.push(Field { lists: prim.lists, degree: prim.degree, matrix });
            }
            continue;
        }
        if scan.rest().starts_with(['(', '[', '{', ')', ']']) {
            scan.balanced()?;
            continue;
        }
        if scan.rest().starts_with(['"', '@', '=']) {
            scan.at += 1;
            continue;
        }
        let word = scan.word();
        if matches!(word, "def" | "class" | "over") {
            scan.blanks();
            let kind = if scan.rest().starts_with('"') { "" } else { scan.word() };
            scan.blanks();
            scan.quoted()?;
            scan.blanks();
            if scan.rest().starts_with('(') {
                scan.balanced()?;
                scan.blanks();
            }
            if !scan.take("{") {
                return Err(scan.bad("a prim has no body"));
            }
            if open.len() >= DEEPEST {
                return Err(scan.bad("prims are nested too deeply"));
            }
            open.push(Prim { kind: kind.to_owned(), abstract_class: word == "class", ..Prim::default() });
            continue;
        }
        attribute(scan, word, open.last_mut())?;
    }
}

/// Reads one attribute. Its first word has been read already and is `first`.
fn attribute<'a>(scan: &mut Scan<'a>, first: &'a str, prim: Option<&mut Prim>) -> Result<(), Error> {
    let mut name = first;
    loop {
        let rest = scan.rest();
        scan.at += rest.len() - rest.trim_start_matches([' ', '\t']).len();
        if scan.rest().starts_with(['\n', '\r']) || scan.rest().is_empty() {
            return Ok(());
        }
        if scan.take("=") {
            break;
        }
        let word = scan.word();
        if word.is_empty() {
            return Ok(());
        }
        name = word;
    }
    scan.blanks();
    let Some(prim) = prim else { return Ok(()) };
    if name == "xformOpOrder" {
        let inner = if scan.rest().starts_with('[') { scan.balanced()? } else { "" };
        prim.order = inner.split('"').skip(1).step_by(2).map(str::to_owned).collect();
    } else if name.starts_with("xformOp:") {
        if name.ends_with(".timeSamples") {
            return Err(Error::unsupported(scan.file, "animated USD splats; save a single frame"));
        }
        let values = scan.numbers()?;
        prim.operations.insert(name.to_owned(), values);
    } else if prim.kind == PRIM {
        let known = ["positions", "points", "orientations", "scales", "opacities", COEFFICIENTS];
        let plain = name.strip_suffix('h').filter(|name| known.contains(name)).unwrap_or(name);
        if known.contains(&plain) {
            let values = scan.numbers()?;
            prim.lists.insert(plain.to_owned(), values);
        } else if name == "radiance:sphericalHarmonicsDegree" {
            prim.degree = scan.numbers()?.first().filter(|d| (0.0..=4.0).contains(*d)).map(|d| *d as u32);
            if prim.degree.is_none() {
                return Err(scan.bad("the degree of the spherical harmonics must be 0 to 4"));
            }
        } else if name.ends_with(".timeSamples") && known.iter().any(|known| name.starts_with(known)) {
            return Err(Error::unsupported(scan.file, "animated USD splats; save a single frame"));
        }
    }
    Ok(())
}

/// Loads a file.
pub(super) fn load(
    file: &str,
    bytes: &[u8],
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let text = std::str::from_utf8(bytes).map_err(|_| Error::format(file, "the file is not text"))?;
    let mut scan = Scan { file, text, at: text.find('\n').unwrap_or(text.len()) };
    scan.blanks();
    let metadata = if scan.rest().starts_with('(') { scan.balanced()? } else { "" };
    let up = match setting(metadata, "upAxis") {
        None | Some("Y") => Up::PlusY,
        Some("Z") => Up::PlusZ,
        Some(other) => return Err(Error::format(file, format!("`upAxis` is `{other}`, not Y or Z")).into()),
    };
    let unit = setting(metadata, "metersPerUnit").map_or(Ok(CENTIMETRE), str::parse::<f64>);
    let unit = unit.ok().filter(|unit| *unit > 0.0 && unit.is_finite());
    let unit = unit.ok_or_else(|| Error::format(file, "`metersPerUnit` is not a number above 0"))?;
    notes.decision("usd-unit", format!("`{file}` has {unit} metres per unit"));
    let fields = fields(&mut scan)?;
    if fields.is_empty() {
        let what = format!("the file has no prim of the type `{PRIM}`");
        return Err(
            NodeError::from(Error::format(file, what)).hint("meshes are read from glTF, PLY, OBJ and STL")
        );
    }
    let world = reading.world(file, Some(up), true, notes).unwrap_or(Similarity::IDENTITY);
    let mut all: Option<Loaded> = None;
    for field in &fields {
        let matrix = DMat4::from_scale(DVec3::splat(unit)) * field.matrix;
        let linear = world.rotation * DMat3::from_mat4(matrix) * world.scale;
        let offset = world.point(matrix.w_axis.truncate());
        let turn = Turn::of_linear(linear, offset).ok_or_else(|| {
            Error::unsupported(file, "a transform of splats that scales unevenly or shears")
        })?;
        let one = rows(file, field, &turn, reading)?;
        all = Some(match all {
            None => one,
            Some(all) => all.join(file, one)?,
        });
    }
    Ok(all.unwrap_or_else(|| Loaded::new(Vec::new(), 0, 0)))
}

/// The splats of one prim.
fn rows(file: &str, field: &Field, turn: &Turn, reading: &Reading<'_>) -> Result<Loaded, NodeError> {
    let list = |name: &str| field.lists.get(name).map_or(&[][..], Vec::as_slice);
    let positions = if list("positions").is_empty() { list("points") } else { list("positions") };
    let positions = positions.as_chunks::<3>().0;
    let count = positions.len();
    let whole = |name: &str, found: usize, each: usize| -> Result<(), Error> {
        if found == count * each || found == 0 {
            return Ok(());
        }
        Err(Error::format(
            file,
            format!("`{name}` has {found} numbers for {count} splats; each splat needs {each}"),
        ))
    };
    let (scales, turns, opacities) = (list("scales"), list("orientations"), list("opacities"));
    whole("scales", scales.len(), 3)?;
    whole("orientations", turns.len(), 4)?;
    whole("opacities", opacities.len(), 1)?;
    let colours = list(COEFFICIENTS).as_chunks::<3>().0;
    let held = colours.len().checked_div(count).unwrap_or(0);
    let degree = field.degree.unwrap_or_else(|| (0..=4).find(|d| sh_rest(*d) + 1 == held).unwrap_or(0));
    whole(COEFFICIENTS, 3 * colours.len(), 3 * (sh_rest(degree) + 1))?;
    let each = sh_rest(degree) + 1;
    let parts = reading.rows(count, Some(turn), |index, sh| {
        let three = |list: &[f32], otherwise: f64| {
            let own = list.as_chunks::<3>().0.get(index);
            own.map_or([otherwise; 3], |v| v.map(f64::from))
        };
        let quat = turns.as_chunks::<4>().0.get(index).map_or([1.0, 0.0, 0.0, 0.0], |q| q.map(f64::from));
        if colours.is_empty() {
            sh.extend(std::iter::repeat_n([0.0; 3], each));
        } else {
            sh.extend_from_slice(colours.get(index * each..(index + 1) * each).ok_or(RowFault::NoSuchEntry)?);
        }
        let opacity = opacities.get(index).map_or(1.0, |o| f64::from(*o));
        let mean = positions.get(index).ok_or(RowFault::NoSuchEntry)?.map(f64::from);
        Row::checked(mean, quat, three(scales, 1.0), opacity, reading.max_extent)
    })?;
    Ok(Loaded::new(parts, count, degree))
}
