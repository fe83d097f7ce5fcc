//! Shapes of a glTF file: the scene's nodes, their transforms, morph weights and skins, and primitives.

use engine::{Context, NodeError, Notes};
use glam::{DMat3, DMat4, DQuat, DVec3};
use gltf::mesh::Mode;
use gltf::scene::Transform;
use gltf::{Accessor, Node, Semantic};

use super::tangents;
use crate::Error;
use crate::io::gltf::{File, Numbers};
use crate::types::{Material, Primitive};

/// Most vertices of one object; beyond that a small file that repeats a mesh could fill any memory.
const VERTEX_LIMIT: usize = 1 << 26;

/// What was dropped or repaired, to be told.
#[derive(Default)]
struct Tally {
    points_and_lines: u64,
    not_finite: u64,
    without_area: u64,
    left_over: u64,
    unmapped: u64,
    coordinates: u64,
    normals: u64,
    colours: u64,
    tangents_made: u64,
    tangents_arbitrary: u64,
    morphed: u64,
    skinned: u64,
    mirrored: u64,
    instances: u64,
}

/// Reads shapes.
pub struct Geometry<'a> {
    name: &'a str,
    file: &'a File,
    buffers: &'a [Vec<u8>],
    /// From the frame of each node to that of the file, for every node of every scene.
    world: Vec<Option<DMat4>>,
    tally: Tally,
}

impl<'a> Geometry<'a> {
    /// A reader of `file`.
    pub fn new(name: &'a str, file: &'a File, buffers: &'a [Vec<u8>]) -> Self {
        let world = vec![None; file.document.nodes().len()];
        Self { name, file, buffers, world, tally: Tally::default() }
    }

    fn bad(&self, what: impl Into<String>) -> Error {
        Error::format(self.name, what)
    }

