//! Byte counts as text, with IEC units (powers of 1024).

/// Parses a number of bytes with or without a unit: `K`, `KB` and `KiB` all mean 1024, likewise for M, G and T.
/// `None` if the text is not such a number.
pub fn parse_bytes(text: &str) -> Option<u64> {
    let digits = text.trim_end_matches(|c: char| c.is_alphabetic());
    let unit = match text[digits.len()..].to_uppercase().trim_end_matches('B').trim_end_matches('I') {
        "" => 0,
        "K" => 10,
        "M" => 20,
        "G" => 30,
        "T" => 40,
        _ => return None,
    };
    let number: f64 = digits.parse().ok()?;
    (0.0..1e9).contains(&number).then(|| (number * (1_u64 << unit) as f64) as u64)
}

/// Formats a number of bytes with its unit: `512 B`, `9.6 KiB`, `273.5 MiB`, `4.0 GiB`.
pub fn bytes_text(bytes: u64) -> String {
    let of = |unit: u32| bytes as f64 / (1_u64 << unit) as f64;
    match bytes {
        0x4000_0000.. => format!("{:.1} GiB", of(30)),
        0x10_0000.. => format!("{:.1} MiB", of(20)),
        0x400.. => format!("{:.1} KiB", of(10)),
        _ => format!("{bytes} B"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_printed_is_read_back_to_its_last_digit() {
        for bytes in [0, 1, 1023, 1024, 9_999, 1 << 20, (1 << 30) - 1, 1 << 30, 250_000_000_000] {
            let text = bytes_text(bytes).replace(' ', "");
            let back = parse_bytes(&text).expect("it is a size");
            assert!(back.abs_diff(bytes) <= bytes / 20, "{bytes} is {text}, which is {back}");
        }
        assert_eq!(bytes_text(4 << 30), "4.0 GiB");
    }

    #[test]
    fn units_are_powers_of_1024_and_nonsense_is_none() {
        for text in ["4G", "4g", "4GB", "4GiB"] {
            assert_eq!(parse_bytes(text), Some(4 << 30), "{text}");
        }
        assert_eq!(parse_bytes("1.5K"), Some(1536));
        for text in ["", "G", "-1", "1e12", "4X", "4 G", "NaN", "inf"] {
            assert_eq!(parse_bytes(text), None, "{text}");
        }
    }
}
