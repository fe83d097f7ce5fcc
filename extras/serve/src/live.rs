//! The data that the watch and the handlers of requests share.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use engine::{Digest, Engine, Event, Graph, Handle, Load, StoredOutput, Wire};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::broadcast;

use crate::difference::{Difference, Place};
use crate::door::Door;
use crate::editor::{Edit, Edited, Editor, OTHER, Refused, SharedGraph, digest_of, fixed};
use crate::graphs::Graphs;
use crate::history::{Shot, now};
use crate::references::References;
use crate::starter::{AXES, Stand, Starter};
use crate::state::State;
use crate::thing::Thing;
use crate::values::{Decoded, Shown};

/// Maximum number of messages that a client may lag behind. A slower client gets the whole state instead.
const BEHIND: usize = 256;

/// A request to put an object into a captured place.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// Digest of the text that the client has seen.
    digest: String,
    /// Name of the object, as [`Starter::objects`] gives it.
    object: String,
    stand: Stand,
}

/// A request to rotate a captured place.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Upright {
    /// Digest of the text that the client has seen.
    digest: String,
    /// The axis of the capture that shall point up, one of [`AXES`].
    up: String,
}

/// A message to the pages.
#[derive(Debug)]
pub struct Message {
    /// Number of the message. A message with the whole state has the number of the last message whose content it
    /// includes.
    pub number: u64,
    /// Content of the message, as JSON.
    pub data: String,
}

