//! The watched files, and detection of changes.
//!
//! Notifications of the system are only hints: they may be late, repeated or lost. A file counts as changed if its
//! stamp differs, or if a notification names it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use cache::FileStamp;

/// Source of notifications about changes in folders.
pub(crate) trait Notifier: Send {
    /// Starts notifications for a folder, without its subfolders.
    fn listen(&mut self, folder: &Path) -> Result<(), String>;
    /// Stops notifications for a folder.
    fn ignore(&mut self, folder: &Path);
}

/// The watched files.
pub(crate) struct WatchedFiles {
    notifier: Option<Box<dyn Notifier>>,
    /// Reason why there are no notifications. `None` if there are notifications, or if the reason has been reported
    /// already.
    failure: Option<String>,
    /// Stamp of each file when it was last inspected; `None` if the file was missing.
    stamps: BTreeMap<PathBuf, Option<FileStamp>>,
    /// The paths that lead to the watched files. The key is the path of a link on the way to a file, or of the file
    /// itself; the value is the watched file.
    names: BTreeMap<PathBuf, PathBuf>,
    /// Folders for which notifications were started, each with its identity at that time.
    folders: BTreeMap<PathBuf, Option<Identity>>,
    /// Watched files named by notifications since the last inspection.
    touched: BTreeSet<PathBuf>,
}

/// Identity of a folder: its device and inode numbers.
type Identity = (u64, u64);

impl WatchedFiles {
    /// An empty set of watched files. Without a notifier, only [`look`](Self::look) finds changes.
    pub fn new(notifier: Result<Box<dyn Notifier>, String>) -> Self {
        let (notifier, failure) = match notifier {
            Ok(notifier) => (Some(notifier), None),
            Err(why) => (None, Some(why)),
        };
        Self {
            notifier,
            failure,
            stamps: BTreeMap::new(),
            names: BTreeMap::new(),
            folders: BTreeMap::new(),
            touched: BTreeSet::new(),
        }
    }

    /// True if there are notifications, so that polling is not needed.
    pub fn has_notifier(&self) -> bool {
        self.notifier.is_some()
    }

    /// Returns the reason why there are no notifications. Later calls return `None`.
    pub fn take_failure(&mut self) -> Option<String> {
        self.failure.take()
    }

    /// Watches exactly these files. Returns true if one of them was not watched before: it may have changed
    /// unnoticed in the meantime.
    pub fn follow(&mut self, paths: &[PathBuf]) -> bool {
        let mut stamps = BTreeMap::new();
        let mut new = false;
        for path in paths {
            let Ok(path) = std::path::absolute(path) else { continue };
            let known = self.stamps.get(&path).copied();
            new |= known.is_none();
            stamps.insert(path, known);
        }
        let paths: Vec<PathBuf> = stamps.keys().cloned().collect();
        self.listen(&paths);
        // Stamps are taken after notifications start, so that no change is missed in between.
        self.stamps = stamps
            .into_iter()
            .map(|(path, known)| (path.clone(), known.unwrap_or_else(|| stamp(&path))))
            .collect();
        new
    }

    /// Starts notifications for every folder in which a change may affect the file at one of the paths.
    fn listen(&mut self, paths: &[PathBuf]) {
        self.names = paths
            .iter()
            .flat_map(|path| names_to(path).into_iter().map(move |name| (name, path.clone())))
            .collect();
        let wanted: BTreeMap<PathBuf, Option<Identity>> = self
            .names
            .keys()
            .filter_map(|name| name.parent())
            .map(|folder| (folder.to_owned(), identity(folder)))
            .collect();
        let Some(notifier) = &mut self.notifier else { return };
        for (folder, was) in &self.folders {
            if wanted.get(folder) != Some(was) {
                notifier.ignore(folder);
            }
        }
        for (folder, is) in &wanted {
            if self.folders.get(folder) != Some(is)
                && let Err(why) = notifier.listen(folder)
                && folder.exists()
            {
                self.failure = Some(format!("{}: {why}", folder.display()));
            }
        }
        self.folders = wanted;
        if self.failure.is_some() {
            // Notifications for only some folders would be misleading.
            self.notifier = None;
        }
    }

    /// Handles a notification about changes at `paths`. Returns true if the files should be inspected soon.
    pub fn notified(&mut self, paths: &[PathBuf]) -> bool {
        let mut ours = paths.is_empty();
        for path in paths {
            if let Some(file) = self.names.get(path) {
                self.touched.insert(file.clone());
                ours = true;
            }
            ours |= self.folders.contains_key(path);
        }
        ours
    }

    /// The watched files that changed, or may have changed, since the last inspection.
    pub fn look(&mut self) -> BTreeSet<PathBuf> {
        let mut changed = std::mem::take(&mut self.touched);
        for (path, known) in &mut self.stamps {
            let now = stamp(path);
            if now != *known {
                *known = now;
                changed.insert(path.clone());
            }
        }
        let moved = self.folders.iter().any(|(folder, was)| identity(folder) != *was);
        if moved || !changed.is_empty() {
            // A link may have a new target, or a folder may be a different one.
            let paths: Vec<PathBuf> = self.stamps.keys().cloned().collect();
            self.listen(&paths);
        }
        changed
    }

