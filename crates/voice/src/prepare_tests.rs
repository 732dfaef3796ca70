use leadtime_taxonomy::Topic;

use super::*;
use crate::sentence::MEAN_WORD;

fn texts(domain: &str) -> Vec<String> {
    let taxonomy = leadtime_taxonomy::shipped(domain).unwrap();
    let utterances = taxonomy.topics().iter().flat_map(Topic::utterances);
    utterances.map(|utterance| utterance.text.clone()).collect()
}

fn spoken_by(command: &str, texts: &[&str]) -> Result<VoiceBook, VoiceError> {
    let choice = VoiceChoice::Pipe(command.to_owned());
    Ok(prepare(&choice, "lander", texts, true)?.unwrap())
}

#[test]
fn every_shipped_sentence_has_sound_with_the_times_of_its_words() {
    for domain in leadtime_taxonomy::shipped::domains() {
        let texts = texts(domain);
        let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
        let book = prepare(&VoiceChoice::Shipped, domain, &texts, true).unwrap().unwrap();
        for text in &texts {
            let spoken = book.get(text).unwrap();
            let sound = spoken.sound.as_ref();
            let length = sound
                .unwrap_or_else(|| panic!("{domain}: `{text}` has no shipped sound"))
                .milliseconds();
            assert!(!spoken.is_estimated && spoken.has_words_in_order(), "{text}");
            assert!((spoken.end()..spoken.end() + 100).contains(&length), "{text}: {length} ms");
        }
        assert_eq!(shipped::sentences(domain, false).unwrap().len(), texts.len(), "{domain}");
        let mean = book.mean_word();
        assert!((mean - MEAN_WORD).abs() < 0.01, "{domain}: a word takes {mean} s");
    }
}

#[test]
fn a_helper_that_answers_is_heard() {
    // A word a sentence, 0.1 s of sound.
    let command = r#"while read line; do echo '{"rate":8000,"words":[{"at":0,"from":0,"to":2}],"samples":800}';
        head -c 1600 /dev/zero | tr '\0' '\7'; done"#;
    let book = spoken_by(command, &["Up.", "Go up."]).unwrap();
    let up = book.get("Up.").unwrap();
    assert_eq!((up.end(), up.is_estimated, book.rate), (100, false, 8_000));
    let go_up = book.get("Go up.").unwrap();
    assert!(go_up.is_estimated && go_up.sound.is_some(), "the time of a word is missing");
}

#[test]
fn a_helper_may_take_its_time_to_start() {
    let command = r#"sleep 2.2; while read line; do echo '{"rate":8000,"samples":800}';
        head -c 1600 /dev/zero | tr '\0' '\7'; done"#;
    let book = spoken_by(command, &["Up.", "Go up."]).unwrap();
    assert!(["Up.", "Go up."].iter().all(|text| book.get(text).unwrap().sound.is_some()));
}

#[test]
fn a_helper_that_hangs_ends_or_talks_rubbish_gives_times_in_proportion() {
    for command in ["cat > /dev/null", "read line", "while read line; do echo rubbish; done"] {
        let book =
            spoken_by(command, &["Up.", "Go up.", "Go down.", "Go left.", "Go right."]).unwrap();
        assert_eq!((book.n_estimated(), book.rate), (5, 0), "{command}");
        assert_eq!(book.get("Go up.").unwrap().end(), 600);
    }
}

#[test]
fn a_helper_that_is_not_there_is_an_error() {
    let error = spoken_by("no-such-helper", &["Up."]).unwrap_err().to_string();
    assert_eq!(error, "`no-such-helper` is not there: install it, or use --voice text");
}

#[test]
fn sentences_of_ones_own_are_completed() {
    let texts = ["Fly up.", "Fly over the third mountain."];
    let book = prepare(&VoiceChoice::Shipped, "lander", &texts, false).unwrap().unwrap();
    assert!(!book.get("Fly up.").unwrap().is_estimated);
    assert_eq!(book.get(texts[1]).unwrap().words.len(), 5);
}
