//! The program `leadtime`: command line, commands, wording, output, exit codes.
//!
//! The only crate that reads arguments and environment, prints, and decides exit codes. What it does not know: how a
//! policy learns, how a rollout travels, what a run consists of, and what every process has around its work
//! (`leadtime-process`).
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

mod build;
mod cli;
mod commands;
mod crash;
mod credentials;
mod display;
mod ending;
mod exit;
mod log;
mod output;
mod program;
mod service;
mod sink;
mod targets;
mod terminal;
mod threads;

pub use program::Program;
