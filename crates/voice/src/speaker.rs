//! What turns sentences into sound.

use crate::error::VoiceError;
use crate::sentence::SpokenSentence;

/// Somebody else's program that speaks.
pub(crate) trait Speaker {
    /// Names the program and its voice, for those who use the sound.
    fn made_by(&self) -> String;

    /// Brings the mean word of these sentences to the pace, where that can be.
    fn prepare(&mut self, sentences: &[&str]) -> Result<(), VoiceError>;

    /// Speaks a sentence, in two seconds at most; the inner error says in words why it could not.
    fn say(&mut self, text: &str) -> Result<Result<SpokenSentence, String>, VoiceError>;
}
