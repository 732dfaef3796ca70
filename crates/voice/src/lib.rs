//! Voices: from a sentence to its sound and the times of its words.
//!
//! ```text
//! VoiceChoice + sentences  --prepare-->  VoiceBook: text -> SpokenSentence { sound, words: [begin, end] }
//!     shipped, recorded     read                          |
//!     flite, espeak, pipe   spoken by a program           +--play, hush-->  Loudspeaker: 20 ms every 20 ms --> aplay
//! ```
//!
//! What this crate does not know: sessions, policies, the network, when something is said.
//!
//! # Invariants
//!
//! * **A sentence has a time for each of its words**, measured or estimated, and says which.
//! * **Nothing waits for somebody else's program without a limit**: two seconds a sentence, three sentences in a row, then
//!   it is given up.
//! * **A cut is silent within 80 ms** of it ([`Playback`]).
//! * No synthesiser is linked: they are programs of their own.
//!
//! # Where to start
//!
//! [`prepare()`], then [`SpokenSentence`]; for sound, [`Playback`].

pub mod book;
mod child;
pub mod choice;
pub mod error;
mod espeak;
mod flite;
mod helper;
pub mod index;
pub mod loudspeaker;
pub mod playback;
pub mod prepare;
pub mod recorded;
pub mod sentence;
pub mod shipped;
mod speaker;
mod trim;
mod vorbis;
pub mod wav;

pub use book::VoiceBook;
pub use choice::VoiceChoice;
pub use error::VoiceError;
pub use index::SoundIndex;
pub use loudspeaker::Loudspeaker;
pub use playback::Playback;
pub use prepare::{prepare, speak};
pub use sentence::{MEAN_WORD, Sound, SpokenSentence, WordTime};
