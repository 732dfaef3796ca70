//! Word times of the shipped sound against what can be heard in it: a pause after a comma is found in the sound alone.

use leadtime_taxonomy::{shipped, words};
use leadtime_voice::{Sound, SpokenSentence, WordTime};

/// How long a piece is whose loudness is measured, in milliseconds.
const PIECE: usize = 5;
/// How loud the voice is in a pause at most, of its loudest.
const QUIET: f64 = 0.05;
/// The shortest pause, in milliseconds: what is shorter may be the closure of a plosive.
const PAUSE: usize = 60;

/// Computes the loudness of each piece, of the loudest.
fn loudness(sound: &Sound) -> Vec<f64> {
    let n = sound.rate as usize * PIECE / 1_000;
    let of = |piece: &[i16]| {
        let sum: f64 = piece.iter().map(|sample| f64::from(*sample).powi(2)).sum();
        (sum / piece.len() as f64).sqrt()
    };
    let pieces: Vec<f64> = sound.samples.chunks(n).map(of).collect();
    let loudest = pieces.iter().copied().fold(1e-9, f64::max);
    pieces.into_iter().map(|loudness| loudness / loudest).collect()
}

/// Finds the longest pause inside a sentence, in milliseconds.
fn longest_pause(sound: &Sound) -> Option<(f64, f64)> {
    let pieces = loudness(sound);
    let first = pieces.iter().position(|it| *it > QUIET)?;
    let last = pieces.iter().rposition(|it| *it > QUIET)?;
    let (mut best, mut run) = (0..0, first..first);
    for (i, piece) in pieces.iter().enumerate().take(last + 1).skip(first) {
        run = if *piece > QUIET { i + 1..i + 1 } else { run.start..i + 1 };
        if run.len() > best.len() {
            best = run.clone();
        }
    }
    let milliseconds = |i: usize| (i * PIECE) as f64;
    (best.len() * PIECE >= PAUSE).then(|| (milliseconds(best.start), milliseconds(best.end)))
}

/// Returns the words on both sides of a sentence's only comma.
fn at_the_comma(spoken: &SpokenSentence) -> Option<(WordTime, WordTime)> {
    let pieces: Vec<&str> = words::spoken(&spoken.text).collect();
    let mut commas = (0..pieces.len() - 1).filter(|i| pieces[*i].ends_with(','));
    let (only, None) = (commas.next()?, commas.next()) else { return None };
    Some((spoken.words[only], spoken.words[only + 1]))
}

fn median(mut errors: Vec<f64>) -> f64 {
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

#[test]
fn word_times_are_where_the_voice_pauses_and_goes_on() {
    let (mut ends, mut begins) = (Vec::new(), Vec::new());
    for domain in shipped::domains() {
        for spoken in leadtime_voice::shipped::sentences(domain, true).unwrap() {
            let Some((before, after)) = at_the_comma(&spoken) else { continue };
            let Some((from, to)) = longest_pause(spoken.sound.as_ref().unwrap()) else { continue };
            ends.push((f64::from(before.end) - from).abs());
            begins.push((f64::from(after.begin) - to).abs());
        }
    }
    let (n, end, begin) = (ends.len(), median(ends), median(begins));
    println!("{n} pauses: word ends off by {end} ms, begins by {begin} ms (median)");
    assert!(n > 100, "{n}");
    assert!(end < 40.0 && begin < 40.0, "{end}, {begin}");
}

#[test]
fn a_sentence_begins_with_its_first_word_and_ends_with_its_last() {
    let (mut begins, mut ends) = (Vec::new(), Vec::new());
    for domain in shipped::domains() {
        for spoken in leadtime_voice::shipped::sentences(domain, true).unwrap() {
            let pieces = loudness(spoken.sound.as_ref().unwrap());
            let loud = |it: &f64| *it > QUIET;
            let (first, last) = (pieces.iter().position(loud), pieces.iter().rposition(loud));
            begins.push((first.unwrap() * PIECE) as f64 - f64::from(spoken.words[0].begin));
            ends.push((f64::from(spoken.end()) - ((last.unwrap() + 1) * PIECE) as f64).abs());
        }
    }
    let (begin, end) = (median(begins), median(ends));
    println!("sentences begin {begin} ms after their time, and end off by {end} ms (median)");
    assert!(begin < 40.0 && end < 40.0, "{begin}, {end}");
}
