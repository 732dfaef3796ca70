//! The sentences of a domain through the program: made, made again, rated, exported, checked, and wrong in every
//! known way.

use std::fs;
use std::net::TcpListener;
use std::process::Command;

use crate::notifier::policy;
use crate::support::{FAILED, Finished, PATIENCE, PEER_LOST, Place, WRONG_INPUT, repository};

/// A database of one topic and two sentences.
const SMALL: &str = r#"schema = 1
domain = "road"
fidelity = "grammar"
generator = "g"
rater = "r"
embedder = "e"
theta = 70
words = [2, 3]
topics = ["left", "right"]
config = ""
[[utterance]]
topic = "left"
comprehension = 2
conveyance = 3
text = "Go left now."
spans = [["what", 0, 2]]
curve = [10, 90, 95]
[[utterance]]
topic = "right"
comprehension = 2
conveyance = 2
text = "Go right."
spans = [["what", 0, 2]]
curve = [10, 90]
"#;

fn data(path: &str) -> String {
    repository(&format!("crates/taxonomy/data/{path}"))
}

fn taxonomy(place: &Place, args: &[&str]) -> Finished {
    place.finish(&[&["taxonomy"], args].concat())
}

#[test]
fn a_database_is_made_by_the_grammar_and_again_from_its_log() {
    let place = Place::new();
    let build = "build highway --backend grammar -o a";
    let stopped = taxonomy(&place, &[build, "--max-calls 1 --json"]).with_code(0).json();
    assert_eq!(stopped, serde_json::json!({"database": null, "calls": 1, "stopped": true}));
    let cut = taxonomy(&place, &[build, "--max-calls 50"]);
    cut.with_code(0).saying(&["stopped after 50 calls"]);
    assert!(!place.path().join("a/taxonomy.toml").exists());
    let made = taxonomy(&place, &[build, "--json"]).with_code(0).json();
    assert_eq!((&made["fidelity"], &made["filled"]), (&"grammar".into(), &40.into()), "{made}");
    let replay = "build highway --replay a/calls.jsonl -o b --json";
    let again = taxonomy(&place, &[replay]).with_code(0).json();
    assert_eq!((&again["calls"], &again["kept"]), (&0.into(), &made["kept"]));
    for file in ["taxonomy.toml", "coverage.md", "candidates.jsonl"] {
        let read = |run: &str| fs::read(place.path().join(run).join(file)).unwrap();
        assert_eq!(read("a"), read("b"), "{file}");
    }
    let report = taxonomy(&place, &["report highway --log a/calls.jsonl"]).with_code(0);
    let coverage = fs::read_to_string(place.path().join("a/coverage.md")).unwrap();
    assert_eq!(report.stdout.trim_end(), coverage.trim_end());
    taxonomy(&place, &["validate a/taxonomy.toml --strict"]).with_code(0);
}

#[test]
fn a_shipped_database_comes_out_of_its_log_byte_for_byte() {
    let place = Place::new();
    let log = data("lander/calls.jsonl");
    taxonomy(&place, &["build lander -o words --replay", &log]).with_code(0);
    for file in ["taxonomy.toml", "coverage.md"] {
        let made = fs::read(place.path().join("words").join(file)).unwrap();
        assert_eq!(made, fs::read(data(&format!("lander/{file}"))).unwrap(), "{file}");
    }
    let report = taxonomy(&place, &["report steakhouse"]).with_code(0).stdout;
    assert!(report.starts_with("# Words of the domain `steakhouse`"), "{report}");
}

#[test]
fn sentences_of_ones_own_are_rated() {
    let place = Place::new();
    let rate = |args: &str, sentences: &[&str]| {
        let mut command = place.program(&["taxonomy rate highway --backend", args]);
        command.args(sentences);
        place.start_with(command).finish(PATIENCE)
    };
    let own = ["Traffic, slow down.", "Lovely day."];
    let rated = rate("grammar --topic slow_down", &own).with_code(0).stdout;
    assert!(rated.contains("(k, l) = (3, 3)  Traffic, slow down.  ["), "{rated}");
    assert!(rated.contains("never_understood  Lovely day.  ["), "{rated}");
    let unknown = rate("authored --topic stop", &["Stop now."]).with_code(WRONG_INPUT);
    unknown.saying(&["--topic stop", "slow_down"]);
    let empty = rate("grammar --topic slow_down", &["?"]).with_code(WRONG_INPUT);
    empty.saying(&["\"?\" has no words"]);
}

