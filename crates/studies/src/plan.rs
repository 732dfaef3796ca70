//! What a study needs, as data: which trainings, under which names, and which policies are evaluated under which
//! conditions.

use std::path::{Path, PathBuf};

use leadtime_config::{Config, Layer, Override, identity};
use leadtime_episodes::known_players;
use leadtime_eval::measure::known_measures;
use leadtime_numerics::stats::Bootstrap;
use leadtime_proto::RunName;
use leadtime_runs::layout::{self, is_finished, read_config};
use leadtime_runs::{BEST_POLICY, LAST_POLICY, RunRecord, Tasks};
use toml::{Table, Value};

use crate::catalog::NamedStudy;
use crate::error::{Error, Placed as _, ensure};
use crate::profile::{self, Profile};
use crate::request::{StudyRequest, is_called};
use crate::script::PlannedSearch;
use crate::study::{StudyPart, StudyRow, WhichPolicy};

/// The longest name of a run.
const MAX_NAME: usize = 64;
/// Seed of every interval: what is uncertain is the data.
const BOOTSTRAP_SEED: u64 = 1;
/// The script that says nothing: what happens when nobody speaks.
pub(crate) const UNAIDED: &str = "unaided";

/// Returns how every interval is made.
pub(crate) fn bootstrap() -> Bootstrap {
    Bootstrap::new(BOOTSTRAP_SEED)
}

/// A study, ready to be carried out.
#[derive(Clone, Debug)]
pub(crate) struct StudyPlan {
    pub(crate) named: NamedStudy,
    /// Its parts, as far as they were asked for.
    pub(crate) parts: Vec<PlannedPart>,
}

/// A part, ready to be carried out.
#[derive(Clone, Debug)]
pub(crate) struct PlannedPart {
    pub(crate) part: StudyPart,
    pub(crate) profile: Profile,
    pub(crate) protocol: Protocol,
    /// Its rows, as far as they were asked for.
    pub(crate) rows: Vec<PlannedRow>,
    pub(crate) maps: Vec<PlannedMap>,
}

/// How every policy is evaluated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Protocol {
    pub(crate) policy: WhichPolicy,
    pub(crate) n_episodes: u32,
    /// Seed of the evaluations, to which the training seed is added.
    pub(crate) seed: u64,
    /// How far below the best of its row a training has failed.
    pub(crate) failed_below: f64,
}

/// A row, ready to be carried out.
#[derive(Clone, Debug)]
pub(crate) struct PlannedRow {
    pub(crate) row: StudyRow,
    /// Its training, without a seed; a script's task as well.
    pub(crate) config: Config,
    /// The seeds that it is trained and evaluated on; a script is only evaluated.
    pub(crate) seeds: Vec<u64>,
    /// One training per seed; none for a script.
    pub(crate) trainings: Vec<PlannedTraining>,
    /// How its script is searched; `None` for a script that comes with the task, and for a trained row.
    pub(crate) search: Option<PlannedSearch>,
    pub(crate) conditions: Vec<PlannedCondition>,
}

/// A run that must be finished before its policy can be evaluated.
#[derive(Clone, Debug)]
pub struct PlannedTraining {
    /// Its name: what it is for, what it computes, its seed.
    pub name: RunName,
    /// The configuration that it trains with.
    pub(crate) config: Config,
    /// First digits of the hash over what it computes.
    pub(crate) hash: String,
}

/// A condition under which a row is evaluated.
#[derive(Clone, Debug)]
pub(crate) struct PlannedCondition {
    /// The evaluations of the study that come to this.
    pub(crate) names: Vec<String>,
    pub(crate) titles: Vec<String>,
    pub(crate) config: Config,
}

/// A map, ready to be drawn.
#[derive(Clone, Debug)]
pub(crate) struct PlannedMap {
    pub(crate) title: String,
    pub(crate) config: Config,
}

