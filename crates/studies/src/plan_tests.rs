use leadtime_runs::{ForkOrigin, SettingChange};

use super::*;
use crate::test_support::{CART, STUDY, plan, record, request, sentence, study};
use crate::{catalog, profile};

/// Asks for the whole study, in a place without runs.
fn whole() -> StudyRequest {
    request(Path::new("nowhere"))
}

fn names(plan: &StudyPlan) -> Vec<String> {
    plan.trainings().iter().map(|training| training.name.to_string()).collect()
}

fn set(text: &str) -> Vec<Override> {
    vec![Override::parse(text).unwrap()]
}

#[test]
fn a_training_per_row_and_seed_named_by_what_it_computes() {
    let request = StudyRequest { seeds: Some(7..9), ..whole() };
    let plan = plan(STUDY, &request).unwrap();
    let names = names(&plan);
    let stems: Vec<(&str, &str)> =
        names.iter().map(|n| (&n[..n.len() - 14], &n[n.len() - 3..])).collect();
    let expected = [
        ("t-piloting-prompt", "-s7"),
        ("t-piloting-prompt", "-s8"),
        ("t-piloting-real-one", "-s7"),
        ("t-piloting-real-one", "-s8"),
    ];
    assert_eq!(stems, expected);
    assert_eq!(plan.trainings()[1].config.seed, 8);
}

#[test]
fn a_training_is_as_far_as_its_newest_file_says() {
    let runs = tempfile::tempdir().unwrap();
    let training = plan(STUDY, &request(runs.path())).unwrap().trainings()[0].clone();
    let checkpoints = training.directory().join("checkpoints");
    std::fs::create_dir_all(&checkpoints).unwrap();
    let each = training.config.steps_per_update();
    assert_eq!(training.steps()[0], 0);
    // The disk was full before there was room for a checkpoint again.
    let line = format!("{{\"update\": 1, \"steps\": {each}}}\n");
    std::fs::write(training.directory().join("metrics.jsonl"), line).unwrap();
    assert_eq!(training.steps()[0], each);
    std::fs::write(checkpoints.join("000000000002.checkpoint"), "state").unwrap();
    assert_eq!(training.steps()[0], 2 * each);
}

#[test]
fn a_part_has_seeds_of_its_own_unless_the_command_line_says() {
    let later = STUDY.replace("quick_steps", "first_seed = 301\nquick_steps");
    let seeds = |text: &str, request| plan(text, &request).unwrap().parts[0].seeds().to_vec();
    assert_eq!(seeds(STUDY, whole()), (201..211).collect::<Vec<_>>());
    assert_eq!(seeds(&later, whole()), (301..311).collect::<Vec<_>>());
    assert_eq!(seeds(&later, StudyRequest { quick: true, ..whole() }), [301]);
    assert_eq!(seeds(&later, StudyRequest { seeds: Some(7..9), ..whole() }), [7, 8]);
}

#[test]
fn a_rows_number_of_seeds_is_above_the_parts_and_that_above_the_studys() {
    let n_seeds = |text: &str, request| -> Vec<usize> {
        let rows = plan(text, &request).unwrap().parts.remove(0).rows;
        rows.iter().map(|row| row.seeds.len()).collect()
    };
    let study = STUDY.replace("lead = \"l\"", "lead = \"l\"\nseeds = 4");
    assert_eq!(n_seeds(&study, whole()), [4, 4, 4]);
    let part = study.replace("quick_steps", "seeds = 6\nquick_steps");
    assert_eq!(n_seeds(&part, whole()), [6, 6, 6]);
    let row = part.replace("name = \"prompt\"", "name = \"prompt\"\nseeds = 20");
    assert_eq!(n_seeds(&row, whole()), [20, 20, 6], "a script meets every row's episodes");
    assert_eq!(n_seeds(&row, StudyRequest { quick: true, ..whole() }), [1, 1, 1]);
    assert_eq!(n_seeds(&row, StudyRequest { seeds: Some(7..9), ..whole() }), [2, 2, 2]);
    let only = StudyRequest { rows: vec!["script".to_owned()], ..whole() };
    assert_eq!(n_seeds(&row, only), [20], "whichever rows are asked for");
}

