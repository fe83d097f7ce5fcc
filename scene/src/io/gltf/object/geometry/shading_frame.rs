//! Generation of missing normals and tangents.

use glam::DVec3;

use super::Geometry;
use crate::io::gltf::object::tangents;
use crate::types::Primitive;

impl Geometry<'_> {
    /// Repairs normals, and generates tangents if a normal map needs them.
    pub(super) fn shading_frame(&mut self, p: &mut Primitive, normal_map: Option<bool>) {
        let broken: Vec<usize> = (0..p.normals.len()).filter(|&v| p.normals[v] == [0.0; 3]).collect();
        if !broken.is_empty() {
            self.tally.normals += broken.len() as u64;
            let faces = summed_face_normals(p);
            for v in broken {
                p.normals[v] = faces[v];
            }
        }
        let Some(second_set) = normal_map else { return };
        let has_uv = !if second_set { &p.uv1 } else { &p.uv0 }.is_empty();
        if p.normals.is_empty() {
            // Flat normals, as the specification requires; given tangents are then invalid.
            unweld(p);
            p.tangents.clear();
            p.normals = summed_face_normals(p);
        }
        let broken = p.tangents.iter().any(|t| t[..3] == [0.0; 3]);
        if has_uv && (p.tangents.is_empty() || broken) {
            self.tally.tangents_made += 1;
            self.tally.tangents_arbitrary += tangents::generate(p, second_set);
        }
    }
}

/// For each vertex, the normalised sum of the normals of the adjacent faces, weighted by area; the up direction if
/// this sum is 0.
fn summed_face_normals(p: &Primitive) -> Vec<[f32; 3]> {
    let mut sums = vec![DVec3::ZERO; p.positions.len()];
    for t in &p.triangles {
        let [a, b, c] = t.map(|v| DVec3::from_array(p.positions[v as usize].map(f64::from)));
        let normal = (b - a).cross(c - a);
        t.iter().for_each(|&v| sums[v as usize] += normal);
    }
    sums.into_iter().map(|sum| sum.try_normalize().unwrap_or(DVec3::Y).as_vec3().to_array()).collect()
}

/// Gives every triangle its own vertices.
fn unweld(p: &mut Primitive) {
    let corners: Vec<usize> = p.triangles.as_flattened().iter().map(|&v| v as usize).collect();
    fn spread<T: Copy>(list: &mut Vec<T>, corners: &[usize]) {
        if !list.is_empty() {
            *list = corners.iter().map(|&v| list[v]).collect();
        }
    }
    spread(&mut p.positions, &corners);
    spread(&mut p.normals, &corners);
    spread(&mut p.uv0, &corners);
    spread(&mut p.uv1, &corners);
    spread(&mut p.colours, &corners);
    p.tangents.clear();
    p.triangles = (0..corners.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
}
