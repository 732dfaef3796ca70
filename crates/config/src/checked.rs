//! The configuration as checked: it cannot be wrong any more.

use std::path::PathBuf;
use std::time::Duration;

use leadtime_episodes::Choice;
use leadtime_policy::parameters;
use leadtime_ppo::checkpoints::{
    CheckpointInterval, MAX_EVALUATIONS, MAX_HELD_OUT_EPISODES, MAX_KEPT, MAX_PAYLOAD_BYTES,
    Retention, max_payload_bytes,
};
use leadtime_ppo::{LearnerSettings, Mode};
use leadtime_proto::limits::{MAX_ROLLOUT_BYTES, MAX_WEIGHTS_BYTES, MAX_WINDOW};
use leadtime_proto::phrase::{counted, nearest};
use leadtime_proto::text::quoted;
use leadtime_proto::{DomainName, Encoder, EnvSpec, PolicySpec, Rollout, RunName, TaskSpec};
use leadtime_sims::{Description, Environment, Registry, notifier};
use leadtime_worker::DOMAIN;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use crate::catalog::{Catalog, GENERAL, GENERAL_TEXT, domain_of};
use crate::error::{ConfigError, ensure, within};
use crate::identity::{TOTAL_STEPS, without_retired};
use crate::layers::{Layer, Layers};
use crate::overrides::Override;
use crate::sections::{self, SECTIONS};
use crate::written::{EncoderKind, EvaluationSection, PolicySection, RunSection, WrittenConfig};

/// The most episodes that one policy is evaluated over.
pub const MAX_EPISODES: u32 = 1_000_000;
/// The widest layer that a policy may have.
const MAX_WIDTH: usize = 4_096;
/// Beyond it a choice is made never or always, and no training changes that.
const MAX_BIAS: f64 = 50.0;

/// Where a configuration comes from, and what to change in it.
#[derive(Clone, Debug, Default)]
pub struct ConfigSource {
    /// The person's file; `None`: the default domain's.
    pub file: Option<Layer>,
    /// Changes of single keys, in order.
    pub set: Vec<Override>,
    /// Seed of every random stream.
    pub seed: Option<u64>,
    /// Environment steps of the whole run.
    pub steps: Option<u64>,
    /// Directory that holds the runs.
    pub runs: Option<PathBuf>,
    /// Name of the run.
    pub name: Option<String>,
}

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
    /// How long training goes on while none can be written.
    pub checkpoint_patience: Duration,
    /// Which of them stay.
    pub keep: Retention,
}

/// How policies are evaluated.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluationSettings {
    /// Episodes per policy, at least 1.
    pub episodes: u32,
    /// How actions are chosen.
    pub action: Choice,
    /// Evaluations of a run's policy while it trains; 0: none.
    pub during_training: u32,
    /// The most episodes of each of these, at least 2.
    pub held_out_episodes: u32,
    /// The score in one of these at which the training ends: mean success, or mean return where the task knows none;
    /// `None`: never.
    pub stop_at: Option<f64>,
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
    /// Where and how the run is carried out.
    pub run: RunSettings,
    /// The task, as actors build it.
    pub task: TaskSpec,
    /// What the task looks like.
    pub env: EnvSpec,
    /// What the task's numbers and choices mean.
    pub description: Description,
    /// The networks that are trained.
    pub policy: PolicySpec,
    /// How they are trained.
    pub learner: LearnerSettings,
    /// The most rollouts that one actor may have unacknowledged.
    pub window: u32,
    /// How policies are evaluated.
    pub evaluation: EvaluationSettings,
    /// The same as a complete table: what a run writes beside its results.
    pub table: Table,
}

impl Config {
    /// Loads a configuration: the file over its bases, the changes of the command line over both.
    ///
    /// # Errors
    ///
    /// [`ConfigError`] with the key, its line or option, and the values that are allowed.
    pub fn load(
        source: &ConfigSource,
        catalog: &Catalog,
        registry: &Registry,
    ) -> Result<Self, ConfigError> {
        // A file that names no base and no domain is about the default domain.
        let file = source.file.clone().unwrap_or_else(|| Layer::text("", ""));
        let mut layers = catalog.with_bases(&file)?;
        layers.extend(source.set.iter().map(Layer::set));
        let numbers = [("--seed", "seed", source.seed), ("--steps", TOTAL_STEPS, source.steps)];
        for (option, key, number) in numbers {
            let Some(number) = number else { continue };
            ensure(i64::try_from(number).is_ok(), option, number, format!("0 to {}", i64::MAX))?;
            layers.push(Layer::option(option, &Override::new(key, number as i64)));
        }
        if let Some(name) = &source.name {
            // In a file an empty name stands for none.
            if name.is_empty() {
                RunName::new("").map_err(|error| ConfigError::of(error).at("--name"))?;
            }
            layers.push(Layer::option("--name", &Override::new("run.name", name.as_str())));
        }
        if let Some(directory) = &source.runs {
            // A path need not be UTF-8; the table, which is, only tells where the run was.
            let shown = directory.to_string_lossy().into_owned();
            layers.push(Layer::option("--runs", &Override::new("run.directory", shown)));
        }
        let mut config = Self::resolve(layers, registry)?;
        if let Some(directory) = &source.runs {
            config.run.directory.clone_from(directory);
        }
        Ok(config)
    }