impl StudyPlan {
    /// Plans a study: which trainings, scripts and evaluations its tables need.
    pub(crate) fn new(
        tasks: &Tasks,
        named: NamedStudy,
        request: &StudyRequest,
    ) -> Result<Self, Error> {
        let mut parts = Vec::new();
        for part in named.study.parts.iter().filter(|part| request.wants_part(part)) {
            let planned = PlannedPart::new(tasks, &named, part, request)
                .at(format_args!("study {}, part {}", named.name, part.name))?;
            // A part of which no row was asked for.
            if !planned.rows.is_empty() {
                parts.push(planned);
            }
        }
        Ok(Self { named, parts })
    }

    /// Lists the trainings, each once.
    pub(crate) fn trainings(&self) -> Vec<&PlannedTraining> {
        let mut all: Vec<&PlannedTraining> = Vec::new();
        let rows = self.parts.iter().flat_map(|part| &part.rows);
        for training in rows.flat_map(|row| &row.trainings) {
            if !all.iter().any(|known| known.is_same(training)) {
                all.push(training);
            }
        }
        all
    }
}

/// Lists the trainings of several studies, each once, and gives those that compute the same the same name.
pub(crate) fn share(plans: &mut [StudyPlan]) -> Vec<PlannedTraining> {
    let mut all: Vec<PlannedTraining> = Vec::new();
    let rows = plans.iter_mut().flat_map(|plan| &mut plan.parts).flat_map(|part| &mut part.rows);
    for training in rows.flat_map(|row| &mut row.trainings) {
        match all.iter().find(|known| known.is_same(training)) {
            Some(known) => *training = known.clone(),
            None => all.push(training.clone()),
        }
    }
    all
}

/// Checks that every requested row and part is somewhere.
pub(crate) fn check_choice(studies: &[NamedStudy], request: &StudyRequest) -> Result<(), Error> {
    let parts = || studies.iter().flat_map(|named| &named.study.parts);
    for wanted in &request.parts {
        let known: Vec<&str> = parts().map(|part| part.name.as_str()).collect();
        ensure(known.contains(&wanted.as_str()), || {
            format!("there is no part `{wanted}`; known: {}", known.join(", "))
        })?;
    }
    for wanted in &request.rows {
        let rows = || parts().flat_map(|part| part.rows.iter().map(move |row| (part, row)));
        ensure(rows().any(|(part, row)| is_called(part, row, wanted)), || {
            let known: Vec<String> =
                rows().map(|(part, row)| format!("{}/{}", part.name, row.name)).collect();
            format!("there is no row `{wanted}`; known: {}", known.join(", "))
        })?;
    }
    Ok(())
}

impl PlannedPart {
    fn new(
        tasks: &Tasks,
        named: &NamedStudy,
        part: &StudyPart,
        request: &StudyRequest,
    ) -> Result<Self, Error> {
        let profile = Profile::load(tasks, &named.name, part, request)?;
        let mut rows = Vec::new();
        for row in part.rows.iter().filter(|row| request.wants_row(part, row)) {
            let config = profile.training(tasks, part, row, request);
            let seeds = request.seeds(&named.study, part, row);
            let planned =
                config.and_then(|config| PlannedRow::new(tasks, named, part, row, config, seeds));
            rows.push(planned.at(format_args!("row {}", row.name))?);
        }
        check_measures(part, &rows)?;
        let protocol = Protocol {
            policy: named.study.policy,
            n_episodes: request.episodes,
            seed: request.eval_seed,
            failed_below: named.study.failed_below,
        };
        let maps = plan_maps(tasks, &named.name, part, &profile)?;
        Ok(Self { part: part.clone(), profile, protocol, rows, maps })
    }

    /// Returns the most training seeds that a row has; those of the others are the first of them.
    pub(crate) fn seeds(&self) -> &[u64] {
        let all = self.rows.iter().map(|row| row.seeds.as_slice());
        all.max_by_key(|seeds| seeds.len()).unwrap_or_default()
    }

    /// Returns the evaluation seed that belongs to the first training seed.
    pub(crate) fn first_seed(&self) -> u64 {
        self.protocol.seed + self.seeds().first().copied().unwrap_or(0)
    }

    pub(crate) fn row(&self, name: &str) -> Option<&PlannedRow> {
        self.rows.iter().find(|row| row.row.name == name)
    }

