//! Output of `tune` and `report` while they measure: a forecast, a bar, a line for each setting.

use std::cell::RefCell;
use std::io::IsTerminal;
use std::rc::Rc;
use std::time::{Duration, Instant};

use engine::Event;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use trade::Outlook;
use trade::bench::Observer;

use super::output::remark;
use super::words::seconds_text;

/// Shows the progress of measuring. Clones share one bar.
#[derive(Clone)]
pub struct Measuring(Rc<RefCell<State>>);

struct State {
    bar: ProgressBar,
    begin: Instant,
    /// Total number of settings, if known.
    of: Option<usize>,
    /// Forecast for the remaining settings, and the time at which it was computed.
    left: Option<(Outlook, Instant)>,
    /// The running node and its progress, from 0 to 1.
    node: Option<(String, f32)>,
}

impl Measuring {
    /// A display of the progress through `of` settings. `of` is `None` if the number of settings is not known.
    pub fn new(of: Option<usize>) -> Self {
        let target = if std::io::stderr().is_terminal() {
            ProgressDrawTarget::stderr_with_hz(12)
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(Some(1000), target);
        let style = ProgressStyle::with_template("measuring [{bar:24}] {elapsed:>4}  {wide_msg}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
        let begin = Instant::now();
        Self(Rc::new(RefCell::new(State { bar, begin, of, left: None, node: None })))
    }

    /// Sets the forecast for the remaining settings.
    pub fn expect(&self, outlook: Outlook) {
        self.0.borrow_mut().left = Some((outlook, Instant::now()));
    }

    /// The callback for the events of a bench.
    pub fn observer<'e>(&self) -> Observer<'e> {
        let shown = self.clone();
        Box::new(move |name, before, event| shown.0.borrow_mut().show(name, before, event))
    }

    /// Prints a line above the bar.
    pub fn line(&self, text: &str) {
        let bar = self.0.borrow().bar.clone();
        bar.suspend(|| remark(text));
    }

    /// Removes the bar.
    pub fn end(&self) {
        self.0.borrow().bar.finish_and_clear();
    }
}

impl State {
    fn show(&mut self, name: &str, before: usize, event: &Event) {
        match event {
            Event::Start { id, .. } => self.node = Some((id.clone(), 0.0)),
            Event::Progress { id, fraction } => self.node = Some((id.clone(), *fraction)),
            Event::Done(_) => self.node = None,
            _ => return,
        }
        if self.bar.is_hidden() {
            return;
        }
        self.bar.enable_steady_tick(Duration::from_millis(250));
        let left = self.left.as_ref().map(|(outlook, since)| {
            (outlook.unknown, (outlook.seconds - since.elapsed().as_secs_f64()).max(0.0))
        });
        let (elapsed, of) = (self.begin.elapsed().as_secs_f64(), self.of);
        let part = match (left, of) {
            (Some((0, left)), _) => elapsed / (elapsed + left).max(1e-9),
            (_, Some(of)) => before as f64 / of.max(1) as f64,
            _ => 0.0,
        };
        self.bar.set_position((1000.0 * part) as u64);
        self.bar.set_message(text(name, before, of, self.node.as_ref(), left));
    }
}

/// Formats the state of the bar: `setting 3 of 14, preview, trace 45 %, about 12 s left`.
fn text(
    name: &str,
    before: usize,
    of: Option<usize>,
    node: Option<&(String, f32)>,
    left: Option<(usize, f64)>,
) -> String {
    let of = of.map(|of| format!(" of {of}")).unwrap_or_default();
    let mut parts = vec![format!("setting {}{of}", before + 1), name.to_owned()];
    parts.extend(node.map(|(id, fraction)| match fraction {
        f if *f > 0.0 => format!("{id} {:.0} %", 100.0 * f),
        _ => id.clone(),
    }));
    parts.extend(left.map(|(unknown, seconds)| match unknown {
        0 if seconds < 0.5 => "nearly done".to_owned(),
        0 => format!("about {} left", seconds_text(seconds)),
        _ => "time left unknown".to_owned(),
    }));
    parts.join(", ")
}

/// Formats the forecast before the first measurement: `14 settings, about 12 s`.
pub fn outlook_text(outlook: &Outlook) -> String {
    let Outlook { settings, seconds, unknown } = outlook;
    let s = if *settings == 1 { "" } else { "s" };
    let known = seconds_text(*seconds);
    match (*unknown, *seconds >= 0.05) {
        (0, false) => format!("{settings} setting{s}, all results known"),
        (0, true) => format!("{settings} setting{s}, about {known}"),
        (n, false) => {
            format!("{settings} setting{s}, time unknown (planned runs without an estimate: {n})")
        }
        (n, true) => {
            format!("{settings} setting{s}, more than {known} (planned runs without an estimate: {n})")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_counted_and_what_is_unknown_is_said() {
        let node = ("trace".to_owned(), 0.45);
        let shown = text("preview", 2, Some(14), Some(&node), Some((0, 12.0)));
        assert_eq!(shown, "setting 3 of 14, preview, trace 45 %, about 12.00 s left");
        assert_eq!(text("draft", 0, None, None, Some((3, 1.0))), "setting 1, draft, time left unknown");
        let outlook = Outlook { settings: 14, seconds: 200.0, unknown: 0 };
        assert_eq!(outlook_text(&outlook), "14 settings, about 3 min 20 s");
        assert!(outlook_text(&Outlook { unknown: 2, ..outlook }).contains("more than 3 min 20 s"));
        assert_eq!(
            outlook_text(&Outlook { settings: 1, ..Outlook::default() }),
            "1 setting, all results known"
        );
    }
}
