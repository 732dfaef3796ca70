//! A run on the disk and as processes.
//!
//! ```text
//! directory    locking, resuming, refusing; on naming, layout, contents    build       which program computed it
//! record       run.json                                 clock           the only reader of the wall clock
//! recorder     what the learner reports, written down by journal (metrics.jsonl), tensorboard and policy_file
//! held_out     evaluations while it trains (held_out.jsonl)            history         what observers receive
//! launch       a learner and its actors as children  ->  supervise      watched until the last of them is gone
//! report       all of it (run_files), and the findings of an evaluation, as a page    evaluation_record   eval.json
//! placement    which CPUs those keep to
//! race         several seeds of a configuration, the hopeless stopped on the way
//! scratch      the short-lived directory of a launch        tasks           what there is to train on
//! find         a run by its name                            listing         all runs in a directory
//! prune        which old runs may go                    own_files       what nobody else may write over
//! ```
//!
//! It reads no command line, prints nothing and decides no exit code: it returns what happened, and the program words
//! it. It does write the commands that a page tells its reader to type. It does not know how a policy learns or how a
//! world moves.
//!
//! # Where to start
//!
//! [`RunDir::open`], then [`launch::launch`].

pub mod build;
pub mod clock;
mod command_line;
mod contents;
pub mod digest;
mod directory;
mod directory_error;
pub mod evaluation;
mod evaluation_record;
mod find;
pub mod findings;
pub mod held_out;
pub mod history;
pub mod journal;
pub mod launch;
pub mod layout;
mod learner_config;
mod listing;
mod metrics;
mod naming;
mod own_files;
mod placement;
pub mod policy_file;
pub mod prune;
pub mod race;
pub mod record;
mod recorder;
pub mod regular;
pub mod report;
mod run_files;
pub mod scratch;
pub mod supervise;
pub mod tasks;
mod tensorboard;
#[cfg(test)]
mod test_support;

pub use build::ProgramBuild;
pub use command_line::{command_line, program_name, shell_argument};
pub use directory::RunDir;
pub use directory_error::RunDirError;
pub use evaluation_record::{EvaluationRecord, LAST_EVALUATION};
pub use find::{did_you_mean_run, find_run, name_in_place};
pub use layout::RunState;
pub use leadtime_learner::{PartialFile, write_atomically};
pub use learner_config::learner_config;
pub use listing::ListedRun;
pub use naming::{Naming, check_place};
pub use own_files::{REPORT_PAGE, run_that_keeps};
pub use placement::{NotPlaced, Placement};
pub use policy_file::{BEST_POLICY, LAST_POLICY, LoadedPolicy};
pub use record::{ForkOrigin, ResultCause, RunRecord, RunResult, SettingChange};
pub use recorder::RunRecorder;
pub use run_files::{QUICK_UPDATES, RunFiles};
pub use tasks::Tasks;
