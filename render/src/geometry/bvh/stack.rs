//! The stack of a traversal. There is one per thread, because creating a stack for every ray took 2.5 % of the
//! tracing time.

use std::cell::Cell;

/// Maximum number of children that wait to be visited. A tree that needs more is replaced with a balanced tree.
pub(super) const STACK: usize = 256;

/// Waiting children, each with the distance at which the ray enters it.
pub(super) type Stack = [(u32, f32); STACK];

thread_local! {
    /// The stack of this thread; `None` while a traversal uses it.
    static SPARE: Cell<Option<Box<Stack>>> = const { Cell::new(None) };
}

/// Runs a traversal with a stack. The initial content of the stack is unspecified.
#[inline(always)]
pub(super) fn with_stack<R>(walk: impl FnOnce(&mut Stack) -> R) -> R {
    let mut stack = SPARE.take().unwrap_or_else(|| Box::new([(0, 0.0); STACK]));
    let found = walk(&mut stack);
    SPARE.set(Some(stack));
    found
}
