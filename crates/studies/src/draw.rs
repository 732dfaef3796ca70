//! The figures of a part: learning curves over training seeds, curves over conditions, playthroughs of the same episode;
//! maps and trajectories are drawn by [`trajectories`].

use std::collections::BTreeMap;

use leadtime_eval::draw::{Rasterizer, Svg};
use leadtime_eval::figure::{Band, BandPanel, bands, sheet};
use leadtime_eval::measure::{Choice, title};
use leadtime_eval::playthrough::{Playthrough, Spoken, Voice};
use leadtime_numerics::stats::mean;
use leadtime_runs::{Tasks, journal};

use crate::candidate::EvalCandidate;
use crate::error::Error;
use crate::plan::{PlannedPart, PlannedRow, PlannedTraining};
use crate::result::{PartResult, StudyFigure};
use crate::study::{Layout, StudyCondition};
use crate::trajectories;

/// Pixels per unit.
const SCALE: f32 = 1.5;
/// Pixels per unit of a sheet of playthroughs, which are large.
const SHEET_SCALE: f32 = 1.0;
/// Playthroughs side by side.
const COLUMNS: usize = 2;
/// Points of a learning curve.
const POINTS: usize = 60;

/// Draws a part's figures; `stem` begins their files' names.
pub(crate) fn draw(
    tasks: &Tasks,
    planned: &PlannedPart,
    part: &PartResult,
    stem: &str,
) -> Result<Vec<StudyFigure>, Error> {
    let mut drawn = Vec::new();
    drawn.extend(trajectories::maps(tasks, planned, stem)?);
    drawn.extend(learning(planned, stem)?);
    if part.layout == Layout::Grid {
        drawn.push(over_conditions(planned, part, stem)?);
    }
    drawn.extend(trajectories::trajectories(tasks, planned, stem)?);
    drawn.extend(playthroughs(tasks, planned, stem)?);
    Ok(drawn)
}

/// Draws training success and return of every trained row.
fn learning(planned: &PlannedPart, stem: &str) -> Result<Option<StudyFigure>, Error> {
    let trained: Vec<&PlannedRow> =
        planned.rows.iter().filter(|row| !row.trainings.is_empty()).collect();
    if trained.is_empty() {
        return Ok(None);
    }
    let panel = |metric: &str, label: &str, range| BandPanel {
        label: label.to_owned(),
        range,
        bands: trained
            .iter()
            .map(|row| learning_band(row, metric, planned.label_of(row)))
            .collect(),
    };
    let panels = [
        panel("episodes/success", "success in training", Some([0.0, 1.0])),
        panel("episodes/return", "return in training", None),
    ];
    let heading = format!("{}: learning", planned.part.title);
    let svg = bands("learning", &heading, "environment steps", 7, &panels).text;
    let n_seeds = trained.iter().map(|row| row.trainings.len()).max().unwrap_or(0);
    let spread = match n_seeds {
        1 => "one training seed".to_owned(),
        n => format!("mean of {n} training seeds, band from the lowest to the highest"),
    };
    let caption = format!(
        "{}: success and return of the last 100 training episodes, each notifier on the person it trains with; {spread}",
        planned.part.title
    );
    let png = Rasterizer::new().png(&svg, SCALE)?;
    Ok(Some(StudyFigure { file: format!("{stem}-learning.png"), caption, png }))
}

fn learning_band(row: &PlannedRow, metric: &str, label: String) -> Band {
    let mut by_step: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
    for training in &row.trainings {
        for (steps, value) in thinned(&curve(training, metric)) {
            by_step.entry(steps).or_default().push(value);
        }
    }
    // Only where every seed has a value: a mean over other seeds is another mean.
    let whole = by_step.into_iter().filter(|(_, values)| values.len() == row.trainings.len());
    let points = whole.map(|(steps, values)| {
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        [steps as f64, mean(&values), low, high]
    });
    Band { label, points: points.collect(), published: Vec::new() }
}

fn curve(training: &PlannedTraining, metric: &str) -> Vec<(u64, f64)> {
    let lines = journal::read(&training.directory()).unwrap_or_default();
    lines
        .iter()
        .filter_map(|l| Some((l.get("steps")?.as_u64()?, l.get(metric)?.as_f64()?)))
        .collect()
}

