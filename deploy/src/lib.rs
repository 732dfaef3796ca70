//! The program `leadtime`: command line, commands, logging, output, exit codes.
//!
//! The only crate that reads arguments and environment, prints, and decides exit codes. What it does not know: how a
//! policy learns, how a rollout travels, what a run consists of.
//!
//! ```text
//! main -> Program -> cli -> commands/* -> Tasks      worlds and built-in configurations
//!                                      -> sink       progress of a run: recorded, shown, logged
//!                                      -> config, runs, learner, actor, eval (crates)
//! ```
//!
//! A binary of one's own adds tasks to [`Program`] and has every command for them.
//!
//! # Where to start
//!
//! [`Program::run`], then the command of interest in [`commands`].

pub mod build;
pub mod cli;
pub mod commands;
pub mod crash;
pub mod display;
pub mod exit;
pub mod logging;
pub mod output;
pub mod program;
pub mod shutdown;
pub mod sink;
pub mod threads;

pub use program::Program;