    /// The watched files.
    pub fn paths(&self) -> Vec<PathBuf> {
        self.stamps.keys().cloned().collect()
    }

    /// Number of watched files.
    pub fn count(&self) -> usize {
        self.stamps.len()
    }

    /// Marks files as changed for the next inspection, even if their stamps are equal.
    pub fn suspect(&mut self, paths: impl IntoIterator<Item = PathBuf>) {
        self.touched.extend(paths);
    }
}

fn stamp(path: &Path) -> Option<FileStamp> {
    FileStamp::of(path).ok()
}

fn identity(folder: &Path) -> Option<Identity> {
    stamp(folder).map(|stamp| (stamp.dev, stamp.inode))
}

/// Maximum number of links on the way to a file; a longer chain counts as a cycle.
const MOST_LINKS: usize = 40;

/// The paths that determine which file an absolute path refers to. These are each link on the way, and at the end
/// either the file itself or the first part of the path that does not exist. Links in the folders of these paths
/// are resolved.
fn names_to(path: &Path) -> Vec<PathBuf> {
    let mut names = Vec::new();
    let mut at = PathBuf::new();
    let mut left: Vec<PathBuf> =
        path.components().rev().map(|part| PathBuf::from(part.as_os_str())).collect();
    while let Some(part) = left.pop() {
        match part.components().next() {
            Some(Component::ParentDir) => {
                at.pop();
                continue;
            }
            Some(Component::CurDir) | None => continue,
            Some(Component::RootDir | Component::Prefix(_)) => {
                at.push(&part);
                continue;
            }
            Some(Component::Normal(_)) => at.push(&part),
        }
        match std::fs::symlink_metadata(&at) {
            Ok(found) if found.is_symlink() && names.len() < MOST_LINKS => {
                names.push(at.clone());
                let target = std::fs::read_link(&at).unwrap_or_default();
                at.pop();
                left.extend(target.components().rev().map(|part| PathBuf::from(part.as_os_str())));
            }
            Ok(_) if !left.is_empty() => {}
            // The file itself, or the first missing name.
            _ => {
                names.push(at);
                return names;
            }
        }
    }
    names
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;

    type Log = Arc<Mutex<Vec<String>>>;

    struct TestNotifier(Log, Option<&'static str>);

    impl Notifier for TestNotifier {
        fn listen(&mut self, folder: &Path) -> Result<(), String> {
            if self.1.is_some_and(|limit| folder.ends_with(limit)) {
                return Err("no watches are left".to_owned());
            }
            self.0.lock().unwrap().push(format!("+{}", folder.file_name().unwrap().to_string_lossy()));
            Ok(())
        }
        fn ignore(&mut self, folder: &Path) {
            self.0.lock().unwrap().push(format!("-{}", folder.file_name().unwrap().to_string_lossy()));
        }
    }

    struct Fixture {
        folder: tempfile::TempDir,
        log: Log,
        files: WatchedFiles,
    }

    impl Fixture {
        fn new(limit: Option<&'static str>) -> Self {
            let (folder, log) = (tempfile::tempdir().unwrap(), Log::default());
            std::fs::create_dir(folder.path().join("home")).unwrap();
            let files = WatchedFiles::new(Ok(Box::new(TestNotifier(log.clone(), limit))));
            Self { folder, log, files }
        }

        fn path(&self, name: &str) -> PathBuf {
            self.folder.path().canonicalize().unwrap().join(name)
        }

        fn write(&self, name: &str, text: &str) {
            std::fs::write(self.path(name), text).unwrap();
        }

        /// True if the file counts as changed. Panics if the change is reported a second time.
        fn changed(&mut self) -> bool {
            let changed = !self.files.look().is_empty();
            assert!(self.files.look().is_empty(), "reported once");
            changed
        }

        fn log(&self) -> String {
            std::mem::take(&mut *self.log.lock().unwrap()).join(" ")
        }
    }

    #[test]
    fn every_way_to_save_is_a_change_and_reading_is_none() {
        let mut place = Fixture::new(None);
        place.write("home/a.ron", "one");
        let path = place.path("home/a.ron");
        assert!(place.files.follow(std::slice::from_ref(&path)));
        assert!(!place.files.follow(std::slice::from_ref(&path)), "it is known by now");
        assert_eq!(place.log(), "+home");
        assert!(!place.changed());
        std::fs::read(&path).unwrap();
        assert!(!place.changed());
        // Writing in place.
        place.write("home/a.ron", "three");
        assert!(place.changed());
        // Saving by rename, like `sed -i` and `git checkout`.
        place.write("home/.a.swp", "fives");
        std::fs::rename(place.path("home/.a.swp"), &path).unwrap();
        assert!(place.changed());
        // Truncating first.
        place.write("home/a.ron", "");
        assert!(place.changed());
        place.write("home/a.ron", "whole");
        assert!(place.changed());
        std::fs::remove_file(&path).unwrap();
        assert!(place.changed());
        assert!(!place.changed(), "it is still missing");
        place.write("home/a.ron", "back");
        assert!(place.changed());
        assert_eq!(place.log(), "", "the folder stayed the same all the time");
    }

    #[test]
    fn an_edit_that_no_stamp_shows_is_seen_where_a_hint_names_it() {
        let mut place = Fixture::new(None);
        place.write("home/a.ron", "one");
        let path = place.path("home/a.ron");
        place.files.follow(std::slice::from_ref(&path));
        assert!(!place.files.notified(&[place.path("home/other.ron")]), "not a watched file");
        assert!(!place.changed());
        assert!(place.files.notified(std::slice::from_ref(&path)));
        assert!(place.changed());
        assert!(place.files.notified(&[]), "events were lost, so the files must be inspected");
        assert!(!place.changed());
    }

    #[cfg(unix)]
    #[test]
    fn a_link_that_leads_elsewhere_is_a_change() {
        use std::os::unix::fs::symlink;
        // Like mounted configuration: graph.ron -> data/graph.ron, data -> v1, and then data is swapped.
        let mut place = Fixture::new(None);
        for (version, text) in [("v1", "one"), ("v2", "two")] {
            std::fs::create_dir(place.path(version)).unwrap();
            place.write(&format!("{version}/graph.ron"), text);
        }
        symlink("v1", place.path("data")).unwrap();
        symlink("../data/graph.ron", place.path("home/graph.ron")).unwrap();
        let path = place.path("home/graph.ron");
        place.files.follow(std::slice::from_ref(&path));
        let root = place.path("").file_name().unwrap().to_string_lossy().into_owned();
        let log = place.log();
        for folder in [root.as_str(), "home", "v1"] {
            assert!(log.contains(&format!("+{folder}")), "{folder} in {log}");
        }
        assert!(place.files.notified(&[place.path("v1/graph.ron")]), "the file behind the links is watched");
        assert!(place.changed());
        symlink("v2", place.path("new")).unwrap();
        std::fs::rename(place.path("new"), place.path("data")).unwrap();
        assert!(place.files.notified(&[place.path("data")]), "so is the link");
        assert!(place.changed());
        assert_eq!(place.log(), "-v1 +v2");
        place.write("v2/graph.ron", "three");
        assert!(place.changed());
    }

    #[cfg(unix)]
    #[test]
    fn links_in_a_circle_end() {
        let place = Fixture::new(None);
        std::os::unix::fs::symlink("b", place.path("a")).unwrap();
        std::os::unix::fs::symlink("a", place.path("b")).unwrap();
        assert_eq!(names_to(&place.path("a")).len(), MOST_LINKS + 1);
    }

    #[test]
    fn a_folder_that_went_away_is_waited_for() {
        let mut place = Fixture::new(None);
        std::fs::create_dir(place.path("home/deep")).unwrap();
        place.write("home/deep/a.ron", "one");
        let path = place.path("home/deep/a.ron");
        place.files.follow(std::slice::from_ref(&path));
        assert_eq!(place.log(), "+deep");
        std::fs::rename(place.path("home/deep"), place.path("home/gone")).unwrap();
        assert!(place.files.notified(&[place.path("home/deep")]), "the folder itself was moved");
        assert!(place.changed());
        assert_eq!(place.log(), "-deep +home", "the folder above reports its return");
        std::fs::rename(place.path("home/gone"), place.path("home/deep")).unwrap();
        assert!(place.files.notified(&[place.path("home/deep")]));
        assert!(place.changed());
        assert_eq!(place.log(), "-home +deep");
        // Another folder of the same name, in which the file may even have an equal stamp.
        std::fs::rename(place.path("home/deep"), place.path("home/gone")).unwrap();
        std::fs::create_dir(place.path("home/deep")).unwrap();
        std::fs::rename(place.path("home/gone/a.ron"), place.path("home/deep/a.ron")).unwrap();
        place.files.look();
        assert_eq!(place.log(), "-deep +deep");
    }

    #[test]
    fn where_no_folder_can_be_heard_of_it_says_why_and_looks() {
        let mut place = Fixture::new(Some("home"));
        place.write("home/a.ron", "one");
        let path = place.path("home/a.ron");
        place.files.follow(std::slice::from_ref(&path));
        assert!(!place.files.has_notifier());
        assert!(place.files.take_failure().is_some_and(|why| why.contains("no watches are left")));
        assert!(place.files.take_failure().is_none(), "reported once");
        place.write("home/a.ron", "three");
        assert!(place.changed());
    }
}
