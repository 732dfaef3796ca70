//! What the program prints, draws and keeps, command by command.

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;
use std::time::Duration;

use crate::support::{PATIENCE, Place, children, is_alive, record, repository, result, wait_until};
use serde_json::Value;

/// A CartPole run with local actors, of about a second.
const TRAIN: &str = "up -c cartpole --name r --actors 1 --set learner.n_steps=64 --set learner.total_steps=5120 \
                     --set run.checkpoint_every=4";

fn trained() -> Place {
    let place = Place::new();
    place.finish(&[TRAIN]).with_code(0);
    place
}

/// Names everybody who plays in an evaluation.
fn players(evaluation: &Value) -> Vec<&str> {
    let players = evaluation["comparison"]["summaries"].as_array().unwrap();
    players.iter().filter_map(|player| player["player"].as_str()).collect()
}

#[test]
fn help_explains_itself_and_lists_exit_codes() {
    let place = Place::new();
    let help = place.finish(&["--help"]).with_code(0).stdout;
    for part in ["smoke", "Examples:", "130  interrupted", "leadtime actor --connect"] {
        assert!(help.contains(part), "{part}");
    }
    let script = place.finish(&["completions bash"]).with_code(0).stdout;
    assert!(script.contains("_leadtime()"));
}

#[test]
fn every_built_in_configuration_can_be_printed_and_used() {
    let place = Place::new();
    let names = place.finish(&["config"]).with_code(0).stdout;
    let names_are = "cartpole cue_recall highway highway_conflict lander lander_hard paper_highway paper_lander paper_lander_hard \
                     paper_letter_highway paper_letter_lander paper_letter_lander_hard paper_letter_steakhouse \
                     pilot python steakhouse steakhouse_timing";
    assert!(names.lines().eq(names_are.split(' ')), "{names}");
    for name in names.lines() {
        let text = place.finish(&["config", name]).with_code(0).stdout;
        let file = place.write("printed.toml", &text);
        let mut check = place.program(&["check -c", &file]);
        if name == "python" {
            // A worker that needs no packages.
            check.args(["--worker", &format!("python3 {}", repository("tests/worker/fake.py"))]);
        }
        place.start_with(check).finish(PATIENCE).with_code(0);
    }
}

#[test]
fn a_crate_for_a_world_of_ones_own_is_made_and_can_be_resolved() {
    let place = Place::new();
    let made = place.finish(&["new my-world"]).with_code(0);
    let next = "\nNext:\n  cd my-world\n  cargo run --release -- check -c corridor\n";
    assert!(made.stderr.contains(next), "{}", made.stderr);
    let made = place.path().join("my-world");
    for (file, original) in [
        ("src/main.rs", "examples/corridor.rs"),
        ("src/corridor.toml", "examples/corridor.toml"),
        ("Cargo.lock", "Cargo.lock"),
    ] {
        let original = fs::read(repository(original)).unwrap();
        assert_eq!(fs::read(made.join(file)).unwrap(), original, "{file}");
    }
    let mut tree = Command::new(env!("CARGO"));
    tree.current_dir(&made).args(["tree", "--offline", "--depth=1", "--prefix=none"]);
    let tree = tree.output().unwrap();
    let (told, errors) =
        (String::from_utf8(tree.stdout).unwrap(), String::from_utf8_lossy(&tree.stderr));
    assert!(tree.status.success(), "{errors}");
    assert!(told.starts_with("my-world ") && told.contains("\nleadtime-sims "), "{told}");
    let says = |args: &str, parts: &[&str]| place.finish(&[args]).with_code(2).saying(parts);
    says("new my-world", &["my-world is not an empty directory"]);
    let allowed = "is not a crate's name; allowed: a lower-case letter";
    let place_of = |name: &str| format!("the directory (--name gives another): `{name}` {allowed}");
    says("new leadtime-sims", &[&place_of("leadtime-sims")]);
    says("new Grid", &[&place_of("Grid")]);
    says("new grid --name Bad_Name", &[&format!("--name: `Bad_Name` {allowed}")]);
    says("new grid --leadtime .", &["--leadtime .: no source of Leadtime"]);
    let empty = place.path().join("empty-one");
    fs::create_dir(&empty).unwrap();
    let mut here = place.program(&["new ."]);
    here.current_dir(&empty);
    place.start_with(here).finish(crate::support::PATIENCE).with_code(0);
    let manifest = fs::read_to_string(empty.join("Cargo.toml")).unwrap();
    assert!(manifest.contains("name = \"empty-one\""), "{manifest}");
    assert!(!place.path().join("grid").exists() && !place.path().join("Grid").exists());
}

