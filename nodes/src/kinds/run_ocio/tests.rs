//! Conversions by a stand-in for a Python with OpenColorIO, and every way in which they fail. `tests/tables/ocio.py`
//! compares the numbers with OpenColorIO itself.

use std::os::unix::fs::PermissionsExt;

use engine::{Scene, Up};
use scene::types::{Data, Image, Linear, Picture};

use super::*;

/// A stand-in that copies the pixels of each picture.
const COPY: &str = r#"for f in *.f32; do cp "$f" "out/$f"; done
echo '{"version": "2.6.0", "from": "A", "to": "B"}' > out/done.json"#;

/// Runs the node with a stand-in that runs the given code.
fn run(p: &RunOcio, code: &str) -> Result<(Out, Notes), NodeError> {
    let image = Image::<Linear>::from_samples(2, 1, 4, vec![0.1, 0.2, 0.3, 1.0, 0.4, 0.2, 0.1, 0.5]);
    run_on(p, code, image.into())
}

fn run_on(p: &RunOcio, code: &str, image: Picture) -> Result<(Out, Notes), NodeError> {
    let folder = tempfile::tempdir().expect("is made");
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("ocio.sh"), format!("#!/bin/sh\n{code}\n")).expect("is written");
    std::fs::set_permissions(at("ocio.sh"), PermissionsExt::from_mode(0o755)).expect("is set");
    std::fs::write(at("a.ocio"), "ocio_profile_version: 2").expect("is written");
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
    let root = SourceRoot::new(folder.path());
    let p = RunOcio { program: Some("./ocio.sh".to_owned()), ..p.clone() };
    let cx = Context::detached(scene, folder.path()).having_listed(&RunOcio::sources(&p, &root)?);
    RunOcio::run(&p, In { image: Arc::new(Images::single("v", image)) }, &cx)
}

/// The error of a run that fails.
fn failure(p: &RunOcio, code: &str) -> NodeError {
    run(p, code).err().unwrap_or_else(|| panic!("succeeds: {code}"))
}

fn to(space: &str) -> RunOcio {
    RunOcio { to: Some(space.to_owned()), ..RunOcio::default() }
}

/// This test fails if the config is not copied, or if a name of the request is lost.
#[test]
fn pictures_pass_through_the_program() {
    let p = RunOcio { config: Some(InputFile("a.ocio".to_owned())), ..to("B \"x\"") };
    let code = format!(
        r#"grep -q '"to":"B \\"x\\""' "$2" && grep -q '"config":"config.ocio"' "$2" && grep -q '"from":null' "$2" && grep -q profile config.ocio || exit 3
{COPY}"#
    );
    let (out, notes) = run(&p, &code).unwrap_or_else(|e| panic!("{e}"));
    let picture = &out.image.0[0].picture;
    assert_eq!((picture.encoding(), picture.size()), ("data", (2, 1, 4)));
    assert_eq!(picture.samples(), [0.1, 0.2, 0.3, 1.0, 0.4, 0.2, 0.1, 0.5]);
    assert!(notes.iter().any(|note| note.text.contains("OpenColorIO 2.6.0: A to B")), "{notes:?}");
}

#[test]
fn the_result_has_the_encoding_of_its_space() {
    let (from, display) = (Some("A".to_owned()), Some("D".to_owned()));
    for (p, encoding) in [
        (RunOcio { from, ..RunOcio::default() }, "linear"),
        (RunOcio { display, ..RunOcio::default() }, "srgb"),
    ] {
        let (out, _) = run(&p, COPY).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(out.image.0[0].picture.encoding(), encoding);
    }
}

