//! `leadtime drive`: one of our own worlds, its listener included, hears a notifier at work over the network.

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
use leadtime_proto::ids::InvalidId;
use leadtime_runs::evaluation::{UNAIDED, compare, n_threads};
use leadtime_runs::{Tasks, clock};
use leadtime_serve::{BusPlayer, ClientError, ClientSettings, LiveClient, SaidMessage};
use serde_json::json;
use tokio_util::sync::CancellationToken;

use super::{describe, evaluation};
use crate::cli::DriveArgs;
use crate::credentials::{connect_settings, is_wrong_input};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;
use crate::shutdown::{Watch, unless_cancelled, watch};

pub(super) async fn run(tasks: &Tasks, args: &DriveArgs) -> Result<(), Failure> {
    let config = describe::load(tasks, &args.task, &args.set, &args.runs)?;
    let shutdown = watch(Watch::Signals).blame(ExitCode::Failed)?;
    let settings = connect_settings(&args.connect, &args.tls, &[Role::Robot]);
    let mut settings = settings.blame(ExitCode::WrongInput)?;
    settings.timeout = args.connect_timeout;
    let link = LiveClientLink::open(&settings).await.map_err(failure)?;
    let asked = ClientSettings {
        service: args.service.clone(),
        client: own_name(args.client.as_ref(), &settings, "drive").blame(ExitCode::WrongInput)?,
        incarnation: clock::incarnation(),
        domain: config.domain.to_string(),
        clock: args.clock(),
        seconds_per_step: args.seconds_per_step,
        seed: args.eval_seed,
        form: args.form(),
    };
    let client = LiveClient::open(&link, asked).await.map_err(client_failure)?;
    tracing::info!(session = %client.answer()["session"], "the notifier listens");
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
    // Nothing is owed to anybody any more.
    drop(link.close().await);
    Ok(())
}

/// Returns a client's name: as asked for, or as its certificate says, or `usual`.
pub(super) fn own_name(
    asked: Option<&ClientName>,
    settings: &ConnectSettings,
    usual: &str,
) -> Result<ClientName, InvalidId> {
    let shown = settings.identity.as_ref().and_then(|identity| identity.shown.name.clone());
    let name = || ClientName::new(shown.unwrap_or_else(|| usual.to_owned()));
    asked.cloned().map_or_else(name, Ok)
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
        let settings = PlaySettings::new(n_episodes, self.seed).threads(n_threads());
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
        ClientError::Link(error) => failure(error),
        error => Failure::of(ExitCode::PeerLost, error),
    }
}

pub(super) fn failure(error: LinkError) -> Failure {
    let is_input = is_wrong_input(&error) || matches!(error, LinkError::ReservedName(_));
    Failure::of(if is_input { ExitCode::WrongInput } else { ExitCode::PeerLost }, error)
}
