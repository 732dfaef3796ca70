//! The task: a cook who does not know which stations are occupied, and somebody who does and may only speak.
//!
//! A topic asks for a direction in the grid, or only informs. The cook follows a direction step by step, until
//! something is in the way; a long enough message also tells what the stations hold, once it was heard to its end:
//! "Go down, all stations occupied".
//!
//! # Where to start
//!
//! [`SteakhouseDomain`] is the domain; [`SteakhouseWorldSettings`] what can be chosen about it.
//!
//! # Source
//!
//! Hsu et al. (arXiv:2509.07438), the task of cooking. It gives no layout, reward, deadline or horizon: those are ours.

mod describe;
mod domain;
mod draw;
mod facts;
mod settings;
mod topics;

pub use domain::{
    LastStep, SteakhouseDomain, SteakhouseTaskSettings, demonstration, entry, golden,
};
pub use settings::{SteakhouseWorldSettings, TieRule};
pub use topics::DEMONSTRATION;
