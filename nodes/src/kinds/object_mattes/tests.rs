//! Tests of the inputs of `object-mattes`. `nodes/tests/mattes.rs` compares it with `path-trace`.

use super::*;

#[test]
fn names_are_checked() {
    for (names, layer, message) in [
        (vec![""], "CryptoObject", Some("the name of an object is empty")),
        (vec!["a"], "", Some("the name `` of the Cryptomatte cannot be written")),
        (vec!["a"], "Crypto0", Some("the name `Crypto0` of the Cryptomatte cannot be written")),
        (vec!["a"], "Crypto.Object", Some("the name `Crypto.Object` of the Cryptomatte cannot be written")),
        (vec!["a", "a"], "Props_of_set", None),
    ] {
        let names = names.into_iter().map(str::to_owned).collect();
        let p = ObjectMattes { names, layer: layer.to_owned(), ..ObjectMattes::default() };
        assert_eq!(
            ObjectMattes::check(&p).err().map(|e| e.to_string()),
            message.map(str::to_owned),
            "{layer}"
        );
    }
}

#[test]
fn objects_of_one_name_are_one() {
    let groups = Groups::of(&["a", "b", "a"].map(str::to_owned));
    assert_eq!((groups.names, groups.of_object), (vec!["a".to_owned(), "b".to_owned()], vec![0, 1, 0]));
}

/// This test fails if NaN or alpha above 1 is kept.
#[test]
fn alpha_is_limited() {
    use scene::types::{Image, Linear};
    let samples = [f32::NAN, 2.0, -1.0, 0.5].map(|alpha| [0.0, 0.0, 0.0, alpha]).concat();
    let image: Picture = Image::<Linear>::from_samples(4, 1, 4, samples).into();
    assert_eq!(alpha_of(&image, "object").expect("has alpha"), [0.0, 1.0, 0.0, 0.5]);
    let opaque: Picture = Image::<Linear>::new(1, 1, 3).into();
    assert!(alpha_of(&opaque, "object").is_err());
}

/// This test fails if `ranks` keeps the objects with the least coverage.
#[test]
fn ranks_keep_the_largest_coverages() {
    let p = ObjectMattes { ranks: 2, ..ObjectMattes::default() };
    let shares = vec![Shares::of([(0, 1.0), (1, 5.0), (2, 2.0)]), Shares::default()];
    let (view, counts) = p.finish(shares, &[1.0, 0.0], ("v", 2, 1));
    assert_eq!((view.indices, view.coverages), (vec![1, 2, 0, 0], vec![0.625, 0.25, 0.0, 0.0]));
    assert_eq!(counts, [0, 0, 1, 1]);
}
