//! The program `leadtime`: command line, configuration, supervision, logging, output.
//!
//! The only crate that reads arguments, environment and wall clock, prints, and decides exit codes. What it does not
//! know: how a policy learns, how a rollout travels, how a world moves.
//!
//! ```text
//! main -> Program -> cli -> commands/*  -> leadtime-config (as written -> as checked)
//!                                       -> run_dir  (naming, locking, resuming)
//!                                       -> learner, actor, eval (crates)   progress -> metrics.jsonl, tensorboard
//!                                       -> supervise -> learner and actors as child processes
//! ```
//!
//! A binary of one's own adds tasks to [`Program`] and has every command for them.
//!
//! # Where to start
//!
//! [`Program::run`], then the command of interest in [`commands`].

pub mod build_id;
pub mod cli;
pub mod clock;
pub mod commands;
pub mod cpu;
pub mod exit;
pub mod logging;
pub mod output;
pub mod program;
pub mod progress;
pub mod record;
pub mod run_dir;
pub mod shutdown;
pub mod supervise;
pub mod tensorboard;
pub mod threads;

pub use program::Program;
