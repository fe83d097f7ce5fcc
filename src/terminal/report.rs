//! Turns events into bars and lines on a terminal, plain lines elsewhere, or JSON lines.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{IsTerminal, Write};
use std::time::Duration;

use engine::{Event, Level, State};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::output::{colours, error, json_line};
use super::words::{counts_text, forecast_text, seconds_text, totals_text};

/// How a run is told.
pub enum Report {
    /// One JSON object a line on standard output.
    Json,
    /// Lines on standard error, paths of written files on standard output; bars where it is a terminal.
    Lines(Box<Lines>),
}

pub struct Lines {
    bars: MultiProgress,
    running: BTreeMap<String, ProgressBar>,
    every: bool,
    colour: bool,
    /// What was remarked on already; a graph that runs again and again says the same each time.
    remarks: BTreeSet<(String, String)>,
}

impl Report {
    /// JSON lines.
    pub fn json() -> Self {
        Report::Json
    }

    /// Lines for a person; `every` also tells nodes whose result was known.
    pub fn lines(every: bool) -> Self {
        let target = if std::io::stderr().is_terminal() {
            ProgressDrawTarget::stderr_with_hz(12)
        } else {
            ProgressDrawTarget::hidden()
        };
        let bars = MultiProgress::with_draw_target(target);
        Report::Lines(Box::new(Lines {
            bars,
            running: BTreeMap::new(),
            every,
            colour: colours(),
            remarks: BTreeSet::new(),
        }))
    }

    /// Tells one event. A closed standard output is no reason to stop a run.
    pub fn tell(&mut self, event: &Event) {
        match self {
            // Threads are for traces.
            Report::Json if matches!(event, Event::Span { .. }) => {}
            Report::Json => json_line(event),
            Report::Lines(lines) => lines.tell(event),
        }
    }
}

impl Lines {
    fn tell(&mut self, event: &Event) {
        match event {
            Event::Start { id, kind, forecast } => self.start(id, kind, *forecast),
            Event::Progress { id, fraction } => {
                if let Some(bar) = self.running.get(id) {
                    bar.set_position((fraction * 1000.0) as u64);
                }
            }
            Event::Part { .. } | Event::Span { .. } => {}
            Event::Remake { id, reason } => {
                self.line("again", "33", &format!("{id}: {reason}"));
            }
            Event::Node { id, kind, state, seconds, counts, notes, degraded, .. } => {
                if let Some(bar) = self.running.remove(id) {
                    bar.finish_and_clear();
                }
                match state {
                    State::Ran => {
                        // Every node has bytes; that many numbers are for those who ask.
                        let shown = |name: &String| self.every || !name.starts_with("bytes_");
                        let counts = counts.iter().filter(|(name, _)| shown(name));
                        let counts = counts.map(|(name, n)| (name.clone(), *n)).collect();
                        let text = format!(
                            "{id:<12} {kind:<16} {:>8}{}",
                            seconds_text(*seconds),
                            counts_text(&counts)
                        );
                        self.line("ran", "32", &text);
                    }
                    State::Cached if self.every => self.line("cached", "2", &format!("{id:<12} {kind}")),
                    State::Cached => {}
                    State::Failed => self.line("failed", "31;1", &format!("{id:<12} {kind}")),
                    State::Skipped => self.line("skipped", "33", &format!("{id:<12} {kind}")),
                }
                for note in notes {
                    if !self.remarks.insert((id.clone(), note.text.clone())) && !self.every {
                        continue;
                    }
                    let (word, colour) = match note.level {
                        Level::Count | Level::Decision => ("note", "36"),
                        Level::Warning => ("warning", "33;1"),
                        Level::Degraded => ("degraded", "31;1"),
                    };
                    self.line(word, colour, &format!("{id}: {} [{}]", note.text, note.id));
                }
                if *degraded && !notes.iter().any(|note| note.level == Level::Degraded) && self.every {
                    self.line("degraded", "31;1", &format!("{id}: made from a degraded result"));
                }
            }
            Event::File { path, written, preview, .. } => {
                // A person sees one line; a program that reads standard output gets the bare path.
                let shown = path.display();
                if !std::io::stdout().is_terminal() {
                    let _ = writeln!(std::io::stdout().lock(), "{shown}");
                }
                if *preview {
                    self.line("preview", "36;1", &shown.to_string());
                } else if *written {
                    self.line("wrote", "32;1", &shown.to_string());
                } else if self.every {
                    self.line("kept", "2", &shown.to_string());
                }
            }
            Event::Warning { id, text } => self.line("warning", "33;1", &format!("{text} [{id}]")),
            Event::Done(totals) => {
                self.bars.clear().unwrap_or_default();
                self.line("done", "1", &totals_text(totals));
            }
            Event::Plan(forecast) => self.line("plan", "1", &forecast_text(forecast)),
            Event::Same => self.line("same", "36", "the graph says the same as before"),
            Event::Pass { parameter, level, of, coarse } => {
                let blocks = match coarse {
                    1 => String::new(),
                    n => format!(", one pixel of each {n} by {n}"),
                };
                self.line("preview", "36", &format!("{parameter} {level} of {of}{blocks}"));
            }
            Event::Mistakes { text, .. } => self.bars.suspend(|| error(text)),
            Event::Stale { path } => {
                let text = format!("{} shows the graph as it was before", path.display());
                self.line("stale", "33;1", &text);
            }
            Event::Idle { files } => {
                let s = if *files == 1 { "" } else { "s" };
                self.line("watching", "2", &format!("{files} file{s}; Ctrl-C ends"));
            }
        }
    }

    fn start(&mut self, id: &str, kind: &str, forecast: Option<f64>) {
        let about = forecast.map(|s| format!("about {}", seconds_text(s))).unwrap_or_default();
        let style = ProgressStyle::with_template("{prefix:>9} {msg} [{bar:24}] {elapsed}")
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("=> ");
        let bar = self.bars.add(ProgressBar::new(1000).with_style(style));
        bar.set_prefix("runs");
        bar.set_message(format!("{id:<12} {kind:<16} {about:<12}"));
        bar.enable_steady_tick(Duration::from_millis(250));
        self.running.insert(id.to_owned(), bar);
    }

    fn line(&self, word: &str, colour: &str, text: &str) {
        self.bars.suspend(|| {
            // In one piece: nothing else that writes there comes between.
            let line = if self.colour {
                format!("\u{1b}[{colour}m{word:>9}\u{1b}[0m {text}\n")
            } else {
                format!("{word:>9} {text}\n")
            };
            let _ = std::io::stderr().lock().write_all(line.as_bytes());
        });
    }
}
