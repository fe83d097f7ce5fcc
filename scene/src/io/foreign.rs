//! Detection of files whose format differs from what their name suggests, and removal of bytes that other programs
//! add around text.

use crate::error::Error;

/// UTF-8 byte-order mark, which some editors put in front of a text.
pub const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// First bytes of a JPEG XL file without a container. Numbers of binary formats may begin with them, too.
pub const JPEG_XL: &[u8] = b"\xff\x0a";

/// Removes a byte-order mark at the start of JSON, and NUL bytes and white space at its end. Programs pad chunks
/// with such bytes.
pub fn json_text(bytes: &[u8]) -> &[u8] {
    let mut text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    while let [rest @ .., 0 | b' ' | b'\t' | b'\r' | b'\n'] = text {
        text = rest;
    }
    text
}

/// Parses JSON, without marks and fill around it.
///
/// # Errors
/// The place of the mistake. If the text has `NaN` or `Infinity`, which Python writes, the error names it.
pub fn parse_json(file: &str, bytes: &[u8]) -> Result<serde_json::Value, Error> {
    let text = json_text(bytes);
    serde_json::from_slice(text).map_err(|error| {
        let word = ["NaN", "Infinity"].into_iter().find(|word| text.windows(word.len()).any(|w| w == word.as_bytes()));
        let hint = word.map_or_else(String::new, |word| {
            format!("; `{word}`, which Python writes for such numbers, is not part of JSON: replace it by a number or `null`")
        });
        Error::format(file, format!("is not valid JSON: {error}{hint}"))
    })
}

/// Converts the backslashes in a relative path to slashes, since exporters on Windows write backslashes, and
/// removes a leading `./`.
pub fn portable_path(path: &str) -> String {
    let path = path.replace('\\', "/");
    path.strip_prefix("./").map(str::to_owned).unwrap_or(path)
}

/// Number of bytes at the start of a file that [`is_text`] examines.
const TEXT_HEAD: usize = 4096;

/// True if the start of a file looks like text in ASCII, UTF-8 or an encoding of 8 bits: there are no control
/// characters other than white space and, in less than 1024 bytes, at least three quarters of the bytes are ASCII.
/// A longer binary file has control characters.
pub fn is_text(bytes: &[u8]) -> bool {
    let head = bytes.get(..TEXT_HEAD).unwrap_or(bytes);
    let control = |byte: &&u8| byte.is_ascii_control() && !byte.is_ascii_whitespace();
    let ascii = head.iter().filter(|byte| byte.is_ascii()).count();
    !head.is_empty()
        && !head.iter().any(|byte| control(&byte))
        && (head.len() >= 1024 || ascii * 4 >= head.len() * 3)
}

/// True if a file begins with the byte-order mark of UTF-16 and ASCII characters in this encoding.
fn is_utf16(bytes: &[u8]) -> bool {
    let little = match bytes {
        [0xff, 0xfe, ..] => true,
        [0xfe, 0xff, ..] => false,
        _ => return false,
    };
    let units = bytes[2..].as_chunks::<2>().0;
    let first = units.get(..8).unwrap_or(units);
    let plain = |[a, b]: &[u8; 2]| {
        let (low, high) = if little { (a, b) } else { (b, a) };
        *high == 0 && (low.is_ascii_graphic() || low.is_ascii_whitespace())
    };
    first.len() > 1 && first.iter().all(plain)
}

/// Rejects placeholders that other programs leave in place of a file. The error suggests a remedy. Unlike
/// [`refuse_foreign`], this is suited for files that may begin with any bytes, such as buffers of numbers.
///
/// # Errors
/// [`Error::Unsupported`], which describes the content of the file.
pub fn refuse_placeholder(file: &str, bytes: &[u8]) -> Result<(), Error> {
    let text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes).trim_ascii_start();
    let starts = |magic: &[u8]| text.get(..magic.len()).is_some_and(|head| head.eq_ignore_ascii_case(magic));
    let what = if starts(b"version https://git-lfs.github.com/spec/")
        || starts(b"version https://hawser.github.com/")
    {
        "a Git LFS pointer, not the file itself; fetch it with `git lfs pull`"
    } else if starts(b"<!doctype html") || starts(b"<html") {
        "a web page, not the file itself; download the file again"
    } else {
        return Ok(());
    };
    Err(Error::unsupported(file, what))
}

