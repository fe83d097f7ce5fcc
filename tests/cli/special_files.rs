//! Files that are not what their names promise: pipes, devices, and files of an absurd length, for every kind that reads
//! files.
#![cfg(unix)]

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::Place;

/// Kinds, with the extensions of the files that they read.
const LOADERS: [(&str, &[&str]); 7] = [
    ("LoadMesh", &["glb", "gltf", "obj", "stl", "ply"]),
    ("LoadObject", &["glb", "gltf", "obj", "stl"]),
    ("LoadSplats", &["ply", "spz", "splat", "ksplat", "sog", "json", "glb", "gltf", "usda"]),
    ("LoadImage", &["png", "jpg", "exr", "hdr"]),
    ("LoadEnvironment", &["exr", "hdr"]),
    ("LoadPanorama", &["png", "jpg", "exr"]),
    ("LoadCameras", &["json", "glb", "gltf"]),
];
/// The same, for the files that are read before the limit on memory applies, to find the files to which they refer.
const REFERRING: [(&str, &[&str]); 4] = [
    ("LoadMesh", &["glb", "gltf", "obj", "stl"]),
    ("LoadObject", &["gltf", "obj"]),
    ("LoadSplats", &["json", "gltf"]),
    ("LoadCameras", &["json", "gltf"]),
];
/// Kinds and extensions.
type Loaders = [(&'static str, &'static [&'static str])];
/// Time after which a command counts as hung. It takes seconds on an idle machine.
const LIMIT: Duration = Duration::from_secs(200);

/// Runs a command on a graph with one node for each kind and extension, whose files `make` creates, with 0.9 GB of address
/// space. Returns the exit code and the messages.
fn call(loaders: &Loaders, command: &str, make: impl Fn(&Path)) -> (Option<i32>, String) {
    let (place, mut nodes) = (Place::new(""), String::new());
    for (kind, extensions) in loaders {
        for extension in *extensions {
            let name = format!("{kind}.{extension}");
            make(&place.path(&name));
            let id = format!("{kind}_{extension}").to_lowercase();
            nodes += &format!("    {id}: {kind}(path: {name:?}),\n");
        }
    }
    place.write(&format!("Graph(version: 1, scene: (up: \"+z\"), nodes: (\n{nodes}))"));
    let mut child = Command::new("sh")
        .args(["-c", "ulimit -v 900000; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_lightharmony")])
        .args(command.split(' '))
        .current_dir(place.folder.path())
        .env("LIGHTHARMONY_CACHE", place.path("cache"))
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut errors = child.stderr.take().unwrap();
    let reader = std::thread::spawn(move || {
        let mut text = String::new();
        errors.read_to_string(&mut text).map(|_| text)
    });
    let begin = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if begin.elapsed() > LIMIT {
            child.kill().unwrap();
            panic!("`{command}` hangs");
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    (status.code(), reader.join().unwrap().unwrap())
}

/// Every node fails with a message that names its file, and nothing ends for want of memory.
fn refused(loaders: &Loaders, what: &str, make: impl Fn(&Path) + Copy) {
    for (command, code) in [("check graph.ron", 2), ("run graph.ron --memory 50M", 1)] {
        let (found, errors) = call(loaders, command, make);
        assert!(found == Some(code) || found == Some(2), "{what}: {command}: {found:?}\n{errors}");
        assert!(
            !errors.contains("out of memory") && !errors.contains("panicked"),
            "{what}: {command}\n{errors}"
        );
        if found == Some(2) {
            continue;
        }
        for (kind, extensions) in loaders {
            for extension in *extensions {
                let name = format!("{kind}.{extension}");
                assert!(errors.contains(&name), "{what}: {command} does not name {name}\n{errors}");
            }
        }
    }
}

#[test]
fn pipes_and_devices_are_refused() {
    refused(&LOADERS, "a pipe", |path| assert!(Command::new("mkfifo").arg(path).status().unwrap().success()));
    refused(&LOADERS, "a device", |path| std::os::unix::fs::symlink("/dev/zero", path).unwrap());
}

/// Files of 1 GB (sparse), empty but for the start that their formats have.
#[test]
fn files_of_an_absurd_length_are_refused() {
    refused(&REFERRING, "a long file", |path| {
        let start: &[u8] = match path.extension().unwrap().to_str().unwrap() {
            "glb" => b"glTF\x02\0\0\0\xff\xff\xff\x7f\xff\xff\xff\x7fJSON",
            "gltf" | "json" => b"{",
            _ => b"",
        };
        let mut file = File::create(path).unwrap();
        file.write_all(start).unwrap();
        file.set_len(1 << 30).unwrap();
    });
}
