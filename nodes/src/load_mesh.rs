//! `load-mesh`: the receiver, the stand-in mesh of the captured place.

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, FileHead, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot,
};
use glam::DVec3;

use crate::color::linear_from_srgb;
use crate::io::{gltf, head, ply};
use crate::place::world_from_gltf;
use crate::types::{Mesh, Primitive};
use crate::{Error, load_object};

engine::choices! {
    /// How vertex colours are encoded.
    pub enum ColourEncoding {
        /// As they are usually written: sRGB in PLY and in what trimesh writes, else linear in glTF.
        Auto,
        /// Display-encoded with the sRGB curve.
        Srgb,
        /// Linear light.
        Linear,
    }
}
engine::choices! {
    /// The frame of a mesh file.
    pub enum MeshFrame {
        /// The world of the scene, in world units: as mesh extraction writes it.
        World,
        /// glTF's: y up and in metres; turned and scaled by the scene block.
        Gltf,
    }
}
engine::params! {
    /// Loads a triangle mesh: PLY (ASCII or binary), glTF or GLB.
    ///
    /// The mesh stands in for the captured place: it receives shadows and gives bounce light. Faces of
    /// more than three corners are cut into fans, vertex colours (of glTF, by `baseColorFactor`) become linear
    /// albedo, and what a tracer cannot use (vertices that are not numbers, faces without area) is dropped and counted.
    pub struct LoadMesh {
        /// The file: `.ply`, `.glb` or `.gltf`.
        path: InputFile, other("\"b.ply\"");
        /// How vertex colours are encoded.
        colours: ColourEncoding = ColourEncoding::Auto, other("Linear");
        /// Which frame the coordinates are in.
        frame: MeshFrame = MeshFrame::World, other("Gltf");
    }
}
engine::inputs! {
    /// None.
    pub struct In {}
}
engine::outputs! {
    /// The mesh.
    pub struct Out {
        /// The mesh in world units.
        mesh: Arc<Mesh>,
    }
}

/// A mesh as a file has it: colours not yet linear, faces not yet checked.
#[derive(Default)]
struct RawMesh {
    positions: Vec<[f64; 3]>,
    /// Whether the file holds them as f64.
    finer: bool,
    colours: Vec<[f64; 3]>,
    /// Linear, multiplied into the colours: glTF's `baseColorFactor`; none where all are white.
    tints: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    fanned: u64,
    /// Written by trimesh, which stores display colours in glTF too, as mesh extraction uses it.
    by_trimesh: bool,
}

impl Kind for LoadMesh {
    const NAME: &'static str = "load-mesh";
    const VERSION: u32 = 3;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        if is_gltf(&p.path) { load_object::sources(&p.path, root) } else { Ok(vec![root.file(&p.path)]) }
    }

    fn estimate_files(_: &Self, files: &[FileHead<'_>]) -> Cost {
        let all = files.iter().fold(0, |sum: u64, file| sum.saturating_add(file.bytes));
        let elements =
            files.first().and_then(FileHead::open).map(|mut reader| head::ply_elements(&mut reader));
        let of = |wanted: &str| {
            let found = elements.iter().flatten().find(|(name, ..)| name == wanted);
            found.map_or((0, 0), |(_, count, fields)| (*count, *fields))
        };
        let ((vertices, fields), (faces, _)) = (of("vertex"), of("face"));
        // In f64 as they are read, then in f32, and a new number of each vertex.
        let vertex = if fields > 3 { 2 * 24 + 2 * 12 + 4 } else { 24 + 12 + 4 };
        let bytes = vertices.saturating_mul(vertex).saturating_add(faces.saturating_mul(2 * 12));
        // glTF has floats and indices as they are; they are read to an object first.
        let bytes = if vertices == 0 { all.saturating_mul(5) } else { bytes };
        Cost { bytes: all.saturating_add(bytes) }
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let name = &p.path.0;
        let bytes = cx.read(&p.path).map_err(|e| e.at("path"))?;
        cx.progress(0.2);
        let of_gltf = is_gltf(&p.path);
        let mut raw =
            if of_gltf { from_gltf(p, &bytes, cx, &mut notes)? } else { from_ply(name, &bytes, cx)? };
        cx.progress(0.7);
        if p.frame == MeshFrame::Gltf {
            let m = world_from_gltf(cx.up(), cx.metres_per_unit());
            for position in &mut raw.positions {
                *position = m.transform_point3(DVec3::from_array(*position)).to_array();
            }
        }
        let srgb = match p.colours {
            ColourEncoding::Auto if !raw.colours.is_empty() => {
                let srgb = !of_gltf || raw.by_trimesh;
                let word = if srgb { "sRGB" } else { "linear" };
                notes.decision("colour-encoding", format!("vertex colours are taken to be {word}"));
                srgb
            }
            other => other == ColourEncoding::Srgb,
        };
        let mesh = clean(name, raw, srgb, cx, &mut notes)?;
        cx.count("triangles", mesh.triangles.len() as u64);
        Ok((Out { mesh: Arc::new(mesh) }, notes))
    }
}

