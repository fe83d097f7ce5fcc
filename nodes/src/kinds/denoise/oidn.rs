//! `Method::Oidn`: filters the ratio and the object with Open Image Denoise, loaded at run time if it is installed.
//!
//! Of several kinds of input, these worked best on `render-refs` (`docs/evidence/light-transport.md`): the ratio as
//! a separate picture without guides, since it has no texture, and the guides have edges that the ratio lacks; and
//! the premultiplied object, with its normals, and with its alpha in place of an albedo.

use std::sync::OnceLock;

use engine::{Context, NodeError, Notes, SourceFile};
use oidn::{Error, Installation, Library, Surfaces};

use super::means::{Field, VALUES};
use super::view::{BRIGHTEST, ViewLayers};

fn found() -> Result<Installation, NodeError> {
    oidn::find().map_err(|e| NodeError::new(e.to_string()).at("method").hint(oidn::Missing::HINT))
}

/// The library, loaded once per process.
fn library() -> Result<&'static Library, NodeError> {
    static LOADED: OnceLock<Library> = OnceLock::new();
    if let Some(library) = LOADED.get() {
        return Ok(library);
    }
    let library = found()?.load().map_err(refused)?;
    Ok(LOADED.get_or_init(|| library))
}

fn refused(error: Error) -> NodeError {
    match error {
        Error::Stopped => NodeError::cancelled(),
        reported => NodeError::new(reported.to_string()).at("method").hint("reinstall it, or use `Means`"),
    }
}

pub(super) fn sources() -> Result<Vec<SourceFile>, NodeError> {
    let path = found()?.path;
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(vec![SourceFile { name, path }])
}

pub(super) fn report(notes: &mut Notes) -> Result<(), NodeError> {
    let text = format!(
        "filtered by Open Image Denoise {}, which may give different bytes on another processor",
        library()?.version()
    );
    notes.decision("oidn", text);
    Ok(())
}

/// Memory of the library for two pictures at once, in bytes: about 0.6 kB (measured) per pixel of each picture, up
/// to a limit.
pub(super) fn bytes(pixels: usize) -> u64 {
    2 * (pixels as u64 * 640).min(oidn::MEMORY_BYTES) + pixels as u64 * 60
}

/// Averages of the receiver and of the object, in the form that `Field::average` returns. Each is computed by
/// one thread.
pub(super) fn filter(
    view: &ViewLayers<'_>,
    [receiver, object]: [&Field; 2],
    cx: &Context,
) -> Result<[Vec<[f32; VALUES]>; 2], NodeError> {
    let library = library()?;
    let pixels = receiver.pixels.len() as u64;
    let size = [receiver.width, receiver.height];
    let goes_on = || !cx.cancelled();
    let mut made = cx.for_each_tile(2, |layer| {
        cx.count("oidn_pixels", pixels);
        match layer {
            0 => lit(library, size, receiver, &goes_on),
            _ => inserted(library, size, view, object, &goes_on),
        }
    })?;
    let inserted = made.pop().unwrap_or(Err(Error::Stopped)).map_err(refused)?;
    let lit = made.pop().unwrap_or(Err(Error::Stopped)).map_err(refused)?;
    Ok([lit, inserted])
}

/// R0 unchanged, and R1 as the product of R0 and the filtered ratio.
fn lit(
    library: &Library,
    size: [usize; 2],
    field: &Field,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<[f32; VALUES]>, Error> {
    // Without a ratio, nothing is changed either.
    let ratio: Vec<f32> =
        field.pixels.iter().flat_map(|pixel| if pixel.there { pixel.signal } else { [1.0; 3] }).collect();
    let smooth = library.denoise(size, &ratio, None, goes_on)?;
    let values = |(i, smooth): (usize, &[f32; 3])| {
        let pixel = &field.pixels[i];
        let mut values = pixel.values;
        // Light that was added where there was none stays unchanged.
        for k in (0..3).filter(|k| pixel.is_noisy() && pixel.values[*k] > 0.0) {
            values[3 + k] = values[k] * smooth[k].max(0.0);
        }
        values
    };
    Ok(smooth.as_chunks::<3>().0.iter().enumerate().map(values).collect())
}

/// Filtered colour of the object, with its alpha unchanged.
fn inserted(
    library: &Library,
    size: [usize; 2],
    view: &ViewLayers<'_>,
    field: &Field,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<[f32; VALUES]>, Error> {
    let exposure = view.exposure();
    let of = |f: &dyn Fn(usize) -> [f32; 3]| -> Vec<f32> {
        let there = |i: usize| if field.pixels[i].there { f(i) } else { [0.0; 3] };
        (0..field.pixels.len()).flat_map(there).collect()
    };
    let colour = of(&|i| [0, 1, 2].map(|k| (field.pixels[i].values[k] * exposure).min(BRIGHTEST)));
    let albedo = of(&|_| [1.0; 3]);
    let normal = of(&|i| field.pixels[i].normal.to_array());
    let surfaces = Surfaces { albedo: &albedo, normal: &normal };
    let smooth = library.denoise(size, &colour, Some(surfaces), goes_on)?;
    let values = |(i, smooth): (usize, &[f32; 3])| {
        let mut values = field.pixels[i].values;
        (0..3).for_each(|k| values[k] = smooth[k].max(0.0) / exposure);
        values
    };
    Ok(smooth.as_chunks::<3>().0.iter().enumerate().map(values).collect())
}
