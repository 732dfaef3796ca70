//! A directory with sentences of one's own: `voice.json` and `sound.wav`, or `sound.ogg`.

use std::fs;
use std::path::Path;

use crate::error::VoiceError;
use crate::index::SoundIndex;
use crate::sentence::SpokenSentence;
use crate::{vorbis, wav};

/// The files of a directory.
pub const INDEX: &str = "voice.json";
/// Its sound as it was made.
pub const WAV: &str = "sound.wav";
/// Its sound, compressed; it counts if both are there.
pub const OGG: &str = "sound.ogg";

/// Reads a directory.
///
/// # Errors
///
/// [`VoiceError::Recorded`] if a file is missing or cannot be decoded, if its rate is not the index's, or if the index
/// does not fit the sound; it names the file.
pub fn sentences(directory: &Path, with_sound: bool) -> Result<Vec<SpokenSentence>, VoiceError> {
    let wrong =
        |file: &str, reason: String| VoiceError::Recorded { path: directory.join(file), reason };
    let bytes = |file: &str| {
        let path = directory.join(file);
        // A pipe would keep its reader waiting for ever.
        if fs::metadata(&path).is_ok_and(|found| !found.is_file()) {
            return Err(wrong(file, "it is not a file".to_owned()));
        }
        fs::read(path).map_err(|error| wrong(file, error.to_string()))
    };
    let index =
        String::from_utf8(bytes(INDEX)?).map_err(|error| wrong(INDEX, error.to_string()))?;
    let index = SoundIndex::read(&index).map_err(|reason| wrong(INDEX, reason))?;
    if !with_sound {
        return index.sentences(None).map_err(|reason| wrong(INDEX, reason));
    }
    let (file, sound) = if directory.join(OGG).exists() {
        (OGG, vorbis::decode(&bytes(OGG)?))
    } else {
        (WAV, wav::read(&bytes(WAV)?))
    };
    let (rate, samples) = sound.map_err(|reason| wrong(file, reason))?;
    if rate != index.rate {
        let reason = format!("has {rate} samples per second; {INDEX} says {}", index.rate);
        return Err(wrong(file, reason));
    }
    index.sentences(Some(&samples)).map_err(|reason| wrong(INDEX, reason))
}
