//! The live page of a run: what an observer sees of it, in a browser and as text.
//!
//! ```text
//! network  ── follow ──▶ page: state (RunView), events (who listens) ──▶ routes ── HTTP ──▶ assets in a browser
//! run directory ───────▶      ▲                                     └─▶ text: one screen
//!                             └── flight: the newest policy plays, moment by moment
//! ```
//!
//! The page is an observer like any other: it reads, and touches nothing. It may be killed at any time, and costs the
//! learner what it publishes anyway, an answer when a page comes, and the newest weights every ten seconds.
//!
//! # What it does not know
//!
//! Configurations, run directories, the command line, the clock: they are handed to it. How HTTP is served and guarded
//! is `leadtime-web`'s.
//!
//! # Where to start
//!
//! [`Page`], which everything shares; [`Attachment`] fills it from the network, [`routes()`] serves it.

mod actors;
mod error;
mod events;
mod flight;
mod follow;
mod page;
mod routes;
mod scene;
mod state;
mod text;

pub use error::Error;
pub use flight::{FlightPlan, FlightThread, FlightWatcher, MakeTask};
pub use follow::{Attachment, PlanMaker};
pub use page::{Clock, Page, TICK};
pub use routes::{open_paths, routes};
pub use state::{MAX_POINTS, RunView};
pub use text::screen;
