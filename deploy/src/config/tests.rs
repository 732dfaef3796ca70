//! Tests of the whole way from text to checked configuration.

use leadtime_sims::registry::Registry;
use toml::Table;

use super::catalog::{GENERAL, built_in_texts};
use super::checked::parse;
use super::table::{Assignment, flatten};
use super::{Catalog, Config, load, sections};
use crate::cli::ConfigSource;

fn check(text: &str) -> anyhow::Result<Config> {
    let table = parse(text, &Catalog::built_in())?;
    Config::from_table(table, &Registry::builtin())
}

/// The error as the program prints it.
fn refused(text: &str) -> String {
    format!("{:#}", check(text).expect_err("the configuration is refused"))
}

#[test]
fn every_built_in_file_is_sound_and_leaves_no_key_out() {
    for (name, text) in built_in_texts() {
        let config = check(text).unwrap_or_else(|error| panic!("{name}: {error:#}"));
        let own = flatten(&text.parse::<Table>().unwrap());
        let all = flatten(&config.table);
        let missing: Vec<_> = all.keys().filter(|key| !own.contains_key(*key)).collect();
        assert!(missing.is_empty(), "{name} leaves out {missing:?}");
        assert_eq!(own, all, "{name} survives the checks unchanged");
    }
}

#[test]
fn every_key_of_every_built_in_file_has_a_comment() {
    for (name, text) in built_in_texts().into_iter().chain([("own", GENERAL)]) {
        let mut before = "";
        for line in text.lines() {
            let is_key = line.split_once(" = ").is_some_and(|(key, _)| {
                key.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_')
            });
            let explained = before.starts_with("# ") || before == "[evaluation.world]";
            assert!(!is_key || explained, "{name}: `{line}` has no comment");
            before = line;
        }
    }
}

#[test]
fn growing_total_steps_is_explained_wherever_the_learning_rate_can_fall() {
    for (name, text) in built_in_texts().into_iter().chain([("own", GENERAL)]) {
        let (before, _) = text.split_once("\ntotal_steps = ").unwrap();
        let comment: Vec<&str> = before.lines().rev().take_while(|l| l.starts_with('#')).collect();
        assert!(comment.iter().any(|line| line.contains("anneal = true")), "{name}");
    }
}

#[test]
fn a_person_needs_to_write_only_what_differs() {
    let config = check("domain = \"cartpole\"\n[learner]\nn_envs = 8").unwrap();
    assert_eq!((config.learner.n_envs, config.learner.n_steps), (8, 128));
    let lander = check("").unwrap();
    assert_eq!(lander.domain.as_str(), "lander");
    assert!(lander.env.actions.gate.is_some());
    assert_eq!(lander.policy.logit_bias.iter().filter(|bias| **bias != 0.0).count(), 1);
}

#[test]
fn an_untrained_notifier_is_quiet_and_brief_as_asked() {
    let biases = |text: &str| check(text).unwrap().policy.logit_bias;
    let brief =
        "[policy]\ninitiate_bias = -3.0\nlength_bias = -1.0\n[notifier]\nwords = [2, 3, 4]\n";
    let (n_topics, lengths) = (4, [0.0, -1.0, -2.0]);
    let quiet = [vec![0.0, -3.0], vec![0.0; n_topics]].concat();
    let both = biases(&format!("{brief}notification = \"incrementally_actionable\""));
    assert_eq!(both, [&quiet[..], &lengths, &lengths].concat());
    let complete = biases(&format!("{brief}notification = \"complete_utterance\""));
    assert_eq!(complete, [&quiet[..], &lengths].concat());
    assert_eq!(biases(&format!("{brief}notification = \"topic_only\"")), quiet);
    assert!(biases("domain = \"cartpole\"\n[policy]\nlength_bias = -1.0").is_empty());
}

