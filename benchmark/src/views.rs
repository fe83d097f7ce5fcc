//! The cameras of a case: which views `views.json` has, and the sizes of their pictures.

use std::path::Path;

use serde_json::Value;

use crate::error::Mistakes;
use crate::fields::finite;

/// Reads a `transforms.json` of nerfstudio as far as the check of a case needs it. Returns the width and height of
/// each of `views`, in pixels, or `None` for a view with a mistake. The cameras themselves are read by the kind
/// `load-cameras`.
pub(crate) fn sizes(
    path: &Path,
    file: &str,
    views: &[String],
    mistakes: &mut Mistakes,
) -> Vec<Option<[u64; 2]>> {
    let none = vec![None; views.len()];
    let whole = match std::fs::read(path) {
        Ok(bytes) => serde_json::from_slice::<Value>(&bytes),
        Err(error) => {
            mistakes.add(file, "", format!("cannot be read: {error}"));
            return none;
        }
    };
    let whole = match whole {
        Ok(whole) => whole,
        Err(error) => {
            mistakes.add(file, "", format!("is not JSON: {error}"));
            return none;
        }
    };
    let Some(frames) = whole.get("frames").and_then(Value::as_array) else {
        mistakes.add(
            file,
            "frames",
            "is missing; write a list of cameras, as in `transforms.json` of nerfstudio",
        );
        return none;
    };
    let named = |name: &String| -> Vec<&Value> {
        frames.iter().filter(|frame| stem(frame).is_some_and(|stem| stem == name)).collect()
    };
    let mut size = |name: &String| {
        let frame = match named(name)[..] {
            [frame] => frame,
            [] => {
                let text = format!("no frame has the `file_path` `{name}.png`; add the camera of this view");
                mistakes.add(file, "frames", text);
                return None;
            }
            _ => {
                mistakes.add(
                    file,
                    "frames",
                    format!("several frames have the name `{name}`; keep one of them"),
                );
                return None;
            }
        };
        if !is_matrix(frame.get("transform_matrix")) {
            let text =
                format!("the frame `{name}` has no matrix of 4 rows of 4 numbers; write camera to world");
            mistakes.add(file, "transform_matrix", text);
        }
        let mut length = |field: &str| {
            let value = frame.get(field).or_else(|| whole.get(field)).and_then(Value::as_u64);
            let value = value.filter(|pixels| (1..=65536).contains(pixels));
            if value.is_none() {
                let text = format!("the frame `{name}` has no size; write the number of pixels, 1 to 65536");
                mistakes.add(file, field, text);
            }
            value
        };
        let (width, height) = (length("w"), length("h"));
        Some([width?, height?])
    };
    views.iter().map(&mut size).collect()
}

/// Name of a view: the file name of its `file_path`, without folder and extension.
fn stem(frame: &Value) -> Option<&str> {
    Path::new(frame.get("file_path")?.as_str()?).file_stem()?.to_str()
}

fn is_matrix(value: Option<&Value>) -> bool {
    let row = |row: &Value| {
        row.as_array().is_some_and(|row| row.len() == 4 && row.iter().all(|n| finite(n).is_some()))
    };
    value.and_then(Value::as_array).is_some_and(|rows| rows.len() == 4 && rows.iter().all(row))
}
