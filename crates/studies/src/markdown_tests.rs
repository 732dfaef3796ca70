use leadtime_eval::measure::{Difference, EpisodeResult, Evaluation, Summary};
use leadtime_numerics::stats::Bootstrap;

use super::*;

fn evaluation(success: &[f32]) -> Evaluation {
    let episode = |&success: &f32| EpisodeResult {
        total_reward: f64::from(success),
        n_steps: 40,
        truncated: false,
        metrics: vec![success, 4.0, 3.0],
    };
    Evaluation {
        player: "p".to_owned(),
        seed: 1,
        metrics: ["success", "notifications", "followed"].map(str::to_owned).to_vec(),
        episodes: success.iter().map(episode).collect(),
    }
}

fn measured_on(evaluations: &[&str], choice: Choice, seeds: &[&[f32]]) -> ConditionResult {
    let evaluated: Vec<Evaluation> = seeds.iter().map(|seed| evaluation(seed)).collect();
    ConditionResult {
        evaluations: evaluations.iter().map(|&name| name.to_owned()).collect(),
        title: evaluations.join(" = "),
        choice,
        summary: Summary::over_seeds("p", &evaluated, &Bootstrap::new(1)),
    }
}

fn said(evaluation: Option<&str>, mean: f64, deviation: Option<f64>) -> Published {
    let evaluation = evaluation.map(str::to_owned);
    Published { evaluation, measure: "success".to_owned(), mean, deviation }
}

fn row(name: &str, published: Vec<Published>, results: Vec<ConditionResult>) -> RowResult {
    RowResult {
        name: name.to_owned(),
        title: name.to_uppercase(),
        notification: "topic only".to_owned(),
        settings: vec!["human.x = 1".to_owned()],
        published,
        results,
        trainings: RowTrainings::new(vec![0.75, 1.0, 0.9], 0.05, &Bootstrap::new(1)),
        runs: vec![TrainedRun {
            name: format!("run-{name}"),
            seed: 101,
            configuration: "c0ffee".to_owned(),
            steps: 2048,
            minutes: 1.25,
            weights: "beef".to_owned(),
            reproducible: true,
            program: "leadtime 0.1.0".to_owned(),
        }],
    }
}

const GOOD: [&[f32]; 2] = [&[1.0, 1.0, 1.0, 0.0], &[1.0, 1.0, 1.0, 1.0]];
const BAD: [&[f32]; 2] = [&[0.0, 1.0, 0.0, 0.0], &[0.0, 0.0, 0.0, 0.0]];

fn result(layout: Layout) -> StudyResult {
    let quick = measured_on(&["quick"], Choice::Sample, &GOOD);
    let slow = measured_on(&["slow"], Choice::Sample, &BAD);
    let both = |choice| measured_on(&["quick", "slow"], choice, &GOOD);
    let late = vec![said(None, 0.22, Some(0.04)), said(Some("slow"), 0.01, None)];
    let rows = vec![
        row("late", late, vec![quick, slow]),
        row("early", vec![], vec![both(Choice::Sample), both(Choice::Greedy)]),
    ];
    let (a, b) = (GOOD.map(evaluation), BAD.map(evaluation));
    let bootstrap = Bootstrap::new(1);
    let difference = Difference::over_seeds(("early", &a), ("late", &b), "success", &bootstrap);
    StudyResult {
        study: "timing".to_owned(),
        title: "Timing".to_owned(),
        lead: "Who | is late.".to_owned(),
        warnings: vec!["Quick: do not quote.".to_owned()],
        bootstrap,
        provenance: vec![
            ProvenanceDetail::new("command", "`leadtime compare timing`"),
            ProvenanceDetail::new("program", "leadtime 0.1.0, commit c0ffee"),
        ],
        parts: vec![PartResult {
            name: "piloting".to_owned(),
            title: "Piloting".to_owned(),
            profile: "`lander`".to_owned(),
            layout,
            columns: vec!["success".to_owned(), "followed_of_initiated".to_owned()],
            rows,
            differences: difference.into_iter().collect(),
            pictures: vec![FigureLink { file: "a.png".to_owned(), caption: "Curves.".to_owned() }],
        }],
    }
}

#[test]
fn a_page_of_lines_shows_the_paper_above_ours_before_and_after_json() {
    let json = serde_json::to_string(&result(Layout::Lines)).unwrap();
    let again: StudyResult = serde_json::from_str(&json).unwrap();
    assert_eq!(again.markdown(), result(Layout::Lines).markdown());
    insta::assert_snapshot!("a_page_of_lines_shows_the_paper_above_ours", again.markdown());
}

#[test]
fn a_grid_has_a_column_per_condition() {
    insta::assert_snapshot!(result(Layout::Grid).section("quick/"));
}

fn measure(by_seed: &[f64]) -> Measure {
    let interval = Some(Interval { estimate: 0.5, low: 0.25, high: 0.75 });
    let (name, by_seed) = ("success".to_owned(), by_seed.to_vec());
    Measure { name, n: 8, interval, standard_deviation: None, by_seed }
}

#[test]
fn a_cell_has_the_deviation_only_over_several_seeds() {
    assert_eq!(measured(Some(&measure(&[0.4, 0.6]))), "0.500 ± 0.141 [0.250, 0.750]");
    assert_eq!(measured(Some(&measure(&[0.5]))), "0.500 [0.250, 0.750]");
    assert_eq!(measured(Some(&Measure { interval: None, ..measure(&[]) })), NONE);
    assert_eq!(measured(None), NONE);
    let five = Some(measure(&[0.5, 0.5, 0.9, 0.5, 0.1]));
    assert!(with_quartiles(five.as_ref()).ends_with(" [0.250, 0.750], IQM 0.500"));
    let few = Some(measure(&[0.4, 0.6]));
    assert_eq!(with_quartiles(few.as_ref()), measured(few.as_ref()));
}
