//! Prims of a file: their transforms, whether they are drawn, and the numbers of their splats.

use std::collections::BTreeMap;

use glam::DMat4;

use super::scan::{Scan, Setting};
use super::transform;
use crate::error::Error;

/// Type of the prims of splats.
pub(super) const PRIM: &str = "ParticleField3DGaussianSplat";
/// Remedy for files that refer to others.
pub(super) const FLATTEN: &str = "`usdcat --flatten` writes a file that contains everything";
/// Attribute of the harmonics.
pub(super) const COEFFICIENTS: &str = "radiance:sphericalHarmonicsCoefficients";
/// Attribute of the linear colour of prims without harmonics: one for each splat, or one for all.
pub(super) const DISPLAY_COLOUR: &str = "primvars:displayColor";
/// Attributes of splats that are read. Each may have a form of half precision, whose name ends in `h`.
const LISTS: [&str; 7] =
    ["positions", "points", "orientations", "scales", "opacities", COEFFICIENTS, DISPLAY_COLOUR];
/// Maximum depth of nested prims.
const DEEPEST: usize = 256;
/// Settings of a file or prim that bring in data from other files or prims.
const ELSEWHERE: [&str; 5] = ["references", "payload", "inherits", "specializes", "subLayers"];

/// The splats of one prim, with the transform of the prim and its parents.
pub(super) struct Field {
    lists: BTreeMap<String, Vec<f32>>,
    /// Degree of the harmonics, if the prim states it.
    pub(super) degree: Option<u32>,
    /// Transform from the prim to the file.
    pub(super) matrix: DMat4,
}

impl Field {
    /// The numbers of an attribute; those of half precision if there are no others.
    pub(super) fn list(&self, name: &str) -> &[f32] {
        let own = self.lists.get(name).filter(|list| !list.is_empty());
        own.or_else(|| self.lists.get(&format!("{name}h"))).map_or(&[], Vec::as_slice)
    }
}

/// A prim. Its parent precedes it in the list of prims.
#[derive(Default)]
struct Prim {
    kind: String,
    name: String,
    parent: Option<usize>,
    hidden: bool,
    operations: BTreeMap<String, Vec<f64>>,
    order: Vec<String>,
    lists: BTreeMap<String, Vec<f32>>,
    degree: Option<u32>,
    elsewhere: Vec<&'static str>,
    /// Feature that is not supported. It matters if there are splats in the prim.
    fault: Option<String>,
}

impl Prim {
    /// The transform to the parent, and true if the transforms of the parents are ignored. The error is the feature
    /// that is not supported.
    fn local(&self) -> Result<(DMat4, bool), String> {
        let (mut matrix, mut reset) = (DMat4::IDENTITY, false);
        for name in &self.order {
            if name == transform::RESET {
                (matrix, reset) = (DMat4::IDENTITY, true);
                continue;
            }
            // An operation without a value is the identity.
            if let Some(values) = self.operations.get(transform::attribute(name)) {
                matrix *= transform::matrix(name, values).ok_or_else(|| {
                    format!("the USD transform `{name}`; write it as a matrix, `xformOp:transform`")
                })?;
            }
        }
        Ok((matrix, reset))
    }

    /// Applies a setting in the parentheses after the name.
    fn set(&mut self, setting: &Setting<'_>) {
        if setting.words == ["active"] {
            self.hidden |= matches!(setting.plain(), "false" | "0");
        }
        self.elsewhere.extend(elsewhere(setting));
    }
}

