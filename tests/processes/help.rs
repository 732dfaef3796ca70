//! What a person reads at a terminal of 80 columns: help, lists, and what to type next.

use std::fs;

use crate::support::{Place, result};

const WIDTH: usize = 80;

#[track_caller]
fn fits(text: &str) {
    for line in text.lines() {
        assert!(line.chars().count() <= WIDTH, "{line}");
    }
}

/// Returns the arguments of an example: words, and what stands between single quotes.
fn arguments(example: &str) -> Vec<String> {
    let command = example.split("  ").next().unwrap().split(" > ").next().unwrap();
    let pieces = command.split('\'').enumerate().flat_map(|(i, piece)| {
        let words = piece.split_whitespace().map(str::to_owned).collect();
        if i % 2 == 1 { vec![piece.to_owned()] } else { words }
    });
    pieces.collect()
}

/// Returns the names of the commands that a help lists; `help` is clap's own.
fn commands(help: &str) -> Vec<String> {
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let listed = listed.take_while(|line| !line.is_empty());
    // What goes on about a command is indented further.
    let names = listed.filter_map(|line| line.strip_prefix("  ")?.split(' ').next());
    names.filter(|name| !name.is_empty() && *name != "help").map(str::to_owned).collect()
}

/// Returns the arguments of the examples that a help ends with.
fn examples(help: &str) -> Vec<Vec<String>> {
    let help = help.replace("\\\n      ", "");
    help.lines().filter_map(|line| line.strip_prefix("  leadtime ")).map(arguments).collect()
}

#[test]
fn help_fits_a_terminal_and_its_examples_are_read() {
    let place = Place::new();
    let help = |args: &[String]| {
        let mut command = place.program(&[]);
        command.args(args).env("COLUMNS", WIDTH.to_string());
        place.start_with(command).finish(crate::support::PATIENCE).with_code(0).stdout
    };
    let with = |path: &[String], word: &str| [path, &[word.to_owned()]].concat();
    // Every command there is: those of a group follow the group.
    let mut paths: Vec<Vec<String>> = vec![Vec::new()];
    let mut n_read = 0;
    while let Some(path) = paths.get(n_read).cloned() {
        n_read += 1;
        let (short, long) = (help(&with(&path, "-h")), help(&with(&path, "--help")));
        for text in [&short, &long] {
            fits(text);
            assert!(!examples(text).is_empty(), "{path:?} shows no example");
        }
        for example in examples(&long) {
            // Arguments are read from left to right, so a wrong one is met before the help is printed.
            help(&with(&example, "--help"));
        }
        paths.extend(commands(&short).iter().map(|name| with(&path, name)));
    }
    let found: Vec<String> = paths.iter().map(|path| path.join(" ")).collect();
    for known in ["up", "script-search", "certs issue", "runs prune", "taxonomy speak"] {
        assert!(found.iter().any(|path| path == known), "`{known}` is not in: {found:?}");
    }
}

#[test]
fn help_for_a_missing_command_is_whole() {
    let place = Place::new();
    let told = place.finish(&[]).with_code(2).stderr;
    assert!(told.contains("\nExit codes:\n") && !told.contains('\u{2026}'), "{told}");
    let asked = place.finish(&["-h"]).with_code(0).stdout;
    assert_eq!(told.trim(), asked.trim());
}

#[test]
fn lists_fit_a_terminal_and_name_runs_whole_in_a_pipe() {
    let place = Place::new();
    let name = "table1-piloting-convey-react-on-a-hard-map-0123456789ab-s201";
    let record = format!(
        r#"{{"format": 1, "name": "{name}", "domain": "steakhouse", "seed": 1, "version": "0.1.0", "commit": null,
             "cpu": "x", "threads": "1", "started": "2026-01-31T12:00:00Z", "resumed": 0, "result": null}}"#
    );
    fs::create_dir_all(place.run(name)).unwrap();
    fs::write(place.run(name).join("run.json"), record).unwrap();
    let line = r#"{"update": 5000, "steps": 10240000, "episodes/success": 0.5, "episodes/return": -1234.5}"#;
    fs::write(place.run(name).join("metrics.jsonl"), line).unwrap();
    let listed = place.finish(&["runs"]).with_code(0).stdout;
    assert!(listed.contains(name) && listed.contains(" 10240000 "), "{listed}");
    assert!(place.finish(&["runs --all"]).with_code(0).stdout.contains(name));
    for args in
        ["compare", "compare table1 --plan", "config", "check -c steakhouse", "check -c lander"]
    {
        fits(&place.finish(&[args]).with_code(0).stdout);
    }
    let plan = place.finish(&["compare table1 --plan"]).with_code(0).stdout;
    assert!(plan.contains("about ") && plan.contains("docs/results"), "{plan}");
}

#[test]
fn the_command_that_goes_on_with_a_run_is_said_and_works() {
    let place = Place::new();
    let train = "train -c cartpole --actors 1 --set learner.n_steps=32 --steps 2560 --name r";
    let stopped = place.finish(&[train, "--stop-after 4 -v"]).with_code(0).stderr;
    assert!(stopped.contains("To go on from update 4:"), "{stopped}");
    assert!(stopped.contains("DEBUG"), "{stopped}");
    let command = stopped.lines().find_map(|line| line.strip_prefix("  leadtime ")).unwrap();
    let done = place.finish(&[command]).with_code(0);
    assert_eq!(result(&place.run("r"))["updates"], 20);
    assert!(done.stdout.contains(", all accounted for"), "{}", done.stdout);
    assert!(done.stderr.contains("leadtime eval runs/r"), "{}", done.stderr);
    // What is asked for quietly says only its results.
    let quiet = place.finish(&["eval r --episodes 2 --baseline unaided --quiet"]).with_code(2);
    quiet.saying(&["unaided"]);
    let quiet = place.finish(&["eval r --episodes 2 -q"]).with_code(0);
    assert!(quiet.stderr.is_empty(), "{}", quiet.stderr);
    fits(&quiet.stdout);
}

#[test]
fn hints_name_the_program_as_it_was_started() {
    let place = Place::new();
    let other = place.copy_of_program("my-world");
    let name = other.to_str().unwrap();
    let train = "train -c cartpole --actors 1 --set learner.n_steps=32 --steps 1280 --name r";
    let run = |args: &[&str]| {
        let command = place.program_at(&other, args);
        place.start_with(command).finish(crate::support::PATIENCE).with_code(0).stderr
    };
    let stopped = run(&[train, "--stop-after 2"]);
    assert!(stopped.contains(&format!("\n  {name} up -c ")), "{stopped}");
    let page = fs::read_to_string(place.run("r").join("report.html")).unwrap();
    assert!(page.contains(&format!("{name} report runs/r")), "the report names the program");
    let done = run(&[train]);
    assert!(done.contains(&format!("\n  {name} eval runs/r\n")), "{done}");
}
