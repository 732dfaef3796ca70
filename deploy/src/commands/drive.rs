//! `leadtime drive`: one of our own worlds, its listener included, hears a notifier at work over the network.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::sync::Arc;

use leadtime_certs::Role;
use leadtime_config::Config;
use leadtime_eval::Error as EvalError;
use leadtime_eval::measure::{Evaluation, PlaySettings, Player, evaluate, with_outcomes};
use leadtime_link::live::LiveClientLink;
use leadtime_link::{ConnectSettings, Error as LinkError};
use leadtime_proto::ClientName;
use leadtime_proto::text::quoted;
use leadtime_runs::build::n_cores;
use leadtime_runs::evaluation::{UNAIDED, compare};
use leadtime_runs::{Tasks, clock};
use leadtime_serve::{BusPlayer, ClientError, ClientSettings, LiveClient, SaidMessage};
use serde_json::{Value, json};
use tokio_util::sync::CancellationToken;

use super::{describe, evaluation};
use crate::cli::DriveArgs;
use crate::credentials::{dialling_failure, notifier_settings};
use crate::ending::{Watch, unless_cancelled, watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

pub(super) async fn run(tasks: &Tasks, args: &DriveArgs) -> Result<(), Failure> {
    let config = describe::load(tasks, &args.task, &args.set, &args.runs)?;
    let shutdown = watch(Watch::Signals).blame(ExitCode::Failed)?;
    let settings = notifier_settings(&args.connect, &args.notifier, &[Role::Robot])?;
    let client = own_name(args.client.as_ref(), &settings, "drive")?;
    let link = LiveClientLink::open(&settings).await.map_err(dialling_failure)?;
    let task = &config.evaluation.task;
    let environment = tasks.registry.build(task).blame(ExitCode::WrongInput)?;
    let asked = ClientSettings {
        service: args.notifier.service.clone(),
        client,
        incarnation: clock::incarnation(),
        domain: config.domain.to_string(),
        obs_dim: environment.session().map(|session| session.obs_dim()),
        clock: args.clock(),
        seconds_per_step: args.seconds_per_step,
        seed: args.eval_seed,
        form: args.form(),
    };
    let client = LiveClient::open(&link, asked).await.map_err(client_failure)?;
    tracing::info!(session = %client.answer()["session"], "the notifier listens");
    let own = serde_json::from_str(&task.settings).unwrap_or_default();
    let differing = differences(&own, &client.answer()["task"]);
    if !differing.is_empty() {
        tracing::warn!(
            "this task is not the one that the notifier's policy was made for: {}. `drive` with the policy's own file flies that one",
            differing.join("; ")
        );
    }
    let player = BusPlayer::new(client, args.clock(), args.seconds_per_step);
    let n_episodes = args.episodes.unwrap_or(config.evaluation.episodes);
    let driven = Drive {
        tasks: tasks.clone(),
        config: config.clone(),
        player: player.clone(),
        n_episodes,
        seed: args.eval_seed,
        stop: shutdown.clone(),
    };
    let evaluation = unless_cancelled(&shutdown, move || driven.run()).await?;
    if let Some(path) = &args.messages_to {
        write_messages(path, &player.take_said(), tasks, &config)?;
    }
    let comparison = compare(&config, &[evaluation], &[]);
    if args.shown.json {
        output::json(&json!({"seed": args.eval_seed, "comparison": comparison}));
    } else {
        evaluation::print(&comparison, args.shown.all);
    }
    // Nobody waits for an answer any more.
    drop(link.close().await);
    Ok(())
}

/// Returns a client's name: as its certificate says, which is the only one that an access list lets it use, or as asked for, or
/// `usual`.
pub(super) fn own_name(
    asked: Option<&ClientName>,
    settings: &ConnectSettings,
    usual: &str,
) -> Result<ClientName, Failure> {
    let shown = settings.identity.as_ref().map(|identity| &identity.shown);
    let certified = shown.and_then(|shown| shown.name.clone());
    let is_robots = shown.is_some_and(|shown| shown.role == Some(Role::Robot));
    match (asked, certified) {
        (Some(asked), Some(certified)) if is_robots && asked.as_str() != certified => {
            let sentence = format!(
                "--client {asked}: the certificate is for `{certified}`, and a robot speaks under its own name only; leave --client out, \
                 or issue a certificate to `{asked}`"
            );
            Err(Failure::input(sentence))
        }
        (Some(asked), _) => Ok(asked.clone()),
        (None, certified) => {
            let name = certified.unwrap_or_else(|| usual.to_owned());
            ClientName::new(name).blame(ExitCode::WrongInput)
        }
    }
}

/// The most differences between two tasks that are printed.
const MAX_DIFFERENCES: usize = 4;

/// Says in which settings two tasks differ; nothing where one of them is not known.
fn differences(own: &Value, theirs: &Value) -> Vec<String> {
    let (own, theirs) = (flat(own), flat(theirs));
    if own.is_empty() || theirs.is_empty() {
        return Vec::new();
    }
    let keys: BTreeSet<&String> = own.keys().chain(theirs.keys()).collect();
    let differing = keys.into_iter().filter(|key| own.get(*key) != theirs.get(*key));
    let value = |of: Option<&String>| of.map_or_else(|| "absent".to_owned(), |it| quoted(it));
    let line = |key: &String| {
        format!("`{key}` is {} here and {} there", value(own.get(key)), value(theirs.get(key)))
    };
    let mut lines: Vec<String> = differing.map(line).collect();
    if lines.len() > MAX_DIFFERENCES {
        let n_more = lines.len() - MAX_DIFFERENCES;
        lines.truncate(MAX_DIFFERENCES);
        lines.push(format!("and {n_more} more"));
    }
    lines
}

/// Returns settings as `human.reaction_delay` and their values.
fn flat(settings: &Value) -> BTreeMap<String, String> {
    let mut open: Vec<(String, &Value)> = vec![(String::new(), settings)];
    let mut found = BTreeMap::new();
    while let Some((path, value)) = open.pop() {
        match value {
            Value::Object(inner) => open.extend(inner.iter().map(|(key, value)| {
                let dot = if path.is_empty() { "" } else { "." };
                (format!("{path}{dot}{key}"), value)
            })),
            Value::Null => {}
            value => drop(found.insert(path, value.to_string())),
        }
    }
    found
}

/// The episodes of a world, as a thread of their own plays them.
struct Drive {
    tasks: Tasks,
    config: Config,
    player: BusPlayer,
    n_episodes: u32,
    seed: u64,
    stop: CancellationToken,
}

impl Drive {
    fn run(&self) -> Result<Evaluation, Failure> {
        let task = Arc::new(self.config.evaluation.task.clone());
        let make = || self.tasks.registry.build(&task);
        let stop = || self.stop.is_cancelled() || self.player.has_failed();
        let n_episodes = u64::from(self.n_episodes);
        let settings = PlaySettings { n_slots: 1, ..PlaySettings::new(n_episodes, self.seed) };
        let player = Player::scripted("over the network", Box::new(self.player.clone()));
        let played = evaluate(&make, &player, &settings.stopped_by(&stop));
        if let Some(error) = self.player.take_failure() {
            return Err(client_failure(error));
        }
        let evaluation = played.map_err(|error| match error {
            error @ EvalError::Task(_) => Failure::of(ExitCode::WrongInput, error),
            error => error.into(),
        })?;
        let unaided = Player::baseline(UNAIDED);
        let environment = make().blame(ExitCode::WrongInput)?;
        if !environment.baselines().contains(&UNAIDED) {
            return Ok(evaluation);
        }
        let settings = PlaySettings::new(n_episodes, self.seed).threads(n_cores());
        let alone = evaluate(&make, &unaided, &settings)?;
        Ok(with_outcomes(evaluation, &alone))
    }
}

/// Writes what was said, a line of JSON per message.
fn write_messages(
    path: &Path,
    said: &[SaidMessage],
    tasks: &Tasks,
    config: &Config,
) -> Result<(), Failure> {
    let topics = tasks.topics(&config.evaluation.task);
    let line = |said: &SaidMessage| {
        let SaidMessage { episode, step, message, text } = said;
        let (topic, k, l) = (topics.get(message.topic), message.comprehension, message.conveyance);
        json!({"episode": episode, "step": step, "topic": topic, "k": k, "l": l, "text": text})
            .to_string()
            + "\n"
    };
    let text: String = said.iter().map(line).collect();
    output::file(path, text.as_bytes()).blame(ExitCode::WrongInput)?;
    tracing::info!(
        "{} messages in {}",
        said.len(),
        fs::canonicalize(path).unwrap_or_default().display()
    );
    Ok(())
}

fn client_failure(error: ClientError) -> Failure {
    match error {
        ClientError::Link(LinkError::Rejected { reason, .. })
            if reason.starts_with(leadtime_serve::open::WRONG_TASK) =>
        {
            let sentence = format!(
                "{reason}. The task of its policy fits: `leadtime drive` with that task's name, or with the policy's own file"
            );
            Failure::of(ExitCode::PeerLost, anyhow::Error::msg(sentence))
        }
        ClientError::Link(error) => dialling_failure(error),
        error => Failure::of(ExitCode::PeerLost, error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_are_compared_setting_by_setting() {
        let own = json!({"human": {"delay": 3, "repeat": "hear"}, "map": "easy", "only": [1]});
        let theirs = json!({"human": {"delay": 2, "repeat": "hear"}, "map": "easy", "none": null});
        let told = ["`human.delay` is 3 here and 2 there", "`only` is [1] here and absent there"];
        assert_eq!(differences(&own, &theirs), told);
        assert_eq!(differences(&own, &own), [""; 0]);
        assert_eq!(differences(&own, &Value::Null), [""; 0]);
        let many = json!({"a": 1, "b": 1, "c": 1, "d": 1, "e": 1, "f": 1});
        assert_eq!(differences(&many, &json!({"a": 1})).last().unwrap(), "and 1 more");
    }
}
