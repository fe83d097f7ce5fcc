//! `write-splats`: splats as a file.

use std::sync::Arc;

use engine::{Artifact, Context, ContextField, Cost, FileBytes, Files, Kind, NodeError, Notes, OutputFile};
use scene::io::splats::save::{SaveFormat, encode};
use scene::types::Splats;

engine::params! {
    /// Writes splats as INRIA PLY or SPZ, depending on the extension of the path: splats that the graph trained, or
    /// splats from a file after the transform and the rotation of their loader.
    ///
    /// PLY has the coordinates of the world and stores every number. SPZ is about a tenth as large: numbers are
    /// quantised, and the splats are rotated from the up axis of the scene to +y. Data that the format cannot store
    /// are reported. `lightharmony convert` writes the same files without a graph.
    pub struct WriteSplats {
        /// The file: `.ply` or `.spz`.
        path: OutputFile, other("\"b.spz\"");
    }
}
engine::inputs! {
    /// Inputs of [`WriteSplats`].
    pub struct In {
        /// The splats.
        splats: Arc<Splats>,
    }
}
engine::outputs! {
    /// The written file.
    pub struct Out {
        /// List of one file.
        files: Arc<Files>,
    }
}

impl Kind for WriteSplats {
    const NAME: &'static str = "write-splats";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.path.0.contains("{view}") {
            let text = "`{view}` is not allowed here: splats are written to a single file for all views";
            return Err(NodeError::new(text).at("path").hint("remove `{view}` from `path`"));
        }
        SaveFormat::of_path(&p.path.0).map(|_| ()).ok_or_else(|| {
            NodeError::new(format!("cannot write splats as `.{}`", p.path.extension()))
                .at("path")
                .hint("end the path in `.ply` or `.spz`")
        })
    }

    fn estimate(_: &Self, In { splats }: &In) -> Cost {
        // Twice the rows: in parts and joined, or rotated. A row of PLY is at most 1.3 times as long as a splat.
        Cost { bytes: 3 * splats.bytes() as u64 }
    }

    fn run(p: &Self, In { splats }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        Self::check(p)?;
        let format = SaveFormat::of_path(&p.path.0).unwrap_or(SaveFormat::Ply);
        if splats.is_empty() {
            let text = "there are no splats to write";
            return Err(NodeError::new(text).hint("check the warnings of the node that makes the splats"));
        }
        let (bytes, notes) = encode(&splats, format, Some(cx.up()), cx)?;
        let file = FileBytes { view: String::new(), bytes };
        Ok((Out { files: Arc::new(Files(vec![file])) }, notes))
    }
}

#[cfg(test)]
mod tests {
    use scene::io::splats::{Frame, from_bytes};
    use testing::context;

    use super::*;

    fn scene() -> Splats {
        let mut scene = Splats::empty();
        scene.sh_degree = 1;
        for i in 0..100 {
            let x = i as f32 / 50.0 - 1.0;
            scene.means.push([x, 0.5 * x, 0.25]);
            scene.scales.push([0.01, 0.02, 0.03]);
            scene.quats.push([1.0, 0.0, 0.0, 0.0]);
            scene.opacities.push(0.5);
            scene.sh.extend((0..4).map(|k| [0.1 * x, 0.05 * k as f32, 0.2]));
        }
        scene
    }

    fn written(scene: &Splats, path: &str) -> Result<Vec<u8>, NodeError> {
        let params = WriteSplats { path: OutputFile(path.to_owned()) };
        let (out, _) = WriteSplats::run(&params, In { splats: Arc::new(scene.clone()) }, &context())?;
        Ok(out.files.0[0].bytes.clone())
    }

    /// Splats are read back where they were: exactly from PLY, within the steps of the format from SPZ, which is
    /// rotated there and back. This test fails if the splats are not rotated to the axis of SPZ.
    #[test]
    fn what_is_written_is_read_back() {
        let scene = scene();
        for (path, most) in [("a.ply", 1e-6), ("a.SPZ", 1e-3)] {
            let bytes = written(&scene, path).expect("writes");
            let (read, _) = from_bytes(path, &bytes, Frame::ByFormat, &context()).expect("reads");
            assert_eq!((read.len(), read.sh_degree), (scene.len(), 1), "{path}");
            for (a, b) in read.means.as_flattened().iter().zip(scene.means.as_flattened()) {
                assert!((a - b).abs() <= most, "{path}: {a} {b}");
            }
        }
    }

    #[test]
    fn other_files_and_empty_scenes_are_refused() {
        for (path, says) in [("a.sog", "cannot write splats as `.sog`"), ("{view}.ply", "`{view}`")] {
            let error = WriteSplats::check(&WriteSplats { path: OutputFile(path.to_owned()) }).err();
            assert!(error.is_some_and(|error| error.message().contains(says)), "{path}");
        }
        let error = written(&Splats::empty(), "a.ply").expect_err("is refused");
        assert!(error.message().contains("no splats"), "{error}");
    }
}
