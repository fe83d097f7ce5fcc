//! Mattes as the Cryptomatte specification (Psyop, version 1.2.0) stores them in OpenEXR.
//!
//! The identifier of a name is its hash, MurmurHash3 (x86, 32 bits, seed 0), as the bits of a 32-bit float. Layers with
//! the names `CryptoObject00`, `CryptoObject01` and so on hold two pairs of identifier and coverage each: R and G, B
//! and A. Attributes of the file name the layer and list the names.

use super::planes::Channel;
use crate::types::{MatteView, Mattes};

/// Number of pairs of identifier and coverage in a layer.
const PAIRS: usize = 2;

/// MurmurHash3 (x86, 32 bits) with seed 0, by A. Appleby.
pub fn murmur3(bytes: &[u8]) -> u32 {
    let mixed = |k: u32| k.wrapping_mul(0xcc9e_2d51).rotate_left(15).wrapping_mul(0x1b87_3593);
    let word = |bytes: &[u8]| bytes.iter().rev().fold(0, |word, byte| word << 8 | u32::from(*byte));
    let blocks = bytes.chunks_exact(4);
    let rest = blocks.remainder();
    let mut hash = blocks.fold(0_u32, |hash, block| {
        (hash ^ mixed(word(block))).rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64)
    });
    // A remainder of no bytes mixes to 0.
    hash ^= mixed(word(rest));
    hash ^= bytes.len() as u32;
    hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
    hash ^ hash >> 16
}

/// Identifier of a name: its hash, with one bit of the exponent changed if the bits would be those of a subnormal number,
/// an infinity or NaN, which programs do not keep.
pub fn identifier(name: &str) -> f32 {
    let hash = murmur3(name.as_bytes());
    let exponent = hash >> 23 & 0xff;
    f32::from_bits(if matches!(exponent, 0 | 0xff) { hash ^ 1 << 23 } else { hash })
}

/// Attributes of a file with these mattes, as pairs of name and text.
pub fn attributes(mattes: &Mattes) -> Vec<(String, String)> {
    let key = format!("{:08x}", murmur3(mattes.layer.as_bytes()));
    let named = |field: &str, text: String| (format!("cryptomatte/{}/{field}", &key[..7]), text);
    vec![
        named("name", mattes.layer.clone()),
        named("hash", "MurmurHash3_32".to_owned()),
        named("conversion", "uint32_to_float32".to_owned()),
        named("manifest", manifest(&mattes.names)),
    ]
}

/// The names with their identifiers, as JSON in ASCII, since attributes have no encoding.
fn manifest(names: &[String]) -> String {
    let mut text = String::from("{");
    for (index, name) in names.iter().enumerate() {
        text += if index == 0 { "\"" } else { ",\"" };
        let mut units = [0; 2];
        for c in name.chars() {
            match c {
                '"' | '\\' => text.extend(['\\', c]),
                ' '..='~' => text.push(c),
                _ => text.extend(c.encode_utf16(&mut units).iter().map(|unit| format!("\\u{unit:04x}"))),
            }
        }
        text += &format!("\":\"{:08x}\"", identifier(name).to_bits());
    }
    text + "}"
}

