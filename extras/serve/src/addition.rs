//! Objects that are added to a graph: the nodes and the wires of one more object, as one edit of the text.

use std::path::Path;

use engine::{Context, Graph, GraphText, InputFile, Kind, Step, TextEdit};
use glam::DVec3;
use nodes::kinds::load_object::{self, LoadObject};
use render::layout::Extents;
use scene::types::frame::world_from_gltf;
use serde::Deserialize;
use serde_json::Value;

use crate::editor::{Refused, fixed};
use crate::live::Live;
use crate::near;

/// Endings of the names of files that are offered.
const ENDINGS: [&str; 2] = ["glb", "gltf"];
/// Maximum length of the name of a node that is made from the name of a file.
const LONGEST: usize = 24;

/// A request to add an object.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Addition {
    /// Digest of the text that the client has seen.
    digest: String,
    /// Name of the file, as [`Live::objects`] gives it.
    object: String,
    /// Point that the object stands on, in world units.
    place: [f64; 3],
}

impl Live {
    /// Names of the files of objects in the folder of the graph and in its subfolders.
    pub fn objects(&self) -> Vec<String> {
        let folder = self.folder();
        near::files(folder, &ENDINGS).iter().map(|path| near::name(folder, path)).collect()
    }

    /// Adds an object to the text: `LoadObject`, `Pose` and `Place`, and a wire into `objects` of each `PathTrace`. Returns
    /// the digest of the new text, the name of the `Pose`, and the size of the object in metres.
    ///
    /// # Errors
    /// [`Refused`]; nothing was changed.
    pub fn add(&self, addition: &Addition) -> Result<Value, Refused> {
        let graph = self.graph()?;
        // Only names that were offered, so that a request cannot name a path.
        if !self.objects().contains(&addition.object) {
            return Err(fixed("this object is not among the files that were found".to_owned()));
        }
        let now = self.own_graph(&graph)?;
        let extents = extents(&self.folder().join(&addition.object), &now)?;
        let foot = DVec3::from_array(addition.place);
        if !foot.is_finite() {
            return Err(fixed("the place must be finite".to_owned()));
        }
        let centre = 0.5 * (extents.low + extents.high);
        let to_world = world_from_gltf(now.scene.up, now.scene.metres_per_unit);
        let offset = to_world.transform_vector3(DVec3::new(centre.x, extents.low.y, centre.z));
        let translation = vector(foot - offset, now.scene.metres_per_unit);
        let label = format!("{} added", addition.object);
        let mut pose = String::new();
        let mut answer = self.write(|editor| {
            let text = editor.text()?;
            let (text, name) = with_object(&now, &text, &addition.object, &translation)?;
            pose = name;
            editor.replace(&graph, &addition.digest, &text, &label)
        })?;
        answer["pose"] = pose.into();
        answer["metres"] = extents.size().max_element().into();
        Ok(answer)
    }
}

/// Bounding box of an object in metres.
fn extents(path: &Path, graph: &Graph) -> Result<Extents, Refused> {
    let params = LoadObject::of(InputFile(path.display().to_string()));
    let cx = Context::detached(graph.scene, "");
    let loaded = LoadObject::run(&params, load_object::In {}, &cx);
    let (out, _) = loaded.map_err(|error| fixed(error.to_string()))?;
    Extents::of(&out.object).ok_or_else(|| fixed(format!("`{}` has no triangles", path.display())))
}

/// Writes a point in RON, to a tenth of a millimetre.
fn vector(at: DVec3, metres_per_unit: f64) -> String {
    let (mut digits, mut size) = (4_usize, 1.0);
    while size < metres_per_unit && digits < 12 {
        (digits, size) = (digits + 1, size * 10.0);
    }
    while size / 10.0 >= metres_per_unit && digits > 1 {
        (digits, size) = (digits - 1, size / 10.0);
    }
    let number = |v: f64| {
        let text = format!("{:.digits$}", v + 0.0);
        let text = text.trim_end_matches('0');
        let text = if text.ends_with('.') { format!("{text}0") } else { text.to_owned() };
        if text == "-0.0" { "0.0".to_owned() } else { text }
    };
    let [x, y, z] = at.to_array().map(number);
    format!("({x}, {y}, {z})")
}

