//! A sentence as it is spoken: its sound, and when each of its words begins and ends.

use std::sync::Arc;

use leadtime_taxonomy::words;

/// How long a word takes on average, in seconds: the paper's pace, to which every voice is stretched.
pub const MEAN_WORD: f64 = 0.3;

/// When a word is spoken, in milliseconds from the start of its sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WordTime {
    /// When its first sound begins.
    pub begin: u32,
    /// When it has ended. A pause may follow.
    pub end: u32,
}

/// Sound: one channel, 16 bits a sample.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sound {
    /// Samples per second, at least 1.
    pub rate: u32,
    /// Amplitudes, one per sample. Shape `[n_samples]`.
    pub samples: Arc<[i16]>,
}

impl Sound {
    /// Returns the sample that is heard so many milliseconds after the first.
    pub fn sample_at(&self, milliseconds: u32) -> usize {
        let at = u64::from(milliseconds) * u64::from(self.rate) / 1_000;
        (at as usize).min(self.samples.len())
    }

    /// Returns how long it lasts, in milliseconds.
    pub fn milliseconds(&self) -> u32 {
        (self.samples.len() as u64 * 1_000 / u64::from(self.rate.max(1))) as u32
    }
}

/// A sentence with the times of its words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpokenSentence {
    /// As it is written.
    pub text: String,
    /// One for each piece of [`words::spoken`], in order; none begins before its predecessor has ended.
    pub words: Vec<WordTime>,
    /// The times are in proportion to letters: they were not measured.
    pub is_estimated: bool,
    /// `None` where the times are known and the sound is not, or not wanted.
    pub sound: Option<Sound>,
}

impl SpokenSentence {
    /// Returns when the last word has ended, in milliseconds.
    pub fn end(&self) -> u32 {
        self.words.last().map_or(0, |word| word.end)
    }

    /// Gives a sentence times in proportion to its words' letters, within so many milliseconds.
    ///
    /// # Example
    ///
    /// ```
    /// let spoken = leadtime_voice::SpokenSentence::estimated("Go up slowly.", 1_000);
    /// assert_eq!(spoken.words.iter().map(|word| word.end).collect::<Vec<_>>(), [200, 400, 1_000]);
    /// ```
    pub fn estimated(text: &str, milliseconds: u32) -> Self {
        let letters = |piece: &str| piece.chars().filter(|c| c.is_alphanumeric()).count() as u64;
        let total: u64 = words::spoken(text).map(letters).sum();
        let (mut said, mut begin) = (0, 0);
        let mut times = Vec::new();
        for piece in words::spoken(text) {
            said += letters(piece);
            let end = (u64::from(milliseconds) * said / total.max(1)) as u32;
            times.push(WordTime { begin, end });
            begin = end;
        }
        Self { text: text.to_owned(), words: times, is_estimated: true, sound: None }
    }

    /// The same for a sentence of which nothing is known: its words take [`MEAN_WORD`] on average.
    pub fn unheard(text: &str) -> Self {
        Self::estimated(text, (f64::from(words::count(text)) * MEAN_WORD * 1e3) as u32)
    }

    /// Returns whether there is a time for each word, and none is before the one before it.
    pub fn has_words_in_order(&self) -> bool {
        let in_order = self.words.is_sorted_by(|a, b| a.end <= b.begin);
        let forwards = self.words.iter().all(|word| word.begin <= word.end);
        self.words.len() == words::count(&self.text) as usize && in_order && forwards
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_of_which_nothing_is_known_takes_its_share_of_letters() {
        let spoken = SpokenSentence::unheard("Zone ahead - go up!");
        assert_eq!(spoken.words.len(), 4);
        assert_eq!(spoken.end(), 1_200);
        assert!(spoken.has_words_in_order() && spoken.is_estimated);
        let lengths: Vec<u32> = spoken.words.iter().map(|it| it.end - it.begin).collect();
        assert!(lengths[1] > lengths[0] && lengths[0] > lengths[2], "{lengths:?}");
        assert_eq!(SpokenSentence::unheard("").words, []);
    }

    #[test]
    fn times_that_go_back_or_are_too_few_are_found() {
        let mut spoken = SpokenSentence::unheard("Go up now.");
        spoken.words.swap(0, 1);
        assert!(!spoken.has_words_in_order());
        spoken.words.truncate(1);
        assert!(!spoken.has_words_in_order());
    }

    #[test]
    fn a_moment_is_a_sample() {
        let sound = Sound { rate: 16_000, samples: vec![0; 1_600].into() };
        assert_eq!(
            (sound.milliseconds(), sound.sample_at(20), sound.sample_at(999)),
            (100, 320, 1_600)
        );
    }
}