    /// Labels a row in a figure: by its title, or, where rows share it, by its name.
    pub(crate) fn label_of(&self, row: &PlannedRow) -> String {
        let title = &row.row.title;
        let n = self.part.rows.iter().filter(|other| other.title == *title).count();
        if n > 1 { row.row.name.replace('_', " ") } else { title.clone() }
    }
}

/// Checks that every measure that a part names is one of its task's.
fn check_measures(part: &StudyPart, rows: &[PlannedRow]) -> Result<(), Error> {
    let metrics = rows.first().map(|row| row.config.env.metrics.as_slice()).unwrap_or_default();
    let known = known_measures(metrics);
    let check = |measure: &str| {
        ensure(rows.is_empty() || known.iter().any(|name| name == measure), || {
            format!("there is no measure `{measure}`; known: {}", known.join(", "))
        })
    };
    part.columns.iter().try_for_each(|measure| check(measure)).at("`columns`")?;
    part.differences.iter().try_for_each(|stated| check(&stated.measure)).at("`differences`")?;
    for row in &part.rows {
        let mut published = row.published().into_iter();
        let checked = published.try_for_each(|published| check(&published.measure));
        checked.at(format_args!("row {}, `paper`", row.name))?;
    }
    Ok(())
}

/// Checks that a row's task has the scripted players that its evaluations need: the row's own, and the silent one, whom every
/// row is compared with.
fn check_players(tasks: &Tasks, script: Option<&str>, config: &Config) -> Result<(), Error> {
    let known = tasks.registry.build(&config.evaluation.task)?.baselines();
    let needed = script.map(|script| (script, "`script`"));
    let silent = (UNAIDED, "what a study compares every row with");
    for (player, place) in needed.into_iter().chain([silent]) {
        ensure(known.contains(&player), || {
            let domain = &config.domain;
            let known = known_players(known);
            format!(
                "there is no scripted player `{player}` ({place}) in the task `{domain}`; {known}"
            )
        })?;
    }
    Ok(())
}

/// Checks what an evaluation changes: settings of the task that have an effect there, and not how much a trained policy sees
/// and how many choices it has.
fn check_condition(
    tasks: &Tasks,
    row: &Config,
    is_trained: bool,
    set: &Table,
    evaluated: &Config,
) -> Result<(), Error> {
    for change in Override::of_table(set) {
        let change = change.given_by("set");
        change.check_of_task()?;
        evaluated.check_evaluated(&change, &tasks.registry)?;
    }
    if !is_trained {
        return Ok(());
    }
    let environment = tasks.registry.build(&evaluated.evaluation.task)?;
    let (policy, task) = (&row.policy, environment.spec());
    let made_for = [policy.obs_dim, policy.actions.n_choices()];
    let needed = [task.obs_dim, task.actions.n_choices()];
    ensure(made_for == needed, || {
        format!(
            "it changes what a policy sees or chooses: the row's observes {} numbers and has {} choices, and this task has {} \
             and {}; change that in the `set` of the row as well",
            made_for[0], made_for[1], needed[0], needed[1]
        )
    })
}

/// Reads the maps that a part wants drawn, and checks that its domain has some if it wants any.
fn plan_maps(
    tasks: &Tasks,
    study: &str,
    part: &StudyPart,
    own: &Profile,
) -> Result<Vec<PlannedMap>, Error> {
    let check = |profile: &str, domain: &str| {
        ensure(tasks.registry.has_map(domain), || {
            format!(
                "`{profile}` is a configuration of the domain `{domain}`, which has no map to draw trajectories on"
            )
        })
    };
    if part.trajectories_on.is_some() {
        check(&own.name, own.config.domain.as_str()).at("`trajectories_on`")?;
    }
    let mut maps = Vec::new();
    for map in &part.maps {
        let config = profile::of_study(tasks, study, &map.profile).at("`maps`")?;
        check(&map.profile, config.domain.as_str()).at("`maps`")?;
        maps.push(PlannedMap { title: map.title.clone(), config });
    }
    Ok(maps)
}

