//! Layout of text for the width of the terminal.

use textwrap::Options;

/// Width in characters that is used if standard output is not a terminal.
const WIDTH: usize = 100;
/// Range of widths in characters. Longer lines are hard to read, and shorter lines leave no space next to a column
/// of names.
const WIDTHS: std::ops::RangeInclusive<usize> = 40..=120;

/// The width for laid-out text, in characters.
pub fn width() -> usize {
    let width = terminal_size::terminal_size().map_or(WIDTH, |(width, _)| usize::from(width.0));
    width.clamp(*WIDTHS.start(), *WIDTHS.end())
}

/// The paragraphs of a doc comment, each on one line: lines are joined up to an empty line, an item of a list, or a
/// line of a table.
pub fn paragraphs(doc: &str) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    let mut open = false;
    for line in doc.trim().lines().map(str::trim) {
        let starts = line.starts_with("- ") || line.starts_with("* ") || line.starts_with('|');
        match found.last_mut() {
            Some(last) if open && !starts && !line.is_empty() => {
                last.push(' ');
                last.push_str(line);
            }
            _ if line.is_empty() => {}
            _ => found.push(line.to_owned()),
        }
        open = !line.is_empty();
    }
    found
}

/// Wraps one line of text to `width`. Every line is indented by `indent` spaces, except that the first line begins
/// with `first`, padded to that length. Ends with a newline.
pub fn wrapped(text: &str, first: &str, indent: usize, width: usize) -> String {
    let space = " ".repeat(indent);
    let head = format!("{first:<indent$}");
    let options = Options::new(width).initial_indent(&head).subsequent_indent(&space).break_words(false);
    let mut lines = textwrap::fill(text, options);
    lines.truncate(lines.trim_end().len());
    lines.push('\n');
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_the_source_are_joined_to_paragraphs() {
        let doc = "\n one\n two\n\n three\n - a\n   b\n - c\n";
        assert_eq!(paragraphs(doc), ["one two", "three", "- a b", "- c"]);
        assert_eq!(paragraphs(""), [""; 0]);
    }

    #[test]
    fn text_is_wrapped_beside_a_column() {
        assert_eq!(wrapped("aa bb cc dd", "x", 3, 9), "x  aa bb\n   cc dd\n");
        assert_eq!(wrapped("a_word_that_is_longer", "", 2, 9), "  a_word_that_is_longer\n");
        assert_eq!(wrapped("b", "long-name", 4, 20), "long-nameb\n");
    }
}
