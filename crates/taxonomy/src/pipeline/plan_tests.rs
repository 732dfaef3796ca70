//! What a plan cannot be, and what is said about it.

use super::*;
use crate::pipeline::job;

const PLAN: &str = include_str!("../../data/lander/plan.toml");

#[test]
fn the_plans_that_come_with_the_crate_are_sound() {
    for domain in crate::shipped::domains() {
        let plan = job::plan(domain).unwrap();
        assert_eq!(plan.domain, domain);
        assert_eq!(plan.examples.len(), 5);
        assert!(plan.topic.iter().all(|topic| topic.rated.len() == 2));
    }
    let error = job::plan("kitchen").unwrap_err().to_string();
    let says = "`domain` of the plan is kitchen; allowed: highway, lander";
    assert!(error.starts_with(says), "{error}");
}

#[test]
fn an_impossible_plan_is_named() {
    let cases = [
        ("keep = 4", "keep = 0", "`settings.keep` of the plan is 0; allowed: 1 to 20"),
        ("keep = 4", "kept = 4", " of the plan: unknown field `kept`, expected one of `theta`"),
        ("keep = 4", "repeats = 2", "is 2; allowed: an odd number from 1 to 9"),
        ("\"joint\"", "\"guess\"", "unknown variant `guess`, expected `joint` or `prefix`"),
        (
            "[25, 92, 92, 93, 96]",
            "[25, 92]",
            "`topic.ascend.rated` of the plan is 2; allowed: 5 percentages",
        ),
    ];
    for (from, to, says) in cases {
        assert!(PLAN.contains(from), "the plan has no {from}");
        let error = DatabasePlan::from_toml(&PLAN.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
}

#[test]
fn a_plan_whose_database_would_be_refused_is_named_before_anything_is_paid() {
    let cases = [
        ("domain = \"lander\"", "domain = \"\"", "`domain` of the plan is \"\"; allowed"),
        ("id = \"descend\"", "id = \"ascend\"", "`topic.id` of the plan is \"ascend\"; allowed"),
        ("id = \"descend\"", "id = \"\"", "`topic.id` of the plan is \"\"; allowed: a name"),
    ];
    for (from, to, says) in cases {
        assert!(PLAN.contains(from), "the plan has no {from}");
        let error = DatabasePlan::from_toml(&PLAN.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
    let mut plan = job::plan("lander").unwrap();
    let facts = (0..=MAX_FACTS).map(|i| format!("fact{i}")).collect();
    plan.presupposes.insert("for all of them".to_owned(), facts);
    let error = plan.check().unwrap_err().to_string();
    assert!(error.contains("`presupposes` of the plan is a table of "), "{error}");
}

#[test]
fn a_plan_that_differs_has_another_hash() {
    let plan = job::plan("lander").unwrap();
    let mut other = plan.clone();
    other.settings.theta = 60;
    assert_ne!(plan.hash(), other.hash());
    assert_eq!(plan.hash(), job::plan("lander").unwrap().hash());
}
