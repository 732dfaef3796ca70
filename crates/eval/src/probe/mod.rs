//! What a notifier knows of its listener: can the listener's reaction delay be read off what goes on in the policy?
//!
//! The policy plays episodes in which the delay `d_r` varies and is never observed. At one step of every stage of an
//! episode a probe notes what the policy's heads see (and its recurrent state), what the policy was given, and the delay.
//!
//! ```text
//! episodes --record--> samples ──┬─ first half ─► readers: constants, regression on input, regression on features
//!                                └─ other half ─────────► errors of each, by stage ─► ProbeResult ─► text, Markdown
//! ```
//!
//! A *stage* of an episode is the time during which the listener has begun to react to the same number of messages.
//!
//! # What makes the answer fair
//!
//! * **Which step.** One step per stage and episode, drawn evenly from the stage's steps, so that long stages do not
//!   outweigh short ones; and all samples of an episode together count as much as those of any other. The last step before a reaction, or the first one after, would give the delay away: the time
//!   since the message is then k + `d_r` by the very choice of the step, which the notifier does not know.
//! * **One regression for all stages**, which does not see the stage. A regression for each would learn from its stage
//!   what the listener has and has not done, which the notifier has to find out by itself; and it would have fewer
//!   episodes than features.
//! * **The penalty** is chosen from a fixed list by cross-validation over episodes of the first half, because the
//!   input can be several times as wide as the features.
//! * **Two constants.** One is the median over everything; the other sees the stage. Listeners who react late are
//!   rarer in late stages, so the second is the harder one to beat.

mod readers;
mod record;
mod result;
mod ridge;
mod scoring;
#[cfg(test)]
mod synthetic;

pub use result::{MIN_EPISODES, ProbeResult, ProbeStage, ReaderScore, Score};
pub use scoring::{check_probe, probe};
