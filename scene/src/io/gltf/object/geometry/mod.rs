//! Shapes of a glTF file: the scene's nodes, their transforms, morph weights and skins, and primitives.

mod deform;
mod matrix;
mod shading_frame;
mod tally;
mod transform;

use engine::{Context, NodeError, Notes};
use glam::{DMat3, DMat4, DVec3};
use gltf::mesh::Mode;
use gltf::{Accessor, Node, Semantic};

use crate::error::Error;
use crate::io::colour_range::Range;
use crate::io::gltf::{File, Numbers};
use crate::types::{Material, Primitive};
pub use matrix::local;
pub(in crate::io::gltf) use matrix::{inverse_transpose, turned};
use tally::Tally;

/// Maximum number of vertices of an object. Without this limit, a small file that repeats a mesh could exhaust the
/// memory.
const VERTEX_LIMIT: usize = 1 << 26;

/// Reader of the shapes of a file.
pub struct Geometry<'a> {
    name: &'a str,
    file: &'a File,
    buffers: &'a [Vec<u8>],
    /// Transform from the frame of each node to the frame of the file, for the nodes of all scenes.
    world: Vec<Option<DMat4>>,
    /// The values of colour and of opacity in vertex colours that stand for white and opaque.
    white: [Range; 2],
    tally: Tally,
}

impl<'a> Geometry<'a> {
    /// Creates a reader of `file`.
    pub fn new(name: &'a str, file: &'a File, buffers: &'a [Vec<u8>]) -> Self {
        let world = vec![None; file.document.nodes().len()];
        let white = [Range::UNIT; 2];
        let mut made = Self { name, file, buffers, world, white, tally: Tally::default() };
        made.white = made.colour_ranges();
        made
    }

    fn bad(&self, what: impl Into<String>) -> Error {
        Error::format(self.name, what)
    }

    /// The primitives of a scene (the default scene of the file if `scene` is `None`), in order of the nodes.
    pub fn scene(
        &mut self,
        scene: Option<u32>,
        materials: &mut Vec<Material>,
        cx: &Context,
        notes: &mut Notes,
    ) -> Result<Vec<Primitive>, NodeError> {
        let document = &self.file.document;
        let mut is_child = vec![false; self.world.len()];
        for child in document.nodes().flat_map(|node| node.children()) {
            is_child[child.index()] = true;
        }
        let roots: Vec<Node<'_>> = document.nodes().filter(|node| !is_child[node.index()]).collect();
        // Joints may belong to another scene, so all nodes are visited first.
        self.walk(roots.clone(), |_| {})?;
        let count = document.scenes().len();
        let chosen = match scene {
            Some(index) => Some(document.scenes().nth(index as usize).ok_or_else(|| {
                NodeError::new(format!(
                    "`{}` has no scene with the index {index} (number of scenes: {count})",
                    self.name
                ))
                .at("scene")
            })?),
            None => document.default_scene().or_else(|| document.scenes().next()),
        };
        if let (Some(chosen), None, true) = (&chosen, scene, count > 1) {
            notes.decision(
                "scene",
                format!(
                    "the scene with the index {} is used (number of scenes in the file: {count})",
                    chosen.index()
                ),
            );
        }
        let mut order = Vec::new();
        let starts = chosen.map_or(roots, |scene| scene.nodes().collect());
        self.walk(starts, |node| order.push(node))?;
        let mut primitives = Vec::new();
        let (mut vertices, total) = (0, order.len().max(1));
        for (done, node) in order.iter().enumerate() {
            cx.progress(done as f32 / total as f32);
            let Some(mesh) = node.mesh() else { continue };
            for instance in self.instances(node)? {
                for primitive in mesh.primitives() {
                    cx.check()?;
                    let Some(read) = self.primitive(node, &primitive, instance, materials)? else { continue };
                    vertices += read.positions.len();
                    if vertices > VERTEX_LIMIT {
                        return Err(self
                            .bad(format!("the object has more than {VERTEX_LIMIT} vertices"))
                            .into());
                    }
                    if !read.triangles.is_empty() {
                        primitives.push(read);
                    }
                }
            }
        }
        self.tally.report(notes);
        if self.white[0].guessed {
            let range = self.white[0].words();
            notes.warning("colour-range", format!("vertex colours are assumed to range {range}"));
        }
        if primitives.is_empty() {
            let t = &self.tally;
            let why = match (t.without_area, t.points_and_lines) {
                (0, 0) => String::new(),
                (0, n) => format!(", only points or lines (primitives: {n})"),
                (n, _) => format!(
                    " with a nonzero area; triangles that are too small for the precision of the coordinates, or are not finite, were dropped (number: {n})"
                ),
            };
            return Err(self.bad(format!("the object has no triangles{why}")).into());
        }
        Ok(primitives)
    }