#[test]
fn a_trainings_hash_depends_only_on_what_it_computes() {
    let hash = |request| plan(STUDY, &request).unwrap().trainings()[0].hash.clone();
    let before = hash(whole());
    let free = ["run.checkpoint_every=3", "evaluation.episodes=9"].map(set).concat();
    assert_eq!(before, hash(StudyRequest { set: free, ..whole() }));
    assert_eq!(before, hash(StudyRequest { seeds: Some(1..2), ..whole() }));
    for change in ["learner.clip=0.1", "world.wind=true"] {
        assert_ne!(before, hash(StudyRequest { set: set(change), ..whole() }), "{change}");
    }
    assert_ne!(before, hash(StudyRequest { steps: Some(9_000), ..whole() }));
    assert_ne!(before, hash(StudyRequest { quick: true, ..whole() }));
}

#[test]
fn a_run_that_computes_the_same_is_taken_whatever_it_is_called() {
    let runs = tempfile::tempdir().unwrap();
    let request = StudyRequest { seeds: Some(7..8), ..request(runs.path()) };
    let first = plan(STUDY, &request).unwrap();
    let training = first.trainings()[0].clone();
    let other = format!("elsewhere-{}-s7", training.hash);
    std::fs::create_dir_all(runs.path().join(&other)).unwrap();
    assert_eq!(names(&plan(STUDY, &request).unwrap()), names(&first));
    record(&runs.path().join(&other), &training.config, false);
    let again = plan(STUDY, &request).unwrap();
    assert_eq!(names(&again)[0], other);
    assert!(!again.trainings()[0].is_finished(), "it was only begun");
    let later = format!("later-{}-s7", training.hash);
    record(&runs.path().join(&later), &training.config, true);
    let again = plan(STUDY, &request).unwrap();
    assert_eq!(names(&again)[0], later, "a finished one is taken before one that was begun");
}

#[test]
fn how_policies_are_evaluated_on_the_way_tells_trainings_apart_where_it_decides_their_policy() {
    let best = STUDY.replace("lead = \"l\"", "lead = \"l\"\njudged = \"best\"");
    let hash = |text: &str, more: &[&str]| {
        let set = more.iter().copied().map(set).collect::<Vec<_>>().concat();
        let plan = plan(text, &StudyRequest { set, ..whole() }).unwrap();
        plan.trainings()[0].hash.clone()
    };
    let (mark, often) = ("evaluation.stop_at=0.9", "evaluation.during_training=20");
    assert_eq!(hash(STUDY, &[]), hash(STUDY, &[often]));
    assert_ne!(hash(STUDY, &[mark]), hash(STUDY, &[mark, often]));
    assert_ne!(hash(&best, &[]), hash(&best, &[often]));
    assert_eq!(hash(&best, &[]), hash(&best, &["evaluation.episodes=9"]));
}

#[test]
fn a_run_that_went_on_with_other_settings_is_not_what_its_name_says() {
    let runs = tempfile::tempdir().unwrap();
    let request = StudyRequest { seeds: Some(7..8), ..request(runs.path()) };
    let training = plan(STUDY, &request).unwrap().trainings()[0].clone();
    let with = |key: &str| {
        let change = Layer::set(&Override::parse(key).unwrap());
        training.config.with([change], &Tasks::new().registry).unwrap()
    };
    let changed = with("learner.total_steps=4000000");
    let other = runs.path().join(format!("elsewhere-{}-s7", training.hash));
    record(&other, &changed, true);
    let again = plan(STUDY, &request).unwrap();
    assert_eq!(again.trainings()[0].name, training.name, "it is not taken");
    record(&training.directory(), &changed, true);
    let text = sentence(plan(STUDY, &request));
    assert!(text.contains("another configuration than its name says: "), "{text}");
    assert!(text.contains(" -> 4000000; move it away"), "{text}");
    record(&training.directory(), &with("seed=9"), true);
    let text = sentence(plan(STUDY, &request));
    assert!(text.contains("seed: 7 -> 9"), "{text}");
    // What changes nothing does not count, nor what an older build did not have.
    let mut older = with("run.checkpoint_every=3").table;
    older["policy"].as_table_mut().unwrap().remove("length_bias");
    record(&training.directory(), &training.config, true);
    let file = training.directory().join("config.toml");
    std::fs::write(&file, older.to_string()).unwrap();
    assert!(plan(STUDY, &request).unwrap().trainings()[0].is_finished());
    std::fs::remove_file(&file).unwrap();
    let text = sentence(plan(STUDY, &request));
    assert!(text.contains("no config.toml any more") && text.contains("other --runs"), "{text}");
}

