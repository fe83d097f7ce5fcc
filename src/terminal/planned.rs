//! The plan of a node as JSON.

use engine::{Change, Digest, Engine, Fate, Graph, Planned, Why};
use serde_json::{Value, json};

use super::causes::reason;

/// The plan of a node, and the time, memory and counts of its last run, as JSON.
pub fn planned_json(engine: &Engine, graph: &Graph, index: usize, node: &Planned) -> Value {
    let (fate, changes, after) = match &node.fate {
        Fate::Unwanted => ("unwanted", &[][..], None),
        Fate::Known => ("known", &[][..], None),
        Fate::Lost => ("lost", &[][..], None),
        Fate::Runs(Why::New) => ("runs", &[][..], None),
        Fate::Runs(Why::Changed(changes)) => ("runs", changes.as_slice(), None),
        Fate::Follows(above) => ("follows", &[][..], Some(above)),
        Fate::Fails(_) => ("fails", &[][..], None),
    };
    let last = engine.past(graph, index, node).spent.map(|last| {
        json!({"seconds": last.seconds, "cpu_seconds": last.cpu_seconds, "memory_bytes": last.memory,
               "counts": last.counts})
    });
    // The key is the digest of its manifest.
    let key = node.manifest.as_ref().map(|manifest| Digest::of(manifest.as_bytes()).to_string());
    let place = engine.placement(graph, index, node);
    let mut object = json!({
        "event": "planned", "id": node.id, "kind": node.kind, "fate": fate, "follows": after, "key": key,
        "forecast": node.forecast, "why": reason(graph, index, &node.fate),
        "changes": changes_json(changes), "last": last,
    });
    if let Some(place) = place {
        object["remote"] = place.is_remote().into();
        object["place"] = place.to_string().into();
    }
    object
}

/// The differences between two keys of a node, as JSON.
pub fn changes_json(changes: &[Change]) -> Vec<Value> {
    let change = |change: &Change| json!({"path": change.path, "old": change.old, "new": change.new});
    changes.iter().map(change).collect()
}
