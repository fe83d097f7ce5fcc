//! Where a walk keeps the children that wait: one place for each thread, since to clear one for each ray took a fortieth of
//! the tracing.

use std::cell::Cell;

/// Most children that wait; a tree that needs more is replaced by a balanced one.
pub(super) const STACK: usize = 256;

/// Children, and where the ray enters them.
pub(super) type Stack = [(u32, f32); STACK];

thread_local! {
    /// That of this thread, while no walk has it.
    static SPARE: Cell<Option<Box<Stack>>> = const { Cell::new(None) };
}

/// What a walk finds that is given a stack, in which anything may stand.
#[inline(always)]
pub(super) fn with_stack<R>(walk: impl FnOnce(&mut Stack) -> R) -> R {
    let mut stack = SPARE.take().unwrap_or_else(|| Box::new([(0, 0.0); STACK]));
    let found = walk(&mut stack);
    SPARE.set(Some(stack));
    found
}
