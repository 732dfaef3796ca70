use std::path::PathBuf;

use leadtime_highway::task::HighwayWorldSettings;
use leadtime_lander::task::LanderWorldSettings;
use leadtime_ppo::{LearnerSettings, Truncation};
use leadtime_proto::TaskSpec;
use leadtime_sims::classic::{CartPole, CartPoleSettings};
use leadtime_sims::env_check::check_environment;
use leadtime_sims::{DomainEntry, Registry};
use leadtime_steakhouse::task::SteakhouseWorldSettings;
use toml::Table;

use super::{Catalog, Config, ConfigError, ConfigSource, Layer, Override, identity, read};

fn load(text: &str, set: &[&str], catalog: &Catalog) -> Result<Config, ConfigError> {
    let source = ConfigSource {
        file: Some(Layer::text("configuration my.toml", text)),
        set: set.iter().map(|text| Override::parse(text).unwrap()).collect(),
        ..ConfigSource::default()
    };
    Config::load(&source, catalog, &registry())
}

/// The built-in worlds, with a stand-in for the one that a process in Python steps.
fn registry() -> Registry {
    leadtime_worlds::builtin().with("python", |_settings| {
        Ok(Box::new(CartPole::new(&CartPoleSettings { max_steps: 20 })?))
    })
}

fn check(text: &str) -> Result<Config, ConfigError> {
    load(text, &[], &Catalog::built_in())
}

