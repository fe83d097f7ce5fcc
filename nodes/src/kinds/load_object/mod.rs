//! `load-object`: loads an object to insert.

use std::io::{Seek, SeekFrom};
use std::sync::Arc;

use engine::{Context, Cost, FileHead, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot};
use render::geometry::inward;
use scene::io::foreign::json_text;
use scene::io::gltf::animation::{Moment, check_clip};
use scene::io::gltf::object::{object, sources};
use scene::io::gltf::{self, Want};
use scene::io::head::Head;
use scene::io::import::Foreign;
use scene::types::Object;

pub use scene::io::gltf::animation::AfterEnd;

engine::params! {
    /// Loads an object to insert: glTF or GLB, Wavefront OBJ with its materials, or STL.
    ///
    /// Node transforms, instances, morph weights and skins are applied as stored in the file, or with `clip` as an
    /// animation of the file sets them at `time_s`. For a film, give `time_s` a value per frame:
    /// `time_s: Axis("t")`. The faces of a closed shape that is inside out are reversed. Textures may be PNG, JPEG or
    /// WebP.
    ///
    /// Materials are metallic-roughness with all their textures and with these KHR extensions: transmission,
    /// volume, ior, clearcoat, sheen, specular, anisotropy, iridescence, diffuse transmission, emissive strength,
    /// unlit. Specular-glossiness materials are converted to the extensions ior and specular.
    /// A file that requires any other extension is refused. An optional extension that is not supported is
    /// reported; if its effect would be visible, the result is marked as degraded.
    pub struct LoadObject {
        /// The file: `.glb`, `.stl`, or `.gltf` and `.obj` with the files that they refer to.
        path: InputFile, other("\"b.glb\"");
        /// Index of the scene in the file, from 0. If not given, the default scene of the file is used.
        scene: Option<u32> = None, range(0, 65535), other("Some(1)"), inert("most files have one scene");
        /// Name of the animation of a glTF file that places the parts of the object. An animation without a name is
        /// named by its index, such as `"0"`. If not given, the parts are placed as stored in the file.
        clip: Option<String> = None, other("Some(\"walk\")"), inert("most files have no animation");
        /// Time in the animation. Before its first key, the animation has the pose of this key.
        time_s: f64 = 0.0, range(0, 86400), unit("s"), other("0.5"), inert("needs `clip`");
        /// Treatment of times after the end of the animation.
        after_end: AfterEnd = AfterEnd::Refuse, other("Hold"), inert("needs `clip`");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`LoadObject`].
    pub struct Out {
        /// The object in the frame of its file: y up, metres.
        object: Arc<Object>,
    }
}

impl LoadObject {
    /// A file, and the default of every other parameter.
    pub fn of(path: InputFile) -> Self {
        Self { path, scene: None, clip: None, time_s: 0.0, after_end: AfterEnd::Refuse }
    }
}

impl Kind for LoadObject {
    const NAME: &'static str = "load-object";
    const VERSION: u32 = 8;
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        check_clip(p.clip.as_deref(), p.time_s)
    }

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        sources(&p.path, root)
    }

    fn estimate_files(_: &Self, files: &[FileHead<'_>]) -> Cost {
        let all = files.iter().fold(0, |sum: u64, file| sum.saturating_add(file.bytes));
        // External and embedded pictures: in the worst case all are decoded at the same time.
        let external = files.iter().filter_map(|file| Head::read(&mut file.open()?));
        let pictures = external.chain(files.first().into_iter().flat_map(pictures_inside));
        let texels = pictures.map(|head| head.as_texels()[0]).fold(0, u64::saturating_add);
        // The files, their geometry as floats, again as triangles of the object, and the edges of the triangles with
        // the places of the vertices.
        // The text of an OBJ file is read to lists and a table of corners first.
        let foreign = files.first().is_some_and(|file| Foreign::of(file.name).is_some());
        Cost { bytes: all.saturating_mul(if foreign { 16 } else { 10 }).saturating_add(texels) }
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let bytes = cx.read(&p.path).map_err(|e| e.at("path"))?;
        let moment = p.clip.as_deref().map(|clip| Moment { clip, seconds: p.time_s, after_end: p.after_end });
        let mut object = object(&p.path, &bytes, Want::Everything, (p.scene, moment), cx, &mut notes)
            .map_err(|e| e.at("path"))?;
        inward::turn(&mut object.primitives, &object.materials, cx, &mut notes)?;
        let triangles: usize = object.primitives.iter().map(|part| part.triangles.len()).sum();
        cx.count("triangles", triangles as u64);
        Ok((Out { object: Arc::new(object) }, notes))
    }
}

/// Headers of the pictures embedded in a GLB file.
fn pictures_inside(file: &FileHead<'_>) -> Vec<Head> {
    let read = || {
        let mut reader = file.open()?;
        let (json, binary) = gltf::json_in(&mut reader).ok()??;
        let json: serde_json::Value = serde_json::from_slice(json_text(&json)).ok().filter(|_| binary)?;
        // The binary chunk begins after its own length and type.
        let start = reader.stream_position().ok()? + 8;
        let views = json["images"].as_array()?.iter().filter_map(|image| image["bufferView"].as_u64());
        let mut heads = Vec::new();
        for view in views {
            let offset = json["bufferViews"][view as usize]["byteOffset"].as_u64().unwrap_or(0);
            reader.seek(SeekFrom::Start(start.saturating_add(offset))).ok()?;
            heads.extend(Head::read(&mut reader));
        }
        Some(heads)
    };
    read().unwrap_or_default()
}
