//! Splats and meshes as bytes for the place view.
//!
//! The bytes are a `u32` with the length of a JSON text, the text, and arrays of little-endian numbers whose
//! lengths the text gives. The length of the text is a multiple of 4. Positions are relative to `origin`, in f32,
//! so that scenes in survey coordinates keep their detail.

use glam::{DMat3, DQuat, DVec3};
use scene::math::color::{code8, linear_from_srgb, srgb_from_linear};
use scene::types::{Material, Mesh, Object, Primitive, SplatEncoding, Splats, TextureRef, Wrap};
use serde_json::{Value, json};

use crate::surface::Surface;
use crate::thinned::{clustered, sampled};

/// Maximum number of splats that are sent.
pub const MOST_SPLATS: usize = 300_000;
/// Maximum number of triangles that are sent.
pub const MOST_TRIANGLES: usize = 400_000;
/// Constant of the spherical harmonics of degree 0.
const SH_0: f32 = 0.282_094_79;

/// Writer of the format of this module.
struct Packed(Vec<u8>);

impl Packed {
    fn new(head: &Value, capacity: usize) -> Self {
        let mut text = head.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bytes = Vec::with_capacity(4 + text.len() + capacity);
        bytes.extend((text.len() as u32).to_le_bytes());
        bytes.extend(text);
        Self(bytes)
    }

    fn point(&mut self, point: DVec3) {
        self.0.extend(point.to_array().into_iter().flat_map(|v| (v as f32).to_le_bytes()));
    }

    fn word(&mut self, word: u32) {
        self.0.extend(word.to_le_bytes());
    }
}

/// The middle of the points, which need not be exact.
fn origin(points: impl Iterator<Item = DVec3>) -> DVec3 {
    let (sum, count) = points.fold((DVec3::ZERO, 0.0), |(sum, count), point| (sum + point, count + 1.0));
    if count > 0.0 && sum.is_finite() { (sum / count).floor() } else { DVec3::ZERO }
}

/// The covariance of a splat in the world, divided by `unit`: xx, xy, xz, yy, yz, zz.
fn covariance(quat: [f32; 4], scale: [f32; 3], unit: f64) -> [f64; 6] {
    let [w, x, y, z] = quat.map(f64::from);
    let turn = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let spread = turn * DMat3::from_diagonal(DVec3::from_array(scale.map(f64::from)));
    let c = spread * spread.transpose() * (1.0 / unit);
    [c.x_axis.x, c.x_axis.y, c.x_axis.z, c.y_axis.y, c.y_axis.z, c.z_axis.z]
}

/// Splats as 32 bytes each: the position (3 f32), colour and opacity (4 bytes, sRGB), the square of the largest
/// standard deviation (f32), and the covariance divided by it (6 f16: xx, xy, xz, yy, yz, zz). A scene with more
/// than `most` splats is thinned.
pub fn splats(splats: &Splats, most: usize) -> Vec<u8> {
    let chosen = sampled(splats, most.clamp(1, MOST_SPLATS));
    let origin = origin(chosen.iter().map(|(index, _)| splats.mean(*index)));
    let head = json!({"count": chosen.len(), "total": splats.len(), "origin": origin.to_array()});
    let mut packed = Packed::new(&head, chosen.len() * 32);
    let sh_len = splats.sh_len();
    for (index, larger) in chosen {
        packed.point(splats.mean(index) - origin);
        let colour = splats.sh[index * sh_len].map(|v| (0.5 + SH_0 * v).max(0.0));
        let [r, g, b] = match splats.encoding {
            SplatEncoding::Srgb => colour.map(code8),
            SplatEncoding::Linear => colour.map(|v| code8(srgb_from_linear(v))),
        };
        packed.word(u32::from_le_bytes([r, g, b, code8(splats.opacities[index])]));
        let scale = splats.scales[index].map(|v| v * larger);
        let largest = f64::from(scale[0].max(scale[1]).max(scale[2]));
        let unit = (largest * largest).max(1e-30);
        packed.word((unit as f32).to_bits());
        let halves =
            covariance(splats.quats[index], scale, unit).map(|v| half::f16::from_f64(v).to_le_bytes());
        packed.0.extend(halves.as_flattened());
    }
    packed.0
}

impl Surface {
    /// The surface of a mesh of the place, in the world.
    pub fn of_mesh(mesh: &Mesh) -> Self {
        let grey = [150, 150, 150, 255];
        let colour = |[r, g, b]: [f32; 3]| {
            let [r, g, b] = [r, g, b].map(|v| code8(srgb_from_linear(v)));
            [r, g, b, 255]
        };
        let positions = (0..mesh.positions.len() as u32).map(|index| mesh.position(index)).collect();
        let colours = match mesh.colours.is_empty() {
            true => vec![grey; mesh.positions.len()],
            false => mesh.colours.iter().map(|rgb| colour(*rgb)).collect(),
        };
        Self { positions, normals: Vec::new(), colours, triangles: mesh.triangles.clone() }
    }