    /// The primitives of a scene (the file's own choice where `scene` is `None`), in order of the nodes.
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
        // Joints may belong to another scene, so all nodes are walked first.
        self.walk(roots.clone(), |_| {})?;
        let count = document.scenes().len();
        let chosen = match scene {
            Some(index) => Some(document.scenes().nth(index as usize).ok_or_else(|| {
                NodeError::new(format!("`{}` has {count} scenes, so none is number {index}", self.name))
                    .at("scene")
            })?),
            None => document.default_scene().or_else(|| document.scenes().next()),
        };
        if let (Some(chosen), None, true) = (&chosen, scene, count > 1) {
            notes.decision(
                "scene",
                format!("of {count} scenes in the file, number {} is taken", chosen.index()),
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
                        return Err(self.bad(format!("has more than {VERTEX_LIMIT} vertices")).into());
                    }
                    if !read.triangles.is_empty() {
                        primitives.push(read);
                    }
                }
            }
        }
        self.tell(notes);
        if primitives.is_empty() {
            let t = &self.tally;
            let why = match (t.without_area, t.points_and_lines) {
                (0, 0) => String::new(),
                (0, n) => format!(", but points or lines in {n} primitives"),
                (n, _) => format!(
                    " with an area, of {n}; are they smaller than the steps of its numbers, or no numbers?"
                ),
            };
            return Err(self.bad(format!("holds no triangles{why}")).into());
        }
        Ok(primitives)
    }

    /// Visits nodes below `starts`, parents first and children in order, and fills `world`.
    fn walk(&mut self, starts: Vec<Node<'a>>, mut visit: impl FnMut(Node<'a>)) -> Result<(), Error> {
        let mut seen = vec![false; self.world.len()];
        let mut stack: Vec<(Node<'a>, DMat4)> =
            starts.into_iter().rev().map(|n| (n, DMat4::IDENTITY)).collect();
        while let Some((node, parent)) = stack.pop() {
            let index = node.index();
            if std::mem::replace(&mut seen[index], true) {
                return Err(self.bad(format!("node {index} is reached twice; nodes must form trees")));
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

    fn numbers(&self, accessor: &Accessor<'_>) -> Result<Numbers, Error> {
        self.file.numbers(accessor, self.buffers)
    }

    /// Where the copies of a node's mesh stand in its frame: EXT_mesh_gpu_instancing, or one as it is.
    fn instances(&mut self, node: &Node<'_>) -> Result<Vec<DMat4>, Error> {
        let attributes =
            &self.file.json["nodes"][node.index()]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
        let mut count = None;
        let mut read = |semantic: &str, width: usize| -> Result<Vec<f64>, Error> {
            let Some(index) = attributes[semantic].as_u64() else { return Ok(Vec::new()) };
            let accessor = self.file.document.accessors().nth(index as usize);
            let accessor =
                accessor.ok_or_else(|| self.bad(format!("{semantic} of instances names no accessor")))?;
            let numbers = self.numbers(&accessor)?;
            if numbers.width != width || *count.get_or_insert(accessor.count()) != accessor.count() {
                return Err(self.bad(format!("{semantic} of instances does not fit the others")));
            }
            Ok(numbers.values)
        };
        let (places, turns) = (read("TRANSLATION", 3)?, read("ROTATION", 4)?);
        let scales = read("SCALE", 3)?;
        let Some(count) = count else { return Ok(vec![DMat4::IDENTITY]) };
        self.tally.instances += count as u64;
        let triple = |values: &[f64], i: usize, default: f64| {
            values.as_chunks::<3>().0.get(i).map_or(DVec3::splat(default), |v| DVec3::from_array(*v))
        };
        let instance = |i: usize| {
            let turn = turns.as_chunks::<4>().0.get(i).copied().unwrap_or([0.0, 0.0, 0.0, 1.0]);
            let (scale, place) = (triple(&scales, i, 1.0), triple(&places, i, 0.0));
            DMat4::from_scale_rotation_translation(scale, rotation(turn), place)
        };
        let instances: Vec<DMat4> = (0..count).map(instance).collect();
        match instances.iter().position(|m| !m.is_finite()) {
            Some(bad) => Err(self.bad(format!("instance {bad} of node {} is not finite", node.index()))),
            None => Ok(instances),
        }
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
            _ => Err(self.bad(format!("{} does not fit its primitive", semantic.to_string()))),
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
                "positions without data, as compressed meshes have them",
            ));
        }
        let numbers = self.numbers(&accessor)?;
        let n = accessor.count();
        let mut positions =
            numbers.arrays::<3>().ok_or_else(|| self.bad("positions are not triples"))?.to_vec();
        let mut normals = self.attribute::<3>(primitive, Semantic::Normals, n)?.unwrap_or_default();
        let mut tangents = self.attribute::<4>(primitive, Semantic::Tangents, n)?.unwrap_or_default();
        self.morph(node, primitive, &mut positions, &mut normals, &mut tangents)?;

        let mut triangles = self.triangles(primitive, n)?;
        let skin = self.skin(node, primitive, n)?;
        let world = self.world[node.index()].unwrap_or_default() * instance;
        // A skinned mesh follows its joints alone: section 3.7.3 of the specification.
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
                // The default material stands behind those of the file, once.
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
            return Err(self.bad("a primitive names what it does not have"));
        }
        Ok(Some(p))
    }

    /// Texture coordinates and vertex colours.
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
            return Err(self.bad("vertex colours do not fit their primitive"));
        }
        for colour in numbers.values.chunks_exact(numbers.width) {
            let legal = colour.iter().all(|c| (0.0..=1.0).contains(c));
            self.tally.colours += u64::from(!legal);
            let channel =
                |i: usize| colour.get(i).map_or(1.0, |&c| if c > 0.0 { c.min(1.0) as f32 } else { 0.0 });
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
                    return Err(self.bad(format!("indices name vertices beyond the {n} there are")));
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

    /// Adds the morph targets at the file's own weights.
    fn morph(
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
                let deltas =
                    numbers.arrays::<3>().ok_or_else(|| self.bad("morph targets are not triples"))?;
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

    /// The blended joint matrix of every vertex, with the joints where the file has them.
    fn skin(
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
                let matrices =
                    numbers.arrays::<16>().ok_or_else(|| self.bad("bind matrices are not 4 x 4"))?;
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
                    .ok_or_else(|| self.bad("a vertex names an unknown joint"))?;
                blended += *matrix * (weight / sum);
            }
            Ok(if sum > 0.0 { blended } else { matrices.first().copied().unwrap_or_default() })
        };
        (0..n).map(blend).collect::<Result<_, Error>>().map(Some)
    }

    /// Repairs normals, and makes tangents where a normal map needs them.
    fn shading_frame(&mut self, p: &mut Primitive, normal_map: Option<bool>) {
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
            // Flat normals, which the specification asks for; given tangents are then void.
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

    fn tell(&self, notes: &mut Notes) {
        let t = &self.tally;
        for (id, count, what) in [
            ("points-and-lines", t.points_and_lines, "primitives of points or lines were left out"),
            (
                "vertices-not-finite",
                t.not_finite,
                "vertices are not finite numbers; their triangles were dropped",
            ),
            (
                "triangles-dropped",
                t.without_area,
                "triangles without area or with such vertices were dropped",
            ),
            ("indices-left-over", t.left_over, "indices at the end make no whole triangle"),
            (
                "no-coordinates",
                t.unmapped,
                "primitives have a texture but not its coordinates; all of them show its corner",
            ),
            (
                "coordinates-not-finite",
                t.coordinates,
                "texture coordinates are not finite numbers; 0 stands for them",
            ),
            ("normals-repaired", t.normals, "normals without length were made from the faces around"),
            ("colours-clamped", t.colours, "vertex colours outside of 0 to 1 were clamped"),
            (
                "tangents-made",
                t.tangents_made,
                "primitives with bumps or a brush had no tangents; they were made",
            ),
            (
                "tangents-arbitrary",
                t.tangents_arbitrary,
                "vertices have texture coordinates without direction",
            ),
            ("morph-targets", t.morphed, "morph targets were applied at the weights of the file"),
            ("skins", t.skinned, "skinned primitives were posed as the file has their joints"),
            ("instances", t.instances, "copies of meshes by EXT_mesh_gpu_instancing"),
            (
                "mirrored",
                t.mirrored,
                "primitives are mirrored by their nodes; their triangles were turned over",
            ),
        ] {
            notes.count(id, count, what);
        }
    }
}

