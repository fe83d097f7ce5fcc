//! SOG (PlayCanvas, splat-transform `write-sog.ts` and `read-sog-v1.ts`): `meta.json` and lossless WebP pictures
//! with one pixel per splat, in one folder or in one ZIP archive. Version 2 has codebooks, version 1 evenly spaced
//! values between bounds; both are converted to tables of 256 entries.

use std::path::{Component, Path};

use engine::{NodeError, Notes};
use serde::Deserialize;

use super::bytes::believed;
use super::loaded::Loaded;
use super::reading::{Fetch, Reading};
use super::rows::{Row, RowFault, largest_left_out, sh_rest};
use super::zip::Archive;
use crate::error::Error;
use crate::io::foreign::{json_text, portable_path, refuse_foreign};
use crate::math::num;

#[derive(Deserialize)]
struct Means {
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Deserialize)]
struct Plain {
    files: [String; 1],
}

#[derive(Deserialize)]
struct Coded {
    codebook: Vec<f64>,
    files: [String; 1],
}

#[derive(Deserialize)]
struct CodedRest {
    count: u64,
    bands: u32,
    codebook: Vec<f64>,
    files: [String; 2],
}

#[derive(Deserialize)]
struct Meta2 {
    count: u64,
    #[serde(default)]
    antialias: bool,
    model: Option<String>,
    means: Means,
    scales: Coded,
    quats: Plain,
    sh0: Coded,
    #[serde(rename = "shN")]
    sh_n: Option<CodedRest>,
}

#[derive(Deserialize)]
struct Even<const N: usize>
where
    [f64; N]: for<'a> Deserialize<'a>,
{
    mins: [f64; N],
    maxs: [f64; N],
    files: [String; 1],
}

#[derive(Deserialize)]
struct EvenRest {
    mins: f64,
    maxs: f64,
    files: [String; 2],
}

#[derive(Deserialize)]
struct Shape {
    shape: Vec<u64>,
}

#[derive(Deserialize)]
struct Meta1 {
    means: Means,
    scales: Even<3>,
    quats: Plain,
    sh0: Even<4>,
    #[serde(rename = "shN")]
    sh_n: Option<EvenRest>,
}

type Table = [f64; 256];

/// A palette for the coefficients of degree 1 and above. Each entry is a set of all these coefficients, which a
/// splat selects by its index.
struct Palette {
    /// Number of sets in the palette; `None` if the file does not specify it.
    count: Option<u64>,
    /// Degree; `None` if it follows from the width of the picture.
    degree: Option<u32>,
    table: Table,
}

/// The content of `meta.json` of either version. Each quantity is a table indexed by a byte.
pub(super) struct Meta {
    count: u64,
    antialiased: bool,
    mins: [f64; 3],
    maxs: [f64; 3],
    /// Standard deviation along each axis.
    scales: [Table; 3],
    colours: [Table; 3],
    opacities: Table,
    palette: Option<Palette>,
    /// Names of the picture files, in this order: low bytes of the centres, high bytes of the centres, scales,
    /// quaternions, constant colours, then the palette and the labels if there is a palette.
    files: Vec<String>,
}

fn book(file: &str, codebook: &[f64]) -> Result<Table, Error> {
    let wrong = || Error::format(file, "a codebook does not hold 256 finite numbers");
    let table: Table = codebook.try_into().map_err(|_| wrong())?;
    if table.iter().all(|v| v.is_finite()) { Ok(table) } else { Err(wrong()) }
}

fn even(low: f64, high: f64) -> Table {
    std::array::from_fn(|i| low + (high - low) * (i as f64 / 255.0))
}

