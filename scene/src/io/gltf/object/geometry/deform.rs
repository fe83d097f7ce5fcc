//! Deformations of vertices before the transform of their node: morph targets and skins.

use glam::DMat4;
use gltf::{Accessor, Node, Semantic};

use super::Geometry;
use crate::error::Error;

impl Geometry<'_> {
    /// Adds the morph targets to the vertices, with the weights that the file specifies.
    pub(super) fn morph(
        &mut self,
        node: &Node<'_>,
        primitive: &gltf::Primitive<'_>,
        positions: &mut [[f64; 3]],
        normals: &mut [[f64; 3]],
        tangents: &mut [[f64; 4]],
    ) -> Result<(), Error> {
        let weights =
            node.weights().or_else(|| node.mesh().and_then(|mesh| mesh.weights())).unwrap_or_default();
        for (target, weight) in primitive.morph_targets().zip(weights).filter(|(_, w)| **w != 0.0) {
            self.tally.morphed += 1;
            let deltas = |accessor: Option<Accessor<'_>>| -> Result<Vec<[f64; 3]>, Error> {
                let Some(accessor) = accessor else { return Ok(Vec::new()) };
                let numbers = self.numbers(&accessor)?;
                let deltas = numbers
                    .arrays::<3>()
                    .ok_or_else(|| self.bad("a morph target does not have three numbers per vertex"))?;
                Ok(deltas.to_vec())
            };
            let moved = [deltas(target.positions())?, deltas(target.normals())?, deltas(target.tangents())?];
            let add = |to: &mut f64, delta: f64| *to += f64::from(*weight) * delta;
            for (v, d) in positions.iter_mut().zip(&moved[0]) {
                (0..3).for_each(|i| add(&mut v[i], d[i]));
            }
            for (v, d) in normals.iter_mut().zip(&moved[1]) {
                (0..3).for_each(|i| add(&mut v[i], d[i]));
            }
            for (v, d) in tangents.iter_mut().zip(&moved[2]) {
                (0..3).for_each(|i| add(&mut v[i], d[i]));
            }
        }
        Ok(())
    }

    /// The blended joint matrix of every vertex, in the frame of the file.
    pub(super) fn skin(
        &mut self,
        node: &Node<'_>,
        primitive: &gltf::Primitive<'_>,
        n: usize,
    ) -> Result<Option<Vec<DMat4>>, Error> {
        let Some(skin) = node.skin() else { return Ok(None) };
        let mut influences = Vec::new();
        for set in 0.. {
            let Some(joints) = self.attribute::<4>(primitive, Semantic::Joints(set), n)? else { break };
            let weights = self
                .attribute::<4>(primitive, Semantic::Weights(set), n)?
                .ok_or_else(|| self.bad("a skinned primitive has joints but no weights"))?;
            influences.push((joints, weights));
        }
        if influences.is_empty() {
            return Ok(None);
        }
        let inverse: Vec<DMat4> = match skin.inverse_bind_matrices() {
            Some(accessor) => {
                let numbers = self.numbers(&accessor)?;
                let matrices = numbers
                    .arrays::<16>()
                    .ok_or_else(|| self.bad("the inverse bind matrices are not 4 x 4"))?;
                matrices.iter().map(DMat4::from_cols_array).collect()
            }
            None => Vec::new(),
        };
        let matrices: Vec<DMat4> = skin
            .joints()
            .enumerate()
            .map(|(k, joint)| {
                let world = self.world[joint.index()].unwrap_or_default();
                world * inverse.get(k).copied().unwrap_or_default()
            })
            .collect();
        self.tally.skinned += 1;
        let blend = |v: usize| {
            let of = |set: &(Vec<[f64; 4]>, Vec<[f64; 4]>)| set.0[v].into_iter().zip(set.1[v]);
            let sum: f64 = influences.iter().flat_map(of).map(|(_, weight)| weight).sum();
            let mut blended = DMat4::ZERO;
            for (joint, weight) in influences.iter().flat_map(of).filter(|(_, weight)| *weight != 0.0) {
                let matrix = matrices
                    .get(joint as usize)
                    .ok_or_else(|| self.bad("a vertex refers to a joint that does not exist"))?;
                blended += *matrix * (weight / sum);
            }
            Ok(if sum > 0.0 { blended } else { matrices.first().copied().unwrap_or_default() })
        };
        (0..n).map(blend).collect::<Result<_, Error>>().map(Some)
    }
}
