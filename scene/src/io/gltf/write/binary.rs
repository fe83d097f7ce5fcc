//! The binary part of a GLB: arrays and pictures, their views and accessors, and the container.

use engine::{Context, NodeError};
use serde_json::{Value, json};

/// Targets of buffer views: attributes of vertices, and indices.
const ARRAY: u32 = 34_962;
const ELEMENT_ARRAY: u32 = 34_963;
const FLOAT: u32 = 5126;
/// Bytes of the headers of the file and of its two chunks.
const HEADERS: u64 = 28;

/// Bytes of the file that are not copied until the file is made.
enum Piece<'a> {
    Floats(&'a [f32]),
    /// Indices, and the number of bytes of each.
    Indices(&'a [u32], usize),
    File(Vec<u8>),
}

impl Piece<'_> {
    /// Number of bytes, without padding.
    fn length(&self) -> u64 {
        match self {
            Self::Floats(numbers) => 4 * numbers.len() as u64,
            Self::Indices(indices, width) => (width * indices.len()) as u64,
            Self::File(bytes) => bytes.len() as u64,
        }
    }

    fn write(&self, to: &mut Vec<u8>) {
        match self {
            Self::Floats(numbers) => numbers.iter().for_each(|v| to.extend_from_slice(&v.to_le_bytes())),
            Self::Indices(indices, width) => {
                indices.iter().for_each(|v| to.extend_from_slice(&v.to_le_bytes()[..*width]));
            }
            Self::File(bytes) => to.extend_from_slice(bytes),
        }
    }
}

/// The binary part of a file. Every view begins at a multiple of four bytes.
#[derive(Default)]
pub(super) struct Binary<'a> {
    pieces: Vec<Piece<'a>>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    /// Number of bytes, with padding.
    length: u64,
}

impl<'a> Binary<'a> {
    /// Adds a view, and returns its index.
    fn view(&mut self, piece: Piece<'a>, target: Option<u32>) -> usize {
        let length = piece.length();
        let mut view = json!({ "buffer": 0, "byteOffset": self.length, "byteLength": length });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.views.push(view);
        self.pieces.push(piece);
        self.length += length.next_multiple_of(4);
        self.views.len() - 1
    }

    /// Adds an accessor, and returns its index.
    fn accessor(&mut self, view: usize, component: u32, count: usize, width: usize) -> usize {
        let shape = ["SCALAR", "VEC2", "VEC3", "VEC4"][width - 1];
        self.accessors
            .push(json!({ "bufferView": view, "componentType": component, "count": count, "type": shape }));
        self.accessors.len() - 1
    }

    /// Adds rows of up to four numbers, one row per vertex. Returns their accessor; `None` if there are no rows.
    pub(super) fn floats<const N: usize>(&mut self, rows: &'a [[f32; N]]) -> Option<usize> {
        if rows.is_empty() {
            return None;
        }
        let view = self.view(Piece::Floats(rows.as_flattened()), Some(ARRAY));
        Some(self.accessor(view, FLOAT, rows.len(), N))
    }

    /// Adds positions. Their accessor has their bounds, which glTF requires.
    pub(super) fn positions(&mut self, rows: &'a [[f32; 3]]) -> Option<usize> {
        let accessor = self.floats(rows)?;
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for row in rows {
            low = std::array::from_fn(|k| low[k].min(row[k]));
            high = std::array::from_fn(|k| high[k].max(row[k]));
        }
        self.accessors[accessor]["min"] = json!(low);
        self.accessors[accessor]["max"] = json!(high);
        Some(accessor)
    }

    /// Adds the indices of triangles, in the shortest type for the number of vertices. Returns their accessor.
    pub(super) fn indices(&mut self, triangles: &'a [[u32; 3]], vertices: usize) -> usize {
        // The largest number of a type is not an index: it may end a strip of triangles.
        let (component, width) = match vertices {
            0..=0xff => (5121, 1),
            0x100..=0xffff => (5123, 2),
            _ => (5125, 4),
        };
        let view = self.view(Piece::Indices(triangles.as_flattened(), width), Some(ELEMENT_ARRAY));
        self.accessor(view, component, 3 * triangles.len(), 1)
    }

    /// Adds the bytes of a picture, and returns their view.
    pub(super) fn file(&mut self, bytes: Vec<u8>) -> usize {
        self.view(Piece::File(bytes), None)
    }

    /// Checks that a file can hold what was added so far.
    pub(super) fn fits(&self) -> Result<(), NodeError> {
        words([0, self.length]).map(|_| ())
    }

    /// The lists of the document that describe the binary part, by name.
    pub(super) fn lists(&self) -> [(&'static str, Vec<Value>); 3] {
        let buffers = vec![json!({ "byteLength": self.length })];
        [("accessors", self.accessors.clone()), ("bufferViews", self.views.clone()), ("buffers", buffers)]
    }

    /// The bytes of the file with the JSON `document`.
    pub(super) fn container(self, document: Value, cx: &Context) -> Result<Vec<u8>, NodeError> {
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let [all, json, binary] = words([text.len() as u64, self.length])?;
        let mut bytes = Vec::with_capacity(all as usize);
        bytes.extend(b"glTF\x02\0\0\0");
        bytes.extend(all.to_le_bytes());
        bytes.extend(json.to_le_bytes());
        bytes.extend(b"JSON");
        bytes.append(&mut text);
        bytes.extend(binary.to_le_bytes());
        bytes.extend(b"BIN\0");
        for piece in self.pieces {
            cx.check()?;
            piece.write(&mut bytes);
            bytes.resize(bytes.len().next_multiple_of(4), 0);
        }
        Ok(bytes)
    }
}

/// The lengths that a file with these chunks states: of the file, of the JSON and of the binary part.
///
/// # Errors
/// A file of 4 GiB or more, since lengths have 32 bits.
pub(super) fn words([json, binary]: [u64; 2]) -> Result<[u32; 3], NodeError> {
    let all = HEADERS + json + binary;
    let word = |length: u64| u32::try_from(length).ok();
    match (word(all), word(json), word(binary)) {
        (Some(all), Some(json), Some(binary)) => Ok([all, json, binary]),
        _ => {
            let text = format!("the file would have {all} bytes, and a GLB has less than 4 GiB");
            Err(NodeError::new(text)
                .hint("write the objects to several files, or reduce their triangles and textures"))
        }
    }
}
