//! SOG version 2 (PlayCanvas, splat-transform `write-sog.ts`): `meta.json` beside lossless WebP pictures,
//! one pixel a splat.

use engine::{Context, InputFile, NodeError};
use serde::Deserialize;

use super::rows::{Row, RowFault};
use super::{Loaded, read_rows};
use crate::{Error, num};

/// `meta.json`.
#[derive(Debug, Deserialize)]
pub struct Meta {
    version: u32,
    count: u64,
    #[serde(default)]
    antialias: bool,
    means: Means,
    scales: Coded,
    quats: Plain,
    sh0: Coded,
    #[serde(rename = "shN")]
    sh_n: Option<ShN>,
}

#[derive(Debug, Deserialize)]
struct Means {
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Debug, Deserialize)]
struct Coded {
    codebook: Vec<f64>,
    files: [String; 1],
}

#[derive(Debug, Deserialize)]
struct Plain {
    files: [String; 1],
}

#[derive(Debug, Deserialize)]
struct ShN {
    count: u64,
    bands: u32,
    codebook: Vec<f64>,
    files: [String; 2],
}

impl Meta {
    /// Reads `meta.json`.
    pub fn read(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        #[derive(Deserialize)]
        struct Version {
            #[serde(default)]
            version: u32,
        }
        let wrong = |e: serde_json::Error| Error::format(file, format!("no SOG `meta.json`: {e}"));
        let version: Version = serde_json::from_slice(bytes).map_err(wrong)?;
        if version.version != 2 {
            return Err(Error::unsupported(
                file,
                format!("SOG version {}; write it as version 2", version.version),
            ));
        }
        let meta: Self = serde_json::from_slice(bytes).map_err(wrong)?;
        debug_assert_eq!(meta.version, 2);
        let codebooks = [&meta.scales.codebook, &meta.sh0.codebook];
        let longer = codebooks.into_iter().chain(meta.sh_n.as_ref().map(|sh| &sh.codebook));
        for codebook in longer {
            if codebook.len() != 256 || codebook.iter().any(|value| !value.is_finite()) {
                return Err(Error::format(file, "a codebook does not hold 256 finite numbers"));
            }
        }
        if meta.sh_n.as_ref().is_some_and(|sh| !(1..=3).contains(&sh.bands)) {
            return Err(Error::format(file, "`shN.bands` is not 1, 2 or 3"));
        }
        Ok(meta)
    }

    /// The pictures beside it.
    pub fn files(&self) -> impl Iterator<Item = &str> {
        let own =
            self.means.files.iter().chain(&self.scales.files).chain(&self.quats.files).chain(&self.sh0.files);
        own.chain(self.sh_n.iter().flat_map(|sh| &sh.files)).map(String::as_str)
    }
}

/// A picture of RGBA bytes.
struct Pixels {
    width: usize,
    rgba: Vec<u8>,
}

impl Pixels {
    fn read(file: &InputFile, name: &str, at_least: u64, cx: &Context) -> Result<Self, NodeError> {
        let bytes = cx.read_beside(file, name)?;
        let wrong = |what: String| Error::format(name, what);
        let mut decoder = image_webp::WebPDecoder::new(std::io::Cursor::new(&bytes))
            .map_err(|e| wrong(format!("no WebP picture: {e}")))?;
        let (width, height) = decoder.dimensions();
        if u64::from(width) * u64::from(height) < at_least {
            let what =
                format!("{width}x{height} pixels are fewer than the {at_least} that `meta.json` promises");
            return Err(wrong(what).into());
        }
        if decoder.is_lossy() {
            return Err(wrong("lossy WebP destroys the numbers of a SOG file".to_owned()).into());
        }
        // WebP is at most 16384 pixels wide and high, so this is at most 1 GiB; the decoder stops at the
        // end of the bytes.
        let pixels = width as usize * height as usize;
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let mut raw = vec![0_u8; pixels * channels];
        decoder.read_image(&mut raw).map_err(|e| wrong(format!("broken WebP picture: {e}")))?;
        let rgba = if channels == 4 {
            raw
        } else {
            raw.as_chunks::<3>().0.iter().flat_map(|[r, g, b]| [*r, *g, *b, 255]).collect()
        };
        Ok(Self { width: width as usize, rgba })
    }

