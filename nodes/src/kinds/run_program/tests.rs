//! Programs that give splats and meshes, and every way in which they fail.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use engine::{Scene, Up};
use glam::DVec3;
use scene::io::mesh::{MeshFormat, encode as encode_mesh};
use scene::io::splats::save::{SaveFormat, encode as encode_splats};
use scene::types::{Camera, Photo, Point};

use super::*;

fn context(folder: &Path) -> Context {
    Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 1, exhaustive: false }, folder)
}

/// A folder with a program whose code is `script`.
fn place(script: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("is made");
    let path = folder.path().join("tool");
    std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).expect("is written");
    std::fs::set_permissions(&path, PermissionsExt::from_mode(0o755)).expect("is set");
    folder
}

fn program(arguments: &[&str]) -> RunProgram {
    RunProgram {
        program: "./tool".to_owned(),
        arguments: arguments.iter().map(|argument| (*argument).to_owned()).collect(),
        splats_file: None,
        mesh_file: Some("mesh.ply".to_owned()),
        splats_digest: None,
        mesh_digest: None,
        files: Vec::new(),
        version: String::new(),
    }
}

fn nothing() -> In {
    In { photos: None, splats: None, mesh: None }
}

fn mesh() -> Mesh {
    Mesh {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]],
        triangles: vec![[0, 1, 2]],
        ..Mesh::default()
    }
}

fn splats() -> Splats {
    let mut splats = Splats::empty();
    splats.means.push([0.5, 1.0, -2.0]);
    splats.scales.push([0.1, 0.2, 0.3]);
    splats.quats.push([1.0, 0.0, 0.0, 0.0]);
    splats.opacities.push(0.5);
    splats.sh.push([0.1, 0.2, 0.3]);
    splats
}

/// Inputs are files in the documented places, arguments reach the program as they are, and outputs are read. This test
/// fails if arguments pass through a shell.
#[test]
fn inputs_and_outputs_are_files() {
    let folder = place(
        r#"test "$1" = 'a b; $HOME' || exit 9
test -s "$2/images/v.png" && test -s "$2/sparse/0/points3D.bin" && test -s "$2/masks/v.png" || exit 8
cp "$3" "$5/result.ply" && cp "$4" "$5/mesh.ply" && cat "$6/notes.txt""#,
    );
    std::fs::write(folder.path().join("notes.txt"), "hello").expect("is written");
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let mut pixels = vec![[9, 9, 9, 255]; 12];
    pixels[0][3] = 0;
    let photo = Photo { camera: Camera::centred("v", [4, 3], 5.0, axes, DVec3::ZERO), pixels };
    let point = Point { position: [0.0, 0.0, 1.0], rgb: [0.5; 3] };
    let inputs = In {
        photos: Some(Arc::new(Photos { photos: vec![photo], points: vec![point] })),
        splats: Some(Arc::new(splats())),
        mesh: Some(Arc::new(mesh())),
    };
    let mut p = program(&["a b; $HOME", "{photos}", "{splats}", "{mesh}", "{out}", "{files}"]);
    p.splats_file = Some("result.ply".to_owned());
    p.files = vec![InputFile("notes.txt".to_owned())];
    RunProgram::check(&p).expect("is valid");
    let cx = context(folder.path());
    let (out, notes) = RunProgram::run(&p, inputs, &cx).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((out.splats.means[0], out.mesh.triangles.len()), ([0.5, 1.0, -2.0], 1));

    // The digests that the notes state are accepted, and no others.
    let (ply, _) = encode_splats(&splats(), SaveFormat::Ply, None, &cx).expect("encodes");
    let digest = Digest::of(&ply).to_string();
    assert!(notes.iter().any(|note| note.id == "output-digest" && note.text.contains(&digest)), "{notes:?}");
    let pinned = |digest: String| {
        let tool = place("cp \"$(dirname \"$0\")/s.ply\" out/s.ply");
        std::fs::write(tool.path().join("s.ply"), &ply).expect("is written");
        let p = RunProgram {
            splats_file: Some("s.ply".to_owned()),
            splats_digest: Some(digest),
            mesh_file: None,
            ..program(&[])
        };
        RunProgram::check(&p).and_then(|()| RunProgram::run(&p, nothing(), &context(tool.path())))
    };
    assert!(pinned(digest).expect("is equal").0.mesh.triangles.is_empty());
    let error = pinned(Digest::of(b"other").to_string()).err().expect("differs").to_string();
    assert!(error.contains("has the digest") && error.contains("`splats_digest` is"), "{error}");
}

/// Every failure is an error of its own, at the responsible field.
#[test]
fn every_failure_is_named() {
    let ply = String::from_utf8_lossy(&encode_mesh(&mesh(), MeshFormat::Obj, None)).into_owned();
    for (script, field, text) in [
        (
            "echo no GPU found >&2; exit 3",
            "program",
            "failed with exit status: 3; the last lines of its standard error are:\n  no GPU found",
        ),
        ("kill -9 $$", "program", "failed with signal: 9"),
        (
            "echo done",
            "mesh_file",
            "did not write `mesh.ply`; the last lines of its standard output are:\n  done",
        ),
        ("ln -s /etc/passwd out/mesh.ply", "mesh_file", "as a link out of its folder, to `/etc/passwd`"),
        ("mkdir out/mesh.ply", "mesh_file", "did not write `mesh.ply`"),
        (&format!("cat > out/mesh.ply <<'X'\n{ply}X"), "mesh_file", "mesh.ply"),
    ] {
        let folder = place(script);
        let error = RunProgram::run(&program(&[]), nothing(), &context(folder.path())).err().expect("fails");
        assert!(error.to_string().contains(text), "{script}: {error}");
        assert!(format!("{error:?}").contains(&format!("Some(\"{field}\")")), "{script}: {error:?}");
    }
    let other = RunProgram { program: "./gone".to_owned(), ..program(&[]) };
    let error = RunProgram::sources(&other, &SourceRoot::new("/tmp")).expect_err("is missing");
    assert!(error.to_string().contains("`./gone` was not found at") && error.advice().is_some(), "{error}");
}

#[test]
fn mistakes_are_found_before_the_run() {
    let with = |change: &dyn Fn(&mut RunProgram)| {
        let mut p = program(&[]);
        change(&mut p);
        RunProgram::check(&p).err().map(|error| error.to_string()).unwrap_or_default()
    };
    for (found, text) in [
        (with(&|p| p.mesh_file = None), "has no output"),
        (with(&|p| p.mesh_file = Some("../mesh.ply".to_owned())), "not a path inside the folder"),
        (with(&|p| p.mesh_file = Some("/etc/mesh.ply".to_owned())), "not a path inside the folder"),
        (with(&|p| p.mesh_digest = Some("12".to_owned())), "not a BLAKE3 digest"),
        (with(&|p| p.splats_digest = Some("0".repeat(64))), "no `splats_file`"),
        (with(&|p| p.program = " ".to_owned()), "is empty"),
        (with(&|p| p.arguments = vec!["{outs}".to_owned()]), "stands for nothing"),
        (with(&|p| p.files = ["a/x", "b/x"].map(|f| InputFile(f.to_owned())).to_vec()), "no name of its own"),
    ] {
        assert!(found.contains(text), "{text}: {found}");
    }
    let error = RunProgram::check_output(&program(&[]), "splats").expect_err("has no splats").to_string();
    assert!(error.contains("no output `splats`"), "{error}");
    assert!(RunProgram::check_output(&program(&[]), "mesh").is_ok());
}
