//! Failures of commands, as the program on the worker reports them.

use serde::Deserialize;

/// The reason why a command gave no outputs.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Failure {
    /// The code of the node failed. It fails everywhere.
    Node { message: String, hint: Option<String> },
    /// The node needs more memory than the worker has: this many bytes, if it is known.
    Memory(Option<u64>),
    /// The command could not run the node, for this reason.
    Worker(String),
}

/// The last line on standard output of a node that failed.
#[derive(Deserialize)]
struct Line {
    event: String,
    message: String,
    #[serde(default)]
    hint: Option<String>,
    /// The memory that the node needs in bytes, if it did not start because the worker has less.
    #[serde(default)]
    needs: Option<u64>,
}

/// Exit code of a process that was killed. Without a time limit, the reason is nearly always a lack of memory.
const KILLED: i32 = 137;
/// Maximum number of characters of a message that are shown.
const SHOWN: usize = 300;

/// The reason why a command ended with `code`.
pub(crate) fn failure(code: i32, out: &str, err: &str) -> Failure {
    let line = out
        .lines()
        .rev()
        .find_map(|line| serde_json::from_str::<Line>(line).ok().filter(|line| line.event == "failed"));
    match (code, line) {
        (KILLED, _) => Failure::Memory(None),
        (1, Some(Line { needs: Some(needs), .. })) => Failure::Memory(Some(needs)),
        (1, Some(Line { message, hint, .. })) => Failure::Node { message, hint },
        _ => {
            let last = err.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("no message");
            let last: String = last.trim().chars().take(SHOWN).collect();
            Failure::Worker(format!("the worker could not run the node (exit code {code}: {last})"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_of_nodes_and_of_workers_differ() {
        let out = "{\"event\":\"start\"}\n{\"event\":\"failed\",\"message\":\"`a`: no\",\"hint\":\"do b\"}";
        let node = Failure::Node { message: "`a`: no".to_owned(), hint: Some("do b".to_owned()) };
        assert_eq!(failure(1, out, "noise"), node);
        let out = "{\"event\":\"failed\",\"message\":\"too little\",\"needs\":7}";
        assert_eq!(failure(1, out, ""), Failure::Memory(Some(7)));
        assert_eq!(failure(137, "", ""), Failure::Memory(None));
        let worker = |code, err| match failure(code, "", err) {
            Failure::Worker(why) => why,
            other => panic!("{other:?}"),
        };
        assert!(worker(127, "sh: lightharmony: not found\n\n").contains("127: sh: lightharmony: not found"));
        assert!(worker(1, "").contains("no message"));
        assert!(worker(2, &"x".repeat(9999)).len() < 500);
    }
}
