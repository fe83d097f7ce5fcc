//! Reduced versions of a graph for previews.

use std::sync::Arc;

use crate::graph::graph::Graph;

impl Graph {
    /// The graph reduced for a preview. Nodes that have `parameter` use at most `level` for it and, if their kind
    /// supports it, compute one pixel per block of `coarse` by `coarse` pixels. The nodes downstream of them use
    /// the preview values of their kinds. Also returns the indices of the nodes that changed. Returns `None` if no
    /// node changed.
    pub fn rough(&self, parameter: &str, level: u64, coarse: u64) -> Option<(Self, Vec<usize>)> {
        let mut graph = self.clone();
        let (mut below, mut changed) = (vec![false; self.nodes.len()], Vec::new());
        for &index in self.order() {
            let kind = &self.nodes[index].kind;
            let mut settings = Vec::new();
            if let Some(n) = self.number(index, parameter) {
                let coarsens =
                    kind.preview.coarse.filter(|name| self.number(index, name).is_some_and(|n| n < coarse));
                settings.extend((n > level).then(|| (parameter, level.to_string())));
                settings.extend(coarsens.map(|name| (name, coarse.to_string())));
            }
            below[index] = !settings.is_empty() || self.reads(index).iter().any(|&above| below[above]);
            if below[index] {
                let costly = kind.preview.rough.iter().filter(|(name, value)| match value.parse::<u64>() {
                    Ok(most) => self.number(index, name).is_some_and(|n| n > most),
                    Err(_) => self.nodes[index].values().iter().any(|(n, v)| n == name && v != value),
                });
                settings.extend(costly.map(|(name, value)| (*name, (*value).to_owned())));
            }
            for (name, value) in &settings {
                let step = graph.nodes[index].with(name, value)?;
                Arc::make_mut(&mut graph.nodes[index]).step = step;
            }
            changed.extend((!settings.is_empty()).then_some(index));
        }
        (!changed.is_empty()).then_some((graph, changed))
    }

    /// True if a node can be limited to a subset of its pixels.
    pub(crate) fn can_be_coarse(&self, node: usize) -> bool {
        self.nodes[node].kind.preview.coarse.is_some()
    }
}
