//! Tests of killed processes. No matter when a process is killed, the next run with the same cache writes the same
//! bytes as a run that was never interrupted, and reports no repair or warning.

use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use cache::{Store, failpoint};
use engine::{Engine, Graph, RunOptions, Source, SourceRoot};

use crate::arithmetic::registry;
use crate::lab::{Lab, graph_text};

const FOLDER: &str = "ENGINE_TEST_FOLDER";
const FAILPOINT: &str = "LIGHTHARMONY_FAILPOINT";

/// A graph with large and small results, parts, a loader and several files. A run takes a few tens of milliseconds.
fn graph() -> String {
    let lists: String = (0..4)
        .map(|n| {
            format!(
                "slow{n}: Slow(value: \"a\", millis: {n}), r{n}: Ramp(value: \"slow{n}\", count: {}), s{n}: Sum(numbers: \"r{n}\"), \
                 mean{n}: Series(value: \"s{n}\", samples: 40), w{n}: WriteNumber(number: [\"s{n}\", \"mean{n}\"], path: \"w{n}.txt\"),\n",
                800 + n
            )
        })
        .collect();
    graph_text(&format!("a: LoadNumber(path: \"a.txt\"),\n{lists}"))
}

/// The process that the other tests start and kill. It is not a test itself.
#[test]
#[ignore = "a part of the other tests"]
fn child() {
    let Some(folder) = std::env::var_os(FOLDER) else { return };
    let folder = Path::new(&folder);
    let source = Source::new("graph.ron", graph());
    let graph = Graph::parse(source, &registry(), SourceRoot::new(folder)).unwrap();
    let store = Store::open(&folder.join("cache"), cache::Options::default()).unwrap();
    let engine = Engine::new(store, 2, 1 << 30);
    let options = RunOptions { out: folder.join("out"), ..RunOptions::default() };
    let outcome = engine.run(&graph, &options, |_| {});
    assert_eq!(outcome.totals.failed, 0);
}

fn start(lab: &Lab, failpoint: Option<&str>) -> std::process::Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "kills::child", "--ignored", "--test-threads=1"]);
    command.env(FOLDER, lab.path("")).env_remove(FAILPOINT).stdout(Stdio::null()).stderr(Stdio::null());
    if let Some(place) = failpoint {
        command.env(FAILPOINT, place);
    }
    command.spawn().unwrap()
}

fn outputs(lab: &Lab) -> Vec<String> {
    (0..4).map(|n| lab.out(&format!("w{n}.txt"))).collect()
}

fn lab() -> Lab {
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    lab
}

fn undisturbed() -> Vec<String> {
    let lab = lab();
    lab.run_text(&graph());
    outputs(&lab)
}

fn assert_recovers(lab: &Lab, expected: &[String], what: &str) {
    let log = lab.run_text(&graph());
    assert_eq!((log.exit_code(), log.warnings()), (0, vec![]), "{what}: {}", log.failures());
    assert_eq!(outputs(lab), expected, "{what}");
    let again = lab.run_text(&graph());
    assert_eq!((again.ran().as_str(), again.warnings()), ("", vec![]), "{what}");
}

/// Number of attempts: `usual`, or the value of `LIGHTHARMONY_KILLS` for a longer run.
fn rounds(usual: u64) -> u64 {
    std::env::var("LIGHTHARMONY_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(usual)
}

#[test]
fn killed_at_every_named_place_of_the_cache() {
    let expected = undisturbed();
    let mut reached = 0;
    for name in failpoint::NAMES {
        for count in [1, 3, 6] {
            let (lab, place) = (lab(), format!("{name}:{count}"));
            let killed = start(&lab, Some(&place)).wait().unwrap().signal().is_some();
            reached += usize::from(killed);
            if !killed {
                break;
            }
            assert_recovers(&lab, &expected, &place);
        }
    }
    assert!(reached >= 40, "only {reached} processes were killed");
}

#[test]
fn killed_at_any_moment_and_again_while_it_recovers() {
    let expected = undisturbed();
    for round in 0..rounds(16) {
        let lab = lab();
        for moment in [round % 16 * 4, round % 40 * 2 + 3] {
            let mut child = start(&lab, None);
            std::thread::sleep(Duration::from_millis(moment));
            // It may have ended before.
            let _ = child.kill();
            child.wait().unwrap();
        }
        assert_recovers(&lab, &expected, &format!("round {round}"));
    }
}

#[test]
fn errors_of_the_disk_at_every_place_are_survived() {
    let expected = undisturbed();
    for name in failpoint::NAMES {
        for effect in ["error", "full"] {
            let (lab, place) = (lab(), format!("{name}:2:{effect}"));
            // It may fail if an output file cannot be written, but it ends without a signal.
            assert_eq!(start(&lab, Some(&place)).wait().unwrap().signal(), None, "{place}");
            assert_recovers(&lab, &expected, &place);
        }
    }
}