#[test]
fn a_fork_and_a_run_whose_changes_cancel_are_not_what_their_names_say() {
    let runs = tempfile::tempdir().unwrap();
    let request = StudyRequest { seeds: Some(7..8), ..request(runs.path()) };
    let training = plan(STUDY, &request).unwrap().trainings()[0].clone();
    let change = |before: &str, after: &str| SettingChange {
        after_update: 3,
        key: "learner.clip".to_owned(),
        before: before.to_owned(),
        after: after.to_owned(),
        identity: String::new(),
    };
    let origin = ForkOrigin { run: "older".to_owned(), weights_sha256: "0".to_owned() };
    let there_and_back = vec![change("0.2", "0.9"), change("0.9", "0.2")];
    let elsewhere = runs.path().join(format!("elsewhere-{}-s7", training.hash));
    for (origin, changes, told) in [
        (Some(origin), vec![], "is a fork of older"),
        (None, there_and_back, "went on with other settings (learner.clip: 0.2 -> 0.9"),
    ] {
        let keep = |directory: &Path| {
            record(directory, &training.config, true);
            let mut record = RunRecord::read(directory).unwrap();
            (record.origin, record.changes) = (origin.clone(), changes.clone());
            record.write(directory).unwrap();
        };
        keep(&elsewhere);
        let again = plan(STUDY, &request).unwrap();
        assert_eq!(again.trainings()[0].name, training.name, "it is not taken");
        keep(&training.directory());
        let text = sentence(plan(STUDY, &request));
        assert!(text.contains(told) && text.contains("move it away"), "{text}");
        std::fs::remove_dir_all(training.directory()).unwrap();
    }
}

#[test]
fn studies_share_what_they_have_in_common() {
    let request = StudyRequest { seeds: Some(7..9), ..whole() };
    let one = |name| StudyPlan::new(&Tasks::new(), study(name, STUDY), &request).unwrap();
    let mut plans = vec![one("first"), one("second")];
    let shared = share(&mut plans);
    assert_eq!(shared.len(), 4);
    assert_eq!(names(&plans[0]), names(&plans[1]));
}

#[test]
fn conditions_that_come_to_the_same_are_evaluated_once() {
    let plan = plan(STUDY, &whole()).unwrap();
    let names = |row: &PlannedRow| {
        row.conditions.iter().map(|condition| condition.names.join(" = ")).collect::<Vec<_>>()
    };
    let [script, prompt, real_one] = &plan.parts[0].rows[..] else { panic!("three rows") };
    assert_eq!(names(script), ["real"], "a script was not trained");
    assert_eq!(names(prompt), ["own", "real"]);
    assert_eq!(names(real_one), ["own = real"]);
}

#[test]
fn one_row_with_one_setting_changed() {
    let (rows, set) = (vec!["piloting/prompt".to_owned()], set("human.reaction_delay.fixed=3"));
    let request = StudyRequest { rows, set, quick: true, ..whole() };
    let plan = plan(STUDY, &request).unwrap();
    let [training] = plan.trainings()[..] else { panic!("one row, one seed") };
    let table = &training.config.table;
    assert_eq!(table["human"]["reaction_delay"]["fixed"].as_integer(), Some(3));
    assert_eq!(training.config.learner.total_steps, 4096);
    let row = &plan.parts[0].rows[0];
    let differences = plan.parts[0].profile.differences(&row.config, WhichPolicy::Last);
    assert!(differences.contains(&"human.reaction_delay.fixed = 3".to_owned()), "{differences:?}");
}

