//! An object in which every field differs from every other.

use glam::{DMat3, DVec3};

use crate::io::gltf::object::turned;
use crate::types::{
    AlphaMode, Anisotropy, Clearcoat, ColourMap, DiffuseTransmission, Iridescence, Map, Material, NormalMap,
    Object, Primitive, Sampler, Sheen, Specular, Texture, TextureRef, TextureTransform, Wrap,
};

fn texture(width: u32, height: u32, opaque: bool) -> Texture {
    let code = |i: u32| if opaque && i % 4 == 3 { 255 } else { (i * 37 % 251) as u8 };
    Texture { width, height, rgba: (0..4 * width * height).map(code).collect() }
}

/// A reference to a texture; no two references are equal.
fn reference(texture: u32, number: u32) -> TextureRef {
    let wrap = |i: u32| [Wrap::Clamp, Wrap::Repeat, Wrap::Mirror][(i % 3) as usize];
    let f = number as f32;
    let transform =
        TextureTransform { offset: [0.1 + f, 0.2 + f], rotation: 0.3 + f, scale: [1.4 + f, 1.5 + f] };
    TextureRef {
        texture,
        uv_set: number % 2,
        sampler: Sampler {
            wrap_u: wrap(number),
            wrap_v: wrap(number / 3),
            nearest: number.is_multiple_of(2),
        },
        transform: (!number.is_multiple_of(3)).then_some(transform),
    }
}

/// A material in which every number differs from all others and from its default. It uses the textures 0 to 16 in the
/// order in which they are read.
pub(super) fn full() -> Material {
    let some = |number: u32| Some(reference(number, number));
    let map = |factor: f32, number: u32| Map { factor, texture: some(number) };
    let colour =
        |red: f32, number: u32| ColourMap { factor: [red, red + 0.01, red + 0.02], texture: some(number) };
    let normal = |scale: f32, number: u32| Some(NormalMap { texture: reference(number, number), scale });
    Material {
        name: "all".to_owned(),
        base_colour: [0.1, 0.2, 0.3, 0.4],
        base_colour_texture: some(0),
        metallic: 0.5,
        roughness: 0.6,
        metallic_roughness_texture: some(1),
        normal: normal(0.7, 2),
        emissive: [0.8, 30.9, 5.1],
        emissive_texture: some(3),
        alpha_mode: AlphaMode::Mask(0.41),
        double_sided: true,
        unlit: true,
        ior: 1.7,
        transmission: map(0.11, 4),
        volume: Some([0.5, 3.0, 1.5]),
        specular: Specular { strength: map(0.12, 5), colour: colour(1.13, 6) },
        clearcoat: Clearcoat { strength: map(0.16, 7), roughness: map(0.17, 8), normal: normal(0.18, 9) },
        sheen: Sheen { colour: colour(0.21, 10), roughness: map(0.24, 11) },
        anisotropy: Anisotropy { strength: 0.25, rotation: -2.6, texture: some(12) },
        iridescence: Iridescence {
            strength: map(0.27, 13),
            ior: 2.8,
            thickness_nm: [129.0, 1310.0],
            thickness_texture: some(14),
        },
        diffuse_transmission: DiffuseTransmission { strength: map(0.31, 16), colour: colour(0.32, 15) },
    }
}

/// A primitive of `vertices` vertices with every attribute.
pub(super) fn primitive(vertices: usize, material: u32) -> Primitive {
    let at = |i: usize, k: usize| ((i * 7 + k * 13) % 101) as f32 / 16.0;
    // Normalised as a reader does, which changes them no more.
    let unit = |i: usize| {
        let v = [DVec3::new(1.0, 2.0, 2.0), DVec3::new(0.0, -1.0, 0.5), DVec3::new(-3.0, 0.5, 1.0)][i % 3];
        turned(DMat3::IDENTITY, v)
    };
    Primitive {
        positions: (0..vertices).map(|i| [at(i, 0) + i as f32, at(i * i, 1), at(i, 2) - 3.0]).collect(),
        normals: (0..vertices).map(unit).collect(),
        tangents: (0..vertices)
            .map(|i| {
                let [x, y, z] = unit(i + 1);
                [x, y, z, if i % 2 == 0 { 1.0 } else { -1.0 }]
            })
            .collect(),
        uv0: (0..vertices).map(|i| [at(i, 3), at(i, 4)]).collect(),
        uv1: (0..vertices).map(|i| [at(i, 5), -at(i, 6)]).collect(),
        colours: (0..vertices).map(|i| [7, 8, 9, 10].map(|k| at(i, k) / 8.0)).collect(),
        triangles: (2..vertices as u32).map(|i| [i - 2, i - 1, i]).collect(),
        material,
    }
}

/// An object with materials with every field, with none, and with few.
pub(super) fn sample() -> Object {
    let few = Material {
        name: "few".to_owned(),
        base_colour_texture: Some(TextureRef { transform: None, ..reference(17, 3) }),
        emissive: [0.25, 0.5, 1.0],
        alpha_mode: AlphaMode::Blend,
        ..Material::default()
    };
    let bare = Primitive {
        positions: vec![[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.3, -0.7]],
        triangles: vec![[2, 1, 0]],
        material: 1,
        ..Primitive::default()
    };
    Object {
        primitives: vec![primitive(5, 0), bare, primitive(300, 2)],
        materials: vec![full(), Material::default(), few],
        textures: (1..19).map(|i| texture(i, 3, i % 2 == 0)).collect(),
    }
}