#[test]
fn a_typo_is_told_with_its_line_and_what_is_allowed() {
    let text = refused("domain = \"cartpole\"\n\n[learner]\nn_env = 8");
    for part in ["line 4", "n_env = 8", "unknown field `n_env`", "`n_envs`"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let text = refused("[human]\nrepeat = \"often\"");
    assert!(text.contains("line 2") && text.contains("restart"), "{text}");
}

#[test]
fn impossible_values_are_told_by_key() {
    for (text, key) in [
        ("[learner]\nclip = -1.0", "learner.clip"),
        ("[actor]\nwindow = 0", "actor.window"),
        ("[policy]\nhidden = []", "policy.hidden"),
        ("[policy]\nlength_bias = -51.0", "policy.length_bias"),
        ("[policy]\ninitiate_bias = 1e39", "policy.initiate_bias"),
        ("[policy]\nencoder = \"lstm\"\nlstm_state = 0", "policy.lstm_state"),
        ("[policy]\nencoder = \"attention\"", "does not consist of entities"),
        (
            "domain = \"highway\"\n[policy]\nencoder = \"attention\"\nattention_heads = 3",
            "policy.attention_heads",
        ),
        (
            "[policy]\nencoder = \"lstm\"\n[learner]\nn_envs = 4\nn_minibatches = 8",
            "learner.n_minibatches",
        ),
        ("[run]\nactors_min = 0", "run.actors_min"),
        ("[evaluation]\nepisodes = 0", "evaluation.episodes"),
        ("[evaluation.world]\nmax_steps = 0", "evaluation.world"),
        ("[world]\nzones = [{ x0 = 1.0, x1 = 0.0, y0 = 0.0, y1 = 1.0 }]", "world.zones"),
        ("[notifier]\nwords = [5, 2]", "notifier.words"),
    ] {
        let refused = refused(text);
        assert!(refused.contains(key), "{key}: {refused}");
    }
}

#[test]
fn the_command_line_has_the_last_word() {
    let set = |text: &str| Assignment::parse(text).unwrap();
    let source = ConfigSource {
        config: Some("cartpole".into()),
        set: vec![set("learner.learning_rate=1"), set("world.max_steps=200")],
        seed: Some(7),
        runs: Some("elsewhere".into()),
    };
    let registry = Registry::builtin();
    let config = load(&source, Some("mine"), &Catalog::built_in(), &registry).unwrap();
    assert_eq!(config.learner.learning_rate, 1.0);
    assert_eq!(config.task.settings, r#"{"world":{"max_steps":200}}"#);
    assert_eq!((config.seed, config.run.directory.to_str()), (7, Some("elsewhere")));
    assert_eq!(config.run.name.unwrap().as_str(), "mine");
    let wrong = ConfigSource { set: vec![set("learner.clipp=1")], ..ConfigSource::default() };
    let error = load(&wrong, None, &Catalog::built_in(), &registry).unwrap_err();
    let text = format!("{error:#}");
    assert!(text.contains("--set learner.clipp") && text.contains("`clip`"), "{text}");
}

#[test]
fn evaluation_may_differ_from_training() {
    let config = check("").unwrap();
    assert!(config.task.settings.contains("\"zone_ends_episode\":true"));
    assert!(config.evaluation.task.settings.contains("\"zone_ends_episode\":false"));
}

#[test]
fn a_domain_of_ones_own_starts_from_general_defaults() {
    let mut catalog = Catalog::built_in();
    catalog.add("mine", "domain = \"mine\"\n[world]\nwidth = 3\n[learner]\nn_envs = 2\n");
    let table = parse("domain = \"mine\"\n[world]\nheight = 4", &catalog).unwrap();
    let typed = sections::typed("mine", table).unwrap();
    assert_eq!(typed.settings, r#"{"world":{"height":4,"width":3}}"#);
    assert_eq!((typed.learner.n_envs, typed.policy.hidden.len()), (2, 2));
    assert!(catalog.text("mine").unwrap().contains("# hidden = [64, 64]"));
}