#[test]
fn only_a_domain_with_maps_has_maps_and_trajectories() {
    let with = |text: &str, more: &str| {
        let text = text.replace("quick_steps = 4096", &format!("quick_steps = 4096\n{more}"));
        plan(&text, &whole())
    };
    let refused = |text: &str, more: &str| sentence(with(text, more));
    let maps = |profile: &str| format!("maps = [{{ profile = \"{profile}\", title = \"a\" }}]");
    assert_eq!(with(STUDY, &maps("lander_hard")).unwrap().parts[0].maps.len(), 1);
    let text = refused(STUDY, &maps("highway"));
    let expected = "`maps`: `highway` is a configuration of the domain `highway`";
    assert!(text.contains(expected), "{text}");
    let text = refused(STUDY, &maps("nowhere"));
    assert!(text.contains("`maps`: ") && text.contains("nowhere"), "{text}");
    let steakhouse = STUDY.replace("profile = \"lander\"", "profile = \"steakhouse\"");
    let text = refused(&steakhouse, "trajectories_on = \"real\"");
    assert!(text.contains("`trajectories_on`: `steakhouse`") && text.contains("map"), "{text}");
}

#[test]
fn a_rows_own_steps_are_above_the_parts_and_below_the_requests() {
    let text = STUDY
        .replace("quick_steps = 4096", "quick_steps = 4096\nsteps = 20480")
        .replace("name = \"real_one\"", "name = \"real_one\"\nset.learner.total_steps = 61440");
    let steps = |request| -> Vec<u64> {
        let rows = plan(&text, &request).unwrap().parts.remove(0).rows;
        rows.iter().skip(1).map(|row| row.config.learner.total_steps).collect()
    };
    assert_eq!(steps(whole()), [20_480, 61_440]);
    assert_eq!(steps(StudyRequest { quick: true, ..whole() }), [4_096, 4_096]);
    assert_eq!(steps(StudyRequest { steps: Some(9_000), ..whole() }), [9_000, 9_000]);
    let set = set("learner.total_steps=8192");
    assert_eq!(steps(StudyRequest { set, ..whole() }), [8_192, 8_192]);
}

#[test]
fn a_misspelt_measure_is_refused_before_anything_is_trained() {
    let with = |from: &str, to: &str| {
        assert!(STUDY.contains(from), "{from}");
        plan(&STUDY.replacen(from, to, 1), &whole())
    };
    let columns = "columns = [\"success\"]";
    with(columns, "columns = [\"mean_l\", \"lead_time\", \"first_l\", \"long_rate\", \"return\"]")
        .unwrap();
    let difference = "differences = [{ of = \"prompt\", minus = \"real_one\", on = \"real\", measure = \"mean\" }]";
    let title = "title = \"Real\"";
    for (from, more, place) in [
        (columns, difference, "`differences`: there is no measure `mean`"),
        (title, "paper = { wins = [1.0] }", "`paper`: there is no measure `wins`"),
        (title, "paper_on.real = { wins = [1.0] }", "there is no measure `wins`"),
        ("success\"", ", \"succeeded\"", "`columns`: there is no measure `succeeded`"),
    ] {
        let text = sentence(with(from, &format!("{from}\n{more}")));
        let known = text.contains("known: ") && text.contains("first_notification");
        assert!(text.contains(place) && known, "{text}");
    }
}

#[test]
fn a_player_that_the_task_does_not_have_is_refused_before_anything_is_trained() {
    let refused = |from: &str, to: &str| {
        assert!(STUDY.contains(from), "{from}");
        sentence(plan(&STUDY.replacen(from, to, 1), &whole()))
    };
    let text = refused("script = \"heuristic\"", "script = \"wise\"");
    assert!(text.contains("row script: there is no scripted player `wise` (`script`)"), "{text}");
    assert!(text.contains("known: unaided, heuristic"), "{text}");
    let scripted = CART.replace("title = \"A\"", "title = \"A\"\nscript = \"unaided\"");
    let text = sentence(plan(&scripted, &whole()));
    assert!(text.contains("row a: ") && text.contains("player `unaided`"), "{text}");
    assert!(text.ends_with("in the task `cartpole`; it has none"), "{text}");
}