/// The text of a graph with the nodes and the wires of one more object, and the name of its `Pose`. `file` is the path of
/// the object relative to the graph, and `translation` its place in RON.
///
/// # Errors
/// [`Refused::Fixed`] if the text has no `PathTrace`, or if the list of its objects is not one in the text.
pub fn with_object(
    graph: &Graph,
    text: &str,
    file: &str,
    translation: &str,
) -> Result<(String, String), Refused> {
    let document = GraphText::new(text);
    let mut traces: Vec<&str> = Vec::new();
    for node in graph.nodes.iter().filter(|node| node.kind.name == "path-trace") {
        let name = node.id.split('/').next().unwrap_or(&node.id);
        if document.node(name).is_some() && !traces.contains(&name) {
            traces.push(name);
        }
    }
    let Some(first) = traces.first() else {
        let why = "this file has no `PathTrace`, which would show the object; add one in the text";
        return Err(fixed(why.to_owned()));
    };
    let name = free_name(graph, &document, file);
    let (pose, placed) = (format!("{name}_pose"), format!("{name}_placed"));
    let mut edits = Vec::new();
    for trace in &traces {
        edits.push(wired(&document, text, trace, &placed)?);
    }
    let last = elements(&document, first).pop().map(|span| text[span].trim_matches('"').to_owned());
    let above = last.as_deref().and_then(|wire| wire.split('.').next());
    let anchor = above.filter(|above| document.node(above).is_some()).unwrap_or(first);
    let nodes = [
        format!("{name}: LoadObject(path: {file:?})"),
        format!("{pose}: Pose(translation: {translation})"),
        format!("{placed}: Place(object: \"{name}\", pose: \"{pose}\")"),
    ];
    edits.extend(document.node(anchor).map(|span| inserted(text, span, &nodes)));
    // From the last to the first, so that the places of the others stay.
    edits.sort_by_key(|edit| std::cmp::Reverse(edit.span.start));
    Ok((edits.iter().fold(text.to_owned(), |text, edit| edit.apply(&text)), pose))
}

/// A name from which no node has its name, made of the name of a file.
fn free_name(graph: &Graph, document: &GraphText<'_>, file: &str) -> String {
    let stem = Path::new(file).file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    let word: String =
        stem.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).take(LONGEST).collect();
    let word = word.trim_matches('_');
    let word = if word.starts_with(|c: char| c.is_ascii_alphabetic()) {
        word.to_owned()
    } else {
        format!("object_{word}")
    };
    let word = word.trim_end_matches('_');
    let is_free = |name: &str| {
        ["", "_pose", "_placed"].iter().all(|end| {
            let name = format!("{name}{end}");
            graph.find_all(&name).is_empty() && document.node(&name).is_none()
        })
    };
    let numbered = (2..).map(|number| format!("{word}{number}"));
    std::iter::once(word.to_owned()).chain(numbered).find(|name| is_free(name)).unwrap_or_default()
}

/// Byte ranges of the entries of `objects` of a node.
fn elements(document: &GraphText<'_>, trace: &str) -> Vec<std::ops::Range<usize>> {
    // The edit of an entry names its place.
    let entry =
        |index| document.set(trace, "objects", &[Step::Index(index)], "\"\"").ok().map(|edit| edit.span);
    (0..).map_while(entry).collect()
}

/// The edit that adds a wire to `objects` of a node.
fn wired(document: &GraphText<'_>, text: &str, trace: &str, placed: &str) -> Result<TextEdit, Refused> {
    let Some(span) = document.field(trace, "objects") else {
        return Ok(document.set(trace, "objects", &[], &format!("[\"{placed}\"]"))?);
    };
    let insert = |at: usize, with: String| Ok(TextEdit { span: at..at, with });
    let value = &text[span.clone()];
    match (value.as_bytes().first(), elements(document, trace).pop()) {
        (Some(b'['), Some(last)) => insert(last.end, format!(", \"{placed}\"")),
        (Some(b'['), None) => insert(span.start + 1, format!("\"{placed}\"")),
        (Some(b'"'), _) => Ok(TextEdit { with: format!("[{value}, \"{placed}\"]"), span }),
        _ => Err(fixed(format!("`{trace}.objects` is not a list of wires; add the object in the text"))),
    }
}

/// The insertion of nodes after the node in `span`, laid out like it.
fn inserted(text: &str, span: std::ops::Range<usize>, nodes: &[String]) -> TextEdit {
    let line = text[..span.start].rfind('\n').map_or(0, |at| at + 1);
    let indent = &text[line..span.start];
    // The node has its own lines, or shares its line with others.
    let lead = match (line, indent.trim().is_empty()) {
        (1.., true) if text[..line].ends_with("\r\n") => format!("\r\n{indent}"),
        (1.., true) => format!("\n{indent}"),
        _ => " ".to_owned(),
    };
    let rest = &text[span.end..];
    let space = rest.len() - rest.trim_start().len();
    if !rest[space..].starts_with(',') {
        // Without a comma, the node is the last one, or a comment follows; both allow this.
        let with = nodes.iter().map(|node| format!(",{lead}{node}")).collect();
        return TextEdit { span: span.end..span.end, with };
    }
    let comma = span.end + space + 1;
    let behind = &text[comma..];
    let behind = &behind[..behind.find('\n').unwrap_or(behind.len())];
    let is_end = lead != " " && (behind.trim().is_empty() || behind.trim_start().starts_with("//"));
    // A comment behind the node stays on its line.
    let (at, lead) = match is_end {
        true => (comma + behind.trim_end_matches('\r').len(), lead.as_str()),
        false => (comma, " "),
    };
    TextEdit { span: at..at, with: nodes.iter().map(|node| format!("{lead}{node},")).collect() }
}