#[test]
fn a_check_plays_the_world() {
    let place = Place::new();
    let told = place.finish(&["check -c cartpole"]).with_code(0).stdout;
    assert!(told.contains("played         12 episodes, "), "{told}");
    let dear = place.finish(&["check -c lander --set notifier.initiation_cost=1000"]).with_code(0);
    // Its lines break where the terminal ends.
    let told = dear.stdout.split_whitespace().collect::<Vec<_>>().join(" ");
    let says = "notice a message costs 1000.000, and an episode without messages has rewards of ";
    assert!(told.contains(says), "{told}");
}

#[test]
fn every_world_with_an_original_replays_its_traces() {
    let place = Place::new();
    for (world, traces) in [
        ("lander", "lander_traces"),
        ("highway", "highway_traces"),
        ("steakhouse", "steak_traces"),
        ("steakhouse", "steak_golden"),
    ] {
        let file = repository(&format!("tests/data/{traces}.json.gz"));
        let told = place.finish(&["conformance", world, &file]).with_code(0).stdout;
        assert!(told.ends_with("passed\n"), "{told}");
        let report = place.finish(&["conformance", world, &file, "--json"]).with_code(0).json();
        assert_eq!(report["passed"], true);
    }
    let wrong = repository("tests/data/steak_golden.json.gz");
    place.finish(&["conformance", "highway", &wrong]).with_code(2);
}

#[test]
fn recorded_traces_may_be_plain_and_one_number_that_is_off_is_told() {
    let place = Place::new();
    let packed = repository("tests/data/lander_traces.json.gz");
    // The traces unpacked, and with one recorded number off.
    let unpacked = Command::new("gzip").args(["-dc", &packed]).output().expect("gzip is there");
    let mut traces: Value = serde_json::from_slice(&unpacked.stdout).expect("the traces are JSON");
    let plain = place.write("traces.json", &traces.to_string());
    place.finish(&["conformance", "lander", &plain]).with_code(0);
    traces["episodes"][0]["steps"][5]["obs"][0] = 0.9.into();
    let wrong = place.write("wrong.json", &traces.to_string());
    let told = place.finish(&["conformance", "lander", &wrong]).with_code(1).stdout;
    assert!(told.contains("beyond the bound") && told.contains("failed"), "{told}");
}

#[test]
fn a_pilot_is_evaluated_on_gymnasiums_seeds() {
    let place = Place::new();
    let args = "pilot eval --pilot heuristic --seeds 0..20 --json";
    let calm = place.finish(&[args]).with_code(0).json();
    assert_eq!(calm["episodes"], 20);
    assert!(calm["mean_return"].as_f64() > Some(150.0), "{calm}");
    let shares = ["landed", "crashed", "out", "timed_out"];
    let sum: f64 = shares.iter().filter_map(|share| calm[share].as_f64()).sum();
    assert!((sum - 1.0).abs() < 1e-9);
    let windy = place.finish(&[args, "--wind"]).with_code(0).json();
    assert!(windy["mean_return"].as_f64() < calm["mean_return"].as_f64());
}

#[test]
fn a_run_leaves_everything_that_is_promised() {
    let place = trained();
    let run = place.run("r");
    for file in ["config.toml", "run.json", "metrics.jsonl", "policy.safetensors", "report.html"] {
        assert!(run.join(file).is_file(), "{file}");
    }
    let report = fs::read_to_string(run.join("report.html")).unwrap();
    for part in ["episode length", "Staleness", "waiting for rollouts", "superseded"] {
        assert!(report.contains(part), "the report has no {part}");
    }
    assert!(fs::read_dir(run.join("tensorboard")).unwrap().count() == 1);
    let record = record(&run);
    for key in ["seed", "version", "cpu", "threads", "started"] {
        assert!(!record[key].is_null(), "{key}");
    }
    assert_eq!(record["threads"], "1");
    assert_eq!(result(&run)["books"]["balanced"], true);
    // The stored configuration is complete and can be used as it is.
    let stored = run.join("config.toml");
    place.finish(&["check", "-c", stored.to_str().unwrap()]).with_code(0);
    // Started once more, it says that there is nothing to do.
    place.finish(&[TRAIN]).with_code(0).saying(&["finished"]);
}

