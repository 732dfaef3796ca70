//! What a command line means, and what is said where it means nothing.

use super::durations::TOO_LONG;
use super::training::stop_after;
use super::*;

#[test]
fn the_command_line_is_sound() {
    Cli::documented().debug_assert();
}

/// Reads a command line, or returns what is said about it.
fn read(words: &str) -> Result<Cli, String> {
    let words = words.split_whitespace();
    let words = std::iter::once("leadtime").chain(words);
    Cli::try_parse_from(words).map_err(|error| error.to_string())
}

#[test]
fn an_option_that_cannot_hold_is_refused_by_its_name() {
    for (words, told) in [
        ("smoke -c lander --domain highway", ["--domain <NAME>", "cannot be used with"]),
        ("up -c lander --metrics-to=", ["--metrics-to <COMMAND>", "the command is empty"]),
        ("serve RUN --play=", ["--play", "the command is empty"]),
        ("up --seed -1", ["invalid value '-1'", "--seed <SEED>"]),
        ("eval RUN --eval-seed -1", ["invalid value '-1'", "--eval-seed <SEED>"]),
    ] {
        let error = read(words).expect_err(words);
        assert!(told.iter().all(|text| error.contains(text)), "{words}: {error}");
    }
    for words in ["smoke -c lander", "smoke --domain highway", "serve RUN --play"] {
        read(words).expect("it is sound");
    }
}

#[test]
fn out_and_output_are_one_option_in_every_command() {
    for words in [
        "report RUN -o FILE",
        "script-search lander -o FILE",
        "certs acl pki -o FILE",
        "compare table1 -o DIR",
        "play RUN -o FILE",
        "record --connect HOST:7448 -o FILE",
        "taxonomy build lander --backend authored -o DIR",
        "taxonomy report lander -o FILE",
        "taxonomy export lander -o FILE",
        "taxonomy speak lander -o DIR",
    ] {
        for option in ["-o", "--out", "--output"] {
            let words = words.replace("-o", option);
            read(&words).unwrap_or_else(|error| panic!("{words}: {error}"));
        }
    }
}

#[test]
fn the_help_of_a_command_is_about_what_it_does_itself() {
    let mut root = Cli::documented();
    root.build();
    let mut help = |name: &str| {
        let help = root.find_subcommand_mut(name).unwrap().render_help().to_string();
        // However the lines are broken.
        help.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let serve = help("serve");
    let at = |option: &str| serve.find(option).unwrap_or_else(|| panic!("no {option}"));
    assert!(at("--runs <DIR>") < at("-q, --quiet") && at("--quiet") < at("-v, --verbose"));
    let race = help("race");
    assert!(race.contains("steps of each racer") && race.contains("Seed of the first racer"));
    let play = help("play");
    assert!(play.contains("Seed of the episode [default"), "{play}");
    assert!(help("eval").contains("Seed of the episodes; not the one of training"));
}

#[test]
fn ranges_and_durations_read_as_people_write_them() {
    assert_eq!(number_range("0..1000"), Ok(0..1000));
    assert_eq!(number_range("7..1000007"), Ok(7..1_000_007));
    assert!(["5..5", "5", "7..1000008"].iter().all(|text| number_range(text).is_err()));
    assert_eq!(duration("2m"), Ok(Duration::from_mins(2)));
    assert!(["-1s", "6"].iter().all(|text| duration(text).is_err()));
    assert_eq!(duration("87600h"), Ok(Duration::from_hours(87_600)));
    for too_long in ["87601h", "9223372036854775807s"] {
        assert_eq!(duration(too_long), Err(TOO_LONG.to_owned()));
        assert_eq!(stop_after(too_long), Err(TOO_LONG.to_owned()));
    }
    assert_eq!([n_steps("1e6"), n_steps("512")], [Ok(1_000_000), Ok(512)]);
    assert!(["1.5", "0", "-1", "many"].iter().all(|text| n_steps(text).is_err()));
}
