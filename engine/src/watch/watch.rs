//! Watching: runs a graph again whenever one of its files changes.
//!
//! One thread controls the runs. It sleeps until a notification, an event of the run, or the time of the next
//! inspection. A run has its own thread and is cancelled by a newer graph; finished nodes are kept. Long runs are
//! preceded by previews that limit a parameter (`samples`). Since the samples of such nodes are cached in chunks,
//! each run computes only the samples that earlier runs did not compute.

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
use crate::watch::files::WatchedFiles;
use crate::watch::handle::{Handle, Input};
use crate::watch::listener::listen;
use crate::watch::options::{Load, Refusal, WatchOptions};
use crate::watch::previews::{Reduction, levels};
use crate::watch::settling::Settling;

/// Maximum time for which changes are collected before they are handled.
const LONGEST: Duration = Duration::from_millis(300);
/// Interval between inspections if there are no notifications.
const POLL: Duration = Duration::from_millis(500);
/// Interval between inspections even if there are notifications, since network drives send none and systems may
/// lose them.
const CHECK: Duration = Duration::from_secs(2);
/// The reason why a wait ended.
enum Next {
    /// Watched files changed, and the graph must run again.
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
    files: WatchedFiles,
}

impl Watch {
    /// A watch that uses notifications if the system provides them.
    pub fn new(options: WatchOptions) -> Self {
        let (sender, inputs) = channel();
        let handle = Handle(sender);
        let notifier = match options.poll {
            true => Err("polling was requested".to_owned()),
            false => listen(handle.clone()),
        };
        Self { options, inputs, handle, files: WatchedFiles::new(notifier) }
    }

    /// A handle that controls the watch from outside.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }

