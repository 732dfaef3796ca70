//! An embedder without weights: sentences are near each other if they share words and parts of words.
//!
//! A stand-in that needs nothing, for trials and tests; it knows no synonyms.

use super::backend::Embedder;
use super::embedding::Embedding;
use super::error::BackendError;
use crate::words;

/// Components of a vector.
const DIM: usize = 128;

/// Weight of a whole word against one of its trigrams.
const WORD: f32 = 2.0;

/// Embeds by words and letter trigrams.
#[derive(Debug)]
pub(super) struct Lexical;

impl Embedder for Lexical {
    fn id(&self) -> &'static str {
        "lexical trigrams, 128 components"
    }

    fn embed(&mut self, text: &str) -> Result<Embedding, BackendError> {
        let mut vector = [0.0_f32; DIM];
        for word in words::words(text) {
            add(&mut vector, word.as_bytes(), WORD);
            let padded = format!("^{word}$");
            for trigram in padded.as_bytes().windows(3) {
                add(&mut vector, trigram, 1.0);
            }
        }
        Ok(Embedding::new(&vector))
    }
}

/// Adds a feature at the place, and with the sign, that its hash gives (FNV-1a, 64 bits, and `MurmurHash3`'s final mix:
/// of short texts alone the upper bits hardly differ).
fn add(vector: &mut [f32; DIM], feature: &[u8], weight: f32) {
    let hash = feature.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    });
    let mixed = (hash ^ (hash >> 33)).wrapping_mul(0xff51_afd7_ed55_8ccd);
    let hash = mixed ^ (mixed >> 33);
    let sign = if hash >> 63 == 0 { 1.0 } else { -1.0 };
    vector[(hash >> 32) as usize % DIM] += sign * weight;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_that_share_words_are_nearer() {
        let embed = |text| Lexical.embed(text).unwrap();
        let left = embed("Merge left now.");
        let near = left.cosine(&embed("Now merge left, please."));
        let far = left.cosine(&embed("Stir the soup."));
        assert!(near > 0.7 && far < 0.3, "{near} {far}");
        assert!((left.cosine(&embed("merge LEFT now")) - 1.0).abs() < 1e-12);
    }
}
