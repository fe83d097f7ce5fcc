//! Tests of panics in the code of a kind. A panic makes the node fail, and never ends the process or makes it hang.

use std::sync::Arc;
use std::sync::mpsc;
use std::time::Duration;

use engine::{
    Artifact, Context, Corrupt, Cost, Decoder, Difference, Encoder, FileHead, Former, InputFile, Kind,
    KindEntry, NodeError, Notes, ParamType, RunOptions, Sizes, SourceFile, SourceRoot, ViewCount, Wired,
};

use crate::arithmetic::{Nothing, Num, registry};
use crate::lab::{Lab, graph_text};

engine::params! {
    /// Panics at the place in its code that `at` names.
    pub struct Burst {
        /// The place at which to panic.
        at: Spot = Spot(String::new()), other("\"run\"");
        /// A file to read.
        path: InputFile, other("\"b.txt\"");
    }
}

/// Name of a place in the code of [`Burst`]. The name `read` cannot be read.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[serde(transparent)]
pub struct Spot(String);

impl<'de> serde::Deserialize<'de> for Spot {
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let name = String::deserialize(from)?;
        assert_ne!(name, "read", "as the test asks for");
        Ok(Self(name))
    }
}

impl ParamType for Spot {
    fn describe() -> String {
        "text".to_owned()
    }
}

impl Burst {
    fn reach(&self, place: &str) {
        assert_ne!(self.at.0, place, "as the test asks for");
    }
}

/// A value that contains the name of one of its methods. That method panics.
pub struct Fuse(String);

impl Fuse {
    fn reach(&self, place: &str) {
        assert_ne!(self.0, place, "as the test asks for");
    }
}

impl Artifact for Fuse {
    const TYPE: &'static str = "fuse";
    const FORMAT: u32 = 1;
    fn encode(&self, to: &mut Encoder) {
        self.reach("encode");
        to.str(&self.0);
    }
    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let fuse = Self(from.str()?);
        fuse.reach("decode");
        Ok(fuse)
    }
    fn bytes(&self) -> usize {
        self.reach("bytes");
        8
    }
    fn size(&self) -> u64 {
        self.reach("size");
        8
    }
    fn difference(&self, _other: &Self) -> Difference {
        self.reach("difference");
        Difference::none()
    }
}

engine::outputs! { /** A number and a fuse. */ pub struct Bursts { /** One. */ number: Arc<Num>, /** The fuse. */ fuse: Arc<Fuse>, } }

