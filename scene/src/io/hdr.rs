//! Radiance pictures (`.hdr`): shared-exponent RGBE, flat or run-length encoded. The decoder of the crate `image`
//! is not used, since it ignores `EXPOSURE` and `COLORCORR` and cannot be cancelled.

use super::believable::believable;
use super::progress::Progress;
use crate::error::Error;

/// Linear RGB of a Radiance file, with `EXPOSURE` and `COLORCORR` already divided out, row 0 at the top.
pub struct Radiance {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Three samples per pixel, finite and at least 0.
    pub rgb: Vec<f32>,
    /// The chromaticities: x and y of red, green, blue and white; `None` if the file has none.
    pub primaries: Option<[[f32; 2]; 4]>,
    /// Height of a pixel divided by its width (`PIXASPECT`).
    pub pixel_aspect: f64,
    /// Lines of the header that are unknown and ignored.
    pub ignored: Vec<String>,
}

/// An axis in the header line that specifies size and orientation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Side {
    /// True for x, false for y.
    pub across: bool,
    /// True if the coordinate grows to the right or upwards.
    pub forward: bool,
    /// Number of pixels along the axis.
    pub count: u32,
}

/// The axes of a line such as `-Y 512 +X 1024`: first the axis across the scanlines, then the axis along them.
/// `None` unless one is x and the other is y.
pub fn sides(line: &str) -> Option<[Side; 2]> {
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    let [first, rows, second, columns] = words[..] else { return None };
    let side = |axis: &str, count: &str| {
        let (sign, name) = axis.split_at_checked(1)?;
        let forward = match sign {
            "+" => true,
            "-" => false,
            _ => return None,
        };
        let across = match name {
            "X" => true,
            "Y" => false,
            _ => return None,
        };
        Some(Side { across, forward, count: count.parse().ok()? })
    };
    let [a, b] = [side(first, rows)?, side(second, columns)?];
    (a.across != b.across).then_some([a, b])
}

/// Largest factor that `EXPOSURE` and `COLORCORR` may amount to, and the inverse of the smallest: 40 stops. Light
/// divided by a factor outside this range would exceed what single precision holds, or vanish.
const LARGEST_SCALE: f64 = 1e12;

/// Variables of the header that are read.
const VARIABLES: [&str; 4] = ["FORMAT", "EXPOSURE", "COLORCORR", "PRIMARIES"];

/// Name and value of a line `NAME=value` of the header, without white space around them. For other lines, the name
/// is the whole line.
fn variable(line: &str) -> (&str, &str) {
    line.split_once('=').map_or((line, ""), |(name, value)| (name.trim(), value.trim()))
}

/// Reads a Radiance picture of any orientation.
pub fn read(file: &str, bytes: &[u8]) -> Result<Radiance, Error> {
    read_for(file, bytes, Progress::UNTRACKED)
}

