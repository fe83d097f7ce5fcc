//! A watch of a small graph with its page, and a client of the server that sends exactly the given bytes.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use engine::{Engine, Graph, Load, Refusal, Source, SourceRoot, Store, Watch, WatchOptions};
use serde_json::Value;
use serve::{Options, Page, Starter};

pub const GRAPH: &str = r#"// A small graph.
Graph(
    version: 1,
    scene: (up: "+z", seed: 3),
    parameters: (height: 1.2),
    axes: (turn: List([0.0, 30.0])),
    nodes: (
        demo:   LoadSplats(path: "demo.ply"),
        camera: Camera(eye: (2.0, -2.5, 1.2), target: (0.0, 0.0, 0.2), width_px: 32, height_px: 18, fov_y_deg: 40.0),
        view:   SplatRender(splats: "demo.splats", rig: "camera"), // the picture
        pose:   Pose(translation: (0.0, 0.0, Param("height")), yaw_deg: 30.0),
        save:   WriteImage(image: "view.colour", path: "view.png"),
    ),
)
"#;

/// A watch with its page. Both end when this is dropped.
pub struct Lab {
    pub folder: Arc<tempfile::TempDir>,
    pub port: u16,
    pub token: String,
    pub cookie: String,
    page: Option<Arc<Page>>,
    handle: engine::Handle,
    thread: Option<JoinHandle<()>>,
}

/// A response.
#[derive(Debug)]
pub struct Response {
    pub status: u16,
    pub headers: Vec<(String, String)>,
    pub body: Vec<u8>,
}

impl Response {
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&self.body)))
    }
}

