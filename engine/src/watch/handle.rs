//! Messages to the watching thread, and the handle to control it from outside.

use std::path::PathBuf;
use std::sync::mpsc::Sender;

use crate::run::event::Event;

/// A message to the watching thread.
pub(crate) enum Input {
    /// Some of these paths changed. The list is empty if the paths are unknown.
    Changed(Vec<PathBuf>),
    Event(Event),
    Ended,
    Quit,
}

/// Handle to end a watch from another thread, or to make the watch inspect its files.
#[derive(Clone)]
pub struct Handle(pub(crate) Sender<Input>);

impl Handle {
    /// Cancels the run and ends the watch. The results of finished nodes are kept.
    pub fn quit(&self) {
        // The watch may have ended already.
        let _ = self.0.send(Input::Quit);
    }

    /// Reports a possible change at these paths. `paths` is empty if the paths are unknown.
    pub fn hint(&self, paths: Vec<PathBuf>) {
        let _ = self.0.send(Input::Changed(paths));
    }
}