#[test]
fn every_metric_is_documented_and_every_documented_metric_exists() {
    let place = trained();
    let last = |file: &str| -> Vec<String> {
        let lines = fs::read_to_string(place.run("r").join(file)).unwrap();
        let last: Value = serde_json::from_str(lines.lines().last().unwrap()).unwrap();
        last.as_object().unwrap().keys().cloned().collect()
    };
    let keys = [last("metrics.jsonl"), last("held_out.jsonl")].concat();
    let written: BTreeSet<&str> =
        keys.iter().map(String::as_str).filter(|key| key.contains('/')).collect();
    let page = fs::read_to_string(repository("docs/metrics.md")).unwrap();
    let names = page.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next());
    // The measures of an evaluation have no slash.
    let documented: BTreeSet<&str> = names.filter(|name| name.contains('/')).collect();
    assert_eq!(documented, written);
}

#[test]
fn the_best_policy_is_found_on_held_out_episodes_and_without_them_it_is_the_last() {
    let place = Place::new();
    let told = place.finish(&[TRAIN]).with_code(0).stdout;
    assert!(told.contains("\nbest     update "), "{told}");
    let listed = place.finish(&["runs --json"]).with_code(0).json();
    assert!(listed[0]["held_out"].as_f64().is_some(), "{listed}");
    let report = fs::read_to_string(place.run("r").join("report.html")).unwrap();
    for part in ["success, held out", "best policy", "held-out episodes"] {
        assert!(report.contains(part), "the report has no {part}");
    }
    let off = TRAIN.replace("--name r", "--name off --set evaluation.during_training=0");
    place.finish(&[&off]).with_code(0);
    let read = |run: &str, file: &str| fs::read(place.run(run).join(file)).unwrap();
    assert_eq!(read("off", "best.safetensors"), read("off", "policy.safetensors"));
    assert!(!place.run("off").join("held_out.jsonl").exists());
    let digest = |run: &str| result(&place.run(run))["weights_sha256"].clone();
    assert_eq!(digest("r"), digest("off"), "an evaluation moves no weight");
}

#[test]
fn a_run_ends_where_its_policy_is_good_enough_and_its_record_says_so() {
    let place = Place::new();
    // Whoever stands for five steps has succeeded, which the first evaluation finds.
    let train = [TRAIN, "--set evaluation.stop_at=0.9 --set evaluation.world.max_steps=5"];
    let told = place.finish(&train).with_code(0).stdout;
    assert!(told.contains("\nended    by evaluation.stop_at"), "{told}");
    let record = result(&place.run("r"));
    assert_eq!((&record["end"], &record["updates"]), (&"stop_at".into(), &5.into()));
    let report = fs::read_to_string(place.run("r").join("report.html")).unwrap();
    assert!(report.contains("evaluation.stop_at = 0.9: from update 5: success 1.00"), "{report}");
    place.finish(&train).with_code(0).saying(&["raise evaluation.stop_at"]);
    // Without the mark it makes all its steps.
    let on = place.finish(&[TRAIN, "--set evaluation.world.max_steps=5"]).with_code(0).stdout;
    assert!(on.contains("\nupdates  20 ("), "{on}");
    assert_eq!(result(&place.run("r"))["end"], "total_steps");
}

