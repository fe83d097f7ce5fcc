//! `load-splats`: a scene of Gaussian splats from a file.

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, FileHead, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot,
    Up,
};
use glam::DVec3;
use render::geometry::level::{self, LevelEstimate};
use scene::io::splats::{SplatFiles, size};
use scene::math::{equirect, num};
use scene::types::Splats;
use scene::types::frame::Similarity;

pub use scene::io::splats::Frame;

engine::params! {
    /// Loads a scene of Gaussian splats.
    ///
    /// The format is detected by content, not by the file extension:
    ///
    /// - INRIA PLY, binary or ASCII, with spherical harmonics of degree 0 to 4. `filter_3D` of Mip-Splatting and
    ///   MILo is applied. Splats may have two scales, as in 2DGS, and `red`, `green` and `blue` in place of
    ///   `f_dc_*`. Other extra fields are ignored.
    /// - PlayCanvas compressed PLY.
    /// - SOG versions 1 and 2: `meta.json` or its folder, a folder of chunks (joined in the order of their names),
    ///   a streamed scene with `lod-meta.json` (one `level` is loaded), or a `.sog` bundle.
    /// - SPZ versions 1 to 4.
    /// - `.splat` and `.ksplat`.
    /// - glTF or GLB with `KHR_gaussian_splatting`.
    /// - USD as text with `ParticleField3DGaussianSplat`.
    ///
    /// Rows that cannot be drawn are dropped and counted by reason.
    ///
    /// SPZ and glTF define +y as up, so their scenes are rotated to the `up` of the graph's scene, like objects:
    /// (x, y, z) becomes (x, -z, y) for +z and (x, -y, -z) for -y. Coordinates of glTF are metres and are also
    /// divided by `metres_per_unit`. USD states its up axis and its unit, and is converted likewise. The other formats
    /// define no up axis, and their coordinates are used as stored. Set `up` of the graph's scene to the up axis of
    /// the file, which is usually -y for INRIA PLY, and +z for files with the comment `Vertical Axis: z`, which
    /// nerfstudio writes. `frame` overrides these rules: `AsStored` reads SPZ files of splat-transform 3, which have the
    /// axes of its input.
    pub struct LoadSplats {
        /// The file, or the folder of a SOG scene.
        path: InputFile, other("\"b.ply\"");
        /// More files of the same scene, such as the chunks of a capture; appended in this order.
        more: Vec<InputFile> = Vec::new(), other("[\"b.ply\"]");
        /// True to fail at the first row that would be dropped. The error then names this row.
        strict: bool = false, inert("the output does not change unless there is an error");
        /// Maximum length of the axes of a splat. Splats with a longer axis are dropped: they hide the scene, and
        /// usually mean that scales were not stored as logarithms.
        max_extent: f64 = 1e6, range(1e-12, 1e30), unit("world units"), other("0.2");
        /// Level of detail of a streamed SOG scene; 0 is the finest.
        level: u32 = 0, range(0, 64), other("1"), inert("only streamed scenes have levels");
        /// Up axis of the file, defined by its format or given here.
        frame: Frame = Frame::ByFormat, other("YUp");
        /// Rotation, uniform scale and translation applied after `frame`: a 4x4 matrix in row-major order.
        /// Spherical harmonics are rotated too. The matrix can make a tilted capture upright, such as one from
        /// COLMAP. Give `load-cameras` and `load-mesh` the same matrix. `lightharmony init` writes it into all
        /// three nodes.
        matrix: Option<[f64; 16]> = None, other("Some((0.0, -1.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0))");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`LoadSplats`].
    pub struct Out {
        /// The scene, with opacities and scales activated.
        splats: Arc<Splats>,
    }
}

impl Kind for LoadSplats {
    const NAME: &'static str = "load-splats";
    const VERSION: u32 = 7;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const STORE: Keep = Keep::Cheap;
    const FOLDERS: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(params: &Self) -> Result<(), NodeError> {
        Similarity::of_parameter(params.matrix.as_ref()).map(|_| ())
    }

