//! The voice of a notifier at work, through the program: what is played, a cut, and helpers that are missing, end or talk rubbish.

use std::fs;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::notifier::{Client, policy};
use crate::support::{PATIENCE, Place, Running, WRONG_INPUT, signal, wait_for_words, wait_until};

/// Samples per second of the shipped sound.
const RATE: usize = 16_000;

/// Starts a notifier for the lander; each option is one argument.
fn serve(place: &Place, options: &[&str]) -> Running {
    let mut command = place.program(&["serve", &policy(), "--listen", &place.endpoint("n")]);
    command.args(options);
    let notifier = place.start_with(command);
    wait_for_words(&notifier, "is at work");
    notifier
}

/// Connects a client that comes down beside the pad and hears what is said; returns the answer to its question, too.
fn listen_to(place: &Place, more: &Value) -> (Client, Value) {
    let mut client = Client::connect(place, "car-1", 1);
    // Sentences take the time of the voice, and not of steps of another length.
    client.own = json!({});
    let answer = client.open(more).unwrap();
    (client, answer)
}

impl Client {
    /// Sends an observation, and takes what is told within 20 ms.
    fn step(&mut self, end: bool) {
        self.put(end);
        self.listen(Duration::from_millis(20));
    }

    /// Sends observations until something holds.
    #[track_caller]
    fn until(&mut self, what: &str, holds: impl Fn(&Self) -> bool) {
        self.act_until(what, holds, |client| client.step(false));
    }

    fn last(&self, event: &str) -> Option<&Value> {
        self.written.iter().rev().find(|say| say["event"] == event)
    }
}

/// Returns how many samples a fake loudspeaker has got, and how many of them are no silence.
fn heard(file: &str) -> (usize, usize) {
    let bytes = fs::read(file).unwrap_or_default();
    let samples = bytes.as_chunks::<2>().0;
    (samples.len(), samples.iter().filter(|sample| **sample != [0, 0]).count())
}

#[test]
fn what_is_said_is_played_and_a_cut_is_silent_within_80_ms() {
    let place = Place::new();
    let file = place.file("heard");
    let _notifier = serve(&place, &[&format!("--play=cat > {file}")]);
    let (mut listener, answer) = listen_to(&place, &json!({"lost_after": 30, "stale_after": 30}));
    let voice = &answer["voice"];
    assert_eq!(
        (&voice["name"], &voice["rate"], &voice["estimated"]),
        (&json!("shipped"), &json!(RATE), &json!(0))
    );
    listener.until("an utterance starts", |it| it.last("start").is_some());
    let say = listener.last("start").unwrap().clone();
    let (at, end) = (say["at"].as_array().unwrap(), say["end"].as_f64().unwrap());
    let lengths: Vec<f64> =
        at.windows(2).map(|pair| pair[1].as_f64().unwrap() - pair[0].as_f64().unwrap()).collect();
    assert!(
        lengths.iter().all(|seconds| (seconds - 0.3).abs() > 1e-9),
        "words are not equally long: {say}"
    );
    assert!(end > at.last().unwrap().as_f64().unwrap());
    assert!(say["estimated"].is_null());
    listener.until("it is played", |_| heard(&file).1 > RATE / 50);
    // In the middle of it the episode ends.
    listener.until("an utterance has just started", |it| {
        it.written.last().is_some_and(|say| say["event"] == "start")
    });
    let deadline = Instant::now() + PATIENCE;
    while listener
        .last("cut")
        .is_none_or(|cut| cut["utterance"] != listener.last("start").unwrap()["utterance"])
    {
        assert!(Instant::now() < deadline);
        listener.step(true);
    }
    // What the loudspeaker had not played of the 40 ms that it holds, and what it got after the cut was told: together 80 ms at most.
    let (n, loud) = heard(&file);
    wait_until("silence is played", PATIENCE, || heard(&file).0 > n + RATE / 2);
    let after = heard(&file).1 - loud;
    assert!(after <= RATE * 40 / 1_000, "{after} samples after the cut");
    let (n, _) = heard(&file);
    let bytes = fs::read(&file).unwrap();
    assert!(bytes[2 * (n - RATE / 4)..2 * n].iter().all(|byte| *byte == 0), "it stays silent");
}

