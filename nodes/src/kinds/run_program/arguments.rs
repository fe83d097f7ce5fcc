//! Placeholders in the arguments of a program.

use std::ffi::OsString;
use std::path::Path;

use engine::NodeError;

/// A placeholder, and the file or folder that it stands for.
const PLACES: [(&str, &str); 5] = [
    ("photos", "photos"),
    ("splats", "splats.ply"),
    ("mesh", "mesh.ply"),
    ("files", "files"),
    ("out", "out"),
];

/// A piece of an argument.
#[derive(Debug, PartialEq)]
enum Piece<'a> {
    Text(&'a str),
    Place(&'static str, &'static str),
}

/// Splits an argument at its placeholders.
fn pieces(argument: &str) -> Result<Vec<Piece<'_>>, NodeError> {
    let (mut found, mut rest) = (Vec::new(), argument);
    while let Some(at) = rest.find(['{', '}']) {
        let (before, from) = rest.split_at(at);
        found.push(Piece::Text(before));
        if from.starts_with("{{") || from.starts_with("}}") {
            found.push(Piece::Text(&from[..1]));
            rest = &from[2..];
            continue;
        }
        let end = from.find('}').filter(|_| from.starts_with('{'));
        let lone = || {
            NodeError::new(format!("the argument `{argument}` contains a single brace"))
                .hint("write `{{` or `}}` for a brace")
        };
        let name = &from[1..end.ok_or_else(lone)?];
        let known = PLACES.iter().find(|(place, _)| *place == name);
        let (place, file) = known.ok_or_else(|| {
            NodeError::new(format!("the argument `{argument}` contains `{{{name}}}`, which stands for nothing")).hint(
                "the placeholders are `{photos}`, `{splats}`, `{mesh}`, `{files}` and `{out}`; write `{{` for a brace",
            )
        })?;
        found.push(Piece::Place(place, file));
        rest = &from[name.len() + 2..];
    }
    found.push(Piece::Text(rest));
    Ok(found)
}

/// Checks the placeholders of all arguments.
pub fn check(arguments: &[String]) -> Result<(), NodeError> {
    for argument in arguments {
        pieces(argument)?;
        if argument.contains('\0') {
            return Err(NodeError::new("an argument contains a zero byte"));
        }
    }
    Ok(())
}

/// True if an argument contains the placeholder `name`.
pub fn uses(arguments: &[String], name: &str) -> bool {
    let is_it = |piece: &Piece<'_>| matches!(piece, Piece::Place(place, _) if *place == name);
    arguments.iter().any(|argument| pieces(argument).is_ok_and(|pieces| pieces.iter().any(is_it)))
}

/// The arguments with absolute paths below `folder` in place of the placeholders. The arguments must be valid.
pub fn filled(arguments: &[String], folder: &Path) -> Vec<OsString> {
    let fill = |argument: &String| {
        let mut text = OsString::new();
        for piece in pieces(argument).unwrap_or_default() {
            match piece {
                Piece::Text(plain) => text.push(plain),
                Piece::Place(_, file) => text.push(folder.join(file)),
            }
        }
        text
    };
    arguments.iter().map(fill).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placeholders_become_paths() {
        let filled = |text: &str| filled(&[text.to_owned()], Path::new("/w"));
        assert_eq!(filled("--out={out}/a.ply"), ["--out=/w/out/a.ply"]);
        assert_eq!(filled("{photos}{splats}"), ["/w/photos/w/splats.ply"]);
        assert_eq!(filled("{{x}} $HOME ; rm"), ["{x} $HOME ; rm"]);
        assert!(uses(&["a".to_owned(), "-i{mesh}".to_owned()], "mesh"));
        assert!(!uses(&["{{mesh}}".to_owned()], "mesh"));
        for (wrong, text) in [
            ("{outs}", "stands for nothing"),
            ("{", "single brace"),
            ("a}", "single brace"),
            ("{out", "single brace"),
        ] {
            let error = check(&[wrong.to_owned()]).expect_err("is refused").to_string();
            assert!(error.contains(text), "{wrong}: {error}");
        }
    }
}
