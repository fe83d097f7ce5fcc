//! Tests of keys: different sequences of fields have different digests, and the manifest says how they differ.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use cache::{Change, Digest, Key, KeyError, KeyWriter, Manifest};
use proptest::prelude::*;

#[derive(Clone, Debug)]
enum Field {
    Str(String),
    U64(u64),
    I64(i64),
    F64(u64),
    F32(u32),
    Bool(bool),
    Bytes(Vec<u8>),
    Digest([u8; 32]),
    Group(Vec<(String, Field)>),
    List(Vec<(String, Field)>),
}

fn number(bits: u64) -> f64 {
    let value = f64::from_bits(bits);
    if value.is_nan() { 1.5 } else { value }
}

fn write(walk: &mut KeyWriter, name: &str, field: &Field) {
    match field {
        Field::Str(value) => walk.str(name, value),
        Field::U64(value) => walk.u64(name, *value),
        Field::I64(value) => walk.i64(name, *value),
        Field::F64(bits) => walk.f64(name, number(*bits)),
        Field::F32(bits) => {
            walk.f32(name, if f32::from_bits(*bits).is_nan() { 1.5 } else { f32::from_bits(*bits) });
        }
        Field::Bool(value) => walk.bool(name, *value),
        Field::Bytes(value) => walk.bytes(name, value),
        Field::Digest(value) => walk.digest(name, Digest::from_bytes(*value)),
        Field::Group(fields) => walk.group(name, |walk| write_all(walk, fields)),
        Field::List(fields) => walk.list(name, |walk| write_all(walk, fields)),
    }
}

fn write_all(walk: &mut KeyWriter, fields: &[(String, Field)]) {
    fields.iter().for_each(|(name, field)| write(walk, name, field));
}

fn key(fields: &[(String, Field)]) -> Key {
    let mut walk = KeyWriter::new("test");
    write_all(&mut walk, fields);
    walk.finish().unwrap()
}

/// Formats a sequence of fields as text. Only equal sequences give equal texts.
fn meaning(fields: &[(String, Field)]) -> String {
    let one = |field: &Field| match field {
        Field::F64(bits) => format!("F64({:016x})", (number(*bits) + 0.0).to_bits()),
        Field::F32(bits) => {
            let value = f32::from_bits(*bits);
            format!("F32({:08x})", if value.is_nan() { 1.5_f32 } else { value + 0.0 }.to_bits())
        }
        Field::Group(fields) => format!("Group({})", meaning(fields)),
        Field::List(fields) => format!("List({})", meaning(fields)),
        plain => format!("{plain:?}"),
    };
    fields.iter().map(|(name, field)| format!("{name:?}: {}, ", one(field))).collect()
}

/// Generates short sequences of similar values, so that many of them are nearly equal.
fn fields() -> impl Strategy<Value = Vec<(String, Field)>> {
    let name = prop::sample::select(vec!["", "a", "b", "ab", "(", ")", "a)"]).prop_map(str::to_owned);
    let leaf = prop_oneof![
        "[ab)s]{0,3}".prop_map(Field::Str),
        (0_u64..3).prop_map(Field::U64),
        (-1_i64..3).prop_map(Field::I64),
        prop::sample::select(vec![0, 1 << 63, 1, 0x3ff0_0000_0000_0000]).prop_map(Field::F64),
        prop::sample::select(vec![0, 1 << 31, 1, 0x3f80_0000]).prop_map(Field::F32),
        any::<bool>().prop_map(Field::Bool),
        prop::collection::vec(prop::sample::select(b"ab)s\0\x01".to_vec()), 0..3).prop_map(Field::Bytes),
        (0_u8..2).prop_map(|byte| Field::Digest([byte; 32])),
    ];
    let named = name.clone();
    let field = leaf.prop_recursive(3, 16, 3, move |inner| {
        let inside = prop::collection::vec((named.clone(), inner), 0..3);
        prop_oneof![inside.clone().prop_map(Field::Group), inside.prop_map(Field::List)]
    });
    prop::collection::vec((name, field), 0..4)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn digests_are_equal_exactly_when_walks_are(a in fields(), b in fields()) {
        prop_assert_eq!(key(&a).digest == key(&b).digest, meaning(&a) == meaning(&b));
    }

    #[test]
    fn manifests_keep_everything(a in fields(), b in fields()) {
        let (a, b) = (key(&a), key(&b));
        prop_assert_eq!(Manifest::from_bytes(a.manifest.as_bytes()), Some(a.manifest.clone()));
        prop_assert_eq!(Digest::of(a.manifest.as_bytes()), a.digest);
        prop_assert_eq!(Manifest::difference(&a.manifest, &a.manifest), vec![]);
        let same = a.manifest.lines() == b.manifest.lines();
        if !same && a.manifest.to_string() != b.manifest.to_string() {
            let mut sorted = [a.manifest.lines(), b.manifest.lines()];
            sorted.iter_mut().for_each(|lines| lines.sort_by(|a, b| a.path.cmp(&b.path)));
            if sorted[0] != sorted[1] {
                prop_assert_ne!(Manifest::difference(&a.manifest, &b.manifest), vec![]);
            }
        }
    }

    #[test]
    fn damaged_manifests_do_no_harm(fields in fields(), at in any::<prop::sample::Index>(), flip in 1_u8.., cut in any::<bool>()) {
        let mut bytes = key(&fields).manifest.as_bytes().to_vec();
        let at = at.index(bytes.len());
        if cut { bytes.truncate(at) } else { bytes[at] ^= flip }
        if let Some(manifest) = Manifest::from_bytes(&bytes) {
            let _ = (manifest.to_string(), manifest.tag());
        }
    }

    #[test]
    fn any_bytes_are_a_manifest_or_not(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = Manifest::from_bytes(&bytes);
        let prefixed = [key(&[]).manifest.as_bytes(), &bytes].concat();
        let _ = Manifest::from_bytes(&prefixed).map(|manifest| manifest.to_string());
    }
}