fn is_gltf(path: &InputFile) -> bool {
    let lower = path.0.to_lowercase();
    lower.ends_with(".glb") || lower.ends_with(".gltf")
}

fn from_gltf(p: &LoadMesh, bytes: &[u8], cx: &Context, notes: &mut Notes) -> Result<RawMesh, NodeError> {
    let object = load_object::object(&p.path, bytes, gltf::Want::Geometry, None, cx, notes)?;
    let generator = gltf::parse(&p.path.0, bytes)?.json["asset"]["generator"].to_string();
    let mut raw = RawMesh { by_trimesh: generator.contains("trimesh"), ..RawMesh::default() };
    let coloured = object.primitives.iter().any(|part| !part.colours.is_empty());
    let tint = |part: &Primitive| {
        let factor = object.materials.get(part.material as usize).map_or([1.0; 4], |m| m.base_colour);
        [factor[0], factor[1], factor[2]].map(f64::from)
    };
    // Beside a texture that is left out, the factor alone says nothing.
    let plain = |part: &Primitive| {
        object.materials.get(part.material as usize).is_none_or(|m| m.base_colour_texture.is_none())
    };
    let tinted = object.primitives.iter().any(|part| tint(part) != [1.0; 3] && (coloured || plain(part)));
    for part in &object.primitives {
        let first = raw.positions.len() as u32;
        raw.positions.extend(part.positions.iter().map(|v| v.map(f64::from)));
        if coloured {
            let white = [1.0; 4];
            let colour = |i| part.colours.get(i).unwrap_or(&white);
            raw.colours.extend((0..part.positions.len()).map(|i| {
                let c = colour(i);
                [c[0], c[1], c[2]].map(f64::from)
            }));
        }
        if tinted {
            raw.tints.resize(raw.positions.len(), tint(part));
        }
        raw.triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    if object.materials.iter().any(|m| m.base_colour_texture.is_some()) {
        notes.warning(
            "mesh-textures-ignored",
            "a receiver takes its colours from vertices and `baseColorFactor`; its textures are left out",
        );
    }
    Ok(raw)
}

fn from_ply(name: &str, bytes: &[u8], cx: &Context) -> Result<RawMesh, NodeError> {
    let header = ply::header(name, bytes)?;
    let mut rows = ply::Rows::new(name, &header, bytes);
    let mut raw = RawMesh::default();
    if !header.elements.iter().any(|e| e.name == "face" && e.rows > 0) {
        let what =
            if header.elements.iter().any(|e| e.name == "tristrips") { "triangle strips" } else { "points" };
        return Err(NodeError::from(Error::format(name, format!("holds {what}, not faces")))
            .at("path")
            .hint("export the mesh with its faces"));
    }
    for element in &header.elements {
        let count = rows.believable(element)?;
        match element.name.as_str() {
            "vertex" => vertices(name, element, count, &mut rows, &mut raw, cx)?,
            "face" => faces(name, element, count, &mut rows, &mut raw, cx)?,
            _ => {
                for _ in 0..count {
                    rows.row(element, |_, _| {})?;
                }
            }
        }
    }
    Ok(raw)
}

fn vertices(
    name: &str,
    element: &ply::Element,
    count: usize,
    rows: &mut ply::Rows<'_>,
    raw: &mut RawMesh,
    cx: &Context,
) -> Result<(), NodeError> {
    let missing = |axis: &str| Error::format(name, format!("vertices have no `{axis}`"));
    let mut slots = [usize::MAX; 6];
    for (slot, axis) in slots.iter_mut().zip(["x", "y", "z"]) {
        *slot = element.find(axis).ok_or_else(|| missing(axis))?;
        raw.finer |= element.properties[*slot].scalar == ply::Scalar::F64;
    }
    let colour_names =
        [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"]];
    let colours = colour_names.iter().find_map(|names| {
        let found: Vec<usize> = names.iter().filter_map(|n| element.find(n)).collect();
        <[usize; 3]>::try_from(found).ok()
    });
    let mut scale = 1.0;
    if let Some(colours) = colours {
        slots[3..].copy_from_slice(&colours);
        scale = element.properties[colours[0]].scalar.whole_range().map_or(1.0, |(_, high)| 1.0 / high);
        raw.colours.reserve(count);
    }
    raw.positions.reserve(count);
    for row in 0..count {
        if row % 65_536 == 0 {
            cx.check()?;
        }
        let mut v = [0.0; 6];
        rows.row(element, |index, numbers| {
            if let ([number], Some(slot)) = (numbers, slots.iter().position(|s| *s == index)) {
                v[slot] = *number;
            }
        })?;
        raw.positions.push([v[0], v[1], v[2]]);
        if colours.is_some() {
            raw.colours.push([v[3] * scale, v[4] * scale, v[5] * scale]);
        }
    }
    Ok(())
}

fn faces(
    name: &str,
    element: &ply::Element,
    count: usize,
    rows: &mut ply::Rows<'_>,
    raw: &mut RawMesh,
    cx: &Context,
) -> Result<(), NodeError> {
    let list = element
        .find("vertex_indices")
        .or_else(|| element.find("vertex_index"))
        .filter(|&i| element.properties[i].count.is_some())
        .ok_or_else(|| Error::format(name, "faces have no list `vertex_indices`"))?;
    raw.triangles.reserve(count);
    for row in 0..count {
        if row % 65_536 == 0 {
            cx.check()?;
        }
        let mut whole = true;
        let (triangles, fanned) = (&mut raw.triangles, &mut raw.fanned);
        rows.row(element, |index, corners| {
            if index != list {
                return;
            }
            let vertex = |c: f64| {
                if (0.0..4_294_967_295.0).contains(&c) && c.trunc() == c { Some(c as u32) } else { None }
            };
            *fanned += u64::from(corners.len() > 3);
            for pair in corners.windows(2).skip(1) {
                match (vertex(corners[0]), vertex(pair[0]), vertex(pair[1])) {
                    (Some(a), Some(b), Some(c)) => triangles.push([a, b, c]),
                    _ => whole = false,
                }
            }
        })?;
        if !whole {
            return Err(Error::format(name, format!("face {row} names a vertex that cannot exist")).into());
        }
    }
    Ok(())
}

const WHITE: [f64; 3] = [1.0; 3];

/// Drops what cannot be traced, and makes colours linear. Row 41 of the table of extremes.
fn clean(name: &str, raw: RawMesh, srgb: bool, cx: &Context, notes: &mut Notes) -> Result<Mesh, NodeError> {
    let n = raw.positions.len();
    if let Some(bad) = raw.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= n)) {
        let what = format!("triangle {bad} names a vertex beyond the {n} there are");
        return Err(Error::format(name, what).into());
    }
    let (mut mesh, mut renamed) = (Mesh::default(), Vec::with_capacity(n));
    mesh.positions.reserve_exact(n);
    mesh.colours.reserve_exact(raw.colours.len().max(raw.tints.len()));
    mesh.triangles.reserve_exact(raw.triangles.len());
    let (mut clamped, mut lost) = (0, 0);
    for (index, position) in raw.positions.iter().enumerate() {
        let (exact, position) = (*position, position.map(|c| c as f32));
        if !position.iter().all(|c| c.is_finite()) {
            renamed.push(u32::MAX);
            lost += 1;
            continue;
        }
        renamed.push(mesh.positions.len() as u32);
        mesh.positions.push(position);
        if raw.finer {
            mesh.positions_low.push([0, 1, 2].map(|k| (exact[k] - f64::from(position[k])) as f32));
        }
        let (colour, tint) = (raw.colours.get(index), raw.tints.get(index));
        if colour.is_some() || tint.is_some() {
            let (colour, tint) = (colour.unwrap_or(&WHITE), tint.unwrap_or(&WHITE));
            let legal = colour.iter().chain(tint).all(|c| (0.0..=1.0).contains(c));
            clamped += u64::from(!legal);
            // The comparison turns what is not a number into 0.
            let legal = |c: f64| if c > 0.0 { c.min(1.0) as f32 } else { 0.0 };
            mesh.colours.push([0, 1, 2].map(|k| {
                let c = legal(colour[k]);
                legal(tint[k]) * if srgb { linear_from_srgb(c) } else { c }
            }));
        }
    }
    cx.check()?;
    let (mut dangling, mut flat) = (0, 0);
    for triangle in &raw.triangles {
        let t = triangle.map(|v| renamed[v as usize]);
        if t.contains(&u32::MAX) {
            dangling += 1;
        } else if area_is_zero(t.map(|v| mesh.position(v))) {
            flat += 1;
        } else {
            mesh.triangles.push(t);
        }
    }
    for (id, count, what) in [
        ("vertices-not-finite", lost, "vertices that are not finite numbers were dropped"),
        ("faces-of-dropped-vertices", dangling, "triangles of such vertices were dropped"),
        ("triangles-without-area", flat, "triangles without area were dropped"),
        ("colours-clamped", clamped, "vertex colours outside of 0 to 1 were clamped"),
        ("faces-fanned", raw.fanned, "faces of more than three corners were cut into fans"),
    ] {
        notes.count(id, count, what);
    }
    if mesh.triangles.is_empty() {
        return Err(NodeError::from(Error::format(name, "has no triangle that can be used")).at("path"));
    }
    if mesh.colours.is_empty() {
        notes.warning(
            "no-vertex-colours",
            "the mesh has no vertex colours: as a receiver it is grey, albedo 0.5",
        );
    }
    Ok(mesh)
}