    fn estimate_files(_: &Self, files: &[FileHead<'_>]) -> Cost {
        // Each file with its unpacked data and its rows; at the end the rows of all files and the resulting scene.
        let (mut rows, mut most) = (0_u64, 0_u64);
        for file in files {
            let (own, unpacked) = size::of(file);
            most = most.max(rows.saturating_add(own).saturating_add(unpacked).saturating_add(file.bytes));
            rows = rows.saturating_add(own);
        }
        Cost { bytes: most.max(rows.saturating_mul(2)) }
    }

    fn sources(params: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        params.files().sources(root)
    }

    fn run(params: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let (splats, mut notes) = params.files().splats(cx)?;
        cx.count("splats", splats.len() as u64);
        if splats.is_empty() {
            notes.degraded("no-splats", "the scene contains no splat that can be drawn");
        }
        // A comment of the file has the same meaning.
        let reported = notes.iter().any(|note| note.id == "up-differs");
        if let Some(text) = other_up(&splats, params.matrix.as_ref(), cx)?.filter(|_| !reported) {
            notes.warning("up-differs", text);
        }
        Ok((Out { splats: Arc::new(splats) }, notes))
    }
}

impl LoadSplats {
    /// The files that the parameters name.
    fn files(&self) -> SplatFiles {
        SplatFiles {
            path: self.path.clone(),
            more: self.more.clone(),
            strict: self.strict,
            max_extent: self.max_extent,
            level: self.level,
            frame: self.frame,
            matrix: self.matrix,
        }
    }

    /// Reads the scene without the harmonics above degree 0, which saves memory. Also returns the degree of the
    /// harmonics in the files. The notes are the notes that [`run`](Kind::run) adds about the files.
    ///
    /// # Errors If [`run`](Kind::run) would fail.
    pub fn plain(&self, cx: &Context) -> Result<(Splats, u32, Notes), NodeError> {
        self.files().plain(cx)
    }
}

/// Largest angle in degrees between two up directions that count as the same. A reliable estimate is within 5
/// degrees.
const SAME_UP_DEG: f64 = 8.0;

/// Text of a warning that the floor of the scene points to an up axis other than the up axis of the graph. `None`
/// if they agree, or if the floor is not found with certainty. `matrix` is the parameter of the loader.
fn other_up(splats: &Splats, matrix: Option<&[f64; 16]>, cx: &Context) -> Result<Option<String>, NodeError> {
    let Some(found) = level::of_sample(splats).filter(LevelEstimate::is_sure) else { return Ok(None) };
    let turn = found.turn_to(equirect::axes(cx.up())[2]);
    let turn = Similarity { rotation: turn, ..Similarity::IDENTITY };
    let upright = turn.after(&Similarity::of_parameter(matrix)?);
    Ok(up_text(DVec3::from_array(found.up), found.axis(), cx.up(), &upright))
}

/// Text of the warning for a scene whose measured up direction is `found`, which is also called `axis` if it is an
/// axis. `upright` is the value of `matrix` that turns the scene upright. `None` if `found` agrees with `up`.
fn up_text(found: DVec3, axis: Option<&str>, up: Up, upright: &Similarity) -> Option<String> {
    let cosine = found.dot(equirect::axes(up)[2]);
    let angle = num::f64::acos(cosine.clamp(-1.0, 1.0)).to_degrees();
    if angle <= SAME_UP_DEG {
        return None;
    }
    let [x, y, z] = found.to_array();
    let named = axis.map_or_else(|| format!("({x:.3}, {y:.3}, {z:.3})"), str::to_owned);
    let other = [Up::PlusZ, Up::PlusY, Up::MinusY].into_iter().find(|other| axis == Some(other.name()));
    let remedy = match other {
        Some(other) => {
            format!(
                "set `up: \"{}\"` in the graph's scene, or set `frame` or `matrix` of this node",
                other.name()
            )
        }
        // The scene accepts no such axis.
        None => {
            // Adding 0 turns -0 into 0.
            let rows: Vec<String> =
                upright.rows().iter().map(|v| format!("{:?}", (v * 1e6).round() / 1e6 + 0.0)).collect();
            format!(
                "set `matrix: Some(({}))` on this node, and rotate the cameras and the mesh of the scene likewise",
                rows.join(", ")
            )
        }
    };
    Some(format!(
        "judging by its floor, the up axis of the scene is {named}, but `up` of the graph's scene is {}, {angle:.0} \
         degrees away; {remedy} (`lightharmony inspect` shows the scene)",
        up.name()
    ))
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DQuat};

    use super::*;
    use render::splat::{Settings, render};
    use scene::io::splats::save::{SaveFormat, encode};
    use scene::types::Camera;

