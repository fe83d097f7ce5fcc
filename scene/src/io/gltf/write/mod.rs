//! Placed objects as a GLB file, for viewers and other programs.
//!
//! Each placed object is one node, whose matrix is the transform of the object. Objects that are equal share a mesh,
//! and equal pictures are written once. Extensions are written only where a material differs from their defaults, and
//! the file requires none of them. The same objects give the same bytes.

mod bake;
mod binary;
mod check;
mod material;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use engine::{Context, NodeError, Notes};
use glam::{DMat3, DMat4};
use serde_json::{Value, json};

use self::binary::Binary;
use self::check::{Bad, checked};
use self::material::{Fields, Materials, Medium};
use crate::io::png::{self, Packing, Raster};
use crate::io::progress::Progress;
use crate::math::num;
use crate::types::{Object, Placed, Primitive, Texture};

/// Share of the progress at which the pictures are compressed, which takes most of the time.
const LAID_OUT: f32 = 0.05;

/// Encodes objects as a GLB file. Returns its bytes and notes on what the file does not contain.
///
/// `file_from_world` is a rotation from the world to the frame of the file. The file has the unit of the world.
///
/// # Errors
/// Objects that no file can store: those with numbers that are not finite or that refer to data that do not exist,
/// transforms that cannot be inverted, files of more than 4 GiB, and objects without a triangle.
pub fn encode(
    objects: &[Arc<Placed>],
    file_from_world: DMat3,
    cx: &Context,
) -> Result<(Vec<u8>, Notes), NodeError> {
    let mut notes = Notes::none();
    let (shapes, nodes) = shapes(objects, DMat4::from_mat3(file_from_world), cx, &mut notes)?;
    let (mut binary, mut materials) = (Binary::default(), Materials::default());
    let meshes = shapes
        .iter()
        .map(|shape| shape.mesh(&mut binary, &mut materials).map_err(|bad| bad.of(shape.first)))
        .collect::<Result<Vec<Value>, NodeError>>()?;
    // Before the pictures are compressed, which may take long.
    binary.fits()?;
    let pictures = std::mem::take(&mut materials.images);
    let mut images = Vec::with_capacity(pictures.len());
    for (index, picture) in pictures.iter().enumerate() {
        let progress = Progress::of(cx, LAID_OUT, 1.0).piece(index, pictures.len());
        let view = binary.file(compressed(picture, progress)?);
        images.push(json!({ "bufferView": view, "mimeType": "image/png" }));
    }
    let mut document = Fields::default();
    document.set("asset", json!({ "version": "2.0", "generator": "lightharmony" }));
    document.set("scene", json!(0));
    document.set("scenes", json!([{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }]));
    for (name, list) in [("nodes", nodes), ("meshes", meshes), ("images", images)]
        .into_iter()
        .chain(materials.lists())
        .chain(binary.lists())
    {
        // Lists of glTF must not be empty.
        document.put(name, list, Vec::new());
    }
    Ok((binary.container(document.value(), cx)?, notes))
}

/// An object as the file stores it, and its size.
struct Shape {
    object: Arc<Object>,
    /// Length in the file of one unit of the object's coordinates, if a material absorbs light; otherwise 1.
    scale: f64,
    /// Index of the first placed object that has this shape.
    first: usize,
}

/// The different shapes of `objects`, and the nodes that place them. Objects without triangles are left out.
fn shapes(
    objects: &[Arc<Placed>],
    file_from_world: DMat4,
    cx: &Context,
    notes: &mut Notes,
) -> Result<(Vec<Shape>, Vec<Value>), NodeError> {
    let (mut shapes, mut nodes, mut empty) = (Vec::<Shape>::new(), Vec::new(), 0);
    for (index, placed) in objects.iter().enumerate() {
        cx.check()?;
        let matrix = file_from_world * placed.world_from_object;
        checked(&placed.object, matrix).map_err(|bad| bad.of(index))?;
        if placed.object.primitives.iter().all(|primitive| primitive.triangles.is_empty()) {
            empty += 1;
            continue;
        }
        // Light is absorbed per unit of the file, whatever the transform of the node; an object that is scaled keeps
        // its appearance.
        let absorbs = placed.object.materials_in_use().any(|material| material.volume.is_some());
        let volume = DMat3::from_mat4(matrix).determinant().abs();
        let scale = if absorbs { num::pow(volume, 1.0 / 3.0) } else { 1.0 };
        let sheared = bake::is_sheared(matrix);
        let (object, matrix) = if sheared {
            (Arc::new(bake::transformed(&placed.object, matrix)), DMat4::IDENTITY)
        } else {
            (Arc::clone(&placed.object), matrix)
        };
        let same = |shape: &Shape| {
            shape.scale == scale && (Arc::ptr_eq(&shape.object, &object) || shape.object == object)
        };
        let mesh = shapes.iter().position(same).unwrap_or_else(|| {
            shapes.push(Shape { object, scale, first: index });
            shapes.len() - 1
        });
        let mut node = Fields::default();
        node.set("name", json!(format!("object {index}")));
        node.set("mesh", json!(mesh));
        node.put("matrix", matrix.to_cols_array(), DMat4::IDENTITY.to_cols_array());
        nodes.push(node.value());
    }
    notes.count("objects-empty", empty, "of the objects had no triangles, and had to be left out");
    if nodes.is_empty() {
        let hint = "check the warnings of the nodes that make the objects";
        return Err(NodeError::new("the objects have no triangles to write").hint(hint));
    }
    Ok((shapes, nodes))
}

