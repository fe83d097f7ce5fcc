//! The live page: a local HTTP server that shows a watched graph in a browser, with editors that write single
//! values back into its text.
//!
//! The text file is the only source of truth. The page reads the events of the watch, the checked graph and values
//! by digest. An edit replaces the bytes of one value, through [`engine::GraphText`], only if the file still has
//! the text that the page has shown. The server has no state that a restart would lose: the history of edits, the
//! port and the token are files in a folder next to the cache.
//!
//! # Requests
//! | request | answer |
//! |---|---|
//! | `GET /`, `/assets/..` | the page |
//! | `POST /session` `{token}` | a cookie, which all requests below need |
//! | `GET /events` | server-sent events: the whole state, then each event of the watch |
//! | `GET /graph` | nodes, wires, layout, parameters with documentation and ranges, text, mistakes |
//! | `GET /value/DIGEST` | the pictures or the report of a value: names, sizes, encodings, ranges |
//! | `GET /value/DIGEST/N.png` | picture N for display; `exposure` in stops, `size` of the longest side in pixels |
//! | `GET /value/DIGEST/N.f32`, `N.f16` | its samples, little-endian, row by row |
//! | `GET /difference/DIGEST/N/DIGEST/N` | the measures of the kind `compare` for two pictures |
//! | `GET /difference/../flip.f32` | FLIP of each pixel, little-endian, row by row |
//! | `GET /references` | picture files near the graph, each with a handle that stands for a digest above |
//! | `GET /graphs` | other graphs near the graph, each with the digests of its pictures that are in the cache |
//! | `GET /trade` | knobs, presets with forecasts, and skipped work |
//! | `POST /preset` `{digest, preset, write}` | tries or writes the values of a preset |
//! | `GET /place` | the place: axes, captures, meshes, objects with their poses, cameras, probes |
//! | `GET /splats/DIGEST`, `/mesh/DIGEST`, `/object/DIGEST` | a value of the place as packed bytes, simplified if it is large |
//! | `POST /ground` `{digest, eye, way, focal_px}` | the first surface of a mesh or of splats along a ray |
//! | `POST /set` `{digest, node, field, at, value, also}` | writes a value, or several of one node, into the text |
//! | `POST /try`, same body or `null` | uses a value for the next runs without writing it, or ends that |
//! | `POST /plan`, same body | the nodes that would run, and the forecast of their time |
//! | `POST /start` `{digest, object, stand}` | puts an object into a captured place: replaces the text with a whole graph |
//! | `POST /up` `{digest, up}` | rotates a captured place, so that an axis of the capture points up |
//! | `GET /objects` | files of objects near the graph |
//! | `POST /add` `{digest, object, place}` | adds an object to the graph: its nodes, and a wire into each `PathTrace` |
//! | `POST /undo`, `/redo` `{digest}` | undoes the last change of the text, or redoes the change that was undone last |
//!
//! # Security
//! Other web sites and other local servers can send requests to this server through the user's browser. The server
//! listens on the loopback interface only, answers only requests that name its exact address as host, needs a
//! cookie that is given for the token in the printed address, and refuses changes that do not come from its own
//! origin (see `door`). It writes only the file of the watched graph, and never a graph of an unpacked bundle. No
//! request contains a path. The page inserts text from graphs as text only, and its content security policy forbids
//! inline scripts.

mod addition;
mod assets;
mod difference;
mod door;
mod editor;
mod error;
mod events;
mod graphs;
mod ground;
mod history;
mod live;
mod names;
mod near;
mod packed;
mod page;
mod place;
mod presets;
mod references;
mod routes;
mod save;
mod starter;
mod state;
mod surface;
mod thing;
mod thinned;
mod track;
mod values;
mod view;

pub use error::Error;
pub use page::{Options, Page};
pub use starter::{AXES, Bare, Proposal, Stand, Starter};