#[test]
fn a_report_can_be_made_again_with_an_evaluation_and_of_several_runs() {
    let place = trained();
    let page = |path: &str| fs::read_to_string(place.path().join(path)).unwrap();
    let before = page("runs/r/report.html");
    assert!(before.contains("<code>leadtime report runs/r</code>"), "the next command is named");
    let text = place.finish(&["report r --episodes 8"]).with_code(0).stdout;
    assert!(
        text.contains("trained minus untrained") && text.contains("runs/r/report.html"),
        "{text}"
    );
    let after = page("runs/r/report.html");
    let command =
        "leadtime up -c cartpole --seed 1 --set learner.n_steps=64 --set learner.total_steps=5120";
    for part in ["The trained policy ", command, "What the measures mean", "All settings of r"] {
        assert!(after.contains(part), "the report has no {part}");
    }
    let kept: Value = serde_json::from_str(&page("runs/r/eval.json")).unwrap();
    assert_eq!(kept["comparison"]["summaries"][0]["n_episodes"], 8);
    place.finish(&["eval r --episodes 4 --save"]).with_code(0);
    let kept: Value = serde_json::from_str(&page("runs/r/eval.json")).unwrap();
    assert_eq!(kept["comparison"]["summaries"][0]["n_episodes"], 4);
    assert_eq!(fs::read_dir(place.run("r").join("tensorboard")).unwrap().count(), 2);
    // Four at once do not disturb each other, and one that cannot save prints what it found.
    let all = [(); 4].map(|()| place.start(&["eval r --episodes 2 --save"]));
    for evaluation in all {
        evaluation.finish(PATIENCE).with_code(0);
    }
    fs::rename(place.run("r").join("eval.json"), place.file("eval.json")).unwrap();
    fs::create_dir_all(place.run("r").join("eval.json/in the way")).unwrap();
    let unsaved = place.finish(&["eval r --episodes 2 --save"]).with_code(2);
    assert!(unsaved.stdout.contains("success") || unsaved.stdout.contains("return"));
    fs::remove_dir_all(place.run("r").join("eval.json")).unwrap();
    let kept = page("runs/r/report.html");
    place.finish(&["report r --episodes 3 --out elsewhere.html"]).with_code(0);
    assert!(page("elsewhere.html").contains("episodes: 3,"));
    let is_untouched =
        page("runs/r/report.html") == kept && !place.run("r").join("eval.json").exists();
    assert!(is_untouched, "--out leaves the run's directory as it is");
    place.finish(&[&TRAIN.replace("--name r", "--name s --seed 2")]).with_code(0);
    place.finish(&["report r s"]).with_code(2).saying(&["--out FILE"]);
    place.finish(&["report r nothing --out both.html"]).with_code(2).saying(&["`nothing`"]);
    place.finish(&["report r s --episodes 4 --out both.html"]).with_code(0);
    let both = page("both.html");
    assert!(both.contains("<h1>Runs r, s</h1>") && both.contains("--seed 2"));
    let outside = place.write("p.safetensors", "");
    fs::copy(place.run("r").join("policy.safetensors"), &outside).unwrap();
    place.finish(&["eval", &outside, "--episodes 1 --save"]).with_code(2).saying(&["--save"]);
}

#[test]
fn a_trained_policy_can_be_evaluated_and_runs_compared() {
    let place = trained();
    let eval = "eval r --episodes 8";
    let evaluated = place.finish(&[eval, "--json"]).with_code(0).json();
    assert_eq!(evaluated["comparison"]["summaries"][0]["n_episodes"], 8);
    let again = place.finish(&[eval, "--json"]).with_code(0).json();
    assert_eq!(evaluated, again, "an evaluation is reproducible");
    let heard = place.finish(&["eval r --transcript"]).with_code(2);
    heard.saying(&["no messages are sent in `cartpole`, so there is nothing to hear"]);
    let of_training = "seed 1 is that of its training";
    place.finish(&[eval, "--eval-seed 1"]).with_code(0).saying(&[of_training]);
    let report = "report r --episodes 2 --out own.html --eval-seed 1";
    place.finish(&[report]).with_code(0).saying(&[of_training]);
    let own = fs::read_to_string(place.file("own.html")).unwrap();
    assert!(own.contains("the first of which it began with"), "it claims no others");
    let other = place.finish(&[eval]).with_code(0);
    assert!(!other.stderr.contains("is that of its training"), "{}", other.stderr);
    let text = other.stdout;
    assert!(text.contains("95 %"), "{text}");
    place.finish(&[eval, "--baseline nobody"]).with_code(2).saying(&["nobody"]);
    let other = TRAIN.replace("--name r", "--name s");
    place.finish(&[&other, "--set learner.clip=0.1"]).with_code(0);
    let compared = place.finish(&["runs compare r s"]).with_code(0).stdout;
    assert!(compared.contains("learner.clip: 0.2 -> 0.1"), "{compared}");
    assert!(compared.ends_with("weights: differ\n"), "{compared}");
}