#[test]
fn a_loudspeaker_that_is_gone_is_told_and_what_is_said_goes_on_in_text() {
    let place = Place::new();
    let notifier = serve(&place, &["--play=head -c 20000 > /dev/null"]);
    let (mut listener, _) = listen_to(&place, &json!({}));
    listener.until("it is mute", |it| it.statuses.last().is_some_and(|it| it["state"] == "mute"));
    let why = "the loudspeaker is gone; what is said goes on in text";
    assert_eq!(listener.statuses.last().unwrap()["why"], why);
    let n = listener.written.len();
    listener.until("it goes on", |it| it.written.len() > n + 3);
    assert!(notifier.stderr().contains("is gone"), "{}", notifier.stderr());
}

#[test]
fn a_voice_that_cannot_be_had_is_one_sentence() {
    let place = Place::new();
    let refused = |options: &[&str], told: &str| {
        let mut command = place.program(&["serve", &policy(), "--listen", &place.endpoint("n")]);
        // Nothing is installed here but a shell.
        let bin = place.file("bin");
        fs::create_dir_all(&bin).unwrap();
        drop(std::os::unix::fs::symlink("/bin/sh", format!("{bin}/sh")));
        command.env("PATH", &bin).args(options);
        place.start_with(command).finish(PATIENCE).with_code(WRONG_INPUT).saying(&[told]);
    };
    refused(&["--voice", "flite"], "`flite` is not there: install flite, or use --voice text");
    refused(
        &["--voice", "espeak"],
        "`espeak-ng` is not there: install espeak-ng, or use --voice text",
    );
    refused(
        &["--voice", "pipe:no-such-helper"],
        "`no-such-helper` is not there: install it, or use --voice text",
    );
    refused(&["--voice", "loud"], "`loud` is no voice; known: none, text, shipped");
    refused(&["--voice", "recorded:nowhere"], "nowhere/voice.json: No such file");
    refused(&["--play"], "`aplay` is not there: install alsa-utils, or use --play=COMMAND");
    refused(&["--play=no-such-player"], "`no-such-player` is not there");
    refused(
        &["--voice", "text", "--play"],
        "--play has nothing to play: --voice text makes no sound",
    );
    refused(&["--voice", "none", "--words", "lander"], "--voice none speaks no words");
    refused(&["--play", "--max-sessions", "3"], "--max-sessions");
}

#[test]
fn a_helper_that_ends_or_talks_rubbish_gives_estimated_times() {
    for helper in ["pipe:read line", "pipe:while read line; do echo rubbish; done"] {
        let place = Place::new();
        let notifier = serve(&place, &["--voice", helper]);
        let told = notifier.stderr();
        assert!(
            told.contains("sentences have no sound, and times in proportion to their letters"),
            "{told}"
        );
        let (mut listener, answer) = listen_to(&place, &json!({}));
        let voice = &answer["voice"];
        assert_eq!(
            (&voice["estimated"], &voice["rate"]),
            (&voice["sentences"], &json!(0)),
            "{voice}"
        );
        listener.until("something is said", |it| it.last("start").is_some());
        assert_eq!(listener.last("start").unwrap()["estimated"], true);
    }
}

/// A flite of which every sentence takes half a second: two phones a word.
const FAKE_FLITE: &str = r#"#!/bin/sh
[ "$1" = -lv ] && { echo "Voices available: slt"; exit; }
while [ $# -gt 0 ]; do
    case $1 in -t) text=$2;; -o) file=$2;; -psdur) times=1;; esac
    shift
done
n=0
printf 'pau'
[ "$times" ] && printf ':0.1'
for word in $text; do
    for phone in a b; do
        n=$((n + 1))
        printf ' %s' $phone
        [ "$times" ] && printf ':%d.%02d' $((n / 4)) $((n % 4 * 25))
    done
done
[ "$file" = none ] || cp "$FAKE_SOUND" "$file"
"#;