#[cfg(test)]
mod tests {
    use engine::{Source, SourceRoot};

    use super::*;

    fn parsed(text: &str) -> Graph {
        // A graph is sound only if its files exist.
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::create_dir(folder.path().join("in")).expect("a folder");
        for file in ["m.obj", "a.glb", "b.glb", "s.hdr", "in/Cone.glb"] {
            std::fs::write(folder.path().join(file), "").expect("writes");
        }
        let root = SourceRoot::new(folder.path());
        let source = Source::new("graph.ron".to_owned(), text.to_owned());
        Graph::parse(source, &nodes::registry(), root)
            .unwrap_or_else(|all| panic!("{}\n{text}", all.render(false)))
    }

    const NODES: &str = "proxy: LoadMesh(path: \"m.obj\"),
        cone: LoadObject(path: \"a.glb\"), cone_pose: Pose(translation: (0.0, 0.0, 1.0)),
        placed: Place(object: \"cone\", pose: \"cone_pose\"), // the first
        camera: Camera(eye: (4.0, -5.0, 3.0), target: (0.0, 0.0, 1.0), width_px: 16, height_px: 12),
        sky: LoadEnvironment(path: \"s.hdr\"),
        trace: PathTrace(receiver: \"proxy\", objects: OBJECTS, rig: \"camera\", env: \"sky\"),
        save: WriteImage(image: \"trace.object\", path: \"o.png\")";

    fn text(objects: &str) -> String {
        let nodes = NODES.replace("OBJECTS", objects);
        format!("// mine\nGraph(version: 1, scene: (up: \"+z\"), nodes: (\n        {nodes}\n))\n")
    }

    /// This test fails if an object is added without its wire.
    #[test]
    fn the_nodes_and_the_wire_are_added_and_every_other_byte_stays() {
        let added = "cone2: LoadObject(path: \"in/Cone.glb\"),
        cone2_pose: Pose(translation: (1.0, 2.0, 0.0)),
        cone2_placed: Place(object: \"cone2\", pose: \"cone2_pose\"),\n        ";
        for (objects, then) in [
            ("[\"placed\"]", "[\"placed\", \"cone2_placed\"]"),
            ("[\"placed\", ]", "[\"placed\", \"cone2_placed\", ]"),
            ("[ \"placed\" /* ] */ ]", "[ \"placed\", \"cone2_placed\" /* ] */ ]"),
        ] {
            for line_end in ["\n", "\r\n"] {
                let text = text(objects).replace('\n', line_end);
                let (found, pose) =
                    with_object(&parsed(&text), &text, "in/Cone.glb", "(1.0, 2.0, 0.0)").unwrap_or_default();
                let expected = text
                    .replace(objects, then)
                    .replace("camera: Camera", &format!("{}camera: Camera", added.replace('\n', line_end)));
                assert_eq!((found.as_str(), pose.as_str()), (expected.as_str(), "cone2_pose"));
                parsed(&found);
            }
        }
        // All on one line, the trace as the anchor, and the last node without a comma.
        let one = text("[\"placed\"]").replace("// the first", "").replace('\n', " ").replace("// mine", "");
        let (found, _) = with_object(&parsed(&one), &one, "b.glb", "(1.0, 2.0, 0.0)").unwrap_or_default();
        assert!(found.contains("pose: \"cone_pose\"), b: LoadObject(path: \"b.glb\"), b_pose"), "{found}");
        let graph = parsed(&found);
        let trace = graph.find("trace").map(|index| graph.nodes[index].inputs.clone());
        assert_eq!(trace.unwrap_or_default()[1].len(), 2);
    }

    #[test]
    fn names_are_free_and_points_are_short() {
        let graph = parsed(&text("[\"placed\"]"));
        let document = GraphText::new("");
        let name = |file| free_name(&graph, &document, file);
        assert_eq!(
            ["a/Vase 3.glb", "3 x.glb", "ä.glb", "cone.gltf", "trace.glb"].map(name),
            ["vase_3", "object_3_x", "object", "cone2", "trace2"]
        );
        let at = DVec3::new(1.234_567, -0.000_01, 20.0);
        assert_eq!(vector(at, 1.0), "(1.2346, 0.0, 20.0)");
        assert_eq!(vector(at, 0.01), "(1.23, 0.0, 20.0)");
        let bare = "Graph(version: 1, scene: (up: \"+z\"), nodes: (a: Pose()))";
        assert!(matches!(
            with_object(&parsed(bare), bare, "a.glb", "(0.0, 0.0, 0.0)"),
            Err(Refused::Fixed { .. })
        ));
    }
}
