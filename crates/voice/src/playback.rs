//! What a loudspeaker is given next: sentences, silence, and how a sentence ends early. Pure.
//!
//! ```text
//! heard now      written so far            written so far + (CUT - LEAD)
//!     |--- LEAD ----|---------------------------|
//!                   a word that ends in here is said to its end; else a fade of 5 ms, at once
//! ```
//!
//! What is written cannot be taken back, so a cut counts from there: silence is heard at most [`CUT`] after it.

use std::sync::Arc;

use crate::sentence::SpokenSentence;

/// How much sound is given to a loudspeaker at a time, in milliseconds.
pub const BLOCK: u32 = 20;
/// How much sound is with the loudspeaker and not heard yet, in milliseconds: its buffer.
pub const LEAD: u32 = 40;
/// How long after a cut there is silence at the latest, in milliseconds.
pub const CUT: u32 = 80;
/// How long the fade of a cut takes, in milliseconds.
pub const FADE: u32 = 5;

/// Sound in the order in which it is played.
#[derive(Clone, Debug)]
pub struct Playback {
    rate: u32,
    running: Option<RunningSound>,
    /// What follows once the running sentence has been cut.
    next: Option<Arc<SpokenSentence>>,
}

#[derive(Clone, Debug)]
struct RunningSound {
    sentence: Arc<SpokenSentence>,
    /// The next sample, and the one before which it ends.
    at: usize,
    stop: usize,
    /// Over how many samples it fades out before it ends.
    n_fade: usize,
}

impl RunningSound {
    /// Writes its next samples, quieter where it fades out.
    fn take(&mut self, out: &mut [i16]) {
        let samples = self.sentence.sound.iter().flat_map(|sound| &sound.samples[self.at..]);
        for (i, (out, sample)) in out.iter_mut().zip(samples).enumerate() {
            let left = self.stop - (self.at + i);
            let share = (left as f32 / self.n_fade.max(1) as f32).min(1.0);
            *out = (f32::from(*sample) * share) as i16;
        }
        self.at += out.len();
    }
}

impl Playback {
    /// Starts in silence, with so many samples per second.
    pub fn new(rate: u32) -> Self {
        Self { rate, running: None, next: None }
    }

    /// Returns how many samples a block has.
    pub fn block_len(&self) -> usize {
        (u64::from(self.rate) * u64::from(BLOCK) / 1_000) as usize
    }

    /// Returns whether nothing is played or waits.
    pub fn is_silent(&self) -> bool {
        self.running.is_none() && self.next.is_none()
    }

    /// Plays a sentence; what is being played is cut.
    pub fn play(&mut self, sentence: Arc<SpokenSentence>) {
        self.cut();
        self.next = Some(sentence);
    }

    /// Falls silent: at the end of the word if that is near, else at once.
    pub fn cut(&mut self) {
        self.next = None;
        let Some(running) = &mut self.running else { return };
        let Some(sound) = running.sentence.sound.as_ref() else { return };
        let samples =
            |milliseconds: u32| (u64::from(self.rate) * u64::from(milliseconds) / 1_000) as usize;
        let latest = running.at + samples(CUT - LEAD);
        let mut ends = running.sentence.words.iter().map(|word| sound.sample_at(word.end));
        let boundary = ends.find(|end| (running.at..=latest).contains(end));
        let n_fade = samples(FADE);
        let stop = boundary.unwrap_or(running.at + n_fade).min(running.stop);
        (running.stop, running.n_fade) = (stop, n_fade.min(stop.saturating_sub(running.at)));
    }

