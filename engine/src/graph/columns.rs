//! The layout of a drawing of a graph. The number of columns is the number of nodes on the longest path. Wires are
//! routed around the nodes between their ends.

use std::collections::BTreeSet;

use crate::graph::graph::Graph;

/// An entry of a column: a node, or the wires of a node that continue to a later column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColumnEntry {
    /// Index of the node.
    pub node: usize,
    /// True for wires that pass the column.
    pub passes: bool,
}

/// Maximum number of entries of a drawing. A long chain of nodes, each of which is also wired to the last node,
/// would need millions of entries.
const MOST_ENTRIES: usize = 50_000;

/// The entries of each column, from top to bottom. A node is after its inputs and before its readers, in the last column
/// that the wires of its inputs reach anyway.
/// Within a column, entries are sorted by the average row of their inputs in the previous column, then by the
/// position of their node in the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Columns(pub Vec<Vec<ColumnEntry>>);

impl Columns {
    /// The columns of a graph; `None` if they have more than 50,000 entries.
    pub fn of(graph: &Graph) -> Option<Self> {
        columns(graph).map(Self)
    }

    /// The line segments between adjacent columns, each as (column, row in it, row in the next column). Wires from
    /// the same node share segments.
    pub fn segments(&self, graph: &Graph) -> BTreeSet<(usize, usize, usize)> {
        segments(graph, &self.0)
    }
}

fn columns(graph: &Graph) -> Option<Vec<Vec<ColumnEntry>>> {
    let mut column = vec![0; graph.nodes.len()];
    let mut last = vec![0; graph.nodes.len()];
    for &index in graph.order() {
        column[index] = graph.reads(index).iter().map(|&above| column[above] + 1).max().unwrap_or(0);
        for &above in graph.reads(index) {
            last[above] = last[above].max(column[index]);
        }
    }
    // As late as possible, so that few nodes share the first columns, and not later than the wires of the inputs reach.
    let mut first = vec![usize::MAX; graph.nodes.len()];
    for &index in graph.order().iter().rev() {
        let reach = graph.reads(index).iter().map(|&above| last[above]).min().unwrap_or(usize::MAX);
        if first[index] != usize::MAX {
            column[index] = column[index].max(reach.min(first[index] - 1));
        }
        graph.reads(index).iter().for_each(|&above| first[above] = first[above].min(column[index]));
    }
    for (index, own) in column.iter().enumerate() {
        graph.reads(index).iter().for_each(|&above| last[above] = last[above].max(*own));
    }
    let count = column.iter().max().map_or(0, |last| last + 1);
    let entries: usize =
        (0..graph.nodes.len()).map(|node| last[node].max(column[node] + 1) - column[node]).sum();
    if entries > MOST_ENTRIES {
        return None;
    }
    let mut starting: Vec<Vec<usize>> = vec![Vec::new(); count];
    (0..graph.nodes.len()).for_each(|node| starting[column[node]].push(node));
    let mut columns: Vec<Vec<ColumnEntry>> = Vec::with_capacity(count);
    let mut rows = Rows::new(graph);
    let mut passing: BTreeSet<usize> = BTreeSet::new();
    for (at, nodes) in starting.iter().enumerate() {
        passing.retain(|&node| last[node] > at);
        let own = nodes.iter().map(|&node| ColumnEntry { node, passes: false });
        let mut entries: Vec<ColumnEntry> =
            own.chain(passing.iter().map(|&node| ColumnEntry { node, passes: true })).collect();
        if let Some(before) = columns.last() {
            rows.set(before);
            entries.sort_by_cached_key(|entry| {
                let above = above(graph, entry);
                let rows: Vec<usize> = above.iter().filter_map(|&node| rows.of(node)).collect();
                // Not negative, so that the order of the bits is that of the numbers.
                let height = rows.iter().sum::<usize>() as f64 / rows.len().max(1) as f64;
                (height.to_bits(), entry.node)
            });
        }
        columns.push(entries);
        passing.extend(nodes);
    }
    Some(columns)
}

/// The nodes whose entries in the previous column are wired to `entry`.
fn above<'g>(graph: &'g Graph, entry: &'g ColumnEntry) -> &'g [usize] {
    if entry.passes { std::slice::from_ref(&entry.node) } else { graph.reads(entry.node) }
}

/// Rows of the nodes in one column.
struct Rows {
    /// For each node, the index of the last column that contained it, and its row in that column.
    of: Vec<(usize, usize)>,
    column: usize,
}

impl Rows {
    fn new(graph: &Graph) -> Self {
        Self { of: vec![(0, 0); graph.nodes.len()], column: 0 }
    }

    /// Replaces the column, in time proportional to the length of the new column.
    fn set(&mut self, column: &[ColumnEntry]) {
        self.column += 1;
        column.iter().enumerate().for_each(|(row, entry)| self.of[entry.node] = (self.column, row));
    }

    fn of(&self, node: usize) -> Option<usize> {
        let (column, row) = self.of[node];
        (column == self.column).then_some(row)
    }
}

fn segments(graph: &Graph, columns: &[Vec<ColumnEntry>]) -> BTreeSet<(usize, usize, usize)> {
    let mut segments = BTreeSet::new();
    let mut rows = Rows::new(graph);
    for (column, pair) in columns.windows(2).enumerate() {
        rows.set(&pair[0]);
        for (to, entry) in pair[1].iter().enumerate() {
            let from = above(graph, entry).iter().filter_map(|&node| rows.of(node));
            segments.extend(from.map(|from| (column, from, to)));
        }
    }
    segments
}