/// Keeps some `POINTS` points; which ones depends only on the number of updates, so seeds agree.
fn thinned(points: &[(u64, f64)]) -> Vec<(u64, f64)> {
    let n_updates = points.last().map_or(0, |last| last.0);
    let every = (n_updates / POINTS as u64).max(1);
    let mut kept: Vec<(u64, f64)> = Vec::new();
    for &(steps, value) in points {
        if kept.last().is_none_or(|last| steps / every > last.0 / every) {
            kept.push((steps, value));
        }
    }
    kept
}

/// Draws every measure of the main table over the conditions under which policies were evaluated.
fn over_conditions(
    planned: &PlannedPart,
    part: &PartResult,
    stem: &str,
) -> Result<StudyFigure, Error> {
    let placed = |condition: &StudyCondition| Some((condition.at?, condition.name.clone()));
    let mut conditions: Vec<(f64, String)> =
        planned.part.evaluations.iter().filter_map(placed).collect();
    conditions.sort_by(|a, b| a.0.total_cmp(&b.0));
    let panels = part.columns.iter().map(|measure| {
        let lines = part.rows.chunk_by(|a, b| a.title == b.title).map(|rows| {
            let mut band = Band { label: rows[0].title.clone(), ..Band::default() };
            for &(x, ref condition) in &conditions {
                let result = rows.iter().find_map(|row| row.result(condition, Choice::Sample));
                let measured = result.and_then(|result| result.summary.get(measure)?.interval);
                band.points.extend(measured.map(|i| [x, i.estimate, i.low, i.high]));
                let published = rows.iter().find_map(|row| row.published(Some(condition), measure));
                band.published.extend(published.map(|published| [x, published.mean]));
            }
            band
        });
        let range = (measure == "success").then_some([0.0, 1.0]);
        BandPanel { label: title(measure), range, bands: lines.collect() }
    });
    let panels: Vec<BandPanel> = panels.collect();
    let mut bands_drawn = panels.iter().flat_map(|panel| &panel.bands);
    let is_published = bands_drawn.any(|band| !band.published.is_empty());
    let [also, dashed] =
        if is_published { [", the paper's (dashed)", ", the paper's dashed"] } else { [""; 2] };
    let heading = format!("{}: ours (solid, with interval){also}", part.title);
    let (axis, n_ticks) = (&planned.part.axis, conditions.len().max(2));
    let svg = bands("people", &heading, axis, n_ticks, &panels).text;
    let png = Rasterizer::new().png(&svg, SCALE)?;
    let caption = format!("{}: ours as solid lines with 95 % intervals{dashed}", part.title);
    Ok(StudyFigure { file: format!("{stem}-people.png"), caption, png })
}

/// Draws the first evaluation episode of the first training seed for every row, under the condition that the study
/// names.
fn playthroughs(
    tasks: &Tasks,
    planned: &PlannedPart,
    stem: &str,
) -> Result<Option<StudyFigure>, Error> {
    let Some(condition) = &planned.part.pictured_on else { return Ok(None) };
    let seed = planned.first_seed();
    let mut episodes = Vec::new();
    for row in &planned.rows {
        let player = EvalCandidate::first_player(tasks, row, planned.protocol.policy)?;
        let (Some(on), Some(player)) = (row.condition(condition), player) else { continue };
        let task = &on.config.evaluation.task;
        let make = || tasks.registry.build(task);
        let played = Playthrough::record(&make, &player, seed, 0)?;
        let voice = Voice::shipped(on.config.domain.as_str(), &tasks.topics(task));
        episodes.push(match voice {
            Some(voice) => voice.speak(played)?,
            None => played.into(),
        });
    }
    let Some(n_steps) = episodes.iter().map(|spoken| spoken.played.n_steps()).max() else {
        return Ok(None);
    };
    let draw = |(i, spoken): (usize, &Spoken)| spoken.svg_over(&format!("{stem}-{i}"), n_steps);
    let pictures: Vec<Svg> = episodes.iter().enumerate().map(draw).collect();
    let caption = format!(
        "{}: the same episode (the first one of seed {seed}, not chosen) with each notifier, on: {}",
        planned.part.title,
        planned.part.condition(condition).map_or("", |condition| &condition.title)
    );
    let png = Rasterizer::new().png(&sheet(&caption, &pictures, COLUMNS).text, SHEET_SCALE)?;
    Ok(Some(StudyFigure { file: format!("{stem}-playthroughs.png"), caption, png }))
}
