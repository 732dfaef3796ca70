//! The figures of a part: learning curves over training seeds, curves over conditions, playthroughs of the same episode;
//! for a domain with maps, the maps next to each other, and the trajectories with every notifier.

use std::collections::BTreeMap;

use leadtime_config::Config;
use leadtime_eval::draw::{Ink, Rasterizer, Svg};
use leadtime_eval::figure::{Band, BandPanel, bands, sheet};
use leadtime_eval::measure::{Choice, PlaySettings, Player, title};
use leadtime_eval::picture::{self, TrajectoryPanel};
use leadtime_eval::playthrough::{Playthrough, Spoken, Voice};
use leadtime_numerics::stats::mean;
use leadtime_runs::{Tasks, journal};

use crate::candidate::EvalCandidate;
use crate::error::Error;
use crate::plan::{PlannedCondition, PlannedPart, PlannedRow, PlannedTraining, UNAIDED};
use crate::result::{PartResult, StudyFigure};
use crate::study::{Layout, StudyCondition, StudyPart};

/// Pixels per unit of a figure.
const SCALE: f32 = 1.5;
/// Pixels per unit of a sheet of playthroughs, which are large.
const SHEET_SCALE: f32 = 1.0;
/// Playthroughs side by side.
const COLUMNS: usize = 2;
/// Points of a learning curve.
const POINTS: usize = 60;
/// Trajectories per notifier; more hide each other.
const N_TRAJECTORIES: u64 = 20;

/// Draws a part's figures; `stem` begins their files' names.
pub(crate) fn draw(
    tasks: &Tasks,
    planned: &PlannedPart,
    part: &PartResult,
    stem: &str,
) -> Result<Vec<StudyFigure>, Error> {
    let artist = Artist { tasks, planned, title: &planned.part.title, stem };
    let figures = [
        artist.maps()?,
        artist.learning()?,
        artist.over_conditions(part)?,
        artist.trajectories()?,
        artist.playthroughs()?,
    ];
    Ok(figures.into_iter().flatten().collect())
}

/// Draws the figures of one part; a figure for which there is nothing to draw is `None`.
struct Artist<'a> {
    tasks: &'a Tasks,
    planned: &'a PlannedPart,
    title: &'a str,
    stem: &'a str,
}

