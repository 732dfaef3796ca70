//! Every defect that a database can have, and what is said about it.

use super::*;
use crate::test_support::header;

const GOOD: &str = r#"
[[utterance]]
topic = "merge_left"
comprehension = 4
conveyance = 4
text = "Truck ahead, merge left."
spans = [["why", 0, 2], ["what", 2, 4]]
curve = [5, 10, 40, 95]

[[utterance]]
topic = "slow_down"
comprehension = 2
conveyance = 2
text = "Slow down."
spans = [["what", 0, 2]]
curve = [45, 95]
"#;

/// Writes a database without a defect.
fn good() -> String {
    header(&["merge_left", "slow_down"]) + GOOD
}

#[test]
fn a_good_file_is_read_in_the_order_of_the_domain() {
    let taxonomy = Taxonomy::from_toml(&good()).unwrap();
    taxonomy.expect_topics(&["merge_left", "slow_down"]).unwrap();
    let found = taxonomy.topics()[0].cell(Cell::new(4, 4));
    assert_eq!(found[0].text, "Truck ahead, merge left.");
    assert!(found[0].states_reason());
    assert!(taxonomy.topics()[0].cell(Cell::new(2, 2)).is_empty());
    assert_eq!(taxonomy.feasible().count(), 10);
    let error = taxonomy.expect_topics(&["slow_down", "merge_left"]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the database speaks of [merge_left, slow_down], the domain of [slow_down, merge_left]"
    );
}

#[test]
fn what_is_wrong_with_a_file_is_named() {
    let topics = "[\"merge_left\", \"slow_down\"]";
    let cases = [
        ("theta = 70", "theta = ", "line 7 of the utterance database: "),
        ("theta = 70", "thetta = 70", "unknown field `thetta`, expected one of `schema`"),
        ("\"why\", 0, 2", "\"whence\", 0, 2", "line 17 of"),
        ("schema = 1", "schema = 2", "`schema` is 2; allowed: 1"),
        ("theta = 70", "theta = 0", "`theta` is 0; allowed: 1 to 100 percent"),
        ("[2, 5]", "[5, 2]", "`words` is [5, 2]; allowed: [least, greatest] within 1 to 20"),
        (topics, "[\"merge_left\", \"merge_left\"]", "allowed: at least one name, each once"),
        ("\"slow_down\"]", "\"slow_down\", \"speed_up\"]", "topic `speed_up` has no utterance"),
        ("Truck ahead, merge left.", "Truck, merge left.", "it has 3 words; `conveyance` says 4"),
        ("conveyance = 4", "conveyance = 6", "its (k, l) is (4, 6); allowed: 2 <= k <= l <= 5"),
        ("[5, 10, 40, 95]", "[5, 10, 95]", "its `curve` has 3 values; allowed: 4, one per word"),
        ("[5, 10, 40, 95]", "[5, 10, 40, 101]", "its curve reaches 101; allowed: 0 to 100 percent"),
        ("[5, 10, 40, 95]", "[5, 10, 9, 95]", "its `curve` falls at word 3"),
        ("[5, 10, 40, 95]", "[5, 10, 70, 95]", "its curve reaches 70 percent at word 3"),
        ("[5, 10, 40, 95]", "[5, 10, 40, 69]", "its curve reaches 70 percent at no word"),
        ("[45, 95]", "[75, 95]", "reaches 70 percent at word 1; `comprehension` says word 2"),
        ("[45, 95]", "[45, 95]\nclamped = true", "at word 2"),
        ("[45, 95]", "[45, 95]\nword_end_ms = [300]", "its `word_end_ms` has 1 values; allowed: 2"),
        ("[45, 95]", "[45, 95]\nword_end_ms = [300, 300]", "its `word_end_ms` falls at word 2"),
        ("[\"what\", 2, 4]", "[\"what\", 1, 4]", "its spans overlap"),
        ("[\"what\", 2, 4]", "[\"how\", 2, 4]", "it has 0 `what` spans; allowed: 1"),
        ("topic = \"merge_left\"", "topic = \"merge\"", "its topic is not in `topics`"),
        (
            "Slow down.",
            "TRUCK ahead, merge left",
            "utterance 2 of topic `slow_down`, \"TRUCK ahead, merge left\": the same words stand under topic \
             `merge_left` already",
        ),
    ];
    let good = good();
    for (from, to, says) in cases {
        assert!(good.contains(from), "the test's file has no {from}");
        let error = Taxonomy::from_toml(&good.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
    // Written otherwise, but the same words; and one that is understood too early, but says so.
    for (from, to) in [("Slow down.", "SLOW, down!"), ("[45, 95]", "[75, 95]\nclamped = true")] {
        Taxonomy::from_toml(&good.replacen(from, to, 1)).unwrap();
    }
}

#[test]
fn what_sentences_presuppose_is_named_once_and_must_be_told() {
    let facts = "[45, 95]\nfacts = [\"wet_road\", \"car_ahead\"]";
    let text = good().replacen("[45, 95]", facts, 1);
    let taxonomy = Taxonomy::from_toml(&text).unwrap();
    assert_eq!(taxonomy.facts(), ["car_ahead", "wet_road"]);
    let [slow_down] = taxonomy.topics()[1].utterances() else { panic!("one sentence") };
    let names: Vec<&str> = taxonomy.fact_names(slow_down.facts).collect();
    assert_eq!(names, ["car_ahead", "wet_road"]);
    assert_eq!(taxonomy.topics()[0].utterances()[0].facts, FactSet::NONE);
    let told = taxonomy.facts_named(["wet_road", "moonlight"]);
    assert!(!told.includes(slow_down.facts));
    taxonomy.expect_facts(&["wet_road", "car_ahead", "moonlight"]).unwrap();
    let error = taxonomy.expect_facts(&["wet_road"]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "\"Slow down.\" presupposes `car_ahead`, which the domain does not tell; it tells wet_road"
    );
    let error = Taxonomy::from_toml(&text.replace("wet_road", "wet road")).unwrap_err().to_string();
    assert!(error.contains("`wet road` is no name of a fact; allowed: a to z, 0 to 9 and _"));
    let many: Vec<String> = (0..65).map(|i| format!("fact{i}")).collect();
    let text = good().replacen("[45, 95]", &format!("[45, 95]\nfacts = {many:?}"), 1);
    let error = Taxonomy::from_toml(&text).unwrap_err().to_string();
    assert_eq!(error, "the sentences presuppose 65 facts; allowed: at most 64");
}
