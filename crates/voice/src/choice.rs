//! Which voice: `none`, `text`, `shipped`, `flite[:VOICE]`, `espeak`, `pipe:COMMAND` or `recorded:DIR`.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use crate::error::VoiceError;

/// The voice of flite that speaks unless another one is named, and that spoke the shipped sentences.
pub const FLITE_VOICE: &str = "slt";

/// A voice, as a person names it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum VoiceChoice {
    /// No words at all.
    None,
    /// Words without sound: each takes a step.
    Text,
    /// The sound that comes with the program.
    #[default]
    Shipped,
    /// flite, with one of its voices.
    Flite(String),
    /// espeak-ng or espeak, whichever is installed.
    Espeak,
    /// A helper that reads sentences and answers with sound.
    Pipe(String),
    /// A directory that `leadtime taxonomy speak` made, or a person.
    Recorded(PathBuf),
}

impl FromStr for VoiceChoice {
    type Err = VoiceError;

    fn from_str(name: &str) -> Result<Self, VoiceError> {
        let (kind, more) = match name.split_once(':') {
            Some((kind, more)) => (kind, Some(more)),
            None => (name, None),
        };
        match (kind, more) {
            ("none", None) => Ok(Self::None),
            ("text", None) => Ok(Self::Text),
            ("shipped", None) => Ok(Self::Shipped),
            ("flite", None) => Ok(Self::Flite(FLITE_VOICE.to_owned())),
            ("flite", Some(voice)) if !voice.is_empty() => Ok(Self::Flite(voice.to_owned())),
            ("espeak", None) => Ok(Self::Espeak),
            ("pipe", Some(command)) if !command.trim().is_empty() => {
                Ok(Self::Pipe(command.to_owned()))
            }
            ("recorded", Some(directory)) if !directory.is_empty() => {
                Ok(Self::Recorded(directory.into()))
            }
            _ => Err(VoiceError::Unknown(name.to_owned())),
        }
    }
}

impl fmt::Display for VoiceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("none"),
            Self::Text => f.write_str("text"),
            Self::Shipped => f.write_str("shipped"),
            Self::Flite(voice) => write!(f, "flite:{voice}"),
            Self::Espeak => f.write_str("espeak"),
            Self::Pipe(command) => write!(f, "pipe:{command}"),
            Self::Recorded(directory) => write!(f, "recorded:{}", directory.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_voice_is_named_in_a_word_and_what_belongs_to_it() {
        for name in [
            "none",
            "text",
            "shipped",
            "flite:awb",
            "espeak",
            "pipe:say --json",
            "recorded:my/words",
        ] {
            assert_eq!(name.parse::<VoiceChoice>().unwrap().to_string(), name);
        }
        assert_eq!("flite".parse::<VoiceChoice>().unwrap(), VoiceChoice::Flite("slt".to_owned()));
        for name in ["", "loud", "flite:", "pipe:", "pipe: ", "pipe", "text:x", "recorded"] {
            let told = name.parse::<VoiceChoice>().unwrap_err().to_string();
            assert!(told.contains("known: none, text, shipped, flite[:VOICE]"), "{told}");
        }
    }
}