#[test]
fn a_comparison_shows_whether_the_weights_are_equal() {
    let place = trained();
    place.finish(&[&TRAIN.replace("--name r", "--name s")]).with_code(0);
    let compared = place.finish(&["runs compare r s --all"]).with_code(0).stdout;
    let digest = result(&place.run("r"))["weights_sha256"].as_str().unwrap().to_owned();
    assert!(compared.ends_with("weights: equal\n"), "{compared}");
    assert_eq!(compared.matches(&digest[..12]).count(), 2, "{compared}");
    let compared = place.finish(&["runs compare r s --json"]).with_code(0).json();
    assert_eq!(compared["weights"], "equal");
    for run in compared["runs"].as_array().unwrap() {
        assert_eq!(run["weights_sha256"], digest);
        assert_eq!(run["reproducible"], true);
    }
    // A record that cannot be read does not hide its run.
    fs::write(place.run("s").join("run.json"), "{").unwrap();
    let listed = place.finish(&["runs"]).with_code(0);
    let listed = listed.saying(&["run.json", "not the record"]).stdout;
    let line = listed.lines().find(|line| line.starts_with("s ")).unwrap();
    assert!(line.contains("unreadable"), "{listed}");
    let listed = place.finish(&["runs --json"]).with_code(0).json();
    assert_eq!(listed.as_array().map(Vec::len), Some(2));
}

#[test]
fn a_run_stops_after_exactly_as_many_updates_as_asked_for() {
    let place = Place::new();
    let lag = "--set learner.mode=lag --stop-after 8";
    let stopped = place.finish(&[TRAIN, lag]).with_code(0).stdout;
    assert!(stopped.contains("updates  8 ("), "{stopped}");
}

#[test]
fn a_run_goes_on_with_other_threads_and_has_the_same_weights() {
    let place = trained();
    let other = TRAIN.replace("--name r", "--name s");
    place.finish(&[&other, "--set learner.threads=3 --stop-after 10"]).with_code(0);
    place.finish(&[&other, "--set learner.threads=2"]).with_code(0);
    let compared = place.finish(&["runs compare r s"]).with_code(0).stdout;
    assert!(compared.ends_with("weights: equal\n"), "{compared}");
}

#[test]
fn a_longer_schedule_of_the_learning_rate_is_told() {
    let place = trained();
    let longer = [TRAIN, "--set learner.total_steps=7680"];
    let told = ["learner.total_steps: 5120 -> 7680", "learner.anneal = true", "will differ"];
    place.finish(&longer).with_code(0).saying(&told);
    assert_eq!(result(&place.run("r"))["reproducible"], false, "no single command trains it");
    let again = place.finish(&longer).with_code(0);
    assert!(!again.stderr.contains("will differ"), "{}", again.stderr);
    // A rate that does not fall is the same for every length.
    let even = TRAIN.replace("--name r", "--name s --set learner.anneal=false");
    place.finish(&[&even]).with_code(0);
    place.finish(&[&even, "--set learner.total_steps=7680"]).with_code(0);
    assert_eq!(result(&place.run("s"))["reproducible"], true);
}