#[test]
fn an_evaluation_that_cannot_be_or_changes_nothing_is_refused_before_anything_is_trained() {
    let with = |set: &str| {
        let more = format!("    {{ name = \"odd\", title = \"odd\", {set} }},\n]\n[[parts.rows]]");
        plan(&STUDY.replacen("]\n[[parts.rows]]", &more, 1), &whole())
    };
    with("set.world.wind = true").unwrap();
    with("set.evaluation.world.zone_ends_episode = true").unwrap();
    for (set, told) in [
        ("set.world.zone_jitter = [0.1, 0.1]", "it changes what a policy sees or chooses"),
        ("set.notifier.history = 1", "numbers and has"),
        ("set.learner.clip = 0.1", "`learner.clip` is a setting of training"),
        ("set.world.zone_ends_episode = true", "change `evaluation.world.zone_ends_episode`"),
    ] {
        let text = sentence(with(set));
        assert!(text.contains("evaluation odd: ") && text.contains(told), "{text}");
    }
    // A script has no shape.
    let rows = vec!["script".to_owned()];
    let jittered =
        STUDY.replace("title = \"real\",", "title = \"real\", set.world.zone_jitter = [0.1, 0.1],");
    plan(&jittered, &StudyRequest { rows, ..whole() }).unwrap();
}

#[test]
fn every_built_in_study_names_only_known_measures_and_settings() {
    for named in catalog::find("all").unwrap() {
        StudyPlan::new(&Tasks::new(), named, &whole()).unwrap();
    }
}

#[test]
fn rows_of_the_same_title_are_labelled_with_their_notifications() {
    let more = "[[parts.rows]]\nname = \"topics\"\ntitle = \"Real\"\nset.notifier.notification = \"topic_only\"\n";
    let plan = plan(&format!("{STUDY}{more}"), &whole()).unwrap();
    let [script, _, real, topics] = &plan.parts[0].rows[..] else { panic!() };
    assert_eq!(disambiguate([script, real]), ["script", "real"]);
    let expected = ["real (incrementally actionable)", "real (topic only)"];
    assert_eq!(disambiguate([real, topics]), expected);
}

#[test]
fn titles_become_words_of_a_sentence_and_symbols_stay() {
    assert_eq!(inside_a_sentence("Convey & react"), "convey & react");
    for title in ["R = l - 2", "N(2, 1.0)", "W/ convey", ""] {
        assert_eq!(inside_a_sentence(title), title);
    }
}

#[test]
fn an_unknown_name_is_refused_with_the_known_ones() {
    let check = |rows: &[&str], parts: &[&str]| {
        let [rows, parts] =
            [rows, parts].map(|names| names.iter().map(|&n| n.to_owned()).collect());
        check_choice(&[study("t", STUDY)], &StudyRequest { rows, parts, ..whole() })
    };
    assert!(check(&["prompt"], &["piloting"]).is_ok());
    let text = sentence(check(&["driving/prompt"], &[]));
    assert!(text.contains("`driving/prompt`") && text.contains("piloting/real_one"), "{text}");
    let text = sentence(check(&[], &["driving"]));
    assert!(text.contains("`driving`") && text.contains("known: piloting"), "{text}");
    let refused = |text| sentence(plan(STUDY, &StudyRequest { set: set(text), ..whole() }));
    let text = refused("human.patience=2");
    assert!(text.contains("--set human.patience") && text.contains("`repeat`"), "{text}");
    let text = refused("seed=2");
    assert!(text.contains("--set seed") && text.contains("see --seeds"), "{text}");
    let profiles = |names: &[&str]| {
        let profiles = names.iter().map(PathBuf::from).collect();
        let request = StudyRequest { profiles, ..whole() };
        profile::check_profiles(&Tasks::new(), &[study("t", STUDY)], &request)
    };
    profiles(&["paper_lander"]).unwrap();
    let text = sentence(profiles(&["highway"]));
    let expected = "--profile highway: no part that was asked for is about the domain `highway`";
    assert!(text.contains(expected), "{text}");
    let text = sentence(profiles(&["lander", "paper_lander"]));
    assert!(text.contains("there is another one for the domain `lander`"), "{text}");
}