    /// A scene is reported if its floor and walls show that its up axis is -y, which is usual for INRIA files. This
    /// test fails if `angle <= SAME_UP_DEG` is changed to `angle > SAME_UP_DEG`.
    #[test]
    fn another_axis_up_than_the_floor_says_is_reported() {
        let mut scene = Splats::empty();
        let mut put = |mean: [f32; 3], scale: [f32; 3]| {
            scene.means.push(mean);
            scene.scales.push(scale);
            scene.quats.push([1.0, 0.0, 0.0, 0.0]);
            scene.opacities.push(0.9);
            scene.sh.push([0.1; 3]);
        };
        let grid =
            || (0..60).flat_map(|i| (0..60).map(move |j| (i as f32 * 0.1 - 3.0, j as f32 * 0.1 - 3.0)));
        for (x, z) in grid() {
            // The floor, at y = 0; things on it lie at negative y.
            put([x, 0.0, z], [0.05, 0.002, 0.05]);
            if x.abs() < 0.5 && z.abs() < 0.5 {
                put([x, -0.7, z], [0.05, 0.002, 0.05]);
            }
        }
        for (x, y) in grid().filter(|(_, y)| *y < -0.5) {
            put([x, y + 0.5, 3.0], [0.05, 0.05, 0.002]);
            put([3.0, y + 0.5, x], [0.002, 0.05, 0.05]);
        }
        let of = |up: Up| {
            let block = engine::Scene { up, metres_per_unit: 1.0, seed: 0, exhaustive: false };
            other_up(&scene, None, &Context::detached(block, ".")).unwrap_or_else(|e| panic!("{e}"))
        };
        let sure = level::of_splats(&scene, None).is_some_and(|found| found.is_sure());
        assert_eq!(of(Up::MinusY), None);
        assert_eq!(of(Up::PlusZ).is_some_and(|text| text.contains("is -y, but")), sure);
    }

