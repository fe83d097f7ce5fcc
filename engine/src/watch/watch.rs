//! Watching: runs a graph again whenever one of its files changes.
//!
//! One thread decides. It sleeps until a notification, an event of the run, or the time of the next inspection. A
//! run has its own thread and is cancelled by a newer graph; finished nodes are kept. Long runs are preceded by
//! previews that limit a parameter (`samples`). Since the work of such nodes is cached in chunks, each run computes
//! only what the one before did not.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use crate::graph::graph::Graph;
use crate::plan::plan::Fate;
use crate::run::engine::Engine;
use crate::run::event::{Event, Forecast, State};
use crate::run::options::RunOptions;
use crate::text::diag::{Diagnostics, Mistake};
use crate::watch::files::Files;
use crate::watch::handle::{Handle, Input};
use crate::watch::listener::listen;
use crate::watch::settling::Pace;

/// The watched graph as read at one moment.
pub struct Load {
    /// The graph and its targets (empty: the default ones), or its mistakes.
    pub graph: Result<(Arc<Graph>, Vec<usize>), Refusal>,
    /// The files of the graph itself, whether they exist or not.
    pub texts: Vec<PathBuf>,
}

/// Why there is no graph to run.
#[derive(Debug, Clone, PartialEq)]
pub struct Refusal {
    /// The mistakes with their places.
    pub list: Vec<Mistake>,
    /// The mistakes as text for a person.
    pub text: String,
    /// Files that the graph names; a change to one may resolve the mistakes.
    pub files: Vec<PathBuf>,
}

impl Refusal {
    /// The mistakes of a graph; `colour` for terminals.
    pub fn mistakes(diagnostics: &Diagnostics, colour: bool) -> Self {
        let (list, files) = (diagnostics.mistakes(), diagnostics.files.clone());
        Self { list, text: diagnostics.render(colour), files }
    }

    /// Any other cause, such as a file that cannot be read.
    pub fn other(text: String) -> Self {
        Self { list: Vec::new(), text, files: Vec::new() }
    }
}

/// Options of a watch.
#[derive(Debug, Clone)]
pub struct WatchOptions {
    /// Output folder of sinks.
    pub out: PathBuf,
    /// The parameter that previews limit.
    pub refine: Option<&'static str>,
    /// Inspects the files every half second and does not use notifications.
    pub poll: bool,
    /// Time without further changes before a change is handled.
    pub settle: Duration,
    /// Time before mistakes are reported, since a graph may be half written.
    pub patience: Duration,
}

impl Default for WatchOptions {
    fn default() -> Self {
        Self {
            out: PathBuf::from("out"),
            refine: Some("samples"),
            poll: false,
            settle: Duration::from_millis(25),
            patience: Duration::from_millis(200),
        }
    }
}

/// Maximum time before continuous changes are handled.
const LONGEST: Duration = Duration::from_millis(300);
/// Interval of inspections without notifications.
const POLL: Duration = Duration::from_millis(500);
/// Interval of inspections with notifications, which network drives omit and systems lose.
const DOUBT: Duration = Duration::from_secs(2);
/// Time in seconds below which no preview is needed.
const SOON: f64 = 0.5;

/// Time in seconds below which the first preview computes all pixels.
const AT_ONCE: f64 = 0.3;

/// The result of waiting.
enum Next {
    /// Files changed, and the graph must run again.
    Changed(Box<Load>),
    /// The run ended.
    Ended,
    Quit,
}

/// A watch that has not started.
pub struct Watch {
    options: WatchOptions,
    inputs: Receiver<Input>,
    handle: Handle,
    files: Files,
}

impl Watch {
    /// A watch with notifications, if the system provides them.
    pub fn new(options: WatchOptions) -> Self {
        let (sender, inputs) = channel();
        let handle = Handle(sender);
        let ears = match options.poll {
            true => Err("polling was requested".to_owned()),
            false => listen(handle.clone()),
        };
        Self { options, inputs, handle, files: Files::new(ears) }
    }

    /// A handle to end the watch from outside.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }

