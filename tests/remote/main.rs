//! Tests of `run --remote` and `key`, with a real server.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test may stop at the first surprise")]

use std::io::{BufRead, BufReader};
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

#[path = "../../extras/remote/src/reapi/tests/casd.rs"]
#[allow(dead_code, reason = "other tests damage the files of the server")]
mod casd;
#[path = "../support/program.rs"]
#[allow(dead_code, reason = "the tests of the program without a server use the rest")]
mod program;

use casd::Casd;
use program::{INSERT, Place, RunLog};

/// A user with a cache and settings of their own.
struct User(Place);

impl User {
    fn new() -> Self {
        Self(Place::new(INSERT))
    }

    fn call(&self, arguments: &[&str]) -> Output {
        let mut command = self.0.command(arguments);
        command.env("XDG_CONFIG_HOME", self.0.path("config")).env_remove("LIGHTHARMONY_REMOTE");
        command.output().unwrap()
    }

    /// Watches the graph until its first picture is finished, and then closes standard input. Returns all events.
    fn watch(&self, arguments: &[&str]) -> RunLog {
        self.watch_with(arguments, |_| {})
    }

    /// The same; `each` is called with each event.
    fn watch_with(&self, arguments: &[&str], mut each: impl FnMut(&Value)) -> RunLog {
        let mut command = self.0.command(
            &[&["watch", "graph.ron", "--json", "--stop-at-eof", "--no-preview"], arguments].concat(),
        );
        command.env("XDG_CONFIG_HOME", self.0.path("config")).env_remove("LIGHTHARMONY_REMOTE");
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut input = child.stdin.take();
        let mut events: Vec<Value> = Vec::new();
        for line in BufReader::new(child.stdout.take().unwrap()).lines() {
            let event: Value = serde_json::from_str(&line.unwrap()).unwrap();
            each(&event);
            if event["event"] == "done" && event["stopped"] != true {
                input = None;
            }
            events.push(event);
        }
        drop(input);
        RunLog { code: child.wait().unwrap().code().unwrap_or(-1), events, errors: String::new() }
    }