/// Description of an ISO media file, from its brand and the brands with which it is compatible.
fn iso_media(brand: &[u8], compatible: &[u8]) -> &'static str {
    const AVIF: &str = "AVIF; export the picture as PNG or JPEG";
    match brand {
        b"avif" | b"avis" => AVIF,
        b"mif1" | b"msf1" if compatible.as_chunks::<4>().0.iter().any(|other| other.starts_with(b"avi")) => {
            AVIF
        }
        b"heic" | b"heix" | b"heim" | b"heis" | b"hevc" | b"hevx" | b"mif1" | b"mif2" | b"msf1" => {
            "HEIC, a format that phones use; export the picture as PNG or JPEG"
        }
        b"crx " => "CR3, a raw picture from a camera; export it as PNG (16 bits) or OpenEXR",
        b"jxl " => "JPEG XL; export the picture as PNG or JPEG",
        b"jp2 " | b"jpx " | b"jph " => "JPEG 2000; export the picture as PNG or OpenEXR",
        _ => "a video or another ISO media file; export pictures from it as PNG or JPEG",
    }
}

/// Name of the format of a picture that no reader supports, from its first bytes or the ending of its name.
pub fn other_picture(name: &str, bytes: &[u8]) -> Option<&'static str> {
    let starts: [(&[u8], &str); 7] = [
        (b"BM", "BMP"),
        (b"GIF8", "GIF"),
        (b"DDS ", "DDS"),
        (b"\x76\x2f\x31\x01", "OpenEXR"),
        (b"#?", "Radiance HDR"),
        (b"8BPS", "Photoshop"),
        (b"RIFF", "WebP"),
    ];
    let found = starts.iter().find(|(start, _)| bytes.starts_with(start)).map(|(_, format)| *format);
    // TGA has no distinctive start.
    found.or(name.to_ascii_lowercase().ends_with(".tga").then_some("TGA"))
}