/// Channels of the mattes of one view: `CryptoObject00.R` and so on, each with `width * height` numbers. Pairs that are
/// not used are 0.
pub fn channels(mattes: &Mattes, view: &MatteView) -> Vec<Channel> {
    let identifiers: Vec<f32> = mattes.names.iter().map(|name| identifier(name)).collect();
    let pixels = view.width * view.height;
    let mut all = Vec::new();
    for layer in 0..view.ranks.div_ceil(PAIRS) {
        let mut planes = [(); 2 * PAIRS].map(|()| Vec::with_capacity(pixels));
        for pixel in 0..pixels {
            let mut pairs = view.pairs(pixel).skip(layer * PAIRS);
            for pair in planes.as_chunks_mut::<2>().0 {
                let (index, coverage) = pairs.next().unzip();
                pair[0].push(index.map_or(0.0, |index| identifiers[index as usize]));
                pair[1].push(coverage.unwrap_or(0.0));
            }
        }
        let named =
            |(letter, samples)| Channel { name: format!("{}{layer:02}.{letter}", mattes.layer), samples };
        all.extend(["R", "G", "B", "A"].into_iter().zip(planes).map(named));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hashes by the PyPI package `mmh3` 5. This test fails if the remainder is read in the other byte order, or if the
    /// length is left out.
    #[test]
    fn hashes_agree_with_mmh3() {
        for (name, hash) in HASHES {
            assert_eq!(murmur3(name.as_bytes()), hash, "{name}");
        }
    }

    /// This test fails if exponents are not changed.
    #[test]
    fn identifiers_are_normal_numbers() {
        // Names whose hashes have the exponents 0 and 255, found by trying numbers.
        for (name, bits) in EXPONENTS {
            let id = identifier(name);
            assert!(id.is_normal(), "{name}");
            assert_eq!(id.to_bits(), bits, "{name}");
        }
    }

    #[test]
    fn the_manifest_is_json_in_ascii() {
        let names = ["vase", "a \"b\" \\", "Stühle 🪑"].map(str::to_owned);
        let text = manifest(&names);
        assert!(text.is_ascii());
        let back: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&text).expect("is JSON");
        let found: Vec<_> = back.iter().map(|(name, id)| (name.as_str(), id.as_str())).collect();
        let hex = names.each_ref().map(|name| format!("{:08x}", identifier(name).to_bits()));
        for (name, hex) in names.iter().zip(&hex) {
            assert!(found.contains(&(name.as_str(), Some(hex.as_str()))), "{name}");
        }
        assert_eq!(manifest(&[]), "{}");
    }

    #[test]
    fn pairs_fill_layers_in_order() {
        let view = MatteView {
            name: "v".to_owned(),
            width: 1,
            height: 1,
            ranks: 3,
            indices: vec![1, 0, 2],
            coverages: vec![0.5, 0.25, 0.125],
        };
        let names: Vec<_> = ["a", "b", "c"].map(str::to_owned).into();
        let mattes = Mattes { layer: "Crypto".to_owned(), names, views: vec![view.clone()] };
        let found = channels(&mattes, &view);
        let found: Vec<_> = found.iter().map(|channel| (channel.name.as_str(), channel.samples[0])).collect();
        let id = identifier;
        let first =
            [("Crypto00.R", id("b")), ("Crypto00.G", 0.5), ("Crypto00.B", id("a")), ("Crypto00.A", 0.25)];
        let second =
            [("Crypto01.R", id("c")), ("Crypto01.G", 0.125), ("Crypto01.B", 0.0), ("Crypto01.A", 0.0)];
        assert_eq!(found, [first, second].concat());
        let name = attributes(&mattes).remove(0);
        assert_eq!(
            name,
            (
                format!("cryptomatte/{}/name", &format!("{:08x}", murmur3(b"Crypto"))[..7]),
                "Crypto".to_owned()
            )
        );
    }

    /// Names and their hashes.
    const HASHES: [(&str, u32); 9] = [
        ("", 0x0000_0000),
        ("a", 0x3c25_69b2),
        ("ab", 0x9bbf_d75f),
        ("abc", 0xb3dd_93fa),
        ("abcd", 0x43ed_676a),
        ("vase", 0x6aaa_21aa),
        ("CryptoObject", 0x3ae3_9a58),
        ("Stühle", 0xf4b7_df61),
        ("a longer name, of 30 characters", 0xddeb_9870),
    ];
    /// Names and the bits of their identifiers.
    const EXPONENTS: [(&str, u32); 2] = [("796", 0x80af_dfe2), ("454", 0xff3f_fb25)];
}