    /// Watches until [`Handle::quit`]. `load` reads the graph, at the start and after every change; its argument is
    /// true if no source file of a node changed, so that a graph with the same text need not be checked again.
    /// Returns the files that do not show the current graph.
    pub fn run(
        self,
        engine: &Engine,
        load: impl FnMut(bool) -> Load,
        tell: impl FnMut(Event),
    ) -> Vec<PathBuf> {
        let Watch { options, inputs, handle, files } = self;
        let pace = Pace::new(options.settle, LONGEST);
        let shown = BTreeMap::new();
        let (doubted, good) = (false, false);
        let mut session =
            Session { engine, options, inputs, handle, files, pace, load, tell, shown, doubted, good };
        session.run();
        let wrong = session.shown.into_iter().filter(|(_, file)| file.shown != Shown::Right);
        wrong.map(|(path, _)| path).collect()
    }
}

/// A file written by a sink.
struct SinkFile {
    id: String,
    shown: Shown,
}

/// The state of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shown {
    /// Up to date.
    Right,
    /// A preview.
    Preview,
    /// From an earlier version of the graph.
    Stale,
}

struct Session<'a, L, T> {
    engine: &'a Engine,
    options: WatchOptions,
    inputs: Receiver<Input>,
    handle: Handle,
    files: Files,
    pace: Pace,
    load: L,
    tell: T,
    shown: BTreeMap<PathBuf, SinkFile>,
    /// The graph has mistakes but may be half written.
    doubted: bool,
    /// Whether the last run was successful.
    good: bool,
}

