//! Values that are interpolated between keys along an axis: `Track("frame", [(0, 0.0), (11, 330.0)])`.

/// The axis of a call of `Track` whose keys consist of numbers. `None` for any other text, including a call that
/// contains a comment, since an edit of the keys would lose it.
pub fn axis(text: &str) -> Option<&str> {
    let rest = text.trim().strip_prefix("Track")?.trim_start().strip_prefix('(')?.trim_start();
    let (name, rest) = rest.strip_prefix('"')?.split_once('"')?;
    let rest = rest.trim_start().strip_prefix(',')?.trim_start().strip_prefix('[')?;
    let rest = rest.strip_suffix(')')?.trim_end();
    let keys = rest.strip_suffix(',').unwrap_or(rest).trim_end().strip_suffix(']')?;
    let is_part = |c: char| c.is_ascii_digit() || c.is_ascii_whitespace() || "+-.eE_,()".contains(c);
    let mut depth = 0_i32;
    let balanced = keys.chars().all(|c| {
        depth += i32::from(c == '(') - i32::from(c == ')');
        is_part(c) && (0..=2).contains(&depth)
    });
    (balanced && depth == 0 && !name.contains('\\')).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_calls_with_numbers_are_tracks() {
        for text in [
            "Track(\"frame\", [(0, 0.0), (11, 330.0)])",
            " Track ( \"frame\" ,\n  [(0, (0.0, -1e-3, 1.0)),\n (3, (1, 2, 3)), ] , ) ",
            "Track(\"frame\", [])",
        ] {
            assert_eq!(axis(text), Some("frame"), "{text}");
        }
        for text in [
            "Axis(\"frame\")",
            "Track(\"frame\", [(0, 0.0)]) // turn",
            "Track(\"frame\", [(0, 0.0) /* start */])",
            "Track(\"frame\", [(0, Param(\"x\"))])",
            "Track(\"frame\", [(0, 0.0)])), other: (1",
            "Track(\"frame\", [(0, 0.0))])",
            "Track(\"frame\", [(0, \"a\")])",
            "Track(\"frame\", (0, 0.0))",
            "Track(\"fra\\me\", [(0, 0.0)])",
            "330.0",
        ] {
            assert_eq!(axis(text), None, "{text}");
        }
    }
}