    /// Reads a configuration that a run or a policy carries, with changes.
    ///
    /// # Errors
    ///
    /// As [`Config::load`].
    pub fn stored(
        place: &str,
        text: &str,
        changes: &[Override],
        registry: &Registry,
    ) -> Result<Self, ConfigError> {
        // It may be older than some settings, which change nothing at their general defaults.
        let own = Layer::text(place, text);
        own.parse()?;
        let as_written: toml::Table = text.parse().unwrap_or_default();
        let read = without_retired(as_written.clone());
        let own = if read == as_written { own } else { Layer::table(place, &read) };
        let layers = [Layer::text(GENERAL, GENERAL_TEXT), own];
        Self::resolve(layers.into_iter().chain(changes.iter().map(Layer::set)).collect(), registry)
    }

    /// Returns this configuration with other texts laid over it.
    ///
    /// # Errors
    ///
    /// As [`Config::load`].
    pub fn with(
        &self,
        over: impl IntoIterator<Item = Layer>,
        registry: &Registry,
    ) -> Result<Self, ConfigError> {
        let own = Layer::table("configuration", &self.table);
        let mut config = Self::resolve([own].into_iter().chain(over).collect(), registry)?;
        if config.table["run"].get("directory") == self.table["run"].get("directory") {
            config.run.directory.clone_from(&self.run.directory);
        }
        Ok(config)
    }

    /// Lays the layers over each other, reads the result once, and checks it.
    fn resolve(mut layers: Vec<Layer>, registry: &Registry) -> Result<Self, ConfigError> {
        same_domain(&layers)?;
        let layers = Layers::merge(&mut layers)?;
        let mut root = layers.table.clone();
        let sections = sections::take(&mut root);
        let changes = root.get("evaluation").and_then(|section| section.get_ref().as_table());
        let changes = changes.and_then(|section| section.get("world").cloned());
        known_keys(&layers)?;
        let written: WrittenConfig = layers.read(root)?;
        let domain = DomainName::new(&written.domain);
        let domain = domain.map_err(|error| ConfigError::of(error).at("`domain`"))?;
        check_worker(&layers, domain.as_str())?;
        let read = |sections| {
            let task = sections::read(domain.as_str(), &layers, sections)?;
            sections::complete(task, registry)
        };
        let task = read(sections.clone())?;
        // What the task itself does otherwise in evaluation comes first, what the user wants on top.
        let evaluation = DeTable::parse(registry.evaluation_world(domain.as_str()));
        let mut evaluation = evaluation.map_err(ConfigError::of)?.into_inner();
        if let Some(DeValue::Table(changes)) = changes.map(toml::Spanned::into_inner) {
            let world = sections.get("world").and_then(|world| world.get_ref().as_table());
            layers.overlay(&mut evaluation, changes, world)?;
        }
        let evaluated = if evaluation.is_empty() {
            task.spec.clone()
        } else {
            let mut sections = sections;
            let world = sections.get_mut("world").map(toml::Spanned::get_mut);
            if let Some(DeValue::Table(world)) = world {
                layers.overlay(world, evaluation, None)?;
            }
            read(sections)?.spec
        };
        let mut table = Table::try_from(&written).map_err(ConfigError::of)?;
        table.extend(task.table);
        let mut environment = registry.build(&task.spec).map_err(ConfigError::of)?;
        let policy = check_policy(&written.policy, environment.as_ref())?;
        written.learner.check().map_err(ConfigError::of)?;
        check_sizes(environment.as_mut(), &policy, &written.learner)?;
        let goes_on = environment.is_restorable() || written.learner.mode == Mode::Async;
        let given = "\"none\", with which an environment that moves begins an episode";
        let allowed = "\"replay\", \"pickle\", or `learner.mode` \"async\"";
        ensure(goes_on, "world.snapshot", given, allowed)?;
        if evaluated != task.spec {
            let built = registry.build(&evaluated);
            built.map_err(|error| ConfigError::of(error).at("`evaluation.world`"))?;
        }
        let window = written.actor.window;
        within("actor.window", window, 1, MAX_WINDOW)?;
        let knows_success = environment.spec().metrics.iter().any(|name| name == "success");
        let evaluation = check_evaluation(&written.evaluation, evaluated, knows_success)?;
        Ok(Self {
            run: check_run(&written.run)?,
            window,
            evaluation,
            domain,
            seed: written.seed,
            env: environment.spec().clone(),
            description: environment.describe(),
            task: task.spec,
            policy,
            learner: written.learner,
            table,
        })
    }

