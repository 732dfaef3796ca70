//! `leadtime check`: would it work here?

use std::path::Path;
use std::thread::available_parallelism;

use anyhow::Context as _;
use leadtime_link::{ConnectSettings, Endpoint, ObserverLink};
use leadtime_runs::cpu;

use crate::cli::CheckArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::{output, threads};
use leadtime_config::Config;
use leadtime_runs::Tasks;

pub(super) async fn run(tasks: &Tasks, args: &CheckArgs) -> Result<(), Failure> {
    let config = args.source.load(tasks, None).blame(ExitCode::WrongInput)?;
    let (n_updates, n_envs) = (config.learner.n_updates(), config.learner.n_envs);
    report(
        "configuration",
        &format!("domain {}, {n_updates} updates, {n_envs} environments", config.domain),
    );
    for notice in config.notices() {
        report("notice", &notice);
    }
    let (obs_dim, heads) = (config.env.obs_dim, &config.env.actions.heads);
    let heads: Vec<String> =
        heads.iter().map(|head| format!("{} {}", head.name, head.n_choices)).collect();
    report("task", &format!("{obs_dim} inputs, heads: {}", heads.join(", ")));
    let cores = available_parallelism().map_or(1, usize::from);
    report(
        "machine",
        &format!(
            "{cores} cores, {}, {} numeric threads",
            cpu::fingerprint(),
            threads::configured()
        ),
    );
    writable(&config).blame(ExitCode::WrongInput)?;
    report("runs", &format!("{} can be written", config.run.directory.display()));
    if !args.connect.is_empty() {
        let runs = look(args).await?;
        report("learner", &format!("runs at {}: {}", args.connect.join(", "), runs.join(", ")));
    }
    Ok(())
}

fn report(what: &str, finding: &str) {
    output::line(&format!("{what:<14} {finding}"));
}

/// Makes sure that a run could be made, without leaving anything behind.
fn writable(config: &Config) -> anyhow::Result<()> {
    let wanted = &config.run.directory;
    let exists = |path: &&Path| path.exists();
    let there = wanted.ancestors().find(exists).filter(|path| !path.as_os_str().is_empty());
    let directory = there.unwrap_or(Path::new("."));
    tempfile::tempfile_in(directory).with_context(|| {
        format!("`run.directory` {}: nothing can be written there", wanted.display())
    })?;
    Ok(())
}

/// Lists the runs at an address.
async fn look(args: &CheckArgs) -> Result<Vec<String>, Failure> {
    let endpoints: Result<Vec<Endpoint>, _> =
        args.connect.iter().map(|text| text.parse()).collect();
    let mut settings = ConnectSettings::new(endpoints.blame(ExitCode::WrongInput)?);
    settings.timeout = args.connect_timeout;
    let (link, _events) = ObserverLink::open(&settings).await.blame(ExitCode::PeerLost)?;
    let runs = link.runs().await.blame(ExitCode::PeerLost)?;
    link.close().await.blame(ExitCode::PeerLost)?;
    if runs.is_empty() {
        let error = anyhow::anyhow!(
            "someone answers at {}, but no learner is there",
            args.connect.join(", ")
        );
        return Err(Failure { code: ExitCode::PeerLost, error: Some(error) });
    }
    Ok(runs.iter().map(ToString::to_string).collect())
}