#[test]
fn a_quick_smoke_works_end_to_end_and_leaves_no_process() {
    let place = Place::new();
    let mut smoke = place.start(&["smoke --quick --json"]);
    let mut seen = BTreeSet::new();
    wait_until("smoke ends", Duration::from_mins(2), || {
        seen.extend(children(smoke.id()));
        !smoke.is_running()
    });
    let done = smoke.finish(PATIENCE).with_code(0).saying(&["mechanics only"]);
    assert!(seen.len() >= 3, "learner and two actors were separate processes: {seen:?}");
    assert!(seen.iter().all(|child| !is_alive(*child)));
    let printed = done.json();
    assert_eq!(printed["quick"], true);
    let run = place.path().join(printed["run"].as_str().unwrap());
    for file in ["report.html", "playthrough.png", "policy.safetensors", "eval.json"] {
        assert!(run.join(file).is_file(), "{file}");
    }
    assert_eq!(printed["books"]["balanced"], true);
    assert_eq!(players(&printed), ["trained", "unaided", "heuristic", "untrained"]);
    // A report made later has the same verdict and says why.
    place.finish(&["report", run.to_str().unwrap(), "--episodes 2"]).with_code(0);
    let report = fs::read_to_string(run.join("report.html")).unwrap();
    for part in [printed["verdict"].as_str().unwrap(), "This was a quick run"] {
        assert!(report.contains(part), "the report has no {part}");
    }
    // The same policy as pictures of every kind.
    let run = run.to_str().unwrap();
    for name in ["a.png", "a.svg", "a.gif", "a.html"] {
        place.finish(&["play", run, "-o", name]).with_code(0);
        assert!(place.path().join(name).metadata().unwrap().len() > 1_000, "{name}");
    }
    // And in words: the same ones whenever it is asked.
    let hear = ["eval", run, "--transcript --episodes 2 --baseline heuristic"];
    let heard = place.finish(&hear).with_code(0).stdout;
    assert_eq!(heard.matches("understands").count(), 4, "{heard}");
    assert!(heard.contains("follows "), "{heard}");
    assert!(!heard.contains(" 1/"), "words, not numbers: {heard}");
    assert_eq!(place.finish(&hear).with_code(0).stdout, heard);
    let other = place.finish(&[&hear[..], &["--words highway"]].concat());
    other.with_code(2).saying(&["highway", "slow_down", "ascend"]);
    place.finish(&["play", run, "-o", "h.svg", "--baseline", "heuristic"]).with_code(0);
    let drawn = fs::read_to_string(place.path().join("h.svg")).unwrap();
    assert!(drawn.contains('\u{201c}'), "a sentence is quoted");
    place
        .finish(&["play", run, "-o", "a.bmp"])
        .with_code(2)
        .saying(&["png, svg, gif, html or mp4"]);
}

/// An ffmpeg that keeps what it is told and given.
const FAKE_FFMPEG: &str = r#"#!/bin/sh
printf '%s ' "$@" > told
for file; do :; done
cat > "$file"
"#;

#[test]
fn a_film_is_what_ffmpeg_makes_of_the_moving_picture() {
    let place = trained();
    fs::create_dir_all(place.file("bin")).unwrap();
    let draw = |path: &str, file: &str| {
        let mut command = place.program(&["play r -o", file]);
        command.env("PATH", path);
        place.start_with(command).finish(PATIENCE)
    };
    let bin = place.file("bin");
    let missing = draw(&bin, "a.mp4").with_code(2);
    let missing = missing.saying(&["an mp4 needs ffmpeg: install it, or draw a gif"]);
    assert!(!missing.stderr.contains("os error"), "{}", missing.stderr);
    assert!(!place.path().join("a.mp4").exists());

    let usual = std::env::var("PATH").unwrap();
    let path = format!("{bin}:{usual}");
    let pretend = |script: &str| {
        place.executable("bin/ffmpeg", place.write("ffmpeg.sh", script).as_ref());
    };
    pretend(FAKE_FFMPEG);
    let drawn = draw(&path, "a.mp4").with_code(0).stdout;
    assert!(drawn.starts_with("a.mp4: "), "{drawn}");
    draw(&path, "a.gif").with_code(0);
    let given = fs::read(place.file("a.mp4")).unwrap();
    let n_steps = drawn.trim_end().rsplit_once(", ").and_then(|(_, n)| n.strip_suffix(" steps"));
    let n_steps: usize = n_steps.and_then(|n| n.parse().ok()).expect("it says how many steps");
    let moments = gif::DecodeOptions::new().read_info(given.as_slice()).unwrap();
    let (width, height) = (moments.width(), moments.height());
    assert!(width == 600 && height >= 200, "{width} x {height}");
    // At most 150.
    let n_moments = n_steps.div_ceil(n_steps.div_ceil(149)) + 1;
    assert_eq!(moments.into_iter().map(Result::unwrap).count(), n_moments, "{drawn}");
    assert!(given == fs::read(place.file("a.gif")).unwrap(), "it is given the whole GIF");
    let told = fs::read_to_string(place.file("told")).unwrap();
    for part in [
        "-f gif -i pipe:0 ",
        "-vf scale=trunc(iw/2)*2:trunc(ih/2)*2 ",
        "-pix_fmt yuv420p ",
        "-f mp4 a.mp4 ",
    ] {
        assert!(told.contains(part), "{told}");
    }
    pretend("#!/bin/sh\necho no such codec >&2\nexit 1\n");
    let told = ["no such codec", "ffmpeg could not write b.mp4: see above"];
    draw(&path, "b.mp4").with_code(2).saying(&told);

    if !Command::new("ffmpeg").arg("-version").output().is_ok_and(|done| done.status.success()) {
        println!("skipped: no ffmpeg here");
        return;
    }
    draw(&usual, "real.mp4").with_code(0);
    let film = fs::read(place.file("real.mp4")).unwrap();
    assert_eq!(film.get(4..8), Some(&b"ftyp"[..]), "an MP4 names its kind first");
}

