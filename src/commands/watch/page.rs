//! The live page of a watch.

use std::path::Path;
use std::sync::Arc;

use engine::{Engine, Event, Handle, Load};

pub use super::capture::Capture;
use crate::session::{Error, cache_folder};

/// The live page of a watch.
pub struct LivePage(serve::Page);

impl LivePage {
    /// Starts the server. `cache` is the folder of the cache, if the command line names one. `capture` is the
    /// capture from which the graph was started.
    pub fn start(
        engine: &Arc<Engine>,
        handle: Handle,
        graph: &Path,
        port: Option<u16>,
        cache: Option<&Path>,
        capture: Option<Capture>,
    ) -> Result<Self, Error> {
        let folder = cache_folder(cache)?.join("pages");
        let starter = capture.map(|capture| Box::new(capture) as Box<dyn serve::Starter>);
        let options = serve::Options { graph: graph.to_owned(), port, folder: Some(folder), starter };
        let page = serve::Page::start(engine.clone(), handle, options);
        page.map(Self).map_err(|error| Error::usage(error.to_string()))
    }

    /// The address to open in a browser.
    pub fn url(&self) -> String {
        self.0.url()
    }

    /// Shows a graph that was read.
    pub fn loaded(&self, load: &Load) {
        self.0.loaded(load);
    }

    /// Shows an event.
    pub fn show(&self, event: &Event) {
        self.0.show(event);
    }

    /// The settings that are tried on the page without being in the text.
    pub fn tried(&self) -> Vec<String> {
        self.0.tried()
    }
}
