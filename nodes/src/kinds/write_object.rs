//! `write-object`: placed objects as a file.

use std::sync::Arc;

use engine::{Context, ContextField, Cost, FileBytes, Files, Kind, NodeError, Notes, OutputFile};
use glam::DMat3;
use scene::io::gltf::write::encode;
use scene::io::splats::from_y_up;
use scene::types::{Object, Placed, Primitive};

engine::choices! {
    /// Frame of the coordinates of a file with objects.
    pub enum ObjectFrame {
        /// The coordinates of the world, as in PLY files of `write-splats`.
        World,
        /// Rotated from the up axis of the scene to +y, as in SPZ files of `write-splats`.
        YUp,
    }
}

engine::params! {
    /// Writes placed objects as GLB, for a viewer that shows them with the splats of `write-splats`.
    ///
    /// The unit of the file is that of the splats, so that objects and splats agree without a further transform.
    /// Viewers of glTF take the unit as a metre, which is right if `metres_per_unit` of the scene is 1.
    ///
    /// Each object is a node with its transform. Shapes, materials with their extensions, and textures (as PNG) are
    /// those that the renderer uses. Occlusion maps, which it does not use, are not part of the file. A transform with
    /// a shear, which glTF cannot store, is applied to the vertices. Rasterizers need the thickness of transparent
    /// bodies: the file states the shortest side of the bounding box of their surface.
    pub struct WriteObject {
        /// The file: `.glb`.
        path: OutputFile, other("\"b.glb\"");
        /// Frame of the coordinates.
        frame: ObjectFrame = ObjectFrame::World, other("YUp");
    }
}
engine::inputs! {
    /// Inputs of [`WriteObject`].
    pub struct In {
        /// The objects. Equal objects are stored once.
        objects: Vec<Arc<Placed>>,
    }
}
engine::outputs! {
    /// The written file.
    pub struct Out {
        /// List of one file.
        files: Arc<Files>,
    }
}

impl Kind for WriteObject {
    const NAME: &'static str = "write-object";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.path.0.contains("{view}") {
            let text = "`{view}` is not allowed here: objects are written to a single file for all views";
            return Err(NodeError::new(text).at("path").hint("remove `{view}` from `path`"));
        }
        match p.path.extension().as_str() {
            "glb" => Ok(()),
            other => Err(NodeError::new(format!("cannot write objects as `.{other}`"))
                .at("path")
                .hint("end the path in `.glb`; `WriteMesh` writes other formats, without materials")),
        }
    }

    fn estimate(_: &Self, inputs: &In) -> Cost {
        let objects = || inputs.objects.iter().map(|placed| &*placed.object);
        let texels = || objects().flat_map(|object| &object.textures).map(|t| t.rgba.len() as u64 / 4);
        // Compressed pictures are at most slightly longer than their texels. One picture at a time is converted to 8
        // bytes per texel and compressed to 4, and its file grows to 12 for a moment.
        let largest = texels().max().unwrap_or(0);
        let compressing = Cost::of(texels().map(|texels| (texels, 4)).chain([(largest, 21)]));
        // The pictures and the file; then the file and a copy of it while it is stored.
        let shapes = objects().map(|object| (geometry(object), 2));
        let writing = Cost::of(shapes.chain(texels().map(|texels| (texels, 8))));
        Cost { bytes: compressing.bytes.max(writing.bytes) }
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        Self::check(p)?;
        let rotation = match p.frame {
            ObjectFrame::World => DMat3::IDENTITY,
            ObjectFrame::YUp => from_y_up(cx.up()).transpose(),
        };
        let (bytes, notes) = encode(&inputs.objects, rotation, cx).map_err(|e| e.at("objects"))?;
        let file = FileBytes { view: String::new(), bytes };
        Ok((Out { files: Arc::new(Files(vec![file])) }, notes))
    }
}

/// Bytes of the arrays of vertices and indices of an object.
fn geometry(object: &Object) -> u64 {
    let bytes = |p: &Primitive| {
        let arrays = [
            12 * p.positions.len(),
            12 * p.normals.len(),
            16 * p.tangents.len(),
            8 * (p.uv0.len() + p.uv1.len()),
            16 * p.colours.len(),
            12 * p.triangles.len(),
        ];
        arrays.iter().sum::<usize>() as u64
    };
    object.primitives.iter().map(bytes).sum()
}