impl Meta {
    /// Reads `meta.json`.
    pub fn read(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        #[derive(Deserialize)]
        struct Version {
            version: Option<u32>,
        }
        let wrong = |e: serde_json::Error| Error::format(file, format!("not a SOG `meta.json`: {e}"));
        let bytes = json_text(bytes);
        let version: Version = serde_json::from_slice(bytes).map_err(wrong)?;
        let mut meta = match version.version {
            None | Some(1) => {
                #[derive(Deserialize)]
                struct Shapes {
                    means: Shape,
                }
                let shapes: Shapes = serde_json::from_slice(bytes).map_err(wrong)?;
                let count = shapes.means.shape.first().copied();
                let count = count.ok_or_else(|| Error::format(file, "`means.shape` is empty"))?;
                Self::version_1(count, serde_json::from_slice(bytes).map_err(wrong)?)
            }
            Some(2) => Self::version_2(file, serde_json::from_slice(bytes).map_err(wrong)?)?,
            Some(other) => return Err(Error::unsupported(file, format!("SOG version {other}"))),
        };
        // Exporters on Windows write backslashes.
        meta.files.iter_mut().for_each(|name| *name = portable_path(name));
        let bounds = meta.mins.iter().chain(&meta.maxs);
        if !bounds.clone().all(|v| v.is_finite()) {
            return Err(Error::format(file, "the bounds of the centres are not finite"));
        }
        // Pictures lie in the same folder: an untrusted scene must not refer to other files of this machine.
        let inside =
            |name: &str| Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
        if let Some(name) = meta.files().find(|name| !inside(name)) {
            return Err(Error::format(
                file,
                format!("the scene refers to `{name}`, which is not in the same folder"),
            ));
        }
        Ok(meta)
    }

    fn version_2(file: &str, meta: Meta2) -> Result<Self, Error> {
        if let Some(sh) = &meta.sh_n
            && !(1..=3).contains(&sh.bands)
        {
            return Err(Error::format(file, format!("`shN.bands` is {}, not 1, 2 or 3", sh.bands)));
        }
        let scales = book(file, &meta.scales.codebook)?.map(num::f64::exp);
        let palette = match &meta.sh_n {
            Some(sh) => Some(Palette {
                count: Some(sh.count),
                degree: Some(sh.bands),
                table: book(file, &sh.codebook)?,
            }),
            None => None,
        };
        let own = meta.means.files.into_iter().chain(meta.scales.files).chain(meta.quats.files);
        let files = own.chain(meta.sh0.files).chain(meta.sh_n.into_iter().flat_map(|sh| sh.files)).collect();
        Ok(Self {
            count: meta.count,
            antialiased: meta.antialias || meta.model.as_deref() == Some("antialiased"),
            mins: meta.means.mins,
            maxs: meta.means.maxs,
            scales: [scales; 3],
            colours: [book(file, &meta.sh0.codebook)?; 3],
            opacities: even(0.0, 1.0),
            palette,
            files,
        })
    }

    fn version_1(count: u64, meta: Meta1) -> Self {
        let (scales, colours) = (&meta.scales, &meta.sh0);
        let sigmoid = |logit: f64| 1.0 / (1.0 + num::f64::exp(-logit));
        let palette =
            meta.sh_n.as_ref().map(|sh| Palette { count: None, degree: None, table: even(sh.mins, sh.maxs) });
        Self {
            count,
            antialiased: false,
            mins: meta.means.mins,
            maxs: meta.means.maxs,
            scales: [0, 1, 2].map(|i| even(scales.mins[i], scales.maxs[i]).map(num::f64::exp)),
            colours: [0, 1, 2].map(|i| even(colours.mins[i], colours.maxs[i])),
            // Only here are opacities stored as logits.
            opacities: even(colours.mins[3], colours.maxs[3]).map(sigmoid),
            palette,
            files: meta
                .means
                .files
                .into_iter()
                .chain(meta.scales.files)
                .chain(meta.quats.files)
                .chain(meta.sh0.files)
                .chain(meta.sh_n.into_iter().flat_map(|sh| sh.files))
                .collect(),
        }
    }

    /// Names of the picture files.
    pub fn files(&self) -> impl Iterator<Item = &str> {
        self.files.iter().map(String::as_str)
    }
}

/// A picture of RGBA bytes.
struct Pixels {
    width: usize,
    rgba: Vec<u8>,
}

/// Maximum number of pixels per byte of a lossless picture. WebP itself has no such limit for pictures of a single
/// colour. Pictures of 64 x 64 pixels are always allowed.
const DENSEST: u64 = 4096;