/// Files state sRGB. This test fails if the names of display or view are ignored, or if a space is taken for a display.
#[test]
fn displays_other_than_srgb_are_reported() {
    let display = RunOcio { display: Some("D".to_owned()), ..RunOcio::default() };
    let warned = |p: &RunOcio, to: &str| {
        let (_, notes) =
            run(p, &COPY.replace("\"B\"", &format!("\"{to}\""))).unwrap_or_else(|e| panic!("{e}"));
        notes.iter().any(|note| note.id == "display-not-srgb")
    };
    assert!(warned(&display, "Display P3 - Display, Un-tone-mapped"));
    assert!(!warned(&display, "sRGB - Display, Raw") && !warned(&display, "ACES, sRGB"));
    assert!(!warned(&to("ACEScg"), "ACEScg"));
}

/// This test fails if data without a space is taken for linear Rec.709.
#[test]
fn data_needs_the_name_of_its_space() {
    let data = || Image::<Data>::from_samples(1, 1, 3, vec![0.5; 3]).into();
    let error = run_on(&to("ACEScg"), COPY, data()).err().expect("is refused");
    assert!(error.message().contains("its space is not known"), "{error}");
    let named = RunOcio { from: Some("log".to_owned()), ..to("ACEScg") };
    assert!(run_on(&named, COPY, data()).is_ok());
}

/// This test fails if near names are left out, or if the mistake is not found.
#[test]
fn mistakes_of_names_are_shown_with_near_names() {
    let code = r#"echo '{"field": "to", "message": "the configuration has no colour space `B`", "near": ["ACEScg", "ACEScc"]}' > out/mistake.json"#;
    let error = failure(&to("B"), code);
    assert_eq!(error.message(), "OpenColorIO: the configuration has no colour space `B`");
    assert_eq!(error.advice(), Some("write one of its names, such as `ACEScg`, `ACEScc`"));
    let code = r#"echo '{"field": "files", "message": "bad line 3", "near": []}' > out/mistake.json"#;
    let error = failure(&to("B"), code);
    assert!(error.advice().is_some_and(|hint| hint.contains("ocioarchive")), "{error}");
}

/// This test fails if pictures of another size, no pictures, or a failure of the program are accepted.
#[test]
fn failures_of_the_program_are_named() {
    for (code, message) in [
        ("echo trouble >&2; exit 4", "`opencolorio` failed with exit status: 4"),
        (":", "did not write `done.json`"),
        (r#"echo '{"version": "2", "from": "A", "to": "B"}' > out/done.json"#, "did not write `0.f32`"),
        (
            r#"echo '{"version": "2", "from": "A", "to": "B"}' > out/done.json; printf abcd > out/0.f32"#,
            "wrote 4 bytes for a picture of 2x1 pixels",
        ),
        ("echo nonsense > out/done.json", "expected"),
    ] {
        let error = failure(&to("B"), code);
        assert!(error.message().contains(message), "{error}");
    }
}

#[test]
fn a_missing_library_is_named_with_what_to_install() {
    let root = SourceRoot::new("/");
    for (program, message) in [("./no-such-python", "was not found"), ("no-such-python3", "was not found")] {
        let p = RunOcio { program: Some(program.to_owned()), ..to("B") };
        let error = RunOcio::sources(&p, &root).expect_err(program);
        assert!(error.message().contains(message), "{error}");
        assert!(error.advice().is_some_and(|hint| hint.contains("pip install opencolorio")), "{error}");
    }
}

#[test]
fn parameters_that_do_not_fit_are_refused() {
    let some = |text: &str| Some(text.to_owned());
    let display = some("sRGB - Display");
    for (p, message) in [
        (RunOcio::default(), "the node converts nothing"),
        (RunOcio { display: display.clone(), ..to("A") }, "not both"),
        (RunOcio { view: some("V"), ..to("A") }, "a `view` belongs to a `display`"),
        (RunOcio { builtin: "cg".to_owned(), ..to("A") }, "`cg` is not the address"),
        (RunOcio { config: Some(InputFile("a.yml".to_owned())), ..to("A") }, "`a.yml` is not an OpenColorIO"),
    ] {
        let error = RunOcio::check(&p).expect_err(message);
        assert!(error.message().contains(message), "{error}");
    }
    assert!(RunOcio::check(&RunOcio { display, ..RunOcio::default() }).is_ok());
}
