//! The start of a run, either with all needed nodes or only with those that changed since the previous run.

use std::sync::atomic::Ordering;
use std::sync::mpsc::{Sender, channel};
use std::time::Instant;

use crate::graph::graph::Graph;
use crate::record::action::history_of;
use crate::run::away::Away;
use crate::run::claims::Claims;
use crate::run::engine::Engine;
use crate::run::event::{Event, State, Totals};
use crate::run::known::Known;
use crate::run::memory::Memory;
use crate::run::message::Message;
use crate::run::options::{Outcome, RunOptions};
use crate::run::previous::{Cone, PreviousRun};
use crate::run::queue::Queue;
use crate::run::scheduler::{Run, Task};
use crate::run::slot::{Life, Slot};
use crate::run::trace::Tracer;
use crate::value::cpu;

impl<'a> Run<'a> {
    /// Creates a run that has not started.
    pub fn new(
        engine: &'a Engine,
        graph: &'a Graph,
        options: &'a RunOptions,
        sender: Sender<Message>,
        emit: &'a mut dyn FnMut(Event),
    ) -> Self {
        let (start, start_cpu) = (Instant::now(), cpu::of_process());
        let tracer = Tracer::new(start, options.trace.then(|| sender.clone()));
        let wanted = graph.wanted(&options.only);
        let mut rank = vec![0; graph.nodes.len()];
        for (position, &node) in graph.order().iter().enumerate() {
            rank[node] = position;
        }
        let previous = engine.warm.as_ref().and_then(|warm| warm.previous().take());
        let cone = previous
            .as_ref()
            .and_then(|previous| previous.cone(graph, &options.only, &wanted, &options.out, &engine.store));
        let whole = cone.is_none();
        let all = || Cone { of: vec![true; graph.nodes.len()], kept: Vec::new() };
        let Cone { of: cone, kept } = cone.unwrap_or_else(all);
        let slot = |node: usize| {
            let life = if wanted[node] { Life::Waiting } else { Life::Unwanted };
            Slot::new(life, graph.reads(node).iter().filter(|&&above| cone[above]).count())
        };
        let mut totals = Totals::default();
        let mut slots = match previous.filter(|_| !whole) {
            None => (0..graph.nodes.len()).map(slot).collect(),
            Some(PreviousRun { mut slots, .. }) => {
                for (index, known) in slots.iter_mut().enumerate() {
                    if cone[index] {
                        *known = slot(index);
                    } else {
                        totals.add(State::Cached);
                        totals.degraded += usize::from(known.degraded);
                    }
                }
                slots
            }
        };
        for (node, path) in kept {
            emit(Event::File { id: graph.nodes[node].id.clone(), path, written: false, preview: false });
        }
        let open = |index: usize| wanted[index] && cone[index];
        for (index, node) in graph.nodes.iter().enumerate().filter(|(index, _)| open(*index)) {
            slots[index].readers += usize::from(node.sink_path.is_some());
            for &above in graph.reads(index) {
                slots[above].readers += 1;
            }
        }
        for &node in &options.rough {
            slots[node].rough = true;
        }
        let ready = graph.order().iter().filter(|&&node| open(node) && slots[node].unresolved == 0);
        let todo = ready.map(|&node| Task::Resolve(node)).collect();
        let history = history_of(graph);
        Self {
            engine,
            graph,
            options,
            sender,
            emit,
            slots,
            todo,
            unstarted: Vec::new(),
            queue: Queue::new(engine.limits().jobs, rank),
            away: Away::default(),
            memory: Memory::new(engine.limits().memory),
            known: Known::new(history),
            scratch: Vec::new(),
            claims: Claims::default(),
            unchanged: whole,
            owed: 0,
            store_failed: false,
            gone: std::collections::BTreeSet::new(),
            failures: Vec::new(),
            totals,
            tracer,
            start,
            start_cpu,
        }
    }
}

impl Engine {
    /// Runs a graph. Events are sent to `emit` on the calling thread, in order.
    pub fn run(&self, graph: &Graph, options: &RunOptions, mut emit: impl FnMut(Event)) -> Outcome {
        let cancelled = || options.cancel.load(Ordering::Relaxed);
        let _running = self.store.begin_run(&history_of(graph), &cancelled);
        let (sender, receiver) = channel();
        let mut run = Run::new(self, graph, options, sender, &mut emit);
        run.run(&receiver);
        let (outcome, slots) = run.finish();
        if let Some(warm) = &self.warm {
            *warm.previous() = PreviousRun::of(graph, &options.only, slots);
        }
        outcome
    }
}
