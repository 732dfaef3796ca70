//! `compare`: from a study to its tables, killed on the way, and what is wrong with a request.

use std::fs;

use serde_json::Value;

use crate::support::{PATIENCE, Place, children, is_alive, signal, updates, wait_until};

/// Two rows that train for a moment, and a script.
const STUDY: &str = r#"
title = "Small"
lead = "A small study."
[[parts]]
name = "piloting"
title = "Piloting"
profile = "lander"
steps = 6144
quick_steps = 2048
pictured_on = "real"
columns = ["success", "notifications_per_step"]
differences = [{ of = "late", minus = "prompt", on = "real", measure = "success" }]
evaluations = [
    { name = "own", title = "own" },
    { name = "real", title = "real", set.human.reaction_delay = { fixed = 2 } },
]
[[parts.rows]]
name = "script"
title = "Script"
script = "heuristic"
paper = { success = [0.0] }
[[parts.rows]]
name = "prompt"
title = "Prompt"
set.human.reaction_delay = { fixed = 0 }
[[parts.rows]]
name = "late"
title = "Late"
"#;

/// Writes the study down; returns the command that carries it out.
fn study(place: &Place) -> String {
    let file = place.write("small.toml", STUDY);
    format!(
        "compare {file} --runs runs --out results --seeds 7..8 --episodes 4 --set learner.n_envs=8 \
         --set learner.n_steps=64 --set run.checkpoint_every=2 --jobs 1"
    )
}

fn runs(place: &Place) -> Vec<String> {
    let Ok(entries) = fs::read_dir(place.path().join("runs")) else { return Vec::new() };
    // Beside the runs is the folder in which scripts' evaluations are kept.
    let is_run = |entry: &fs::DirEntry| entry.path().join("config.toml").is_file();
    let runs = entries.filter_map(Result::ok).filter(is_run);
    runs.filter_map(|entry| entry.file_name().into_string().ok()).collect()
}

#[test]
fn a_killed_comparison_goes_on_where_it_was() {
    let place = Place::new();
    let study = study(&place);
    let running = place.start(&[&study]);
    let finished = |place: &Place| -> Vec<String> {
        let is_done = |name: &String| {
            let text = fs::read_to_string(place.run(name).join("run.json")).unwrap_or_default();
            serde_json::from_str::<Value>(&text).is_ok_and(|record| !record["result"].is_null())
        };
        runs(place).into_iter().filter(is_done).collect()
    };
    wait_until("one run is finished, the next begun", PATIENCE, || {
        let done = finished(&place);
        let begun = |name: &String| !done.contains(name) && updates(&place.run(name)) >= 2;
        done.len() == 1 && runs(&place).iter().any(begun)
    });
    let family = children(running.id());
    running.kill();
    wait_until("every process is gone", PATIENCE, || family.iter().all(|id| !is_alive(*id)));
    let done = finished(&place);
    let before = done.iter().map(|name| fs::read(place.run(name).join("run.json")).unwrap());
    let before: Vec<Vec<u8>> = before.collect();
    let listed = place.finish(&[&study, "--plan"]).with_code(0).stdout;
    assert!(listed.contains("finished") && listed.contains("begun"), "{listed}");

    let said = place.finish(&[&study]).with_code(0).stdout;
    assert!(said.contains("results/small.md"), "{said}");
    assert_eq!(runs(&place).len(), 2);
    for (name, before) in done.iter().zip(before) {
        let after = fs::read(place.run(name).join("run.json")).unwrap();
        assert_eq!(after, before, "a finished run is left alone");
    }
    let page = fs::read_to_string(place.path().join("results/small.md")).unwrap();
    for text in ["**Script**, scripted", "*the paper*", "own = real", "late minus prompt"] {
        assert!(page.contains(text), "{text}: {page}");
    }
    let json = fs::read_to_string(place.path().join("results/small.json")).unwrap();
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["parts"][0]["rows"][2]["runs"][0]["steps"], 6144);
    for picture in json["parts"][0]["pictures"].as_array().unwrap() {
        let file = place.path().join("results").join(picture["file"].as_str().unwrap());
        assert!(fs::read(&file).unwrap().starts_with(b"\x89PNG"), "{}", file.display());
    }
    assert!(place.path().join("results/README.md").exists());
}

#[test]
fn an_interrupted_comparison_takes_its_runs_down_and_a_drained_one_ends_well() {
    for (name, code) in [("INT", 130), ("USR1", 0)] {
        let place = Place::new();
        let running = place.start(&[&study(&place), "--steps 100000000"]);
        let under_way = || runs(&place).iter().any(|name| updates(&place.run(name)) >= 1);
        wait_until("a run is under way", PATIENCE, under_way);
        let family = children(running.id());
        signal(name, running.id());
        let ended = running.finish(PATIENCE).with_code(code);
        ended.saying(&["The same command goes on with what is missing"]);
        assert!(family.iter().all(|id| !is_alive(*id)));
    }
}

#[test]
fn wrong_requests_are_one_sentence() {
    let place = Place::new();
    let broken =
        place.write("broken.toml", &STUDY.replace("profile = \"lander\"", "profile = \"sub\""));
    let misspelt = place.write("misspelt.toml", &STUDY.replace("[\"success\",", "[\"succeeded\","));
    for (args, told) in [
        (&*misspelt, "there is no measure `succeeded`; known: success"),
        ("table9", "there is no study or .toml file `table9`"),
        ("table1 --row silent", "there is no row `silent`"),
        ("table1 --row convey --set human.x=1", "--set human.x"),
        ("nowhere.toml", "reading nowhere.toml"),
        (&broken, "there is no file or configuration `sub`"),
    ] {
        let finished = place.finish(&["compare", args]).with_code(2).saying(&[told]);
        assert_eq!(finished.stderr.matches("error: ").count(), 1, "{}", finished.stderr);
    }
    assert!(runs(&place).is_empty());
    for options in ["--quick --out x", "--plan", "--episodes 9"] {
        place.finish(&["compare", options]).with_code(2).saying(&["STUDY"]);
    }
    let own = ["compare table1 --plan --eval-seed 0"];
    place.finish(&own).with_code(2).saying(&["--eval-seed", "1.."]);
}
