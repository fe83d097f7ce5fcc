//! `crop-mesh`: keeps part of a mesh.

use std::sync::Arc;

use engine::{Context, ContextField, Keep, Kind, NodeError, Notes};
use glam::DVec3;
use scene::math::equirect::axes;
use scene::types::Mesh;

engine::params! {
    /// Keeps the triangles of a mesh that lie in a box and below a height.
    ///
    /// A triangle is kept if its centroid lies inside; triangles are not cut. Removing the ceiling of a room
    /// (`below_height: 2.4`) lets light in; the paper compares its method with this simple approach.
    pub struct CropMesh {
        /// Corner of the box with the smallest world coordinates. The default is a box without lower bounds.
        box_min: Option<[f64; 3]> = None, other("(0.2, -1.0, -1.0)"), unit("world units");
        /// Corner of the box with the largest world coordinates. The default is a box without upper bounds.
        box_max: Option<[f64; 3]> = None, other("(0.5, 1.0, 1.0)"), unit("world units");
        /// Maximum height of the triangles that are kept, along the up axis of the scene. By default, the height is
        /// not limited.
        below_height: Option<f64> = None, other("0.5"), unit("world units");
    }
}

engine::inputs! {
    /// Inputs of [`CropMesh`].
    pub struct In {
        /// The mesh.
        mesh: Arc<Mesh>,
    }
}

engine::outputs! {
    /// Outputs of [`CropMesh`].
    pub struct Out {
        /// The remaining mesh.
        mesh: Arc<Mesh>,
    }
}

impl Kind for CropMesh {
    const NAME: &'static str = "crop-mesh";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up];
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let [_, _, above] = axes(cx.up());
        let mesh = &inputs.mesh;
        let low = params.box_min.map_or(DVec3::NEG_INFINITY, DVec3::from_array);
        let high = params.box_max.map_or(DVec3::INFINITY, DVec3::from_array);
        let highest = params.below_height.unwrap_or(f64::INFINITY);
        let mut kept = Mesh { glosses: mesh.glosses.clone(), ..Mesh::default() };
        let mut moved = vec![u32::MAX; mesh.positions.len()];
        for (number, triangle) in mesh.triangles.iter().enumerate() {
            let centroid = triangle.iter().fold(DVec3::ZERO, |sum, &v| sum + mesh.position(v)) / 3.0;
            if centroid.cmplt(low).any() || centroid.cmpgt(high).any() || centroid.dot(above) > highest {
                continue;
            }
            kept.gloss_of.extend(mesh.gloss_of.get(number));
            kept.triangles.push(triangle.map(|index| {
                let at = &mut moved[index as usize];
                if *at == u32::MAX {
                    *at = kept.positions.len() as u32;
                    kept.positions.push(mesh.positions[index as usize]);
                    kept.positions_low.extend(mesh.positions_low.get(index as usize));
                    kept.colours.extend(mesh.colours.get(index as usize));
                }
                *at
            }));
        }
        let mut notes = Notes::none();
        let (left, all) = (kept.triangles.len(), mesh.triangles.len());
        notes.count(
            "cropped",
            (all - left) as u64,
            format_args!(
                "of the {all} triangles had a centroid outside the given limits and had to be removed"
            ),
        );
        if left == 0 && all > 0 {
            notes.degraded(
                "empty",
                "no triangle of the mesh is within the given limits, so the mesh is empty",
            );
        }
        Ok((Out { mesh: Arc::new(kept) }, notes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::types::Gloss;
    use testing::context;

    #[test]
    fn what_is_outside_goes_with_its_vertices() {
        let wet = Gloss { roughness: 0.1, metallic: 0.0, ior: 1.33, specular: 1.0, normal: [0.0; 3] };
        let mesh = Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0], [1.0, 0.0, 3.0]],
            positions_low: [1e-9, 2e-9, 3e-9, 4e-9, 5e-9].map(|low| [0.0, low, 0.0]).to_vec(),
            colours: vec![[0.1; 3], [0.2; 3], [0.3; 3], [0.4; 3], [0.5; 3]],
            triangles: vec![[0, 3, 4], [2, 1, 0]],
            glosses: vec![wet],
            gloss_of: vec![0, 1],
        };
        let params = CropMesh { box_min: None, box_max: None, below_height: Some(1.0) };
        let (out, _) = CropMesh::run(&params, In { mesh: Arc::new(mesh.clone()) }, &context()).expect("runs");
        assert_eq!(out.mesh.positions, [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0; 3]]);
        assert_eq!(out.mesh.colours, [[0.3; 3], [0.2; 3], [0.1; 3]]);
        assert_eq!(out.mesh.positions_low, [3e-9, 2e-9, 1e-9].map(|low| [0.0, low, 0.0]));
        assert_eq!(out.mesh.triangles, [[0, 1, 2]]);
        assert_eq!(out.mesh.gloss(0), Some(&wet));
        let boxed = CropMesh { box_min: Some([0.1, -1.0, 1.0]), box_max: Some([2.0; 3]), below_height: None };
        let (out, _) = CropMesh::run(&boxed, In { mesh: Arc::new(mesh) }, &context()).expect("runs");
        assert_eq!(out.mesh.triangles.len(), 1);
        assert_eq!(out.mesh.positions[1], [0.0, 0.0, 3.0]);
    }
}