/// Like [`read`], with progress and cancellation.
pub fn read_for(file: &str, bytes: &[u8], progress: Progress<'_>) -> Result<Radiance, Error> {
    let bad = |what: &str| Error::format(file, what);
    if !bytes.starts_with(b"#?") {
        return Err(bad("not a Radiance picture: it does not start with `#?`"));
    }
    // Factor of each channel that the file was multiplied by.
    let (mut rest, mut scale) = (bytes, [1.0_f64; 3]);
    let (mut primaries, mut ignored, mut pixel_aspect) = (None, Vec::new(), 1.0_f64);
    let line = |rest: &mut &[u8]| -> Result<String, Error> {
        let end = rest
            .iter()
            .take(65_536)
            .position(|&b| b == b'\n')
            .ok_or_else(|| bad("the file ends within a line of the header"))?;
        let text = String::from_utf8_lossy(&rest[..end]).trim_end().to_owned();
        *rest = &rest[end + 1..];
        Ok(text)
    };
    loop {
        let text = line(&mut rest)?;
        if text.is_empty() {
            break;
        }
        let (key, value) = variable(&text);
        if !VARIABLES.contains(&key) && VARIABLES.iter().any(|known| known.eq_ignore_ascii_case(key)) {
            // Radiance reads only names in capital letters.
            ignored.push(text.clone());
        }
        if key == "FORMAT" && value != "32-bit_rle_rgbe" {
            let remedy = if value == "32-bit_rle_xyze" {
                ", which stores CIE XYZ; `ra_xyze -r IN OUT` of Radiance writes RGB"
            } else {
                ""
            };
            return Err(Error::unsupported(file, format!("the Radiance format `{value}`{remedy}")));
        }
        // Radiance defines no gamma: its pictures are linear, and other programs leave the value out too.
        if key.eq_ignore_ascii_case("GAMMA") && value.parse::<f64>() != Ok(1.0) {
            ignored.push(text.clone());
        }
        if key == "EXPOSURE" {
            let value: f64 = match value {
                "" => 0.0,
                value => value.parse().map_err(|_| bad("`EXPOSURE` is not a number"))?,
            };
            if value == 0.0 {
                // As FreeImage writes for an exposure that it does not know; other programs leave the value out.
                ignored.push(text.clone());
            } else {
                scale = scale.map(|scale| scale * value);
            }
        }
        if key == "PIXASPECT" {
            // Several lines multiply.
            match value.parse::<f64>() {
                Ok(value) => pixel_aspect *= value,
                Err(_) => ignored.push(text.clone()),
            }
        }
        if key == "PRIMARIES" {
            let values: Option<Vec<f32>> =
                value.split_ascii_whitespace().map(|value| value.parse().ok()).collect();
            let Some([rx, ry, gx, gy, bx, by, wx, wy]) = values.as_deref() else {
                return Err(bad("`PRIMARIES` must consist of eight numbers"));
            };
            primaries = Some([[*rx, *ry], [*gx, *gy], [*bx, *by], [*wx, *wy]]);
        }
        if key == "COLORCORR" {
            let values: Option<Vec<f64>> =
                value.split_ascii_whitespace().map(|value| value.parse().ok()).collect();
            let Some([r, g, b]) = values.as_deref() else {
                return Err(bad("`COLORCORR` must consist of three numbers"));
            };
            scale.iter_mut().zip([r, g, b]).for_each(|(scale, value)| *scale *= value);
        }
    }
    if let Some(scale) = scale.iter().find(|scale| !(1.0 / LARGEST_SCALE..=LARGEST_SCALE).contains(*scale)) {
        let what = format!(
            "`EXPOSURE` and `COLORCORR` multiply to {scale:e}, which is not between {:e} and {LARGEST_SCALE:e}",
            1.0 / LARGEST_SCALE
        );
        return Err(Error::format(file, what));
    }
    let size = line(&mut rest)?;
    let [outer, inner] = sides(&size).ok_or_else(|| {
        Error::format(
            file,
            format!("the line with the size, `{size}`, is not of the form `-Y HEIGHT +X WIDTH`"),
        )
    })?;
    // A run of 127 equal samples takes 2 bytes; an old-style run of up to 255 pixels takes 4.
    believable(file, inner.count.into(), outer.count.into(), 3, rest.len(), 255)?;
    let (rows, columns) = (outer.count as usize, inner.count as usize);
    let (width, height) = if outer.across { (rows, columns) } else { (columns, rows) };
    let usual = !outer.across && !outer.forward && inner.forward;
    let mut rgb = if usual { Vec::with_capacity(width * height * 3) } else { vec![0.0; width * height * 3] };
    let mut scan = vec![[0_u8; 4]; columns];
    for row in 0..rows {
        progress.report(row as f32 / rows as f32)?;
        scanline(&mut rest, &mut scan)
            .ok_or_else(|| Error::format(file, format!("row {row} of {rows} is truncated or corrupt")))?;
        if usual {
            rgb.extend(scan.iter().flat_map(|texel| decode(*texel, scale)));
            continue;
        }
        for (column, texel) in scan.iter().enumerate() {
            // x runs right; y runs up in the file, and down here.
            let along = |side: Side, at: usize| {
                let count = side.count as usize;
                if side.forward == side.across { at } else { count - 1 - at }
            };
            let [a, b] = [along(outer, row), along(inner, column)];
            let (x, y) = if outer.across { (a, b) } else { (b, a) };
            if let Some(pixel) = rgb.as_chunks_mut::<3>().0.get_mut(y * width + x) {
                *pixel = decode(*texel, scale);
            }
        }
    }
    Ok(Radiance { width, height, rgb, primaries, pixel_aspect, ignored })
}

