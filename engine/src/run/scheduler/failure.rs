//! Nodes that fail, are skipped, or lose their values.

use crate::run::event::{Event, State};
use crate::run::scheduler::{Run, Task};
use crate::run::slot::{Life, Waiter};
use crate::text::diag::{Code, Diagnostic};
use crate::value::counts::Counts;
use crate::value::error::NodeError;

impl Run<'_> {
    /// Marks a node as failed. All nodes downstream of it are skipped; everything else continues.
    pub fn fail(&mut self, index: usize, error: &NodeError) {
        if error.is_cancelled() {
            return self.skip(index);
        }
        self.report(index, error);
        for follower in self.take_followers(index) {
            self.report(follower, error);
            self.give_up(follower, Life::Failed);
        }
        self.give_up(index, Life::Failed);
    }

    /// Skips a node. The nodes that wait for it because they have the same key are tried instead, since their
    /// inputs may be in memory.
    pub fn skip(&mut self, index: usize) {
        for follower in self.take_followers(index) {
            self.slots[follower].life = Life::Waiting;
            self.todo.push_back(Task::Resolve(follower));
        }
        self.report_skipped(index);
        self.give_up(index, Life::Skipped);
    }

    /// Removes a node and all unresolved nodes downstream of it from the run.
    fn give_up(&mut self, index: usize, life: Life) {
        let graph = self.graph;
        self.leave(index, life);
        let mut doomed: Vec<usize> = graph.consumers(index).to_vec();
        while let Some(node) = doomed.pop() {
            if self.slots[node].life == Life::Waiting {
                self.report_skipped(node);
                self.leave(node, Life::Skipped);
                doomed.extend(graph.consumers(node));
            }
        }
    }

    fn leave(&mut self, index: usize, life: Life) {
        let settled = self.slots[index].record.is_some();
        let slot = &mut self.slots[index];
        self.queue.leave(index, slot);
        self.away.leave(self.queue.place(index), slot);
        // Its files will not be written.
        let is_sink = self.graph.nodes[index].sink_path.is_some();
        slot.readers -= usize::from(is_sink && slot.life != Life::Done);
        slot.life = life;
        if settled {
            self.memory.drop_unread(&mut self.slots[index]);
        } else {
            self.release_inputs(index);
        }
    }

    /// Reports a failed node. If it was reported as done before, the totals are corrected.
    pub fn report(&mut self, index: usize, error: &NodeError) {
        let node = &self.graph.nodes[index];
        let message = format!("`{}` failed: {error}", node.id);
        let mut diagnostic = Diagnostic::of(Code::Failed, self.graph.place(index, error.field), message);
        diagnostic.hints.extend(error.hint.clone());
        self.failures.push(diagnostic);
        let slot = &self.slots[index];
        if let (Life::Done, Some(state)) = (slot.life, slot.end) {
            self.totals.take_back(state);
            self.totals.degraded -= usize::from(slot.degraded);
        }
        self.totals.add(State::Failed);
        (self.emit)(Event::Node {
            id: node.id.clone(),
            kind: node.kind.name,
            state: State::Failed,
            key: slot.key,
            seconds: 0.0,
            cpu_seconds: 0.0,
            counts: Counts::new(),
            notes: Vec::new(),
            degraded: false,
            error: Some(error.to_string()),
        });
    }

    pub fn report_skipped(&mut self, index: usize) {
        let node = &self.graph.nodes[index];
        self.totals.add(State::Skipped);
        (self.emit)(Event::Node {
            id: node.id.clone(),
            kind: node.kind.name,
            state: State::Skipped,
            key: None,
            seconds: 0.0,
            cpu_seconds: 0.0,
            counts: Counts::new(),
            notes: Vec::new(),
            degraded: false,
            error: None,
        });
    }

    /// Gives up the values of a node and skips everything that waits for them. Downstream nodes whose outputs are
    /// known by digest keep their results.
    pub fn lose(&mut self, index: usize, error: Option<&NodeError>) {
        let mut error = error.filter(|error| !error.is_cancelled());
        let mut lost = vec![index];
        while let Some(node) = lost.pop() {
            self.end_remake(node);
            self.slots[node].lost = true;
            let waiters = std::mem::take(&mut self.slots[node].waiters);
            match (self.slots[node].life, error.take()) {
                (Life::Placing, Some(error)) => self.fail(node, error),
                (Life::Placing, None) => self.skip(node),
                (_, Some(error)) => {
                    self.report(node, error);
                    self.slots[node].life = Life::Failed;
                }
                _ => {}
            }
            for (_, waiter) in waiters {
                let Waiter::Code(reader) = waiter else { continue };
                if self.slots[reader].remaking.is_some() {
                    lost.push(reader);
                } else if matches!(self.slots[reader].life, Life::Gathering | Life::Collecting) {
                    self.skip(reader);
                }
            }
            self.memory.drop_unread(&mut self.slots[node]);
        }
    }

    /// Handles the failure of a node that runs or is about to run. The node is marked as failed. If it runs again
    /// only because its values are needed, the values are given up instead.
    pub fn fail_or_lose(&mut self, index: usize, error: &NodeError) {
        if self.slots[index].remaking.is_some() {
            self.lose(index, Some(error));
        } else {
            self.fail(index, error);
        }
    }

    /// Removes and returns the nodes that wait for this node because they have the same key.
    pub fn take_followers(&mut self, index: usize) -> Vec<usize> {
        let slot = &self.slots[index];
        let key = slot.key.filter(|_| slot.leads());
        key.map(|key| self.known.end(&key)).unwrap_or_default()
    }
}
