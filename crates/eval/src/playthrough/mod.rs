//! One recorded episode: its scenes, its messages in words, and how the listener reacted to them.
//!
//! ```text
//! record        Player + environment --> Playthrough (a scene per step)
//! timeline      scenes --> what the listener was doing in each step, utterances and reactions as spans of time
//! voice         topic, k, l of each utterance, and the facts that hold --> a true sentence that says it: Spoken
//! truth         many episodes --> how many of their sentences are false
//! transcript    a spoken episode as text, word by word
//! ```

mod demonstration;
mod record;
mod timeline;
mod transcript;
mod truth;
mod voice;

pub use record::Playthrough;
pub use timeline::{Activity, Span, Timeline, topic_name};
pub use truth::{FalseSentence, Truthfulness};
pub use voice::{Choosing, Sentence, Spoken, Voice};

#[cfg(test)]
pub(crate) mod synthetic;
