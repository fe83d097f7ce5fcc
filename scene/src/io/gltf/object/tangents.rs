//! Tangents for normal maps of files without tangents, similar to MikkTSpace: corners that share position, normal
//! and texture coordinates share a tangent, which is the mean of their tangents, weighted by the angle of each
//! corner. Mirrored islands are kept separate. The green channel of a normal map points up in the picture, and v of
//! glTF runs down. The bitangent therefore points against v, and its sign is opposite to the sign of the area in
//! texture coordinates.

use std::collections::HashMap;

use glam::{DVec2, DVec3};

use crate::math::num;
use crate::types::Primitive;

fn vec3(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

/// Returns a unit vector perpendicular to `n`, the same for equal `n`.
fn across(n: DVec3) -> DVec3 {
    let axis = if n.x.abs() < 0.6 { DVec3::X } else { DVec3::Y };
    (axis - n * n.dot(axis)).normalize()
}

/// Generates a tangent for every vertex; vertices on the seam of mirrored islands are duplicated. Needs normals and
/// texture coordinates (`uv`, one per vertex). Returns the number of vertices whose texture coordinates are
/// degenerate, which get an arbitrary tangent.
pub fn generate(p: &mut Primitive, second_set: bool) -> u64 {
    let uv = if second_set { p.uv1.clone() } else { p.uv0.clone() };
    // The map is used for lookup only; the order is that of the vertices.
    let mut groups = HashMap::new();
    let group: Vec<u32> = (0..p.positions.len())
        .map(|v| {
            let key =
                (p.positions[v].map(f32::to_bits), p.normals[v].map(f32::to_bits), uv[v].map(f32::to_bits));
            let next = groups.len() as u32;
            *groups.entry(key).or_insert(next)
        })
        .collect();
    // [mirrored][group]
    let mut sums = [vec![DVec3::ZERO; groups.len()], vec![DVec3::ZERO; groups.len()]];
    let mut mirrored = vec![None; p.triangles.len()];
    for (side, t) in mirrored.iter_mut().zip(&p.triangles) {
        let [a, b, c] = t.map(|v| vec3(p.positions[v as usize]));
        let [ta, tb, tc] = t.map(|v| DVec2::new(f64::from(uv[v as usize][0]), f64::from(uv[v as usize][1])));
        let (d1, d2, t1, t2) = (b - a, c - a, tb - ta, tc - ta);
        let area = t1.x * t2.y - t1.y * t2.x;
        let direction = d1 * t2.y - d2 * t1.y;
        if area == 0.0 || direction.length_squared() == 0.0 {
            continue;
        }
        let flip = area < 0.0;
        *side = Some(flip);
        let direction = if flip { -direction } else { direction }.normalize();
        let corners = [a, b, c];
        for k in 0..3 {
            let v = t[k] as usize;
            let n = vec3(p.normals[v]);
            let flat = |d: DVec3| (d - n * n.dot(d)).normalize_or_zero();
            let (e1, e2) = (flat(corners[(k + 1) % 3] - corners[k]), flat(corners[(k + 2) % 3] - corners[k]));
            let angle = num::f64::acos(e1.dot(e2).clamp(-1.0, 1.0));
            sums[usize::from(flip)][group[v] as usize] += flat(direction) * angle;
        }
    }
    split_mirrored(p, &mirrored, &group, &sums)
}

/// Writes the tangents, and duplicates each vertex that both mirrored and unmirrored triangles use.
fn split_mirrored(
    p: &mut Primitive,
    mirrored: &[Option<bool>],
    group: &[u32],
    sums: &[Vec<DVec3>; 2],
) -> u64 {
    let mut side: Vec<Option<bool>> = vec![None; p.positions.len()];
    let mut twin: Vec<Option<u32>> = vec![None; p.positions.len()];
    let mut source: Vec<u32> = (0..p.positions.len() as u32).collect();
    for (t, flip) in p.triangles.iter_mut().zip(mirrored) {
        let Some(flip) = *flip else { continue };
        for v in t {
            let old = *v as usize;
            match side[old] {
                None => side[old] = Some(flip),
                Some(own) if own == flip => {}
                Some(_) => {
                    *v = *twin[old].get_or_insert_with(|| {
                        source.push(old as u32);
                        (source.len() - 1) as u32
                    });
                }
            }
        }
    }
    let first = p.positions.len();
    let mut arbitrary = 0;
    p.tangents = source
        .iter()
        .enumerate()
        .map(|(index, &old)| {
            let own = side[old as usize].unwrap_or(false);
            let flip = if index < first { own } else { !own };
            let n = vec3(p.normals[old as usize]);
            let sum = sums[usize::from(flip)][group[old as usize] as usize];
            let flat = sum - n * n.dot(sum);
            let tangent = if flat.length() > 1e-12 {
                flat.normalize()
            } else {
                arbitrary += 1;
                across(n)
            };
            let sign = if flip { 1.0 } else { -1.0 };
            [tangent.x as f32, tangent.y as f32, tangent.z as f32, sign]
        })
        .collect();
    let extra: Vec<usize> = source[first..].iter().map(|&v| v as usize).collect();
    fn double<T: Copy>(list: &mut Vec<T>, extra: &[usize]) {
        if !list.is_empty() {
            list.extend_from_within(..0);
            let copies: Vec<T> = extra.iter().map(|&v| list[v]).collect();
            list.extend(copies);
        }
    }
    double(&mut p.positions, &extra);
    double(&mut p.normals, &extra);
    double(&mut p.uv0, &extra);
    double(&mut p.uv1, &extra);
    double(&mut p.colours, &extra);
    arbitrary
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad(uv: [[f32; 2]; 4]) -> Primitive {
        Primitive {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
            normals: vec![[0.0, 0.0, 1.0]; 4],
            uv0: uv.to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Primitive::default()
        }
    }

    #[test]
    fn tangent_follows_u_and_the_bitangent_runs_up_the_picture() {
        // v points down in glTF: bitangent = sign * cross(n, t) is +y, which is up in the picture.
        let mut card = quad([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]);
        assert_eq!(generate(&mut card, false), 0);
        assert_eq!(card.tangents, [[1.0, 0.0, 0.0, 1.0]; 4]);
        // The picture upside down.
        let mut turned = quad([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
        generate(&mut turned, false);
        assert_eq!(turned.tangents, [[1.0, 0.0, 0.0, -1.0]; 4]);
    }

    #[test]
    fn mirrored_halves_keep_their_own_sides() {
        // Both triangles share the diagonal, and the second one's texture is mirrored in it.
        let mut p = quad([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 0.0]]);
        generate(&mut p, false);
        assert!(p.is_consistent());
        assert_eq!(p.positions.len(), 6, "two corners doubled");
        let signs = |t: usize| p.triangles[t].map(|v| p.tangents[v as usize][3]);
        assert_eq!((signs(0), signs(1)), ([-1.0; 3], [1.0; 3]));
    }

    #[test]
    fn texture_without_direction_gives_unit_tangents_all_the_same() {
        let mut p = quad([[0.5, 0.5]; 4]);
        assert_eq!(generate(&mut p, false), 4);
        for t in &p.tangents {
            assert!((vec3([t[0], t[1], t[2]]).length() - 1.0).abs() < 1e-6 && t[2] == 0.0);
        }
    }
}