    /// Writes the next block: sound, then silence.
    pub fn fill(&mut self, block: &mut [i16]) {
        block.fill(0);
        let mut n_done = 0;
        while n_done < block.len() {
            if self.running.is_none() {
                let Some(sentence) = self.next.take() else { return };
                let stop = sentence.sound.as_ref().map_or(0, |sound| sound.samples.len());
                self.running = Some(RunningSound { sentence, at: 0, stop, n_fade: 0 });
            }
            let Some(running) = &mut self.running else { return };
            let n = (running.stop - running.at).min(block.len() - n_done);
            running.take(&mut block[n_done..n_done + n]);
            n_done += n;
            if running.at == running.stop {
                self.running = None;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sentence::{Sound, WordTime};

    const RATE: u32 = 8_000;
    const MS: usize = RATE as usize / 1_000;

    /// A second of sound with words that end at these milliseconds.
    fn sentence(ends: &[u32]) -> Arc<SpokenSentence> {
        let words = ends.iter().scan(0, |begin, &end| {
            let word = WordTime { begin: *begin, end };
            *begin = end;
            Some(word)
        });
        let sound = Sound { rate: RATE, samples: vec![1_000; 1_000 * MS].into() };
        Arc::new(SpokenSentence {
            text: "test".to_owned(),
            words: words.collect(),
            is_estimated: false,
            sound: Some(sound),
        })
    }

    /// Plays blocks; returns the samples.
    fn blocks(playback: &mut Playback, n: usize) -> Vec<i16> {
        let mut all = vec![0; n * playback.block_len()];
        all.chunks_mut(playback.block_len()).for_each(|block| playback.fill(block));
        all
    }

    /// Plays for `before` blocks, cuts, and returns how many milliseconds after what was written before it is silent.
    fn silent_after(ends: &[u32], before: usize) -> usize {
        let mut playback = Playback::new(RATE);
        playback.play(sentence(ends));
        let heard = blocks(&mut playback, before);
        assert!(heard.iter().all(|sample| *sample == 1_000));
        playback.cut();
        let rest = blocks(&mut playback, 20);
        assert!(playback.is_silent());
        rest.iter().rposition(|sample| *sample != 0).map_or(0, |last| (last + 1).div_ceil(MS))
    }

    #[test]
    fn a_cut_is_silent_within_80_ms_wherever_it_comes() {
        for before in 1..49 {
            for ends in [&[1_000][..], &[300, 600, 1_000], &[90, 333, 333, 777, 990]] {
                let after = silent_after(ends, before);
                assert!(after <= (CUT - LEAD) as usize, "{before}, {ends:?}: {after} ms");
            }
        }
    }

    #[test]
    fn a_word_that_is_nearly_over_is_said_to_its_end_and_another_fades() {
        assert_eq!(silent_after(&[135, 1_000], 5), 35, "to the end of the word");
        assert_eq!(silent_after(&[100, 1_000], 5), 0, "it is over already");
        assert_eq!(silent_after(&[145, 1_000], 5), 5, "too far away");
        let mut playback = Playback::new(RATE);
        playback.play(sentence(&[1_000]));
        drop(blocks(&mut playback, 2));
        playback.cut();
        let fade = blocks(&mut playback, 1);
        assert!(fade[..5 * MS].is_sorted_by(|a, b| a > b), "it becomes quieter");
        assert!(fade[5 * MS..].iter().all(|sample| *sample == 0));
    }

    #[test]
    fn a_sentence_follows_the_cut_of_another_and_a_second_cut_takes_it_back() {
        let mut playback = Playback::new(RATE);
        playback.play(sentence(&[1_000]));
        drop(blocks(&mut playback, 2));
        playback.play(sentence(&[1_000]));
        let heard = blocks(&mut playback, 60);
        assert_eq!(heard.iter().filter(|sample| **sample == 1_000).count(), 1_000 * MS + 1);
        assert!(playback.is_silent());
        playback.play(sentence(&[1_000]));
        playback.cut();
        assert!(blocks(&mut playback, 2).iter().all(|sample| *sample == 0));
    }

    #[test]
    fn a_sentence_without_sound_is_silence() {
        let mut playback = Playback::new(RATE);
        playback.play(Arc::new(SpokenSentence::unheard("Go up.")));
        assert!(blocks(&mut playback, 2).iter().all(|sample| *sample == 0));
        assert!(playback.is_silent());
    }
}
