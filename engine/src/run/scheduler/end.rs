//! The end of a run: its outcome, and what is kept for later runs.

use std::cell::LazyCell;
use std::collections::BTreeSet;

use crate::run::event::{Event, Totals};
use crate::run::options::Outcome;
use crate::run::scheduler::Run;
use crate::run::slot::{Life, Slot};
use crate::run::unchanged;
use crate::text::diag::Diagnostics;
use crate::value::cpu;
use crate::value::error::NodeError;

/// The history of a graph is trimmed only if it contains more nodes than this.
const MIN_HISTORY: usize = 1024;

impl Run<'_> {
    /// The warning about stored values that were missing. All of them are reported in one warning, since they have
    /// a common cause.
    fn gone_text(&self) -> Option<String> {
        const NAMED: usize = 3;
        if self.gone.is_empty() {
            return None;
        }
        if let (Some(&node), 1) = (self.gone.first(), self.gone.len()) {
            let id = &self.graph.nodes[node].id;
            return Some(format!(
                "`{id}`: its stored value was missing from the cache and was computed again"
            ));
        }
        let names = self.gone.iter().take(NAMED).map(|&node| format!("`{}`", self.graph.nodes[node].id));
        let names = names.collect::<Vec<_>>().join(", ");
        let more = match self.gone.len().saturating_sub(NAMED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        Some(format!("stored values of {names}{more} were missing from the cache and were computed again"))
    }

    /// Ends the run. Returns its outcome and the end state of each node.
    pub fn finish(mut self) -> (Outcome, Vec<Slot>) {
        for index in 0..self.slots.len() {
            let slot = &self.slots[index];
            let over = matches!(slot.life, Life::Unwanted | Life::Done | Life::Failed | Life::Skipped);
            if !over && slot.remaking != Some(Life::Done) {
                self.slots[index].life = Life::Skipped;
                self.report_skipped(index);
            }
        }
        self.remark();
        let store = &self.engine.store;
        // Removes names of nodes that the graph no longer has, such as instances at former axis values.
        let most = MIN_HISTORY.max(2 * self.graph.nodes.len());
        let names =
            LazyCell::new(|| self.graph.nodes.iter().map(|node| node.id.as_str()).collect::<BTreeSet<_>>());
        store.history_trim(self.known.history(), most, |name| names.contains(name));
        let mut quiet = self.unchanged;
        if let Err(error) = store.flush() {
            let text = NodeError::from(error).to_string();
            (self.emit)(Event::Warning { id: "cache-write", text });
            quiet = false;
        }
        for incident in store.take_incidents() {
            (self.emit)(Event::Warning { id: "cache-damage", text: incident.to_string() });
            quiet = false;
        }
        if let Some(text) = self.gone_text() {
            (self.emit)(Event::Warning { id: "cache-damage", text });
        }
        self.totals.peak_bytes = self.memory.peak();
        self.totals.stopped = self.stopped();
        if quiet && self.all_is_known() {
            unchanged::keep(store, self.graph, &self.options.out, &self.slots);
        }
        self.totals.seconds = self.start.elapsed().as_secs_f64();
        self.totals.cpu_seconds = (cpu::of_process() - self.start_cpu).as_secs_f64();
        (self.emit)(Event::Done(self.totals.clone()));
        let failures = (!self.failures.is_empty())
            .then(|| Diagnostics::new(self.graph.source.clone(), std::mem::take(&mut self.failures)));
        (Outcome { totals: self.totals, failures }, self.slots)
    }

    /// True if all sinks were up to date and no work was done.
    fn all_is_known(&self) -> bool {
        let Totals { ran: 0, remade: 0, failed: 0, skipped: 0, stopped: false, .. } = self.totals else {
            return false;
        };
        let asked = self.options.only.is_empty() && self.options.rough.is_empty();
        asked && self.graph.nodes.iter().any(|node| node.sink_path.is_some())
    }
}