#[test]
fn a_database_is_printed_as_table_and_as_json() {
    let place = Place::new();
    let csv = taxonomy(&place, &["export highway"]).with_code(0).stdout;
    assert!(csv.contains("slow_down,2,5,\"Slow down for incoming traffic.\","), "{csv}");
    let file = place.write("small.toml", SMALL);
    let json = taxonomy(&place, &["export --format json", &file]).with_code(0).json();
    assert_eq!(json["topics"][1]["utterances"][0]["text"], "Go right.");
}

#[test]
fn a_notifier_can_be_held_to_what_can_be_said() {
    let place = Place::new();
    let cells = taxonomy(&place, &["export lander --format cells"]).with_code(0).stdout;
    let own = place.write("own.toml", &format!("domain = \"lander\"\n{cells}"));
    place.finish(&["check -c", &own]).with_code(0);
    let wrong = place.write("wrong.toml", &format!("domain = \"highway\"\n{cells}"));
    let says = ["`notifier.cells`", "[\"ascend\", 2, 2]", "slow_down"];
    place.finish(&["check -c", &wrong]).with_code(WRONG_INPUT).saying(&says);
    let small = place.write("small.toml", SMALL);
    let cells = taxonomy(&place, &["export --format cells", &small]).with_code(0).stdout;
    assert_eq!(cells, "[notifier]\ncells = [\n    [\"left\", 2, 3],\n    [\"right\", 2, 2],\n]\n");
}

#[test]
fn the_study_of_reasons_has_those_of_the_shipped_sentences() {
    let printed = taxonomy(&Place::new(), &["export lander --format cells"]).with_code(0).stdout;
    let cells: toml::Value = toml::from_str(&printed).unwrap();
    let shipped = cells["notifier"]["reasons"].as_array().unwrap();
    assert!(shipped.iter().any(|cell| cell[3].as_float() == Some(0.25)), "{printed}");
    let study = include_str!("../../crates/studies/studies/reasons.toml");
    let study: toml::Value = toml::from_str(study).unwrap();
    let rows = study["parts"][0]["rows"].as_array().unwrap();
    let tables: Vec<_> = rows.iter().filter_map(|row| row["set"].get("notifier")).collect();
    assert_eq!(tables.len(), 2);
    for table in tables {
        let same = |(ours, theirs): (&toml::Value, &toml::Value)| {
            (0..3).all(|i| ours[i] == theirs[i]) && ours[3].as_float() == theirs[3].as_float()
        };
        let ours = table["reasons"].as_array().unwrap();
        assert_eq!(ours.len(), shipped.len());
        assert!(ours.iter().zip(shipped).all(same), "{ours:?}");
    }
}

#[test]
fn what_a_database_lacks_is_listed_and_fails_only_if_asked() {
    let place = Place::new();
    let file = place.write("small.toml", SMALL);
    let lacks = taxonomy(&place, &["validate", &file]).with_code(0).stdout;
    assert!(lacks.contains("topic `left` has nothing at (k, l) = (2, 2)"), "{lacks}");
    taxonomy(&place, &["validate --strict", &file]).with_code(FAILED);
    taxonomy(&place, &["validate steakhouse --strict"]).with_code(0);
}

