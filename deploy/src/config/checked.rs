//! The second stage of a configuration: it cannot be wrong any more.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use leadtime_learner::{CheckpointInterval, LearnerSettings};
use leadtime_proto::limits::MAX_WINDOW;
use leadtime_proto::{ActionSpec, DomainName, Encoder, EnvSpec, PolicySpec, RunName, TaskSpec};
use leadtime_sims::Environment;
use leadtime_sims::notifier::LENGTH_HEADS;
use leadtime_sims::registry::Registry;
use toml::Table;

use super::catalog::Catalog;
use super::raw::{
    ActorSection, EncoderKind, EvaluationAction, EvaluationSection, PolicySection, RunSection,
};
use super::sections::{self, Typed};
use super::table::overlay;
use super::{numbers, sizes};
use crate::cli::ConfigSource;

/// The domain of a file that names none.
const DEFAULT_DOMAIN: &str = "lander";
/// The most episodes that one policy is judged over.
pub const MAX_EPISODES: u32 = 1_000_000;
/// The widest layer.
const MAX_WIDTH: usize = 4_096;
/// Beyond it a choice is made never or always, and no training changes that.
const MAX_BIAS: f64 = 50.0;

/// Where and how a run is carried out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunSettings {
    /// Its name, if it was given one.
    pub name: Option<RunName>,
    /// Directory that holds the runs.
    pub directory: PathBuf,
    /// Actors that must be there before the run starts, at least 1.
    pub actors_min: u32,
    /// How often checkpoints are written.
    pub checkpoints: CheckpointInterval,
}

/// How policies are judged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EvaluationSettings {
    /// Episodes per policy, at least 1.
    pub episodes: u32,
    /// How actions are chosen.
    pub action: EvaluationAction,
    /// The task as it is in evaluation.
    pub task: TaskSpec,
}

/// A whole configuration, checked.
#[derive(Clone, Debug)]
pub struct Config {
    /// What to train on.
    pub domain: DomainName,
    /// Seed of every random stream.
    pub seed: u64,
    /// Where and how.
    pub run: RunSettings,
    /// The task, as actors build it.
    pub task: TaskSpec,
    /// What the task looks like.
    pub env: EnvSpec,
    /// The networks.
    pub policy: PolicySpec,
    /// The algorithm.
    pub learner: LearnerSettings,
    /// The most rollouts that one actor may have unacknowledged.
    pub window: u32,
    /// How policies are judged.
    pub evaluation: EvaluationSettings,
    /// The same as a complete table: what a run writes beside its results.
    pub table: Table,
}

/// Loads a configuration: embedded default, the person's file, changes on the command line, checks.
///
/// # Errors
///
/// One sentence that names file, key and line, and what is allowed.
pub fn load(
    source: &ConfigSource,
    name: Option<&str>,
    catalog: &Catalog,
    registry: &Registry,
) -> anyhow::Result<Config> {
    let file = source.config.as_deref().unwrap_or(Path::new(DEFAULT_DOMAIN));
    let mut table = read(file, catalog)?;
    for assignment in &source.set {
        assignment.apply(&mut table);
        let checked =
            domain_of(&table).and_then(|domain| sections::complete(domain, table.clone()));
        table = checked.with_context(|| format!("--set {}", assignment.key()))?;
    }
    if let Some(seed) = source.seed {
        let seed =
            i64::try_from(seed).context("--seed: at most 9223372036854775807 is possible")?;
        table.insert("seed".to_owned(), seed.into());
    }
    let run = table.get_mut("run").and_then(toml::Value::as_table_mut);
    let run = run.context("the configuration has no [run] section")?;
    if let Some(directory) = &source.runs {
        let directory = directory.to_str().context("--runs: the path is not UTF-8")?;
        run.insert("directory".to_owned(), directory.into());
    }
    if let Some(name) = name {
        run.insert("name".to_owned(), name.into());
    }
    Config::from_table(table, registry)
}

/// Reads a file, or a built-in configuration of that name, over the default of its domain.
fn read(file: &Path, catalog: &Catalog) -> anyhow::Result<Table> {
    let shown = file.display();
    let built_in = file.to_str().and_then(|name| catalog.own_text(name));
    let text = match fs::read_to_string(file) {
        Ok(text) => text,
        Err(error) if error.kind() != std::io::ErrorKind::NotFound && built_in.is_none() => {
            return Err(error).with_context(|| format!("reading {shown}"));
        }
        Err(_) => built_in.map(str::to_owned).with_context(|| {
            let names: Vec<&str> = catalog.names().collect();
            format!("there is no file {shown}; built-in configurations: {}", names.join(", "))
        })?,
    };
    parse(&text, catalog).with_context(|| format!("configuration {shown}"))
}