impl PlannedRow {
    fn new(
        tasks: &Tasks,
        named: &NamedStudy,
        part: &StudyPart,
        row: &StudyRow,
        config: Config,
        seeds: Vec<u64>,
    ) -> Result<Self, Error> {
        let first = seeds.first().copied().unwrap_or(part.first_seed);
        let script = row.script.as_deref();
        let search = script.and_then(|script| PlannedSearch::new(script, &config, first));
        let is_made = script.is_none() || search.as_ref().is_some_and(PlannedSearch::is_searched);
        let mut conditions: Vec<PlannedCondition> = Vec::new();
        let wanted = part.evaluations.iter().filter(|known| row.is_evaluated_on(&known.name));
        for condition in wanted {
            // A script of the task was not made for any listener, so there is nothing to evaluate it as.
            if !is_made && condition.set.is_empty() {
                continue;
            }
            let place = format!("evaluation {}", condition.name);
            let evaluated = config.with([Layer::table("`set`", &condition.set)], &tasks.registry);
            let evaluated = evaluated.at(&place)?;
            check_condition(tasks, &config, script.is_none(), &condition.set, &evaluated)
                .at(place)?;
            let config = evaluated;
            let same = |known: &PlannedCondition| known.config.evaluation == config.evaluation;
            let place = conditions.iter().position(same).unwrap_or(conditions.len());
            if place == conditions.len() {
                conditions.push(PlannedCondition { names: vec![], titles: vec![], config });
            }
            conditions[place].names.push(condition.name.clone());
            conditions[place].titles.push(condition.title.clone());
        }
        check_players(tasks, script.filter(|_| search.is_none()), &config)?;
        let policy = named.study.policy;
        let stem = format!("{}-{}-{}", named.name, part.name, row.name).replace('_', "-");
        let train = |&seed| PlannedTraining::new(tasks, &stem, &config, policy, seed);
        let trained = seeds.iter().filter(|_| row.script.is_none());
        let trainings = trained.map(train).collect::<Result<_, Error>>()?;
        Ok(Self { row: row.clone(), config, seeds, trainings, search, conditions })
    }

    /// Returns the condition that a study calls so.
    pub(crate) fn condition(&self, name: &str) -> Option<&PlannedCondition> {
        self.conditions.iter().find(|condition| condition.names.iter().any(|known| known == name))
    }

    /// Names the type of the row's notifications.
    pub(crate) fn notification(&self) -> String {
        if self.row.script.is_some() {
            return "scripted".to_owned();
        }
        let kind =
            self.config.table.get("notifier").and_then(|section| section.get("notification"));
        let kind = kind.and_then(Value::as_str);
        kind.unwrap_or_default().replace('_', " ")
    }
}

/// Labels two rows in a sentence: by their titles, and by the type of their notifications where the titles are equal.
pub(crate) fn disambiguate(rows: [&PlannedRow; 2]) -> [String; 2] {
    let titles = rows.map(|row| inside_a_sentence(&row.row.title));
    if titles[0] != titles[1] {
        return titles;
    }
    rows.map(|row| format!("{} ({})", titles[0], row.notification()))
}

/// Writes a title's first letter small, unless it is a symbol such as R or the N of N(2, 1).
fn inside_a_sentence(title: &str) -> String {
    let mut letters = title.chars();
    match (letters.next(), letters.clone().next()) {
        (Some(first), Some(second)) if second.is_lowercase() => {
            first.to_lowercase().chain(letters).collect()
        }
        _ => title.to_owned(),
    }
}

impl PlannedTraining {
    fn new(
        tasks: &Tasks,
        stem: &str,
        config: &Config,
        policy: WhichPolicy,
        seed: u64,
    ) -> Result<Self, Error> {
        let hash = profile::hash(&config.table, policy);
        let suffix = format!("-{hash}-s{seed}");
        let wanted = WantedRun { hash: &hash, policy, seed };
        let found = wanted.existing(&config.run.directory, &suffix);
        let name = found.clone().unwrap_or_else(|| {
            let room = MAX_NAME - suffix.len();
            let stem: String = stem.chars().take(room).collect();
            format!("{}{suffix}", stem.trim_end_matches('-'))
        });
        let text = format!("seed = {seed}\nrun.name = \"{name}\"\n");
        let config = config.with([Layer::text("--seeds", text)], &tasks.registry)?;
        let name = RunName::new(name).map_err(|error| Error::Refused(error.to_string()))?;
        if found.is_none() {
            wanted.check_free(&config.run.directory.join(name.as_str()), &config.table)?;
        }
        Ok(Self { name, config, hash })
    }

