//! Traces of runs in the Trace Event Format, which `chrome://tracing` and Perfetto read.

use std::collections::BTreeMap;

use engine::{Event, State};
use serde_json::{Value, json};

/// Collects the work of the threads of a run.
#[derive(Default)]
pub struct Trace {
    spans: Vec<Value>,
    /// Kind and counts of each finished node.
    nodes: BTreeMap<String, Value>,
    threads: usize,
}

impl Trace {
    /// Adds an event to the trace, if it is of a type that traces contain.
    pub fn add(&mut self, event: &Event) {
        match event {
            Event::Span { id, what, thread, start, seconds } => {
                let name = if what == "code" { id.clone() } else { format!("{id} {what}") };
                self.threads = self.threads.max(thread + 1);
                self.spans.push(json!({
                    "name": name, "cat": what, "ph": "X", "pid": 1, "tid": thread,
                    "ts": (start * 1e6).round(), "dur": (seconds * 1e6).round(), "args": { "node": id },
                }));
            }
            Event::Node { id, kind, state: State::Ran, counts, .. } => {
                self.nodes.insert(id.clone(), json!({ "node": id, "kind": kind, "counts": counts }));
            }
            _ => {}
        }
    }

    /// The content of the trace file.
    pub fn finish(mut self) -> Vec<u8> {
        for span in &mut self.spans {
            let node = span["args"]["node"].as_str().and_then(|id| self.nodes.get(id));
            if let (Some(node), "code") = (node, span["cat"].as_str().unwrap_or_default()) {
                span["args"] = node.clone();
            }
        }
        let named = |thread| {
            let name = format!("thread {thread}");
            json!({ "name": "thread_name", "ph": "M", "pid": 1, "tid": thread, "args": { "name": name } })
        };
        let mut events: Vec<Value> = (0..self.threads).map(named).collect();
        events.append(&mut self.spans);
        json!({ "displayTimeUnit": "ms", "traceEvents": events }).to_string().into_bytes()
    }
}