impl Pixels {
    fn read(name: &str, bytes: &[u8], at_least: u64) -> Result<Self, Error> {
        refuse_foreign(name, bytes)?;
        let wrong = |what: String| Error::format(name, what);
        let mut decoder = image_webp::WebPDecoder::new(std::io::Cursor::new(bytes))
            .map_err(|e| wrong(format!("not a WebP picture: {e}")))?;
        let (width, height) = decoder.dimensions();
        let area = u64::from(width) * u64::from(height);
        if area < at_least {
            return Err(wrong(format!(
                "the picture is {width}x{height} pixels, fewer than the {at_least} pixels that `meta.json` promises"
            )));
        }
        if area > 64 * 64 + DENSEST * bytes.len() as u64 {
            return Err(wrong(format!("{width}x{height} pixels do not fit into {} bytes", bytes.len())));
        }
        if decoder.is_lossy() || decoder.is_animated() {
            return Err(wrong("the picture must be a still, lossless WebP".to_owned()));
        }
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let mut raw = vec![0_u8; width as usize * height as usize * channels];
        decoder.read_image(&mut raw).map_err(|e| wrong(format!("the WebP picture is corrupt: {e}")))?;
        let rgba = if channels == 4 {
            raw
        } else {
            raw.as_chunks::<3>().0.iter().flat_map(|[r, g, b]| [*r, *g, *b, 255]).collect()
        };
        Ok(Self { width: width as usize, rgba })
    }

    fn get(&self, index: usize) -> Option<[u8; 4]> {
        self.rgba.as_chunks::<4>().0.get(index).copied()
    }

    /// Returns the pixel at an index that is known to be valid.
    fn own(&self, index: usize) -> [u8; 4] {
        self.get(index).unwrap_or_default()
    }
}

/// Maximum size of a compressed `meta.json`; real files have about ten thousand bytes.
const META_BYTES: usize = 16 << 20;

/// Loads a ZIP archive with `meta.json` and its pictures.
pub(super) fn load_bundle(
    file: &str,
    bytes: &[u8],
    ranges: Option<&[(usize, usize)]>,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let archive = Archive::read(file, bytes)?;
    if archive.find(super::streamed::NAME).is_some() {
        let what = "an archive of a streamed SOG; unpack it, and give the path of the folder";
        return Err(Error::unsupported(file, what).into());
    }
    if file.to_ascii_lowercase().ends_with(".usdz") {
        return Err(
            Error::unsupported(file, "USDZ; unpack it, and save its contents as text, `.usda`").into()
        );
    }
    let Some(name) = archive.find("meta.json") else {
        return Err(Error::format(
            file,
            "the ZIP archive does not hold exactly one `meta.json`, so it is not SOG",
        )
        .into());
    };
    let folder = name.strip_suffix("meta.json").unwrap_or_default();
    let length = archive.length(name);
    if length > META_BYTES {
        return Err(Error::format(
            file,
            format!("the `meta.json` of the archive has {length} bytes, more than the maximum of 16 MiB"),
        )
        .into());
    }
    let meta = Meta::read(file, &archive.get(name)?)?;
    load(file, &meta, ranges, &|name| Ok(archive.get(&format!("{folder}{name}"))?), reading, notes)
}

