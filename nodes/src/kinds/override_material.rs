//! `override-material`: one plain material for a whole object.

use std::sync::Arc;

use engine::{Context, Keep, Kind, NodeError, Notes};
use scene::types::{AlphaMode, Material, Object};

engine::choices! {
    /// Type of the material.
    pub enum Surface {
        /// A Lambert surface without specular reflection.
        Diffuse,
        /// A metallic-roughness surface.
        Glossy,
    }
}

engine::params! {
    /// Gives every part of an object one plain material, without textures.
    ///
    /// `Diffuse` is a Lambert surface of the given colour; `Glossy` follows `metallic` and `roughness`. A
    /// chrome ball is `surface: Glossy, metallic: 1.0, roughness: 0.0, colour: (1.0, 1.0, 1.0)`.
    pub struct OverrideMaterial {
        /// Type of the material.
        surface: Surface = Surface::Diffuse, other("Glossy");
        /// Linear colour: the albedo of a diffuse or dielectric surface, or the reflectance of a metal.
        colour: [f64; 3] = [0.5; 3], range(0.0, 1.0), other("(0.1, 0.2, 0.3)");
        /// Metalness, from 0 (dielectric) to 1 (metal).
        metallic: f64 = 0.0, range(0.0, 1.0), other("0.5"), inert("a diffuse surface has no metalness");
        /// Perceptual roughness.
        roughness: f64 = 0.5, range(0.0, 1.0), other("0.25"), inert("a diffuse surface has no roughness");
    }
}

engine::inputs! {
    /// Inputs of [`OverrideMaterial`].
    pub struct In {
        /// The object.
        object: Arc<Object>,
    }
}

engine::outputs! {
    /// Outputs of [`OverrideMaterial`].
    pub struct Out {
        /// The same shape with the new material.
        object: Arc<Object>,
    }
}

impl Kind for OverrideMaterial {
    const NAME: &'static str = "override-material";
    const VERSION: u32 = 1;
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(params: &Self, inputs: In, _cx: &Context) -> Result<(Out, Notes), NodeError> {
        let [r, g, b] = params.colour.map(|c| c as f32);
        let diffuse = params.surface == Surface::Diffuse;
        let material = Material {
            name: "override".to_owned(),
            base_colour: [r, g, b, 1.0],
            metallic: if diffuse { 0.0 } else { params.metallic as f32 },
            roughness: if diffuse { 1.0 } else { params.roughness as f32 },
            // An index of 1 means no interface, hence no reflection.
            ior: if diffuse { 1.0 } else { 1.5 },
            alpha_mode: AlphaMode::Opaque,
            double_sided: true,
            ..Material::default()
        };
        let mut primitives = inputs.object.primitives.clone();
        for primitive in &mut primitives {
            primitive.material = 0;
            primitive.colours.clear();
        }
        let object = Object { primitives, materials: vec![material], textures: Vec::new() };
        Ok((Out { object: Arc::new(object) }, Notes::none()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::types::Primitive;
    use testing::context;

    #[test]
    fn every_part_gets_the_one_material() {
        let part = |material| Primitive {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            colours: vec![[0.3; 4]; 3],
            triangles: vec![[0, 1, 2]],
            material,
            ..Primitive::default()
        };
        let object = Object {
            primitives: vec![part(0), part(1)],
            materials: vec![Material::default(), Material::default()],
            textures: Vec::new(),
        };
        let params = OverrideMaterial {
            surface: Surface::Diffuse,
            colour: [0.25, 0.5, 0.75],
            metallic: 1.0,
            roughness: 0.1,
        };
        let (out, _) =
            OverrideMaterial::run(&params, In { object: Arc::new(object) }, &context()).expect("runs");
        assert_eq!(out.object.materials.len(), 1);
        assert_eq!(out.object.materials[0].base_colour, [0.25, 0.5, 0.75, 1.0]);
        assert_eq!(out.object.materials[0].metallic, 0.0);
        assert!(out.object.primitives.iter().all(|p| p.material == 0 && p.colours.is_empty()));
    }
}