    /// Any difference above 8 degrees is reported, and the remedy is one that the graph accepts: `up` has only
    /// three values. This test fails if `SAME_UP_DEG` is 25.
    #[test]
    fn the_remedy_for_another_up_is_possible() {
        let text = |found: DVec3, axis: Option<&str>, up: Up, rotation: DMat3| {
            up_text(found, axis, up, &Similarity { rotation, ..Similarity::IDENTITY })
        };
        let tilted = |degrees: f64| {
            let angle = degrees.to_radians();
            let (sin, cos) = (num::f64::sin(angle), num::f64::cos(angle));
            let rotation = DMat3::from_cols(DVec3::X, DVec3::new(0.0, cos, -sin), DVec3::new(0.0, sin, cos));
            text(DVec3::new(0.0, -sin, cos), None, Up::PlusZ, rotation)
        };
        assert_eq!(tilted(6.0), None);
        let found = tilted(20.0).expect("reported");
        let matrix = "set `matrix: Some((1.0, 0.0, 0.0, 0.0, 0.0, 0.939693, 0.34202, 0.0, 0.0, -0.34202, 0.939693, 0.0, \
                      0.0, 0.0, 0.0, 1.0))`";
        assert!(
            found.contains("is (0.000, -0.342, 0.940), but") && found.contains("20 degrees away"),
            "{found}"
        );
        assert!(found.contains(matrix), "{found}");
        let found = text(DVec3::NEG_Y, Some("-y"), Up::PlusZ, DMat3::IDENTITY).expect("reported");
        assert!(found.contains("set `up: \"-y\"` in the graph's scene, or"), "{found}");
        // The scene accepts neither -z nor the x axes.
        let half = DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z);
        let found = text(DVec3::NEG_Z, Some("-z"), Up::PlusZ, half).expect("reported");
        assert!(
            !found.contains("set `up") && found.contains("0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0"),
            "{found}"
        );
    }

    /// A scene that is read without its harmonics is otherwise the same, also with a matrix and from several files.
    #[test]
    fn a_plain_scene_has_all_but_the_harmonics() {
        let mut scene = Splats::empty();
        scene.sh_degree = 2;
        for i in 0..40_000 {
            let unit = |k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 504.0 - 1.0;
            scene.means.push([unit(0), unit(1), unit(2)]);
            scene.scales.push([0.01, 0.02, 0.03]);
            scene.quats.push([1.0, 0.0, 0.0, 0.0]);
            scene.opacities.push(0.5);
            scene.sh.extend((0..9).map(|k| [unit(3), unit(4 + k), unit(5)]));
        }
        // This row is dropped.
        scene.means[7] = [f32::NAN; 3];
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let block = engine::Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
        let cx = Context::detached(block, folder.path().display().to_string());
        let bytes = encode(&scene, SaveFormat::Ply, None, &cx).unwrap_or_else(|e| panic!("{e}")).0;
        for name in ["a.ply", "b.ply"] {
            std::fs::write(folder.path().join(name), &bytes).unwrap_or_else(|e| panic!("{e}"));
        }
        let turned = Similarity { offset: DVec3::X, scale: 2.0, ..Similarity::IDENTITY };
        let params = LoadSplats {
            path: InputFile("a.ply".to_owned()),
            more: vec![InputFile("b.ply".to_owned())],
            strict: false,
            max_extent: 1e6,
            level: 0,
            frame: Frame::ByFormat,
            matrix: Some(turned.rows()),
        };
        let (whole, notes) = LoadSplats::run(&params, In {}, &cx).unwrap_or_else(|e| panic!("{e}"));
        let (plain, degree, remarks) = params.plain(&cx).unwrap_or_else(|e| panic!("{e}"));
        let whole = &whole.splats;
        assert_eq!((degree, plain.sh_degree, whole.sh_degree), (2, 0, 2));
        assert_eq!((plain.len(), plain.sh.len()), (79_998, 79_998));
        assert_eq!((&plain.means, &plain.scales), (&whole.means, &whole.scales));
        assert_eq!((&plain.quats, &plain.opacities), (&whole.quats, &whole.opacities));
        assert!(plain.sh.iter().zip(whole.sh.chunks_exact(9)).all(|(one, all)| *one == all[0]));
        let dropped = |notes: &Notes| notes.iter().filter(|note| note.text.contains("dropped")).count();
        assert_eq!((dropped(&notes), dropped(&remarks)), (2, 2));
    }

    /// A scene of degree 3 that is loaded with a matrix gives the same picture for a camera that is transformed by
    /// the same matrix. This test fails without `self.sh.apply(sh)` in `Turn::apply`.
    #[test]
    fn turned_scene_and_turned_camera_give_the_same_picture() {
        let mut scene = Splats::empty();
        scene.sh_degree = 3;
        let unit = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 504.0 - 1.0;
        for i in 0..400 {
            scene.means.push([0, 1, 2].map(|k| unit(i, k)));
            scene.scales.push([3, 4, 5].map(|k| 0.06 + 0.05 * unit(i, k)));
            let quat = [6, 7, 8, 9].map(|k| unit(i, k) + 0.01);
            let length = quat.iter().map(|q| q * q).sum::<f32>().sqrt();
            scene.quats.push(quat.map(|q| q / length));
            scene.opacities.push(0.5 + 0.4 * unit(i, 10));
            scene.sh.extend((0..16).map(|k| [11, 12, 13].map(|c| 0.4 * unit(i, c + 3 * k))));
        }
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let root = folder.path().display().to_string();
        let scene_block = engine::Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
        let cx = Context::detached(scene_block, &root);
        let bytes = encode(&scene, SaveFormat::Ply, None, &cx).unwrap_or_else(|e| panic!("{e}")).0;
        std::fs::write(folder.path().join("a.ply"), bytes).unwrap_or_else(|e| panic!("{e}"));
        let load = |matrix: Option<[f64; 16]>| {
            let path = InputFile("a.ply".to_owned());
            let frame = Frame::ByFormat;
            let p =
                LoadSplats { path, more: Vec::new(), strict: true, max_extent: 1e6, level: 0, frame, matrix };
            LoadSplats::check(&p).unwrap_or_else(|e| panic!("{e}"));
            LoadSplats::run(&p, In {}, &cx).unwrap_or_else(|e| panic!("{e}")).0.splats
        };
        let rotation = DQuat::from_xyzw(0.2, -0.5, 0.3, 0.7).normalize();
        let moved = Similarity {
            rotation: DMat3::from_quat(rotation),
            scale: 1.7,
            offset: DVec3::new(3.0, -2.0, 1.0),
        };
        let camera = |by: &Similarity| {
            let forward = DVec3::new(0.1, 0.9, -0.2).normalize();
            let right = forward.cross(DVec3::Z).normalize();
            let axes = [right, forward.cross(right), forward].map(|v| by.rotation * v);
            Camera::centred("v", [96, 64], 70.0, axes, by.point(DVec3::new(0.0, -3.2, 0.4)))
        };
        let picture = |splats: &Splats, by: &Similarity| {
            let seen = render(splats, &camera(by), None, &Settings::default(), &cx);
            seen.unwrap_or_else(|e| panic!("{e}")).rgba
        };
        let before = picture(&load(None), &Similarity::IDENTITY);
        let after = picture(&load(Some(moved.rows())), &moved);
        let off = before.iter().zip(&after).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(before.iter().any(|v| *v > 0.5) && off < 2e-3, "{off}");
    }
}
