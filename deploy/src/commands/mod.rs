//! One module per command; each turns checked arguments into calls of the crates below, and errors into exit codes.

mod actor;
mod certs;
mod check;
mod compare;
mod config;
mod conformance;
mod describe;
mod dispatch;
mod drive;
mod episode;
mod eval;
mod evaluation;
mod health;
mod launch;
mod learner;
mod new;
mod opponent;
mod pilot;
mod play;
mod probe;
mod race;
mod record;
mod record_run;
mod recorded;
mod replay;
mod report;
mod router;
mod runs;
mod script_search;
mod serve;
mod smoke;
mod standing;
mod taxonomy;
mod version;
mod watch;

pub(crate) use dispatch::dispatch;
