//! Conversion of triangles to splats, so that meshes and objects can be rendered like splats.

use glam::{DMat3, DMat4, DVec3};
use scene::io::splats::{SH_C0, quaternion};
use scene::math::color::srgb_from_linear;
use scene::types::{Mesh, Object, Splats};

/// Approximate number of splats into which a surface is converted.
const COUNT: f64 = 200_000.0;

/// A triangle with its colour in linear light.
struct Face {
    corners: [DVec3; 3],
    linear: [f32; 3],
}

/// Converts a mesh to splats, in its own frame.
pub fn of_mesh(mesh: &Mesh) -> Splats {
    let faces = mesh.triangles.iter().map(|of| {
        let colours = of.map(|v| mesh.colours.get(v as usize).copied().unwrap_or([0.4; 3]));
        let linear = [0, 1, 2].map(|k| (colours[0][k] + colours[1][k] + colours[2][k]) / 3.0);
        Face { corners: of.map(|v| mesh.position(v)), linear }
    });
    splats(&faces.collect::<Vec<_>>())
}

/// Converts an object, placed by a transform, to splats with the colours of its materials, but without textures.
pub fn of_object(object: &Object, world_from_object: &DMat4) -> Splats {
    let mut faces = Vec::new();
    for part in &object.primitives {
        let base = object.materials.get(part.material as usize).map_or([0.5; 4], |m| m.base_colour);
        for of in &part.triangles {
            let place = |v: u32| {
                world_from_object.transform_point3(DVec3::from(part.positions[v as usize].map(f64::from)))
            };
            let tint = part.colours.get(of[0] as usize).copied().unwrap_or([1.0; 4]);
            let linear = [0, 1, 2].map(|k| base[k] * tint[k]);
            faces.push(Face { corners: of.map(place), linear });
        }
    }
    splats(&faces)
}

fn splats(faces: &[Face]) -> Splats {
    let cross = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
    let area: f64 = faces.iter().map(|face| 0.5 * cross(face.corners).length()).sum();
    let each = (area / COUNT).max(1e-300);
    let mut out = Splats::empty();
    // Light from behind and to the left of a viewer who looks along (-1, -1, -1); both sides of a face are lit
    // alike.
    let light = DVec3::new(0.45, 0.35, 0.82);
    for face in faces {
        let [a, b, c] = face.corners;
        let normal = cross(face.corners);
        let double = normal.length();
        if !(double > 0.0 && double.is_finite()) {
            continue;
        }
        let normal = normal / double;
        let x = (b - a).normalize();
        let turn = quaternion(DMat3::from_cols(x, normal.cross(x), normal)).map(|q| q as f32);
        let shade = (0.55 + 0.45 * normal.dot(light).abs()) as f32;
        let rgb = face.linear.map(|v| (srgb_from_linear(v.max(0.02) * shade) - 0.5) / SH_C0 as f32);
        // Rows of points with equal distances; one for a small triangle.
        let n = ((0.5 * double / each).sqrt().ceil() as usize).clamp(1, 400);
        let size = (0.5 * double / (n * n) as f64).sqrt() * 0.75;
        for i in 0..n {
            for j in 0..2 * (n - i) - 1 {
                // Centres of the small triangles, which alternate between upright and upside down.
                let (u, v) = (i as f64, (j / 2) as f64);
                let third = if j % 2 == 0 { 1.0 / 3.0 } else { 2.0 / 3.0 };
                let (u, v) = ((u + third) / n as f64, (v + third) / n as f64);
                let p = a + (b - a) * v + (c - a) * u;
                out.means.push(p.as_vec3().to_array());
                out.quats.push(turn);
                out.scales.push([size as f32, size as f32, (size * 0.05) as f32]);
                out.opacities.push(0.95);
                out.sh.push(rgb);
            }
        }
    }
    out
}