#[test]
fn facts_and_words_are_checked_against_each_other() {
    let place = Place::new();
    let shipped = fs::read_to_string(data("lander/taxonomy.toml")).unwrap();
    let with = |entry: &str| {
        let added = format!("{shipped}\n[[utterance]]\ntopic = \"ascend\"\n{entry}\n");
        place.write("mine.toml", &added)
    };
    // What the domain does not tell is refused.
    let file = with("text = \"Moon up, climb.\"\nfacts = [\"moon_up\"]");
    let says = "\"Moon up, climb.\" presupposes `moon_up`, which the domain does not tell; it tells zone_near,";
    taxonomy(&place, &["validate", &file]).with_code(WRONG_INPUT).saying(&[says]);
    // A command that would speak in them says so too, instead of never saying that sentence.
    for command in ["serve --describe", "eval --transcript"] {
        let refused = place.finish(&[command, &policy(), "--words", &file]);
        refused.with_code(WRONG_INPUT).saying(&[says]);
    }
    // What no world remembers is listed, and the other sentences are of use.
    let file = with("text = \"Climb again.\"");
    let listed = taxonomy(&place, &["validate", &file]).with_code(0).stdout;
    let says = "topic `ascend`, \"Climb again.\": it is never said, because it presupposes `again`, which the";
    assert!(listed.contains(says), "{listed}");
    taxonomy(&place, &["validate --strict", &file]).with_code(FAILED);
    place.finish(&["serve --describe", &policy(), "--words", &file]).with_code(0);
    let spoken = place.finish(&["eval --transcript --episodes 20", &policy(), "--words", &file]);
    let spoken = spoken.with_code(0).stdout;
    assert!(!spoken.contains("Climb again"), "{spoken}");
    // Words without their facts are listed.
    for (entry, says) in [
        (
            "text = \"Zone below, climb now.\"\nfacts = []",
            "\"Zone below, climb now.\": its words presuppose `zone_below`, its `facts` do not",
        ),
        (
            "text = \"Sun is low, climb.\"\nfacts = []",
            "\"Sun is low, climb.\": it gives a reason and presupposes no fact",
        ),
    ] {
        let file = with(entry);
        let listed = taxonomy(&place, &["validate", &file]).with_code(0).stdout;
        assert!(listed.contains(says), "{listed}");
        taxonomy(&place, &["validate --strict", &file]).with_code(FAILED);
    }
    // The words alone are enough.
    let file = with("text = \"Zone just below, climb.\"");
    taxonomy(&place, &["validate --strict", &file]).with_code(0);
    // A fact that nobody needs, and a cell that may have nothing true to say.
    let unused = shipped.replace("[\"zone_just_above\"]", "[\"zone_above\"]");
    let listed = taxonomy(&place, &["validate", &place.write("mine.toml", &unused)]).with_code(0);
    assert!(listed.stdout.contains("no sentence presupposes zone_just_above\n"), "{listed:?}");
    let always =
        "text = \"Pull up for safety.\"\nspans = [[\"what\", 0, 2], [\"why\", 2, 4]]\nfacts = []";
    assert!(shipped.contains(always));
    let sometimes = always.replace("facts = []", "facts = [\"too_low\"]");
    let file = place.write("mine.toml", &shipped.replace(always, &sometimes));
    let listed = taxonomy(&place, &["validate", &file]).with_code(0).stdout;
    let says = "topic `ascend` has no utterance at (k, l) = (2, 4) that is always true";
    assert!(listed.contains(says), "{listed}");
}

#[test]
fn what_the_shipped_policies_say_is_true() {
    let place = Place::new();
    for policy in ["piloting", "driving", "cooking"] {
        let path = repository(&format!("deploy/policies/{policy}.safetensors"));
        let truth = place.finish(&["eval --truth --json --episodes 20", &path]).with_code(0).json();
        let (any, if_true) = (&truth[0]["in_turn"], &truth[0]["true_in_turn"]);
        assert!(any["false_at_start"].as_u64() > Some(0), "{policy}: {truth}");
        assert_eq!(any["said"], if_true["said"]);
        for counted in ["false_at_start", "stand_ins", "without_words"] {
            assert_eq!(if_true[counted], 0, "{policy}: {truth}");
        }
    }
    let none = place.finish(&[
        "eval --truth --words lander",
        &repository("deploy/policies/driving.safetensors"),
    ]);
    none.with_code(WRONG_INPUT).saying(&["the database speaks of [ascend,"]);
}

#[test]
fn a_wrong_database_is_told_by_line_or_sentence() {
    let place = Place::new();
    let cases: &[(&str, &str, &[&str])] = &[
        ("theta = 70", "theta = ", &["wrong.toml", "line 7"]),
        ("\"Go right.\"", "\"Go right now.\"", &["it has 3 words; `conveyance` says 2"]),
        ("domain = \"road\"", "domain = \"lander\"", &["[left, right]", "[ascend, shift_left"]),
    ];
    for (from, to, expected) in cases {
        assert!(SMALL.contains(from), "{from}");
        let file = place.write("wrong.toml", &SMALL.replace(from, to));
        taxonomy(&place, &["validate", &file]).with_code(WRONG_INPUT).saying(expected);
    }
    taxonomy(&place, &["validate moon"]).with_code(WRONG_INPUT).saying(&["`moon`", "lander"]);
    // One that is there is not told to be missing.
    fs::write(place.path().join("bytes.toml"), [0xff, 0xfe]).unwrap();
    let unread = taxonomy(&place, &["validate bytes.toml"]).with_code(WRONG_INPUT);
    unread.saying(&["the database bytes.toml cannot be read", "UTF-8"]);
    let pipe = place.file("pipe.toml");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let refused = taxonomy(&place, &["validate pipe.toml"]).with_code(WRONG_INPUT);
    refused.saying(&["the database pipe.toml cannot be read", "pipe.toml is not a file"]);
}

