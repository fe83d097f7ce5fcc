//! Reads the recipe in a written picture from PNG text, EXR comments or JPEG comments.

use std::io::Cursor;

/// Keyword of the text in a PNG.
pub const KEYWORD: &str = "lightharmony:recipe";

/// True if the bytes begin like a picture that can contain a recipe.
pub fn is_picture(bytes: &[u8]) -> bool {
    [&b"\x89PNG"[..], &b"\xff\xd8\xff"[..], &b"v/1\x01"[..]].iter().any(|magic| bytes.starts_with(magic))
}

/// Maximum size in bytes of a recipe in a PNG. Text in a PNG may be compressed, and 1 MB could expand to 1 GB.
const LONGEST: usize = 16 << 20;

/// The recipe in a picture; `None` if the picture has no recipe, if the recipe is too long, or if the file is
/// damaged before the recipe.
pub fn recipe(bytes: &[u8]) -> Option<String> {
    match bytes {
        [0x89, b'P', ..] => in_png(bytes),
        [0xff, 0xd8, ..] => in_jpeg(bytes),
        [b'v', b'/', ..] => in_exr(bytes),
        _ => None,
    }
}

fn in_png(bytes: &[u8]) -> Option<String> {
    let limits = png::Limits { bytes: bytes.len().saturating_mul(8) };
    let reader = png::Decoder::new_with_limits(Cursor::new(bytes), limits).read_info().ok()?;
    let mut text = reader.info().utf8_text.iter().find(|text| text.keyword == KEYWORD)?.clone();
    text.decompress_text_with_limit(LONGEST).ok()?;
    text.get_text().ok().filter(|text| text.len() <= LONGEST)
}

fn in_exr(bytes: &[u8]) -> Option<String> {
    let meta = exr::prelude::MetaData::read_from_buffered(Cursor::new(bytes), false).ok()?;
    let comments = meta.headers.first()?.own_attributes.comments.as_ref()?;
    // Earlier versions wrote Latin-1.
    Some(String::from_utf8(comments.as_slice().to_vec()).unwrap_or_else(|_| comments.to_string()))
}

/// The recipe in the comments of a JPEG. A recipe that is longer than a segment continues in the next one.
fn in_jpeg(bytes: &[u8]) -> Option<String> {
    let mut rest = bytes.get(2..)?;
    let mut comment = Vec::new();
    while let [0xff, marker, high, low, tail @ ..] = rest {
        let length = usize::from(u16::from_be_bytes([*high, *low])).checked_sub(2)?;
        let (segment, after) = tail.split_at_checked(length)?;
        match marker {
            0xfe => comment.extend_from_slice(segment),
            // The picture itself begins.
            0xda => break,
            _ => {}
        }
        rest = after;
    }
    String::from_utf8(comment).ok().filter(|text| !text.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{exr, jpeg, png};

    #[test]
    fn a_packed_text_is_not_believed() {
        let raster = png::Raster {
            width: 1,
            height: 1,
            channels: 3,
            largest: 255,
            codes: vec![7; 3],
            ignored: vec![],
            colour: None,
        };
        let packed = |length: usize| {
            let mut bytes = Vec::new();
            let mut encoder = ::png::Encoder::new(&mut bytes, 1, 1);
            encoder.set_color(::png::ColorType::Rgb);
            let mut writer = encoder.write_header().expect("a head");
            let mut text = ::png::text_metadata::ITXtChunk::new(KEYWORD, "a".repeat(length));
            text.compressed = true;
            writer.write_text_chunk(&text).expect("a text");
            writer.write_image_data(&[7; 3]).expect("a pixel");
            drop(writer);
            bytes
        };
        assert_eq!(recipe(&packed(1000)).map(|text| text.len()), Some(1000));
        let bomb = packed(LONGEST + 1);
        assert!(bomb.len() < LONGEST / 100);
        assert_eq!(recipe(&bomb), None);
        assert_eq!(
            recipe(&png::write(&raster, true, &[(KEYWORD, &"a".repeat(LONGEST + 1))]).unwrap_or_default()),
            None
        );
    }

    #[test]
    fn what_was_written_is_read_from_every_format() {
        let text = "// lightharmony recipe 2: é 椅\n".repeat(4000);
        let raster = png::Raster {
            width: 3,
            height: 2,
            channels: 3,
            largest: 255,
            codes: vec![7; 18],
            ignored: Vec::new(),
            colour: None,
        };
        let channel = exr::Channel { name: "Y".to_owned(), samples: vec![0.5; 6] };
        let files = [
            png::write(&raster, true, &[("Software", "x"), (KEYWORD, &text)]).unwrap_or_default(),
            jpeg::write(&raster, 90, Some(&text)).unwrap_or_default(),
            exr::write(3, 2, vec![(channel, exr::Depth::Float)], "Y=data", Some(&text)).unwrap_or_default().0,
        ];
        for file in &files {
            assert!(is_picture(file));
            let found = recipe(file);
            assert!(
                found.as_deref() == Some(&*text) || found.is_some_and(|f| f.starts_with("// lightharmony"))
            );
            for end in 0..file.len().min(3000) {
                drop(recipe(&file[..end]));
            }
            for at in 0..file.len().min(3000) {
                let mut hurt = file.clone();
                hurt[at] ^= 1 << (at % 8);
                drop(recipe(&hurt));
            }
        }
        assert_eq!(recipe(&files[2]).as_deref(), Some(&*text), "OpenEXR has all characters");
        assert_eq!(recipe(&png::write(&raster, true, &[]).unwrap_or_default()), None);
        assert!(!is_picture(b"Graph("));
    }
}
