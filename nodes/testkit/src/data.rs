//! A folder with files for tests and benches, and functions that load them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use engine::{Context, InputFile, Kind, Notes, Scene, Up};
use nodes::kinds::load_cameras::{self, LoadCameras};
use nodes::kinds::load_environment::{self, FileEncoding, LoadEnvironment};
use nodes::kinds::load_mesh::{self, ColourEncoding, LoadMesh, MeshFrame};
use nodes::kinds::load_object::{self, LoadObject};
use nodes::kinds::load_splats::{self, Frame, LoadSplats};
use scene::types::{Environment, Mesh, Object, Rig, Splats};

/// A folder of files, and the `scene` settings with which kinds run on the files.
#[derive(Clone)]
pub struct Data {
    folder: PathBuf,
    up: Up,
    seed: u64,
}

impl Data {
    /// Uses the files of a folder. The scene unit is one metre.
    pub fn of(folder: &Path, up: Up, seed: u64) -> Self {
        Self { folder: folder.to_owned(), up, seed }
    }

    /// Uses the shared data next to the checkout.
    pub fn shared(up: Up, seed: u64) -> Self {
        Self::of(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), up, seed)
    }

    /// Returns the same files with a different seed.
    pub fn with_seed(&self, seed: u64) -> Self {
        Self { seed, ..self.clone() }
    }

    /// Path of a file or folder.
    ///
    /// # Panics
    /// If it does not exist, so that no test is skipped.
    pub fn path(&self, path: &str) -> PathBuf {
        let path = self.folder.join(path);
        assert!(path.exists(), "{} is missing", path.display());
        path
    }

    /// The bytes of a file.
    pub fn bytes(&self, path: &str) -> Vec<u8> {
        std::fs::read(self.path(path)).unwrap()
    }

    /// Contents of a JSON file.
    pub fn json(&self, path: &str) -> serde_json::Value {
        serde_json::from_slice(&self.bytes(path)).unwrap()
    }

    /// Context that belongs to no run. Paths are relative to the folder.
    pub fn context(&self) -> Context {
        let scene = Scene { up: self.up, metres_per_unit: 1.0, seed: self.seed, exhaustive: false };
        Context::detached(scene, &self.folder)
    }

    /// The splats in the files `path` and `more`, in the frame that the format of these files defines.
    pub fn splats(&self, path: &str, more: &[&str], strict: bool) -> Arc<Splats> {
        let file = |path: &str| InputFile(path.to_owned());
        let params = LoadSplats {
            path: file(path),
            more: more.iter().map(|path| file(path)).collect(),
            strict,
            max_extent: 1e6,
            level: 0,
            frame: Frame::ByFormat,
            matrix: None,
        };
        LoadSplats::run(&params, load_splats::In {}, &self.context()).unwrap().0.splats
    }

    /// The mesh in a file, whose coordinates are taken as world coordinates.
    pub fn mesh(&self, path: &str, colours: ColourEncoding) -> (Arc<Mesh>, Notes) {
        let params =
            LoadMesh { path: InputFile(path.to_owned()), frame: MeshFrame::World, colours, matrix: None };
        let (out, notes) = LoadMesh::run(&params, load_mesh::In {}, &self.context()).unwrap();
        (out.mesh, notes)
    }

    /// The default scene of a glTF file.
    pub fn object(&self, path: &str) -> (Arc<Object>, Notes) {
        let params = LoadObject::of(InputFile(path.to_owned()));
        let (out, notes) = LoadObject::run(&params, load_object::In {}, &self.context()).unwrap();
        (out.object, notes)
    }

    /// The environment in a file, not rotated or changed in any other way.
    pub fn environment(&self, path: &str) -> (Arc<Environment>, Notes) {
        let params = LoadEnvironment {
            path: InputFile(path.to_owned()),
            encoding: FileEncoding::Auto,
            layer: String::new(),
            rotation_deg: 0.0,
            scale: 1.0,
            origin: None,
        };
        let (out, notes) = LoadEnvironment::run(&params, load_environment::In {}, &self.context()).unwrap();
        (out.env, notes)
    }

    /// Cameras from the list `list` in a file: all of them if `pick` is empty, otherwise those whose names match an
    /// entry of `pick`.
    pub fn cameras(&self, path: &str, list: &str, pick: &[&str]) -> Arc<Rig> {
        let pick = pick.iter().map(|name| load_cameras::Pick::from(*name)).collect();
        let params =
            LoadCameras { pick, list: list.to_owned(), ..LoadCameras::of(InputFile(path.to_owned())) };
        LoadCameras::run(&params, load_cameras::In {}, &self.context()).unwrap().0.rig
    }
}
