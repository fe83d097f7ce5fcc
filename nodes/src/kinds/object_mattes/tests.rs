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
    assert_eq!(counts, Counts { solid: 1, cut: 1, ..Counts::default() });
}

/// The objects or the camera of another trace. This test fails if `SOLID` is 0, so that blurred edges count, or if
/// `MOST_UNSEEN` is 1.
#[test]
fn mattes_of_other_objects_are_reported() {
    let warned = |shown: usize, alpha: f64| {
        let one = || Shares::of([(0, 1.0)]);
        let shares = (0..10).map(|pixel| if pixel < shown { one() } else { Shares::default() }).collect();
        let alphas: Vec<f64> = (0..10).map(|pixel| if pixel < 5 { 1.0 } else { alpha }).collect();
        let (_, counts) = ObjectMattes::default().finish(shares, &alphas, ("v", 10, 1));
        counts.notes().iter().any(|note| note.id == "mattes-disagree")
    };
    assert!(warned(5, 1.0), "half of the object is not wired");
    assert!(!warned(10, 1.0) && !warned(5, 0.45), "all is wired, and the object is blurred");
}
