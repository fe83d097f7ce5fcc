//! Detection of files whose format differs from what their name suggests, and removal of bytes that other programs
//! add around text.

use crate::error::Error;

/// UTF-8 byte-order mark, which some editors put in front of a text.
pub const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Removes a byte-order mark at the start of JSON, and NUL bytes and white space at its end. Programs pad chunks
/// with such bytes.
pub fn json_text(bytes: &[u8]) -> &[u8] {
    let mut text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    while let [rest @ .., 0 | b' ' | b'\t' | b'\r' | b'\n'] = text {
        text = rest;
    }
    text
}

/// Rejects placeholders that other programs leave in place of a file, and formats that no reader supports. The
/// error suggests a remedy. Readers call this before they detect their own formats.
///
/// # Errors
/// [`Error::Unsupported`], which names the format of the file.
pub fn refuse_foreign(file: &str, bytes: &[u8]) -> Result<(), Error> {
    let starts = |magic: &[u8]| bytes.starts_with(magic);
    let what = if starts(b"version https://git-lfs.github.com/spec/")
        || starts(b"version https://hawser.github.com/")
    {
        "a Git LFS pointer, not the file itself; fetch it with `git lfs pull`"
    } else if let Some(brand) = bytes.get(4..12).and_then(|head| head.strip_prefix(b"ftyp")) {
        match brand {
            b"heic" | b"heix" | b"heim" | b"heis" | b"hevc" | b"mif1" | b"msf1" => {
                "HEIC, a format that phones use; export the picture as PNG or JPEG"
            }
            b"avif" | b"avis" => "AVIF; export the picture as PNG or JPEG",
            _ => "a video or another ISO media file; export pictures from it as PNG or JPEG",
        }
    } else if starts(b"II*\0") || starts(b"MM\0*") {
        "TIFF, or a raw picture from a camera; export it as PNG (16 bits) or OpenEXR"
    } else if starts(b"\x00\x00\x00\x0cJXL ") || starts(b"\xff\x0a") {
        "JPEG XL; export the picture as PNG or JPEG"
    } else if starts(b"\x00\x00\x00\x0cjP  ") || starts(b"\xff\x4f\xff\x51") {
        "JPEG 2000; export the picture as PNG or OpenEXR"
    } else if starts(b"<!DOCTYPE") || starts(b"<!doctype") || starts(b"<html") {
        "a web page, not the file itself; download the file again"
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
        ] {
            let error = refuse_foreign("a.bin", bytes).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.contains(says), "{error}");
        }
        for fine in [&b""[..], b"ply\n", b"\x89PNG", b"ftyp", b"{}"] {
            assert!(refuse_foreign("a.bin", fine).is_ok());
        }
    }

    #[test]
    fn marks_and_fill_around_json_are_dropped() {
        assert_eq!(json_text(b"\xef\xbb\xbf{}\0\0 \n"), b"{}");
        assert_eq!(json_text(b"{\"a\": 1}"), b"{\"a\": 1}");
        assert_eq!(json_text(b"\0\0"), b"");
    }
}
