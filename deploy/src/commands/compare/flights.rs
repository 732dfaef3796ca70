//! The figures of piloting alone: maps beside each other, and where every notifier's flights go.

use std::path::Path;

use anyhow::{Context as _, ensure};
use leadtime_eval::draw::Rasterizer;
use leadtime_eval::measure::{PlaySettings, Player};
use leadtime_eval::picture::{self, TrajectoryPanel};
use leadtime_eval::playthrough::Playthrough;

use super::configure::{self, Profile};
use super::judging::{Judge, UNAIDED};
use super::plan::PlannedPart;
use super::study::Part;
use super::write::Drawn;
use crate::commands::evaluation;
use leadtime_config::Config;
use leadtime_runs::Tasks;

/// The domain that has maps and flights.
const DOMAIN: &str = "lander";
/// Flights per notifier; more hide each other.
const N_FLIGHTS: u64 = 20;
/// Pixels per unit.
const SCALE: f32 = 1.5;

/// A map, ready to be drawn.
#[derive(Clone, Debug)]
pub(super) struct PlannedMap {
    title: String,
    config: Config,
}

/// Reads the maps that a part wants drawn, and checks that it is about flights if it wants any.
///
/// # Errors
///
/// One sentence: a configuration that cannot be read, or a domain in which nobody flies.
pub(super) fn plan(
    program: &Tasks,
    part: &Part,
    profile: &Profile,
) -> anyhow::Result<Vec<PlannedMap>> {
    let own = profile.config.domain.as_str();
    if part.trajectories_on.is_some() {
        check_domain(&profile.name, own).context("`trajectories_on`")?;
    }
    let plan = |map: &super::study::Map| {
        let config = configure::read(program, Path::new(&map.profile))?;
        check_domain(&map.profile, config.domain.as_str())?;
        Ok(PlannedMap { title: map.title.clone(), config })
    };
    part.maps.iter().map(plan).collect::<anyhow::Result<_>>().context("`maps`")
}

fn check_domain(profile: &str, domain: &str) -> anyhow::Result<()> {
    ensure!(
        domain == DOMAIN,
        "`{profile}` is a configuration of the domain `{domain}`, and only `{DOMAIN}` has flights to draw"
    );
    Ok(())
}

/// Draws the part's maps with the unaided flight of the same episode on each.
///
/// # Errors
///
/// A picture that cannot be made.
pub(super) fn maps(
    judge: &Judge<'_>,
    planned: &PlannedPart,
    stem: &str,
) -> anyhow::Result<Option<Drawn>> {
    if planned.maps.is_empty() {
        return Ok(None);
    }
    let seed = judge.first_seed(planned);
    let mut panels = Vec::new();
    for map in &planned.maps {
        let trajectories = fly(judge.program, &map.config, &Player::baseline(UNAIDED), seed, 1)?;
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

/// Draws the first flights of every row's first training seed, on the person that the study names.
///
/// # Errors
///
/// A policy that cannot be read, or a picture that cannot be made.
pub(super) fn trajectories(
    judge: &Judge<'_>,
    planned: &PlannedPart,
    stem: &str,
) -> anyhow::Result<Option<Drawn>> {
    let Some(person) = &planned.part.trajectories_on else { return Ok(None) };
    let (seed, n) = (judge.first_seed(planned), N_FLIGHTS.min(u64::from(judge.args.episodes)));
    let mut panels = Vec::new();
    for row in &planned.rows {
        let on = row.evaluations.iter().find(|evaluated| evaluated.names.contains(person));
        let (Some(on), Some(player)) = (on, judge.first_player(row)?) else { continue };
        let trajectories = fly(judge.program, &on.config, &player, seed, n)?;
        panels.push(TrajectoryPanel { title: row.row.title.clone(), trajectories });
    }
    if panels.is_empty() {
        return Ok(None);
    }
    let title = &planned.part.title;
    let heading = format!("{title}: the same {n} flights with each notifier");
    let svg = picture::trajectories("trajectories", &heading, &panels);
    let named = planned.part.evaluations.iter().find(|known| known.name == *person);
    let caption = format!(
        "{title}: where the lander flies with each notifier, in the same {n} episodes (the first ones of seed {seed}, not \
         chosen), on: {}. Trained notifiers are those of the first training seed, and sample their choices. Blue flights \
         land on the pad without having been in a danger zone (dashed), orange ones enter one, black dashed ones crash, land \
         beside the pad, or end out of view or of time; each ends at its dot. The ground differs between episodes and is drawn faintly",
        named.map_or("", |person| &person.title)
    );
    drawn(format!("{stem}-trajectories.png"), caption, &svg.text).map(Some)
}

/// Flies the first episodes of a seed.
fn fly(
    program: &Tasks,
    config: &Config,
    player: &Player,
    seed: u64,
    n: u64,
) -> anyhow::Result<Vec<Playthrough>> {
    let make = || program.registry.build(&config.evaluation.task);
    let settings = PlaySettings::new(n, seed).threads(evaluation::n_threads());
    Ok(Playthrough::record_all(&make, player, &settings)?)
}

fn drawn(file: String, caption: String, svg: &str) -> anyhow::Result<Drawn> {
    let png = Rasterizer::new().png(svg, SCALE)?;
    Ok(Drawn { file, caption, png })
}
