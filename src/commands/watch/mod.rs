//! `watch`: runs a graph again whenever it or a file it reads changes.

#[cfg(feature = "serve")]
mod capture;
#[cfg(not(feature = "serve"))]
#[path = "absent.rs"]
mod page;
#[cfg(feature = "serve")]
mod page;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use engine::{Graph, Load, Refusal, WatchOptions};
use page::{Capture, LivePage};

use crate::session::origin::is_written_once;
use crate::session::{EngineArgs, Error, GraphArgs, RemoteArgs, at_end_of_input};
use crate::terminal::{self, Report};

/// Runs a graph again whenever it or a file it reads changes. Ctrl-C ends the command.
///
/// A slow picture is first shown as a rough preview, which is then refined. While the graph has mistakes, the last
/// picture is kept.
#[derive(Debug, Args)]
#[command(mut_arg("graph", |graph| graph.help("The graph file (RON); with `--serve` also a captured place, for which `graph.ron` is written in the current folder")))]
#[command(mut_arg("inputs", |inputs| inputs.help("For the graph of an unpacked bundle: a folder whose files it may read; may be repeated")))]
#[command(mut_arg("other_versions", |other| other.hide(true)))]
pub struct Watch {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    #[command(flatten)]
    remote: RemoteArgs,
    /// Output folder of the sinks
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON object per line on standard output
    #[arg(long)]
    pub json: bool,
    /// Stop when standard input reaches its end, as after Ctrl-C. A program that starts this one and keeps the other
    /// end of a pipe open thus also stops it by ending, even if it is killed
    #[arg(long)]
    stop_at_eof: bool,
    /// Also print cached nodes, counts, and all notes of nodes
    #[arg(long, short)]
    verbose: bool,
    /// Skip the rough previews
    #[arg(long)]
    no_preview: bool,
    /// Check the files every half second instead of listening to their folders
    #[arg(long)]
    poll: bool,
    /// Also serve the live page, which shows the graph and its pictures in a browser and can edit values in the
    /// graph file. Prints the address to open, which contains a secret
    #[arg(long)]
    serve: bool,
    /// Port of the live page [default: the port that was used last, or any free port]
    #[arg(long, value_name = "PORT", requires = "serve")]
    port: Option<u16>,
}

/// The reason why a bundle or a picture cannot be watched.
const WRITTEN_ONCE: &str = "a bundle or a picture does not change; to edit and watch a bundle, unpack it with `lightharmony unpack` and watch `graph.ron` in the new folder";

/// True if a path names a captured place and not a graph.
fn is_capture(path: &Path) -> bool {
    let ends = |end: &str| path.extension().is_some_and(|known| known.eq_ignore_ascii_case(end));
    path.is_dir() || ["ply", "spz", "sog", "splat", "ksplat", "glb", "gltf"].into_iter().any(ends)
}

impl Watch {
    /// Watches until it is interrupted.
    pub fn run(self) -> Result<u8, Error> {
        if self.graph.graph == Path::new("-") {
            return Err(Error::usage(
                "only a file can be watched: `-` is standard input, which is read once",
            ));
        }
        if is_written_once(&self.graph.graph) {
            return Err(Error::usage(WRITTEN_ONCE));
        }
        let mut arguments = self.graph;
        let capture = match self.serve && is_capture(&arguments.graph) {
            true => Some(Capture::open(&arguments.graph)?),
            false => None,
        };
        if let Some(capture) = &capture {
            arguments.graph = capture.path();
        }
        let mut report = if self.json { Report::json() } else { Report::lines(self.verbose) };
        let engine = self.engine.open()?.keeping();
        let (engine, remote) =
            self.remote.connect(engine, &AtomicBool::new(false), |warning| report.show(warning))?;
        let engine = Arc::new(engine);
        let out = self.out.clone();
        let mut options = WatchOptions { out: self.out, poll: self.poll, ..WatchOptions::default() };
        if self.no_preview {
            options.refine = None;
        }
        let watch = engine::Watch::new(options);
        let page = match self.serve {
            true => {
                let (handle, cache) = (watch.handle(), self.engine.cache.as_deref());
                Some(LivePage::start(&engine, handle, &arguments.graph, self.port, cache, capture)?)
            }
            false => None,
        };
        let (handle, asked) = (watch.handle(), AtomicBool::new(false));
        ctrlc::set_handler(move || {
            // The first Ctrl-C stops gracefully, the second at once.
            if asked.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
            handle.quit();
        })?;
        if self.stop_at_eof {
            let handle = watch.handle();
            at_end_of_input(move || handle.quit());
        }
        if let Some(page) = &page {
            match self.json {
                true => terminal::json_line(&serde_json::json!({"event": "page", "url": page.url()})),
                false => terminal::print(&format!("live page: {}\n", page.url()))?,
            }
        }
        let (mut graph, colour) = (arguments, terminal::colours() && !self.json);
        let settings = graph.set.len();
        let mut last: Option<(Arc<Graph>, Vec<usize>)> = None;
        let load = |same_files: bool| {
            let mut texts = Vec::new();
            let tried = page.as_ref().map(LivePage::tried).unwrap_or_default();
            // With other settings, an equal text is another graph.
            let same_settings = graph.set[settings..] == tried[..];
            graph.set.splice(settings.., tried);
            let known = last.as_ref().filter(|_| same_files && same_settings);
            let loaded = graph.load_again(known, &mut texts);
            last = loaded.as_ref().ok().map(|loaded| (loaded.graph.clone(), loaded.only.clone()));
            let loaded = loaded.and_then(|loaded| match loaded.unpacked {
                None => loaded.check_outputs(&out).map(|()| (loaded.graph, loaded.only)),
                Some(_) => Err(Error::usage(WRITTEN_ONCE)),
            });
            let refusal = |error| match error {
                Error::Graph(mistakes) => Refusal::mistakes(&mistakes, colour),
                other => Refusal::other(other.to_string()),
            };
            let load = Load { graph: loaded.map_err(refusal), texts };
            if let Some(page) = &page {
                page.loaded(&load);
            }
            load
        };
        let show = |event| {
            report.show(&event);
            if let Some(page) = &page {
                page.show(&event);
            }
        };
        let wrong = watch.run(&engine, load, show);
        match remote {
            Some(remote) if self.json => terminal::json_line(&remote.json()),
            Some(remote) => remote.summary().iter().for_each(|line| terminal::remark(line)),
            None => {}
        }
        if !self.json {
            for path in wrong {
                terminal::remark(&format!("{} does not show the current graph", path.display()));
            }
        }
        Ok(130)
    }
}
