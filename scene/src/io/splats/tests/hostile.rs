//! Truncates every small file at every position and changes every byte: the result is an error or a scene, never a
//! panic or a non-finite value.

use super::*;

fn all() -> Vec<(&'static str, Vec<u8>)> {
    let row = PlyRow { rest: vec![0.5; 9], ..PlyRow::default() };
    let packed = Packed { position: 7, rotation: 9 << 28, scale: 5, colour: 0x0102_0304, rest: vec![3; 9] };
    vec![
        ("ply", build::ply(&[row.clone(), row], 1)),
        ("compressed ply", build::compressed_ply(&[packed.clone(), packed], 1)),
        ("splat", build::splat(3)),
        ("ksplat 0", build::ksplat(0, 1)),
        ("ksplat 2", build::ksplat(2, 2)),
        ("spz 1", build::spz(1, 1)),
        ("spz 2", build::spz(2, 0)),
        ("spz 3", build::spz(3, 2)),
        ("spz 4", build::spz(4, 1)),
        ("sog stored", build::zip("a/", &build::sog(2), false)),
        ("sog deflated", build::zip("", &build::sog(1), true)),
        ("glb", build::glb("", "srgb_rec709_display")),
        ("ply ascii", ASCII.to_vec()),
        ("ply of two scales", TWO_SCALES.to_vec()),
    ]
}

/// A splat in ASCII, with a comment of its trainer.
const ASCII: &[u8] =
    b"ply\nformat ascii 1.0\ncomment SplatRenderMode: mip\nelement vertex 1\nproperty float x\n\
    property float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
    property float opacity\nproperty float scale_0\nproperty float scale_1\nproperty float scale_2\n\
    property float rot_0\nproperty float rot_1\nproperty float rot_2\nproperty float rot_3\nend_header\n\
    1 2 3 9 8 7 inf -1 -inf -2 1 0 0 0.\n";

/// A big-endian splat of 2DGS, whose numbers are all 0 except for the rotation.
const TWO_SCALES: &[u8] = b"ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
    property float z\nproperty float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\nproperty float opacity\n\
    property float scale_0\nproperty float scale_1\nproperty float rot_0\nproperty float rot_1\nproperty float rot_2\n\
    property float rot_3\nend_header\n\
    \0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\x3f\x80\0\0\0\0\0\0\0\0\0\0\0\0\0\0";

fn is_sane(splats: &Splats) {
    let numbers = [splats.means.as_flattened(), splats.scales.as_flattened(), splats.quats.as_flattened()];
    let sh = splats.sh.as_flattened();
    assert!(numbers.into_iter().flatten().chain(&splats.opacities).chain(sh).all(|v| v.is_finite()));
    assert_eq!(splats.sh.len(), splats.len() * splats.sh_len());
    assert!(splats.opacities.iter().all(|o| (0.0..=1.0).contains(o)));
}

#[test]
fn cut_off_anywhere_is_an_error() {
    for (name, bytes) in all() {
        // A `.splat` has no header, so one that ends after a row is complete. The last number of an ASCII file may
        // lack the end of its line, and its dot.
        let whole = |length: usize| {
            name == "splat" && length.is_multiple_of(32) || name == "ply ascii" && length + 2 >= bytes.len()
        };
        for length in (0..bytes.len()).filter(|length| *length > 0 && !whole(*length)) {
            // The unused space of a .ksplat header has no effect.
            if name.starts_with("ksplat") && (64..4000).contains(&length) && length % 97 != 0 {
                continue;
            }
            match read(&bytes[..length]) {
                Err(_) => {}
                Ok((splats, _)) => {
                    panic!("{name} cut at {length} of {} gave {} splats", bytes.len(), splats.len())
                }
            }
        }
    }
}

#[test]
fn any_changed_byte_is_survived() {
    for (name, bytes) in all() {
        let mut bytes = bytes;
        for at in 0..bytes.len() {
            if name.starts_with("ksplat") && (64..4096).contains(&at) {
                continue;
            }
            for change in [0x01, 0x80, 0xff] {
                bytes[at] ^= change;
                if let Ok((splats, _)) = read(&bytes) {
                    is_sane(&splats);
                    // The number of splats is limited by the number of bytes.
                    assert!(splats.len() <= bytes.len(), "{name} at {at}");
                }
                bytes[at] ^= change;
            }
        }
    }
}