/// The data that the watch and the handlers of requests share.
pub struct Live {
    pub engine: Arc<Engine>,
    pub door: Door,
    pub decoded: Decoded<Shown>,
    /// Values with a position in space.
    pub things: Decoded<Thing>,
    /// Differences between pictures.
    pub differences: Decoded<Difference>,
    /// Picture files that outputs can be compared with.
    pub references: References,
    /// Other graphs whose pictures outputs can be compared with.
    pub graphs: Graphs,
    /// Number of connected pages.
    pub clients: AtomicUsize,
    /// The writer of a first graph, for a bare capture.
    pub starter: Option<Box<dyn Starter>>,
    handle: Handle,
    /// Path of the graph file, without links.
    path: PathBuf,
    state: Mutex<State>,
    editor: Mutex<Editor>,
    /// Trial values, which are not written to the file, by node and field.
    tried: Mutex<BTreeMap<(String, String), String>>,
    /// The fields with trial values when the watch began to read the graph, followed by those in the graph that the
    /// page shows. A trial may have ended since then.
    applied: Mutex<[BTreeSet<(String, String)>; 2]>,
    number: AtomicU64,
    sender: broadcast::Sender<Arc<Message>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Live {
    /// The data for a page that shows the graph file `path`.
    pub fn new(
        engine: Arc<Engine>,
        handle: Handle,
        path: PathBuf,
        door: Door,
        editor: Editor,
        starter: Option<Box<dyn Starter>>,
    ) -> Self {
        Self {
            engine,
            door,
            decoded: Decoded::default(),
            things: Decoded::default(),
            differences: Decoded::default(),
            references: References::default(),
            graphs: Graphs::default(),
            clients: AtomicUsize::new(0),
            starter,
            handle,
            path,
            state: Mutex::default(),
            editor: Mutex::new(editor),
            tried: Mutex::default(),
            applied: Mutex::default(),
            number: AtomicU64::new(0),
            sender: broadcast::Sender::new(BEHIND),
        }
    }

    /// Sends a message to all pages. The caller must hold the lock of the state, so that messages are in order.
    fn send(&self, data: &Value) {
        let number = self.number.fetch_add(1, Ordering::Relaxed) + 1;
        // Without pages, nobody receives it.
        let _ = self.sender.send(Arc::new(Message { number, data: data.to_string() }));
    }

    /// The whole state as a message, and the messages after it.
    pub fn subscribe(&self) -> (Message, broadcast::Receiver<Arc<Message>>) {
        let receiver = self.sender.subscribe();
        (self.snapshot(), receiver)
    }

    /// The whole state as a message.
    pub fn snapshot(&self) -> Message {
        let history = self.history();
        let state = lock(&self.state);
        let mut json = state.json();
        json["event"] = "state".into();
        json["history"] = history;
        Message { number: self.number.load(Ordering::Relaxed), data: json.to_string() }
    }

    /// The history as JSON.
    pub fn history(&self) -> Value {
        let mut editor = lock(&self.editor);
        let history = editor.history();
        let (undo, redo) = history.depth();
        json!({
            "undo": undo,
            "redo": redo,
            "last": history.last().map(|change| &change.label),
            "next": history.next().map(|change| &change.label),
            "problem": history.problem(),
            "shots": history.shots(),
            "tried": lock(&self.tried).iter().map(|((node, field), value)| json!([node, field, value])).collect::<Value>(),
        })
    }

    fn send_history(&self) {
        let history = self.history();
        let _state = lock(&self.state);
        self.send(&json!({"event": "history", "history": history}));
    }

    /// Calls `read` with the state, and returns its result.
    pub fn with_state<T>(&self, read: impl FnOnce(&State) -> T) -> T {
        read(&lock(&self.state))
    }

    /// Receives a graph that the watch has read.
    pub fn loaded(&self, load: &Load) {
        let text = {
            // With the lock, since a text that was read before an edit of the page would count as a later change.
            let mut editor = lock(&self.editor);
            let text = editor.text();
            if let (Ok(_), Ok(text)) = (&load.graph, &text) {
                editor.history().saved(text, OTHER);
            }
            text
        };
        {
            let [read, shown] = &mut *lock(&self.applied);
            shown.clone_from(read);
        }
        // A file that cannot be read has no text; the refusal says why.
        let text = text.unwrap_or_default();
        {
            let mut state = lock(&self.state);
            state.digest = digest_of(&text);
            state.text = text;
            match &load.graph {
                Ok((graph, only)) => {
                    (state.mistakes, state.problem) = (Vec::new(), None);
                    (state.graph, state.only) = (Some(graph.clone()), only.clone());
                    state.retain(graph);
                }
                Err(refusal) => {
                    state.mistakes.clone_from(&refusal.list);
                    state.problem = refusal.list.is_empty().then(|| crate::state::plain(&refusal.text));
                }
            }
            self.send(&json!({
                "event": "graph", "digest": state.digest, "mistakes": state.mistakes, "problem": state.problem,
            }));
        }
        self.send_history();
    }

    /// Receives an event of the watch.
    pub fn show(&self, event: &Event) {
        let mut state = lock(&self.state);
        let graph = state.graph.clone();
        let outputs = |id: &str, key: &Digest| self.outputs(graph.as_deref(), id, key);
        // After the end of a run, everything is in the store.
        let is_end = matches!(event, Event::Done(_));
        if is_end || state.is_pending() {
            for event in state.settle(outputs) {
                self.send(&event);
            }
        }
        let is_result = matches!(event, Event::Done(totals) if !totals.stopped) && !state.is_preview();
        if let Some(json) = state.update(event, outputs) {
            self.send(&json);
        }
        if is_result && lock(&self.tried).is_empty() {
            let (values, text) = (state.shown(), state.digest.clone());
            drop(state);
            self.shot(values, text);
        }
    }

    fn outputs(&self, graph: Option<&Graph>, id: &str, key: &Digest) -> Option<Vec<StoredOutput>> {
        let graph = graph?;
        self.engine.outputs(&graph.nodes[graph.find(id)?], key)
    }

    /// Adds the results of a run to the history.
    fn shot(&self, values: BTreeMap<String, (String, String)>, text: String) {
        let new = {
            let mut editor = lock(&self.editor);
            let history = editor.history();
            let label = history.last().map_or_else(|| "start".to_owned(), |change| change.label.clone());
            history.shot(Shot { text, label, seconds: now(), values })
        };
        if new {
            self.send_history();
        }
    }

    /// The graph that the page shows.
    pub fn graph(&self) -> Result<SharedGraph, Refused> {
        let graph = lock(&self.state).graph.clone();
        graph.ok_or_else(|| Refused::Fixed {
            why: "the graph has mistakes; correct them in the text".to_owned(),
        })
    }

    /// The graph of the text, without trial values. `graph` is the graph that the page shows.
    pub fn own_graph(&self, graph: &Graph) -> Result<Graph, Refused> {
        lock(&self.editor).own_graph(graph)
    }

    /// Applies an edit to the file.
    pub fn set(&self, edit: &Edit) -> Result<Value, Refused> {
        let (graph, tried) = (self.graph()?, self.tried_of(&edit.node));
        self.write(|editor| editor.set(&graph, edit, &tried))
    }

    /// Replaces the text with a graph in which an object stands in the captured place.
    pub fn start(&self, start: &Start) -> Result<Value, Refused> {
        let graph = self.graph()?;
        let starter = self.starter()?;
        // Only names that were offered, so that a request cannot name a path.
        if !starter.objects().contains(&start.object) {
            return Err(fixed("this object is not among the files that were found".to_owned()));
        }
        let now = self.own_graph(&graph)?;
        let text = starter.graph(&now, &start.object, &start.stand).map_err(fixed)?;
        let label = format!("{} put into the place", start.object);
        self.write(|editor| editor.replace(&graph, &start.digest, &text, &label))
    }

    /// Replaces the text with a graph in which another axis of the capture points up.
    pub fn upright(&self, upright: &Upright) -> Result<Value, Refused> {
        let graph = self.graph()?;
        let starter = self.starter()?;
        if !AXES.contains(&upright.up.as_str()) {
            return Err(fixed(format!("`up` must be one of {}", AXES.join(", "))));
        }
        let now = self.own_graph(&graph)?;
        if now.nodes.iter().any(|node| node.kind.outputs.iter().any(|port| port.artifact.name == "placed")) {
            let why = "the graph has an object already; undo that first, or edit `up` in the text";
            return Err(fixed(why.to_owned()));
        }
        let text = starter.turned(&now, &upright.up).map_err(fixed)?;
        let label = format!("{} of the capture points up", upright.up);
        self.write(|editor| editor.replace(&graph, &upright.digest, &text, &label))
    }

    fn starter(&self) -> Result<&dyn Starter, Refused> {
        let none = || fixed("this graph was not started from a bare capture".to_owned());
        self.starter.as_deref().ok_or_else(none)
    }

    /// Undoes the last change (`undo`), or repeats the change that was undone last.
    pub fn step(&self, digest: &str, undo: bool) -> Result<Value, Refused> {
        let graph = self.graph()?;
        self.write(|editor| if undo { editor.undo(&graph, digest) } else { editor.redo(&graph, digest) })
    }

    /// Writes the file, and makes the watch read it. Returns the digest of the new text.
    pub fn write(&self, write: impl FnOnce(&mut Editor) -> Result<(), Refused>) -> Result<Value, Refused> {
        let digest = {
            let mut editor = lock(&self.editor);
            write(&mut editor)?;
            lock(&self.tried).clear();
            digest_of(editor.history().text())
        };
        self.look();
        self.send_history();
        Ok(json!({"digest": digest}))
    }

    /// Sets a trial value, which is not written to the file. Runs use it until [`end_try`](Self::end_try) is called
    /// or an edit is made.
    pub fn try_value(&self, edit: &Edit) -> Result<Value, Refused> {
        let (graph, tried) = (self.graph()?, self.tried_of(&edit.node));
        // Held until the value is set: an edit drops the trials of the text before it, and none may come after.
        let editor = lock(&self.editor);
        let Edited { whole, .. } = editor.edited(&graph, edit, &tried)?;
        let missing = || Refused::Fixed { why: "the request does not contain a value to try".to_owned() };
        let whole = whole.into_iter().map(|(field, value)| Some(((edit.node.clone(), field), value?)));
        let whole: Vec<_> = whole.collect::<Option<_>>().ok_or_else(missing)?;
        lock(&self.tried).extend(whole);
        drop(editor);
        self.look();
        Ok(json!({"tried": true}))
    }

    /// Sets trial values, each given as node, field and value in RON, in place of those before. See
    /// [`try_value`](Self::try_value).
    pub fn try_all(&self, fields: Vec<(String, String, String)>) -> Value {
        let fields = fields.into_iter().map(|(node, field, value)| ((node, field), value));
        *lock(&self.tried) = fields.collect();
        self.look();
        json!({"tried": true})
    }

    /// The fields of a node that have trial values, now or in the graph that the page shows. Edits of such a field are
    /// not checked for overlays on the command line, since this was done when the trial began.
    fn tried_of(&self, node: &str) -> Vec<String> {
        let of = |known: &&(String, String)| known.0 == node;
        let now: Vec<String> = lock(&self.tried).keys().filter(of).map(|(_, field)| field.clone()).collect();
        let [_, shown] = &*lock(&self.applied);
        now.into_iter().chain(shown.iter().filter(of).map(|(_, field)| field.clone())).collect()
    }

    /// Drops the trial values.
    pub fn end_try(&self) -> Value {
        let tried = std::mem::take(&mut *lock(&self.tried));
        if !tried.is_empty() {
            self.look();
        }
        json!({"tried": false})
    }

    /// The trial values, in the form of `--set` options. The watch asks for them when it reads the graph, and then
    /// calls [`loaded`](Self::loaded).
    pub fn tried(&self) -> Vec<String> {
        let tried = lock(&self.tried);
        lock(&self.applied)[0] = tried.keys().cloned().collect();
        tried.iter().map(|((node, field), value)| format!("{node}.{field}={value}")).collect()
    }

    /// The nodes that would run after an edit, and the forecast of their time.
    pub fn plan(&self, edit: &Edit) -> Result<Value, Refused> {
        let (graph, tried) = (self.graph()?, self.tried_of(&edit.node));
        let Edited { graph: edited, .. } = lock(&self.editor).edited(&graph, edit, &tried)?;
        let only = self.with_state(|state| state.only.clone());
        let ids: BTreeSet<&str> = only.iter().map(|&index| graph.nodes[index].id.as_str()).collect();
        let only: Vec<usize> =
            (0..edited.nodes.len()).filter(|&index| ids.contains(edited.nodes[index].id.as_str())).collect();
        let plan = self.engine.plan(&edited, &only);
        let opens = |fate: &engine::Fate| !matches!(fate, engine::Fate::Known | engine::Fate::Unwanted);
        let nodes: Vec<&str> =
            plan.iter().filter(|node| opens(&node.fate)).map(|node| node.id.as_str()).collect();
        Ok(json!({"nodes": nodes, "forecast": engine::Forecast::of(&plan)}))
    }

    /// Path of the graph file, without links.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Folder of the graph.
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new("."))
    }

    /// The difference between picture `a` and the reference `b`. `None` if one of them is gone.
    ///
    /// # Errors
    /// A text for the user if the pictures cannot be compared.
    pub fn difference(&self, a: &Place, b: &Place) -> Option<Result<Arc<Difference>, String>> {
        let picture = self.value(&a.0)?;
        let reference = self.value(&b.0)?;
        let (picture, reference) = (picture.pictures.get(a.1)?, reference.pictures.get(b.1)?);
        let name = Digest::of(format!("{}/{}/{}/{}", a.0, a.1, b.0, b.1).as_bytes());
        let mut why = None;
        let found = self.differences.get(&name, || {
            Difference::of(&picture.picture, &reference.picture).map_err(|error| why = Some(error)).ok()
        });
        Some(found.ok_or_else(|| why.unwrap_or_default()))
    }

    /// Makes the watch read the graph again.
    fn look(&self) {
        self.handle.hint(vec![self.path.clone()]);
    }

    /// The output that has a value now, and its type.
    fn current(&self, digest: &str) -> Option<(SharedGraph, Wire, &'static str)> {
        self.with_state(|state| {
            let (id, port, type_name) = state.find(digest)?;
            let graph = state.graph.clone()?;
            let node = graph.find(&id)?;
            Some((graph, Wire { node, port }, type_name))
        })
    }

    /// The value with a position in space that has this digest, if an output has it now.
    pub fn thing(&self, digest: &str) -> Option<Arc<Thing>> {
        let (graph, wire, _) = self.current(digest)?;
        self.thing_of(&graph, wire, digest)
    }

    /// The value of an output, whose digest is known.
    pub fn thing_of(&self, graph: &Graph, wire: Wire, digest: &str) -> Option<Arc<Thing>> {
        let parsed = Digest::from_hex(digest)?;
        let type_name = graph.nodes[wire.node].kind.outputs[wire.port].artifact.name;
        self.things.get(&parsed, || Thing::read(&self.engine, type_name, &parsed, Some((graph, wire))))
    }

    /// The value with a digest, if the graph has it now, had it before, or had it in a recorded run. Values of
    /// other graphs in the same cache are not given.
    pub fn value(&self, digest: &str) -> Option<Arc<Shown>> {
        let parsed = Digest::from_hex(digest)?;
        if self.references.contains(&parsed) {
            return self.decoded.get(&parsed, || self.references.read(&parsed));
        }
        if let Some(other) = self.graphs.find(&parsed) {
            return self.decoded.get(&parsed, || other.read(&self.engine));
        }
        let current = self.current(digest);
        let wire = current.as_ref().map(|(graph, wire, _)| (&**graph, *wire));
        let type_name = match &current {
            Some((_, _, type_name)) => (*type_name).to_owned(),
            None => match self.with_state(|state| state.recent(digest)) {
                Some(type_name) => type_name.to_owned(),
                None => {
                    let mut editor = lock(&self.editor);
                    let shots = editor.history().shots().iter().rev();
                    let mut values = shots.flat_map(|shot| shot.values.values());
                    values.find(|(_, known)| known == digest)?.0.clone()
                }
            },
        };
        self.decoded.get(&parsed, || Shown::read(&self.engine, &type_name, &parsed, wire))
    }
}