impl<L: FnMut(bool) -> Load, T: FnMut(Event)> Session<'_, L, T> {
    fn run(&mut self) {
        let mut current = self.read(false);
        loop {
            let next = match &current.graph {
                Ok((graph, only)) => self.show(&current, graph, only),
                Err(refusal) => {
                    self.turn_stale(None);
                    let Refusal { list, text, .. } = refusal.clone();
                    (self.tell)(Event::Mistakes { list, text });
                    Next::Ended
                }
            };
            let next = match next {
                Next::Ended => {
                    (self.tell)(Event::Idle { files: self.files.count() });
                    self.wait(&current, false)
                }
                other => other,
            };
            match next {
                Next::Changed(load) => current = *load,
                Next::Ended | Next::Quit => return,
            }
        }
    }

    /// Runs a graph, after previews if it takes long.
    fn show(&mut self, current: &Load, graph: &Graph, only: &[usize]) -> Next {
        self.shown.retain(|_, file| graph.find(&file.id).is_some());
        let plan = self.engine.plan_next(graph, only, &self.options.out);
        let forecast = Forecast::of(&plan);
        if forecast.open > 0 {
            (self.tell)(Event::Plan(forecast));
        }
        let parameter = self.options.refine.unwrap_or_default();
        let opens = |fate: &Fate| matches!(fate, Fate::Runs(_) | Fate::Follows(_) | Fate::Lost);
        let open = || plan.iter().enumerate().filter(|(_, node)| opens(&node.fate));
        let most = open().filter_map(|(index, _)| graph.number(index, parameter)).max().unwrap_or_default();
        let seconds: Option<f64> = open()
            .filter(|(index, _)| graph.number(*index, parameter).is_some())
            .map(|(_, node)| node.forecast)
            .sum();
        let coarse = open().any(|(index, _)| graph.can_be_coarse(index));
        for Level { level, coarse } in levels(most, seconds, coarse) {
            let Some((rough, changed)) = graph.rough(parameter, level, coarse) else { continue };
            (self.tell)(Event::Pass { parameter: parameter.to_owned(), level, of: most, coarse });
            match self.pass(current, &rough, only, changed) {
                Next::Ended => {}
                other => return other,
            }
        }
        self.pass(current, graph, only, Vec::new())
    }

    /// Runs once, until the end or until a newer graph.
    fn pass(&mut self, current: &Load, graph: &Graph, only: &[usize], rough: Vec<usize>) -> Next {
        let cancel = Arc::new(AtomicBool::new(false));
        let options = RunOptions {
            out: self.options.out.clone(),
            texts: current.texts.clone(),
            only: only.to_vec(),
            cancel: cancel.clone(),
            rough,
            trace: false,
        };
        let (engine, handle) = (self.engine, self.handle.clone());
        std::thread::scope(|scope| {
            scope.spawn(|| {
                // Sent even if the engine panics, so that nothing waits for ever.
                let ended = Ended(handle);
                let outcome = engine.run(graph, &options, |event| drop(ended.0.0.send(Input::Told(event))));
                if let Some(failures) = outcome.failures {
                    let (list, text) = (failures.mistakes(), failures.to_string());
                    drop(ended.0.0.send(Input::Told(Event::Mistakes { list, text })));
                }
            });
            let next = self.wait(current, true);
            if !matches!(next, Next::Ended) {
                cancel.store(true, Ordering::Relaxed);
                while let Ok(input) = self.inputs.recv() {
                    match input {
                        // The node is about to run in the next run.
                        Input::Told(Event::Node { state: State::Skipped, .. }) => {}
                        Input::Told(event) => self.pass_on(event),
                        Input::Heard(paths) => self.hear(&paths),
                        Input::Ended => break,
                        Input::Quit => return Next::Quit,
                    }
                }
            }
            next
        })
    }

    /// Waits until changes settled, the run ended, or the watch is to end.
    fn wait(&mut self, current: &Load, running: bool) -> Next {
        let pause = if self.files.hears() { DOUBT } else { POLL };
        let mut look = Instant::now() + pause;
        loop {
            let now = Instant::now();
            if self.pace.take(now)
                && let Some(load) = self.changed(current, running)
            {
                return Next::Changed(Box::new(load));
            }
            if look <= now {
                look = now + pause;
                if !running && self.is_file_gone() {
                    let load = self.read(true);
                    if load.graph.is_ok() {
                        return Next::Changed(Box::new(load));
                    }
                }
                let changed = self.files.look();
                if !changed.is_empty() {
                    self.files.doubt(changed);
                    self.pace.hint(now);
                }
            }
            let until = self.pace.due().map_or(look, |due| due.min(look));
            match self.inputs.recv_timeout(until.saturating_duration_since(now)) {
                Ok(Input::Heard(paths)) => self.hear(&paths),
                Ok(Input::Told(event)) => self.pass_on(event),
                Ok(Input::Ended) => return Next::Ended,
                Ok(Input::Quit) | Err(RecvTimeoutError::Disconnected) => return Next::Quit,
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Returns true if a file of a successful run was deleted since.
    fn is_file_gone(&self) -> bool {
        let gone = |(path, file): (&PathBuf, &SinkFile)| file.shown == Shown::Right && !path.exists();
        self.good && self.shown.iter().any(gone)
    }

    fn hear(&mut self, paths: &[PathBuf]) {
        if self.files.heard(paths) {
            self.doubted = false;
            self.pace.hint(Instant::now());
        }
    }

    /// The graph to run, if its meaning changed, or if its results are not up to date.
    fn changed(&mut self, current: &Load, running: bool) -> Option<Load> {
        let changed = self.files.look();
        if changed.is_empty() {
            return None;
        }
        let texts: BTreeSet<PathBuf> =
            current.texts.iter().filter_map(|p| std::path::absolute(p).ok()).collect();
        let only_texts = changed.iter().all(|path| texts.contains(path));
        let load = self.read(only_texts);
        let same = match (&current.graph, &load.graph) {
            (Ok((old, wanted)), Ok((new, now))) => wanted == now && (Arc::ptr_eq(old, new) || old.same(new)),
            (Err(old), Err(new)) => old == new,
            _ => false,
        };
        if same && only_texts {
            self.doubted = false;
            (self.tell)(Event::Same);
            // Saving an unchanged graph retries what failed.
            let in_place = |(path, file): (&PathBuf, &SinkFile)| file.shown == Shown::Right && path.exists();
            let again = !running && load.graph.is_ok() && !(self.good && self.shown.iter().all(in_place));
            return again.then_some(load);
        }
        if load.graph.is_err() && !std::mem::replace(&mut self.doubted, true) {
            self.files.doubt(changed);
            self.pace.wait(Instant::now(), self.options.patience);
            return None;
        }
        self.doubted = false;
        Some(load)
    }

    /// Reads the graph, and reads it again if it names files that were not watched during reading.
    fn read(&mut self, mut same_files: bool) -> Load {
        loop {
            let load = (self.load)(std::mem::replace(&mut same_files, false));
            let mut paths = load.texts.clone();
            match &load.graph {
                Ok((graph, _)) => paths.extend(graph.files()),
                // The files of the last graph stay watched, since one of them may be missing now.
                Err(refusal) => paths.extend(refusal.files.iter().cloned().chain(self.files.paths())),
            }
            let new = self.files.follow(&paths);
            if let Some(why) = self.files.take_deafness() {
                let text = format!(
                    "no notifications from the system ({why}): checking files every {} ms",
                    POLL.as_millis()
                );
                (self.tell)(Event::Warning { id: "watch-polls", text });
            }
            if !new {
                return load;
            }
        }
    }

    /// Forwards an event and records the state of files.
    fn pass_on(&mut self, event: Event) {
        let mut stale = None;
        match &event {
            Event::File { id, path, preview, .. } => {
                let shown = if *preview { Shown::Preview } else { Shown::Right };
                self.shown.insert(path.clone(), SinkFile { id: id.clone(), shown });
            }
            Event::Node { id, state: State::Failed | State::Skipped, .. } => stale = Some(id.clone()),
            Event::Done(totals) => self.good = !totals.stopped && totals.failed == 0 && totals.skipped == 0,
            _ => {}
        }
        (self.tell)(event);
        if let Some(id) = stale {
            self.turn_stale(Some(&id));
        }
    }

    /// Marks the files of one sink, or all files, as stale.
    fn turn_stale(&mut self, id: Option<&str>) {
        for (path, file) in &mut self.shown {
            if file.shown != Shown::Stale && id.is_none_or(|id| file.id == id) {
                file.shown = Shown::Stale;
                (self.tell)(Event::Stale { path: path.clone() });
            }
        }
    }
}

/// Reports the end of a run when dropped.
struct Ended(Handle);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.0.send(Input::Ended);
    }
}