#[cfg(test)]
mod tests {
    use engine::{InputFile, Scene, Up};
    use glam::{DMat4, DVec3};
    use scene::io::gltf::Want;
    use scene::io::gltf::object::object;
    use scene::io::splats::save::{SaveFormat, encode as encode_splats};
    use scene::io::splats::{Frame, from_bytes};
    use scene::types::{Material, Sampler, Splats, Texture, TextureRef, Wrap};
    use testing::context;

    use super::*;

    /// A triangle whose first corner is at the origin.
    fn triangle() -> Object {
        let primitive = Primitive {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            ..Primitive::default()
        };
        Object { primitives: vec![primitive], materials: vec![Material::default()], textures: Vec::new() }
    }

    fn at(place: DVec3) -> Arc<Placed> {
        let world_from_object = DMat4::from_translation(place);
        Arc::new(Placed { object: Arc::new(triangle()), world_from_object })
    }

    fn written(frame: ObjectFrame, objects: Vec<Arc<Placed>>, cx: &Context) -> Result<Vec<u8>, NodeError> {
        let params = WriteObject { path: OutputFile("a.GLB".to_owned()), frame };
        let (out, _) = WriteObject::run(&params, In { objects }, cx)?;
        Ok(out.files.0[0].bytes.clone())
    }

    /// An object stands in the file where a splat at the same place stands in PLY (`World`) and in SPZ (`YUp`), in
    /// the same unit. This test fails if either frame is rotated another way, or if `metres_per_unit` scales it.
    #[test]
    fn objects_and_splats_are_in_the_same_frame() {
        let place = DVec3::new(1.5, -2.25, 0.75);
        let splats = Splats {
            means: vec![place.as_vec3().to_array()],
            scales: vec![[0.01; 3]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]],
            opacities: vec![0.5],
            sh: vec![[0.1; 3]],
            ..Splats::empty()
        };
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            let cx = Context::detached(Scene { up, metres_per_unit: 0.5, seed: 7, exhaustive: false }, ".");
            let files = [
                (ObjectFrame::World, SaveFormat::Ply, "a.ply"),
                (ObjectFrame::YUp, SaveFormat::Spz, "a.spz"),
            ];
            for (frame, format, name) in files {
                let bytes = written(frame, vec![at(place)], &cx).expect("writes");
                let (file, mut notes) = (InputFile("a.glb".to_owned()), Notes::none());
                let read =
                    object(&file, &bytes, Want::Everything, (None, None), &cx, &mut notes).expect("reads");
                let (bytes, _) = encode_splats(&splats, format, Some(cx.up()), &cx).expect("writes");
                let (same, _) = from_bytes(name, &bytes, Frame::AsStored, &cx).expect("reads");
                assert_eq!(read.primitives[0].positions[0], same.means[0], "{up:?} {name}");
            }
        }
    }

    /// The estimate covers the file and its copy, with a picture that no compression makes shorter.
    #[test]
    fn the_estimate_covers_the_file() {
        let noise = |i: u64| (i.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_pow(3) >> 41) as u8;
        let rgba = (0..256 * 256 * 4).map(noise).collect();
        let mut noisy = triangle();
        noisy.textures.push(Texture { width: 256, height: 256, rgba });
        let sampler = Sampler { wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false };
        noisy.materials[0].emissive_texture =
            Some(TextureRef { texture: 0, uv_set: 0, sampler, transform: None });
        let objects = vec![Arc::new(Placed { object: Arc::new(noisy), world_from_object: DMat4::IDENTITY })];
        let most = WriteObject::estimate(&params("a.glb"), &In { objects: objects.clone() }).bytes;
        let file = written(ObjectFrame::World, objects, &context()).expect("writes").len() as u64;
        assert!(file > 200_000 && (2 * file..10 * file).contains(&most), "{most} bytes for a file of {file}");
    }

    fn params(path: &str) -> WriteObject {
        WriteObject { path: OutputFile(path.to_owned()), frame: ObjectFrame::World }
    }

    #[test]
    fn other_files_and_objects_that_are_empty_are_refused() {
        for (path, says) in [("a.gltf", "cannot write objects as `.gltf`"), ("{view}.glb", "`{view}`")] {
            let error = WriteObject::check(&params(path)).err();
            assert!(error.is_some_and(|error| error.message().contains(says)), "{path}");
        }
        let error = written(ObjectFrame::World, Vec::new(), &context()).expect_err("is refused");
        assert!(error.message().contains("no triangles to write") && error.advice().is_some(), "{error}");
    }
}
