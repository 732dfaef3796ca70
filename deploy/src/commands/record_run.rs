//! `leadtime record --run`: what learner and actors tell of a run, in a file.

use std::fs::File;
use std::io::BufWriter;
use std::pin::pin;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use leadtime_certs::Role;
use leadtime_link::keys::{Key, Member};
use leadtime_link::{Events, ObserverEvent, ObserverLink};
use leadtime_proto::RunName;
use leadtime_proto::phrase::counted;
use leadtime_recording::{RecordedTopic, RecordingWriter};
use serde_json::Value;
use tokio::time::{MissedTickBehavior, interval, sleep};
use tokio_util::sync::CancellationToken;

use super::record::{
    FLUSH_EVERY, RecordClock, RecordFailure, begin, close, create, end, stop_after,
};
use crate::cli::RecordArgs;
use crate::credentials::{dialling_failure, notifier_settings};
use crate::ending::{Watch, watch};
use crate::exit::{Blame as _, ExitCode, Failure};

/// The longest until a learner that is there is seen.
const SEEN_WITHIN: Duration = Duration::from_secs(5);

pub(super) async fn run(args: &RecordArgs, name: &str) -> Result<(), Failure> {
    let shutdown = watch(Watch::Signals).blame(ExitCode::Failed)?;
    let run = RunName::new(name).context("--run").blame(ExitCode::WrongInput)?;
    let settings =
        notifier_settings(&args.connect, &args.notifier, &[Role::Recorder, Role::Observer])?;
    let mut file = create(args)?;
    let opened = async {
        let (link, events) = ObserverLink::open(&settings).await?;
        let run = link.find_run(&settings, Some(run)).await?;
        link.follow(&run)?;
        Ok((link, events, run))
    };
    let (link, events, run) = tokio::select! {
        () = shutdown.cancelled() => return Err(Failure::silent(ExitCode::Interrupted)),
        opened = opened => opened.map_err(dialling_failure)?,
    };
    let mut writer = begin(&mut file)?;
    let shown = args.output.display();
    tracing::info!("recording run `{run}` to {shown} until it is finished, or {}", end(args));
    stop_after(args, &shutdown);
    let recorded = record(&run, &link, &events, &mut writer, &shutdown).await;
    // What was recorded is kept, whatever went wrong: with its index, if the disk takes one.
    let failure = recorded.and(writer.finish().map_err(RecordFailure::File)).err();
    drop(link.close().await);
    close(args, &counted(writer.n_messages(), "message"), failure)
}

/// Records until the run has ended, or the token is cancelled.
async fn record(
    run: &RunName,
    link: &ObserverLink,
    events: &Events<ObserverEvent>,
    writer: &mut RecordingWriter<BufWriter<File>>,
    stop: &CancellationToken,
) -> Result<(), RecordFailure> {
    let mut flushes = interval(FLUSH_EVERY);
    flushes.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let clock = RecordClock::start();
    let (mut n_missed, mut n_passed_over, mut is_here) = (0, 0, None);
    // One that was killed before it was seen here leaves without a word.
    let mut first_look = pin!(sleep(SEEN_WITHIN));
    loop {
        tokio::select! {
            () = stop.cancelled() => return Ok(()),
            event = events.recv() => match event {
                Some(ObserverEvent::Metrics { member, json, .. }) => {
                    let Ok(told) = serde_json::from_slice::<Value>(&json) else { continue };
                    if !told.is_object() {
                        continue;
                    }
                    let key = Key::Metrics(run, &member).to_string();
                    let at = clock.at(Instant::now());
                    writer.write(&key, RecordedTopic::Metrics, at, &json)?;
                    // A learner that was asked to stop may be started again.
                    if told["kind"] == "end" && told["how"] == "finished" {
                        return Ok(());
                    }
                }
                Some(ObserverEvent::Left(Member::Learner, _)) => {
                    is_here = Some(false);
                    warn_of_loss(run);
                }
                Some(ObserverEvent::Joined(Member::Learner, _)) => {
                    if is_here.replace(true) == Some(false) {
                        tracing::info!("the learner of run `{run}` is back");
                    }
                }
                Some(_) => {}
                None => return Ok(()),
            },
            () = &mut first_look, if is_here.is_none() => {
                is_here = Some(false);
                warn_of_loss(run);
            }
            _ = flushes.tick() => {
                writer.flush()?;
                if let Some(n_new) = super::record::newly(link.n_missed(), &mut n_missed) {
                    tracing::warn!("{n_new} came faster than they can be written: not recorded");
                }
                if let Some(n_new) = super::record::newly(writer.n_passed_over(), &mut n_passed_over) {
                    tracing::warn!("{n_new} came of more members than a file has room for: not recorded");
                }
            }
        }
    }
}

fn warn_of_loss(run: &RunName) {
    tracing::warn!("the learner of run `{run}` is gone: looking for it until Ctrl-C");
}
