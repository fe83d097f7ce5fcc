//! Prints events: as lines and a progress bar on a terminal, as lines elsewhere, or as JSON lines.

use std::collections::BTreeSet;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use engine::{Event, Level, Note, Planned, State};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::output::{colours, error, json_line};
use super::progress::Progress;
use super::words::{counts_text, forecast_text, seconds_text, totals_text};

/// Prints the events of a run.
pub enum Report {
    /// Print one JSON object per line on standard output.
    Json,
    /// Lines on standard error, with a bar if it is a terminal, and paths of written files on standard output.
    Lines(Box<Lines>),
    /// The same, and progress for Open Job Description on standard output. The number is the last printed progress in
    /// percent.
    OpenJd(Box<Lines>, Option<u8>),
}

/// Lines of text.
pub struct Lines {
    bar: ProgressBar,
    progress: Progress,
    begin: Instant,
    /// True to also print cached nodes, counts and all notes.
    verbose: bool,
    colour: bool,
    /// Notes that were printed, since `watch` prints each note only once.
    printed: BTreeSet<(String, String)>,
    /// Number of notes that were not printed in this run.
    unprinted: usize,
    /// Sinks whose paths were printed in this run.
    written: BTreeSet<String>,
}

impl Report {
    /// A report as JSON lines.
    pub fn json() -> Self {
        Report::Json
    }

    /// A report as lines of text; `verbose` also prints cached nodes, counts and all notes.
    pub fn lines(verbose: bool) -> Self {
        Report::Lines(Lines::new(verbose))
    }

    /// A report as lines of text, with progress for Open Job Description.
    pub fn openjd(verbose: bool) -> Self {
        Report::OpenJd(Lines::new(verbose), None)
    }

    /// True if progress with a forecast is shown. The forecast requires a plan.
    pub fn shows_forecast(&self) -> bool {
        match self {
            Report::Json => false,
            Report::Lines(lines) => !lines.bar.is_hidden(),
            Report::OpenJd(..) => true,
        }
    }

    /// Sets the plan of the run that follows, for the forecast.
    pub fn expect(&mut self, plan: &[Planned]) {
        if let Report::Lines(lines) | Report::OpenJd(lines, _) = self {
            lines.progress = Progress::planned(plan, lines.now());
        }
    }

    /// Prints one event. A closed standard output does not stop a run.
    pub fn show(&mut self, event: &Event) {
        match self {
            // Spans are for traces.
            Report::Json if matches!(event, Event::Span { .. }) => {}
            Report::Json => json_line(event),
            Report::Lines(lines) => lines.show(event),
            Report::OpenJd(lines, printed) => {
                lines.show(event);
                for line in lines.openjd(event, printed) {
                    let _ = writeln!(std::io::stdout().lock(), "{line}");
                }
            }
        }
    }
}

impl Lines {
    fn new(verbose: bool) -> Box<Self> {
        let target = if std::io::stderr().is_terminal() {
            ProgressDrawTarget::stderr_with_hz(12)
        } else {
            ProgressDrawTarget::hidden()
        };
        Box::new(Self {
            bar: ProgressBar::with_draw_target(None, target),
            progress: Progress::default(),
            begin: Instant::now(),
            verbose,
            colour: colours(),
            printed: BTreeSet::new(),
            unprinted: 0,
            written: BTreeSet::new(),
        })
    }

    /// The lines of Open Job Description for an event: the progress in percent when it has grown, and the state of
    /// the run when a node starts.
    fn openjd(&self, event: &Event, printed: &mut Option<u8>) -> Vec<String> {
        let (percent, starts) = match event {
            Event::Start { .. } => (self.progress.fraction(self.now()), true),
            Event::Progress { .. } | Event::Node { .. } => (self.progress.fraction(self.now()), false),
            Event::Done(_) => (1.0, false),
            _ => return Vec::new(),
        };
        let percent = (100.0 * percent) as u8;
        let mut lines = Vec::new();
        if printed.is_none_or(|printed| percent > printed) {
            *printed = Some(percent);
            lines.push(format!("openjd_progress: {percent}"));
        }
        if starts {
            lines.push(format!("openjd_status: {}", self.progress.text(self.now())));
        }
        lines
    }

    fn now(&self) -> f64 {
        self.begin.elapsed().as_secs_f64()
    }

