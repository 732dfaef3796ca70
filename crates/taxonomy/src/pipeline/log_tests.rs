//! A log survives what a killed process does to it, and nothing else.

use super::*;
use crate::pipeline::backend::Sampling;

fn header(generator: &str) -> LogHeader {
    let [domain, generator, rater, embedder] =
        ["lander", generator, "rater", "embedder"].map(str::to_owned);
    LogHeader { schema: 1, domain, fidelity: Fidelity::Local, generator, rater, embedder }
}

fn call(prompt: &str) -> Call {
    let (stage, input, prompt) = (CallStage::Summarise, Input::Domain, prompt.to_owned());
    let sampling = Sampling { temperature: 0.0, top_p: 1.0, max_tokens: 16 };
    Call { stage, system: String::new(), prompt, sampling, seed: 1, input }
}

fn fill(path: &Path) -> Vec<String> {
    let mut log = CallLog::open(path).unwrap();
    log.claim(&header("writer")).unwrap();
    let keys: Vec<String> = ["a", "b"].iter().map(|prompt| call(prompt).key("writer")).collect();
    for (key, prompt) in keys.iter().zip(["a", "b"]) {
        log.add(key.clone(), &call(prompt), Reply::complete(format!("{prompt}\nreply"))).unwrap();
    }
    keys
}

#[test]
fn a_torn_last_line_is_forgotten_and_the_rest_kept() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("calls.jsonl");
    let keys = fill(&path);
    let whole = std::fs::read(&path).unwrap();
    let last = whole[..whole.len() - 1].iter().rposition(|byte| *byte == b'\n').unwrap() + 1;
    for cut in [last + 1, whole.len() - 1] {
        std::fs::write(&path, &whole[..cut]).unwrap();
        let mut log = CallLog::open(&path).unwrap();
        assert_eq!(log.replies.len(), 1);
        assert_eq!(log.reply(&keys[0]).unwrap().text, "a\nreply");
        assert!(log.reply(&keys[1]).is_none());
        log.add(keys[1].clone(), &call("b"), Reply::complete("b\nreply")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), whole);
    }
}

#[test]
fn damage_in_the_middle_is_refused_with_its_line() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("calls.jsonl");
    fill(&path);
    let text = std::fs::read_to_string(&path).unwrap().replacen("\"key\"", "\"kee\"", 1);
    std::fs::write(&path, text).unwrap();
    let error = CallLog::open(&path).unwrap_err().to_string();
    assert!(error.starts_with("line 2 of the call log "), "{error}");
}

#[test]
fn a_file_that_is_refused_stays_as_it_is() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("calls.jsonl");
    for (bytes, says) in [
        (&b"{\"my\":\"only copy\"}"[..], "is no call log"),
        (&b"\x08\0\0{}\nweights\nthe rest"[..], "line 1 of the call log"),
        (&b"{\"schema\": 1}\ntorn"[..], "line 1 of the call log"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let error = CallLog::open(&path).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }
    // A header that was torn is begun again.
    for torn in [&b"{\"sc"[..], &b"{\"schema\":1,\"dom"[..], &b""[..]] {
        std::fs::write(&path, torn).unwrap();
        assert!(CallLog::open(&path).unwrap().header.is_none());
        assert!(std::fs::read(&path).unwrap().is_empty());
    }
}

#[test]
fn a_pipe_in_the_place_of_a_log_keeps_nobody_waiting() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("calls.jsonl");
    assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
    for told in [CallLog::open(&path).map(|_| ()), regular::read_to_string(&path).map(|_| ())] {
        assert!(told.unwrap_err().to_string().ends_with("calls.jsonl: it is not a file"));
    }
}

#[test]
fn a_log_has_one_writer() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("calls.jsonl");
    let first = CallLog::open(&path).unwrap();
    let error = CallLog::open(&path).unwrap_err().to_string();
    assert!(
        error.ends_with("is written by another command; wait for its end, or give another log")
    );
    drop(first);
    CallLog::open(&path).unwrap();
}

#[test]
fn the_log_of_another_run_is_not_gone_on_with() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("calls.jsonl");
    fill(&path);
    let error = CallLog::open(&path).unwrap().claim(&header("another")).unwrap_err().to_string();
    let says = "was made for lander (local) with writer, rater and embedder, not";
    assert!(error.contains(says), "{error}");
}

#[test]
fn a_log_of_another_claim_says_both() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("calls.jsonl");
    fill(&path);
    let claim = |header| CallLog::open(&path).unwrap().claim(&header).unwrap_err().to_string();
    let error = claim(LogHeader { fidelity: Fidelity::Paper, ..header("writer") });
    let says = "was begun with --fidelity local, not paper; give --fidelity local, or another log";
    assert!(error.ends_with(says), "{error}");
    let error = claim(LogHeader { schema: 2, ..header("writer") });
    assert!(error.ends_with("is of form 1; this program writes form 2; give another log"));
}

#[test]
fn keys_tell_apart_whatever_a_reply_depends_on() {
    let base = call("a");
    let hotter = Sampling { temperature: 0.5, ..base.sampling };
    let others = [
        call("b"),
        Call { seed: 2, ..base.clone() },
        Call { system: "s".to_owned(), ..base.clone() },
        Call { sampling: hotter, ..base.clone() },
    ];
    for other in &others {
        assert_ne!(other.key("m"), base.key("m"));
    }
    assert_ne!(base.key("m"), base.key("n"));
    assert_eq!(base.key("m"), call("a").key("m"));
}
