//! The whole pipeline, without network: replay, resume, and what the shipped databases promise.

use std::path::Path;

use super::*;
use crate::pipeline::caller::{Backends, CallMode};
use crate::pipeline::error::BackendError;
use crate::pipeline::job::{self, Backend, BuildJob};
use crate::pipeline::lexical::Lexical;
use crate::pipeline::log::CallLog;
use crate::pipeline::{Call, Input, Model, PipelineError, RateForm, Reply};
use crate::shipped;
use crate::utterance::Fidelity;

fn job(log: &Path, backend: Backend) -> BuildJob {
    let log = log.to_owned();
    BuildJob { backend, log, prompts: None, embedder: None, rater: None, max_calls: None }
}

#[test]
fn shipped_databases_come_out_of_their_logs_byte_for_byte() {
    for domain in shipped::domains() {
        let plan = job::plan(domain).unwrap();
        let (built, header) = job::replay_shipped(domain).unwrap();
        assert_eq!(built.text, shipped::text(domain).unwrap(), "{domain}");
        assert_eq!(built.calls, 0);
        let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(domain);
        let report = std::fs::read_to_string(directory.join("coverage.md")).unwrap();
        assert_eq!(built.report(&plan, &header), report, "{domain}");
    }
}

#[test]
fn every_cell_of_the_shipped_databases_has_three_sentences() {
    let topics: [(&str, &[&str]); 3] = [
        ("highway", &["slow_down", "speed_up", "merge_left", "merge_right"]),
        ("lander", &["ascend", "shift_left", "shift_right", "descend"]),
        ("steakhouse", &["move_up", "move_down", "move_left", "move_right", "inform"]),
    ];
    for (domain, topics) in topics {
        let taxonomy = shipped::shipped(domain).unwrap();
        taxonomy.expect_topics(topics).unwrap();
        assert_eq!(taxonomy.header().fidelity, Fidelity::Authored);
        let mut findings = crate::check(&taxonomy, 3);
        findings.extend(job::check_words(&taxonomy));
        assert!(findings.is_empty(), "{domain}: {}", findings[0]);
        for topic in taxonomy.topics() {
            assert!(topic.utterances().iter().all(|utterance| !utterance.clamped));
        }
    }
}

#[test]
fn the_sources_samples_are_in_their_cells() {
    let samples = [
        ("lander", "shift_left", (2, 2), "Shift left."),
        ("lander", "ascend", (5, 5), "Avoid top-left danger zone, ascend."),
        ("highway", "slow_down", (2, 5), "Slow down for incoming traffic."),
        ("highway", "merge_right", (5, 5), "Merge to the right lane."),
        ("steakhouse", "move_down", (2, 2), "Go down."),
        ("steakhouse", "move_right", (5, 5), "Chopping board full, go right."),
    ];
    for (domain, topic, (k, l), text) in samples {
        let taxonomy = shipped::shipped(domain).unwrap();
        let topic = taxonomy.topics().iter().find(|found| found.name() == topic).unwrap();
        let there = topic.cell(Cell::new(k, l));
        assert!(there.iter().any(|utterance| utterance.text == text), "{text} not in {there:?}");
    }
}

#[test]
fn a_run_that_is_cut_off_goes_on_without_paying_twice() {
    let directory = tempfile::tempdir().unwrap();
    let plan = job::plan("lander").unwrap();
    let whole = directory.path().join("whole.jsonl");
    let (expected, _) = job::run(&plan, job(&whole, Backend::Grammar)).unwrap();
    assert!(expected.calls > 100);
    let log = directory.path().join("calls.jsonl");
    let mut calls = 0;
    let built = loop {
        let mut part = job(&log, Backend::Grammar);
        part.max_calls = Some(90);
        match job::run(&plan, part) {
            Ok((built, _)) => break built,
            Err(PipelineError::BudgetSpent { calls: spent }) => calls += spent,
            Err(other) => panic!("{other}"),
        }
        // Killed while it wrote: the last line is torn, its call alone has to be made again.
        let bytes = std::fs::read(&log).unwrap();
        std::fs::write(&log, &bytes[..bytes.len() - 5]).unwrap();
        calls -= 1;
    };
    assert_eq!(calls + built.calls, expected.calls);
    assert_eq!(built.text, expected.text);
    assert_eq!(std::fs::read(&log).unwrap(), std::fs::read(&whole).unwrap());
}

#[test]
fn a_grammar_fills_every_cell_and_says_what_it_is() {
    let directory = tempfile::tempdir().unwrap();
    for domain in shipped::domains() {
        let plan = job::plan(domain).unwrap();
        let log = directory.path().join(domain);
        let (built, _) = job::run(&plan, job(&log, Backend::Grammar)).unwrap();
        assert_eq!(built.taxonomy.as_ref().unwrap().header().fidelity, Fidelity::Grammar);
        let findings = crate::check(built.taxonomy.as_ref().unwrap(), 3);
        assert!(findings.is_empty(), "{domain}: {}", findings[0]);
        for candidate in built.candidates.iter().filter(|candidate| candidate.is_accepted()) {
            assert_eq!(candidate.landed, Some(candidate.requested), "{domain}: {}", candidate.text);
        }
    }
}

