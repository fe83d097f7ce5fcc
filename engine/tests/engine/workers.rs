//! Tests of nodes that workers compute. The workers are in this process.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use cache::{Digest, Store};
use engine::{
    Engine, Entry, Event, NodeError, Placement, Registry, SharedResults, Stage, Work, WorkContent,
    WorkRequest, WorkerTerms, Workers,
};

use crate::arithmetic::{registry, registry_of_a_liar};
use crate::lab::{Lab, Log, graph_text};

/// Workers that share a store of values.
struct Shop {
    registry: Registry,
    terms: WorkerTerms,
    /// The planned answers, in the order of the requests; then all nodes are computed.
    plan: Mutex<Vec<Plan>>,
    values: Mutex<BTreeMap<Digest, Vec<u8>>>,
    stopped: AtomicBool,
    /// Number of nodes in progress, and the maximum of this number so far.
    busy: [AtomicUsize; 2],
    computed: AtomicUsize,
    /// Number of values that were sent here and fetched from here.
    moved: [AtomicUsize; 2],
}

/// The answer to a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Plan {
    Compute,
    Refuse,
    /// All values are lost before the request.
    Lose,
    /// All values are lost after the request.
    Forget,
    Fail,
    Error,
    Stop,
}

const TERMS: WorkerTerms = WorkerTerms { in_flight: 3, overhead: 0.1, speed: 1e6, checked: 0.0 };

impl Shop {
    fn new(terms: WorkerTerms, plan: &[Plan]) -> Arc<Self> {
        Self::of(registry(), terms, plan)
    }

    fn of(registry: Registry, terms: WorkerTerms, plan: &[Plan]) -> Arc<Self> {
        Arc::new(Self {
            registry,
            terms,
            plan: Mutex::new(plan.to_vec()),
            values: Mutex::default(),
            stopped: AtomicBool::new(false),
            busy: Default::default(),
            computed: AtomicUsize::new(0),
            moved: Default::default(),
        })
    }

    fn values(&self) -> MutexGuard<'_, BTreeMap<Digest, Vec<u8>>> {
        self.values.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn count(&self, counter: &AtomicUsize) -> usize {
        counter.load(Ordering::SeqCst)
    }