#[test]
fn a_database_is_spoken_once_and_served_from_its_recording() {
    let place = Place::new();
    let bin = place.file("bin");
    fs::create_dir_all(&bin).unwrap();
    place.executable("bin/flite", place.write("flite.sh", FAKE_FLITE).as_ref());
    let sound = place.file("sound.wav");
    fs::write(&sound, leadtime_voice::wav::write(8_000, &vec![500; 40_000])).unwrap();
    let path = format!("{bin}:{}", std::env::var("PATH").unwrap());
    let mut command = place.program(&["taxonomy speak lander -o spoken"]);
    command.env("PATH", &path).env("FAKE_SOUND", &sound);
    let spoken = place.start_with(command).finish(PATIENCE).with_code(0);
    assert!(spoken.stdout.contains("160 sentences"), "{}", spoken.stdout);
    let index = fs::read_to_string(place.file("spoken/voice.json")).unwrap();
    let index: Value = serde_json::from_str(&index).unwrap();
    assert!(
        index["made_by"].as_str().unwrap().starts_with("flite, voice slt"),
        "{}",
        index["made_by"]
    );
    // It may be somebody's own voice by now: it is never replaced, and what cannot be spoken leaves nothing.
    let again = place.finish(&["taxonomy speak lander -o spoken"]).with_code(2);
    again.saying(&["spoken holds sound.wav already, which is left as it is: choose another -o"]);
    place.finish(&["taxonomy speak lander --voice flite:nobody -o other"]).with_code(2);
    let mute = place.finish(&["taxonomy speak lander --voice text -o other"]).with_code(2);
    mute.saying(&["--voice text speaks nothing anew: use flite[:VOICE], espeak or pipe:COMMAND"]);
    assert!(!place.path().join("other").exists());
    let _notifier = serve(&place, &["--voice", "recorded:spoken"]);
    let (mut listener, _) = listen_to(&place, &json!({}));
    listener.until("something is said", |it| it.last("start").is_some());
    let say = listener.last("start").unwrap();
    let n = say["words"].as_array().unwrap().len();
    assert_eq!(
        (say["at"].as_array().unwrap().len(), &say["estimated"]),
        (n, &Value::Null),
        "{say}"
    );
    assert_eq!(say["end"].as_f64().unwrap(), 0.5 * n as f64 - 0.1, "{say}");
}

#[test]
fn where_sound_cannot_be_written_nobody_speaks() {
    let place = Place::new();
    place.write("file", "");
    fs::create_dir(place.file("mine")).unwrap();
    place.write("mine/sound.ogg", "my own");
    for (output, told) in [
        ("file/x", "cannot make file/x"),
        ("mine", "mine holds sound.ogg already, which is left as it is: choose another -o"),
    ] {
        let mut command = place.program(&["taxonomy speak lander -o", output]);
        command.args(["--voice", "pipe:touch asked; read line"]);
        place.start_with(command).finish(PATIENCE).with_code(WRONG_INPUT).saying(&[told]);
        assert!(!place.path().join("asked").exists(), "the helper was started");
    }
    let mut command = place.program(&["taxonomy speak lander -o new"]);
    command.args(["--voice", "pipe:touch asked; read line"]);
    place.start_with(command).finish(PATIENCE).with_code(WRONG_INPUT);
    assert!(place.path().join("asked").exists() && !place.path().join("new").exists());
}

#[test]
fn what_is_said_in_the_time_of_a_voice_is_replayed_exactly() {
    for clock in ["timer", "word"] {
        let place = Place::new();
        let notifier = serve(&place, &[]);
        let recorder = place.start(&["record -o r.mcap --connect", &place.endpoint("n")]);
        wait_for_words(&recorder, "recording notifier");
        let (mut listener, _) = listen_to(&place, &json!({"clock": clock}));
        listener.until("sentences end", |it| {
            it.written.iter().filter(|say| say["event"] == "end").count() > 2
        });
        signal("INT", recorder.id());
        recorder.finish(PATIENCE).with_code(0);
        drop((listener, notifier));
        let own = place.finish(&["replay r.mcap --json"]).with_code(0).json();
        let own = &own["sessions"][0];
        assert_eq!((&own["difference"], &own["events_lost"]), (&Value::Null, &json!(0)), "{own}");
        assert_eq!((&own["is_same_policy"], &own["is_same_voice"]), (&json!(true), &json!(true)));
        assert_eq!((&own["gaps"], &own["replayed"]), (&json!({}), &own["recorded"]), "{own}");
        // Words of another voice end at other times, for no fault of the policy.
        let other = place.finish(&["replay r.mcap --voice text --json"]).with_code(0).json();
        let other = &other["sessions"][0];
        assert_eq!(
            (&other["is_same_policy"], &other["is_same_voice"]),
            (&json!(true), &json!(false))
        );
        assert_ne!(other["difference"], Value::Null, "{other}");
        let told = place.finish(&["replay r.mcap --voice text"]).with_code(0).stdout;
        assert!(told.contains("recorded with the voice shipped"), "{told}");
    }
}