/// The reduction of a preview.
#[derive(Debug, PartialEq, Eq)]
struct Level {
    /// Limit of the parameter.
    level: u64,
    /// Side of the blocks of pixels of which one is computed.
    coarse: u64,
}

/// The previews for a parameter with maximum `most` and a total time of `seconds`, if known. The limits are the
/// chunk boundaries of nodes that work in chunks, and 1. If even that takes long and a node supports it, the first
/// preview computes a subset of the pixels.
fn levels(most: u64, seconds: Option<f64>, coarse: bool) -> Vec<Level> {
    let takes = |level: u64| seconds.map_or(f64::INFINITY, |all| all * level as f64 / most.max(1) as f64);
    let block = match takes(1) {
        ..=AT_ONCE => None,
        // Blocks of 2 by 2 pixels take a quarter of the time.
        time if time <= 4.0 * AT_ONCE => Some(2),
        _ => Some(4),
    };
    let first = block.filter(|_| coarse && most > 0).map(|coarse| Level { level: 1, coarse });
    let steps = std::iter::successors(Some(1_u64), |step| step.checked_mul(4));
    // A preview is left out if the next one comes soon.
    let levels = steps
        .take_while(|step| *step < most)
        .filter(|step| takes(step.saturating_mul(4).min(most)) > SOON)
        .map(|level| Level { level, coarse: 1 });
    first.into_iter().chain(levels).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(most: u64, seconds: Option<f64>) -> Vec<(u64, u64)> {
        levels(most, seconds, true).into_iter().map(|l| (l.level, l.coarse)).collect()
    }

    #[test]
    fn what_takes_long_comes_roughly_first() {
        assert_eq!(told(0, None), [], "nothing is refined");
        assert_eq!(told(64, Some(0.4)), [], "soon there");
        assert_eq!(told(64, Some(1.0)), [(16, 1)]);
        assert_eq!(told(64, Some(64.0)), [(1, 2), (1, 1), (4, 1), (16, 1)]);
        assert_eq!(told(64, Some(640.0)), [(1, 4), (1, 1), (4, 1), (16, 1)]);
        assert_eq!(told(1, None), [(1, 4)], "one sample of many pixels");
        assert_eq!(told(3, None), [(1, 4), (1, 1)]);
        assert_eq!(levels(3, None, false), [Level { level: 1, coarse: 1 }], "no node can be coarse");
    }
}