// A few bytes that claim billions of splats: refused at once, without allocating memory.
#[test]
fn bombs_are_refused() {
    let mut spz = build::spz(4, 1);
    spz[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut plain = build::spz(4, 0)[..16].to_vec();
    plain[4] = 3;
    plain[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut ksplat = build::ksplat(0, 1);
    ksplat[4096..4104].copy_from_slice(&[0xff; 8]);
    let mut sog = build::sog(2);
    sog[0].1 = String::from_utf8(sog[0].1.clone())
        .unwrap()
        .replace("\"count\":7", "\"count\":4294967296")
        .into_bytes();
    let mut blank = build::sog(2);
    blank[0].1.resize(17 << 20, b' ');
    let text = |from: &str, to: &str| {
        let bytes = build::glb("", "srgb_rec709_display");
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        assert_eq!(from.len(), to.len());
        [&bytes[..at], to.as_bytes(), &bytes[at + to.len()..]].concat()
    };
    for (name, bytes) in [
        ("spz 4", spz),
        ("spz plain", plain),
        ("ksplat", ksplat),
        ("sog", build::zip("", &sog, false)),
        ("sog meta", build::zip("", &blank, true)),
        ("glb accessor", text("\"count\":2,", "\"count\":9,")),
    ] {
        assert!(read(&bytes).is_err(), "{name}");
    }
}

/// Generator of reproducible damage to files.
struct Damage(u64);

impl Damage {
    fn next(&mut self) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize
    }

    fn below(&mut self, end: usize) -> usize {
        self.next() % end.max(1)
    }

    /// Makes one to eight changes: bits, bytes, numbers that may overflow, and pieces that are duplicated, moved or
    /// removed.
    fn apply(&mut self, bytes: &mut Vec<u8>) {
        for _ in 0..=self.below(8) {
            // Headers are short compared with the data: half of the changes are in the first 256 bytes.
            let end = if self.below(2) == 0 { bytes.len().min(256) } else { bytes.len() };
            let (at, length) = (self.below(end), 1 << self.below(9));
            let to = (at + length).min(bytes.len());
            match self.below(8) {
                0 | 1 if at < bytes.len() => bytes[at] ^= 1 << self.below(8),
                2 if at < bytes.len() => bytes[at] = self.next() as u8,
                3 => {
                    let numbers =
                        [0_u64, 1, 0x7f, 0xff, 0x7fff_ffff, 0xffff_ffff, 1 << 32, 1 << 63, u64::MAX];
                    let number = numbers[self.below(numbers.len())].to_le_bytes();
                    let width = [1, 2, 4, 8][self.below(4)];
                    bytes.iter_mut().skip(at).zip(&number[..width]).for_each(|(to, from)| *to = *from);
                }
                4 => {
                    let digits = ["0", "-1", "9", "4294967296", "1e999", "null", "[]"];
                    bytes.splice(at..at, digits[self.below(digits.len())].bytes());
                }
                5 => drop(bytes.drain(at..to)),
                6 => {
                    let piece = bytes[at..to].to_vec();
                    bytes.splice(at..at, piece);
                }
                _ => bytes.truncate(bytes.len() - self.below(bytes.len()).min(length)),
            }
        }
    }
}

/// Returns a damaged copy of a file. Compressed files are usually damaged before compression, since the checksum
/// would detect later damage.
fn damaged(name: &str, bytes: &[u8], damage: &mut Damage) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    match name {
        "sog stored" | "sog deflated" if damage.below(4) > 0 => {
            let mut files = build::sog(if name == "sog stored" { 2 } else { 1 });
            // The description is more important than the pictures.
            let which = if damage.below(2) == 0 { 0 } else { damage.below(files.len()) };
            damage.apply(&mut files[which].1);
            build::zip("", &files, name == "sog deflated")
        }
        "spz 2" | "spz 3" if damage.below(4) > 0 => {
            let mut plain = Vec::new();
            flate2::read::GzDecoder::new(&bytes[..]).read_to_end(&mut plain).unwrap();
            damage.apply(&mut plain);
            plain
        }
        _ => {
            damage.apply(&mut bytes);
            bytes
        }
    }
}

// Some thousand damaged files of every format. `LIGHTHARMONY_FUZZ=200000 cargo test damaged` tries that many of
// each; `nodes/fuzz` has coverage-guided targets.
#[test]
fn damaged_files_are_survived() {
    let wanted = std::env::var("LIGHTHARMONY_FUZZ").ok().and_then(|n| n.parse().ok());
    for (name, bytes) in all() {
        let mut damage = Damage(1);
        let mut scenes = 0;
        for number in 0..wanted.unwrap_or(1000) {
            let file = damaged(name, &bytes, &mut damage);
            let seen = std::panic::catch_unwind(|| {
                if let Ok((splats, _)) = read(&file) {
                    is_sane(&splats);
                    assert!(splats.len() <= file.len() * 64, "{} splats", splats.len());
                    return true;
                }
                false
            });
            match seen {
                Ok(scene) => scenes += usize::from(scene),
                Err(_) => panic!("{name}: damaged file {number} of {} bytes: {file:02x?}", file.len()),
            }
        }
        // Some files are accepted, and some are refused.
        assert!(scenes > 0, "{name}");
    }
}
