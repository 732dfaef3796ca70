//! The sound that comes with the program: every sentence of the shipped databases, spoken once by flite.
//!
//! `scripts/make_voices.sh` makes it; `data/NOTICE` says whose voice it is.

use crate::error::VoiceError;
use crate::index::SoundIndex;
use crate::sentence::SpokenSentence;
use crate::vorbis;

/// Domain, index and sound.
const FILES: [(&str, &str, &[u8]); 3] = [
    (
        "highway",
        include_str!("../data/highway/voice.json"),
        include_bytes!("../data/highway/sound.ogg"),
    ),
    (
        "lander",
        include_str!("../data/lander/voice.json"),
        include_bytes!("../data/lander/sound.ogg"),
    ),
    (
        "steakhouse",
        include_str!("../data/steakhouse/voice.json"),
        include_bytes!("../data/steakhouse/sound.ogg"),
    ),
];

/// Names the domains whose sentences have sound.
pub fn domains() -> impl Iterator<Item = &'static str> {
    FILES.iter().map(|(domain, ..)| *domain)
}

/// Returns the sentences of a domain, with their sound if it is wanted: to decode it takes a moment.
///
/// # Errors
///
/// [`VoiceError::NotShipped`] if no sound is shipped for the domain.
pub fn sentences(domain: &str, with_sound: bool) -> Result<Vec<SpokenSentence>, VoiceError> {
    let file = FILES.iter().find(|(name, ..)| *name == domain);
    let (_, index, sound) = file.ok_or_else(|| VoiceError::NotShipped(domain.to_owned()))?;
    let read = || {
        let index = SoundIndex::read(index)?;
        let sound = if with_sound { Some(vorbis::decode(sound)?.1) } else { None };
        index.sentences(sound.as_deref())
    };
    let wrong = |reason| VoiceError::Recorded {
        path: format!("the shipped voice of {domain}").into(),
        reason,
    };
    read().map_err(wrong)
}