    /// Watches until [`Handle::quit`] is called. `load` reads the graph at the start and after every change. The
    /// argument of `load` is true if no source file of a node has changed; a graph with the same text then need not
    /// be checked again. Returns the files that do not show the current graph.
    pub fn run(
        self,
        engine: &Engine,
        load: impl FnMut(bool) -> Load,
        emit: impl FnMut(Event),
    ) -> Vec<PathBuf> {
        let Watch { options, inputs, handle, files } = self;
        let settling = Settling::new(options.settle, LONGEST);
        let shown = BTreeMap::new();
        let (suspected, good) = (false, false);
        let mut session =
            Session { engine, options, inputs, handle, files, settling, load, emit, shown, suspected, good };
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
    /// The file is up to date.
    Right,
    /// The file shows a preview.
    Preview,
    /// The file shows an earlier version of the graph.
    Stale,
}

struct Session<'a, L, T> {
    engine: &'a Engine,
    options: WatchOptions,
    inputs: Receiver<Input>,
    handle: Handle,
    files: WatchedFiles,
    settling: Settling,
    load: L,
    emit: T,
    shown: BTreeMap<PathBuf, SinkFile>,
    /// True if the graph has mistakes that may be due to a partly written file.
    suspected: bool,
    /// True if the last run was successful.
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
                    (self.emit)(Event::Mistakes { list, text });
                    Next::Ended
                }
            };
            let next = match next {
                Next::Ended => {
                    (self.emit)(Event::Idle { files: self.files.count() });
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

    /// Runs a graph. If the run is forecast to take long, previews precede it.
    fn show(&mut self, current: &Load, graph: &Graph, only: &[usize]) -> Next {
        self.shown.retain(|_, file| graph.find(&file.id).is_some());
        let plan = self.engine.plan_next(graph, only, &self.options.out);
        let forecast = Forecast::of(&plan);
        if forecast.open > 0 {
            (self.emit)(Event::Plan(forecast));
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
        for Reduction { level, coarse } in levels(most, seconds, coarse) {
            let Some((rough, changed)) = graph.rough(parameter, level, coarse) else { continue };
            (self.emit)(Event::Pass { parameter: parameter.to_owned(), level, of: most, coarse });
            match self.pass(current, &rough, only, changed) {
                Next::Ended => {}
                other => return other,
            }
        }
        self.pass(current, graph, only, Vec::new())
    }

    /// Runs a graph once. Returns when the run has ended or a newer graph exists.
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
                let outcome = engine.run(graph, &options, |event| drop(ended.0.0.send(Input::Event(event))));
                if let Some(failures) = outcome.failures {
                    let (list, text) = (failures.mistakes(), failures.to_string());
                    drop(ended.0.0.send(Input::Event(Event::Mistakes { list, text })));
                }
            });
            let next = self.wait(current, true);
            if matches!(next, Next::Ended) {
                return next;
            }
            cancel.store(true, Ordering::Relaxed);
            if self.drain() { Next::Quit } else { next }
        })
    }

    /// Waits for the end of a cancelled run. Returns true if the watch is to quit. The remaining events are handled
    /// in either case, so that the list of files that do not show the current graph is correct.
    fn drain(&mut self) -> bool {
        let mut quit = false;
        while let Ok(input) = self.inputs.recv() {
            match input {
                // The node is about to run in the next run.
                Input::Event(Event::Node { state: State::Skipped, .. }) => {}
                Input::Event(event) => self.pass_on(event),
                Input::Changed(paths) => self.on_change(&paths),
                Input::Ended => break,
                Input::Quit => quit = true,
            }
        }
        quit
    }

    /// Waits until changes have settled, the run has ended, or the watch is to end.
    fn wait(&mut self, current: &Load, running: bool) -> Next {
        let pause = if self.files.has_notifier() { CHECK } else { POLL };
        let mut look = Instant::now() + pause;
        loop {
            let now = Instant::now();
            if self.settling.take(now)
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
                    self.files.suspect(changed);
                    self.settling.hint(now);
                }
            }
            let until = self.settling.due().map_or(look, |due| due.min(look));
            match self.inputs.recv_timeout(until.saturating_duration_since(now)) {
                Ok(Input::Changed(paths)) => self.on_change(&paths),
                Ok(Input::Event(event)) => self.pass_on(event),
                Ok(Input::Ended) => return Next::Ended,
                Ok(Input::Quit) | Err(RecvTimeoutError::Disconnected) => return Next::Quit,
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// True if a file that a successful run wrote has been deleted since.
    fn is_file_gone(&self) -> bool {
        let gone = |(path, file): (&PathBuf, &SinkFile)| file.shown == Shown::Right && !path.exists();
        self.good && self.shown.iter().any(gone)
    }

    fn on_change(&mut self, paths: &[PathBuf]) {
        if self.files.notified(paths) {
            self.suspected = false;
            self.settling.hint(Instant::now());
        }
    }

    /// Returns the graph to run if its meaning changed or its results are not up to date.
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
            self.suspected = false;
            (self.emit)(Event::Same);
            // Saving an unchanged graph retries what failed.
            let in_place = |(path, file): (&PathBuf, &SinkFile)| file.shown == Shown::Right && path.exists();
            let again = !running && load.graph.is_ok() && !(self.good && self.shown.iter().all(in_place));
            return again.then_some(load);
        }
        if load.graph.is_err() && !std::mem::replace(&mut self.suspected, true) {
            self.files.suspect(changed);
            self.settling.wait(Instant::now(), self.options.patience);
            return None;
        }
        self.suspected = false;
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
            if let Some(why) = self.files.take_failure() {
                let text = format!(
                    "the system does not report changes of files ({why}); files are checked every {} ms",
                    POLL.as_millis()
                );
                (self.emit)(Event::Warning { id: "watch-polls", text });
            }
            if !new {
                return load;
            }
        }
    }

    /// Forwards an event to the caller and updates the state of files.
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
        (self.emit)(event);
        if let Some(id) = stale {
            self.turn_stale(Some(&id));
        }
    }

    /// Marks the files of one sink, or all files, as stale.
    fn turn_stale(&mut self, id: Option<&str>) {
        for (path, file) in &mut self.shown {
            if file.shown != Shown::Stale && id.is_none_or(|id| file.id == id) {
                file.shown = Shown::Stale;
                (self.emit)(Event::Stale { path: path.clone() });
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

#[cfg(test)]
mod tests {
    use cache::Store;

    use super::*;

    #[test]
    fn what_a_run_reports_after_quit_still_counts() {
        let watch = Watch::new(WatchOptions { poll: true, ..WatchOptions::default() });
        let sender = watch.handle().0;
        let Watch { options, inputs, handle, files } = watch;
        let load = |_| Load { graph: Err(Refusal::other(String::new())), texts: Vec::new() };
        let mut session = Session {
            engine: &Engine::new(Store::in_memory(), 1, 1 << 20),
            settling: Settling::new(options.settle, LONGEST),
            options,
            inputs,
            handle,
            files,
            load,
            emit: |_| {},
            shown: BTreeMap::new(),
            suspected: false,
            good: false,
        };
        let (path, written) = (PathBuf::from("out/a.png"), true);
        sender.send(Input::Quit).expect("works");
        let event = Event::File { id: "save".to_owned(), path: path.clone(), written, preview: false };
        sender.send(Input::Event(event)).expect("works");
        sender.send(Input::Ended).expect("works");
        assert!(session.drain(), "it quits");
        assert!(session.shown.get(&path).is_some_and(|file| file.shown == Shown::Right));
        assert!(session.inputs.try_recv().is_err(), "nothing is left unread");
    }
}
