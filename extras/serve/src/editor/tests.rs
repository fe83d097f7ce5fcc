//! 10,000 random edits of texts with unusual layouts. Each edit is undone at a later time.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use engine::SourceRoot;

use super::*;

/// Numbers from a fixed sequence.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % limit
    }

    fn of<'a>(&mut self, list: &[&'a str]) -> &'a str {
        list[self.below(list.len())]
    }

    fn number(&mut self) -> String {
        let value = self.below(2_000_000) as f64 / 1000.0 - 1000.0;
        match self.below(4) {
            0 => format!("{value:e}"),
            1 => format!("{value:.1}"),
            2 => format!("{}", value.trunc()),
            _ => format!("{value:?}"),
        }
    }
}

/// The tokens of a graph, between which any space and any comment may be.
const TOKENS: &str = r#"Graph ( version : 1 , scene : ( up : "+z" , metres_per_unit : 1.0 , seed : 3 ) ,
    parameters : ( h : 1.5 , k : 2.0 , ) , nodes : (
    pose : Pose ( translation : ( 0.5 , -1.0 , Param("h") ) , yaw_deg : 30.0 , ) ,
    other : Pose ( translation : ( 1.0 , 2.0 , 3.0 , ) , scale : 1.25 ) ,
    bare : Pose ( translation : ( 0 , 0.0 , 0e0 ) ) ,
    camera : Camera ( eye : ( 2 , -2.5 , 1.2 ) , target : ( 0 , 0 , 0.2 ) , width_px : 32 , height_px : 18 , fov_y_deg : 4.0e1 , ) ,
    demo : DemoScene ( ) , rig : CubeRig ( at : "pose" , height_metres : 0.3 ) , ) , )"#;

const SPACES: [&str; 12] = [
    "",
    "",
    " ",
    " ",
    "  ",
    "\t",
    "\n",
    "\r\n",
    "\r\n    ",
    "/* ), \" { */",
    " // it's \"(\r\n",
    "/* /* nested */ */ ",
];

/// The graph with another layout.
fn laid_out(random: &mut Random) -> String {
    let mut text =
        random.of(&["", "\u{feff}", "// Ünïcode \u{1f600}\r\n", "#![enable(implicit_some)]\n"]).to_owned();
    for token in TOKENS.split_whitespace() {
        text.push_str(random.of(&SPACES));
        text.push_str(token);
    }
    text + random.of(&["", "\n", "\r\n\r\n", " // end", "/* end */"])
}

fn edit(random: &mut Random, text: &str) -> Edit {
    let fields: [(&str, &str, usize); 15] = [
        ("pose", "translation", 2),
        ("pose", "yaw_deg", 0),
        ("pose", "scale", 0),
        ("other", "translation", 3),
        ("other", "yaw_deg", 0),
        ("other", "scale", 0),
        ("bare", "yaw_deg", 0),
        ("bare", "translation", 3),
        ("camera", "eye", 3),
        ("camera", "width_px", 0),
        ("camera", "fov_y_deg", 0),
        ("scene", "seed", 0),
        ("parameters", "h", 0),
        ("rig", "height_metres", 0),
        ("demo", "splats", 0),
    ];
    let (node, field, parts) = fields[random.below(fields.len())];
    let at = if parts > 0 && random.below(4) > 0 { vec![At::Index(random.below(parts))] } else { Vec::new() };
    let value = match (field, at.is_empty()) {
        (_, true) if random.below(4) == 0 => None,
        ("seed" | "width_px" | "splats", _) => Some((random.below(900) + 1).to_string()),
        ("translation" | "eye", true) => {
            Some(format!("({},{} , {})", random.number(), random.number(), random.number()))
        }
        _ => Some(random.number()),
    };
    // The gizmo writes several fields of a pose at once.
    let mut also = Vec::new();
    if field == "translation" && random.below(2) == 0 {
        for field in ["yaw_deg", "scale"] {
            also.push(FieldEdit { field: field.to_owned(), at: Vec::new(), value: Some(random.number()) });
        }
    }
    Edit { digest: digest_of(text), node: node.to_owned(), field: field.to_owned(), at, value, also }
}

