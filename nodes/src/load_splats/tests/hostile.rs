//! Every small file cut off everywhere and with every byte changed: an error or a scene, never a panic, and
//! nothing that is not finite.

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
    ]
}

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
        // A `.splat` has no header, so one that ends with a row is whole.
        let whole = |length: usize| name == "splat" && length.is_multiple_of(32);
        for length in (0..bytes.len()).filter(|length| *length > 0 && !whole(*length)) {
            // The empty space of a .ksplat header holds nothing to notice.
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
                    // No count of splats beyond what the bytes may hold.
                    assert!(splats.len() <= bytes.len(), "{name} at {at}");
                }
                bytes[at] ^= change;
            }
        }
    }
}

// A few bytes that promise billions: refused at once, without the memory.
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
        ("glb accessor", text("\"count\":2,", "\"count\":9,")),
    ] {
        assert!(read(&bytes).is_err(), "{name}");
    }
}