impl Lab {
    pub fn new(graph: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("graph.ron"), graph).unwrap();
        Self::at(Arc::new(folder), None).unwrap()
    }

    /// A page of the graph that is in the folder, which gets a scene of three splats.
    pub fn at(folder: Arc<tempfile::TempDir>, port: Option<u16>) -> Result<Self, serve::Error> {
        Self::started(folder, port, None)
    }

    /// A page that was started from a bare capture.
    pub fn started(
        folder: Arc<tempfile::TempDir>,
        port: Option<u16>,
        starter: Option<Box<dyn Starter>>,
    ) -> Result<Self, serve::Error> {
        let path = folder.path().join("graph.ron");
        std::fs::write(folder.path().join("demo.ply"), splats()).unwrap();
        let store = Store::open(&folder.path().join("cache"), cache::Options::default()).unwrap();
        let engine = Arc::new(Engine::new(store, 1, 1 << 30).keeping());
        let options = WatchOptions { out: folder.path().join("out"), ..WatchOptions::default() };
        let watch = Watch::new(options);
        let handle = watch.handle();
        let options =
            Options { graph: path.clone(), port, folder: Some(folder.path().join("cache/pages")), starter };
        let page = Arc::new(Page::start(engine.clone(), handle.clone(), options)?);
        let url = page.url();
        let (address, token) = url.strip_prefix("http://127.0.0.1:").unwrap().split_once("/#").unwrap();
        let (port, token) = (address.parse().unwrap(), token.to_owned());
        let thread = std::thread::spawn({
            let page = page.clone();
            move || {
                let load = |_| {
                    let load = read(&path, &page.tried());
                    page.loaded(&load);
                    load
                };
                watch.run(&engine, load, |event| page.show(&event));
            }
        });
        let mut lab = Self {
            folder,
            port,
            token: token.clone(),
            cookie: String::new(),
            page: Some(page),
            handle,
            thread: Some(thread),
        };
        let admitted = lab.post("/session", &serde_json::json!({"token": token}).to_string());
        lab.cookie = admitted.header("set-cookie").unwrap().split(';').next().unwrap().to_owned();
        Ok(lab)
    }

    pub fn path(&self) -> PathBuf {
        self.folder.path().join("graph.ron")
    }

    pub fn text(&self) -> String {
        std::fs::read_to_string(self.path()).unwrap()
    }

    /// The host that the server answers.
    pub fn host(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    pub fn get(&self, path: &str) -> Response {
        self.raw(&format!(
            "GET {path} HTTP/1.1\r\nHost: {}\r\nCookie: {}\r\nConnection: close\r\n\r\n",
            self.host(),
            self.cookie
        ))
    }

    /// A request as the page sends it.
    pub fn post(&self, path: &str, body: &str) -> Response {
        self.raw(&format!(
            "POST {path} HTTP/1.1\r\nHost: {0}\r\nOrigin: http://{0}\r\nSec-Fetch-Site: same-origin\r\nCookie: {1}\r\n\
             X-Lightharmony: 1\r\nContent-Type: application/json\r\nContent-Length: {2}\r\nConnection: close\r\n\r\n{body}",
            self.host(),
            self.cookie,
            body.len(),
        ))
    }

    /// Sends exactly these bytes.
    pub fn raw(&self, request: &str) -> Response {
        let mut stream = self.connect();
        // The server may answer and close before it has read everything.
        let _ = stream.write_all(request.as_bytes());
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        let end = bytes.windows(4).position(|window| window == b"\r\n\r\n").unwrap_or(bytes.len());
        let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
        let mut lines = head.lines();
        let status =
            lines.next().unwrap_or_default().split(' ').nth(1).map_or(0, |status| status.parse().unwrap());
        let headers = lines.filter_map(|line| line.split_once(": "));
        let headers =
            headers.map(|(name, value)| (name.to_lowercase(), value.to_owned())).collect::<Vec<_>>();
        Response { status, headers, body: bytes.get(end + 4..).unwrap_or_default().to_vec() }
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        stream
    }

    /// Digest of the text that the page shows.
    pub fn digest(&self) -> String {
        self.get("/graph").json()["digest"].as_str().unwrap().to_owned()
    }

    /// Sends an edit of the text that the page shows now.
    pub fn set(&self, node: &str, field: &str, at: &[usize], value: Option<&str>) -> Response {
        let digest = digest_of(&self.text());
        let edit =
            serde_json::json!({"digest": digest, "node": node, "field": field, "at": at, "value": value});
        self.post("/set", &edit.to_string())
    }

    /// The stream of events.
    pub fn events(&self) -> Events {
        let mut stream = self.connect();
        let request =
            format!("GET /events HTTP/1.1\r\nHost: {}\r\nCookie: {}\r\n\r\n", self.host(), self.cookie);
        stream.write_all(request.as_bytes()).unwrap();
        Events { lines: BufReader::new(stream) }
    }

    /// Waits until the run has ended, and returns the state.
    pub fn idle(&self) -> Value {
        let mut events = self.events();
        loop {
            let event = events.next();
            let is_idle = event["event"] == "state" && event["running"] == false && event["done"].is_object();
            if is_idle {
                return event;
            }
            if event["event"] == "idle" {
                events = self.events();
            }
        }
    }

    /// Waits until `good` is true.
    pub fn until(&self, what: &str, good: impl Fn(&Self) -> bool) {
        let begin = Instant::now();
        while !good(self) {
            assert!(begin.elapsed() < Duration::from_secs(30), "{what}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        self.handle.quit();
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
        drop(self.page.take());
    }
}

/// Digest of a text, as the server names it.
pub fn digest_of(text: &str) -> String {
    cache::Digest::of(text.as_bytes()).to_string()
}

/// Reads the graph as the program does.
fn read(path: &Path, tried: &[String]) -> Load {
    let text = match engine::read_text(path, engine::MAX_GRAPH_BYTES) {
        Ok(text) => text,
        Err(error) => {
            let graph = Err(Refusal::other(format!("cannot read the graph: {error}")));
            return Load { graph, texts: vec![path.to_owned()] };
        }
    };
    let root = match engine::bundle_around(path.parent().unwrap()) {
        Some(bundle) => SourceRoot::confined(&bundle, &[]).unwrap().at(path.parent().unwrap()),
        None => SourceRoot::new(path.parent().unwrap()),
    };
    let settings: Vec<engine::Setting> = tried.iter().map(|setting| setting.parse().unwrap()).collect();
    let source = engine::apply(&Source::new(path.display().to_string(), text), &settings);
    let (source, included) = source.including(&root);
    let graph = Graph::parse(source, &nodes::registry(), root);
    let graph = graph.map(|graph| (Arc::new(graph), Vec::new()));
    let texts = std::iter::once(path.to_owned()).chain(included).collect();
    Load { graph: graph.map_err(|mistakes| Refusal::mistakes(&mistakes, true)), texts }
}

/// A scene of three splats of different colours, as PLY.
fn splats() -> Vec<u8> {
    let properties = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let properties: String = properties.split(' ').map(|name| format!("property float {name}\n")).collect();
    let head = format!("ply\nformat binary_little_endian 1.0\nelement vertex 3\n{properties}end_header\n");
    let splat = |x: f32, colour: [f32; 3]| {
        let [r, g, b] = colour;
        [x, 0.0, 0.2, r, g, b, 4.0, -1.5, -1.5, -1.5, 1.0, 0.0, 0.0, 0.0]
    };
    let splats = [splat(-0.5, [1.5, 0.0, 0.0]), splat(0.0, [0.0, 1.5, 0.0]), splat(0.5, [0.0, 0.0, 1.5])];
    let bytes = splats.into_iter().flatten().flat_map(f32::to_le_bytes);
    head.into_bytes().into_iter().chain(bytes).collect()
}

/// A stream of events, read line by line.
pub struct Events {
    lines: BufReader<TcpStream>,
}

impl Events {
    /// The next event.
    pub fn next(&mut self) -> Value {
        loop {
            let mut line = String::new();
            assert!(self.lines.read_line(&mut line).unwrap() > 0, "the stream ended");
            if let Some(data) = line.trim_end().strip_prefix("data: ") {
                return serde_json::from_str(data).unwrap();
            }
        }
    }

    /// Skips events up to one of the given name.
    pub fn until(&mut self, name: &str) -> Value {
        loop {
            let event = self.next();
            if event["event"] == name {
                return event;
            }
        }
    }
}
