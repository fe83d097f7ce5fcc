//! Notifications from the system through the `notify` crate.

use std::path::Path;

use notify::event::{AccessKind, AccessMode, EventKind};
use notify::{RecommendedWatcher, RecursiveMode, Watcher};

use crate::watch::files::Notifier;
use crate::watch::handle::Handle;

struct Listener(RecommendedWatcher);

/// Starts notifications, which are sent to `handle`. Returns an error text if the system provides none.
pub(crate) fn listen(handle: Handle) -> Result<Box<dyn Notifier>, String> {
    let notified = move |event: notify::Result<notify::Event>| match event {
        // Reading is frequent and does not matter.
        Ok(event) if matches!(event.kind, EventKind::Access(kind) if kind != AccessKind::Close(AccessMode::Write)) =>
            {}
        Ok(event) if !event.need_rescan() => handle.hint(event.paths),
        // Notifications were lost or failed, so all files are inspected.
        Ok(_) | Err(_) => handle.hint(Vec::new()),
    };
    match notify::recommended_watcher(notified) {
        Ok(watcher) => Ok(Box::new(Listener(watcher))),
        Err(error) => Err(error.to_string()),
    }
}

impl Notifier for Listener {
    fn listen(&mut self, folder: &Path) -> Result<(), String> {
        self.0.watch(folder, RecursiveMode::NonRecursive).map_err(|error| error.to_string())
    }

    fn ignore(&mut self, folder: &Path) {
        // A removed folder has no notifications anyway.
        let _ = self.0.unwatch(folder);
    }
}
