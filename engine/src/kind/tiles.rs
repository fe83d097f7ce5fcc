//! Tiles: parts of one node's work that run on all free threads.
//!
//! The thread that runs the code of a node works through its tiles, and *helpers* join in as long as fewer than the
//! permitted number of threads are busy. A helper checks this before each tile. A node that starts therefore gets a
//! processor core within the time of one tile, whatever else is running. No thread ever runs the code of one node
//! within the code of another.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::value::error::NodeError;

/// Time after which a helper ends its turn, so that its thread can do other work.
const TURN: Duration = Duration::from_millis(1);

/// The limit on the number of threads that compute at once, and the threads that help with tiles.
pub(crate) struct Threads {
    limit: usize,
    busy: AtomicUsize,
    helpers: OnceLock<rayon::ThreadPool>,
}

/// Guard that counts a thread as busy until the guard is dropped.
struct Busy<'t>(&'t AtomicUsize);

impl Drop for Busy<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Threads {
    /// Creates a set of threads of which at most `limit` compute at the same time. More may compute for the time of
    /// one tile.
    pub fn new(limit: usize) -> Self {
        Self { limit: limit.max(1), busy: AtomicUsize::new(0), helpers: OnceLock::new() }
    }

    /// Runs `code` immediately, even if the limit is reached. Meanwhile the calling thread counts as busy, so that
    /// a helper stops after its current tile.
    pub fn occupied<T>(&self, code: impl FnOnce() -> T) -> T {
        self.busy.fetch_add(1, Ordering::Relaxed);
        let _busy = Busy(&self.busy);
        code()
    }

    fn has_room(&self) -> bool {
        self.busy.load(Ordering::Relaxed) < self.limit
    }

    /// Counts the calling thread as busy until the returned guard is dropped. Returns `None` if the limit is
    /// reached.
    fn join(&self) -> Option<Busy<'_>> {
        let free = |busy| (busy < self.limit).then_some(busy + 1);
        self.busy.fetch_update(Ordering::Relaxed, Ordering::Relaxed, free).ok().map(|_| Busy(&self.busy))
    }

    /// The pool of helpers; `None` if the limit is one thread, so that there are no helpers.
    fn helpers(&self) -> Result<Option<&rayon::ThreadPool>, NodeError> {
        if self.limit == 1 {
            return Ok(None);
        }
        if let Some(pool) = self.helpers.get() {
            return Ok(Some(pool));
        }
        let builder = rayon::ThreadPoolBuilder::new().num_threads(self.limit - 1);
        let pool = builder.thread_name(|index| format!("tiles-{index}")).build().map_err(|error| {
            NodeError::new(format!("cannot start the threads of the run: {error}"))
                .hint("use fewer threads with `--jobs`")
        })?;
        Ok(Some(self.helpers.get_or_init(|| pool)))
    }
}

/// Runs `tile` for every index below `count`, or until `stopped` returns true. If `threads` is `None`, helpers come
/// from the rayon pool of the caller.
pub(crate) fn run_tiles(
    threads: Option<&Threads>,
    count: usize,
    stopped: &(dyn Fn() -> bool + Sync),
    tile: &(dyn Fn(usize) + Sync),
) -> Result<(), NodeError> {
    let pool = if count > 1 { threads.map(Threads::helpers).transpose()? } else { Some(None) };
    let most = match (threads, pool) {
        (_, Some(None)) => 0,
        (Some(threads), _) => threads.limit - 1,
        (None, _) => rayon::current_num_threads() - 1,
    };
    let tiles = Tiles {
        next: AtomicUsize::new(0),
        count,
        helping: AtomicUsize::new(0),
        most: most.min(count.saturating_sub(1)),
        ended: AtomicBool::new(false),
        threads,
        stopped,
        tile,
    };
    match pool {
        Some(None) => while tiles.run_next() {},
        Some(Some(pool)) => pool.in_place_scope(|scope| tiles.lead(scope)),
        None => rayon::in_place_scope(|scope| tiles.lead(scope)),
    }
    if tiles.ended.into_inner() { Err(NodeError::cancelled()) } else { Ok(()) }
}

struct Tiles<'t> {
    next: AtomicUsize,
    count: usize,
    /// Number of helpers that are active.
    helping: AtomicUsize,
    most: usize,
    /// Set when the run is cancelled or a tile panicked; the remaining tiles are skipped.
    ended: AtomicBool,
    threads: Option<&'t Threads>,
    stopped: &'t (dyn Fn() -> bool + Sync),
    tile: &'t (dyn Fn(usize) + Sync),
}