impl Shape {
    /// The mesh of the shape. Adds its arrays to `binary` and the materials in use to `materials`.
    fn mesh<'a>(&'a self, binary: &mut Binary<'a>, materials: &mut Materials<'a>) -> Result<Value, Bad> {
        let object = &*self.object;
        let parts = || object.primitives.iter().filter(|primitive| !primitive.triangles.is_empty());
        let mut places = vec![None; object.materials.len()];
        for (index, material) in object.materials.iter().enumerate() {
            let own = || parts().filter(|primitive| primitive.material as usize == index);
            if own().next().is_some() {
                let medium = Medium { thickness: thickness(own()), scale: self.scale };
                places[index] = Some(materials.add(material, medium, &object.textures)?);
            }
        }
        let primitives: Vec<Value> = parts()
            .map(|primitive| {
                json!({
                    "attributes": attributes(primitive, binary),
                    "indices": binary.indices(&primitive.triangles, primitive.positions.len()),
                    "material": places[primitive.material as usize],
                })
            })
            .collect();
        Ok(json!({ "primitives": primitives }))
    }
}

/// Adds the arrays of a primitive to `binary`. Returns their accessors by attribute.
fn attributes<'a>(p: &'a Primitive, binary: &mut Binary<'a>) -> Value {
    let mut attributes = Fields::default();
    attributes.set("POSITION", json!(binary.positions(&p.positions)));
    let mut add = |name: &str, accessor: Option<usize>| {
        if let Some(accessor) = accessor {
            attributes.set(name, json!(accessor));
        }
    };
    add("NORMAL", binary.floats(&p.normals));
    add("TANGENT", binary.floats(&p.tangents));
    add("TEXCOORD_0", binary.floats(&p.uv0));
    add("TEXCOORD_1", binary.floats(&p.uv1));
    add("COLOR_0", binary.floats(&p.colours));
    attributes.value()
}

/// Thickness that rasterizers assume for a body with this surface, which they do not trace: the shortest side of the
/// bounding box that is not 0, in the coordinates of the object. Above 0.
fn thickness<'a>(surface: impl Iterator<Item = &'a Primitive>) -> f32 {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for position in surface.flat_map(|primitive| &primitive.positions) {
        low = std::array::from_fn(|k| low[k].min(position[k]));
        high = std::array::from_fn(|k| high[k].max(position[k]));
    }
    let sides = (0..3).map(|k| high[k] - low[k]).filter(|side| *side > 0.0 && side.is_finite());
    let shortest = sides.fold(f32::INFINITY, f32::min);
    if shortest.is_finite() { shortest } else { 1.0 }
}

/// A texture as PNG, without the alpha channel if all texels are opaque.
fn compressed(texture: &Texture, progress: Progress<'_>) -> Result<Vec<u8>, NodeError> {
    let texels = texture.rgba.as_chunks::<4>().0;
    let channels = if texels.iter().all(|texel| texel[3] == 255) { 3 } else { 4 };
    // Not collected, since the list would grow to twice its length.
    let mut codes = Vec::with_capacity(texels.len() * channels);
    codes.extend(texels.iter().flat_map(|texel| &texel[..channels]).map(|&code| u16::from(code)));
    let (width, height) = (texture.width as usize, texture.height as usize);
    let raster = Raster { width, height, channels, largest: 255, codes, ignored: Vec::new(), colour: None };
    // glTF determines the meaning of the codes, and the file must not state another one.
    let mut bytes = png::write_for(&raster, Packing::Small, None, &[], progress)?;
    bytes.shrink_to_fit();
    Ok(bytes)
}