    pub(crate) fn directory(&self) -> PathBuf {
        self.config.run.directory.join(self.name.as_str())
    }

    /// Returns the file for the log of its processes.
    pub(crate) fn log(&self) -> PathBuf {
        self.config.run.directory.join(format!("{}.log", self.name))
    }

    /// Returns the file of the policy that is evaluated.
    pub(crate) fn policy(&self, which: WhichPolicy) -> PathBuf {
        let directory = self.directory();
        let best = directory.join(BEST_POLICY);
        // A run of an earlier release in which no hundred episodes ended knows no best one.
        if which == WhichPolicy::Best && best.exists() { best } else { directory.join(LAST_POLICY) }
    }

    /// Returns whether the run has reached its end.
    pub fn is_finished(&self) -> bool {
        is_finished(&self.directory())
    }

    /// Returns the environment steps that it was trained on so far, and in all.
    pub fn steps(&self) -> [u64; 2] {
        let (n_updates, each) = (self.config.learner.n_updates(), self.config.steps_per_update());
        let made = || layout::n_updates(&self.directory());
        let done = if self.is_finished() { n_updates } else { made() };
        [done.min(n_updates) * each, n_updates * each]
    }

    fn is_same(&self, other: &Self) -> bool {
        self.hash == other.hash && self.config.seed == other.config.seed
    }
}

/// What a run must have been trained with to be taken for a training. Its name says so only as long as nobody lets it go on with
/// other settings.
struct WantedRun<'a> {
    hash: &'a str,
    policy: WhichPolicy,
    seed: u64,
}

impl WantedRun<'_> {
    /// Returns whether a run with this configuration is such a one.
    fn is(&self, config: &Table) -> bool {
        let seed = config.get("seed").and_then(Value::as_integer);
        seed.is_some_and(|seed| u64::try_from(seed) == Ok(self.seed))
            && profile::hash(config, self.policy) == self.hash
    }

    /// Finds a run that computes the same, whatever study it was made for; of several a finished one, the first by name.
    fn existing(&self, runs: &Path, suffix: &str) -> Option<String> {
        let entries = std::fs::read_dir(runs).ok()?.filter_map(Result::ok);
        let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
        let is_wanted = |name: &String| {
            let run = runs.join(name);
            name.ends_with(suffix)
                && RunRecord::detour(&run).is_ok_and(|detour| detour.is_none())
                && read_config(&run).is_ok_and(|config| self.is(&config))
        };
        names.filter(is_wanted).min_by_key(|name| (!is_finished(&runs.join(name)), name.clone()))
    }

    /// Refuses the place of a new run if one lies there that was trained with something else.
    fn check_free(&self, run: &Path, config: &Table) -> Result<(), Error> {
        let shown = run.display();
        let helps = "move it away, or take other --runs";
        if let Ok(Some(detour)) = RunRecord::detour(run) {
            return Err(Error::Refused(format!(
                "{shown} {detour}, which its name does not say; {helps}"
            )));
        }
        let found = match read_config(run) {
            Ok(found) => found,
            // It counts as done, and nobody knows what it was trained with.
            Err(error) if is_finished(run) => {
                return Err(Error::Refused(format!("{error}; or {helps}")));
            }
            Err(_) => return Ok(()),
        };
        let mut changes = identity::difference(config, &found);
        changes.retain(|it| profile::decides(&it.key, &found, self.policy));
        let changes: Vec<String> = changes.iter().map(ToString::to_string).collect();
        ensure(changes.is_empty(), || {
            format!(
                "{shown} was trained with another configuration than its name says: {}; {helps}",
                changes.join("; ")
            )
        })
    }
}

#[cfg(test)]
#[path = "plan_tests.rs"]
mod tests;
