//! [`Page`]: the running server.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;

use engine::{Engine, Event, Handle, Load};
use serde::{Deserialize, Serialize};
use tokio::net::TcpListener;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::oneshot;

use crate::door::Door;
use crate::editor::Editor;
use crate::error::Error;
use crate::history::{History, name_of, write_private};
use crate::live::Live;
use crate::routes::router;
use crate::starter::Starter;

/// Options of a page.
pub struct Options {
    /// Path of the graph file.
    pub graph: PathBuf,
    /// The port; `None` for the port that was used last, or any free port.
    pub port: Option<u16>,
    /// Folder of the history of edits and of the address; `None` to keep them in memory only.
    pub folder: Option<PathBuf>,
    /// The writer of a first graph with an object; `None` if the graph is not that of a bare capture.
    pub starter: Option<Box<dyn Starter>>,
}

/// The server of a page. Dropping this value stops the server.
pub struct Page {
    live: Arc<Live>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// The port and the token of a page, kept in a file so that an open page can reconnect after a restart.
#[derive(Serialize, Deserialize)]
struct Address {
    port: u16,
    token: String,
}

impl Address {
    fn read(path: &Path) -> Option<Self> {
        let address: Self = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
        let is_token =
            address.token.len() == 32 && address.token.bytes().all(|byte| byte.is_ascii_hexdigit());
        is_token.then_some(address)
    }
}

impl Page {
    /// Starts the server for a watch, which must call [`loaded`](Self::loaded) and [`show`](Self::show).
    ///
    /// # Errors
    /// [`Error`], for instance if the port is in use.
    pub fn start(engine: Arc<Engine>, handle: Handle, options: Options) -> Result<Self, Error> {
        let graph = options.graph.canonicalize();
        let graph = graph.map_err(|error| Error::Graph { path: options.graph.clone(), error })?;
        let file = |end: &str| options.folder.as_ref().map(|folder| folder.join(name_of(&graph) + end));
        let known = file(".address.json").as_deref().and_then(Address::read);
        let runtime = Builder::new_current_thread().enable_all().build().map_err(Error::Thread)?;
        let listener = listen(&runtime, options.port, known.as_ref().map(|known| known.port))?;
        let port = listener.local_addr().map_err(Error::Listen)?.port();
        let token = match known {
            Some(known) => known.token,
            None => token()?,
        };
        if let Some(path) = file(".address.json") {
            // Without the file, an open page must be opened again after a restart; nothing else is lost.
            let address = serde_json::to_vec(&Address { port, token: token.clone() }).unwrap_or_default();
            let _ = write_private(&path, &address);
        }
        let text = engine::read_text(&graph, engine::MAX_GRAPH_BYTES);
        let text = text.map_err(|error| Error::Graph { path: options.graph.clone(), error })?;
        let editor = Editor::new(graph.clone(), History::open(file(".history.jsonl"), &text));
        let live =
            Arc::new(Live::new(engine, handle, graph, Door::new(token, port), editor, options.starter));
        let (stop, stopped) = oneshot::channel();
        let served = live.clone();
        let serve = move || {
            runtime.block_on(async {
                tokio::select! {
                    _ = axum::serve(listener, router(served)) => {}
                    _ = stopped => {}
                }
            });
            // Requests that still read a value are not waited for.
            runtime.shutdown_background();
        };
        let thread =
            std::thread::Builder::new().name("page".to_owned()).spawn(serve).map_err(Error::Thread)?;
        Ok(Self { live, stop: Some(stop), thread: Some(thread) })
    }

    /// The address to open in a browser. It contains the token.
    pub fn url(&self) -> String {
        self.live.door.url()
    }

    /// Shows a graph that the watch has read, or its mistakes.
    pub fn loaded(&self, load: &Load) {
        self.live.loaded(load);
    }

    /// Shows an event of the watch.
    pub fn show(&self, event: &Event) {
        self.live.show(event);
    }

    /// The trial values of the page, which are not in the text, such as `pose.yaw_deg=30.0`. The watch applies them
    /// each time it reads the graph.
    pub fn tried(&self) -> Vec<String> {
        self.live.tried()
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Listens on the loopback interface: on `port` if it is given, else on `known` if it is free, else on any port.
fn listen(runtime: &Runtime, port: Option<u16>, known: Option<u16>) -> Result<TcpListener, Error> {
    let bind = |port: u16| runtime.block_on(TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port))));
    match (port, known) {
        (Some(port), _) => bind(port).map_err(|error| match error.kind() {
            std::io::ErrorKind::AddrInUse => Error::PortInUse(port),
            _ => Error::Listen(error),
        }),
        (None, Some(known)) => bind(known).or_else(|_| bind(0)).map_err(Error::Listen),
        (None, None) => bind(0).map_err(Error::Listen),
    }
}

/// A secret of 128 random bits in hexadecimal digits.
fn token() -> Result<String, Error> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|_| Error::Random)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}
