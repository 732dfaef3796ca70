//! Tests that drive the program itself, as a person or a supervisor would: exit codes, files, signals, `kill -9`.
//!
//! | module | what must hold |
//! |---|---|
//! | `program` | what the commands print, draw and keep |
//! | `bad_input` | wrong input is one sentence and a documented exit code |
//! | `compare` | a study becomes its tables, also when it is killed on the way |
//! | `ending` | who comes while a run ends is dismissed like the others |
//! | `help` | help fits a terminal, and its examples are read; so do lists of runs; the next command is said and works |
//! | `live` | a notifier at work: who is let in, what is said, and that nothing stale ever is |
//! | `long_run` | a run stops where it is told, goes on with other settings, and hands its metrics on |
//! | `mutated` | changed copies of genuine messages harm nobody |
//! | `operations` | status pages, logs, signals, the service manager, a full disk, old runs |
//! | `probe` | what a notifier knows is measured the same way twice, or a sentence says why not |
//! | `python` | whatever happens to a worker in Python, the weights are the same, and nobody executes what others wrote |
//! | `race` | a race stops who is behind, and changes nobody's weights |
//! | `recording` | a recorded notifier says the same again; a killed recorder loses no more than a second |
//! | `resilience` | killing or halting anything changes no bit; the books balance |
//! | `streams` | output that cannot be written, limits, names that are not text: a sentence, and nothing is lost |
//! | `supervision` | processes live and die together |
//! | `taxonomy` | words are made, made again and checked; what is wrong with them is one sentence |
//! | `trace` | a trace tells who waited for whom, changes nothing, and is readable whatever is killed |
//! | `voice` | what a notifier says is played, and a voice that is missing, hangs or talks rubbish harms nobody |
//! | `watch` | a run is seen from outside, and nobody is disturbed |
//! | `words_server` | a language model's words are paid once, whatever is killed or breaks down |
//! | `robot` | a robot that asks for nothing is spoken to on keys of its own, and over ROS 2's |
//! | `rogue` | an actor that lies harms nobody |
//! | `shipped` | the policies that come with the program do what their table says |

#![expect(clippy::unwrap_used, reason = "a test that cannot go on says where")]

mod bad_input;
mod compare;
mod ending;
mod help;
mod live;
mod long_run;
mod mutated;
mod notifier;
mod operations;
mod probe;
mod program;
mod python;
mod race;
mod recording;
mod resilience;
mod robot;
mod rogue;
mod shipped;
mod streams;
mod supervision;
mod support;
mod taxonomy;
mod trace;
mod voice;
mod watch;
mod words_server;
