//! Every defect that a database can have, and what is said about it.

use super::*;

const HEADER: &str = r#"schema = 1
domain = "road"
fidelity = "authored"
generator = "a person"
rater = "a person"
embedder = "none"
theta = 70
words = [2, 5]
topics = ["merge_left", "slow_down"]
config = ""
"#;

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

fn refuse(from: &str, to: &str) -> String {
    let text = format!("{HEADER}{GOOD}");
    assert!(text.contains(from), "the test's file has no {from}");
    Taxonomy::from_toml(&text.replacen(from, to, 1)).unwrap_err().to_string()
}

#[test]
fn a_good_file_is_read_in_the_order_of_the_domain() {
    let taxonomy = Taxonomy::from_toml(&format!("{HEADER}{GOOD}")).unwrap();
    taxonomy.expect_topics(&["merge_left", "slow_down"]).unwrap();
    let found = taxonomy.topics()[0].cell(Cell::new(4, 4));
    assert_eq!(found[0].text, "Truck ahead, merge left.");
    assert_eq!(found[0].words_of_reason(), 2);
    assert!(taxonomy.topics()[0].cell(Cell::new(2, 2)).is_empty());
    assert_eq!(taxonomy.feasible().count(), 10);
    let error = taxonomy.expect_topics(&["slow_down", "merge_left"]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the database speaks of [merge_left, slow_down], the domain of [slow_down, merge_left]"
    );
}

#[test]
fn a_malformed_file_is_named_by_its_line() {
    let text = refuse("theta = 70", "theta = ");
    assert!(text.starts_with("line 7 of the utterance database: "), "{text}");
    let text = refuse("theta = 70", "thetta = 70");
    assert!(text.contains("unknown field `thetta`, expected one of `schema`"), "{text}");
    let text = refuse("\"why\", 0, 2", "\"whence\", 0, 2");
    assert!(text.starts_with("line 17 of"), "{text}");
}

#[test]
fn impossible_headers_are_named() {
    assert_eq!(refuse("schema = 1", "schema = 2"), "`schema` is 2; allowed: 1");
    assert_eq!(refuse("theta = 70", "theta = 0"), "`theta` is 0; allowed: 1 to 100 percent");
    let text = refuse("[2, 5]", "[5, 2]");
    assert_eq!(text, "`words` is [5, 2]; allowed: [least, greatest] within 1 to 20");
    let text = refuse("[\"merge_left\", \"slow_down\"]", "[\"merge_left\", \"merge_left\"]");
    assert!(text.ends_with("allowed: at least one name, each once"), "{text}");
    let text = refuse("\"slow_down\"]", "\"slow_down\", \"speed_up\"]");
    assert!(text.starts_with("topic `speed_up` has no utterance"), "{text}");
}

#[test]
fn a_sentence_that_is_not_what_it_says_is_refused() {
    let cases = [
        ("Truck ahead, merge left.", "Truck, merge left.", "it has 3 words; `conveyance` says 4"),
        ("conveyance = 4", "conveyance = 6", "its (k, l) is (4, 6); allowed: 2 <= k <= l <= 5"),
        ("[5, 10, 40, 95]", "[5, 10, 95]", "its `curve` has 3 values; allowed: 4, one per word"),
        ("[5, 10, 40, 95]", "[5, 10, 40, 101]", "its curve reaches 101; allowed: 0 to 100 percent"),
        ("[5, 10, 40, 95]", "[5, 10, 9, 95]", "its `curve` falls at word 3"),
        ("[5, 10, 40, 95]", "[5, 10, 70, 95]", "its curve reaches 70 percent at word 3"),
        ("[5, 10, 40, 95]", "[5, 10, 40, 69]", "its curve reaches 70 percent at no word"),
        ("[\"what\", 2, 4]", "[\"what\", 1, 4]", "its spans overlap"),
        ("[\"what\", 2, 4]", "[\"how\", 2, 4]", "it has 0 `what` spans; allowed: 1"),
        ("topic = \"merge_left\"", "topic = \"merge\"", "its topic is not in `topics`"),
        ("Slow down.", "SLOW, down!", "no"),
    ];
    for (from, to, says) in cases {
        let text = format!("{HEADER}{GOOD}").replacen(from, to, 1);
        match Taxonomy::from_toml(&text) {
            Err(error) => assert!(error.to_string().contains(says), "{error}"),
            Ok(_) => assert_eq!(says, "no", "{to} passed"),
        }
    }
}

#[test]
fn the_same_words_under_two_topics_are_refused() {
    let again = r#"
[[utterance]]
topic = "merge_left"
comprehension = 2
conveyance = 2
text = "slow DOWN"
spans = [["what", 0, 2]]
curve = [45, 95]
"#;
    let error = Taxonomy::from_toml(&format!("{HEADER}{GOOD}{again}")).unwrap_err();
    assert_eq!(
        error.to_string(),
        "utterance 3 of topic `merge_left`, \"slow DOWN\": the same words stand under topic `slow_down` already"
    );
}

#[test]
fn a_word_that_is_understood_too_early_counts_as_clamped() {
    let clamped = GOOD.replace("[45, 95]", "[75, 95]\nclamped = true");
    Taxonomy::from_toml(&format!("{HEADER}{clamped}")).unwrap();
    let text = refuse("[45, 95]", "[75, 95]");
    assert!(text.contains("reaches 70 percent at word 1; `comprehension` says word 2"), "{text}");
    let text = refuse("[45, 95]", "[45, 95]\nclamped = true");
    assert!(text.contains("at word 2"), "{text}");
}

#[test]
fn recorded_word_ends_must_rise() {
    let text = refuse("[45, 95]", "[45, 95]\nword_end_ms = [300]");
    assert!(text.contains("its `word_end_ms` has 1 values; allowed: 2"), "{text}");
    let text = refuse("[45, 95]", "[45, 95]\nword_end_ms = [300, 300]");
    assert!(text.contains("its `word_end_ms` falls at word 2"), "{text}");
}
