//! Cooking: a cook who does not know which stations are occupied, and somebody who does and may only speak.
//!
//! A topic asks for a direction in the grid, or only informs. The cook follows a direction step by step, until
//! something is in the way; a long enough message also tells what the stations hold, once it was heard to its end:
//! "Go down, all stations occupied".
//!
//! # Where to start
//!
//! [`Cooking`] is the domain; [`WorldSettings`] what can be chosen about it; [`compare()`] what scripted notifiers come to.
//!
//! # Source
//!
//! Hsu et al. (arXiv:2509.07438), the cooking task. It gives no layout, reward, deadline or horizon: those are ours.

mod compare;
mod domain;
mod draw;
mod settings;
mod topics;

pub use compare::{Averages, Speaker, compare, play};
pub use domain::{Cooking, LastStep};
pub use settings::{CookingSettings, TieRule, WorldSettings};
pub use topics::{DEMONSTRATION, DOWN, INFORM, LEFT, RIGHT, TOPICS, UP};