#[test]
fn a_wrong_plan_prompt_or_log_is_told_before_anybody_is_asked() {
    let place = Place::new();
    let build = |args: &str| taxonomy(&place, &["build", args]).with_code(WRONG_INPUT);
    let with = |plan: &str| build(&format!("{plan} --backend grammar"));
    build("highway").saying(&["--backend", "--replay"]);
    with("moon").saying(&["`moon`", "highway, lander, steakhouse"]);
    let plan = place.write("plan.toml", "domain = \"road\"\nroel = \"driver\"");
    with(&plan).saying(&["plan.toml", "line 2", "roel"]);
    fs::create_dir(place.path().join("prompts")).unwrap();
    let own = "highway --prompts prompts";
    for template in ["system", "summarise", "generate", "rate_joint", "rate_prefix"] {
        let name = format!("prompts/{template}.txt");
        place.write(&name, "Say {{topik}}.");
        let unknown = "has the unknown variable `topik`; known: action";
        with(own).saying(&[&format!("prompt template `{template}` {unknown}")]);
        place.write(&name, "Say\n{{topic");
        with(own).saying(&[&format!("`{template}` opens a variable on line 2")]);
        fs::remove_file(place.path().join(name)).unwrap();
    }
    assert!(!place.path().join("words/calls.jsonl").exists(), "somebody was asked");
    with("highway --prompts nowhere").saying(&["--prompts nowhere", "no such directory"]);
    build("highway --replay none.jsonl").saying(&["none.jsonl"]);
    // A log of another domain answers nothing.
    let other = build(&format!("highway --replay {}", data("lander/calls.jsonl")));
    other.saying(&["lander", "highway"]);
    place.write("torn.jsonl", "{\"schema\": 1");
    build("highway --replay torn.jsonl").saying(&["line 1", "torn.jsonl"]);
    // One key can be changed without a file; a wrong one is named.
    let theta = with("highway --set settings.theta=0");
    let names = ["--set settings.theta", "`settings.theta` of the plan is 0", "1 to 100 percent"];
    theta.saying(&names);
    let bound = with("highway --set settings.bound=60");
    bound.saying(&["--set settings.bound", "unknown key `bound`"]);
    taxonomy(&place, &["report highway --set settings.theta=60"])
        .with_code(WRONG_INPUT)
        .saying(&["--log is missing"]);
    // What is an option is not blamed on the plan, and one that nobody heeds is told.
    let shipped = fs::read_to_string(data("lander/plan.toml")).unwrap();
    let own =
        place.write("grid.toml", &shipped.replace("domain = \"lander\"", "domain = \"grid\""));
    for (args, says) in [
        (
            "--backend authored",
            "--annotations is missing: none come with `grid`, only with highway",
        ),
        ("--backend http --model m --url http://h --tries 0", "--tries is 0; allowed: 1 to 10"),
        ("--backend grammar --annotations a.txt", "--annotations is for --backend authored"),
        ("--backend authored --fidelity paper", "--fidelity is for --backend http; leave it out"),
    ] {
        build(&format!("{own} {args}")).saying(&[says]);
    }
    place.write("annotations.txt", "# ascend two 4\n");
    build("lander --backend authored --annotations annotations.txt").saying(&["line 1"]);
}

#[test]
fn a_server_that_is_not_there_is_a_lost_peer() {
    let place = Place::new();
    // Bound and let go: nobody listens there.
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let url = format!("http://{free}/v1");
    let build = |url: &str, rest: &str| {
        taxonomy(&place, &["build highway --backend http --tries 1 --url", url, rest])
    };
    build(&url, "--model m").with_code(PEER_LOST).saying(&[&url, "cannot be reached"]);
    build(&url, "").with_code(WRONG_INPUT).saying(&["--model"]);
    let wrong = build("ftp://here", "--model m").with_code(WRONG_INPUT);
    wrong.saying(&["ftp://here", "http://"]);
    let no_key = build(&url, "--model m --api-key-env LEADTIME_NO_SUCH_KEY");
    no_key.with_code(WRONG_INPUT).saying(&["LEADTIME_NO_SUCH_KEY"]);
}

#[test]
fn an_embedder_must_be_built_in_and_the_one_that_is_known() {
    let place = Place::new();
    place.write("model.safetensors", "abc");
    let refused = taxonomy(&place, &["build highway --backend grammar --embedder ."]);
    let refused = refused.with_code(WRONG_INPUT);
    if cfg!(feature = "minilm") {
        refused.saying(&["model.safetensors", "has sha256 ba7816bf", "expected 53aa5117"]);
    } else {
        refused.saying(&["without an embedder", "--features minilm"]);
    }
}
