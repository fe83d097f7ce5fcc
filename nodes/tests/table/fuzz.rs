//! The functions of the fuzz targets, whose crate is not part of the workspace.

#[path = "../../fuzz/target.rs"]
mod target;

use target::file;

use crate::files;

/// A picture of one texel, grey and opaque, as lossless WebP.
const WEBP: &[u8] = b"RIFF\x1e\0\0\0WEBPVP8L\x11\0\0\0/\0\0\0\0\x07P\xc0\x02\x16\xb0\xff\x81\x88\xe8\x7f\0\0";

/// The list of a streamed scene with one level of one splat, and the description of its pictures.
fn streamed_scene() -> [String; 2] {
    let book = vec!["-1.0"; 256].join(",");
    let list = r#"{"lodLevels": 1, "filenames": ["meta.json"],
        "tree": {"lods": {"0": {"file": 0, "offset": 0, "count": 1}}}}"#;
    let meta = format!(
        r#"{{"version": 2, "count": 1,
        "means": {{"mins": [-1, -1, -1], "maxs": [1, 1, 1], "files": ["a.webp", "a.webp"]}},
        "scales": {{"codebook": [{book}], "files": ["a.webp"]}}, "quats": {{"files": ["a.webp"]}},
        "sh0": {{"codebook": [{book}], "files": ["a.webp"]}}}}"#
    );
    [list.to_owned(), meta]
}

/// Each function of the fuzz targets reads a valid file and survives a damaged one. This test does not compile if the
/// targets do not, and fails if one of their functions writes or reads other files than the kind looks for.
#[test]
fn functions_of_the_fuzz_targets_read_files() {
    let cut = |bytes: &[u8]| bytes[..bytes.len() / 2].to_vec();
    let splats = files::splats_ply(3);
    assert!(target::read(b"ply\n", &splats[4..]) && !target::read(b"", &cut(&splats)));
    let picture = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n\x80\x80\x80\x80\x80\x80\x80\x84";
    assert!(target::picture(picture) && !target::picture(&cut(picture)));
    let mesh = files::MESH_PLY.as_bytes();
    assert!(file::mesh("a.ply", mesh) && !file::mesh("a.ply", &cut(mesh)));
    let object = files::object_glb();
    assert!(file::object("a.glb", &object) && !file::object("a.glb", &cut(&object)));
    let json = files::CAMERAS_JSON.as_bytes();
    assert!(
        file::cameras("c.json", &[("c.json", json)]) && !file::cameras("c.json", &[("c.json", &cut(json))])
    );
    let [cameras, images, _] = files::colmap_model(0.0);
    // The first two bytes are the length of the first part.
    let both = [&(cameras.len() as u16).to_le_bytes()[..], &cameras, &images].concat();
    let colmap = |data: &[u8]| {
        let (cameras, images) = file::halves(data);
        file::cameras("cameras.bin", &[("cameras.bin", cameras), ("images.bin", images)])
    };
    assert!(colmap(&both) && !colmap(&cut(&both)));
    let [list, meta] = streamed_scene();
    let scene = |list: &[u8]| {
        let files = [("lod-meta.json", list), ("meta.json", meta.as_bytes()), ("a.webp", WEBP)];
        file::streamed(0, &files)
    };
    assert!(scene(list.as_bytes()) && !scene(&cut(list.as_bytes())));
    std::fs::remove_dir_all(file::folder()).expect("the folder exists");
}