    /// Visits `starts` and all nodes below them, parents first and children in order, and fills `world`.
    fn walk(&mut self, starts: Vec<Node<'a>>, mut visit: impl FnMut(Node<'a>)) -> Result<(), Error> {
        let mut seen = vec![false; self.world.len()];
        let mut stack: Vec<(Node<'a>, DMat4)> =
            starts.into_iter().rev().map(|n| (n, DMat4::IDENTITY)).collect();
        while let Some((node, parent)) = stack.pop() {
            let index = node.index();
            if std::mem::replace(&mut seen[index], true) {
                return Err(
                    self.bad(format!("node {index} appears twice in the hierarchy; nodes must form trees"))
                );
            }
            let world = self.world[index].unwrap_or_else(|| parent * local(&node.transform()));
            if !world.is_finite() {
                return Err(self.bad(format!("the transform of node {index} is not finite")));
            }
            self.world[index] = Some(world);
            stack.extend(node.children().map(|child| (child, world)).collect::<Vec<_>>().into_iter().rev());
            visit(node);
        }
        Ok(())
    }

    /// Ranges of the vertex colours and of their opacities, inferred from all primitives of the file.
    fn colour_ranges(&self) -> [Range; 2] {
        let primitives = self.file.document.meshes().flat_map(|mesh| mesh.primitives());
        let accessors = primitives.filter_map(|primitive| primitive.get(&Semantic::Colors(0)));
        // What is wrong with an accessor is reported where it is used.
        let lists: Vec<Numbers> = accessors.filter_map(|accessor| self.numbers(&accessor).ok()).collect();
        let lists = || lists.iter().filter(|list| matches!(list.width, 3 | 4));
        let rows = || lists().flat_map(|list| list.values.chunks_exact(list.width));
        let colours = Range::of_floats(rows().flat_map(|row| &row[..3]).copied());
        [colours, Range::of_floats(rows().filter_map(|row| row.get(3)).copied())]
    }

    fn numbers(&self, accessor: &Accessor<'_>) -> Result<Numbers, Error> {
        self.file.numbers(accessor, self.buffers)
    }

    fn attribute<const N: usize>(
        &self,
        primitive: &gltf::Primitive<'_>,
        semantic: Semantic,
        vertices: usize,
    ) -> Result<Option<Vec<[f64; N]>>, Error> {
        let Some(accessor) = primitive.get(&semantic) else { return Ok(None) };
        let numbers = self.numbers(&accessor)?;
        match numbers.arrays::<N>() {
            Some(values) if values.len() == vertices => Ok(Some(values.to_vec())),
            _ => Err(self.bad(format!(
                "the attribute {} of a primitive has the wrong type or number of elements",
                semantic.to_string()
            ))),
        }
    }

    fn primitive(
        &mut self,
        node: &Node<'_>,
        primitive: &gltf::Primitive<'_>,
        instance: DMat4,
        materials: &mut Vec<Material>,
    ) -> Result<Option<Primitive>, Error> {
        if matches!(primitive.mode(), Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
            self.tally.points_and_lines += 1;
            return Ok(None);
        }
        let Some(accessor) = primitive.get(&Semantic::Positions) else { return Ok(None) };
        if accessor.view().is_none() && accessor.sparse().is_none() {
            return Err(Error::unsupported(
                self.name,
                "positions without data, which occur in compressed meshes",
            ));
        }
        let numbers = self.numbers(&accessor)?;
        let n = accessor.count();
        let mut positions = numbers
            .arrays::<3>()
            .ok_or_else(|| self.bad("the positions do not have three numbers per vertex"))?
            .to_vec();
        let mut normals = self.attribute::<3>(primitive, Semantic::Normals, n)?.unwrap_or_default();
        let mut tangents = self.attribute::<4>(primitive, Semantic::Tangents, n)?.unwrap_or_default();
        self.morph(node, primitive, &mut positions, &mut normals, &mut tangents)?;

        let mut triangles = self.triangles(primitive, n)?;
        let skin = self.skin(node, primitive, n)?;
        let world = self.world[node.index()].unwrap_or_default() * instance;
        // A skinned mesh follows its joints only: section 3.7.3 of the specification.
        let transform = |v: usize| skin.as_ref().map_or(world, |matrices| matrices[v]);
        let mirrored = n > 0 && DMat3::from_mat4(transform(0)).determinant() < 0.0;
        let mut p = Primitive::default();
        let mut finite = vec![true; n];
        for v in 0..n {
            let m = transform(v);
            let position = m.transform_point3(DVec3::from_array(positions[v])).as_vec3();
            finite[v] = position.is_finite();
            p.positions.push(if finite[v] { position.to_array() } else { [0.0; 3] });
            let linear = DMat3::from_mat4(m);
            if let Some(normal) = normals.get(v) {
                p.normals.push(turned(inverse_transpose(linear), DVec3::from_array(*normal)));
            }
            if let Some([x, y, z, w]) = tangents.get(v).copied() {
                let [x, y, z] = turned(linear, DVec3::new(x, y, z));
                p.tangents.push([x, y, z, if (w < 0.0) == mirrored { 1.0 } else { -1.0 }]);
            }
        }
        if mirrored {
            self.tally.mirrored += 1;
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let all = triangles.len();
        p.triangles = triangles.into_iter().filter(|t| usable(t, &p.positions, &finite)).collect();
        self.tally.without_area += (all - p.triangles.len()) as u64;
        self.tally.not_finite += finite.iter().filter(|f| !**f).count() as u64;
        self.rest(primitive, n, &mut p)?;

        p.material = match primitive.material().index() {
            Some(index) => index as u32,
            None => {
                // The default material is added once after those of the file.
                let named = self.file.document.materials().len();
                if materials.len() == named {
                    materials.push(Material::default());
                }
                named as u32
            }
        };
        let material = materials.get(p.material as usize);
        let pictures = material.into_iter().flat_map(|m| {
            [m.base_colour_texture, m.metallic_roughness_texture, m.emissive_texture].into_iter().flatten()
        });
        let mapped = |set: u32| !if set == 0 { &p.uv0 } else { &p.uv1 }.is_empty();
        self.tally.unmapped += u64::from(pictures.into_iter().any(|picture| !mapped(picture.uv_set)));
        let set = material.and_then(Material::tangent_set);
        self.shading_frame(&mut p, set.map(|set| set == 1));
        if !p.is_consistent() {
            return Err(self.bad("a primitive refers to data that does not exist"));
        }
        Ok(Some(p))
    }

    /// Reads texture coordinates and vertex colours.
    fn rest(&mut self, primitive: &gltf::Primitive<'_>, n: usize, p: &mut Primitive) -> Result<(), Error> {
        for (set, to) in [(0, &mut p.uv0), (1, &mut p.uv1)] {
            let uv = self.attribute::<2>(primitive, Semantic::TexCoords(set), n)?.unwrap_or_default();
            let good = |uv: &[f64; 2]| uv.iter().all(|c| c.is_finite());
            self.tally.coordinates += uv.iter().filter(|uv| !good(uv)).count() as u64;
            *to = uv.into_iter().map(|uv| uv.map(|c| if c.is_finite() { c as f32 } else { 0.0 })).collect();
        }
        let Some(accessor) = primitive.get(&Semantic::Colors(0)) else { return Ok(()) };
        let numbers = self.numbers(&accessor)?;
        if !matches!(numbers.width, 3 | 4) || accessor.count() != n {
            return Err(
                self.bad("the vertex colours of a primitive have the wrong type or number of elements")
            );
        }
        for colour in numbers.values.chunks_exact(numbers.width) {
            let scaled = |i: usize| Some(*colour.get(i)? / self.white[usize::from(i == 3)].white);
            let legal = (0..4).filter_map(scaled).all(|c| (0.0..=1.0).contains(&c));
            self.tally.colours += u64::from(!legal);
            let channel = |i: usize| scaled(i).map_or(1.0, |c| if c > 0.0 { c.min(1.0) as f32 } else { 0.0 });
            p.colours.push([channel(0), channel(1), channel(2), channel(3)]);
        }
        Ok(())
    }

    fn triangles(&mut self, primitive: &gltf::Primitive<'_>, n: usize) -> Result<Vec<[u32; 3]>, Error> {
        let indices: Vec<u32> = match primitive.indices() {
            Some(accessor) => {
                let numbers = self.numbers(&accessor)?;
                if numbers.width != 1
                    || numbers.values.iter().any(|&i| i.is_nan() || i < 0.0 || i >= n as f64)
                {
                    return Err(self.bad(format!(
                        "an index refers to a vertex that does not exist (the primitive has {n} vertices)"
                    )));
                }
                numbers.values.into_iter().map(|i| i as u32).collect()
            }
            None => (0..n as u32).collect(),
        };
        Ok(match primitive.mode() {
            Mode::TriangleStrip => indices
                .windows(3)
                .enumerate()
                .map(|(k, w)| if k % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] })
                .collect(),
            Mode::TriangleFan => {
                indices.windows(2).skip(1).map(|pair| [indices[0], pair[0], pair[1]]).collect()
            }
            _ => {
                let (whole, rest) = indices.as_chunks::<3>();
                self.tally.left_over += rest.len() as u64;
                whole.to_vec()
            }
        })
    }
}

fn usable(t: &[u32; 3], positions: &[[f32; 3]], finite: &[bool]) -> bool {
    let [a, b, c] = t.map(|v| DVec3::from_array(positions[v as usize].map(f64::from)));
    t.iter().all(|&v| finite[v as usize]) && (b - a).cross(c - a) != DVec3::ZERO
}