/// Loads the pictures of a `meta.json`. Returns all rows, or only the rows in `ranges`, which must be ascending.
pub(super) fn load(
    file: &str,
    meta: &Meta,
    ranges: Option<&[(usize, usize)]>,
    fetch: &Fetch<'_>,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let needed = |index: usize| match (index, &meta.palette) {
        (5, Some(Palette { count: Some(count), degree: Some(degree), .. })) => {
            count.saturating_mul(sh_rest(*degree) as u64)
        }
        (5, _) => 1,
        _ => meta.count,
    };
    // Two steps, so that a count that the files cannot hold is refused before decoding.
    let raw = meta.files().map(fetch).collect::<Result<Vec<_>, _>>()?;
    let held = raw.iter().map(Vec::len).sum();
    let count = believed(file, meta.count, held, 64.0)?;
    let pictures =
        reading.cx.for_each_tile(raw.len(), |i| Pixels::read(&meta.files[i], &raw[i], needed(i)))?;
    let pictures = pictures.into_iter().collect::<Result<Vec<_>, _>>()?;
    drop(raw);
    let [low, high, scales, quats, sh0, rest @ ..] = &pictures[..] else {
        return Err(Error::format(file, "the file has fewer than the five pictures that SOG needs").into());
    };
    let palette = match (&meta.palette, rest) {
        (Some(palette), [centroids, labels]) => {
            // 64 sets of coefficients per row.
            let degree = [1, 2, 3].into_iter().find(|l| centroids.width == 64 * sh_rest(*l));
            let degree =
                degree.filter(|l| palette.degree.is_none_or(|reported| reported == *l)).ok_or_else(|| {
                    Error::format(
                        file,
                        format!(
                            "the palette is {} pixels wide, which matches no degree of the harmonics",
                            centroids.width
                        ),
                    )
                })?;
            Some((palette, centroids, labels, degree))
        }
        _ => None,
    };
    let turn = reading.turn(file, None, false, notes);
    let read = |index: usize, sh: &mut Vec<[f32; 3]>| {
        let (low, high) = (low.own(index), high.own(index));
        let mean = [0, 1, 2].map(|axis| {
            let whole = f64::from(u16::from(high[axis]) << 8 | u16::from(low[axis]));
            let (min, max) = (meta.mins[axis], meta.maxs[axis]);
            let coded = min + (max - min) * (whole / 65_535.0);
            (num::f64::exp(coded.abs()) - 1.0).copysign(coded)
        });
        let size = scales.own(index);
        let scale = [0, 1, 2].map(|axis| meta.scales[axis][usize::from(size[axis])]);
        let colour = sh0.own(index);
        let opacity = meta.opacities[usize::from(colour[3])];
        sh.push([0, 1, 2].map(|c| meta.colours[c][usize::from(colour[c])] as f32));
        if let Some((palette, centroids, labels, degree)) = palette {
            let label = labels.own(index);
            let label = usize::from(label[1]) << 8 | usize::from(label[0]);
            if palette.count.is_some_and(|count| label as u64 >= count) {
                return Err(RowFault::NoSuchEntry);
            }
            let each = sh_rest(degree);
            let start = label / 64 * centroids.width + label % 64 * each;
            for i in 0..each {
                let code = centroids.get(start + i).ok_or(RowFault::NoSuchEntry)?;
                sh.push([0, 1, 2].map(|c| palette.table[usize::from(code[c])] as f32));
            }
        }
        Row::checked(mean, quaternion(quats.own(index))?, scale, opacity, reading.max_extent)
    };
    let whole = [(0, count)];
    let (mut parts, mut rows) = (Vec::new(), 0);
    for &(start, end) in ranges.unwrap_or(&whole) {
        if end > count || start > end {
            let what = format!(
                "the streamed scene refers to splats {start} to {end}, which do not exist (number of splats in the file: {count})"
            );
            return Err(Error::format(file, what).into());
        }
        parts.extend(reading.rows_from(start, end - start, turn.as_ref(), |i, sh| read(start + i, sh))?);
        rows += end - start;
    }
    let degree = palette.map_or(0, |(_, _, _, degree)| degree);
    let mut loaded = Loaded::new(parts, rows, degree);
    loaded.antialiased = meta.antialiased;
    Ok(loaded)
}

/// Decodes a rotation. Red, green and blue are the three smaller components. Alpha is 252 plus the index of the
/// omitted component in the order w, x, y, z.
fn quaternion([a, b, c, tag]: [u8; 4]) -> Result<[f64; 4], RowFault> {
    let which = tag.checked_sub(252).ok_or(RowFault::NoSuchEntry)?;
    let smaller = [a, b, c].map(|v| (f64::from(v) / 255.0 - 0.5) * std::f64::consts::SQRT_2);
    Ok(largest_left_out(usize::from(which), smaller))
}