    /// Refuses a change of the world that has no effect on a trained policy, because where it is evaluated the task has a value
    /// of its own; this is the configuration with the change.
    ///
    /// # Errors
    ///
    /// [`ConfigError`] that names the key that has an effect.
    pub fn check_evaluated(
        &self,
        change: &Override,
        registry: &Registry,
    ) -> Result<(), ConfigError> {
        if let Value::Table(inner) = &change.value {
            return Override::of_table(inner).into_iter().try_for_each(|leaf| {
                let path = [&change.path[..], &leaf.path].concat();
                let leaf = Override { path, ..leaf.given_by(change.option) };
                self.check_evaluated(&leaf, registry)
            });
        }
        let Some((section, path)) = change.path.split_first() else { return Ok(()) };
        let of_task = registry.evaluation_world(self.domain.as_str()).parse::<Table>();
        let written = self.table.get("evaluation").and_then(|section| section.get("world"));
        let is_own = written.and_then(Value::as_table).is_some_and(|own| sets(own, path))
            || of_task.is_ok_and(|own| sets(&own, path));
        if section != "world" || !is_own {
            return Ok(());
        }
        let (option, key) = (change.option, quoted(&change.key()));
        Err(ConfigError(format!(
            "{option}: `{key}` has no effect on a policy that is trained already, for whom the task has a value of its own: \
             leave it out, and change `evaluation.{key}`"
        )))
    }

    /// Returns how many steps one update trains on.
    pub fn steps_per_update(&self) -> u64 {
        self.learner.n_envs as u64 * self.learner.n_steps as u64
    }

    /// Says how many steps are trained where they are not the ones that are written, because an update takes a whole batch.
    pub fn rounded_steps(&self) -> Option<String> {
        let (steps, batch) = (self.learner.total_steps, self.steps_per_update());
        let which = if steps < batch { "up" } else { "down" };
        let (n_updates, trained) = (self.learner.n_updates(), self.learner.n_updates() * batch);
        let updates = counted(n_updates, "update");
        let rounded =
            format!("steps rounded {which} from {steps} to {trained}: {updates} of {batch}");
        (trained != steps).then_some(rounded)
    }
}

/// Returns whether a table sets a key, or a part of it.
fn sets(table: &Table, path: &[String]) -> bool {
    let Some((first, rest)) = path.split_first() else { return !table.is_empty() };
    match table.get(first) {
        Some(Value::Table(inner)) => sets(inner, rest),
        value => value.is_some(),
    }
}

/// Refuses an option that asks for another domain than the texts below it are about, because their sections are not its own.
fn same_domain(layers: &[Layer]) -> Result<(), ConfigError> {
    let asked = |layer: &Layer| layer.asked_domain().is_some();
    let Some(first) = layers.iter().position(asked) else { return Ok(()) };
    let about = domain_of(&layers[..first])?;
    let allowed = || {
        format!(
            "\"{about}\", which the configuration is about; another domain has a configuration of its own, by -c"
        )
    };
    for layer in &layers[first..] {
        let Some(asked) = layer.asked_domain() else { continue };
        let fits = about == GENERAL || asked.as_str() == Some(about.as_str());
        ensure(fits, "domain", quoted(&asked.to_string()), allowed())
            .map_err(|error| error.at(&layer.place))?;
    }
    Ok(())
}

/// Refuses a worker's command for a world that no worker steps, before the key that it stands for is found to be unknown there.
fn check_worker(layers: &Layers<'_>, domain: &str) -> Result<(), ConfigError> {
    const OPTION: &str = "--worker";
    if domain == DOMAIN || !layers.are_changed_by(OPTION) {
        return Ok(());
    }
    let text =
        format!("{OPTION} is for worlds in Python (`domain = \"{DOMAIN}\"`); `{domain}` is none");
    Err(ConfigError(text))
}