#[test]
fn ten_thousand_edits_and_their_undo_give_the_original_bytes() {
    // In memory where that is possible: every edit waits for the disk.
    let memory = std::path::Path::new("/dev/shm");
    let folder = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() }.unwrap();
    let path = folder.path().join("graph.ron");
    let (mut random, mut written) = (Random(25), 0);
    while written < 10_000 {
        let original = laid_out(&mut random);
        std::fs::write(&path, &original).unwrap();
        let history = History::open(Some(folder.path().join(format!("{written}.jsonl"))), &original);
        let mut editor = Editor::new(path.clone(), history);
        let parse = |text: &str| {
            let root = SourceRoot::new(folder.path());
            Graph::parse(Source::new("graph.ron", text), &nodes::registry(), root)
                .unwrap_or_else(|mistakes| panic!("{mistakes}"))
        };
        let graph = parse(&original);
        let mut texts = vec![original.clone()];
        for _ in 0..60 {
            let edit = edit(&mut random, texts.last().unwrap());
            match editor.set(&graph, &edit, &[]) {
                Ok(()) => {
                    let (old, new) = (texts.last().unwrap().clone(), std::fs::read_to_string(&path).unwrap());
                    if edit.also.is_empty() {
                        check(&old, &new, &edit);
                    }
                    if old != new {
                        texts.push(new);
                        written += 1;
                    }
                }
                // Some numbers are out of range, and a field that is not set cannot be removed.
                Err(Refused::Invalid { .. } | Refused::Fixed { .. }) => {
                    assert_eq!(std::fs::read_to_string(&path).unwrap(), *texts.last().unwrap(), "{edit:?}");
                }
                Err(other) => panic!("{edit:?}: {other:?}"),
            }
            // Some steps back and forth on the way.
            if random.below(8) == 0 && texts.len() > 1 {
                let last = texts.last().unwrap().clone();
                editor.undo(&graph, &digest_of(&last)).unwrap();
                assert_eq!(std::fs::read_to_string(&path).unwrap(), texts[texts.len() - 2]);
                editor.redo(&graph, &digest_of(&texts[texts.len() - 2])).unwrap();
                assert_eq!(std::fs::read_to_string(&path).unwrap(), last);
            }
        }
        while texts.len() > 1 {
            editor.undo(&graph, &digest_of(&texts.pop().unwrap())).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), *texts.last().unwrap());
        }
        assert_eq!(std::fs::read(&path).unwrap(), original.as_bytes());
        assert_eq!(editor.undo(&graph, &digest_of(&original)), Err(Refused::Nothing));
    }
}

/// Checks an edit independently of the code that made it: without space and comments, only the value differs, and
/// the bytes around the value are the same.
fn check(old: &str, new: &str, edit: &Edit) {
    let change = crate::history::Change::between(old, new, String::new());
    let (removed, added) = (change.removed.as_str(), change.added.as_str());
    match &edit.value {
        // The differing bytes are part of the new value, or of a field that was added.
        Some(value) => {
            let longest = value.len() + edit.field.len() + 64;
            assert!(added.len() <= longest, "{edit:?}: {added:?}");
            let value = added.len() <= value.len() && (value.contains(added) || removed.len() <= 64);
            assert!(value || added.contains(&edit.field), "{edit:?}: {removed:?} -> {added:?}");
        }
        None => {
            assert!(added.is_empty() || removed.contains(&edit.field), "{edit:?}: {removed:?} -> {added:?}");
        }
    }
    let comments = |text: &str| text.matches("it's").count() + text.matches("nested").count();
    if edit.value.is_some() && comments(removed) == 0 {
        assert_eq!(comments(old), comments(new), "{edit:?}");
    }
    // The whole value may contain comments, which are replaced with it; parts and plain numbers do not.
    if edit.value.is_some() && (!edit.at.is_empty() || !matches!(edit.field.as_str(), "translation" | "eye"))
    {
        assert_eq!(comments(old), comments(new), "{edit:?}");
    }
}