impl Kind for Burst {
    const NAME: &'static str = "burst";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = Nothing;
    type Out = Bursts;
    fn estimate(params: &Self, _inputs: &Nothing) -> Cost {
        params.reach("estimate");
        Cost::default()
    }
    fn estimate_files(params: &Self, _files: &[FileHead<'_>]) -> Cost {
        params.reach("estimate_files");
        Cost::default()
    }
    fn work(params: &Self, _sizes: &Sizes) -> f64 {
        params.reach("work");
        1.0
    }
    fn sources(params: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        params.reach("sources");
        Ok(vec![root.file(&params.path)])
    }
    fn former(name: &str, fields: &[(&str, &str)]) -> Option<Former> {
        assert!(name != "former" || fields.is_empty(), "as the test asks for");
        None
    }
    fn check(params: &Self) -> Result<(), NodeError> {
        params.reach("check");
        Ok(())
    }
    fn check_wires(params: &Self, _wired: &Wired) -> Result<(), NodeError> {
        params.reach("check_wires");
        Ok(())
    }
    fn views(params: &Self, _root: &SourceRoot) -> ViewCount {
        params.reach("views");
        ViewCount::Known(1)
    }
    fn run(params: &Self, _inputs: Nothing, cx: &Context) -> Result<(Bursts, Notes), NodeError> {
        cx.read(&params.path)?;
        params.reach("run");
        cx.for_each_tile(8, |tile| assert!(params.at.0 != "tile" || tile != 5, "as the test asks for"))?;
        let fuse = Fuse(params.at.0.clone());
        Ok((Bursts { number: Arc::new(Num(1.0)), fuse: Arc::new(fuse) }, Notes::none()))
    }
}

engine::params! {
    /// Reads a [`Fuse`].
    pub struct Defuse {
        /// A parameter that changes only the key.
        by: f64 = 1.0, other("2.0");
    }
}
engine::inputs! { /** A fuse. */ pub struct OneFuse { /** The fuse. */ fuse: Arc<Fuse>, } }
engine::outputs! { /** One number. */ pub struct Defused { /** The result. */ number: Arc<Num>, } }

impl Kind for Defuse {
    const NAME: &'static str = "defuse";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = OneFuse;
    type Out = Defused;
    fn run(params: &Self, _inputs: OneFuse, _cx: &Context) -> Result<(Defused, Notes), NodeError> {
        Ok((Defused { number: Arc::new(Num(params.by)) }, Notes::none()))
    }
}

fn lab() -> Lab {
    let mut lab = Lab::on_disk();
    lab.registry = registry().with(KindEntry::of::<Burst>()).with(KindEntry::of::<Defuse>());
    lab.write("a.txt", "3");
    lab
}

fn nodes(at: &str, by: f64) -> String {
    format!(
        "burst: Burst(at: \"{at}\", path: \"a.txt\"),
        below: Defuse(fuse: \"burst.fuse\", by: {by:?}),
        bad: WriteNumber(number: [\"burst\", \"below\"], path: \"bad.txt\"),
        a: LoadNumber(path: \"a.txt\"),
        good: Scale(value: \"a\"),
        save: WriteNumber(number: \"good\", path: \"good.txt\"),"
    )
}

/// Runs `act` on another thread. Panics if it does not end within a minute.
fn in_time(what: &str, act: impl FnOnce() + Send + 'static) {
    let (done, ended) = mpsc::channel();
    let thread = std::thread::spawn(move || {
        act();
        let _ = done.send(());
    });
    match ended.recv_timeout(Duration::from_secs(60)) {
        Err(mpsc::RecvTimeoutError::Timeout) => panic!("{what}: hangs"),
        _ => thread.join().unwrap_or_else(|_| panic!("{what}: the panic is not a failure of its node")),
    }
}

#[test]
fn a_panic_while_a_graph_is_checked_is_a_mistake_of_its_node() {
    for at in ["read", "check", "check_wires", "views"] {
        in_time(at, move || {
            let text = lab().mistakes(&graph_text(&nodes(at, 1.0)));
            assert!(text.contains("panicked") && text.contains("graph.ron:2"), "{at}: {text}");
        });
    }
    in_time("former", || {
        let nodes = nodes("", 1.0).replace("at: \"\"", "former: 1");
        let text = lab().mistakes(&graph_text(&nodes));
        assert!(text.contains("panicked") && text.contains("graph.ron:2:14"), "{text}");
        assert!(!text.contains("has no field"), "one mistake is enough: {text}");
    });
}

#[test]
fn a_panic_while_a_graph_runs_is_the_failure_of_its_node() {
    for at in ["sources", "estimate", "estimate_files", "work", "run", "tile", "encode", "bytes", "size"] {
        in_time(at, move || {
            let lab = lab();
            let graph = lab.parse(&graph_text(&nodes(at, 1.0))).unwrap();
            for round in 0..2 {
                let log = lab.run(&nodes(at, 1.0));
                assert_eq!((log.failed().as_str(), log.skipped().as_str()), ("burst", "bad below"), "{at}");
                assert_eq!(
                    (log.exit_code(), lab.out("good.txt").as_str()),
                    (1, "6.0\n"),
                    "{at}, run {round}"
                );
                let text = log.failures();
                assert!(text.contains("as the test asks for") && text.contains("report it"), "{at}: {text}");
            }
            // What else looks at the graph does not end by it either.
            let engine = lab.engine();
            assert_eq!(engine.plan(&graph, &[]).len(), 6);
            assert_eq!(graph.check_sources().is_err(), at == "sources");
            assert!(graph.files().len() >= 2);
            assert_eq!(engine.lock(&graph, &[]).is_err(), at == "sources");
        });
    }
}

#[test]
fn a_panic_in_decoding_makes_the_value_again() {
    in_time("decode", || {
        let lab = lab();
        assert_eq!(lab.run(&nodes("decode", 1.0)).exit_code(), 0);
        let log = lab.run(&nodes("decode", 2.0));
        assert_eq!((log.exit_code(), log.remade().as_str()), (0, "burst"), "{}", log.failures());
        assert_eq!(lab.out("bad.txt"), "1.0\n2.0\n");
    });
}

#[test]
fn a_panic_in_a_comparison_is_its_result() {
    let artifact = engine::ArtifactType::of::<Fuse>();
    let fuse: engine::AnyArtifact = Arc::new(Fuse("difference".to_owned()));
    let difference = artifact.difference(&fuse, &fuse);
    assert!(!difference.equal && difference.summary.contains("panicked"), "{}", difference.summary);
}

#[test]
fn a_watched_graph_that_panics_does_not_end_the_watch() {
    in_time("again", || {
        let lab = lab();
        let engine = lab.engine().keeping();
        for at in ["sources", "work", "run", "bytes"] {
            for _ in 0..2 {
                let graph = lab.parse(&graph_text(&nodes(at, 1.0))).unwrap();
                let options = RunOptions { out: lab.path("out"), ..RunOptions::default() };
                let outcome = engine.run(&graph, &options, |_| {});
                assert_eq!((outcome.totals.failed, outcome.totals.skipped), (1, 2), "{at}");
            }
        }
    });
}