/// Refuses an unknown top-level key, and finds the section, or the section's key, that was meant.
fn known_keys(layers: &Layers<'_>) -> Result<(), ConfigError> {
    const KEYS: [&str; 7] = ["domain", "seed", "run", "policy", "learner", "actor", "evaluation"];
    let known: Vec<&str> = KEYS.into_iter().chain(SECTIONS).collect();
    let Some(key) = layers.table.keys().find(|key| !known.contains(&key.get_ref().as_ref())) else {
        return Ok(());
    };
    let name = key.get_ref().as_ref();
    let section = |name: &str| layers.table.get(name).and_then(|value| value.get_ref().as_table());
    let keys = |section: &'_ DeTable<'_>| section.keys().map(ToString::to_string).collect();
    let mut meant: Vec<[String; 2]> =
        known.iter().map(|name| [*name; 2].map(str::to_owned)).collect();
    for section_name in &known {
        let keys: Vec<String> = section(section_name).map_or_else(Vec::new, keys);
        meant.extend(keys.into_iter().map(|key| [format!("{section_name}.{key}"), key]));
    }
    let near = nearest(name, meant.iter().map(|[_, last]| last.as_str()));
    let near = near.and_then(|near| meant.iter().find(|[_, last]| last == near));
    let hint = match near {
        Some([full, _]) => format!("; did you mean `{full}`?"),
        None => format!(", expected one of `{}`", known.join("`, `")),
    };
    Err(layers.refuse(Some(key.span()), &format!("unknown key `{name}`{hint}")))
}

fn check_evaluation(
    evaluation: &EvaluationSection,
    task: TaskSpec,
    knows_success: bool,
) -> Result<EvaluationSettings, ConfigError> {
    let &EvaluationSection {
        episodes, action, during_training, held_out_episodes, stop_at, ..
    } = evaluation;
    within("evaluation.episodes", episodes, 1, MAX_EPISODES)?;
    within("evaluation.during_training", during_training, 0, MAX_EVALUATIONS)?;
    // One episode has no standard error.
    within("evaluation.held_out_episodes", held_out_episodes, 2, MAX_HELD_OUT_EPISODES)?;
    if let Some(mark) = stop_at {
        let (fits, allowed) = if knows_success {
            (mark > 0.0 && mark <= 1.0, "above 0 to 1: this task's success")
        } else {
            (mark.is_finite(), "a number: this task's return")
        };
        ensure(fits, "evaluation.stop_at", mark, allowed)?;
        let needed = "at least 1 where `evaluation.stop_at` is set";
        ensure(during_training > 0, "evaluation.during_training", during_training, needed)?;
    }
    Ok(EvaluationSettings { episodes, action, during_training, held_out_episodes, stop_at, task })
}

fn check_run(run: &RunSection) -> Result<RunSettings, ConfigError> {
    let (actors_min, updates) = (run.actors_min, run.checkpoint_every);
    ensure(actors_min >= 1, "run.actors_min", actors_min, "at least 1")?;
    ensure(updates >= 1, "run.checkpoint_every", updates, "at least 1 update")?;
    let seconds = run.checkpoint_seconds;
    ensure(seconds >= 1, "run.checkpoint_seconds", seconds, "at least 1 second")?;
    let patience = run.checkpoint_patience;
    ensure(patience >= 1, "run.checkpoint_patience", patience, "at least 1 second")?;
    within("run.keep.newest", run.keep.newest, 1, MAX_KEPT)?;
    ensure(!run.directory.is_empty(), "run.directory", "empty", "a path")?;
    let directory = &run.directory;
    ensure(!directory.contains('\0'), "run.directory", quoted(directory), "a path without NUL")?;
    let name = (!run.name.is_empty()).then(|| RunName::new(&run.name)).transpose();
    Ok(RunSettings {
        name: name.map_err(|error| ConfigError::of(error).at("`run.name`"))?,
        directory: PathBuf::from(&run.directory),
        actors_min,
        checkpoints: CheckpointInterval { updates, time: Duration::from_secs(seconds) },
        checkpoint_patience: Duration::from_secs(patience),
        keep: run.keep,
    })
}

