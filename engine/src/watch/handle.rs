//! What wakes the thread that decides, and the handle that does so from outside.

use std::path::PathBuf;
use std::sync::mpsc::Sender;

use crate::run::event::Event;

/// What wakes the thread that decides.
pub(crate) enum Input {
    /// Something happened at these paths; none stands for anywhere.
    Heard(Vec<PathBuf>),
    Told(Event),
    Ended,
    Quit,
}

/// Ends a watch from another thread, or makes it look at its files.
#[derive(Clone)]
pub struct Handle(pub(crate) Sender<Input>);

impl Handle {
    /// Stops the run and the watch; what is finished is kept.
    pub fn quit(&self) {
        // A watch that is over has nothing to end.
        let _ = self.0.send(Input::Quit);
    }

    /// Something may have changed at these paths; none stands for anywhere.
    pub fn hint(&self, paths: Vec<PathBuf>) {
        let _ = self.0.send(Input::Heard(paths));
    }
}
