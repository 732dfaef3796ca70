//! A small HTTP server for what a process reports about itself: read-only, guarded, gone within a second.
//!
//! ```text
//! TCP ── server: at most MAX_CONNECTIONS, with deadlines to ask, read and end ── guard: who may ask, and how ── routes
//! ```
//!
//! It is the only crate that names axum and hyper; crates that serve something take [`axum`] from here. It knows no page and
//! no number: the routes are handed to it.
//!
//! # Invariants
//!
//! * Nothing can be changed through it: only GET and HEAD exist.
//! * A page of another site cannot read it, whatever name it makes a browser believe in (DNS rebinding).
//! * A cancelled token ends it within a second, open event streams included.
//! * A client that does not read loses its place, and one that asks nothing loses it to the next.
//!
//! # Where to start
//!
//! [`HttpServer::bind`], then [`HttpServer::serve`] with a router and a [`Guard`].

mod error;
mod guard;
mod heads;
mod server;

pub use axum;
pub use error::Error;
pub use guard::{AccessToken, Guard};
pub use server::{HttpServer, parse_address};
