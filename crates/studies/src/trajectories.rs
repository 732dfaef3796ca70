//! Figures of a domain with maps: maps beside each other, and the trajectories with every notifier.

use leadtime_config::Config;
use leadtime_eval::draw::Rasterizer;
use leadtime_eval::measure::{PlaySettings, Player};
use leadtime_eval::picture::{self, TrajectoryPanel};
use leadtime_eval::playthrough::Playthrough;
use leadtime_runs::Tasks;

use crate::candidate::EvalCandidate;
use crate::error::Error;
use crate::plan::{PlannedPart, UNAIDED};
use crate::result::StudyFigure;

/// Trajectories per notifier; more hide each other.
const N_TRAJECTORIES: u64 = 20;
/// Pixels per unit.
const SCALE: f32 = 1.5;

/// Draws the part's maps with the unaided trajectory of the same episode on each.
pub(crate) fn maps(
    tasks: &Tasks,
    planned: &PlannedPart,
    stem: &str,
) -> Result<Option<StudyFigure>, Error> {
    if planned.maps.is_empty() {
        return Ok(None);
    }
    let seed = planned.first_seed();
    let mut panels = Vec::new();
    for map in &planned.maps {
        let trajectories = first(tasks, &map.config, &Player::baseline(UNAIDED), seed, 1)?;
        panels.push(TrajectoryPanel { title: map.title.clone(), trajectories });
    }
    let title = &planned.part.title;
    let svg = picture::maps("maps", &format!("{title}: the maps"), &panels);
    let caption = format!(
        "{title}: the maps on one scale. Danger zones are dashed, the pad is green. The line is where the lander flies when \
         nobody speaks (the same episode on every map: the first one of seed {seed}, not chosen), thick and orange inside a zone"
    );
    drawn(format!("{stem}-maps.png"), caption, &svg.text).map(Some)
}

/// Draws the first trajectories of every row's first training seed, under the condition that the study names.
pub(crate) fn trajectories(
    tasks: &Tasks,
    planned: &PlannedPart,
    stem: &str,
) -> Result<Option<StudyFigure>, Error> {
    let Some(condition) = &planned.part.trajectories_on else { return Ok(None) };
    let (seed, n) =
        (planned.first_seed(), N_TRAJECTORIES.min(u64::from(planned.protocol.n_episodes)));
    let mut panels = Vec::new();
    for row in &planned.rows {
        let player = EvalCandidate::first_player(tasks, row, planned.protocol.policy)?;
        let (Some(on), Some(player)) = (row.condition(condition), player) else { continue };
        let trajectories = first(tasks, &on.config, &player, seed, n)?;
        panels.push(TrajectoryPanel { title: row.row.title.clone(), trajectories });
    }
    if panels.is_empty() {
        return Ok(None);
    }
    let title = &planned.part.title;
    let heading = format!("{title}: the same {n} flights with each notifier");
    let svg = picture::trajectories("trajectories", &heading, &panels);
    let on = planned.part.condition(condition).map_or("", |condition| &condition.title);
    let caption = format!(
        "{title}: where the lander flies with each notifier, in the same {n} episodes (the first ones of seed {seed}, not \
         chosen), on: {on}. Trained notifiers are those of the first training seed, and sample their choices. Blue flights \
         land on the pad without having been in a danger zone (dashed), orange ones enter one, black dashed ones crash, land \
         beside the pad, or end out of view or of time; each ends at its dot. The ground differs between episodes and is drawn faintly"
    );
    drawn(format!("{stem}-trajectories.png"), caption, &svg.text).map(Some)
}

/// Plays the first episodes of a seed.
fn first(
    tasks: &Tasks,
    config: &Config,
    player: &Player,
    seed: u64,
    n: u64,
) -> Result<Vec<Playthrough>, Error> {
    let make = || tasks.registry.build(&config.evaluation.task);
    Ok(Playthrough::record_all(&make, player, &PlaySettings::new(n, seed))?)
}

fn drawn(file: String, caption: String, svg: &str) -> Result<StudyFigure, Error> {
    let png = Rasterizer::new().png(svg, SCALE)?;
    Ok(StudyFigure { file, caption, png })
}