    fn good(&self, arguments: &[&str]) -> String {
        let output = self.call(arguments);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    fn bad(&self, arguments: &[&str]) -> String {
        let output = self.call(arguments);
        assert_eq!(output.status.code(), Some(2));
        String::from_utf8_lossy(&output.stderr).into_owned()
    }

    fn run(&self, arguments: &[&str]) -> RunLog {
        let output = self.call(&[&["run", "graph.ron", "--json"], arguments].concat());
        let text = String::from_utf8(output.stdout).unwrap();
        RunLog {
            code: output.status.code().unwrap_or(-1),
            events: text.lines().map(|line| serde_json::from_str(line).unwrap()).collect(),
            errors: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

/// The event on what moved between the machine and the server.
fn traffic(log: &RunLog) -> &Value {
    log.events.iter().find(|event| event["event"] == "remote").expect("an event")
}

fn warnings(log: &RunLog) -> Vec<&str> {
    let events = log.events.iter().filter(|event| event["event"] == "warning");
    events.filter_map(|event| event["id"].as_str()).collect()
}

#[test]
fn two_users_share_results_through_a_server() {
    let Some(server) = Casd::start() else { return };
    let address = server.address();
    let (anna, ben) = (User::new(), User::new());
    let error = anna.bad(&["run", "graph.ron", "--remote", &address, "--remote-write"]);
    assert!(error.contains("`lightharmony key new NAME`"), "{error}");
    let key = anna.good(&["key", "new", "anna-1"]);
    let log = anna.run(&["--remote", &address, "--remote-write"]).good();
    assert!(log.nodes("ran").contains(&"trace") && warnings(&log).is_empty(), "{:?}", log.events);
    assert!(traffic(&log)["stored"].as_u64().unwrap() >= 10, "{}", traffic(&log));

    // Not trusted yet: everything is computed, and one warning prints the command.
    let log = ben.run(&["--remote", &address]).good();
    assert!(log.nodes("ran").contains(&"trace"));
    assert_eq!(warnings(&log), ["remote-untrusted"]);
    ben.good(&["key", "trust", key.trim()]);
    assert_eq!(ben.good(&["key", "list"]), format!("trusted {key}"));

    // Trusted: nothing but the instant nodes runs, and the files are equal.
    std::fs::remove_dir_all(ben.0.path("cache")).unwrap();
    std::fs::remove_dir_all(ben.0.path("out")).unwrap();
    let log = ben.run(&["--remote", &address, "--no-remote-fallback"]).good();
    let ran: Vec<&str> = log.nodes("ran");
    assert!(ran.iter().all(|node| ["camera", "pose", "probe"].contains(node)), "{ran:?}");
    assert_eq!(anna.0.outputs(), ben.0.outputs());
    // Only the values of the three sinks came.
    assert_eq!(traffic(&log)["values"], 3, "{}", traffic(&log));

    // `watch` uses the server too.
    std::fs::remove_dir_all(ben.0.path("cache")).unwrap();
    std::fs::remove_dir_all(ben.0.path("out")).unwrap();
    let log = ben.watch(&["--remote", &address]);
    let ran: Vec<&str> = log.nodes("ran");
    assert!(ran.iter().all(|node| ["camera", "pose", "probe"].contains(node)), "{ran:?}");
    assert_eq!(anna.0.outputs(), ben.0.outputs());
    assert_eq!(traffic(&log)["values"], 3, "{}", traffic(&log));

    // The address may come from a file or the environment; `none` turns it off.
    let config = ben.0.path("config/lightharmony");
    std::fs::write(config.join("remote.ron"), format!("Remote(address: {address:?})")).unwrap();
    std::fs::remove_dir_all(ben.0.path("cache")).unwrap();
    let log = ben.run(&[]).good();
    assert!(traffic(&log)["found"].as_u64().unwrap() >= 10);
    std::fs::remove_dir_all(ben.0.path("cache")).unwrap();
    let log = ben.run(&["--remote", "none"]).good();
    assert!(log.events.iter().all(|event| event["event"] != "remote"));

    // A revoked key.
    ben.good(&["key", "revoke", "anna-1"]);
    assert!(ben.bad(&["key", "trust", key.trim()]).contains("was revoked"));
    std::fs::remove_dir_all(ben.0.path("cache")).unwrap();
    let log = ben.run(&["--remote", &address]).good();
    assert_eq!((warnings(&log), log.nodes("ran").contains(&"trace")), (vec!["remote-revoked"], true));
}

#[test]
fn a_server_that_cannot_be_reached_is_reported() {
    let user = User::new();
    // Port 1 is reserved, and nothing listens there.
    let address = "grpc://127.0.0.1:1";
    let error = user.bad(&["run", "graph.ron", "--remote", address, "--no-remote-fallback"]);
    assert!(error.contains(address) && error.contains("--no-remote-fallback"), "{error}");
    assert!(!user.0.path("out").exists(), "nothing ran");
    for command in [&["watch", "graph.ron"][..], &["tune", "graph.ron", "--max-error", "flip=0.1"]] {
        let error = user.bad(&[command, &["--remote", address, "--no-remote-fallback"]].concat());
        assert!(error.contains(address) && error.contains("--no-remote-fallback"), "{error}");
    }
    let log = user.run(&["--remote", address]).good();
    assert_eq!(warnings(&log), ["remote-lost"]);
    for (wrong, message) in [
        (&["--remote", "http://a:1"][..], "is not the address of a server"),
        (&["--remote", "grpcs://a"], "is not the address of a server"),
        (&["--remote-write"], "`--remote-write` needs a server"),
    ] {
        let error = user.bad(&[&["run", "graph.ron", "--set", "trace.samples=1"], wrong].concat());
        assert!(error.contains(message), "{error}");
    }
}

#[test]
fn a_server_computes_nodes() {
    let Some(server) = Casd::executing() else { return };
    let address = server.address();
    let (alone, anna, ben) = (User::new(), User::new(), User::new());
    alone.run(&["--remote", "none"]).good();
    let key = anna.good(&["key", "new", "anna-1"]);
    let remote = ["--remote", &address, "--remote-execute"];

    let plan = anna.good(&[&["plan", "graph.ron"], &remote[..]].concat());
    let line = |node: &str| plan.lines().find(|line| line.starts_with(node)).unwrap_or_default();
    assert!(line("trace ").contains("on a worker"), "{plan}");
    assert!(line("camera ").contains("here: it takes microseconds"), "{plan}");

    let log = anna.run(&[&remote[..], &["--remote-write"]].concat()).good();
    let executed = traffic(&log)["executed"].as_u64().unwrap();
    assert!(executed >= 4 && warnings(&log).is_empty(), "{} {:?}", traffic(&log), warnings(&log));
    let at = |stage: &str, node: &str| {
        let is_it =
            |event: &&Value| event["event"] == "stage" && event["stage"] == stage && event["id"] == node;
        log.events.iter().any(|event| is_it(&event))
    };
    assert!(at("sending", "trace") && at("queued", "trace") && !at("queued", "camera"));
    assert_eq!(alone.0.outputs(), anna.0.outputs());

    // Another machine uses what the first one signed, and has nothing computed.
    ben.good(&["key", "trust", key.trim()]);
    let log = ben.run(&remote).good();
    assert_eq!((&traffic(&log)["executed"], warnings(&log).len()), (&0.into(), 0), "{}", traffic(&log));
    assert_eq!(alone.0.outputs(), ben.0.outputs());

    // Everything is checked.
    let carla = User::new();
    let log = carla.run(&[&remote[..], &["--verify-remote", "100%"]].concat()).good();
    let [again, here] = [traffic(&log)["executed"].as_u64().unwrap(), log.nodes("ran").len() as u64];
    assert!(again >= executed && here > again, "{again} {here}");
    assert_eq!(alone.0.outputs(), carla.0.outputs());
    for (wrong, message) in [
        (&["--remote-execute"][..], "`--remote-execute` needs a server"),
        (&["--remote", &address, "--verify-remote", "2%"], "`--verify-remote` needs `--remote-execute`"),
        (&["--remote", &address, "--remote-execute", "--verify-remote", "200%"], "is not a share"),
    ] {
        let error = carla.bad(&[&["run", "graph.ron", "--set", "trace.samples=1"], wrong].concat());
        assert!(error.contains(message), "{error}");
    }
}

/// Processes of workers that compute nodes.
fn busy_workers() -> Vec<u32> {
    let processes = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let ids = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let computes = |id: &u32| {
        let command = std::fs::read(format!("/proc/{id}/cmdline")).unwrap_or_default();
        command.starts_with(b"./lightharmony\0action\0run\0")
    };
    ids.filter(computes).collect()
}

/// `watch` and `tune` have nodes computed by workers, and an edit ends what a worker computes for the text before it.
#[test]
fn watching_and_tuning_use_workers() {
    let Some(server) = Casd::executing() else { return };
    let address = server.address();
    let remote = ["--remote", &address, "--remote-execute"];
    let (alone, anna) = (User::new(), User::new());
    alone.run(&["--remote", "none"]).good();

    // More than a minute of work for `trace`, until the text is edited.
    anna.0.write(&INSERT.replace("samples: 4)", "samples: 20000)"));
    let mut before = None;
    let log = anna.watch_with(&remote, |event| {
        if before.is_none()
            && event["event"] == "stage"
            && event["id"] == "trace"
            && event["stage"] == "queued"
        {
            let begin = Instant::now();
            while busy_workers().is_empty() && begin.elapsed() < Duration::from_secs(20) {
                std::thread::sleep(Duration::from_millis(50));
            }
            std::thread::sleep(Duration::from_secs(1));
            before = Some(busy_workers());
            anna.0.write(INSERT);
        }
    });
    let before = before.expect("`trace` goes to a worker");
    assert!(!before.is_empty(), "a worker computes `trace`");
    assert_eq!(alone.0.outputs(), anna.0.outputs());
    assert!(traffic(&log)["executed"].as_u64().unwrap() >= 4, "{}", traffic(&log));
    let begin = Instant::now();
    while busy_workers().iter().any(|worker| before.contains(worker)) {
        assert!(
            begin.elapsed() < Duration::from_secs(20),
            "a worker still computes the text before the edit"
        );
        std::thread::sleep(Duration::from_millis(100));
    }

    // The search begins with the best settings, which take long for larger pictures.
    anna.0.write(&INSERT.replace("width_px: 96, height_px: 54, fov", "width_px: 16, height_px: 9, fov"));
    let tune = ["tune", "graph.ron", "--max-error", "flip=0.2", "--budget", "2"];
    let output = anna.call(&[&tune[..], &remote[..]].concat());
    let text = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&text);
    let computed =
        text.split("computed: ").nth(1).and_then(|rest| rest.split(';').next()?.parse::<u32>().ok());
    assert!(computed.is_some_and(|count| count > 0), "{text}");
}
