//! Writing the files of sinks.

use crate::graph::node::Wire;
use crate::graph::reads::{OTHER_FILE, ReadFiles, over_text};
use crate::run::event::Event;
use crate::run::message::{Message, Owed, Placed};
use crate::run::scheduler::Run;
use crate::run::sink;
use crate::run::slot::{Life, Waiter};
use crate::value::error::{NodeError, guarded};

impl Run<'_> {
    /// Compares the files of a sink with the existing files, and writes those that differ.
    pub fn place_files(&mut self, index: usize) {
        let (graph, engine) = (self.graph, self.engine);
        let node = &graph.nodes[index];
        let (Some(record), Some(template)) = (&self.slots[index].record, &node.sink_path) else { return };
        let targets = match sink::targets(&self.options.out, template, &record.files) {
            Ok(targets) => targets,
            Err(error) => return self.fail(index, &error),
        };
        for (path, _) in &targets {
            let Some([first, second]) = self.claims.claim(path, index) else { continue };
            let message = format!("`{}` also writes to {}", graph.nodes[first].id, path.display());
            self.fail(second, &NodeError::new(message).at("path").hint("give each sink its own path"));
            if second == index {
                return;
            }
        }
        let confined = graph.root.is_confined().then_some(self.options.out.as_path());
        if let Some(placed) = sink::in_place(&engine.store, &targets, confined) {
            return self.placed(index, Ok(Some(placed)));
        }
        // Computed only if something may be written, since it inspects every file.
        let texts = &self.options.texts;
        let read = self.claims.read(|| ReadFiles::new(texts.iter().cloned().chain(graph.files())));
        if let Some((path, _)) = targets.iter().find(|(path, _)| read.has(path)) {
            return self.fail(index, &NodeError::new(over_text(path)).at("path").hint(OTHER_FILE));
        }
        let (sender, value) = (self.sender.clone(), self.slots[index].value(0).cloned());
        let tracer = self.tracer.clone();
        self.send(index, move || {
            let owed = Owed::new(&sender, |error| Message::Placed { node: index, placed: Err(error) });
            let place = || guarded(|| sink::place(&engine.store, targets, value.as_ref(), confined));
            let placed = tracer.span(&node.id, "files", place);
            owed.send(Message::Placed { node: index, placed });
        });
    }

    /// Handles the outcome of writing the files of a sink.
    pub fn placed(&mut self, index: usize, placed: Result<Option<Placed>, NodeError>) {
        if self.slots[index].life != Life::Placing {
            return;
        }
        match placed {
            Ok(Some(files)) => {
                for (path, written) in files {
                    self.unchanged &= !written;
                    let (id, preview) = (self.graph.nodes[index].id.clone(), self.slots[index].rough);
                    (self.emit)(Event::File { id, path, written, preview });
                }
                let slot = &mut self.slots[index];
                slot.readers -= 1;
                let effort = std::mem::take(&mut slot.effort);
                self.done(index, effort);
            }
            Ok(None) => self.request(Wire { node: index, port: 0 }, Waiter::Files(index)),
            Err(error) => self.fail(index, &error),
        }
    }
}