/// The name of a setting that brings in data from other files or prims.
fn elsewhere(setting: &Setting<'_>) -> Option<&'static str> {
    let empty = setting.value == "None" || setting.value.trim_matches(['[', ']', ' ']).is_empty();
    let name = ELSEWHERE.iter().copied().find(|name| *name == setting.name());
    name.filter(|_| !empty && setting.words.first() != Some(&"delete"))
}

/// The content of a file.
pub(super) struct Stage {
    /// The splats that are drawn.
    pub(super) fields: Vec<Field>,
    /// Number of prims of splats that are not drawn.
    pub(super) hidden: usize,
    /// Data that are not read, in words, such as "the references of `Chair`".
    pub(super) elsewhere: Vec<String>,
}

/// Maximum number of entries of [`Stage::elsewhere`] that are named.
const NAMED: usize = 3;

impl Stage {
    /// Reads the prims of a file. `settings` are the settings of the file.
    pub(super) fn read(scan: &mut Scan<'_>, settings: &[Setting<'_>]) -> Result<Self, Error> {
        let mut prims = prims(scan)?;
        let mut named: Vec<String> =
            settings.iter().filter_map(elsewhere).map(|what| format!("the {what} of the file")).collect();
        let (mut fields, mut hidden) = (Vec::new(), 0);
        let mut matrices: Vec<DMat4> = Vec::with_capacity(prims.len());
        for at in 0..prims.len() {
            let (local, fault) = match prims[at].local() {
                Ok(local) => (local, None),
                Err(fault) => ((DMat4::IDENTITY, false), Some(fault)),
            };
            let (matrix, reset) = local;
            let parent = prims[at].parent;
            let above = parent.filter(|_| !reset).map_or(DMat4::IDENTITY, |parent| matrices[parent]);
            matrices.push(above * matrix);
            let (hidden_above, fault_above) =
                parent.map_or((false, None), |parent| (prims[parent].hidden, prims[parent].fault.clone()));
            let prim = &mut prims[at];
            prim.hidden |= hidden_above;
            prim.fault = prim.fault.take().or(fault).or(fault_above);
            if prim.hidden {
                hidden += usize::from(prim.kind == PRIM);
                continue;
            }
            named.extend(prim.elsewhere.iter().map(|what| format!("the {what} of `{}`", prim.name)));
            if prim.kind != PRIM {
                continue;
            }
            if let Some(fault) = &prim.fault {
                return Err(Error::unsupported(scan.file, fault.as_str()));
            }
            let lists = std::mem::take(&mut prim.lists);
            let field = Field { lists, degree: prim.degree, matrix: matrices[at] };
            if !prim.elsewhere.is_empty()
                && field.list("positions").is_empty()
                && field.list("points").is_empty()
            {
                let what =
                    format!("the {} of the splats `{}`; {FLATTEN}", prim.elsewhere.join(", "), prim.name);
                return Err(Error::unsupported(scan.file, what));
            }
            fields.push(field);
        }
        let more = named.len().saturating_sub(NAMED);
        named.truncate(NAMED);
        if more > 0 {
            named.push(format!("and {more} more"));
        }
        Ok(Self { fields, hidden, elsewhere: named })
    }
}

/// Reads all prims, parents first.
fn prims(scan: &mut Scan<'_>) -> Result<Vec<Prim>, Error> {
    let (mut prims, mut open): (Vec<Prim>, Vec<usize>) = (Vec::new(), Vec::new());
    loop {
        scan.blanks()?;
        if scan.rest().is_empty() {
            return if open.is_empty() { Ok(prims) } else { Err(scan.bad("a prim is not closed")) };
        }
        if scan.take("}") {
            open.pop().ok_or_else(|| scan.bad("a closing bracket has no opening bracket"))?;
            continue;
        }
        // The settings of an attribute, or a value without a meaning for splats.
        if scan.next_is(['(', '[', '{']) {
            scan.balanced()?;
            continue;
        }
        let word = scan.word();
        match word {
            "" => return Err(scan.bad("a name is missing")),
            "def" | "class" | "over" => {
                if open.len() >= DEEPEST {
                    return Err(scan.bad("prims are nested too deeply"));
                }
                let prim = heading(scan, word, open.last().copied())?;
                open.push(prims.len());
                prims.push(prim);
            }
            "variantSet" => {
                scan.blanks()?;
                scan.quoted()?;
                scan.blanks()?;
                if !scan.take("=") {
                    return Err(scan.bad("a variant set has no variants"));
                }
                scan.blanks()?;
                scan.balanced()?;
                if let Some(prim) = open.last().and_then(|at| prims.get_mut(*at)) {
                    prim.elsewhere.push("variants");
                }
            }
            _ => attribute(scan, word, open.last().and_then(|at| prims.get_mut(*at)))?,
        }
    }
}