#[test]
fn a_changed_plan_cannot_be_replayed() {
    let mut plan = job::plan("lander").unwrap();
    plan.topic[0].action = "rise".to_owned();
    let log = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/lander/calls.jsonl");
    let error = job::run(&plan, job(&log, Backend::Replay)).unwrap_err();
    let says = "the call log lacks the reply to the summary of the domain; the plan, a prompt or the log has";
    assert!(error.to_string().starts_with(says), "{error}");
}

#[test]
fn a_rater_that_talks_nonsense_is_given_up() {
    let directory = tempfile::tempdir().unwrap();
    let plan = job::plan("highway").unwrap();
    let mut job = job(&directory.path().join("calls.jsonl"), Backend::Grammar);
    job.rater = Some(Box::new(Opinionated { replies: Vec::new(), rate: |_, _| "no".to_owned() }));
    let error = job::run(&plan, job).unwrap_err().to_string();
    let says =
        "of the last 50 replies of opinionated are malformed: its template or the model is wrong";
    assert!(error.ends_with(says), "{error}");
}

#[test]
fn the_same_words_for_two_topics_go_to_neither() {
    let mut plan = job::plan("highway").unwrap();
    let mut progress = BuildProgress::new(&plan);
    let candidate = |topic: usize| Candidate {
        spans: vec![crate::WordSpan { part: crate::SpanKind::What, from: 0, to: 2 }],
        landed: Some(Cell::new(2, 2)),
        ..Candidate::new(topic, Cell::new(2, 2), "Slow down.".to_owned(), "")
    };
    progress.add(candidate(0));
    assert_eq!(progress.repeated(&candidate(0)), Some(Reason::Duplicate));
    assert_eq!(progress.repeated(&candidate(1)), Some(Reason::AmbiguousTopic));
    assert_eq!(progress.candidates[0].reason, Some(Reason::AmbiguousTopic));
    assert_eq!(progress.accepted[&(0, Cell::new(2, 2))], 0);
    plan.settings.max_iterations = 1;
    assert!(progress.next(&plan).is_some());
    assert!(progress.next(&plan).is_none());
}

#[test]
fn one_call_per_word_gives_what_one_call_per_sentence_gives_if_nothing_leaks() {
    let directory = tempfile::tempdir().unwrap();
    let mut plan = job::plan("lander").unwrap();
    plan.topic.truncate(1);
    let (joint, _) = job::run(&plan, job(&directory.path().join("a"), Backend::Grammar)).unwrap();
    plan.settings.rate = RateForm::Prefix;
    plan.settings.repeats = 3;
    let (prefix, _) = job::run(&plan, job(&directory.path().join("b"), Backend::Grammar)).unwrap();
    assert_eq!(prefix.candidates.len(), joint.candidates.len());
    for (a, b) in prefix.candidates.iter().zip(&joint.candidates) {
        assert_eq!((&a.text, &a.rated, a.landed), (&b.text, &b.rated, b.landed));
    }
    assert!(prefix.calls > 5 * joint.calls);
}

/// Writes one list, and rates by a rule.
#[derive(Debug)]
struct Opinionated {
    replies: Vec<Reply>,
    rate: fn(&str, Option<usize>) -> String,
}

impl Model for Opinionated {
    fn id(&self) -> &'static str {
        "opinionated"
    }

    fn fidelity(&self) -> Fidelity {
        Fidelity::Local
    }

    fn complete(&mut self, call: &Call) -> Result<Reply, BackendError> {
        Ok(match &call.input {
            Input::Domain => Reply::complete("All matters."),
            Input::Sentence { topic, words, .. } => Reply::complete((self.rate)(topic, *words)),
            _ if self.replies.is_empty() => Reply::exhausted(),
            _ => self.replies.remove(0),
        })
    }
}

fn percent(holds: bool, high: u8, low: u8) -> String {
    if holds { high.to_string() } else { low.to_string() }
}

/// Lets it write for the highway, and returns what came of it.
fn built(model: Opinionated, change: fn(&mut DatabasePlan)) -> (DatabasePlan, Built, LogHeader) {
    let directory = tempfile::tempdir().unwrap();
    let mut plan = job::plan("highway").unwrap();
    plan.settings.rate = RateForm::Prefix;
    plan.settings.max_iterations = 3;
    change(&mut plan);
    let log = directory.path().join("calls.jsonl");
    let prompts = Prompts::default();
    let backends =
        Backends { generator: Box::new(model), rater: None, embedder: Box::new(Lexical) };
    let mut open = CallLog::open(&log).unwrap();
    let mode = CallMode::Live { max_calls: None };
    let mut caller = Caller::new(backends, &mut open, mode, "highway").unwrap();
    let made = build(&plan, &prompts, &mut caller).unwrap();
    let header = caller.header;
    // Whatever was asked is in the log, so nobody is needed to make it again.
    let text = std::fs::read_to_string(&log).unwrap();
    let again = job::replay(&plan, &prompts, &log, &text).unwrap().0;
    assert_eq!(again.report(&plan, &header), made.report(&plan, &header));
    (plan, made, header)
}

