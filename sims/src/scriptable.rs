//! What a notifier needs that is written down as rules instead of weights: numbers to look at, and messages to choose from.
//!
//! A policy sees an observation, and a world's own script sees the world. A script that somebody writes or that a search finds sees
//! numbers that have names. The notifier environment offers them ([`Environment::scriptable`](crate::Environment::scriptable)).

use crate::description::Quantity;
use crate::human::SpeechAct;
use crate::message::Message;

/// The name of the number that counts the steps of the episode so far; every task has it.
pub const STEP: &str = "step";

/// A task in which messages are sent, as a scripted notifier sees it.
pub trait Scriptable {
    /// Names the topics, by id.
    fn topics(&self) -> &[&'static str];

    /// Lists the messages that can be said, each once.
    fn messages(&self) -> Vec<Message>;

    /// Returns whether the listener would hear a message that starts now.
    fn may_start(&self) -> bool;

    /// Returns whether the episode goes on although it can no longer become a success.
    fn is_lost(&self) -> bool;

    /// Writes the action that starts a message, or that says nothing new. Shape `[n_heads]`.
    ///
    /// A message that cannot be said becomes the nearest one that can; one of an unknown topic becomes silence.
    fn write_action(&self, message: Option<Message>, action: &mut [u8]);

    /// Writes the action that carries out a speech act; one that is not among the choices becomes silence. Shape `[n_heads]`.
    fn write_act(&self, act: SpeechAct, action: &mut [u8]);

    /// Says what the numbers are: those of the world's observation, those that the world adds for scripts, and [`STEP`].
    fn quantities(&self) -> Vec<Quantity>;

    /// Returns how many of the first quantities are the world's observation.
    fn n_observed(&self) -> usize;

    /// Returns of how many of the first quantities it is remembered what they were a step ago.
    fn n_remembered(&self) -> usize;

    /// Writes the numbers as they are now, and as they were a step ago. Shape of both `[n_quantities]`.
    ///
    /// Both are the same at the start of an episode, and where nothing is remembered ([`Scriptable::n_remembered`]).
    fn write_quantities(&self, now: &mut [f32], before: &mut [f32]);
}
