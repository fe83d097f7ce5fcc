//! In place of the live page, in builds without the feature `serve`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use engine::{Engine, Event, Handle, Load};

use crate::session::Error;

/// The type of the live page in a build without it. It has no values.
pub enum LivePage {}

/// The type of a capture in a build without the live page. It has no values.
pub enum Capture {}

impl Capture {
    /// Returns an error that names the feature.
    pub fn open(_: &Path) -> Result<Self, Error> {
        Err(absent())
    }

    pub fn path(&self) -> PathBuf {
        match *self {}
    }
}

fn absent() -> Error {
    Error::usage("this program was built without the live page; build it with `--features serve`")
}

impl LivePage {
    /// Returns an error that names the feature.
    pub fn start(
        _: &Arc<Engine>,
        _: Handle,
        _: &Path,
        _: Option<u16>,
        _: Option<&Path>,
        _: Option<Capture>,
    ) -> Result<Self, Error> {
        Err(absent())
    }

    pub fn url(&self) -> String {
        match *self {}
    }

    pub fn loaded(&self, _: &Load) {
        match *self {}
    }

    pub fn show(&self, _: &Event) {
        match *self {}
    }

    pub fn tried(&self) -> Vec<String> {
        match *self {}
    }
}