/// In f64, where products of f32 differences are exact enough that only a true line gives 0.
fn area_is_zero([a, b, c]: [DVec3; 3]) -> bool {
    (b - a).cross(c - a) == DVec3::ZERO
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Scene, Up};

    const BODY: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";

    fn load(bytes: &[u8], p: &LoadMesh) -> Result<(Arc<Mesh>, Notes), NodeError> {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        std::fs::write(folder.path().join(&p.path.0), bytes).unwrap_or_else(|e| panic!("{e}"));
        let cx = Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 0.5, seed: 0 }, folder.path());
        LoadMesh::run(p, In {}, &cx).map(|(out, notes)| (out.mesh, notes))
    }
    fn plain() -> LoadMesh {
        LoadMesh { path: InputFile("a.ply".into()), colours: ColourEncoding::Auto, frame: MeshFrame::World }
    }
    fn good(bytes: &[u8]) -> (Arc<Mesh>, Notes) {
        load(bytes, &plain()).unwrap_or_else(|e| panic!("{e}"))
    }

    fn ascii() -> Vec<u8> {
        let rows = "0 0 0 0 128 255\n1 0 0 255 255 255\r\n1 1 0 0 0 0\n0 1 0.25 12 13 14\n4 0 1 2 3\n";
        format!("ply\nformat ascii 1.0\ncomment made here\n{BODY}{rows}").into_bytes()
    }
    fn binary(big: bool) -> Vec<u8> {
        let order = if big { "big" } else { "little" };
        let mut bytes = format!("ply\nformat binary_{order}_endian 1.0\n{BODY}").into_bytes();
        let rows = [
            ([0.0_f32, 0.0, 0.0], [0, 128, 255_u8]),
            ([1.0, 0.0, 0.0], [255; 3]),
            ([1.0, 1.0, 0.0], [0; 3]),
            ([0.0, 1.0, 0.25], [12, 13, 14]),
        ];
        for (position, colour) in rows {
            bytes.extend(position.iter().flat_map(|c| if big { c.to_be_bytes() } else { c.to_le_bytes() }));
            bytes.extend(colour);
        }
        bytes.push(4);
        bytes.extend(
            [0_i32, 1, 2, 3].iter().flat_map(|c| if big { c.to_be_bytes() } else { c.to_le_bytes() }),
        );
        bytes
    }

    /// A triangle with this material, and with vertex colours where there are any.
    fn triangle(material: &str, colours: Option<[f32; 3]>) -> Vec<u8> {
        let mut floats = vec![0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        floats.extend(colours.iter().flat_map(|c| [*c; 3]).flatten());
        let bytes: Vec<u8> = floats.iter().flat_map(|v| v.to_le_bytes()).collect();
        let accessor = |at| {
            format!(r#"{{"bufferView":0,"byteOffset":{at},"componentType":5126,"count":3,"type":"VEC3"}}"#)
        };
        let (second, name) = match colours {
            Some(_) => (format!(",{}", accessor(36)), r#","COLOR_0":1"#),
            None => (String::new(), ""),
        };
        let length = bytes.len();
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"materials":[{material}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0{name}}},"material":0}}]}}],"accessors":[{}{second}],"bufferViews":[{{"buffer":0,"byteLength":{length}}}],"buffers":[{{"byteLength":{length}}}]}}"#,
            accessor(0)
        );
        let json = format!("{json}{}", " ".repeat(json.len().next_multiple_of(4) - json.len()));
        let mut glb = b"glTF".to_vec();
        for (word, chunk) in [(b"JSON", json.as_bytes()), (b"BIN\0", &bytes)] {
            if glb.len() == 4 {
                glb.extend(2_u32.to_le_bytes());
                glb.extend((12 + 8 + json.len() as u32 + 8 + length as u32).to_le_bytes());
            }
            glb.extend((chunk.len() as u32).to_le_bytes());
            glb.extend(word);
            glb.extend(chunk);
        }
        glb
    }

    // glTF's factor is linear and multiplies; alone it is the colour, and white is no statement.
    // Mutation: `raw.tints` left empty; the tint decoded as sRGB.
    #[test]
    fn the_factor_of_a_gltf_material_colours_its_vertices() {
        let factor = r#"{"pbrMetallicRoughness":{"baseColorFactor":[0.5,0.25,1.0,1.0]}}"#;
        let colours = |material: &str, vertex: Option<[f32; 3]>, colours: ColourEncoding| {
            let p = LoadMesh { path: InputFile("a.glb".into()), colours, frame: MeshFrame::World };
            load(&triangle(material, vertex), &p).unwrap_or_else(|e| panic!("{e}")).0.colours.clone()
        };
        let auto = ColourEncoding::Auto;
        assert_eq!(colours(factor, Some([0.2, 0.4, 0.6]), auto), [[0.1, 0.1, 0.6]; 3]);
        assert_eq!(colours(factor, None, auto), [[0.5, 0.25, 1.0]; 3]);
        assert_eq!(colours("{}", None, auto), [[0.0; 3]; 0]);
        let half = linear_from_srgb(0.5);
        assert_eq!(
            colours(factor, Some([0.5; 3]), ColourEncoding::Srgb),
            [[0.5 * half, 0.25 * half, half]; 3]
        );
    }

    #[test]
    fn three_ways_to_write_one_mesh() {
        let (mesh, notes) = good(&ascii());
        assert_eq!(mesh, good(&binary(false)).0);
        assert_eq!(mesh, good(&binary(true)).0);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]], "a fan");
        assert_eq!(mesh.positions[3], [0.0, 1.0, 0.25]);
        assert_eq!(mesh.colours[0], [0.0, linear_from_srgb(128.0 / 255.0), 1.0]);
        assert!(
            notes.iter().any(|n| n.id == "colour-encoding") && notes.iter().any(|n| n.id == "faces-fanned")
        );
    }

    // A surveyed frame: millimetres at a distance of a thousand kilometres, which f32 rounds to sixteenths of a metre.
    // Seen red with `area_is_zero` of the rounded corners, and without the low parts.
    #[test]
    fn doubles_far_from_the_origin_keep_their_millimetres() {
        let at = [1_048_576.001, -524_288.5, 262_144.004];
        let text =
            String::from_utf8(ascii()).unwrap_or_default().replace("property float", "property double");
        let (head, body) = text.split_once("end_header\n").unwrap_or_default();
        let moved = body.lines().map(|line| {
            let words: Vec<&str> = line.split(' ').collect();
            let [x, y, z, rest @ ..] = words.as_slice() else { panic!("{line}") };
            if rest.len() != 3 {
                return line.to_owned();
            }
            let place =
                [x, y, z].into_iter().zip(at).map(|(word, at)| word.parse::<f64>().unwrap_or(0.0) / 1e3 + at);
            let place: Vec<String> = place.map(|c| format!("{c:?}")).collect();
            format!("{} {}", place.join(" "), rest.join(" "))
        });
        let moved = format!("{head}end_header\n{}\n", moved.collect::<Vec<_>>().join("\n"));
        let ((mesh, notes), (near, _)) = (good(moved.as_bytes()), good(&ascii()));
        assert!(notes.iter().all(|note| note.id != "triangles-without-area"));
        assert_eq!(mesh.triangles, near.triangles);
        for vertex in 0..4 {
            let off = mesh.position(vertex) - DVec3::from(at) - near.position(vertex) / 1e3;
            assert!(off.abs().max_element() < 1e-9, "{off}");
        }
        assert!(near.positions_low.is_empty());
    }

    #[test]
    fn parameters_change_what_they_say() {
        let linear = load(&ascii(), &LoadMesh { colours: ColourEncoding::Linear, ..plain() });
        assert_eq!(linear.map(|m| m.0.colours[0][1]).ok(), Some((128.0 / 255.0) as f32));
        let turned = load(&ascii(), &LoadMesh { frame: MeshFrame::Gltf, ..plain() });
        assert_eq!(turned.map(|m| m.0.positions[3]).ok(), Some([0.0, -0.5, 2.0]), "(x, -z, y) / 0.5");
    }

    /// Unusable vertices and faces go, and are counted.
    #[test]
    fn row_41_unusable_parts_are_dropped_and_counted() {
        let text = String::from_utf8(ascii()).unwrap_or_default();
        let text = text.replace("1 0 0 255", "nan 0 0 255").replace("element face 1", "element face 4");
        let (mesh, notes) = good(format!("{text}3 2 2 3\n3 0 2 3\n3 0 1 3\n").as_bytes());
        assert_eq!(mesh.positions.len(), 3);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 1, 2]]);
        let count = |id: &str| notes.iter().find(|n| n.id == id).map(|n| n.text.clone());
        assert!(count("vertices-not-finite").is_some_and(|t| t.starts_with("1 ")));
        assert!(count("faces-of-dropped-vertices").is_some_and(|t| t.starts_with("2 ")));
        assert!(count("triangles-without-area").is_some_and(|t| t.starts_with("1 ")));
    }

    #[test]
    fn no_cut_or_flip_panics_and_every_cut_is_an_error() {
        let cx = Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0 }, ".");
        let read = |bytes: &[u8]| {
            from_ply("a.ply", bytes, &cx).and_then(|raw| clean("a.ply", raw, true, &cx, &mut Notes::none()))
        };
        for bytes in [ascii(), binary(false), binary(true)] {
            // The last bytes of ASCII are a digit and a line end, which may go.
            for end in 0..bytes.len() - 3 {
                assert!(read(&bytes[..end]).is_err(), "cut at {end}");
            }
            for at in 0..bytes.len() {
                let mut hurt = bytes.clone();
                hurt[at] ^= 1 << (at % 8);
                drop(read(&hurt));
            }
        }
        let bomb =
            String::from_utf8(ascii()).unwrap_or_default().replace("vertex 4", "vertex 18446744073709551615");
        assert!(load(bomb.as_bytes(), &plain()).is_err());
        let points =
            String::from_utf8(ascii()).unwrap_or_default().replace("element face 1", "element face 0");
        assert!(load(points.as_bytes(), &plain()).is_err());
        let far = String::from_utf8(ascii()).unwrap_or_default().replace("4 0 1 2 3", "4 0 1 2 4");
        assert!(load(far.as_bytes(), &plain()).is_err());
    }
}