/// The value of a texel, computed as in OpenImageIO and OpenCV. (Radiance's own reader adds half a unit to each
/// mantissa; pictures decoded in the two ways differ by 0.3 % in dark parts.)
fn decode([r, g, b, e]: [u8; 4], scale: [f64; 3]) -> [f32; 3] {
    if e == 0 {
        return [0.0; 3];
    }
    // Exact: a power of two with an exponent in -135..=119.
    let unit = f64::from_bits(((i64::from(e) - 136 + 1023) as u64) << 52);
    let light = |m: u8, scale: f64| (f64::from(m) * (unit / scale)).min(f64::from(f32::MAX)) as f32;
    [light(r, scale[0]), light(g, scale[1]), light(b, scale[2])]
}

fn scanline(rest: &mut &[u8], scan: &mut [[u8; 4]]) -> Option<()> {
    let width = scan.len();
    let (head, tail) = rest.split_first_chunk::<4>()?;
    if !(8..32_768).contains(&width) || head[0] != 2 || head[1] != 2 || head[2] & 0x80 != 0 {
        return flat_scanline(rest, scan);
    }
    if (usize::from(head[2]) << 8 | usize::from(head[3])) != width {
        return None;
    }
    *rest = tail;
    #[allow(clippy::needless_range_loop, reason = "`channel` indexes every texel of the row")]
    for channel in 0..4 {
        let mut x = 0;
        while x < width {
            let (&count, tail) = rest.split_first()?;
            let run = count > 128;
            let length = usize::from(if run { count - 128 } else { count });
            if length == 0 || x + length > width {
                return None;
            }
            let (values, tail) = tail.split_at_checked(if run { 1 } else { length })?;
            for i in 0..length {
                scan[x + i][channel] = values[if run { 0 } else { i }];
            }
            *rest = tail;
            x += length;
        }
    }
    Some(())
}