/// Lays a person's text over the default of its domain, after reading it key by key.
pub(super) fn parse(text: &str, catalog: &Catalog) -> anyhow::Result<Table> {
    numbers::check_text(text)?;
    let mut own: Table = text.parse().map_err(sections::readable)?;
    own.entry("domain").or_insert_with(|| DEFAULT_DOMAIN.into());
    let domain = domain_of(&own)?;
    let mut table = catalog.defaults(domain).with_context(|| {
        let names: Vec<&str> = catalog.names().collect();
        format!("`domain` is \"{domain}\"; allowed: {}", names.join(", "))
    })??;
    sections::check_text(domain, text)?;
    overlay(&mut table, &own);
    sections::complete(domain, table.clone())
}

fn domain_of(table: &Table) -> anyhow::Result<&str> {
    let domain = table.get("domain").context("the configuration has no `domain`")?;
    domain.as_str().with_context(|| format!("`domain` is {domain}; allowed: a name in quotes"))
}

impl Config {
    /// Checks a complete table.
    ///
    /// # Errors
    ///
    /// One sentence that names the key and what is allowed.
    pub fn from_table(table: Table, registry: &Registry) -> anyhow::Result<Self> {
        numbers::check(&table)?;
        let domain = DomainName::new(domain_of(&table)?).context("`domain`")?;
        let table = sections::complete(domain.as_str(), table)?;
        let typed = sections::typed(domain.as_str(), table.clone())?;
        let task = TaskSpec { domain: domain.to_string(), settings: typed.settings.clone() };
        let mut environment = registry.build(&task)?;
        let env = environment.spec().clone();
        let policy = check_policy(&typed.policy, environment.as_ref())?;
        typed.learner.check()?;
        check_sequences(&policy, &typed.learner)?;
        sizes::check(environment.as_mut(), &policy, &typed.learner)?;
        let evaluation = check_evaluation(&typed, &table, registry)?;
        Ok(Self {
            run: check_run(&typed.run)?,
            window: check_actor(&typed.actor)?,
            domain,
            seed: typed.seed,
            task,
            env,
            policy,
            learner: typed.learner,
            evaluation,
            table,
        })
    }

    /// Builds one environment of the task.
    ///
    /// # Errors
    ///
    /// None after the checks, unless the registry is another one.
    pub fn build(&self, registry: &Registry) -> anyhow::Result<Box<dyn Environment>> {
        Ok(registry.build(&self.task)?)
    }

    /// Returns how many steps one update trains on.
    pub fn steps_per_update(&self) -> u64 {
        self.learner.n_envs as u64 * self.learner.n_steps as u64
    }
}

fn check_run(run: &RunSection) -> anyhow::Result<RunSettings> {
    ensure!(run.actors_min >= 1, "`run.actors_min` is 0; allowed: at least 1");
    ensure!(run.checkpoint_every >= 1, "`run.checkpoint_every` is 0; allowed: at least 1 update");
    let seconds = run.checkpoint_seconds;
    ensure!(seconds >= 1, "`run.checkpoint_seconds` is 0; allowed: at least 1 second");
    ensure!(!run.directory.is_empty(), "`run.directory` is empty; allowed: a path");
    let name = match run.name.as_str() {
        "" => None,
        name => Some(RunName::new(name).context("`run.name`")?),
    };
    Ok(RunSettings {
        name,
        directory: PathBuf::from(&run.directory),
        actors_min: run.actors_min,
        checkpoints: CheckpointInterval {
            updates: run.checkpoint_every,
            time: Duration::from_secs(run.checkpoint_seconds),
        },
    })
}

fn check_actor(actor: &ActorSection) -> anyhow::Result<u32> {
    let window = actor.window;
    ensure!(
        (1..=MAX_WINDOW).contains(&window),
        "`actor.window` is {window}; allowed: 1 to {MAX_WINDOW}"
    );
    Ok(window)
}

fn check_policy(
    policy: &PolicySection,
    environment: &dyn Environment,
) -> anyhow::Result<PolicySpec> {
    let env = environment.spec();
    let encoder = check_encoder(policy, environment)?;
    let hidden = &policy.hidden;
    let fewest = usize::from(encoder == Encoder::Identity);
    let fits = (fewest..=8).contains(&hidden.len());
    ensure!(fits, "`policy.hidden` has {} layers; allowed: {fewest} to 8", hidden.len());
    if let Some(width) = hidden.iter().find(|width| !(1..=MAX_WIDTH).contains(*width)) {
        bail!("`policy.hidden` has a layer of width {width}; allowed: 1 to {MAX_WIDTH}");
    }
    env.actions.check()?;
    Ok(PolicySpec {
        obs_dim: env.obs_dim,
        encoder,
        hidden: hidden.clone(),
        actions: env.actions.clone(),
        head_credit: policy.head_credit,
        logit_bias: initial_biases(policy, &env.actions)?,
        normalize_observations: policy.normalize_observations,
    })
}

