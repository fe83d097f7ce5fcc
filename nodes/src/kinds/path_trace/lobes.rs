//! Lobes that no material of the objects has. They are neither evaluated nor sampled.

use std::sync::Arc;

use scene::types::{Material, Placed};

/// Name of a lobe, and a function that returns whether a material has it. Textures can only reduce the factor
/// of a lobe.
type NamedLobe = (&'static str, fn(&Material) -> bool);

const LOBES: [NamedLobe; 7] = [
    ("gloss", |m| m.metallic > 0.0 || (m.ior > 1.0 && m.specular.strength.factor > 0.0)),
    ("transmission", |m| m.transmission.factor > 0.0),
    ("diffuse transmission", |m| m.diffuse_transmission.strength.factor > 0.0),
    ("clear coat", |m| m.clearcoat.strength.factor > 0.0),
    ("sheen", |m| m.sheen.colour.factor != [0.0; 3]),
    ("brush", |m| m.anisotropy.strength > 0.0),
    ("thin film", |m| m.iridescence.strength.factor > 0.0),
];

/// Names of the lobes that no material in use has, separated by commas.
pub(crate) fn absent(objects: &[Arc<Placed>]) -> String {
    let materials =
        || objects.iter().flat_map(|placed| placed.object.materials_in_use()).filter(|m| !m.unlit);
    let names = LOBES.iter().filter(|(_, has)| !materials().any(has)).map(|(name, _)| *name);
    names.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::types::{Map, Object, Primitive};

    #[test]
    fn lobes_are_there_once_a_material_that_is_lit_has_them() {
        let with = |materials: Vec<Material>, used: u32| {
            let part = |material| Primitive { triangles: vec![[0; 3]], material, ..Primitive::default() };
            let unseen = Primitive { material: used, ..Primitive::default() };
            let primitives = (0..used).map(part).chain([unseen]).collect();
            let object = Object { primitives, materials, ..Object::default() };
            [Arc::new(Placed { object: Arc::new(object), world_from_object: glam::DMat4::IDENTITY })]
        };
        let placed = |materials: Vec<Material>| {
            let all = materials.len() as u32;
            with(materials, all)
        };
        let all = "gloss, transmission, diffuse transmission, clear coat, sheen, brush, thin film";
        assert_eq!(absent(&[]), all);
        let matte = Material { metallic: 0.0, ior: 1.0, ..Material::default() };
        let glass = Material { metallic: 0.0, transmission: Map::of(0.5), ..Material::default() };
        assert_eq!(absent(&placed(vec![matte.clone()])), all);
        // A material without triangles does not count.
        assert_eq!(absent(&with(vec![matte.clone(), glass.clone()], 1)), all);
        let two = absent(&placed(vec![matte, glass.clone()]));
        assert_eq!(two, "diffuse transmission, clear coat, sheen, brush, thin film");
        assert_eq!(absent(&placed(vec![Material { unlit: true, ..glass }])), all);
    }
}