/// Reads the start of a prim after the word `specifier`, up to the bracket of its body. Only `def` defines a prim.
fn heading(scan: &mut Scan<'_>, specifier: &str, parent: Option<usize>) -> Result<Prim, Error> {
    scan.blanks()?;
    let kind = scan.word().to_owned();
    scan.blanks()?;
    let name = scan.quoted()?.to_owned();
    scan.blanks()?;
    let mut prim = Prim { kind, name, parent, hidden: specifier != "def", ..Prim::default() };
    for setting in scan.settings()? {
        prim.set(&setting);
    }
    scan.blanks()?;
    if !scan.take("{") {
        return Err(scan.bad("a prim has no body"));
    }
    Ok(prim)
}

/// Reads one attribute with its value. Its first word has been read already and is `first`.
fn attribute<'a>(scan: &mut Scan<'a>, first: &'a str, prim: Option<&mut Prim>) -> Result<(), Error> {
    let mut name = first;
    loop {
        scan.spaces();
        if scan.take("=") {
            break;
        }
        let word = scan.word();
        if word.is_empty() {
            // The end of the line or of the prim, settings or a comment: the attribute has no value.
            let rest = scan.rest();
            let known = rest.is_empty() || rest.starts_with(['\n', '\r', '}', '(', '#', '/', ';']);
            return if known { Ok(()) } else { Err(scan.bad("an attribute has no value")) };
        }
        name = word;
    }
    scan.blanks()?;
    let Some(prim) = prim else { return scan.value().map(drop) };
    let (plain, animated) = match name.split_once('.') {
        Some((plain, "timeSamples" | "spline")) => (plain, true),
        // A connection has no value.
        Some(_) => return scan.value().map(drop),
        None => (name, false),
    };
    let list = LISTS.contains(&plain) || plain.strip_suffix('h').is_some_and(|name| LISTS.contains(&name));
    let splats = prim.kind == PRIM && (list || plain == "radiance:sphericalHarmonicsDegree");
    let operation = plain.starts_with("xformOp:");
    if animated && (splats || operation || matches!(plain, "visibility" | "purpose")) {
        prim.fault = Some("animated USD splats; save a single frame".to_owned());
    }
    if animated {
        return scan.value().map(drop);
    }
    if plain == "xformOpOrder" {
        prim.order = scan.strings()?;
    } else if plain == "visibility" {
        prim.hidden |= scan.value()?.trim_matches(['"', '\'']) == "invisible";
    } else if plain == "purpose" {
        // Renderers draw the purposes `default` and `render`; `proxy` and `guide` stand in for them while editing.
        prim.hidden |= matches!(scan.value()?.trim_matches(['"', '\'']), "proxy" | "guide");
    } else if operation {
        match scan.numbers()? {
            Some(values) => drop(prim.operations.insert(plain.to_owned(), values)),
            None => drop(prim.operations.remove(plain)),
        }
    } else if splats && list {
        match scan.numbers()? {
            Some(values) => drop(prim.lists.insert(plain.to_owned(), values)),
            None => drop(prim.lists.remove(plain)),
        }
    } else if splats {
        let Some(degree) = scan.numbers::<f32>()? else { return Ok(()) };
        prim.degree = degree.first().filter(|d| (0.0..=4.0).contains(*d)).map(|d| *d as u32);
        if prim.degree.is_none() {
            return Err(scan.bad("the degree of the spherical harmonics must be 0 to 4"));
        }
    } else {
        scan.value()?;
    }
    Ok(())
}
