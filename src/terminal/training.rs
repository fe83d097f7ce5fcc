//! Shows the progress of training, and handles its interruption.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressStyle};

use super::output::remark;

/// Shows the progress of a training: a bar on a terminal, otherwise a line on standard error after each tenth of a
/// stage.
pub struct Follow {
    bar: ProgressBar,
    tenth: Option<u64>,
    stopped: Arc<AtomicBool>,
}

impl Follow {
    /// Creates the display. From then on, Ctrl-C stops the training.
    pub fn new() -> Self {
        let stopped = Arc::new(AtomicBool::new(false));
        let flag = stopped.clone();
        // Fails only if a handler is set already; without one, Ctrl-C ends the program.
        drop(ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)));
        let bar = ProgressBar::new(0);
        if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len}") {
            bar.set_style(style);
        }
        Self { bar, tenth: None, stopped }
    }

    /// Returns the flag that Ctrl-C sets.
    pub fn stopped(&self) -> Arc<AtomicBool> {
        self.stopped.clone()
    }

    /// Shows that `at` of `of` parts of a stage are done.
    pub fn show(&mut self, text: String, at: u64, of: u64) {
        if self.bar.is_hidden() {
            if let Some(line) = line(&mut self.tenth, &text, at, of) {
                remark(&line);
            }
            return;
        }
        self.bar.set_length(of);
        self.bar.set_position(at);
        self.bar.set_message(text);
    }

    /// Removes the bar.
    pub fn end(&self) {
        self.bar.finish_and_clear();
    }
}

/// Returns the line to print if standard error is not a terminal; `None` if no further tenth of the stage has been
/// completed since the last line.
fn line(tenth: &mut Option<u64>, text: &str, at: u64, of: u64) -> Option<String> {
    let now = at.saturating_mul(10) / of.max(1);
    (tenth.replace(now) != Some(now)).then(|| format!("{text}: {at}/{of}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    // This test fails if `!=` in `line` is `==`.
    #[test]
    fn a_line_for_each_tenth_of_each_stage() {
        let mut tenth = None;
        let mut lines = Vec::new();
        for (text, of) in [("photographs", 234), ("networks", 8400)] {
            lines.extend((1..=of).filter_map(|at| line(&mut tenth, text, at, of)));
        }
        assert_eq!(lines.len(), 22, "{lines:?}");
        assert_eq!(lines[10], "photographs: 234/234");
        assert_eq!(lines[21], "networks: 8400/8400");
    }
}
