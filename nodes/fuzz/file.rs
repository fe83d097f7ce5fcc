//! Fuzz targets for readers that read files from a folder. They are called through the kind that uses the reader.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use engine::{Context, InputFile, Kind, NodeError, Notes, Scene, SourceRoot, Up};
use nodes::kinds::load_cameras::{self, Distortion, LoadCameras};
use nodes::kinds::load_mesh::{self, ColourEncoding, LoadMesh, MeshFrame};
use nodes::kinds::load_object::{self, LoadObject};
use nodes::kinds::load_splats::{self, LoadSplats};
use scene::io::gltf::animation::AfterEnd;
use scene::io::splats::Frame;

/// Path of a folder for the files of this process. The folder is in memory if the system has `/dev/shm`.
pub fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let memory = Path::new("/dev/shm");
        let base = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
        let folder = base.join(format!("lightharmony-fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("the folder for the files of a target must be writable");
        folder
    })
}

/// Writes files and runs a kind on them. As in the engine, `sources` is called before `run`.
fn run<K: Kind>(
    params: &K::Params,
    inputs: K::In,
    files: &[(&str, &[u8])],
) -> Result<(K::Out, Notes), NodeError> {
    for (name, bytes) in files {
        std::fs::write(folder().join(name), bytes).expect("the files of a target must be writable");
    }
    let root = SourceRoot::new(folder());
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
    K::sources(params, &root)?;
    K::views(params, &root);
    K::run(params, inputs, &Context::detached(scene, folder()))
}

/// Writes `files`, which are pairs of name and content, and reads cameras from the file `path`. All numbers must be
/// finite, also those of rays. Returns true if the file was read.
pub fn cameras(path: &str, files: &[(&str, &[u8])]) -> bool {
    let params = LoadCameras {
        path: InputFile(path.to_owned()),
        pick: Vec::new(),
        list: "views".to_owned(),
        resolution: 1.0,
        distortion: Distortion::Apply,
        dataparser: None,
        matrix: None,
        clip: None,
        time_s: 0.0,
        after_end: AfterEnd::Refuse,
    };
    let Ok((out, _)) = run::<LoadCameras>(&params, load_cameras::In {}, files) else { return false };
    for camera in &out.rig.cameras {
        let lens = [camera.fx, camera.fy, camera.cx, camera.cy];
        assert!(lens.iter().chain(&camera.world_from_camera).all(|v| v.is_finite()));
        assert!(camera.width_px > 0 && camera.height_px > 0);
        let [width, height] = [camera.width_px, camera.height_px].map(f64::from);
        for [x, y] in [[0.0, 0.0], [width, height], [0.5 * width, 0.0], [camera.cx, camera.cy]] {
            assert!(camera.ray(x, y).is_finite());
        }
    }
    true
}

/// Writes `data` to the file `name`, and reads it as the mesh of a place. All indices must be valid. Returns true if
/// the file was read.
pub fn mesh(name: &str, data: &[u8]) -> bool {
    let path = InputFile(name.to_owned());
    let params = LoadMesh { path, colours: ColourEncoding::Auto, frame: MeshFrame::World, matrix: None };
    let Ok((out, _)) = run::<LoadMesh>(&params, load_mesh::In {}, &[(name, data)]) else { return false };
    let vertices = out.mesh.positions.len();
    assert!(out.mesh.triangles.as_flattened().iter().all(|&index| (index as usize) < vertices));
    true
}

/// Writes `data` to the file `name`, and reads it as an object. All indices must be valid. Returns true if the file
/// was read.
pub fn object(name: &str, data: &[u8]) -> bool {
    let path = InputFile(name.to_owned());
    let params = LoadObject { path, scene: None, clip: None, time_s: 0.0, after_end: AfterEnd::Refuse };
    let Ok((out, _)) = run::<LoadObject>(&params, load_object::In {}, &[(name, data)]) else { return false };
    for primitive in &out.object.primitives {
        let vertices = primitive.positions.len();
        assert!(primitive.triangles.as_flattened().iter().all(|&index| (index as usize) < vertices));
    }
    true
}

/// Writes `files`, which may be damaged, and loads the level `level` of the streamed scene that `lod-meta.json`
/// describes. All positions must be finite. Returns true if the scene was read.
pub fn streamed(level: u32, files: &[(&str, &[u8])]) -> bool {
    let params = LoadSplats {
        path: InputFile("lod-meta.json".to_owned()),
        more: Vec::new(),
        strict: false,
        max_extent: 1e6,
        level,
        frame: Frame::ByFormat,
        matrix: None,
    };
    let Ok((out, _)) = run::<LoadSplats>(&params, load_splats::In {}, files) else { return false };
    assert!(out.splats.means.as_flattened().iter().all(|v| v.is_finite()));
    true
}

/// Splits `data` into two parts. The first two bytes of `data` are the length of the first part.
pub fn halves(data: &[u8]) -> (&[u8], &[u8]) {
    let Some((head, rest)) = data.split_first_chunk::<2>() else { return (data, &[]) };
    rest.split_at(usize::from(u16::from_le_bytes(*head)).min(rest.len()))
}