#[test]
fn a_script_is_searched_and_a_policy_is_compared_with_it_and_with_the_oracle() {
    let place = Place::new();
    let search = ["script-search lander --steps 2000 --episodes 4 --json -o"];
    let found = place.finish(&[&search[..], &["s.toml"]].concat()).with_code(0).json();
    assert_eq!(found["search"]["domain"], "lander");
    let again = place.finish(&[&search[..], &["again.toml"]].concat()).with_code(0).json();
    assert_eq!(found, again, "a search is reproducible");
    let read = |name: &str| fs::read_to_string(place.path().join(name)).unwrap();
    assert_eq!(read("s.toml"), read("again.toml"));
    let words = place.finish(&["script-search lander --steps 2000 --episodes 4"]).with_code(0);
    assert!(words.stdout.starts_with("Tried ") && words.stdout.contains("unaided"));
    assert_eq!(read("lander-script.toml"), read("s.toml"));
    let none = place.finish(&["script-search cartpole"]).with_code(2);
    assert!(!none.stderr.contains("searching a script"), "{}", none.stderr);
    none.saying(&["no messages are sent"]);
    // What would fail after the search is refused before it, and no script is lost.
    place.finish(&["script-search lander"]).with_code(2).saying(&["exists already", "-o"]);
    place.finish(&["script-search lander -o no/where.toml"]).with_code(2).saying(&["no folder no"]);
    place.finish(&["script-search lander -o new/"]).with_code(2).saying(&["new/ is a folder"]);
    let same = ["script-search lander --steps 2000 --seed 7 --eval-seed 7 -o other.toml"];
    place.finish(&same).with_code(2).saying(&["episodes that chose it", "--eval-seed"]);
    let policy = repository("deploy/policies/piloting.safetensors");
    place.write("up.toml", "[[rules]]\nsay = { topic = \"ascend\", k = 2, l = 2 }\n");
    let eval = ["eval", &policy, "--episodes 1 --json --baseline up.toml --baseline oracle"];
    assert_eq!(players(&place.finish(&eval).with_code(0).json()), ["policy", "up", "oracle"]);
    place.finish(&["play", &policy, "-o up.svg --baseline up.toml"]).with_code(0);
    // Two files of one name are told apart.
    fs::create_dir(place.file("b")).unwrap();
    place.write("b/up.toml", "[[rules]]\nsay = { topic = \"descend\", k = 2, l = 2 }\n");
    let eval = ["eval", &policy, "--episodes 1 --json --baseline up.toml --baseline b/up.toml"];
    let told_apart = ["policy", "up.toml", "b/up.toml"];
    assert_eq!(players(&place.finish(&eval).with_code(0).json()), told_apart);
    // On the episodes that chose it, it looks better than it is.
    let written = read("s.toml").parse::<toml::Table>().unwrap();
    assert!(written["search"]["seed"].is_integer(), "that is where its seed is looked for");
    let rule = "[[rules]]\nsay = { topic = \"ascend\", k = 2, l = 2 }\n";
    place.write("searched.toml", &format!("[search]\nseed = 7\n{rule}"));
    let with_seed = |seed: &str| {
        let eval = ["eval", &policy, "--episodes 1 --baseline searched.toml --eval-seed", seed];
        place.finish(&eval).with_code(0).stderr
    };
    assert!(with_seed("7").contains("seed 7 is that of its search"));
    assert!(!with_seed("8").contains("is that of its search"));
    place.write("odd.toml", "[[rules]]\nsay = { topic = \"upwards\", k = 2, l = 2 }\n");
    let eval = ["eval", &policy, "--episodes 1 --baseline odd.toml"];
    place.finish(&eval).with_code(2).saying(&["odd", "rule 1", "no topic `upwards`"]);
}