/// Reads a scanline of plain texels, or of the older run-length code, in which a texel (1, 1, 1, n) repeats the
/// previous texel n times. If several such texels follow each other, their n are the bytes of one number, least
/// significant byte first.
fn flat_scanline(rest: &mut &[u8], scan: &mut [[u8; 4]]) -> Option<()> {
    let (mut x, mut shift) = (0, 0);
    while x < scan.len() {
        let (texel, tail) = rest.split_first_chunk::<4>()?;
        *rest = tail;
        if let [1, 1, 1, count] = *texel {
            let length = usize::from(count) << shift;
            let last = *scan.get(x.checked_sub(1)?)?;
            scan.get_mut(x..x.checked_add(length)?)?.fill(last);
            x += length;
            shift += 8;
            if shift > 24 {
                return None;
            }
        } else {
            scan[x] = *texel;
            x += 1;
            shift = 0;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::num;
    use testing::row;

    fn file(header: &str, body: &[u8]) -> Vec<u8> {
        let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{header}").into_bytes();
        bytes.extend(body);
        bytes
    }
    fn runs() -> Vec<u8> {
        // Red: a run of 8; green: 8 given; blue: 4 and a run of 4; exponent: a run.
        let mut body =
            vec![2, 2, 0, 8, 136, 200, 8, 1, 2, 3, 4, 5, 6, 7, 8, 4, 9, 9, 9, 9, 132, 30, 136, 129];
        body.extend([2, 2, 0, 8, 136, 1, 136, 2, 136, 3, 136, 0]);
        file("\n-Y 2 +X 8\n", &body)
    }

    #[test]
    fn runs_and_flat_texels_decode() {
        let picture = read("a.hdr", &runs()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((picture.width, picture.height), (8, 2));
        // 129 - 136 = -7: 200 / 128.
        assert_eq!(picture.rgb[..3], [200.0 / 128.0, 1.0 / 128.0, 9.0 / 128.0]);
        assert_eq!(picture.rgb[21..24], [200.0 / 128.0, 8.0 / 128.0, 30.0 / 128.0]);
        assert!(picture.rgb[24..].iter().all(|v| *v == 0.0), "exponent 0 is black");
        let flat = file("EXPOSURE=2\n\n-Y 1 +X 4\n", &[10, 20, 30, 136, 1, 1, 1, 2, 5, 5, 5, 136]);
        let picture = read("a.hdr", &flat).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(picture.rgb[..3], [5.0, 10.0, 15.0]);
        assert_eq!(picture.rgb[6..9], picture.rgb[..3], "an old run");
        assert_eq!(picture.rgb[9], 2.5);
    }

    /// `EXPOSURE` and `COLORCORR` are divided out, per channel. This test fails if `COLORCORR` is not read.
    #[test]
    fn exposure_and_colour_correction_are_divided_out() {
        let texel = |head: &str| read("a.hdr", &file(&format!("{head}\n-Y 1 +X 1\n"), &[10, 20, 30, 136]));
        let head = "EXPOSURE=2\nCOLORCORR= 0.5 1 2\nCOLORCORR=1 1 4\n";
        assert_eq!(texel(head).map(|p| p.rgb).unwrap_or_default(), [10.0, 10.0, 1.875]);
        for wrong in ["COLORCORR=1 1\n", "COLORCORR=1 a 1\n", "COLORCORR=1 0 1\n", "COLORCORR=1 nan 1\n"] {
            let why = texel(wrong).map(|_| ()).expect_err("is wrong").to_string();
            assert!(why.contains("COLORCORR"), "{why}");
        }
    }

    /// Values near the limits of an 8-bit exponent, 1e-38 and 1e38, are decoded; exponent 0 is black for any
    /// mantissa.
    #[test]
    fn rgbe_at_the_ends() {
        let body = [200, 100, 50, 0, 174, 174, 174, 2, 151, 0, 0, 255, 128, 128, 128, 129];
        let picture = read("a.hdr", &file("\n-Y 1 +X 4\n", &body)).unwrap_or_else(|e| panic!("{e}"));
        let off = |at: usize, want: f64| (f64::from(picture.rgb[at]) / want - 1.0).abs();
        assert_eq!(picture.rgb[..3], [0.0; 3]);
        let power = |n: i32| num::pow(2.0, f64::from(n));
        row(64, "relative error of RGBE at 2e-39", off(3, 174.0 * power(2 - 136)), 1e-5);
        row(64, "relative error of RGBE at 1e38", off(6, 151.0 * power(255 - 136)), 1e-7);
        row(64, "relative error of RGBE at 1", off(9, 1.0), 0.0);
    }

    /// A picture of 3 x 2 pixels, stored in each of the eight orientations, is always decoded to the same pixels.
    /// This test fails if `side.forward == side.across` is replaced with `side.forward`.
    #[test]
    fn every_orientation_is_the_same_picture() {
        // Rows from the top, values 1 to 6.
        let value = |x: usize, y: usize| (1 + x + 3 * y) as u8;
        for (line, xs, ys, across) in [
            ("-Y 2 +X 3", [0, 1, 2], [0, 1], false),
            ("-Y 2 -X 3", [2, 1, 0], [0, 1], false),
            ("+Y 2 +X 3", [0, 1, 2], [1, 0], false),
            ("+Y 2 -X 3", [2, 1, 0], [1, 0], false),
            ("+X 3 -Y 2", [0, 1, 2], [0, 1], true),
            ("-X 3 -Y 2", [2, 1, 0], [0, 1], true),
            ("+X 3 +Y 2", [0, 1, 2], [1, 0], true),
            ("-X 3 +Y 2", [2, 1, 0], [1, 0], true),
        ] {
            let texel = |x: usize, y: usize| [value(x, y), 0, 0, 136];
            let body: Vec<u8> = if across {
                xs.iter()
                    .flat_map(|&x| ys.iter().map(move |&y| (x, y)))
                    .flat_map(|(x, y)| texel(x, y))
                    .collect()
            } else {
                ys.iter()
                    .flat_map(|&y| xs.iter().map(move |&x| (x, y)))
                    .flat_map(|(x, y)| texel(x, y))
                    .collect()
            };
            let bytes = file(&format!("\n{line}\n"), &body);
            let picture = read("a.hdr", &bytes).unwrap_or_else(|e| panic!("{line}: {e}"));
            assert_eq!((picture.width, picture.height), (3, 2), "{line}");
            let red: Vec<f32> = picture.rgb.iter().step_by(3).copied().collect();
            assert_eq!(red, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "{line}");
            let head = crate::io::head::Head::read(&mut std::io::Cursor::new(&bytes));
            assert_eq!(head.map(|head| head.size), Some([3, 2]), "{line}");
        }
        for line in ["-Y 2 +Y 3", "-Z 2 +X 3", "2 3", "-Y 2", "-Y -2 +X 3", "Y 2 X 3"] {
            let error = read("a.hdr", &file(&format!("\n{line}\n"), &[9; 64])).err().map(|e| e.to_string());
            assert!(error.is_some_and(|e| e.contains("is not of the form")), "{line}");
        }
    }

    /// An exposure of 0 is ignored. Primaries that differ from those of sRGB are returned with the picture.
    #[test]
    fn exposures_of_0_count_as_none_and_primaries_are_read() {
        let of = |head: &str| read("a.hdr", &file(&format!("{head}\n-Y 1 +X 1\n"), &[10, 20, 30, 136]));
        for head in [
            "EXPOSURE=0\n",
            "EXPOSURE=\n",
            "EXPOSURE=          0.0000000000000\n",
            "EXPOSURE=-0\n",
            "EXPOSURE=0\nEXPOSURE=1\n",
        ] {
            let picture = of(head).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!((&picture.rgb[..], picture.ignored.len()), (&[10.0, 20.0, 30.0][..], 1));
        }
        assert!(of("EXPOSURE=-1\n").is_err() && of("EXPOSURE=nan\n").is_err());
        // White space around the name. An earlier version ignored such lines silently.
        for spaced in ["EXPOSURE\t=\t2\n", " EXPOSURE = 2\n", "EXPOSURE=2 \n"] {
            let picture = of(spaced).unwrap_or_else(|e| panic!("{spaced}: {e}"));
            assert_eq!((&picture.rgb[..], picture.ignored.len()), (&[5.0, 10.0, 15.0][..], 0), "{spaced}");
        }
        let picture = of("Exposure=2\n").unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((picture.rgb[0], picture.ignored), (10.0, vec!["Exposure=2".to_owned()]));
        // An exposure near 0 would make the light infinite, and a huge one would make it vanish.
        for beyond in ["EXPOSURE=1e-40\n", "EXPOSURE=1e40\n", "EXPOSURE=1e-7\nCOLORCORR=1 1e-7 1\n"] {
            let error = of(beyond).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.contains("which is not between 1e-12 and 1e12"), "{beyond}: {error}");
        }
        assert_eq!(of("EXPOSURE=1e-6\n").map(|p| p.rgb).unwrap_or_default(), [1e7, 2e7, 3e7]);
        // Radiance defines no gamma.
        for (head, ignored) in [("GAMMA=1.0\n", 0), ("GAMMA=2.2\n", 1), ("Gamma=2.2\n", 1)] {
            let picture = of(head).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!((picture.rgb[0], picture.ignored.len()), (10.0, ignored), "{head}");
        }
        let xyz = String::from_utf8_lossy(&runs()).replace("rgbe", "xyze");
        let refused = read("a.hdr", xyz.as_bytes()).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(refused.contains("ra_xyze -r"), "{refused}");
        let wide = "PRIMARIES= 0.708 0.292 0.170 0.797 0.131 0.046 0.3127 0.3290\n";
        assert_eq!(of(wide).ok().and_then(|p| p.primaries).map(|p| p[1]), Some([0.17, 0.797]));
        assert!(of("PRIMARIES=0.6 0.3\n").is_err());
    }

    #[test]
    fn no_cut_or_flip_panics_and_every_cut_is_an_error() {
        let bytes = runs();
        for end in 0..bytes.len() {
            assert!(read("a.hdr", &bytes[..end]).is_err(), "cut at {end}");
        }
        for at in 0..bytes.len() * 8 {
            let mut hurt = bytes.clone();
            hurt[at / 8] ^= 1 << (at % 8);
            drop(read("a.hdr", &hurt));
        }
        assert!(read("a.hdr", &file("\n-Y 1000000 +X 1000000\n", &[0; 64])).is_err());
    }
}