fn reasons(built: &Built) -> Vec<(&str, Option<Reason>)> {
    built.candidates.iter().map(|found| (found.text.as_str(), found.reason)).collect()
}

#[test]
fn truncated_and_unreadable_replies_are_counted() {
    let cut = Reply { finish: Finish::Length, ..Reply::complete("Slow down now.\nSlow do") };
    let replies = vec![cut, Reply::complete("Here you are:")];
    let model = Opinionated { replies, rate: |_, words| percent(words >= Some(2), 90, 10) };
    let (plan, built, header) = built(model, |_| {});
    let expected = [("Slow down now.", None), ("Slow do", Some(Reason::Truncated))];
    assert_eq!(reasons(&built), expected);
    let report = built.report(&plan, &header);
    assert!(report.contains("| `truncated` | 1 |"), "{report}");
    let says = "Replies that could not be read: 1 of 2 generations, 0 of 3 ratings, 0 of 7 ratings of controls.";
    assert!(report.contains(says), "{report}");
    assert!(report.contains("Thin, with one sentence: slow_down (2, 3)."), "{report}");
    assert!(report.contains("| slow_down | 10 % | Slow down now. [10, 90, 90] |"), "{report}");
}

/// Sentences of a person's own, on one topic: more than a call asks for, some in a cell that others have filled.
#[test]
fn nothing_that_was_written_vanishes_from_the_report() {
    let mut plan = job::plan("lander").unwrap();
    plan.topic.truncate(1);
    plan.settings.target = 1;
    plan.settings.keep = 1;
    plan.settings.batch = 2;
    plan.settings.max_iterations = 2;
    let hows =
        ["now", "quickly", "gently", "slowly", "carefully", "soon", "here", "again", "instead"];
    let mut texts: Vec<String> = hows.map(|how| format!("Go up {how}.")).into();
    texts.extend(
        ["Gain height.", "Higher, please.", "Zone ahead, climb.", "Go up, danger."]
            .map(str::to_owned),
    );
    let rated = |text: &String| {
        let curve: Vec<&str> = text.split(' ').map(|_| "90").collect();
        format!("Instruction: {text}\nComprehension after each word: {}\n", curve.join(", "))
    };
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("mine.txt");
    let sections = [
        ("2 3", &texts[..9]),
        ("2 2", &texts[9..11]),
        ("3 3", &texts[11..12]),
        ("4 5", &texts[12..]),
    ];
    let section = |(cell, texts): (&str, &[String])| {
        format!("# ascend {cell}\n{}", texts.iter().map(rated).collect::<String>())
    };
    std::fs::write(&file, format!("# summary\nAll.\n{}", sections.map(section).concat())).unwrap();
    let log = directory.path().join("calls.jsonl");
    let authored = || job(&log, Backend::Authored(Some(file.clone())));
    let (built, header) = job::run(&plan, authored()).unwrap();
    let report = built.report(&plan, &header);
    for text in &texts {
        assert!(report.contains(text.as_str()), "{text} has vanished:\n{report}");
    }
    assert!(report.contains("* `no_directive`, ascend (2, 2): Higher, please.\n"), "{report}");
    assert!(report.contains("A cell keeps 1 sentences (`settings.keep`)"), "{report}");
    let again = job::run(&plan, job(&log, Backend::Replay)).unwrap().0;
    assert_eq!(again.report(&plan, &header), report);
    // Nor does a sentence that is added later, because the log answers for the annotations as they were.
    assert_eq!(job::run(&plan, authored()).unwrap().0.calls, 0);
    let more = "\n# ascend\nInstruction: Please go up.\n";
    std::fs::write(&file, std::fs::read_to_string(&file).unwrap() + more).unwrap();
    let error = job::run(&plan, authored()).unwrap_err().to_string();
    let says = "the annotations have changed since the call log was written: it holds another reply to generation 1 of";
    assert!(error.starts_with(says), "{error}");
}

#[test]
fn a_sentence_that_asks_for_another_action_as_clearly_is_turned_down() {
    let turned_down = |rate| {
        let model = Opinionated { replies: vec![Reply::complete("Slow down now.")], rate };
        reasons(&built(model, |plan| plan.settings.min_margin = 10).1)[0].1
    };
    assert_eq!(turned_down(|topic, _| percent(topic == "slow_down", 90, 80)), None);
    let close = turned_down(|topic, _| percent(topic == "slow_down", 90, 81));
    assert_eq!(close, Some(Reason::LowMargin));
    let other = turned_down(|topic, _| percent(topic == "merge_left", 95, 90));
    assert_eq!(other, Some(Reason::WrongAction));
}
