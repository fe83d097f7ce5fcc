//! Tests of the server by raw HTTP requests, with a real watch, files and cache.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test may stop at the first surprise")]

mod additions;
mod compare;
mod edits;
mod events;
mod full_disk;
mod lab;
mod place;
mod round_trip;
mod security;
mod start;
mod trade;
mod values;