/// Returns what an untrained notifier prefers: silence to a message, and short messages to long ones, where the biases are
/// negative. Other policies prefer nothing.
fn initial_biases(policy: &PolicySection, actions: &ActionSpec) -> anyhow::Result<Vec<f32>> {
    let (initiate, length) = (policy.initiate_bias, policy.length_bias);
    for (key, bias) in [("initiate_bias", initiate), ("length_bias", length)] {
        let fits = bias.abs() <= MAX_BIAS;
        ensure!(fits, "`policy.{key}` is {bias}; allowed: -{MAX_BIAS} to {MAX_BIAS}");
    }
    let Some(gate) = actions.gate else { return Ok(Vec::new()) };
    let mut biases = vec![0.0; actions.n_choices()];
    let offsets = actions.offsets();
    biases[offsets[gate.head] + gate.choice] = initiate as f32;
    for (head, offset) in actions.heads.iter().zip(offsets) {
        if LENGTH_HEADS.contains(&head.name.as_str()) {
            let head = &mut biases[offset..offset + head.n_choices];
            head.iter_mut().enumerate().for_each(|(i, bias)| *bias = (i as f64 * length) as f32);
        }
    }
    let none = biases.iter().all(|bias| *bias == 0.0);
    Ok(if none { Vec::new() } else { biases })
}

/// Checks the encoder's widths.
fn check_encoder(policy: &PolicySection, environment: &dyn Environment) -> anyhow::Result<Encoder> {
    let (projection, state) = (policy.lstm_projection, policy.lstm_state);
    match policy.encoder {
        EncoderKind::None => Ok(Encoder::Identity),
        EncoderKind::Lstm => {
            let fits = projection <= MAX_WIDTH;
            ensure!(fits, "`policy.lstm_projection` is {projection}; allowed: 0 to {MAX_WIDTH}");
            let fits = (1..=MAX_WIDTH / 4).contains(&state);
            ensure!(fits, "`policy.lstm_state` is {state}; allowed: 1 to {}", MAX_WIDTH / 4);
            Ok(Encoder::Lstm { projection, state })
        }
        EncoderKind::Attention => {
            let history = environment.entity_history().context(
                "`policy.encoder` is \"attention\", but this domain's observation does not consist of entities; \
                 allowed: \"none\", \"lstm\"",
            )?;
            let (width, heads) = (policy.attention_width, policy.attention_heads);
            let fits = (1..=1_024).contains(&width);
            ensure!(fits, "`policy.attention_width` is {width}; allowed: 1 to 1024");
            let fits = heads >= 1 && width.is_multiple_of(heads);
            ensure!(
                fits,
                "`policy.attention_heads` is {heads}; allowed: a divisor of {width} (`attention_width`)"
            );
            Ok(Encoder::EgoAttention(history.attention(width, heads)))
        }
    }
}

/// A recurrent policy learns from whole rollouts, so an update cannot be cut finer than these.
fn check_sequences(policy: &PolicySpec, learner: &LearnerSettings) -> anyhow::Result<()> {
    let (n_minibatches, n_envs) = (learner.n_minibatches, learner.n_envs);
    ensure!(
        policy.recurrent_dim() == 0 || n_minibatches <= n_envs,
        "`learner.n_minibatches` is {n_minibatches}; a recurrent policy learns from whole rollouts, so allowed: 1 to \
         {n_envs} (`learner.n_envs`)"
    );
    Ok(())
}

fn check_evaluation(
    typed: &Typed,
    table: &Table,
    registry: &Registry,
) -> anyhow::Result<EvaluationSettings> {
    let EvaluationSection { episodes, action, world } = &typed.evaluation;
    let n = *episodes;
    let fits = (1..=MAX_EPISODES).contains(&n);
    ensure!(fits, "`evaluation.episodes` is {n}; allowed: 1 to {MAX_EPISODES}");
    let mut evaluated = table.clone();
    if let Some(below) = evaluated.get_mut("world").and_then(toml::Value::as_table_mut) {
        overlay(below, world);
    }
    let typed = sections::typed(&typed.domain, evaluated).context("`evaluation.world`")?;
    let task = TaskSpec { domain: typed.domain, settings: typed.settings };
    registry.build(&task).context("`evaluation.world`")?;
    Ok(EvaluationSettings { episodes: n, action: *action, task })
}