    fn work(&self, request: &WorkRequest<'_>, cancel: &AtomicBool) -> Result<Work, NodeError> {
        let folder = tempfile::tempdir().unwrap();
        for file in request.files {
            let path = folder.path().join(&file.path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            match &file.content {
                WorkContent::Text(text) => std::fs::write(&path, text).unwrap(),
                WorkContent::File { path: from, .. } => drop(std::fs::copy(from, &path).unwrap()),
                WorkContent::Value(value) => {
                    let known = self.values().get(value).cloned();
                    let Some(bytes) = known.or_else(|| {
                        let sent = (request.bytes)(value)?;
                        self.moved[0].fetch_add(1, Ordering::SeqCst);
                        self.values().insert(*value, sent.clone());
                        Some(sent)
                    }) else {
                        return Ok(Work::Missing);
                    };
                    std::fs::write(&path, bytes).unwrap();
                }
            }
        }
        let engine = Engine::new(Store::unavailable("none".to_owned()), 1, 1 << 30);
        let out = folder.path().join("out");
        let stop = Arc::new(AtomicBool::new(false));
        std::thread::scope(|scope| {
            let run = scope.spawn(|| engine.run_action(&self.registry, folder.path(), &out, &stop, |_| ()));
            while !run.is_finished() {
                if cancel.load(Ordering::Relaxed) {
                    stop.store(true, Ordering::Relaxed);
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            match run.join().unwrap() {
                Ok(_) => {}
                Err(error) if error.is_cancelled() => return Err(NodeError::cancelled()),
                Err(error) => return Ok(Work::Failed { message: error.to_string(), hint: None }),
            }
            for path in request.values {
                let bytes = std::fs::read(out.join(path)).unwrap();
                self.values().insert(Digest::of(&bytes), bytes);
            }
            let entry =
                Entry::decode(&std::fs::read(out.join(request.entry)).unwrap(), &request.key).unwrap();
            self.computed.fetch_add(1, Ordering::SeqCst);
            Ok(Work::Done { entry: Box::new(entry), worker: "worker 7".to_owned() })
        })
    }
}

impl Workers for Shop {
    fn terms(&self) -> Option<WorkerTerms> {
        (!self.stopped.load(Ordering::SeqCst)).then_some(self.terms)
    }

    fn holds(&self, value: &Digest) -> bool {
        self.values().contains_key(value)
    }

    fn compute(
        &self,
        request: &WorkRequest<'_>,
        cancel: &AtomicBool,
        report: &dyn Fn(Stage),
    ) -> Result<Work, NodeError> {
        let now = self.busy[0].fetch_add(1, Ordering::SeqCst) + 1;
        self.busy[1].fetch_max(now, Ordering::SeqCst);
        report(Stage::Executing("worker 7".to_owned()));
        let plan = {
            let mut plan = self.plan.lock().unwrap();
            if plan.is_empty() { Plan::Compute } else { plan.remove(0) }
        };
        let answer = match plan {
            Plan::Refuse => Ok(Work::Refused),
            Plan::Fail => {
                Ok(Work::Failed { message: "as planned".to_owned(), hint: Some("plan".to_owned()) })
            }
            Plan::Error => Err(NodeError::new("not here")),
            Plan::Stop => {
                self.distrust("as planned");
                Ok(Work::Refused)
            }
            Plan::Lose => {
                self.values().clear();
                self.work(request, cancel)
            }
            Plan::Forget => {
                let answer = self.work(request, cancel);
                self.values().clear();
                answer
            }
            Plan::Compute => self.work(request, cancel),
        };
        self.busy[0].fetch_sub(1, Ordering::SeqCst);
        answer
    }

    fn distrust(&self, _why: &str) {
        self.stopped.store(true, Ordering::SeqCst);
    }
}

impl SharedResults for Shop {
    fn find(&self, _key: &Digest, _cancel: &AtomicBool) -> Result<Option<Entry>, NodeError> {
        Ok(None)
    }

    fn fetch(
        &self,
        _key: &Digest,
        value: &Digest,
        _cancel: &AtomicBool,
    ) -> Result<Option<Vec<u8>>, NodeError> {
        self.moved[1].fetch_add(1, Ordering::SeqCst);
        Ok(self.values().get(value).cloned())
    }

    fn publish(&self, _entry: &Entry, _values: &[(Digest, &[u8])], _cancel: &AtomicBool) {}

    fn remarks(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }
}

fn engine(lab: &Lab, shop: &Arc<Shop>) -> Engine {
    lab.engine().sharing(shop.clone()).sending(shop.clone())
}

fn run(lab: &Lab, shop: &Arc<Shop>, nodes: &str) -> Log {
    lab.run_on(&engine(lab, shop), &graph_text(nodes), &[], |_, _| {})
}

/// A graph in which values go from here to workers, between workers, and back. Every kind appears once, since a kind
/// whose time is known to be short is computed here.
const MIXED: &str = r#"
    a: LoadNumber(path: "a.txt"), b: Number(value: 3.5), s: Split(value: "a"),
    c: Add(terms: ["a", "b", "s.whole"]), d: Ramp(value: "c", count: 5000), e: Sum(numbers: "d"),
    f: Slow(value: "s.rest", millis: 5), g: Series(value: "s.whole"), h: Remark(value: "e"),
    i: Scale(value: "h", by: 3.0), j: Prepared(value: "i"),
    w: WriteNumber(number: ["h", "j"], path: "w.txt"), v: WriteNumber(number: ["f", "g"], path: "v.txt"),
"#;

fn lab() -> Lab {
    let lab = Lab::on_disk();
    lab.write("a.txt", "7.25");
    lab
}

fn files(lab: &Lab) -> [String; 2] {
    ["w.txt", "v.txt"].map(|name| lab.out(name))
}

#[test]
fn workers_compute_what_takes_time_and_keep_the_values() {
    let alone = lab();
    let log = alone.run(MIXED);
    assert_eq!(log.exit_code(), 0);
    let (lab, shop) = (lab(), Shop::new(TERMS, &[]));
    let log = run(&lab, &shop, MIXED);
    assert_eq!((log.exit_code(), files(&lab)), (0, files(&alone)));
    // s c d e f g h j: all but loaders, instant nodes and sinks.
    assert_eq!((shop.count(&shop.computed), log.outcome.totals.ran), (8, 13));
    // Sent are `a` and `b`, and `i`, which is computed here from `h`; fetched are `h`, `f` and `g`; the value of `j` is that
    // of `i`.
    assert_eq!((shop.count(&shop.moved[0]), shop.count(&shop.moved[1])), (3, 3));
    let stages = log.events.iter().filter(
        |event| matches!(event, Event::Stage { stage: "executing", worker, .. } if worker == "worker 7"),
    );
    assert_eq!(stages.count(), 8);
    let again = run(&lab, &shop, MIXED);
    assert_eq!((again.ran(), shop.count(&shop.computed)), (String::new(), 8));
    // Without the workers, the values that are needed are computed again.
    std::fs::remove_dir_all(lab.path("out")).unwrap();
    let log = lab.run(MIXED);
    assert_eq!((log.ran(), files(&lab)), (String::new(), files(&alone)));
}

/// Nodes on workers take no place of nodes here, and no more than permitted are in progress.
#[test]
fn as_many_nodes_as_permitted_are_in_progress() {
    let mut nodes = "a: Number(),".to_owned();
    for n in 0..9 {
        nodes += &format!("s{n}: Slow(value: \"a\", millis: {}),", 200 + n);
    }
    nodes += "w: WriteNumber(number: [\"s0\"], path: \"w.txt\"),";
    let lab = Lab { jobs: 1, ..Lab::on_disk() };
    let shop = Shop::new(TERMS, &[]);
    let begin = Instant::now();
    let all = ["s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7", "s8", "w"];
    let log = lab.run_on(&engine(&lab, &shop), &graph_text(&nodes), &all, |_, _| {});
    assert_eq!((log.exit_code(), shop.count(&shop.busy[1])), (0, 3), "three at once");
    assert!(begin.elapsed() < Duration::from_millis(1700), "{:?}", begin.elapsed());
}

/// Refusals, losses and the end of the service at every request: the files are right. The counters of the scheduler
/// are compared with its state after each message.
#[test]
fn whatever_workers_answer_the_files_are_right() {
    let alone = lab();
    assert_eq!(alone.run(MIXED).exit_code(), 0);
    for plan in [Plan::Refuse, Plan::Lose, Plan::Forget, Plan::Stop] {
        for at in 0..8 {
            for in_flight in [1, 3] {
                let mut plans = vec![Plan::Compute; at];
                plans.push(plan);
                let (lab, shop) = (lab(), Shop::new(WorkerTerms { in_flight, ..TERMS }, &plans));
                let log = run(&lab, &shop, MIXED);
                assert_eq!((log.exit_code(), files(&lab)), (0, files(&alone)), "{plan:?} at {at}");
                let computed = shop.count(&shop.computed);
                match plan {
                    Plan::Refuse => assert_eq!(computed, 7, "{at}"),
                    Plan::Stop => assert!(computed < 8, "{at}"),
                    _ => assert_eq!(computed, 8, "{at}"),
                }
            }
        }
    }
    let shop = Shop::new(TERMS, &[Plan::Lose; 50]);
    let lab = lab();
    assert_eq!((run(&lab, &shop, MIXED).exit_code(), files(&lab)), (0, files(&alone)));
}

#[test]
fn nodes_that_fail_on_workers_fail_like_others() {
    for (plan, text) in [(Plan::Fail, "as planned"), (Plan::Error, "not here")] {
        let (lab, shop) = (lab(), Shop::new(TERMS, &[plan]));
        let log = run(&lab, &shop, MIXED);
        assert_eq!((log.failed().as_str(), log.exit_code()), ("s", 1));
        assert!(log.outcome.failures.unwrap().render(false).contains(text));
    }
    let (lab, shop) = (lab(), Shop::new(TERMS, &[]));
    let log = run(&lab, &shop, "a: Number(value: 50), r: Refuse(value: \"a\"), s: Slow(value: \"r\"),");
    assert_eq!((log.failed().as_str(), log.skipped().as_str()), ("r", "s"));
}

#[test]
fn a_cancelled_run_ends_at_once_and_keeps_what_is_finished() {
    let (lab, shop) = (lab(), Shop::new(TERMS, &[]));
    let nodes = r#"s: Seeded(), t: Slow(value: "s", millis: 60000), u: Slow(value: "t"),"#;
    let begin = Instant::now();
    let mut stages = 0;
    let log = lab.run_on(&engine(&lab, &shop), &graph_text(nodes), &[], |event, cancel| {
        stages += usize::from(matches!(event, Event::Stage { .. }));
        if stages == 2 {
            cancel.store(true, Ordering::Relaxed);
        }
    });
    assert!(log.outcome.totals.stopped && begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
    assert_eq!((log.ran().as_str(), log.skipped().as_str()), ("s", "t u"));
}

#[test]
fn a_check_compares_with_this_machine() {
    let (lab, all) = (lab(), WorkerTerms { checked: 1.0, in_flight: 1, ..TERMS });
    let shop = Shop::new(all, &[]);
    let log = run(&lab, &shop, MIXED);
    assert_eq!((log.exit_code(), shop.count(&shop.computed), log.outcome.totals.ran), (0, 8, 13));

    // The liar's `add` is wrong. Unchecked, it is believed.
    let lie = |terms| Shop::of(registry_of_a_liar(), terms, &[]);
    let right = files(&lab);
    let believing = self::lab();
    assert_eq!(run(&believing, &lie(TERMS), MIXED).exit_code(), 0);
    assert_ne!(files(&believing), right);
    let checking = self::lab();
    let log = run(&checking, &lie(all), MIXED);
    let failures = log.outcome.failures.as_ref().unwrap().render(false);
    assert!(failures.contains("`c` from worker 7 differs"), "{failures}");
    assert_eq!(log.exit_code(), 1);
    // Whatever is in the cache now is right.
    assert_eq!(checking.run(MIXED).exit_code(), 0);
    assert_eq!(files(&checking), right);
}

#[test]
fn a_plan_states_where_nodes_run() {
    let (lab, shop) = (lab(), Shop::new(TERMS, &[]));
    let graph = lab.parse(&graph_text(MIXED)).unwrap();
    let places = |engine: &Engine| -> Vec<(String, Option<Placement>)> {
        let plan = engine.plan(&graph, &[]);
        let places = plan.iter().enumerate();
        places.map(|(at, node)| (node.id.clone(), engine.placement(&graph, at, node))).collect()
    };
    assert!(places(&lab.engine()).iter().all(|(_, place)| place.is_none()), "no workers");
    let of = |places: &[(String, Option<Placement>)], id: &str| {
        places.iter().find(|(known, _)| known == id).unwrap().1.clone()
    };
    let found = places(&engine(&lab, &shop));
    for (id, place) in [
        ("a", Placement::NotStored),
        ("b", Placement::Instant),
        ("s", Placement::Worker(None)),
        ("d", Placement::Worker(None)),
        ("w", Placement::Sink),
    ] {
        assert_eq!(of(&found, id), Some(place), "{id}");
    }
    assert_eq!(run(&lab, &shop, MIXED).exit_code(), 0);
    let found = places(&engine(&lab, &shop));
    assert!(found.iter().all(|(_, place)| place.is_none()), "everything is known");
    lab.write("a.txt", "9.5");
    let found = places(&engine(&lab, &shop));
    assert_eq!(of(&found, "s"), Some(Placement::Short), "its time is known now");
}
