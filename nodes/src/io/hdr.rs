//! Radiance pictures (`.hdr`): shared-exponent RGBE, flat or run-length encoded. Decoded here, since the decoder of
//! `image` ignores `EXPOSURE` and `COLORCORR` and cannot be cancelled.

use super::png::believable;
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
}

/// Reads a Radiance picture of the usual orientation, `-Y height +X width`.
pub fn read(file: &str, bytes: &[u8]) -> Result<Radiance, Error> {
    read_for(file, bytes, Progress::UNTRACKED)
}

/// The same with progress and cancellation.
pub fn read_for(file: &str, bytes: &[u8], progress: Progress<'_>) -> Result<Radiance, Error> {
    let bad = |what: &str| Error::format(file, what);
    if !bytes.starts_with(b"#?") {
        return Err(bad("not a Radiance picture: it does not start with `#?`"));
    }
    // Factor of each channel that the file was multiplied by.
    let (mut rest, mut scale) = (bytes, [1.0_f64; 3]);
    let line = |rest: &mut &[u8]| -> Result<String, Error> {
        let end = rest
            .iter()
            .take(65_536)
            .position(|&b| b == b'\n')
            .ok_or_else(|| bad("the header does not end"))?;
        let text = String::from_utf8_lossy(&rest[..end]).trim_end().to_owned();
        *rest = &rest[end + 1..];
        Ok(text)
    };
    loop {
        let text = line(&mut rest)?;
        if text.is_empty() {
            break;
        }
        if let Some(format) = text.strip_prefix("FORMAT=")
            && format != "32-bit_rle_rgbe"
        {
            return Err(Error::unsupported(file, format!("the Radiance format `{format}`")));
        }
        if let Some(value) = text.strip_prefix("EXPOSURE=") {
            let value: f64 = value.trim().parse().map_err(|_| bad("EXPOSURE is not a number"))?;
            scale = scale.map(|scale| scale * value);
        }
        if let Some(values) = text.strip_prefix("COLORCORR=") {
            let values: Option<Vec<f64>> =
                values.split_ascii_whitespace().map(|value| value.parse().ok()).collect();
            let Some([r, g, b]) = values.as_deref() else {
                return Err(bad("COLORCORR is not three numbers"));
            };
            scale.iter_mut().zip([r, g, b]).for_each(|(scale, value)| *scale *= value);
        }
    }
    if scale.iter().any(|scale| !(*scale > 0.0 && scale.is_finite())) {
        return Err(bad("EXPOSURE or COLORCORR is not above 0"));
    }
    let size = line(&mut rest)?;
    let words: Vec<&str> = size.split_ascii_whitespace().collect();
    let ["-Y", height, "+X", width] = words[..] else {
        return Err(Error::unsupported(file, format!("the orientation `{size}`; save it as `-Y .. +X ..`")));
    };
    let number = |text: &str| text.parse::<u32>().map_err(|_| bad("the size is not a number"));
    let (width, height) = (number(width)?, number(height)?);
    // A run of 127 equal samples takes 2 bytes; an old-style run of up to 255 pixels takes 4.
    believable(file, width.into(), height.into(), 3, rest.len(), 255)?;
    let (width, height) = (width as usize, height as usize);
    let mut rgb = Vec::with_capacity(width * height * 3);
    let mut scan = vec![[0_u8; 4]; width];
    for row in 0..height {
        progress.report(row as f32 / height as f32)?;
        scanline(&mut rest, &mut scan)
            .ok_or_else(|| Error::format(file, format!("row {row} of {height} is cut off or broken")))?;
        rgb.extend(scan.iter().flat_map(|texel| decode(*texel, scale)));
    }
    Ok(Radiance { width, height, rgb })
}

/// The value of a texel, as in OpenImageIO and OpenCV. (Radiance's own reader adds half a unit to each mantissa;
/// pictures rendered with the two differ by 0.3 % in dark parts.)
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
    #[allow(clippy::needless_range_loop, reason = "a channel runs across the texels of the row")]
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

/// Plain texels, or the older run-length code: a texel (1, 1, 1, n) repeats the previous one n times, and several
/// in a row are the bytes of one number.
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
    use crate::testing::row;

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

    /// `EXPOSURE` and `COLORCORR` are divided out, per channel. Mutation: `COLORCORR` not read.
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

    /// 1e-38 and 1e38 are near the limits of an exponent of 8 bits; exponent 0 is black for any mantissa.
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