fn named(name: &str) -> Config {
    check(&format!("base = \"{name}\"")).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Asserts that a text and changes are refused, in one short message that holds all of `parts` and nothing dangerous.
#[track_caller]
fn refused(text: &str, set: &[&str], parts: &[&str]) -> String {
    let error = load(text, set, &Catalog::built_in()).expect_err("the configuration is refused");
    let error = error.to_string();
    assert!(parts.iter().all(|part| error.contains(part)), "{parts:?}: {error}");
    assert!(error.len() < 2_000 && !error.contains('\u{1b}'), "{} bytes: {error:?}", error.len());
    error
}

/// The built-in configurations as `leadtime config NAME` prints them.
fn printed() -> Vec<(String, String)> {
    let catalog = Catalog::built_in();
    let text = |name: &str| (name.to_owned(), catalog.text(name).unwrap().unwrap());
    catalog.names().map(text).collect()
}

#[test]
fn every_built_in_configuration_is_sound_and_is_printed_complete_with_a_comment_for_every_key() {
    for (name, text) in printed() {
        let resolved = named(&name);
        let written: Table = text.parse().unwrap_or_else(|error| panic!("{name}: {error}\n{text}"));
        assert_eq!(identity::flatten(&written), identity::flatten(&resolved.table), "{name}");
        assert_eq!(check(&text).unwrap().table, resolved.table, "{name} read again");
        // Every key has a comment.
        let mut before = "";
        for line in text.lines() {
            let is_key = line.split_once(" = ").is_some_and(|(key, _)| {
                key.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_')
            });
            let explained = before.starts_with("# ") || before == "[evaluation.world]";
            assert!(!is_key || explained, "{name}: `{line}` has no comment");
            before = line;
        }
        let (before, _) = text.split_once("\ntotal_steps = ").unwrap();
        let comment: Vec<&str> = before.lines().rev().take_while(|l| l.starts_with('#')).collect();
        assert!(comment.iter().any(|line| line.contains("anneal = true")), "{name}: total_steps");
    }
}

/// The profiles that follow the paper to the letter repeat what they share with their base: each line says where the paper has it.
#[test]
fn a_built_in_configuration_writes_only_what_differs_from_its_base() {
    let catalog = Catalog::built_in();
    for name in catalog.names().filter(|name| !name.starts_with("paper_letter_")) {
        let mut layers = catalog.with_bases(&catalog.file(name).unwrap()).unwrap();
        let own: Table = layers.pop().unwrap().text.parse().unwrap();
        let below = identity::flatten(&read::<Table>(layers).unwrap());
        for (key, value) in identity::flatten(&own) {
            assert_ne!(below.get(&key), Some(&value), "{name}: {key}");
        }
    }
}

#[test]
fn a_printed_configuration_has_the_comments_of_all_of_its_files() {
    let catalog = Catalog::built_in();
    for (name, text) in printed() {
        let own = catalog.file(&name).unwrap().text;
        let (above, below) = own.split_once("\nbase = ").expect("every world has a base");
        // What stands above the base is about the file, but for its head.
        let head = above.split("\n\n").next().unwrap();
        let said = head.lines().chain(below.lines()).map(str::trim);
        for line in said.filter(|line| line.starts_with('#')) {
            assert!(text.contains(line), "{name}: `{line}` is not printed");
        }
    }
}

#[test]
fn sections_are_printed_in_the_order_in_which_a_task_is_explained() {
    let order = |text: &str| {
        let sections = text.lines().filter(|line| line.starts_with('[') && !line.contains('.'));
        sections.map(str::to_owned).collect::<Vec<_>>()
    };
    for (name, text) in printed() {
        let listens = text.contains("\n[human]\n");
        let spoken: &[&str] = if listens { &["[human]", "[notifier]"] } else { &[] };
        let rest = ["[policy]", "[learner]", "[actor]", "[evaluation]"];
        assert_eq!(order(&text), [&["[run]", "[world]"], spoken, &rest].concat(), "{name}");
    }
    let highway = &printed().into_iter().find(|(name, _)| name == "highway").unwrap().1;
    let at = |line: &str| highway.find(&format!("\n{line}\n")).unwrap();
    assert!(at("[world]") < at("[world.ego]") && at("[world.road]") < at("[human]"), "{highway}");
}

/// The first four bytes of every run identity: a run that was begun is found only as long as they stay. The kitchen's
/// are as computed before variants became differences to a base.
#[test]
fn run_identities_stay() {
    let expected = [
        ("cartpole", 2_749_332_832),
        ("cue_recall", 879_600_762),
        ("highway", 741_220_534),
        ("highway_conflict", 3_777_678_866),
        ("lander", 2_641_403_731),
        ("lander_hard", 150_016_040),
        ("paper_highway", 741_220_534),
        ("paper_lander", 2_311_859_075),
        ("paper_lander_hard", 3_622_931_962),
        ("pilot", 3_946_323_515),
        ("steakhouse", 1_151_090_681),
        ("steakhouse_timing", 3_042_336_859_u32),
    ];
    let first = |name| {
        let [a, b, c, d, ..] = identity::of_run(&named(name).table);
        u32::from_be_bytes([a, b, c, d])
    };
    let found = expected.map(|(name, _)| (name, first(name)));
    assert_eq!(found, expected);
}

/// The profiles that follow the paper to the letter, each with what only it has, as TOML.
const LETTER: [(&str, &str); 4] = [
    (
        "paper_letter_lander",
        r#"
        world = { observe_time = false, zone_ends_episode = false, entry_penalty = 20.0, entry_charged = "per_frame" }
        world.near_charged = "per_frame"
        human.follow_through = "length"
        human.reaction_reward = "off"
        policy = { encoder = "none", hidden = [64, 64], normalize_observations = false }
        learner = { n_envs = 4, n_steps = 128, n_minibatches = 4, n_epochs = 4, normalize_rewards = false }
        "#,
    ),
    (
        "paper_letter_lander_hard",
        r#"
        world = { observe_time = false, zone_ends_episode = false, entry_penalty = 20.0, entry_charged = "per_frame" }
        world.near_charged = "per_frame"
        human.follow_through = { fixed = 3 }
        human.reaction_reward = "once"
        policy = { encoder = "none", hidden = [64, 64], normalize_observations = true }
        learner = { n_envs = 16, n_steps = 600, n_minibatches = 8, n_epochs = 8, normalize_rewards = true }
        "#,
    ),
    (
        "paper_letter_highway",
        r#"
        world.absorb_until = 0
        human.follow_through = "twice_length_minus_two"
        policy = { encoder = "attention", attention_width = 64, attention_heads = 2, hidden = [64, 64] }
        policy.normalize_observations = false
        learner = { n_envs = 4, n_steps = 128, n_minibatches = 4, n_epochs = 4, normalize_rewards = false }
        "#,
    ),
    (
        "paper_letter_steakhouse",
        r#"
        human.follow_through = { fixed = 3 }
        policy = { encoder = "lstm", lstm_projection = 32, lstm_state = 128, hidden = [] }
        policy.normalize_observations = false
        learner = { n_envs = 4, n_steps = 128, n_minibatches = 4, n_epochs = 4, normalize_rewards = false }
        "#,
    ),
];

/// What all of them have.
const EVERY_LETTER: &str = r#"
    human = { words_from = 1, reaction_delay = { fixed = 2 }, follow_through_end = "inclusive", interrupt = "replace" }
    human.can_stop = true
    human.pending = "overwrite_on_comprehension"
    human.repeat = "restart"
    notifier.observe_utterance = false
    policy = { head_credit = "all", initiate_bias = 0.0, length_bias = 0.0 }
    learner = { mode = "sync", learning_rate = 2.5e-4, anneal = true, gamma = 0.99, gae_lambda = 0.95, clip = 0.2 }
    learner.value_clip = true
    learner.normalize_advantages = true
    learner.entropy_coef = 0.01
    learner.value_coef = 0.5
    learner.max_grad_norm = 0.5
    learner.truncation = "cleanrl"
    learner.reward_scale = 1.0
"#;

#[test]
fn the_letter_profiles_have_what_the_paper_writes() {
    // One line at a time: in one text a table and its dotted keys would exclude each other.
    let leaves = |text: &str| {
        let lines = text.lines().map(|line| line.parse::<Table>().unwrap());
        lines.flat_map(|table| identity::flatten(&table)).collect::<Vec<_>>()
    };
    for (name, own) in LETTER {
        let config = named(name);
        let written = identity::flatten(&config.table);
        for (key, value) in leaves(EVERY_LETTER).into_iter().chain(leaves(own)) {
            assert_eq!(written.get(&key), Some(&value), "{name}: {key}");
        }
        assert!(config.policy.logit_bias.is_empty(), "{name}: an untrained policy has a bias");
        assert!(!written.contains_key("learner.target_kl"), "{name}: target_kl");
    }
}

#[test]
fn a_letter_profile_plays_on_the_map_of_the_profile_that_it_stands_beside() {
    for (letter, ours) in
        [("paper_letter_lander", "paper_lander"), ("paper_letter_lander_hard", "paper_lander_hard")]
    {
        let [letter, ours] = [letter, ours].map(|name| named(name).table);
        for key in ["zones", "frames_per_step", "max_steps", "zone_jitter", "reaction", "on_pad"] {
            assert_eq!(letter["world"][key], ours["world"][key], "{key}");
        }
        assert_eq!(letter["notifier"]["notification"], ours["notifier"]["notification"]);
        assert_eq!(letter["learner"]["total_steps"], ours["learner"]["total_steps"]);
    }
}

/// A run of the road from before its later settings.
#[test]
fn an_earlier_run_on_the_road_keeps_its_identity() {
    let table = named("highway").table;
    let shorter: String = table
        .to_string()
        .lines()
        .filter(|line| !line.starts_with("arrive_within"))
        .collect::<Vec<_>>()
        .join("\n");
    let stored = Config::stored("the run", &shorter, &[], &leadtime_worlds::builtin()).unwrap();
    assert_eq!(identity::of_run(&stored.table), identity::of_run(&table));
}

/// A run from before sentences decided which messages state a reason.
#[test]
fn an_earlier_run_keeps_its_identity_without_the_setting_that_is_gone() {
    let table = named("lander").table;
    let earlier = table.to_string().replace("[human]\n", "[human]\nreason_from_words = 4\n");
    let stored = |text: &str| Config::stored("the run", text, &[], &leadtime_worlds::builtin());
    assert_eq!(stored(&earlier).unwrap().table, table);
    let earlier_table: Table = earlier.parse().unwrap();
    assert_eq!(identity::of_run(&earlier_table), identity::of_run(&table));
    assert!(identity::difference(&earlier_table, &table).is_empty());
    // Where a reason was worth something, the run cannot be carried on as it was.
    let paid = earlier.replace("reason_weight = 0.0", "reason_weight = 4.0");
    let error = stored(&paid).unwrap_err().to_string();
    assert!(error.contains("reason_from_words"), "{error}");
}

#[test]
fn the_learners_own_defaults_are_those_of_cartpole() {
    let config = check("domain = \"cartpole\"").unwrap();
    let own = LearnerSettings { truncation: Truncation::Cleanrl, ..LearnerSettings::default() };
    assert_eq!(config.learner, own);
}

/// Worlds of one's own, whose code may leave the listener and the notifier as they are, start from the code's defaults; the
/// built-in ones from the files.
#[test]
fn the_defaults_in_the_code_are_those_of_the_files() {
    let entries = [
        ("lander", DomainEntry::notifier::<LanderWorldSettings>("lander")),
        ("highway", DomainEntry::notifier::<HighwayWorldSettings>("highway")),
        ("steakhouse", DomainEntry::notifier::<SteakhouseWorldSettings>("steakhouse")),
    ];
    for (name, entry) in entries {
        let mut catalog = Catalog::built_in();
        catalog.add("mine", "domain = \"mine\"");
        catalog.add_defaults("mine", &entry.defaults().unwrap());
        let table: Table = catalog.text("mine").unwrap().unwrap().parse().unwrap();
        let of_file = named(name).table;
        for section in ["world", "human", "notifier"] {
            assert_eq!(table[section], of_file[section], "{name}, [{section}]");
        }
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
    let hard = check("base = \"paper_lander_hard\"\nhuman.reaction_delay = { fixed = 4 }").unwrap();
    assert_eq!((hard.domain.as_str(), hard.learner.gamma), ("lander", 0.999));
    assert!(hard.task.settings.contains("\"reaction_delay\":{\"fixed\":4}"), "{hard:?}");
    assert!(!hard.table.contains_key("base"));
    for (text, part) in [
        ("base = \"paper\"", "`base` is \"paper\"; allowed: cartpole, cue_recall"),
        ("domain = \"moon\"", "`domain` is \"moon\"; allowed: cartpole"),
        ("base = 3", "`base` is a whole number; allowed: a name in quotes"),
        ("base = \"highway\"\ndomain = \"lander\"", "`domain` is \"lander\"; allowed: \"highway\""),
        ("base = \"notifier\"", "general"),
    ] {
        refused(text, &[], &[part]);
    }
}

#[test]
fn another_choice_replaces_the_old_one() {
    let delay = |text: &str, set: &[&str]| {
        let config = load(text, set, &Catalog::built_in()).unwrap();
        config.table["human"]["reaction_delay"].to_string()
    };
    let uniform = "human.reaction_delay.uniform = { low = 1, high = 3, drawn = \"per_episode\" }";
    let all = "{ uniform = { drawn = \"per_episode\", high = 3, low = 1 } }";
    assert_eq!(delay(uniform, &[]), all);
    assert_eq!(delay(uniform, &["human.reaction_delay.fixed=3"]), "{ fixed = 3 }");
    assert_eq!(delay("", &["human.reaction_delay={fixed=4}"]), "{ fixed = 4 }");
    assert_eq!(delay("human.reaction_delay = 3", &[]), "{ fixed = 3 }", "a bare number");
    let negative = "whole number `-1`, expected a number of steps";
    refused("", &["human.reaction_delay=-1"], &[negative]);
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
fn a_wrong_value_is_reported_by_line_or_option_with_what_is_allowed() {
    let text = refused("domain = \"cartpole\"\n\n[learner]\nn_env = 8", &[], &[]);
    let expected = "configuration my.toml: TOML parse error at line 4, column 1\n  |\n4 | n_env = 8\n  | ^^^^^\n\
                    unknown key `n_env`; did you mean `n_envs`?";
    assert!(text.starts_with(expected), "{text}");
    for (text, parts) in [
        ("[human]\nrepeat = \"often\"", ["line 2", "restart"]),
        (
            "[learner]\nclip = \"much\"",
            ["line 2", "invalid type: text \"much\", expected a number"],
        ),
        ("domain = \"cartpole\"\n[human]\ncan_stop = true", ["line 2", "unknown key `human`"]),
        ("\nlearning_rate = 1.0", ["line 2", "did you mean `learner.learning_rate`?"]),
        ("\nlerning_rate = 1.0", ["line 2", "did you mean `learner.learning_rate`?"]),
        ("\n[leaner]\nclip = 1.0", ["line 2", "did you mean `learner`?"]),
        ("[learner]\nmode = \"sycn\"", ["line 2", "did you mean `sync`?"]),
        ("[evaluation.world]\n\nwnd = true", ["line 3", "unknown key `wnd`"]),
        ("[[[[", ["line 1", "[[[["]),
        // Numbers that no setting can have, wherever they hide.
        ("seed = 1\n[learner]\nclip = nan", ["line 3", "`learner.clip` is nan; allowed: a finite"]),
        ("[world]\nzone_jitter = [1.0, -inf]", ["line 2", "`world.zone_jitter` is -inf; allowed"]),
        ("[world]\n\nzones = [{ x0 = inf }]", ["line 3", "`world.zones.x0` is inf; allowed"]),
        (
            "domain = \"python\"\n[world]\nenv = { day = [1979-05-27] }",
            ["line 3", "`world.env.day` is 1979-05-27; allowed: a date as text in quotes only"],
        ),
        (
            "seed = 9223372036854775808",
            ["line 1", "allowed: whole numbers up to 922337203685477580"],
        ),
    ] {
        refused(text, &[], &parts);
    }
    for (set, parts) in [
        ("learner.clipp=1", ["--set learner.clipp: ", "`clip`"]),
        ("learning_rate=1", ["--set learning_rate: ", "did you mean `learner.learning_rate`?"]),
        ("learner=[]", ["--set learner: `learner` is a section, not a list: set its", "`anneal`"]),
        ("learner=3", ["`learner` is a section, not a whole number: set", "such as `anneal`"]),
        ("human.reaction_delay=[]", ["`reaction_delay` is a section, not a list", "`fixed`"]),
        ("base=3", ["--set base: ", "is named in its file, or by `-c`"]),
        ("base.x=3", ["--set base.x: ", "is named in its file, or by `-c`"]),
        ("learner.n_envs=1.5", ["--set learner.n_envs: ", "number `1.5`, expected a whole number"]),
        ("seed=-1", ["whole number `-1`", ", expected a whole number that is not negative"]),
        ("actor.window=5e9", ["`5000000000`", ", expected a whole number that is not as large"]),
        ("learner.anneal=3", ["whole number `3`", ", expected true or false"]),
        ("run.name=true", ["invalid type: `true`", ", expected text"]),
        ("run.keep=3", ["whole number `3`", ", expected a table"]),
        ("evaluation.world=3", ["whole number `3`", ", expected a table"]),
        ("policy.hidden={a=1}", ["invalid type: a table", ", expected a list"]),
        ("world.zone_jitter=3", ["whole number `3`", ", expected a list"]),
        ("world.zone_jitter=[1.0]", ["invalid length 1", ", expected a list of length 2"]),
        ("human.reaction_delay={uniform=[1]}", ["invalid type: a list", ", expected a table"]),
        ("human.reaction_delay={uniform={low=1}}", ["reaction_delay: ", "missing key `high`"]),
        ("human.repeat=often", ["unknown choice `often`", "expected `restart` or `continue`"]),
        ("learner.mode=3", ["--set learner.mode: ", "expected text or a table"]),
        ("learner.clip=\", expected \"", ["text \", expected \"", ", expected a number"]),
        ("world.landing_reward=nan", ["`world.landing_reward` is nan", "a finite number"]),
    ] {
        refused("", &[set], &parts);
    }
    // What two texts make together is the fault of the one that was written last.
    let two = "base = \"lander\"\n[human]\nreaction_delay = { fixed = 2, uniform = [0, 3] }";
    let text =
        refused(two, &[], &["configuration my.toml: ", "line 3", "a second choice `uniform`"]);
    assert!(!text.contains("built-in"), "{text}");
    let says = "--set domain: `domain` is \"lander\"; allowed: \"cartpole\", which the configuration is about";
    refused("domain = \"cartpole\"", &["domain=lander"], &[says]);
    refused("domain = \"cartpole\"", &["domain=cartpole", "domain=lander"], &[says]);
    load("domain = \"cartpole\"", &["domain=cartpole"], &Catalog::built_in()).unwrap();
}

#[test]
fn impossible_values_are_reported_by_key() {
    let heads = "domain = \"highway\"\n[policy]\nencoder = \"attention\"\nattention_heads = 3";
    let cut = "[policy]\nencoder = \"lstm\"\n[learner]\nn_envs = 4\nn_minibatches = 8";
    for (text, key) in [
        ("[learner]\nclip = -1.0", "learner.clip"),
        ("[actor]\nwindow = 0", "actor.window"),
        ("[policy]\nhidden = []", "policy.hidden"),
        ("[policy]\nhidden = [4096, 4096]", "policy.hidden"),
        ("[policy]\nlength_bias = -51.0", "policy.length_bias"),
        ("[policy]\ninitiate_bias = 1e39", "policy.initiate_bias"),
        ("[policy]\nencoder = \"lstm\"\nlstm_state = 0", "policy.lstm_state"),
        ("[policy]\nencoder = \"attention\"", "does not consist of entities"),
        (heads, "policy.attention_heads"),
        (cut, "learner.n_minibatches"),
        ("[learner]\nn_steps = 65536", "learner.n_steps"),
        ("[learner]\nn_envs = 20000", "learner.n_envs"),
        ("[run]\nactors_min = 0", "run.actors_min"),
        ("[run]\nname = \"A\"", "run.name"),
        ("[evaluation]\nepisodes = 0", "evaluation.episodes"),
        ("[evaluation]\nduring_training = 1001", "evaluation.during_training"),
        ("[evaluation]\nheld_out_episodes = 1", "evaluation.held_out_episodes"),
        ("[evaluation]\nstop_at = 1.5", "evaluation.stop_at"),
        ("[evaluation]\nstop_at = 0.0", "above 0 to 1"),
        ("[evaluation]\nstop_at = 0.9\nduring_training = 0", "evaluation.during_training"),
        ("domain = \"cartpole\"\n[evaluation]\nstop_at = inf", "evaluation.stop_at"),
        ("[evaluation.world]\nmax_steps = 0", "evaluation.world"),
        ("[world]\nzones = [{ x0 = 1.0, x1 = 0.0, y0 = 0.0, y1 = 1.0 }]", "world.zones"),
        ("[notifier]\nwords = [5, 2]", "`notifier.words` is [5, 2]"),
        ("[notifier]\nwords = [0]", "notifier.words"),
        ("[notifier]\nwords = []", "notifier.words"),
        ("[notifier]\ntopics = []", "notifier.topics"),
        ("[human]\nreaction_delay = { fixed = 99 }", "human.reaction_delay"),
        ("domain = \"cartpole\"\n[world]\nmax_steps = 0", "world.max_steps"),
        ("domain = \"cartpole\"\nseed = -1", "line 2"),
        ("domain = \"cartpole\"\n[leaner]", "unknown key `leaner`"),
        ("[run]\nname = \"a/b\"", "run.name"),
        ("[human]\ninterrupt = \"never\"", "finish"),
    ] {
        refused(text, &[], &[key]);
    }
}

/// Among the rest: a lander that touches the ground remembers its contacts, nine times what it is at the start, and no
/// snapshot may be larger than the bound that checkpoints are planned with.
#[test]
fn every_built_in_configuration_is_played_without_a_defect() {
    let registry = registry();
    for name in Catalog::built_in().names() {
        let config = named(name);
        for task in [&config.task, &config.evaluation.task] {
            let report = check_environment(|| registry.build(task)).unwrap();
            assert!(report.defects.is_empty(), "{name}: {:?}", report.defects);
            assert_eq!(report.rewards.notice(), None, "{name}");
        }
    }
}

#[test]
fn steps_that_are_no_whole_updates_are_reported() {
    let rounded = |steps: u64| {
        let text = format!("domain = \"cartpole\"\nlearner.total_steps = {steps}");
        check(&text).unwrap().rounded_steps()
    };
    assert_eq!(rounded(512), None);
    let reported = |steps, how: &str| {
        let expected = format!("steps rounded {how} of 512");
        assert_eq!(rounded(steps), Some(expected));
    };
    reported(1, "up from 1 to 512: 1 update");
    reported(1_500, "down from 1500 to 1024: 2 updates");
}

#[test]
fn one_form_of_a_number_is_as_good_as_another() {
    let changed = |set: &[&str]| load("", set, &Catalog::built_in()).unwrap();
    let same = |set: &[&str], long: &[&str]| {
        let (config, long) = (changed(set), changed(long));
        assert_eq!(config.table, long.table, "{set:?}");
        assert_eq!(identity::of_run(&config.table), identity::of_run(&long.table));
    };
    same(&["human.reaction_delay=3"], &["human.reaction_delay={fixed=3}"]);
    same(&["human.follow_through=3"], &["human.follow_through.fixed=3"]);
    same(&["learner.total_steps=1e6"], &["learner.total_steps=1000000"]);
    same(&["learner.clip=1"], &["learner.clip=1.0"]);
    refused("", &["learner.total_steps=1.5"], &["--set learner.total_steps", "1.5"]);
    let file = |number: &str| {
        let text = format!("learner.total_steps = {number} # all\n[run]\nactors_min = 1");
        load(&text, &[], &Catalog::built_in()).unwrap().table
    };
    assert_eq!(file("1e6"), file("1000000"));
    assert_eq!(identity::of_run(&file("1_000_000.0")), identity::of_run(&file("1_000_000")));
    refused("[learner]\ntotal_steps = 1.5", &[], &["line 2", "1.5"]);
}

#[test]
fn a_setting_is_found_by_its_last_part() {
    let catalog = Catalog::built_in();
    assert_eq!(catalog.key("learning_rate").as_deref(), Some("learner.learning_rate"));
    assert_eq!(catalog.key("reaction_delay").as_deref(), Some("human.reaction_delay"));
    assert_eq!(catalog.key("sed"), None);
}

#[test]
fn the_command_line_has_the_last_word() {
    let set = |text: &str| Override::parse(text).unwrap();
    let catalog = Catalog::built_in();
    let source = ConfigSource {
        file: catalog.file("cartpole"),
        set: vec![set("learner.learning_rate=1"), set("world.max_steps=200")],
        seed: Some(7),
        steps: Some(4096),
        runs: Some("elsewhere".into()),
        name: Some("mine".to_owned()),
    };
    let config = Config::load(&source, &catalog, &leadtime_worlds::builtin()).unwrap();
    assert_eq!(config.learner.learning_rate, 1.0);
    assert_eq!(config.table["learner"]["learning_rate"].to_string(), "1.0");
    assert_eq!(config.task.settings, r#"{"world":{"max_steps":200}}"#);
    assert_eq!((config.seed, config.learner.total_steps), (7, 4096));
    assert_eq!(config.run.directory, PathBuf::from("elsewhere"));
    assert_eq!(config.run.name.unwrap().as_str(), "mine");
    let seed = ConfigSource { seed: Some(1 << 63), ..source };
    let error = Config::load(&seed, &catalog, &leadtime_worlds::builtin()).unwrap_err().to_string();
    assert!(error.contains("`--seed` is 9223372036854775808; allowed: 0 to"), "{error}");
}

#[cfg(unix)]
#[test]
fn a_directory_of_runs_need_not_be_text() {
    use std::os::unix::ffi::OsStrExt as _;
    let directory = PathBuf::from(std::ffi::OsStr::from_bytes(b"r\xff"));
    let source = ConfigSource { runs: Some(directory.clone()), ..ConfigSource::default() };
    let registry = leadtime_worlds::builtin();
    let config = Config::load(&source, &Catalog::built_in(), &registry).unwrap();
    assert_eq!(config.run.directory, directory);
    let changed = config.with([Layer::text("", "seed = 2")], &registry).unwrap();
    assert_eq!((changed.seed, changed.run.directory), (2, directory));
    let nul = ConfigSource { runs: Some("a\0b".into()), ..ConfigSource::default() };
    let error = Config::load(&nul, &Catalog::built_in(), &registry).unwrap_err().to_string();
    assert!(error.contains("allowed: a path without NUL"), "{error}");
}

#[test]
fn evaluation_may_differ_from_training_and_a_drive_is_evaluated_to_its_arrival() {
    let same = check("domain = \"cartpole\"").unwrap();
    assert_eq!(same.evaluation.task, same.task);
    let both = |config: &Config, key: &str| {
        [&config.task, &config.evaluation.task].map(|task| {
            let mut settings: serde_json::Value = serde_json::from_str(&task.settings).unwrap();
            settings["world"][key].take()
        })
    };
    assert_eq!(both(&check("").unwrap(), "zone_ends_episode"), [true, false]);
    let highway = check("domain = \"highway\"").unwrap();
    assert_eq!(both(&highway, "absorb_until"), [200, 0]);
    // As runs and policies have it that are older than this rule.
    let stored = highway.table.to_string();
    let stored = Config::stored("the run", &stored, &[], &leadtime_worlds::builtin()).unwrap();
    assert_eq!(both(&stored, "absorb_until"), [200, 0]);
    let own = check("domain = \"highway\"\n[evaluation.world]\nabsorb_until = 150").unwrap();
    assert_eq!(both(&own, "absorb_until"), [200, 150]);
}

#[test]
fn a_change_of_the_world_that_evaluations_overrule_is_refused_with_the_key_that_counts() {
    let registry = leadtime_worlds::builtin();
    let told = |text: &str, key: &str| {
        let change = Override::new(key, true);
        let checked = check(text).unwrap().check_evaluated(&change, &registry);
        checked.err().map(|error| error.to_string()).unwrap_or_default()
    };
    let drive = "domain = \"highway\"";
    let text = told("", "world.zone_ends_episode");
    assert!(text.contains("change `evaluation.world.zone_ends_episode`"), "{text}");
    assert!(told(drive, "world.absorb_until").contains("`evaluation.world.absorb_until`"));
    let windy = "[evaluation.world]\nwind = true";
    assert!(told(windy, "world.wind").contains("`evaluation.world.wind`"));
    for free in ["world.wind", "evaluation.world.zone_ends_episode", "human.can_stop", "seed"] {
        assert_eq!(told("", free), "", "{free}");
    }
    assert_eq!(told(drive, "world.zone_ends_episode"), "", "another domain has that");
    let whole = Override::parse("world={wind=true, zone_ends_episode=true}").unwrap();
    let text = check("").unwrap().check_evaluated(&whole, &registry).unwrap_err().to_string();
    assert!(text.starts_with("--set: `world.zone_ends_episode` has no effect"), "{text}");
}

#[test]
fn a_stored_configuration_may_lack_what_came_later() {
    let mut table = check("").unwrap().table;
    for key in ["length_bias", "attention_width", "attention_heads"] {
        table["policy"].as_table_mut().unwrap().remove(key).unwrap();
    }
    let stored = |set: &[Override]| {
        Config::stored("the policy", &table.to_string(), set, &leadtime_worlds::builtin()).unwrap()
    };
    assert_eq!(stored(&[]).table, check("").unwrap().table);
    let slower = stored(&[Override::parse("human.reaction_delay.fixed=5").unwrap()]);
    assert!(slower.task.settings.contains("\"reaction_delay\":{\"fixed\":5}"));
}

#[test]
fn a_domain_of_ones_own_starts_from_general_defaults() {
    let mut catalog = Catalog::built_in();
    let text = "# Mine.\n\ndomain = \"mine\"\n\n[world]\n# Metres.\nwidth = 3\nx = 1.5\n\n\
                # The person.\n[human]\npatience = 2\n\n[learner]\nn_envs = 2\n";
    catalog.add("mine", text);
    let printed = catalog.text("mine").unwrap().unwrap();
    let parts =
        ["# Mine.\n", "[world]\n# Metres.\nwidth = 3", "\n# The person.\n[human]", "n_envs = 2"];
    assert!(parts.iter().all(|part| printed.contains(part)), "{printed}");
    let registry = leadtime_worlds::builtin().with("mine", |settings| {
        let expected = r#"{"human":{"patience":2},"world":{"height":4,"width":3,"x":2.0}}"#;
        assert_eq!(settings, expected);
        let settings = String::from("{}");
        leadtime_worlds::builtin().build(&TaskSpec { domain: "cartpole".to_owned(), settings })
    });
    let load = |text: &str, set: &str| {
        let file = Some(Layer::text("mine.toml", text));
        let set = vec![Override::parse(set).unwrap()];
        let source = ConfigSource { file, set, ..ConfigSource::default() };
        Config::load(&source, &catalog, &registry).unwrap()
    };
    let config = load("domain = \"mine\"\n[world]\nheight = 4", "world.x=2");
    assert_eq!((config.learner.n_envs, config.policy.hidden.len()), (2, 2));
    let again = load(&printed.replace("x = 1.5", "x = 2.0"), "world.height=4");
    assert_eq!(again.table["world"]["width"].as_integer(), Some(3));
}

#[test]
fn two_keys_of_one_table_are_two_choices_only_where_the_table_is_one() {
    let mut catalog = Catalog::built_in();
    let text =
        "domain = \"mine\"\n[world]\nwind = { fixed = 2 }\nego = { speed = 1, braking = 2 }\n";
    catalog.add("mine", text);
    let registry = leadtime_worlds::builtin().with("mine", |_settings| {
        Ok(Box::new(CartPole::new(&CartPoleSettings { max_steps: 20 })?))
    });
    let load = |text: &str, set: &[&str]| {
        let file = Some(Layer::text("mine.toml", format!("domain = \"mine\"\n{text}")));
        let set = set.iter().map(|text| Override::parse(text).unwrap()).collect();
        let source = ConfigSource { file, set, ..ConfigSource::default() };
        Config::load(&source, &catalog, &registry).unwrap().table
    };
    let ego: Table = "speed = 3\nbraking = 4".parse().unwrap();
    let set = ["evaluation.world.ego.speed=3", "evaluation.world.ego.braking=4"];
    let file = "[evaluation.world.ego]\nspeed = 3";
    for table in [load("", &set), load(file, &set[1..])] {
        assert_eq!(table["evaluation"]["world"]["ego"].as_table(), Some(&ego));
    }
    let wind = ["evaluation.world.wind.fixed=3", "evaluation.world.wind.uniform=4"];
    let uniform: Table = "uniform = 4".parse().unwrap();
    assert_eq!(load("", &wind)["evaluation"]["world"]["wind"].as_table(), Some(&uniform));
    // Below `env` every key is its user's own.
    let env = load("", &["world.env.a.speed=3", "world.env.a.braking=4"]);
    assert_eq!(env["world"]["env"]["a"].as_table(), Some(&ego));
    // One that is dropped would not be refused either.
    let set = ["evaluation.world.ego.braking=100", "evaluation.world.ego.speed=20"];
    for n_set in [1, 2] {
        refused("base = \"highway\"", &set[..n_set], &["braking"]);
    }
}

/// What others start from has names of its own, and a domain may have one of them.
#[test]
fn a_domain_may_be_called_as_a_base_is() {
    for domain in ["general", "notifier"] {
        let entry = DomainEntry::notifier::<HighwayWorldSettings>(domain);
        let mut catalog = Catalog::built_in();
        catalog.add(domain, &format!("domain = \"{domain}\"\n"));
        catalog.add_defaults(domain, &entry.defaults().unwrap());
        let registry = leadtime_worlds::builtin().with_domain(entry);
        let load = |text: &str| {
            let file = Some(Layer::text("", text));
            Config::load(&ConfigSource { file, ..ConfigSource::default() }, &catalog, &registry)
        };
        let own = load(&format!("domain = \"{domain}\"")).unwrap();
        assert_eq!(own.domain.as_str(), domain);
        assert_eq!(own.table["world"]["absorb_until"].as_integer(), Some(200));
        assert_eq!(load("").unwrap().table, named("lander").table);
    }
}

#[test]
fn a_domain_of_ones_own_may_start_from_the_listener_that_every_world_has() {
    let entry = DomainEntry::notifier::<HighwayWorldSettings>("mine");
    let mut catalog = Catalog::built_in();
    catalog.add("mine", "base = \"notifier\"\ndomain = \"mine\"\n");
    let world = named("highway").table["world"].to_string();
    let text = format!("base = \"notifier\"\ndomain = \"mine\"\nworld = {world}");
    let source = ConfigSource { file: Some(Layer::text("", text)), ..ConfigSource::default() };
    let registry = leadtime_worlds::builtin().with_domain(entry);
    let config = Config::load(&source, &catalog, &registry).unwrap();
    assert_eq!(config.table["human"], named("lander").table["human"]);
}

#[test]
fn the_defaults_of_a_world_of_ones_own_are_printed_with_their_comments() {
    let entry = DomainEntry::notifier::<HighwayWorldSettings>("mine");
    let mut catalog = Catalog::built_in();
    let text = "# Mine.\n\ndomain = \"mine\"\n\n[world]\n# Arrival.\nabsorb_until = 150\n\n[notifier]\ninitiation_cost = 0.7\n";
    catalog.add("mine", text);
    catalog.add_defaults("mine", &entry.defaults().unwrap());
    let registry = leadtime_worlds::builtin().with_domain(entry);
    let file = Some(Layer::text("", "domain = \"mine\""));
    let source = ConfigSource { file, ..ConfigSource::default() };
    let config = Config::load(&source, &catalog, &registry).unwrap();
    let printed = catalog.text("mine").unwrap().unwrap();
    let written: Table = printed.parse().unwrap_or_else(|error| panic!("{error}\n{printed}"));
    assert_eq!(identity::flatten(&written), identity::flatten(&config.table));
    // The world's own listener, the general comment, the person's value.
    for part in [
        "# Mine.\n",
        "# Arrival.\nabsorb_until = 150\n",
        "# Steps that a reaction lasts, d_f: \"length\" (I), \"twice_length_minus_two\" (2 I - 2), { fixed = 3 } (1 to 1000).\n\
         follow_through = \"twice_length_minus_two\"\n",
        "`leadtime check` compares the two.\ninitiation_cost = 0.7\n",
        "# topics = [\"TOPIC\", \"OTHER_TOPIC\"]\n",
    ] {
        assert!(printed.contains(part), "{part}: {printed}");
    }
    let (_, spoken) = printed.split_once("\n[human]\n").unwrap();
    let mut before = "";
    for line in spoken.lines() {
        let is_key = !line.starts_with(['#', '[']) && line.contains(" = ");
        assert!(!is_key || before.starts_with('#'), "`{line}` has no comment: {printed}");
        before = line;
    }
}

#[test]
fn endless_and_hostile_texts_are_refused_in_a_few_lines() {
    let deep_key = vec!["a"; 60_000].join(".");
    let inline = format!("{}1{}", "a={".repeat(70), "}".repeat(70));
    let key = vec!["a"; 79].join(".");
    let both = (0..70).fold(format!("{key} = 1"), |inner, _| format!("{key} = {{ {inner} }}"));
    for text in [
        "[".repeat(100_000),
        format!("seed = {}", "[".repeat(100_000)),
        format!("{deep_key} = 1"),
        format!("[{deep_key}]\nb = 1"),
        inline,
        both,
        format!("{deep_key} = 1\nb = = 1"),
        format!("base = \"lander\"\nworld = {{ {deep_key} = 1 }}"),
        format!("{} = 1", "x".repeat(100_000)),
        "\"\\u001b[31m\" = 1".to_owned(),
        "[learner]\nn_envs = \"\\u001b[31m\"".to_owned(),
        "# \u{1b}[31m\nseed = x".to_owned(),
        format!("seed = {}", "9".repeat(100_000)),
        format!("[learner]\nmode = \"{}\"", "x".repeat(100_000)),
    ] {
        refused(&text, &[], &[]);
    }
}

#[test]
fn a_default_that_toml_cannot_hold_is_refused_by_its_key() {
    let mut catalog = Catalog::built_in();
    catalog.add("mine", "domain = \"mine\"\n");
    let sections = serde_json::json!({"world": {"size": 3, "limit": u64::MAX, "none": null}});
    catalog.add_defaults("mine", &sections);
    let error = catalog.text("mine").unwrap().unwrap_err().to_string();
    let told = "the code's defaults of `mine`: `world.limit` is 18446744073709551615; allowed: ";
    assert!(error.starts_with(told), "{error}");
    catalog.add_defaults("mine", &serde_json::json!({"world": {"size": 3, "none": null}}));
    assert!(catalog.text("mine").unwrap().unwrap().contains("\n[world]\nsize = 3\n"));
}