    /// The surface of an object, in the frame of its file, with the base colours of its materials at the vertices.
    pub fn of_object(object: &Object) -> Self {
        let mut all = Self::default();
        for part in &object.primitives {
            let first = all.positions.len() as u32;
            let material = &object.materials[part.material as usize];
            all.positions.extend(part.positions.iter().map(|p| DVec3::from_array(p.map(f64::from))));
            all.normals.extend(normals(part));
            all.colours.extend((0..part.positions.len()).map(|vertex| base(object, part, material, vertex)));
            all.triangles.extend(part.triangles.iter().map(|corners| corners.map(|v| v + first)));
        }
        all
    }

    /// Packs the surface: positions (f32), normals (f32, if there are any), colours (4 bytes) and corners (u32). A
    /// surface with more than [`MOST_TRIANGLES`] is simplified.
    pub fn pack(self) -> Vec<u8> {
        let total = self.triangles.len();
        let shown = if total > MOST_TRIANGLES { clustered(&self, MOST_TRIANGLES) } else { self };
        let origin = origin(shown.positions.iter().copied());
        let head = json!({
            "vertices": shown.positions.len(), "triangles": shown.triangles.len(), "total": total,
            "normals": !shown.normals.is_empty(), "origin": origin.to_array(),
        });
        let mut packed = Packed::new(&head, shown.positions.len() * 28 + shown.triangles.len() * 12);
        shown.positions.iter().for_each(|point| packed.point(*point - origin));
        shown.normals.iter().for_each(|normal| packed.point(*normal));
        packed.0.extend(shown.colours.as_flattened());
        shown.triangles.as_flattened().iter().for_each(|corner| packed.word(*corner));
        packed.0
    }
}

/// The normals of a part; mean normals of the triangles around each vertex if the file has none.
fn normals(part: &Primitive) -> Vec<DVec3> {
    if !part.normals.is_empty() {
        return part.normals.iter().map(|n| DVec3::from_array(n.map(f64::from))).collect();
    }
    let mut sums = vec![DVec3::ZERO; part.positions.len()];
    for corners in &part.triangles {
        let [a, b, c] = corners.map(|v| DVec3::from_array(part.positions[v as usize].map(f64::from)));
        let area = (b - a).cross(c - a);
        corners.iter().for_each(|&v| sums[v as usize] += area);
    }
    sums.into_iter().map(DVec3::normalize_or_zero).collect()
}

/// The base colour at a vertex, sRGB: that of the material, times its texture and the colour of the vertex.
fn base(object: &Object, part: &Primitive, material: &Material, vertex: usize) -> [u8; 4] {
    let [r, g, b, alpha] = material.base_colour;
    let mut rgb = [r, g, b];
    let mut times = |other: [f32; 3]| rgb.iter_mut().zip(other).for_each(|(v, other)| *v *= other);
    if let Some(texel) =
        material.base_colour_texture.and_then(|texture| texel(object, part, &texture, vertex))
    {
        times(texel);
    }
    if let Some([r, g, b, _]) = part.colours.get(vertex) {
        times([*r, *g, *b]);
    }
    let [r, g, b] = rgb.map(|v| code8(srgb_from_linear(v)));
    [r, g, b, code8(alpha)]
}

/// The nearest texel at a vertex, linear; `None` if the part has no such texture coordinates.
fn texel(object: &Object, part: &Primitive, at: &TextureRef, vertex: usize) -> Option<[f32; 3]> {
    let uvs = if at.uv_set == 0 { &part.uv0 } else { &part.uv1 };
    let [mut u, mut v] = *uvs.get(vertex)?;
    if let Some(transform) = at.transform {
        let (sin, cos) = scene::math::num::sin_cos(f64::from(transform.rotation));
        let (sin, cos) = (sin as f32, cos as f32);
        let [x, y] = [u * transform.scale[0], v * transform.scale[1]];
        (u, v) = (x * cos + y * sin + transform.offset[0], y * cos - x * sin + transform.offset[1]);
    }
    let texture = object.textures.get(at.texture as usize)?;
    let index = |v: f32, size: u32, wrap: Wrap| {
        let inside = match wrap {
            Wrap::Repeat => v - v.floor(),
            Wrap::Mirror => 1.0 - ((v * 0.5 - (v * 0.5).floor()) * 2.0 - 1.0).abs(),
            Wrap::Clamp => v.clamp(0.0, 1.0),
        };
        ((inside * size as f32) as u32).min(size.saturating_sub(1))
    };
    let column = index(u, texture.width, at.sampler.wrap_u) as usize;
    let row = index(v, texture.height, at.sampler.wrap_v) as usize;
    let start = (row * texture.width as usize + column) * 4;
    let rgba = texture.rgba.get(start..start + 3)?;
    Some([0, 1, 2].map(|k| linear_from_srgb(f32::from(rgba[k]) / 255.0)))
}