fn one(write: impl FnOnce(&mut KeyWriter)) -> Result<Key, KeyError> {
    let mut walk = KeyWriter::new("test");
    write(&mut walk);
    walk.finish()
}

#[test]
fn boundaries_between_items_count() {
    let list =
        |items: &[&str]| one(|walk| walk.list("l", |walk| items.iter().for_each(|item| walk.str("", item))));
    assert_ne!(list(&["ab", "c"]), list(&["a", "bc"]));
    assert_ne!(list(&["ab"]), list(&["ab", ""]));
    assert_ne!(KeyWriter::new("a").finish(), KeyWriter::new("b").finish());
}

#[test]
fn zero_has_one_sign_and_nan_no_key() {
    assert_eq!(one(|walk| walk.f64("x", -0.0)), one(|walk| walk.f64("x", 0.0)));
    assert_eq!(one(|walk| walk.f32("x", -0.0)), one(|walk| walk.f32("x", 0.0)));
    assert_ne!(one(|walk| walk.f64("x", f64::MIN_POSITIVE)), one(|walk| walk.f64("x", 0.0)));
    assert!(one(|walk| walk.f64("x", f64::INFINITY)).is_ok());
    let nan =
        |write: fn(&mut KeyWriter)| one(|walk| walk.group("pose", |w| w.list("eye", write))).unwrap_err();
    let path = "pose.eye[1]".to_owned();
    let expected = KeyError::NotANumber { path };
    assert_eq!(nan(|w| [0.0, f64::NAN, f64::NAN].iter().for_each(|v| w.f64("", *v))), expected);
    assert_eq!(nan(|w| [0.0, -f32::NAN].iter().for_each(|v| w.f32("", *v))), expected);
    assert_eq!(expected.to_string(), "`pose.eye[1]` is not a number (NaN)");
}

#[test]
fn differences_have_values() {
    let pose = |yaw: f64, extra: bool| {
        let key = one(|walk| {
            walk.group("pose", |walk| {
                walk.f64("yaw_deg", yaw);
                walk.str("a.b", "text");
            });
            walk.list("objects", |walk| {
                walk.digest("", Digest::of(b"chair"));
                if extra {
                    walk.bytes("", b"xyz");
                }
            });
        });
        key.unwrap().manifest
    };
    let change = |path: &str, old: Option<&str>, new: Option<&str>| Change {
        path: path.to_owned(),
        old: old.map(str::to_owned),
        new: new.map(str::to_owned),
    };
    let (old, new) = (pose(30.0, true), pose(35.0, false));
    let bytes = format!("3 bytes {}", Digest::of(b"xyz").short());
    assert_eq!(
        Manifest::difference(&old, &new),
        [change("pose.yaw_deg", Some("30.0"), Some("35.0")), change("objects[1]", Some(&bytes), None)]
    );
    assert_eq!(Manifest::difference(&new, &old)[1], change("objects[1]", None, Some(&bytes)));
    let text = new.to_string();
    assert!(
        text.starts_with("key test\npose.yaw_deg = 35.0\npose.\"a.b\" = \"text\"\nobjects[0] = "),
        "{text}"
    );
}

#[test]
fn the_format_of_keys_is_fixed() {
    let key = one(|walk| {
        walk.str("s", "é");
        walk.u64("u", 1);
        walk.i64("i", -1);
        walk.f64("d", 0.1);
        walk.f32("f", 0.1);
        walk.bool("b", true);
        walk.bytes("x", &[0; 200]);
        walk.digest("h", Digest::from_bytes([3; 32]));
        walk.group("g", |walk| walk.list("l", |_| ()));
    });
    let golden = "6b9f2548f35d2e471ff0c2006b8e84b056243cd6450d6e6dd7eb49bd3e607e8b";
    assert_eq!(key.unwrap().digest.to_string(), golden, "a change here changes every key of every user");
}
