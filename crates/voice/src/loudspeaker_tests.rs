use std::fs;
use std::path::Path;

use super::*;
use crate::sentence::{Sound, WordTime};

/// How long something may take on a busy machine.
const PATIENCE: Duration = Duration::from_secs(20);

#[track_caller]
fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !holds() {
        assert!(Instant::now() < deadline, "waited in vain: {what}");
        thread::sleep(Duration::from_millis(5));
    }
}

/// Two seconds of sound, one word.
fn sentence() -> Arc<SpokenSentence> {
    Arc::new(SpokenSentence {
        text: "test".to_owned(),
        words: vec![WordTime { begin: 0, end: 2_000 }],
        is_estimated: false,
        sound: Some(Sound { rate: 8_000, samples: vec![1_000; 16_000].into() }),
    })
}

fn samples(path: &Path) -> Vec<i16> {
    crate::wav::pcm(&fs::read(path).unwrap_or_default())
}

fn n_loud(path: &Path) -> usize {
    samples(path).iter().filter(|sample| **sample != 0).count()
}

#[test]
fn what_is_played_reaches_the_program_and_a_cut_ends_it() {
    let place = tempfile::TempDir::new().unwrap();
    let file = place.path().join("heard");
    let command = format!("cat > {}", file.display());
    let loudspeaker = Loudspeaker::start(Some(&command), 8_000).unwrap();
    wait_until("silence is played", || !samples(&file).is_empty());
    loudspeaker.play(&sentence());
    wait_until("the sentence is played", || n_loud(&file) > 2_000);
    loudspeaker.hush();
    drop(loudspeaker);
    let heard = samples(&file);
    let last = heard.iter().rposition(|sample| *sample != 0).unwrap();
    let loud = heard.iter().filter(|sample| **sample != 0).count();
    assert!(loud < 16_000, "it was cut");
    // The fade: five milliseconds that become quieter.
    assert!(heard[last - 30..=last].is_sorted_by(|a, b| a >= b), "{:?}", &heard[last - 30..=last]);
}

#[test]
fn a_loudspeaker_that_ends_is_mute_and_one_that_takes_nothing_too() {
    for command in ["exit 1", "head -c 2000 > /dev/null", "sleep 60"] {
        let loudspeaker = Loudspeaker::start(Some(command), 8_000).unwrap();
        loudspeaker.play(&sentence());
        wait_until(command, || loudspeaker.is_mute());
    }
}

/// A program that was gone for some time and has been started again.
fn started_again(command: &str) -> Playing {
    let program = SoundCommand { command: Some(command.to_owned()), rate: 8_000 };
    let mut playing = Playing::new(program.start().unwrap(), program);
    playing.is_mute.store(true, Ordering::Relaxed);
    playing.started = Instant::now().checked_sub(2 * IS_BACK).unwrap();
    playing
}

#[test]
fn a_loudspeaker_that_is_started_again_is_back_once_it_takes_something() {
    let mut hanging = started_again("sleep 60");
    for _ in 0..=MAX_UNTAKEN {
        hanging.write_block();
        assert!(hanging.player.is_some() && hanging.is_mute.load(Ordering::Relaxed));
    }
    hanging.write_block();
    assert!(hanging.player.is_none(), "it is gone in silence, too");
    let mut playing = started_again("cat > /dev/null");
    wait_until("it is back", || {
        playing.write_block();
        !playing.is_mute.load(Ordering::Relaxed)
    });
}

#[test]
fn a_command_that_is_not_there_is_told_at_once() {
    let error = Loudspeaker::start(Some("no-such-player -q"), 8_000).unwrap_err().to_string();
    assert!(
        error.starts_with("`no-such-player -q` is not there: install it, or use --play"),
        "{error}"
    );
}