    fn get(&self, index: usize) -> [u8; 4] {
        self.rgba.as_chunks::<4>().0.get(index).copied().unwrap_or_default()
    }
}

/// Loads a version 2 file with the pictures beside it.
pub(super) fn load(
    file: &InputFile,
    meta: &[u8],
    max_extent: f64,
    cx: &Context,
) -> Result<Loaded, NodeError> {
    let meta = Meta::read(&file.0, meta)?;
    let names: Vec<&str> = meta.files().collect();
    let needed = |index: usize| match (index, &meta.sh_n) {
        (5, Some(sh)) => sh.count.saturating_mul(sh_rest(sh.bands) as u64),
        _ => meta.count,
    };
    let pictures = cx.for_each_tile(names.len(), |i| Pixels::read(file, names[i], needed(i), cx))?;
    let pictures = pictures.into_iter().collect::<Result<Vec<_>, _>>()?;
    let [low, high, scales, quats, sh0, ..] = &pictures[..] else {
        return Err(NodeError::new("a SOG file has five pictures or more"));
    };
    // Every picture holds `count` pixels, so this fits.
    let count = usize::try_from(meta.count).unwrap_or(usize::MAX);
    let bands = meta.sh_n.as_ref().map_or(0, |sh| sh.bands);
    let parts = read_rows(count, cx, |index, sh| {
        let (low, high) = (low.get(index), high.get(index));
        let mean = [0, 1, 2].map(|axis| {
            let whole = f64::from(u16::from(high[axis]) << 8 | u16::from(low[axis]));
            let (min, max) = (meta.means.mins[axis], meta.means.maxs[axis]);
            let coded = min + (max - min) * (whole / 65_535.0);
            (num::f64::exp(coded.abs()) - 1.0).copysign(coded)
        });
        let coded_scale = scales.get(index);
        let scale = [0, 1, 2].map(|axis| num::f64::exp(meta.scales.codebook[usize::from(coded_scale[axis])]));
        let colour = sh0.get(index);
        let opacity = f64::from(colour[3]) / 255.0;
        let row = Row::checked(mean, quaternion(quats.get(index))?, scale, opacity, max_extent)?;
        sh.push([0, 1, 2].map(|c| meta.sh0.codebook[usize::from(colour[c])] as f32));
        if let (Some(shn), Some(centroids), Some(labels)) = (&meta.sh_n, pictures.get(5), pictures.get(6)) {
            let label = labels.get(index);
            let label = usize::from(label[1]) << 8 | usize::from(label[0]);
            let each = sh_rest(bands);
            // 64 entries a row of the palette.
            let start = label / 64 * centroids.width + label % 64 * each;
            for i in 0..each {
                let code = centroids.get(start + i);
                sh.push([0, 1, 2].map(|c| shn.codebook[usize::from(code[c])] as f32));
            }
        }
        Ok(row)
    })?;
    Ok(Loaded { parts, count, sh_degree: bands, antialiased: meta.antialias })
}

/// Coefficients beyond the constant one, up to a degree.
fn sh_rest(bands: u32) -> usize {
    ((bands + 1) * (bands + 1) - 1) as usize
}

/// The three smaller components in 8 bits each, and in alpha, from 252, which one was left out: w, x, y, z.
fn quaternion([a, b, c, tag]: [u8; 4]) -> Result<[f64; 4], RowFault> {
    let Some(largest) = tag.checked_sub(252) else { return Err(RowFault::NotFinite) };
    let [a, b, c] = [a, b, c].map(|v| (f64::from(v) / 255.0 - 0.5) * std::f64::consts::SQRT_2);
    let d = (1.0 - (a * a + b * b + c * c)).max(0.0).sqrt();
    Ok(match largest {
        0 => [d, a, b, c],
        1 => [a, d, b, c],
        2 => [a, b, d, c],
        _ => [a, b, c, d],
    })
}
