//! Cameras of a glTF file, which Blender writes next to the objects.

use engine::{Context, NodeError, Notes};
use glam::{DMat3, DMat4, DVec3};
use scene::error::Error;
use scene::io::capture::raw::Raw;
use scene::io::gltf::animation::Moment;
use scene::io::gltf::{self, object::local};
use scene::math::num;
use scene::types::frame::world_from_gltf;

use super::interface::LoadCameras;

/// Height of a picture in pixels, since glTF does not define it. It is multiplied by `resolution`.
const HEIGHT_PX: u64 = 1080;
/// Aspect ratio of cameras that do not define one. It is the default of Blender.
const ASPECT: f64 = 16.0 / 9.0;

/// Reads the perspective cameras of the scene, in the order of its nodes, and converts them from the frame of glTF
/// (y up, metres) to the world of the graph.
pub fn read(p: &LoadCameras, bytes: &[u8], cx: &Context, notes: &mut Notes) -> Result<Vec<Raw>, NodeError> {
    let file = &p.path.0;
    let mut parsed = gltf::parse(file, bytes)?;
    if let Some(clip) = p.clip.as_deref() {
        let buffers = parsed.buffers(|name| cx.read_sibling(&p.path, name))?;
        let moment = Moment { clip, seconds: p.time_s, after_end: p.after_end };
        parsed.pose(&moment, &buffers, notes)?;
    }
    let document = &parsed.document;
    let scene = document.default_scene().or_else(|| document.scenes().next());
    let world = world_from_gltf(cx.up(), cx.metres_per_unit());
    let mut open: Vec<_> = scene.iter().flat_map(|scene| scene.nodes()).map(|node| (node, world)).collect();
    open.reverse();
    let (mut cameras, mut parallel, mut visits) = (Vec::new(), 0, 0);
    while let Some((node, above)) = open.pop() {
        visits += 1;
        if visits > document.nodes().len() {
            return Err(Error::format(
                file,
                "a node appears twice in the hierarchy; the nodes of a glTF scene must form trees",
            )
            .into());
        }
        let matrix = above * local(&node.transform());
        let children: Vec<_> = node.children().map(|child| (child, matrix)).collect();
        open.extend(children.into_iter().rev());
        let Some(camera) = node.camera() else { continue };
        let ::gltf::camera::Projection::Perspective(lens) = camera.projection() else {
            parallel += 1;
            continue;
        };
        let name = node
            .name()
            .or_else(|| camera.name())
            .map_or_else(|| format!("camera{}", cameras.len()), str::to_owned);
        let aspect = lens.aspect_ratio().map_or(ASPECT, f64::from);
        let half = num::f64::tan(0.5 * f64::from(lens.yfov()));
        let width = (HEIGHT_PX as f64 * aspect).round();
        if !(half > 0.0 && half.is_finite() && (1.0..=65_536.0).contains(&width)) {
            return Err(Error::format(
                file,
                format!("camera `{name}` has no usable `yfov` or `aspectRatio`"),
            )
            .into());
        }
        // Scaled nodes and the units of the world scale the matrix, but the pose of a camera has no scale.
        let linear = DMat3::from_mat4(matrix);
        let axes = [linear.x_axis, -linear.y_axis, -linear.z_axis].map(DVec3::normalize_or_zero);
        let [x, y, z] = axes;
        let world_from_camera = DMat4::from_cols(x.extend(0.0), y.extend(0.0), z.extend(0.0), matrix.w_axis);
        let focal = 0.5 * HEIGHT_PX as f64 / half;
        cameras.push(Raw {
            picture: name,
            width: width as u64,
            height: HEIGHT_PX,
            lens: [focal, focal, 0.5 * width, 0.5 * HEIGHT_PX as f64],
            distortion: None,
            world_from_camera,
        });
    }
    if parallel > 0 && cameras.is_empty() {
        let what = format!(
            "only orthographic cameras (count: {parallel}), and cameras of a graph are perspective; export a \
             perspective camera"
        );
        return Err(Error::unsupported(file, what).into());
    }
    if parallel > 0 {
        notes.warning(
            "parallel-cameras",
            format!("the orthographic cameras of `{file}` are left out (count: {parallel})"),
        );
    }
    Ok(cameras)
}