fn usable(t: &[u32; 3], positions: &[[f32; 3]], finite: &[bool]) -> bool {
    let [a, b, c] = t.map(|v| DVec3::from_array(positions[v as usize].map(f64::from)));
    t.iter().all(|&v| finite[v as usize]) && (b - a).cross(c - a) != DVec3::ZERO
}

fn local(transform: &Transform) -> DMat4 {
    match transform {
        Transform::Matrix { matrix } => {
            DMat4::from_cols_array(&std::array::from_fn(|i| f64::from(matrix[i / 4][i % 4])))
        }
        Transform::Decomposed { translation, rotation, scale } => {
            let [t, s] = [translation, scale].map(|v| DVec3::from_array(v.map(f64::from)));
            DMat4::from_scale_rotation_translation(s, self::rotation(rotation.map(f64::from)), t)
        }
    }
}

/// A quaternion of length 0 is no rotation; any other is made one.
fn rotation(q: [f64; 4]) -> DQuat {
    let q = DQuat::from_array(q);
    if q.length() > 0.0 { q.normalize() } else { DQuat::IDENTITY }
}

fn inverse_transpose(m: DMat3) -> DMat3 {
    // Cofactors: the inverse transpose times the determinant, so a flat matrix divides by nothing. The
    // sign of the determinant turns the normals of a mirror the right way.
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
    let sign = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign
}

/// A unit vector, or zero where there is none.
fn turned(m: DMat3, v: DVec3) -> [f32; 3] {
    let unit = (m * v).try_normalize().unwrap_or(DVec3::ZERO);
    unit.as_vec3().to_array()
}

/// For each vertex the normalised sum of the normals of its faces, weighted by area; up where it is 0.
fn summed_face_normals(p: &Primitive) -> Vec<[f32; 3]> {
    let mut sums = vec![DVec3::ZERO; p.positions.len()];
    for t in &p.triangles {
        let [a, b, c] = t.map(|v| DVec3::from_array(p.positions[v as usize].map(f64::from)));
        let normal = (b - a).cross(c - a);
        t.iter().for_each(|&v| sums[v as usize] += normal);
    }
    sums.into_iter().map(|sum| sum.try_normalize().unwrap_or(DVec3::Y).as_vec3().to_array()).collect()
}

/// Gives every triangle vertices of its own.
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
