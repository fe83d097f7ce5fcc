//! The example crate `examples/own-kinds`, with its unit tests and its test of the rules for kinds. A change of the library
//! that breaks the crate breaks this test. The crate itself is outside the workspace, as the crate of a user is.
#![allow(missing_docs, reason = "the crate is documented where it is")]

extern crate self as own_kinds;

#[path = "../examples/own-kinds/src/lib.rs"]
mod library;
#[expect(dead_code, reason = "the program is compiled, not run")]
#[path = "../examples/own-kinds/src/main.rs"]
mod main;
#[path = "../examples/own-kinds/tests/table.rs"]
mod table;

use library::{draw_histogram, histogram, measure_histogram, program};