    fn show(&mut self, event: &Event) {
        match event {
            Event::Start { id, forecast, .. } => {
                self.progress.start(id, *forecast, self.now());
                self.draw();
            }
            Event::Progress { id, fraction } => {
                self.progress.advance(id, *fraction);
                self.draw();
            }
            Event::Stage { id, stage, worker } => {
                let place = if worker.is_empty() { String::new() } else { format!(" on {worker}") };
                self.progress.stage(id, format!("{stage}{place}"));
                self.draw();
            }
            Event::Part { .. } | Event::Span { .. } => {}
            Event::Remake { id, reason } => self.line("again", "33", &format!("{id}: {reason}")),
            Event::Node { id, .. } => {
                self.progress.end(id);
                self.draw();
                self.node(event);
            }
            Event::File { id, path, written, preview } => {
                self.written.insert(id.clone());
                let shown = path.display();
                // A program that reads standard output gets the bare path; on a terminal each path is printed once.
                let [out, err] = [std::io::stdout().is_terminal(), std::io::stderr().is_terminal()];
                if !out {
                    let _ = writeln!(std::io::stdout().lock(), "{shown}");
                }
                match (*preview, *written) {
                    _ if !out && !err => {}
                    (true, _) => self.line("preview", "36;1", &shown.to_string()),
                    (false, true) => self.line("wrote", "32;1", &shown.to_string()),
                    (false, false) if self.verbose => self.line("kept", "2", &shown.to_string()),
                    (false, false) => {}
                }
            }
            Event::Warning { id, text } => self.line("warning", "33;1", &format!("{text} [{id}]")),
            Event::Done(totals) => {
                self.bar.finish_and_clear();
                let mut text = totals_text(totals);
                match std::mem::take(&mut self.unprinted) {
                    0 => {}
                    1 => text.push_str("; 1 note, which --verbose prints"),
                    n => text.push_str(&format!("; {n} notes, which --verbose prints")),
                }
                self.written.clear();
                self.line("done", "1", &text);
            }
            Event::Plan(forecast) => {
                self.progress = Progress::forecast(forecast, self.now());
                self.line("plan", "1", &forecast_text(forecast));
            }
            Event::Same => self.line("same", "36", "the edit does not change the graph"),
            Event::Pass { parameter, level, of, coarse } => {
                let blocks = match coarse {
                    1 => String::new(),
                    n => format!(", with one computed pixel per block of {n} by {n} pixels"),
                };
                self.line("preview", "36", &format!("{parameter} {level} of {of}{blocks}"));
            }
            Event::Mistakes { text, .. } => self.bar.suspend(|| error(text)),
            Event::Stale { path } => {
                let text = format!("{} is still from an earlier run", path.display());
                self.line("stale", "33;1", &text);
            }
            Event::Idle { files } => {
                let s = if *files == 1 { "" } else { "s" };
                self.line("watching", "2", &format!("{files} file{s}; press Ctrl-C to end"));
            }
        }
    }

    /// Prints one line for a node that is done, and its notes.
    fn node(&mut self, event: &Event) {
        let Event::Node { id, kind, state, seconds, counts, notes, degraded, .. } = event else { return };
        match state {
            // The line about its file is enough.
            State::Ran if self.written.contains(id) && !self.verbose => {}
            State::Ran => {
                let counts = if self.verbose { counts_text(counts) } else { String::new() };
                let text = format!("{id:<12} {kind:<16} {:>8}{counts}", seconds_text(*seconds));
                self.line("ran", "32", text.trim_end());
            }
            State::Cached if self.verbose => self.line("cached", "2", &format!("{id:<12} {kind}")),
            State::Cached => {}
            State::Failed => self.line("failed", "31;1", &format!("{id:<12} {kind}")),
            State::Skipped => self.line("skipped", "33", &format!("{id:<12} {kind}")),
        }
        notes.iter().for_each(|note| self.note(id, note));
        if *degraded && !notes.iter().any(|note| note.level == Level::Degraded) && self.verbose {
            self.line("degraded", "31;1", &format!("{id}: made from a degraded result"));
        }
    }

    /// Prints a note. Warnings are always printed, once per process; other notes are counted, and printed only with
    /// `verbose`.
    fn note(&mut self, id: &str, note: &Note) {
        let (word, colour, asks_for_action) = match note.level {
            Level::Count | Level::Decision => ("note", "36", false),
            Level::Warning => ("warning", "33;1", true),
            Level::Degraded => ("degraded", "31;1", true),
        };
        let new = self.printed.insert((id.to_owned(), note.text.clone()));
        if self.verbose || (asks_for_action && new) {
            self.line(word, colour, &format!("{id}: {} [{}]", note.text, note.id));
        } else if !asks_for_action {
            self.unprinted += 1;
        }
    }

    /// Updates the bar while a node runs.
    fn draw(&self) {
        if self.bar.is_hidden() || !self.progress.is_running() {
            return;
        }
        if self.bar.length().is_none() || self.bar.is_finished() {
            let style = ProgressStyle::with_template("{prefix:>9} [{bar:24}] {elapsed:>4}  {wide_msg}");
            let style = style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> ");
            self.bar.reset();
            self.bar.set_style(style);
            self.bar.set_length(1000);
            self.bar.set_prefix("running");
            self.bar.enable_steady_tick(Duration::from_millis(250));
        }
        let now = self.now();
        self.bar.set_position((1000.0 * self.progress.fraction(now)) as u64);
        self.bar.set_message(self.progress.text(now));
    }

    fn line(&self, word: &str, colour: &str, text: &str) {
        self.bar.suspend(|| {
            // One write, so that other output does not come between.
            let line = if self.colour {
                format!("\u{1b}[{colour}m{word:>9}\u{1b}[0m {text}\n")
            } else {
                format!("{word:>9} {text}\n")
            };
            let _ = std::io::stderr().lock().write_all(line.as_bytes());
        });
    }
}
