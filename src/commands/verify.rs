//! `verify`: recomputes nodes of a bundle and compares their results.

use std::fs::File;
use std::num::NonZero;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use cache::TempFolder;
use clap::Args;
use engine::{Bundle, Verdict, VerifyOptions, verify};

use crate::session::{EngineArgs, Error, on_interrupt};
use crate::terminal::{self, Report};

/// Recomputes some nodes of a bundle from its inputs and reports whether the results are bit-identical.
#[derive(Debug, Args)]
pub struct Verify {
    /// The bundle
    bundle: PathBuf,
    /// Number of nodes to verify; the seed determines which
    #[arg(long, value_name = "K", default_value = "3")]
    sample: NonZero<usize>,
    /// Verify every node
    #[arg(long, conflicts_with = "sample")]
    all: bool,
    /// Seed for the random choice of nodes
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Also print the nodes that run
    #[arg(long, short)]
    verbose: bool,
    #[command(flatten)]
    engine: EngineArgs,
}

impl Verify {
    /// Prints one line per node. Returns exit code 1 if a result differs from the bundle.
    pub fn run(self) -> Result<u8, Error> {
        let named = |error: engine::BundleError| Error::of_file(&self.bundle, &error);
        let file = File::open(&self.bundle);
        let file = file.map_err(|error| Error::unreadable("bundle", &self.bundle, &error))?;
        let mut bundle = Bundle::open(file).map_err(named)?;
        let place = TempFolder::private()?;
        let options = VerifyOptions {
            sample: if self.all { usize::MAX } else { self.sample.get() },
            seed: self.seed,
            jobs: self.engine.jobs(),
            memory: self.engine.memory()?,
            folder: place.path(),
            cancel: on_interrupt()?,
        };
        let mut report = Report::lines(false);
        let verbose = self.verbose;
        let show = |event: engine::Event| {
            if verbose || matches!(event, engine::Event::Warning { .. }) {
                report.show(&event);
            }
        };
        let verified = verify(&mut bundle, &nodes::registry(), &options, show).map_err(named)?;
        // An interrupted run is not a failure.
        let stopped = options.cancel.load(Ordering::Relaxed);
        if let Some(failures) = verified.failures.as_ref().filter(|_| !stopped) {
            terminal::error(&failures.render(terminal::colours()));
        }
        let mut text = String::new();
        for line in &verified.differences {
            text.push_str(&format!("differs   {line}\n"));
        }
        for (id, verdict) in &verified.nodes {
            let line = match verdict {
                Verdict::Equal => format!("equal     {id}\n"),
                Verdict::Differs { output, difference } => {
                    let how = difference
                        .as_ref()
                        .map_or("different content (the value is not in the bundle)", |d| &d.summary);
                    format!("differs   {id}.{output}: {how}\n")
                }
                Verdict::OtherInputs => {
                    format!("unlike    {id}: its inputs differ from those in the bundle\n")
                }
                Verdict::NotReproducible => {
                    format!(
                        "external  {id}: made by a program, which is not run again; its result is not verified\n"
                    )
                }
                Verdict::Failed if stopped => continue,
                Verdict::Failed => format!("failed    {id}\n"),
            };
            text.push_str(&line);
        }
        let equal = verified.nodes.iter().filter(|(_, verdict)| *verdict == Verdict::Equal).count();
        let external =
            verified.nodes.iter().filter(|(_, verdict)| *verdict == Verdict::NotReproducible).count();
        let (tried, known) = (verified.nodes.len() - external, verified.known);
        let word = if stopped { "interrupted: " } else { "" };
        text.push_str(&format!(
            "{word}nodes recomputed: {tried}, with bit-identical results: {equal}; nodes with results in the bundle: {known}\n"
        ));
        terminal::print(&text)?;
        Ok(if stopped { 130 } else { u8::from(!verified.is_good()) })
    }
}
