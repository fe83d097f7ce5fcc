//! USD in text (`.usda`) with prims of `ParticleField3DGaussianSplat` (OpenUSD 26.03, `usdVol`): scales and
//! opacities are activated, quaternions are w x y z, harmonics follow each other splat by splat. Prims that are
//! inactive, invisible, of the purpose `guide` or `proxy`, or not defined are skipped. Splats without harmonics have
//! the colour `displayColor`. References, variants and other layers are not followed, but reported.

mod prim;
mod scan;
mod transform;

use engine::{NodeError, Notes, Up};
use glam::{DMat3, DMat4, DVec3};

use self::prim::{COEFFICIENTS, DISPLAY_COLOUR, FLATTEN, Field, PRIM, Stage};
use self::scan::Scan;
use super::frame::{Frame, Turn};
use super::loaded::Loaded;
use super::reading::Reading;
use super::rows::{Row, RowFault, SH_C0, sh_rest};
use crate::error::Error;
use crate::math::color::srgb_from_linear;
use crate::types::frame::Similarity;

/// First bytes of a file.
pub(super) const MAGIC: &[u8] = b"#usda";
/// First bytes of binary USD.
pub(super) const BINARY: &[u8] = b"PXR-USDC";

/// Metres per unit of a file that does not specify it, as defined by USD.
const CENTIMETRE: f64 = 0.01;

/// The axis that the setting `upAxis` names. Any other value is the error.
fn up_of(setting: Option<&str>) -> Result<Up, &str> {
    match setting {
        None | Some("Y") => Ok(Up::PlusY),
        Some("Z") => Ok(Up::PlusZ),
        Some(other) => Err(other),
    }
}

/// The up axis of a file; `None` if its settings cannot be read.
pub(super) fn up_axis(bytes: &[u8]) -> Option<Up> {
    let mut scan = Scan::after_first_line("", std::str::from_utf8(bytes).ok()?);
    scan.blanks().ok()?;
    let settings = scan.settings().ok()?;
    up_of(settings.iter().find(|one| one.words == ["upAxis"]).map(|one| one.plain())).ok()
}

/// Loads a file.
pub(super) fn load(
    file: &str,
    bytes: &[u8],
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let text = std::str::from_utf8(bytes).map_err(|_| Error::format(file, "the file is not text"))?;
    let mut scan = Scan::after_first_line(file, text);
    scan.blanks()?;
    let settings = scan.settings()?;
    let setting = |name: &str| settings.iter().find(|one| one.words == [name]).map(|one| one.plain());
    let up = up_of(setting("upAxis"));
    let up = up.map_err(|other| Error::format(file, format!("`upAxis` is `{other}`, not Y or Z")))?;
    let unit = setting("metersPerUnit").map_or(Ok(CENTIMETRE), str::parse::<f64>);
    let unit = unit.ok().filter(|unit| *unit > 0.0 && unit.is_finite());
    let unit = unit.ok_or_else(|| Error::format(file, "`metersPerUnit` is not a number above 0"))?;
    let stays = if reading.placing.frame == Frame::AsStored {
        ", by which its coordinates are multiplied although its axes are used as stored"
    } else {
        ""
    };
    notes.decision("usd-unit", format!("`{file}` has {unit} metres per unit{stays}"));
    let Stage { fields, hidden, elsewhere } = Stage::read(&mut scan, &settings)?;
    if hidden > 0 {
        let text = format!(
            "prims of splats in `{file}` that are inactive, invisible, guides, proxies or not defined are ignored (count: {hidden})"
        );
        notes.decision("usd-hidden", text);
    }
    if fields.is_empty() && !elsewhere.is_empty() {
        let what = format!("splats in {}; {FLATTEN}", elsewhere.join(", "));
        return Err(Error::unsupported(file, what).into());
    }
    if fields.is_empty() {
        let what = if hidden > 0 {
            format!("all prims of the type `{PRIM}` are inactive, invisible, guides, proxies or not defined")
        } else {
            format!("the file has no prim of the type `{PRIM}`")
        };
        return Err(
            NodeError::from(Error::format(file, what)).hint("meshes are read from glTF, PLY, OBJ and STL")
        );
    }
    if !elsewhere.is_empty() {
        let text = format!("`{file}` uses {}, which are not read; {FLATTEN}", elsewhere.join(", "));
        notes.degraded("usd-elsewhere", text);
    }
    let world = reading.world(file, Some(up), true, notes).unwrap_or(Similarity::IDENTITY);
    let mut all: Option<Loaded> = None;
    for field in &fields {
        let matrix = DMat4::from_scale(DVec3::splat(unit)) * field.matrix;
        let linear = world.rotation * DMat3::from_mat4(matrix) * world.scale;
        let offset = world.point(matrix.w_axis.truncate());
        let turn = Turn::of_linear(linear, offset).ok_or_else(|| {
            Error::unsupported(file, "a transform of splats with non-uniform scale or shear")
        })?;
        if field.list(COEFFICIENTS).is_empty() {
            let text = format!("splats of `{file}` have no spherical harmonics");
            if field.list(DISPLAY_COLOUR).is_empty() {
                notes.warning("usd-no-colour", format!("{text} and no `displayColor`; they are grey"));
            } else {
                notes.decision("usd-display-colour", format!("{text}; they have the colour `displayColor`"));
            }
        }
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
    let list = |name: &str| field.list(name);
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
    let plain = list(DISPLAY_COLOUR).as_chunks::<3>().0;
    if plain.len() > 1 {
        whole(DISPLAY_COLOUR, 3 * plain.len(), 3)?;
    }
    let parts = reading.rows(count, Some(turn), |index, sh| {
        let three = |list: &[f32], otherwise: f64| {
            let own = list.as_chunks::<3>().0.get(index);
            own.map_or([otherwise; 3], |v| v.map(f64::from))
        };
        let quat = turns.as_chunks::<4>().0.get(index).map_or([1.0, 0.0, 0.0, 0.0], |q| q.map(f64::from));
        if colours.is_empty() {
            let colour = plain
                .get(index)
                .or(plain.first())
                .map_or([0.0; 3], |colour| colour.map(|c| (srgb_from_linear(c) - 0.5) / SH_C0 as f32));
            sh.push(colour);
            sh.extend(std::iter::repeat_n([0.0; 3], each - 1));
        } else {
            sh.extend_from_slice(colours.get(index * each..(index + 1) * each).ok_or(RowFault::NoSuchEntry)?);
        }
        let opacity = opacities.get(index).map_or(1.0, |o| f64::from(*o));
        let mean = positions.get(index).ok_or(RowFault::NoSuchEntry)?.map(f64::from);
        Row::checked(mean, quat, three(scales, 1.0), opacity, reading.max_extent)
    })?;
    Ok(Loaded::new(parts, count, degree))
}
