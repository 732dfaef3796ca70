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

mod build;
mod cli;
mod commands;
mod crash;
mod credentials;
mod display;
mod exit;
mod log_file;
mod log_line;
mod logging;
mod metrics_pipe;
mod new_file;
mod output;
mod program;
mod refused;
mod service;
mod shutdown;
mod sink;
mod targets;
mod terminal;
mod threads;
mod trace_file;

pub use program::Program;
