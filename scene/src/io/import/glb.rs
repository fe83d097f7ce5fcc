//! A GLB file that is built part by part.

use serde_json::{Value, json};

/// A mesh of triangles with one material; attributes are empty or have one entry per vertex.
#[derive(Debug, Default)]
pub(super) struct GlbMesh {
    pub positions: Vec<[f32; 3]>,
    pub normals: Vec<[f32; 3]>,
    pub uv: Vec<[f32; 2]>,
    pub colours: Vec<[f32; 3]>,
    pub indices: Vec<u32>,
    pub material: Option<usize>,
}

/// Collects the parts and the materials of a file.
#[derive(Debug, Default)]
pub(super) struct Builder {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    primitives: Vec<Value>,
    /// Materials as JSON of glTF.
    pub materials: Vec<Value>,
    images: Vec<Value>,
    textures: Vec<Value>,
}

/// The component type `FLOAT` of glTF.
const FLOAT: u32 = 5126;
/// The component type `UNSIGNED_INT` of glTF.
const WORD: u32 = 5125;

impl Builder {
    fn column(&mut self, kind: u32, shape: &str, count: usize, bytes: impl Iterator<Item = u8>) -> usize {
        let start = self.binary.len();
        self.binary.extend(bytes);
        let length = self.binary.len() - start;
        self.views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": length}));
        let view = self.views.len() - 1;
        self.accessors
            .push(json!({"bufferView": view, "componentType": kind, "count": count, "type": shape}));
        view
    }

    fn floats<const N: usize>(&mut self, shape: &str, rows: &[[f32; N]]) -> usize {
        self.column(FLOAT, shape, rows.len(), rows.as_flattened().iter().flat_map(|v| v.to_le_bytes()))
    }

    /// Adds a mesh, unless it has no triangles.
    pub fn add(&mut self, part: &GlbMesh) {
        if part.indices.is_empty() || part.positions.is_empty() {
            return;
        }
        let mut attributes = json!({"POSITION": self.floats("VEC3", &part.positions)});
        let whole = |length: usize| length == part.positions.len();
        if whole(part.normals.len()) {
            attributes["NORMAL"] = self.floats("VEC3", &part.normals).into();
        }
        if whole(part.uv.len()) {
            attributes["TEXCOORD_0"] = self.floats("VEC2", &part.uv).into();
        }
        if whole(part.colours.len()) {
            attributes["COLOR_0"] = self.floats("VEC3", &part.colours).into();
        }
        let bytes = part.indices.iter().flat_map(|v| v.to_le_bytes());
        let indices = self.column(WORD, "SCALAR", part.indices.len(), bytes);
        let mut primitive = json!({"attributes": attributes, "indices": indices});
        if let Some(material) = part.material.filter(|at| *at < self.materials.len()) {
            primitive["material"] = material.into();
        }
        self.primitives.push(primitive);
    }

    /// Adds a texture whose picture is the file at a relative path, and returns the index of the texture.
    pub fn texture(&mut self, path: &str) -> usize {
        let uri: String = path
            .bytes()
            .map(|b| match b {
                b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'/' => {
                    char::from(b).to_string()
                }
                other => format!("%{other:02X}"),
            })
            .collect();
        self.images.push(json!({"uri": uri}));
        self.textures.push(json!({"source": self.images.len() - 1}));
        self.textures.len() - 1
    }

    /// The bytes of the file.
    pub fn finish(mut self) -> Vec<u8> {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let (nodes, scene) = if self.primitives.is_empty() {
            (json!([]), json!([]))
        } else {
            (json!([{"mesh": 0}]), json!([0]))
        };
        let mut document = json!({
            "asset": {"version": "2.0", "generator": "import"},
            "scene": 0, "scenes": [{"nodes": scene}], "nodes": nodes,
        });
        let lists = [
            ("bufferViews", self.views),
            ("accessors", self.accessors),
            ("materials", self.materials),
            ("images", self.images),
            ("textures", self.textures),
        ];
        // glTF has no empty lists.
        for (name, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            document[name] = list.into();
        }
        if !self.primitives.is_empty() {
            document["meshes"] = json!([{"primitives": self.primitives}]);
            document["buffers"] = json!([{"byteLength": self.binary.len()}]);
        }
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let total = 12 + 8 + text.len() + 8 + self.binary.len();
        let mut out = Vec::with_capacity(total);
        let word = |out: &mut Vec<u8>, n: usize| out.extend_from_slice(&(n as u32).to_le_bytes());
        out.extend_from_slice(b"glTF\x02\0\0\0");
        word(&mut out, total);
        word(&mut out, text.len());
        out.extend_from_slice(b"JSON");
        out.extend_from_slice(&text);
        word(&mut out, self.binary.len());
        out.extend_from_slice(b"BIN\0");
        out.extend_from_slice(&self.binary);
        out
    }
}
