//! Base64 (RFC 4648, section 4).

/// Whether a text ends with a whole byte: one digit alone is none.
pub(crate) fn is_whole(text: &str) -> bool {
    text.trim_end_matches('=').len() % 4 != 1
}

/// The bytes of a text; `None` where it has other signs. What is left over at its end is passed over.
pub(crate) fn decode(text: &str) -> Option<Vec<u8>> {
    let text = text.trim_end_matches('=');
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 2);
    let (mut bits, mut held) = (0_u32, 0);
    for c in text.bytes() {
        let six = match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(six);
        held += 6;
        if held >= 8 {
            held -= 8;
            out.push((bits >> held) as u8);
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::{decode, is_whole};

    #[test]
    fn base64_of_the_standard() {
        for (text, bytes) in [
            ("", ""),
            ("Zg==", "f"),
            ("Zm8=", "fo"),
            ("Zm9v", "foo"),
            ("Zm9vYmFy", "foobar"),
            ("bGlnaHRz", "lights"),
        ] {
            assert_eq!(decode(text).as_deref(), Some(bytes.as_bytes()));
        }
        for broken in ["Z*==", "bGlna*"] {
            assert_eq!(decode(broken), None, "{broken}");
        }
        assert!(is_whole("bGlnaA==") && is_whole("bGlnaHQ=") && !is_whole("bGlnaHQab"));
    }
}