/// Rejects placeholders that other programs leave in place of a file, and formats that no reader supports. The
/// error suggests a remedy. Readers call this before they detect their own formats.
///
/// # Errors
/// [`Error::Unsupported`], which names the format of the file.
pub fn refuse_foreign(file: &str, bytes: &[u8]) -> Result<(), Error> {
    refuse_placeholder(file, bytes)?;
    let starts = |magic: &[u8]| bytes.starts_with(magic);
    let what = if is_utf16(bytes) {
        "text in UTF-16; save it as UTF-8"
    } else if let Some(brand) = bytes.get(4..12).and_then(|head| head.strip_prefix(b"ftyp")) {
        // The box holds its length, its type, the brand, a version and the other brands.
        let length = bytes.first_chunk().map_or(0, |length| u32::from_be_bytes(*length) as usize);
        iso_media(brand, bytes.get(16..length.min(bytes.len())).unwrap_or_default())
    } else if ["II*\0", "MM\0*", "II+\0", "MM\0+"].iter().any(|magic| starts(magic.as_bytes())) {
        "TIFF, or a raw picture from a camera; export it as PNG (16 bits) or OpenEXR"
    } else if starts(b"SDPX") || starts(b"XPDS") || starts(b"\x80\x2a\x5f\xd7") {
        "DPX or Cineon; convert it with `oiiotool plate.dpx -o plate.exr`, and set `encoding` if its codes are logarithmic"
    } else if ["IIU\0", "IIRO", "IIRS", "MMOR", "FOVb", "FUJIFILMCCD-RAW"]
        .iter()
        .any(|magic| starts(magic.as_bytes()))
    {
        "a raw picture from a camera; export it as PNG (16 bits) or OpenEXR"
    } else if starts(b"\xef\xbb\xbf#?") {
        "a Radiance picture after a byte-order mark; remove the first three bytes of the file"
    } else if starts(b"\x00\x00\x00\x0cJXL ") || starts(JPEG_XL) {
        "JPEG XL; export the picture as PNG or JPEG"
    } else if starts(b"\x00\x00\x00\x0cjP  ") || starts(b"\xff\x4f\xff\x51") {
        "JPEG 2000; export the picture as PNG or OpenEXR"
    } else {
        return Ok(());
    };
    Err(Error::unsupported(file, what))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stays_refused_is_named_with_what_to_do() {
        for (bytes, says) in [
            (&b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n"[..], "git lfs pull"),
            (b"\0\0\0\x18ftypheic\0\0\0\0", "HEIC"),
            (b"\0\0\0\x18ftypavif\0\0\0\0", "AVIF"),
            (b"\0\0\0\x18ftypisom\0\0\0\0", "video"),
            (b"II*\0\x08\0\0\0", "TIFF"),
            (b"\xff\x0aabc", "JPEG XL"),
            (b"<!DOCTYPE html><html>", "web page"),
            (b"\xef\xbb\xbf\n <!DocType HTML>", "web page"),
            (b"\xef\xbb\xbfversion https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
            (b"\r\nversion https://hawser.github.com/spec/v1\n", "git lfs pull"),
            (b"\xff\xfe{\0\"\0a\0\"\0", "save it as UTF-8"),
            (b"\xfe\xff\0#\0 \0C\0a\0m\0e\0r\0a\0s\0!", "save it as UTF-8"),
            (b"\0\0\0\x18ftypcrx \0\0\0\x01crx isom", "CR3, a raw picture"),
            (b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic", "HEIC"),
            (b"\0\0\0\x18ftypmif1\0\0\0\0mif1avif", "AVIF"),
            (b"II+\0\x08\0\0\0", "TIFF"),
            (b"SDPX\0\0\x08\0V1.0", "oiiotool plate.dpx"),
            (b"XPDS\0\x08\0\0V1.0", "set `encoding`"),
            (b"\x80\x2a\x5f\xd7\0\0\x08\0", "DPX or Cineon"),
            (b"FUJIFILMCCD-RAW 0201", "raw picture"),
            (b"\xef\xbb\xbf#?RADIANCE\n", "remove the first three bytes"),
        ] {
            let error = refuse_foreign("a.bin", bytes).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.contains(says), "{error}");
        }
        for fine in
            [&b""[..], b"ply\n", b"\x89PNG", b"ftyp", b"{}", b"\xff\xfe", b"\xff\xfea\0\0\0", b"<?xml"]
        {
            assert!(refuse_foreign("a.bin", fine).is_ok());
        }
        // Numbers of binary files.
        for fine in [&b"\xff\x0a\0\0\0\0\0\0"[..], b"\xff\xfe\0\0\0\0\0\0"] {
            assert!(refuse_placeholder("a.bin", fine).is_ok());
        }
    }

    #[test]
    fn text_is_distinguished_from_binary_data() {
        let cyrillic = "облако точек ".repeat(60);
        for text in [&b"x,y,z\n0.5,0.25,1\r\n"[..], b"# cl\xe9ment\n1 2 3\n", cyrillic.as_bytes()] {
            assert!(is_text(text), "{text:?}");
        }
        // Only the first bytes count.
        assert!(is_text(&[&b"1 2 3\n".repeat(1000)[..], &[0; 32]].concat()));
        let noise: Vec<u8> = (0..64_u32).map(|i| 128 + (i * 37 % 128) as u8).collect();
        for binary in [&b""[..], &[0; 32], b"1 2 3\n\0", b"a\x7fb", &noise] {
            assert!(!is_text(binary), "{binary:?}");
        }
    }

    #[test]
    fn paths_of_windows_are_converted() {
        for (path, wanted) in [
            (".\\images\\a.png", "images/a.png"),
            ("./a.png", "a.png"),
            ("..\\a.png", "../a.png"),
            ("0_0/meta.json", "0_0/meta.json"),
        ] {
            assert_eq!(portable_path(path), wanted);
        }
    }

    #[test]
    fn marks_and_fill_around_json_are_dropped() {
        assert_eq!(json_text(b"\xef\xbb\xbf{}\0\0 \n"), b"{}");
        assert_eq!(json_text(b"{\"a\": 1}"), b"{\"a\": 1}");
        assert_eq!(json_text(b"\0\0"), b"");
    }
}