fn check_policy(policy: &PolicySection, env: &dyn Environment) -> Result<PolicySpec, ConfigError> {
    let encoder = check_encoder(policy, env)?;
    let env = env.spec();
    let (n_layers, fewest) = (policy.hidden.len(), usize::from(encoder == Encoder::Identity));
    let fits = (fewest..=8).contains(&n_layers);
    let given = format_args!("{n_layers} layers");
    ensure(fits, "policy.hidden", given, format_args!("{fewest} to 8"))?;
    for width in &policy.hidden {
        within("policy.hidden", *width, 1, MAX_WIDTH)?;
    }
    let (initiate, length) = (policy.initiate_bias, policy.length_bias);
    within("policy.initiate_bias", initiate, -MAX_BIAS, MAX_BIAS)?;
    within("policy.length_bias", length, -MAX_BIAS, MAX_BIAS)?;
    Ok(PolicySpec {
        obs_dim: env.obs_dim,
        encoder,
        hidden: policy.hidden.clone(),
        actions: env.actions.clone(),
        head_credit: policy.head_credit,
        logit_bias: notifier::initial_bias(&env.actions, initiate, length),
        normalize_observations: policy.normalize_observations,
    })
}

fn check_encoder(policy: &PolicySection, env: &dyn Environment) -> Result<Encoder, ConfigError> {
    let (projection, state) = (policy.lstm_projection, policy.lstm_state);
    match policy.encoder {
        EncoderKind::None => Ok(Encoder::Identity),
        EncoderKind::Lstm => {
            within("policy.lstm_projection", projection, 0, MAX_WIDTH)?;
            within("policy.lstm_state", state, 1, MAX_WIDTH / 4)?;
            Ok(Encoder::Lstm { projection, state })
        }
        EncoderKind::Attention => {
            let (width, heads) = (policy.attention_width, policy.attention_heads);
            within("policy.attention_width", width, 1, 1_024)?;
            let fits = heads >= 1 && width.is_multiple_of(heads);
            let allowed = format_args!("a divisor of {width} (`attention_width`)");
            ensure(fits, "policy.attention_heads", heads, allowed)?;
            let given = "\"attention\", but this domain's observation does not consist of entities";
            let history = env.entity_history();
            ensure(history.is_some(), "policy.encoder", given, "\"none\", \"lstm\"")?;
            let attention = history.map(|history| history.attention(width, heads));
            Ok(attention.map_or(Encoder::Identity, Encoder::EgoAttention))
        }
    }
}

/// Refuses an update that is cut finer than a recurrent policy's rollouts, and messages and files that could never be sent
/// or written: a rollout over its limit would be sent, refused and sent again for ever; a checkpoint over its limit would
/// end the run at its first one.
fn check_sizes(
    environment: &mut dyn Environment,
    policy: &PolicySpec,
    learner: &LearnerSettings,
) -> Result<(), ConfigError> {
    let (n_steps, n_envs, n_minibatches) = (learner.n_steps, learner.n_envs, learner.n_minibatches);
    let fits = policy.recurrent_dim() == 0 || n_minibatches <= n_envs;
    let allowed = format!(
        "1 to {n_envs} (`learner.n_envs`), because a recurrent policy learns from whole rollouts"
    );
    ensure(fits, "learner.n_minibatches", n_minibatches, allowed)?;
    let spec = environment.spec();
    let rollout = |n_steps| Rollout::max_bytes(spec, policy.recurrent_dim(), n_steps);
    let (bytes, empty) = (rollout(n_steps), rollout(0));
    let most = MAX_ROLLOUT_BYTES.saturating_sub(empty) / (rollout(1) - empty);
    let given = format!("{n_steps}, which makes rollouts of up to {bytes} bytes");
    let allowed = format!("at most {MAX_ROLLOUT_BYTES} bytes, which is {most} steps of this task");
    ensure(bytes <= MAX_ROLLOUT_BYTES, "learner.n_steps", given, allowed)?;
    let weights = parameters::max_bytes(policy);
    let given = format!("so wide, with the encoder, that weights have up to {weights} bytes");
    let allowed = format!("at most {MAX_WEIGHTS_BYTES} bytes");
    ensure(weights <= MAX_WEIGHTS_BYTES, "policy.hidden", given, allowed)?;
    let snapshot = environment.max_snapshot_bytes() + 4 * policy.recurrent_dim();
    let (bytes, lag) = (max_payload_bytes(learner, weights, snapshot), learner.lag);
    if bytes <= MAX_PAYLOAD_BYTES {
        return Ok(());
    }
    Err(ConfigError(format!(
        "a checkpoint would have up to {bytes} bytes: {weights} for each version of the weights that is kept \
         (`policy.hidden`, `learner.lag` is {lag}), {snapshot} for each environment (`learner.n_envs` is {n_envs}); \
         allowed: at most {MAX_PAYLOAD_BYTES} bytes"
    )))
}
