//! The output of a program: standard output and standard error.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Number of lines that are shown in error messages.
const SHOWN: usize = 8;
/// Maximum number of characters of a line that are shown.
const LONGEST: usize = 200;
/// Maximum number of bytes of a file that are read at once.
const AT_ONCE: u64 = 1 << 20;

/// The last lines of a file that a program writes, read as the file grows.
pub struct Log {
    file: Option<File>,
    /// The last lines, oldest first.
    lines: Vec<String>,
    /// The bytes after the last end of a line.
    rest: Vec<u8>,
}

impl Log {
    /// The log of a file, from its beginning.
    pub fn open(path: &Path) -> Self {
        Self { file: File::open(path).ok(), lines: Vec::new(), rest: Vec::new() }
    }

    /// Reads what the program has written since the last call, and calls `line` with each whole line. A carriage
    /// return ends a line as well, since progress bars use it.
    pub fn read(&mut self, line: &mut dyn FnMut(&str)) {
        let Some(file) = &mut self.file else { return };
        loop {
            let mut bytes = Vec::new();
            let read = file.take(AT_ONCE).read_to_end(&mut bytes).unwrap_or(0);
            for byte in bytes {
                if byte != b'\n' && byte != b'\r' {
                    self.rest.push(byte);
                    // A program that never ends its lines must not fill the memory.
                    self.rest.truncate(1 << 16);
                    continue;
                }
                let text = shown(&std::mem::take(&mut self.rest));
                if text.is_empty() {
                    continue;
                }
                line(&text);
                if self.lines.len() == SHOWN {
                    self.lines.remove(0);
                }
                self.lines.push(text);
            }
            if read < AT_ONCE as usize {
                return;
            }
        }
    }

    /// The last lines of the file.
    pub fn last(&self) -> Vec<String> {
        let mut lines = self.lines.clone();
        lines.extend(Some(shown(&self.rest)).filter(|text| !text.is_empty()));
        lines.drain(..lines.len().saturating_sub(SHOWN));
        lines
    }
}

/// A line without control characters and escape sequences of terminals, shortened.
fn shown(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    let (mut line, mut escape) = (String::new(), false);
    for c in text.chars() {
        match c {
            '\u{1b}' => escape = true,
            _ if escape => escape = !c.is_ascii_alphabetic(),
            '\t' => line.push(' '),
            c if !c.is_control() => line.push(c),
            _ => {}
        }
    }
    let line = line.trim();
    match line.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}..", &line[..end]),
        None => line.to_owned(),
    }
}

/// The progress that a line states, from 0 to 1: the last percentage (`45%`), or else the last pair of whole numbers
/// in the form `3/40` or `3 / 40`.
pub fn fraction_in(line: &str) -> Option<f32> {
    let digits_before = |end: usize| {
        let head = line[..end].trim_end();
        let start = head.rfind(|c: char| !(c.is_ascii_digit() || c == '.')).map_or(0, |at| at + 1);
        head[start..].parse::<f32>().ok()
    };
    let percent = line.rfind('%').and_then(digits_before).map(|value| value / 100.0);
    let pair = || {
        let at = line.rfind('/')?;
        let tail = line[at + 1..].trim_start();
        let end = tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len());
        let (done, all) = (digits_before(at)?, tail[..end].parse::<f32>().ok()?);
        (all > 0.0 && done.fract() == 0.0).then(|| done / all)
    };
    percent.or_else(pair).filter(|fraction| (0.0..=1.0).contains(fraction))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_is_found_in_the_lines_of_programs() {
        for (line, fraction) in [
            ("Step 100: 0.123 (5%)", Some(0.05)),
            (" 45%|####     | 450/1000 [00:10<00:12]", Some(0.45)),
            ("Processed file [3/40]", Some(0.075)),
            ("Matching block [1/2, 1/4]", Some(0.25)),
            ("loss 0.3", None),
            ("/usr/lib/x", None),
            ("9/4", None),
            ("%", None),
        ] {
            assert_eq!(fraction_in(line), fraction, "{line}");
        }
    }

    #[test]
    fn lines_are_shown_without_escape_sequences() {
        assert_eq!(shown(b"\x1b[31merror\x1b[0m:\tno data \x07"), "error: no data");
        assert_eq!(shown("ä".repeat(300).as_bytes()).chars().count(), 202);
    }
}