impl Artist<'_> {
    fn figure(
        &self,
        kind: &str,
        caption: String,
        svg: &Svg,
        scale: f32,
    ) -> Result<Option<StudyFigure>, Error> {
        let png = Rasterizer::new().png(&svg.text, scale)?;
        Ok(Some(StudyFigure { file: format!("{}-{kind}.png", self.stem), caption, png }))
    }

    /// Draws training success and return of every trained row; where rows are more than inks, success alone, some of them at a time.
    fn learning(&self) -> Result<Option<StudyFigure>, Error> {
        let trained: Vec<&PlannedRow> =
            self.planned.rows.iter().filter(|row| !row.trainings.is_empty()).collect();
        let n_seeds = || trained.iter().map(|row| row.trainings.len());
        let (Some(fewest), Some(most)) = (n_seeds().min(), n_seeds().max()) else {
            return Ok(None);
        };
        let panel = |metric: &str, label: &str, range, rows: &[&PlannedRow]| {
            let band = |row: &&PlannedRow| learning_band(row, metric, self.planned.label_of(row));
            BandPanel { label: label.to_owned(), range, bands: rows.iter().map(band).collect() }
        };
        let success = |rows: &Vec<&PlannedRow>| {
            panel("episodes/success", "success in training", Some([0.0, 1.0]), rows)
        };
        let groups = groups(&trained);
        let mut panels: Vec<BandPanel> = groups.iter().map(success).collect();
        let is_one = groups.len() == 1;
        panels
            .extend(is_one.then(|| panel("episodes/return", "return in training", None, &trained)));
        let heading = format!("{}: learning", self.title);
        let svg = bands("learning", &heading, "environment steps", 7, &panels);
        let seeds = if fewest == most { most.to_string() } else { format!("{fewest} to {most}") };
        let spread = match most {
            1 => "one training seed".to_owned(),
            _ => format!("mean of {seeds} training seeds, band from the lowest to the highest"),
        };
        let what = if is_one { "success and return" } else { "success" };
        let caption = format!(
            "{}: {what} of the last 100 training episodes, each notifier on the listener it trains with; {spread}",
            self.title
        );
        self.figure("learning", caption, &svg, SCALE)
    }

    /// Draws every measure of a grid over the conditions under which policies were evaluated.
    fn over_conditions(&self, part: &PartResult) -> Result<Option<StudyFigure>, Error> {
        if part.layout != Layout::Grid {
            return Ok(None);
        }
        let placed = |condition: &StudyCondition| Some((condition.at?, condition.name.clone()));
        let StudyPart { evaluations, axis, axis_name, .. } = &self.planned.part;
        let mut conditions: Vec<(f64, String)> = evaluations.iter().filter_map(placed).collect();
        conditions.sort_by(|a, b| a.0.total_cmp(&b.0));
        let panels = part.columns.iter().map(|measure| {
            let lines = part.rows.chunk_by(|a, b| a.title == b.title).map(|rows| {
                let mut band = Band { label: rows[0].title.clone(), ..Band::default() };
                for &(x, ref condition) in &conditions {
                    let result = rows.iter().find_map(|row| row.result(condition, Choice::Sample));
                    let measured = result.and_then(|result| result.summary.get(measure)?.interval);
                    band.points.extend(measured.map(|i| [x, i.estimate, i.low, i.high]));
                    let published = rows.iter().find_map(|r| r.published(Some(condition), measure));
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
        let heading = format!("{}: ours (solid, with interval){also}", self.title);
        let svg = bands(axis_name, &heading, axis, conditions.len().max(2), &panels);
        let caption = format!("{}: ours as solid lines with 95 % intervals{dashed}", self.title);
        self.figure(axis_name, caption, &svg, SCALE)
    }

    /// Lists every row's condition of a name, with the player of its first training seed, which bears the row's title.
    fn players(&self, condition: &str) -> Result<Vec<(&PlannedCondition, Player)>, Error> {
        let mut players = Vec::new();
        for row in &self.planned.rows {
            let which = self.planned.protocol.policy;
            let mut first = EvalCandidate::of(self.tasks, row, which, Choice::Sample, 1)?;
            if let (Some(on), Some(first)) = (row.condition(condition), first.pop()) {
                players.push((on, first.player));
            }
        }
        Ok(players)
    }

    fn titled(&self, condition: &str) -> &str {
        self.planned.part.condition(condition).map_or("", |condition| &condition.title)
    }

    /// Draws the first evaluation episode of the first training seed for every row, under the condition that the study
    /// names.
    fn playthroughs(&self) -> Result<Option<StudyFigure>, Error> {
        let Some(condition) = &self.planned.part.pictured_on else { return Ok(None) };
        let seed = self.planned.first_seed();
        let mut episodes = Vec::new();
        for (on, player) in self.players(condition)? {
            let task = &on.config.evaluation.task;
            let make = || self.tasks.registry.build(task);
            let played = Playthrough::record(&make, &player, seed, 0)?;
            let voice = Voice::shipped(on.config.domain.as_str(), &self.tasks.topics(task));
            episodes.push(match voice {
                Some(voice) => voice.speak(played)?,
                None => played.into(),
            });
        }
        let Some(n_steps) = episodes.iter().map(|spoken| spoken.played.n_steps()).max() else {
            return Ok(None);
        };
        let draw =
            |(i, spoken): (usize, &Spoken)| spoken.svg_over(&format!("{}-{i}", self.stem), n_steps);
        let pictures: Vec<Svg> = episodes.iter().enumerate().map(draw).collect();
        let caption = format!(
            "{}: the same episode (the first one of seed {seed}, not chosen) with each notifier, on: {}",
            self.title,
            self.titled(condition)
        );
        let sheet = sheet(&caption, &pictures, COLUMNS);
        self.figure("playthroughs", caption, &sheet, SHEET_SCALE)
    }

    /// Draws the part's maps with the unaided trajectory of the same episode on each.
    fn maps(&self) -> Result<Option<StudyFigure>, Error> {
        if self.planned.maps.is_empty() {
            return Ok(None);
        }
        let (title, seed) = (self.title, self.planned.first_seed());
        let panels = self.planned.maps.iter().map(|map| {
            let trajectories = self.first(&map.config, &Player::baseline(UNAIDED), 1)?;
            Ok(TrajectoryPanel { title: map.title.clone(), trajectories })
        });
        let panels = panels.collect::<Result<Vec<_>, Error>>()?;
        let svg = picture::maps("maps", &format!("{title}: the maps"), &panels);
        let caption = format!(
            "{title}: the maps on one scale. Danger zones are dashed, the pad is green. The line is where the lander flies \
             when nobody speaks (the same episode on every map: the first one of seed {seed}, not chosen), thick and \
             orange inside a zone"
        );
        self.figure("maps", caption, &svg, SCALE)
    }

    /// Draws the first trajectories of every row's first training seed, under the condition that the study names.
    fn trajectories(&self) -> Result<Option<StudyFigure>, Error> {
        let Some(condition) = &self.planned.part.trajectories_on else { return Ok(None) };
        let n = N_TRAJECTORIES.min(u64::from(self.planned.protocol.n_episodes));
        let panels = self.players(condition)?.into_iter().map(|(on, player)| {
            let trajectories = self.first(&on.config, &player, n)?;
            Ok(TrajectoryPanel { title: player.name().to_owned(), trajectories })
        });
        let panels = panels.collect::<Result<Vec<_>, Error>>()?;
        if panels.is_empty() {
            return Ok(None);
        }
        let (title, seed, on) = (self.title, self.planned.first_seed(), self.titled(condition));
        let heading = format!("{title}: the same {n} flights with each notifier");
        let svg = picture::trajectories("trajectories", &heading, &panels);
        let caption = format!(
            "{title}: where the lander flies with each notifier, in the same {n} episodes (the first ones of seed {seed}, \
             not chosen), on: {on}. Trained notifiers are those of the first training seed, and sample their choices. Blue \
             flights land on the pad without having been in a danger zone (dashed), orange ones enter one, black dashed \
             ones crash, land beside the pad, or end out of view or of time; each ends at its dot. The ground differs \
             between episodes and is drawn faintly"
        );
        self.figure("trajectories", caption, &svg, SCALE)
    }

    /// Plays the first `n` episodes of the first seed.
    fn first(&self, config: &Config, player: &Player, n: u64) -> Result<Vec<Playthrough>, Error> {
        let make = || self.tasks.registry.build(&config.evaluation.task);
        let settings = PlaySettings::new(n, self.planned.first_seed());
        Ok(Playthrough::record_all(&make, player, &settings)?)
    }
}

/// Shares out rows among panels, so that in each every row has an ink of its own: all in one, or by title, or as many as there
/// are inks.
fn groups<'a>(rows: &[&'a PlannedRow]) -> Vec<Vec<&'a PlannedRow>> {
    let n_inks = Ink::SERIES.len();
    if rows.len() <= n_inks {
        return vec![rows.to_vec()];
    }
    let by_title = || rows.chunk_by(|a, b| a.row.title == b.row.title);
    if by_title().any(|rows| rows.len() > 1) {
        return by_title().flat_map(|rows| rows.chunks(n_inks)).map(<[_]>::to_vec).collect();
    }
    rows.chunks(n_inks).map(<[_]>::to_vec).collect()
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
    let point = |line: &serde_json::Map<String, serde_json::Value>| {
        Some((line.get("steps")?.as_u64()?, line.get(metric)?.as_f64()?))
    };
    lines.iter().filter_map(point).collect()
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::test_support::{STUDY, plan, request};

    /// Returns how many rows share a panel, of a study with further rows of these titles.
    fn group_sizes(titles: &[&str]) -> Vec<usize> {
        let row = |(i, title): (usize, &&str)| {
            format!(
                "[[parts.rows]]\nname = \"r{i}\"\ntitle = \"{title}\"\nset.learner.n_epochs = {}\n",
                i + 5
            )
        };
        let rows: String = titles.iter().enumerate().map(row).collect();
        let plan = plan(&format!("{STUDY}{rows}"), &request(Path::new("nowhere"))).unwrap();
        let rows = plan.parts[0].rows.iter().filter(|row| !row.trainings.is_empty());
        groups(&rows.collect::<Vec<_>>()).iter().map(Vec::len).collect()
    }

    #[test]
    fn no_two_learning_curves_of_a_panel_have_the_same_ink() {
        // The study has two trained rows of its own.
        assert_eq!(group_sizes(&["a"; 6]), [8]);
        assert_eq!(group_sizes(&["a", "b", "c", "d", "e", "f", "g"]), [8, 1]);
        assert_eq!(group_sizes(&["a", "a", "a", "a", "b", "b", "b"]), [1, 1, 4, 3]);
        assert_eq!(group_sizes(&["a"; 9]), [1, 1, 8, 1]);
    }
}