impl<'t> Tiles<'t> {
    /// Runs tiles on the thread of the node until all have been started.
    fn lead<'s>(&'s self, scope: &rayon::Scope<'s>) {
        for _ in 0..self.most {
            self.call_helper(scope);
        }
        while self.run_next() {
            self.call_helper(scope);
        }
    }

    /// Starts another helper if fewer threads are busy than permitted.
    fn call_helper<'s>(&'s self, scope: &rayon::Scope<'s>) {
        let wanted = |helping| (helping < self.most).then_some(helping + 1);
        if self.next.load(Ordering::Relaxed) < self.count
            && self.threads.is_none_or(Threads::has_room)
            && self.helping.fetch_update(Ordering::Relaxed, Ordering::Relaxed, wanted).is_ok()
        {
            scope.spawn(|scope| self.help(scope));
        }
    }

    /// Runs tiles on a helper for the time [`TURN`]. The helper then spawns its next turn instead of continuing the
    /// loop, so that the thread can do other work in between.
    fn help<'s>(&'s self, scope: &rayon::Scope<'s>) {
        let start = Instant::now();
        loop {
            let busy = self.threads.map(Threads::join);
            if matches!(busy, Some(None)) || !self.run_next() {
                self.helping.fetch_sub(1, Ordering::Relaxed);
                return;
            }
            drop(busy);
            if start.elapsed() > TURN {
                self.call_helper(scope);
                return scope.spawn(|scope| self.help(scope));
            }
        }
    }

    /// Runs the next tile. Returns false if no tile is left, or if the run has ended.
    fn run_next(&self) -> bool {
        if self.ended.load(Ordering::Relaxed) {
            return false;
        }
        let index = self.next.fetch_add(1, Ordering::Relaxed);
        if index >= self.count {
            return false;
        }
        if (self.stopped)() {
            self.ended.store(true, Ordering::Relaxed);
            return false;
        }
        catch_unwind(AssertUnwindSafe(|| (self.tile)(index))).unwrap_or_else(|panic| {
            self.ended.store(true, Ordering::Relaxed);
            resume_unwind(panic)
        });
        true
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    fn sorted(made: Mutex<Vec<usize>>) -> Vec<usize> {
        let mut made = made.into_inner().expect("no tile panicked");
        made.sort_unstable();
        made
    }

    #[test]
    fn every_tile_runs_once_however_many_threads_there_are() {
        for (limit, count) in [(1, 100), (2, 1), (2, 1000), (7, 0), (7, 3), (7, 10_000)] {
            let (threads, made) = (Threads::new(limit), Mutex::new(Vec::new()));
            let tile = |index| made.lock().expect("no tile panicked").push(index);
            threads
                .occupied(|| run_tiles(Some(&threads), count, &|| false, &tile))
                .expect("nothing stops it");
            assert_eq!(sorted(made), (0..count).collect::<Vec<_>>(), "{limit} {count}");
            assert_eq!(threads.busy.into_inner(), 0, "every thread has left");
        }
    }

    #[test]
    fn tiles_may_have_tiles() {
        let (threads, made) = (Threads::new(3), Mutex::new(Vec::new()));
        let inner = |outer: usize| {
            let tile = |index| made.lock().expect("no tile panicked").push(outer * 50 + index);
            run_tiles(Some(&threads), 50, &|| false, &tile).expect("nothing stops it");
        };
        threads.occupied(|| run_tiles(Some(&threads), 20, &|| false, &inner)).expect("nothing stops it");
        assert_eq!(sorted(made), (0..1000).collect::<Vec<_>>());
    }

    // This test fails if helpers do not call `join` before each tile, since they then keep running.
    #[test]
    fn helpers_make_room_within_a_tile() {
        let (threads, helped) = (Threads::new(2), AtomicUsize::new(0));
        let (both, own) = (AtomicBool::new(false), std::thread::current().id());
        let pause = || std::thread::sleep(Duration::from_millis(1));
        let tile = |index: usize| {
            if std::thread::current().id() != own {
                helped.fetch_add(1, Ordering::Relaxed);
                both.store(true, Ordering::Relaxed);
            } else if index == 0 {
                while !both.load(Ordering::Relaxed) {
                    pause();
                }
                // Another node starts. The helper may finish its current tile, but no more.
                threads.busy.fetch_add(1, Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(30));
                let before = helped.load(Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(30));
                assert_eq!(helped.load(Ordering::Relaxed), before, "the helper has left");
                threads.busy.fetch_sub(1, Ordering::Relaxed);
                both.store(false, Ordering::Relaxed);
            }
            pause();
        };
        threads.occupied(|| run_tiles(Some(&threads), 200, &|| false, &tile)).expect("nothing stops it");
        assert!(both.into_inner(), "and comes back");
    }

    #[test]
    fn a_panic_and_a_stop_end_the_rest() {
        let (threads, ran) = (Threads::new(2), AtomicUsize::new(0));
        let run = |stop_at: usize, panic_at: usize| {
            ran.store(0, Ordering::Relaxed);
            let tile = |index: usize| {
                ran.fetch_add(1, Ordering::Relaxed);
                assert_ne!(index, panic_at, "polling was requested");
                std::thread::sleep(Duration::from_micros(100));
            };
            let stopped = || ran.load(Ordering::Relaxed) >= stop_at;
            let code = || threads.occupied(|| run_tiles(Some(&threads), 10_000, &stopped, &tile));
            catch_unwind(AssertUnwindSafe(code))
        };
        assert!(run(50, usize::MAX).is_ok_and(|outcome| outcome.is_err_and(|error| error.is_cancelled())));
        assert!(ran.load(Ordering::Relaxed) < 60);
        assert!(run(usize::MAX, 50).is_err());
        assert!(ran.load(Ordering::Relaxed) < 9000);
        assert_eq!(threads.busy.load(Ordering::Relaxed), 0);
    }
}
