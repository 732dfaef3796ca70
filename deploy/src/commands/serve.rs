//! `leadtime serve`: a policy at work, speaking to robots, cars and simulators over the network.

use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use leadtime_certs::Role;
use leadtime_learner::{lock_file, replaced_name};
use leadtime_link::ListenSettings;
use leadtime_link::live::{LiveServiceLink, OtherNotifier};
use leadtime_proto::phrase::counted;
use leadtime_proto::{ClientName, Incarnation, ServiceName};
use leadtime_runs::{Tasks, clock, regular, write_atomically};
use leadtime_serve::observation::{MAX_SEQ, MAX_TIME};
use leadtime_serve::{
    LiveService, MAX_SESSIONS, OpenRefusal, PolicyOrigin, ServiceSettings, StateStore,
    WorkingPolicy,
};
use leadtime_table::{Table, WIDTH, wrapped};
use leadtime_taxonomy::{MAX_FACTS, Taxonomy, shipped};
use leadtime_voice::loudspeaker::APLAY;
use leadtime_voice::{Loudspeaker, VoiceChoice};
use serde_json::{Value, json};

use super::robot_session::robot_session;
use super::{evaluation, taxonomy};
use crate::cli::ServeArgs;
use crate::credentials::{listen_settings, listening_failure};
use crate::ending::{Watch, watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

pub(super) async fn run(tasks: &Tasks, args: &ServeArgs) -> Result<(), Failure> {
    if !args.describe && args.listen.is_empty() && args.connect.is_empty() {
        let sentence = "nobody could reach the notifier: say where it listens (--listen tcp/127.0.0.1:7448), or which router \
                        it connects to (--connect tcp/HOST:7447)";
        return Err(Failure::input(sentence));
    }
    let policy = load(tasks, args)?;
    if args.describe {
        describe(&policy, args.json);
        return Ok(());
    }
    let settings = listen_settings(&args.listen, &args.connect, &args.guard, Role::Service);
    let settings: ListenSettings = settings.blame(ExitCode::WrongInput)?;
    let policy = with_voice(policy, args)?;
    let loudspeaker = loudspeaker(&policy, args)?;
    let store = args.state.as_deref().map(StateDirectory::open).transpose();
    let store = store.context("--state").blame(ExitCode::WrongInput)?;
    let shutdown = watch(Watch::Signals).blame(ExitCode::Failed)?;
    let own = clock::incarnation();
    let opened = LiveServiceLink::open(&settings, &args.service, own).await;
    let (link, events) = opened.map_err(listening_failure)?;
    check_alone(&link, &args.service, own, settings.identity.is_some()).await?;
    let (domain, service) = (policy.domain.clone(), &args.service);
    let sentences = counted(policy.n_sentences(), "sentence");
    let locators = link.locators().join(", ");
    let service_settings = ServiceSettings {
        max_sessions: match (args.max_sessions, &args.play) {
            (Some(n), _) => n as usize,
            // Two clients on one loudspeaker would talk over each other.
            (None, Some(_)) => 1,
            (None, None) => MAX_SESSIONS,
        },
        seed: args.seed,
        spins: !args.no_spin,
        store,
        loudspeaker,
        unix: i64::try_from(clock::now().as_nanosecond()).unwrap_or(i64::MAX),
    };
    let robot_session = robot_session(&args.robot, &domain, service, own, &link.zid());
    let robot_session = robot_session.context("--ros2-topic").blame(ExitCode::WrongInput)?;
    let notifier = LiveService::new(policy, service_settings, link, events, own);
    let mut notifier = notifier.blame(ExitCode::Failed)?;
    if let Some((robot_session, robot)) = robot_session {
        let client = robot_session.client.clone();
        notifier.stand(robot_session).map_err(|refusal| match refusal {
            OpenRefusal::Network(error) => Failure::of(ExitCode::WrongInput, error),
            refusal => Failure::of(ExitCode::WrongInput, refusal),
        })?;
        tracing::info!("listens to robot `{client}` on {robot}");
    }
    let place = if locators.is_empty() { args.connect.join(", ") } else { locators };
    tracing::info!("notifier `{service}` for {domain}, with {sentences}, is at work at {place}");
    notifier.run(shutdown.cancelled_owned()).await.map_err(listening_failure)
}

/// Refuses to speak beside another notifier of this name.
async fn check_alone(
    link: &LiveServiceLink,
    name: &ServiceName,
    own: Incarnation,
    is_guarded: bool,
) -> Result<(), Failure> {
    match link.other(own).await.map_err(listening_failure)? {
        OtherNotifier::Absent => Ok(()),
        OtherNotifier::Silent => {
            tracing::warn!("{}", silence(name, is_guarded));
            Ok(())
        }
        OtherNotifier::AtWork => Err(Failure::input(format!(
            "a notifier `{name}` is at work there already: choose another --service"
        ))),
    }
}

/// Says what another notifier of this name may be that does not answer. Nobody shows its presence without a certificate where they
/// are asked for.
fn silence(name: &ServiceName, is_guarded: bool) -> String {
    let remedy = if is_guarded {
        ". If it is one at work, two speak now: an access list that an older release wrote lets none ask the other; `leadtime \
         certs acl` writes it again"
    } else {
        " (see --tls)"
    };
    format!(
        "somebody shows the presence of a notifier `{name}` and does not answer as one: clients may take it for this one{remedy}"
    )
}

/// Loads the policy with its words.
pub(super) fn load(tasks: &Tasks, args: &ServeArgs) -> Result<WorkingPolicy, Failure> {
    let loaded = evaluation::load(tasks, &args.runs, &args.policy, &args.set);
    let loaded = loaded.blame(ExitCode::WrongInput)?;
    let config = &loaded.config;
    let environment = tasks.registry.build(&config.evaluation.task);
    let environment = environment.blame(ExitCode::WrongInput)?;
    let domain = config.domain.as_str();
    let choice = args.action.unwrap_or(config.evaluation.action);
    let words = words(args, domain)?;
    let policy = WorkingPolicy::new(
        domain,
        environment.as_ref(),
        &config.policy,
        &loaded.parameters,
        choice,
        words,
    );
    let policy = policy.blame(ExitCode::WrongInput)?;
    if args.voice != VoiceChoice::None && policy.n_sentences() == 0 {
        let error = leadtime_serve::UnfitPolicy::NoWords(domain.to_owned());
        return Err(error).blame(ExitCode::WrongInput);
    }
    let policy = policy.of_task(&config.evaluation.task.settings);
    let origin = PolicyOrigin {
        path: loaded.path.display().to_string(),
        sha256: loaded.sha256.clone(),
        changes: args.set.iter().map(ToString::to_string).collect(),
        action: choice,
        words: args.words_name(),
        voice: args.voice.to_string(),
    };
    Ok(policy.of_file(loaded.sha256.clone(), loaded.n_updates).put_to_work(origin))
}

/// Returns the sentences that are asked for, or those of the domain.
fn words(args: &ServeArgs, domain: &str) -> Result<Option<Taxonomy>, Failure> {
    match (&args.words, &args.voice) {
        (Some(_), VoiceChoice::None) => Err(Failure::input(
            "--voice none speaks no words: leave out --words, or choose another voice",
        )),
        (None, VoiceChoice::None) => Ok(None),
        (Some(name), _) => taxonomy::database(name).map(Some),
        (None, _) => Ok(shipped(domain).ok()),
    }
}

/// Lets the voice say every sentence, so that the times of their words, and with --play their sound, are known.
pub(super) fn with_voice(
    policy: WorkingPolicy,
    args: &ServeArgs,
) -> Result<WorkingPolicy, Failure> {
    let texts: Vec<&str> = policy.sentences().collect();
    let voice = leadtime_voice::prepare(&args.voice, &policy.domain, &texts, args.play.is_some());
    let voice = voice.blame(ExitCode::WrongInput)?;
    Ok(policy.with_voice(voice))
}

/// Starts what plays the sentences here, if that is asked for.
fn loudspeaker(policy: &WorkingPolicy, args: &ServeArgs) -> Result<Option<Loudspeaker>, Failure> {
    let Some(command) = &args.play else { return Ok(None) };
    let own = Some(command.as_str()).filter(|command| *command != APLAY);
    let rate = policy.voice().map_or(0, |voice| voice.rate);
    if rate == 0 {
        let told = format!("--play has nothing to play: --voice {} makes no sound", args.voice);
        return Err(Failure::input(told));
    }
    let started = Loudspeaker::start(own, rate).blame(ExitCode::WrongInput)?;
    Ok(Some(started))
}

/// Says what an observation consists of, and what can be said.
fn describe(policy: &WorkingPolicy, as_schema: bool) {
    if as_schema {
        output::json(&schema(policy));
        return;
    }
    let bound = |bound: f32| {
        if bound.is_finite() { bound.to_string() } else { String::new() }
    };
    let head = ["#", "number", "least", "greatest", "meaning"];
    let mut table = Table::new(head).left(&[1, 4]).flowing(4);
    for (i, quantity) in policy.observation().iter().enumerate() {
        let [low, high] = quantity.range.map(bound);
        table.push([i.to_string(), quantity.name.clone(), low, high, quantity.meaning.clone()]);
    }
    let (domain, n) = (&policy.domain, policy.obs_dim());
    output::line(&format!("One observation of {domain}: {}\n", counted(n, "number")));
    output::line(table.text_within(WIDTH).trim_end());
    let topics = format!("Topics: {}", policy.session.topics().join(", "));
    output::line(&format!("\n{}", wrapped(&topics, WIDTH, 4)));
    if policy.facts().is_empty() {
        return;
    }
    let mut facts = Table::new(["fact", "holds when"]).left(&[0, 1]).flowing(1);
    for fact in policy.facts() {
        facts.push([fact.name.to_owned(), fact.meaning.to_owned()]);
    }
    output::line("\nFacts that an observation may tell, for sentences that presuppose them:\n");
    output::line(facts.text_within(WIDTH).trim_end());
}

/// Describes an observation as a JSON Schema.
fn schema(policy: &WorkingPolicy) -> Value {
    let number = |quantity: &leadtime_sims::Quantity| {
        let mut number =
            json!({"type": "number", "title": quantity.name, "description": quantity.meaning});
        for (key, bound) in ["x-low", "x-high"].into_iter().zip(quantity.range) {
            if bound.is_finite() {
                number[key] = json!(bound);
            }
        }
        number
    };
    let n = policy.obs_dim();
    let facts: Vec<&str> = policy.facts().iter().map(|fact| fact.name).collect();
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": format!("observation of {}", policy.domain),
        "type": "object",
        "required": ["seq", "t", "obs"],
        "additionalProperties": false,
        "properties": {
            "seq": {"type": "integer", "minimum": 0, "maximum": MAX_SEQ},
            "t": {"type": "number", "minimum": 0, "maximum": MAX_TIME, "description": "the client's own clock, in seconds"},
            "obs": {
                "type": "array",
                "prefixItems": policy.observation().iter().map(number).collect::<Vec<_>>(),
                "minItems": n,
                "maxItems": n,
            },
            "episode": {"type": "integer", "minimum": 0},
            "end": {"type": "boolean"},
            "facts": {"type": "array", "items": {"type": "string"}, "examples": [facts], "maxItems": MAX_FACTS},
        },
    })
}

/// After how long the state of a client is removed that has not come back.
const STATE_LASTS: Duration = Duration::from_hours(24);
/// The most clients whose states are kept: where anybody may ask, anybody may invent names.
const MAX_STATES: usize = 1_024;
/// How the name of a state's file ends.
const STATE: &str = ".session";

/// A directory with a file for every client.
#[derive(Debug)]
struct StateDirectory {
    path: PathBuf,
    /// Held as long as the notifier works: another one would write its sessions over ours.
    _lock: File,
}

impl StateDirectory {
    fn open(path: &Path) -> anyhow::Result<Arc<dyn StateStore>> {
        fs::create_dir_all(path).with_context(|| format!("cannot make {}", path.display()))?;
        let lock = path.join(".lock");
        // What is old is removed there: it must not be another program's.
        if lock.symlink_metadata().is_err()
            && let Some(state) =
                states(path).with_context(|| format!("cannot read {}", path.display()))?.first()
        {
            anyhow::bail!(
                "{} is no notifier's, as there is no .lock beside it: choose another directory; if it is a copy of a notifier's \
                 states, make an empty .lock there",
                state.display()
            );
        }
        match lock_file(&lock) {
            Ok(lock) => Ok(Arc::new(Self { path: path.to_owned(), _lock: lock })),
            Err(TryLockError::WouldBlock) => Err(anyhow::anyhow!(
                "{} is another notifier's that is at work: give each a directory of its own",
                path.display()
            )),
            Err(TryLockError::Error(error)) => {
                Err(error).with_context(|| format!("cannot write into {}", path.display()))
            }
        }
    }

    fn file(&self, client: &ClientName) -> PathBuf {
        self.path.join(format!("{client}{STATE}"))
    }

    /// Lists the states that are too old or too many. Files of others are not touched.
    fn old_states(&self) -> io::Result<Vec<PathBuf>> {
        let aged = |path: PathBuf| clock::age(&path).map(|age| (age, path));
        let mut states: Vec<_> = states(&self.path)?.into_iter().filter_map(aged).collect();
        states.sort_unstable();
        let n_young = states.partition_point(|(age, _)| *age <= STATE_LASTS);
        Ok(states.split_off(n_young.min(MAX_STATES)).into_iter().map(|(_, path)| path).collect())
    }

    /// Removes the states that are too old or too many; returns how many.
    fn remove_old(&self) -> io::Result<usize> {
        let old = self.old_states()?;
        let mut removed = Ok(old.len());
        for path in &old {
            // One that cannot be removed keeps no other.
            removed = fs::remove_file(path).and(removed);
        }
        removed
    }
}

/// Lists the states in a directory, with what a killed notifier has left of one.
fn states(directory: &Path) -> io::Result<Vec<PathBuf>> {
    let mut states = Vec::new();
    for entry in fs::read_dir(directory)? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let client = replaced_name(&name).unwrap_or(&name).strip_suffix(STATE);
        let is_state = client.is_some_and(|client| ClientName::new(client).is_ok());
        if is_state && entry.file_type()?.is_file() {
            states.push(entry.path());
        }
    }
    Ok(states)
}

impl StateStore for StateDirectory {
    fn keep(&self, client: &ClientName, state: &[u8]) -> io::Result<()> {
        let file = self.file(client);
        let is_new = !file.exists();
        write_atomically(&file, state)?;
        if is_new {
            // If they cannot be removed, the next sweep says so.
            drop(self.remove_old());
        }
        Ok(())
    }

    fn find(&self, client: &ClientName) -> Option<Vec<u8>> {
        let file = self.file(client);
        let read = regular::read(&file);
        if let Err(error) = &read
            && error.kind() != ErrorKind::NotFound
        {
            let file = file.display();
            tracing::warn!("{file} cannot be read ({error}); `{client}` gets a new session");
        }
        read.ok()
    }

    fn forget(&self, client: &ClientName) -> io::Result<()> {
        match fs::remove_file(self.file(client)) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
            Ok(()) | Err(_) => Ok(()),
        }
    }

    fn sweep(&self) {
        let place = self.path.display();
        match self.remove_old() {
            Ok(0) => {}
            Ok(n) => {
                let n = counted(n, "state");
                tracing::info!("{n} of clients that have not come back removed from {place}");
            }
            Err(error) => tracing::warn!(%error, "old states in {place} cannot be removed"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_notifier_that_does_not_answer_is_no_strangers_where_certificates_are_asked_for() {
        let said = |is_guarded| silence(&ServiceName::new("n").unwrap(), is_guarded);
        assert!(said(false).ends_with("(see --tls)"));
        assert!(said(true).contains("an access list that an older release wrote"));
    }

    /// Writes a file that was changed so long ago.
    fn aged(path: &Path, age: Duration) {
        let file = File::create(path).unwrap();
        let now = file.metadata().unwrap().modified().unwrap();
        file.set_modified(now - age).unwrap();
    }

    fn names(path: &Path) -> Vec<String> {
        let names = fs::read_dir(path).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<String> = names.map(|name| name.into_string().unwrap()).collect();
        names.sort_unstable();
        names
    }

    #[test]
    fn the_states_of_clients_that_stay_away_are_removed_and_no_other_files() {
        let place = tempfile::tempdir().unwrap();
        let states = StateDirectory::open(place.path()).unwrap();
        for (name, hours) in [
            ("away.session", 25),
            ("away.session.12.partial", 25),
            ("here.session", 23),
            ("notes.txt", 99),
            ("No client.session", 99),
        ] {
            aged(&place.path().join(name), Duration::from_hours(hours));
        }
        states.sweep();
        let left = [".lock", "No client.session", "here.session", "notes.txt"];
        assert_eq!(names(place.path()), left);
    }

    #[test]
    fn however_many_names_are_invented_the_newest_states_stay() {
        let place = tempfile::tempdir().unwrap();
        let states = StateDirectory::open(place.path()).unwrap();
        let oldest = MAX_STATES - 1;
        for i in 0..MAX_STATES {
            let path = place.path().join(format!("client-{i}{STATE}"));
            aged(&path, Duration::from_secs(60 + i as u64));
        }
        states.keep(&ClientName::new("client-0").unwrap(), b"one that is there").unwrap();
        assert_eq!(names(place.path()).len(), 1 + MAX_STATES);
        states.keep(&ClientName::new("new").unwrap(), b"one more").unwrap();
        let names = names(place.path());
        assert_eq!(names.len(), 1 + MAX_STATES);
        assert!(names.contains(&"new.session".to_owned()));
        assert!(!names.contains(&format!("client-{oldest}{STATE}")));
    }

    #[test]
    fn a_lock_that_leads_elsewhere_is_refused_and_what_it_leads_to_is_left_alone() {
        let place = tempfile::tempdir().unwrap();
        let (states, other) = (place.path().join("states"), place.path().join("other"));
        fs::create_dir(&states).unwrap();
        fs::write(&other, "precious").unwrap();
        std::os::unix::fs::symlink(&other, states.join(".lock")).unwrap();
        let error = StateDirectory::open(&states).unwrap_err();
        assert!(format!("{error:#}").ends_with("states: .lock is a link"), "{error:#}");
        assert_eq!(fs::read_to_string(&other).unwrap(), "precious");
        fs::remove_file(states.join(".lock")).unwrap();
        let held = StateDirectory::open(&states).unwrap();
        let error = StateDirectory::open(&states).unwrap_err();
        assert!(error.to_string().contains("another notifier's that is at work"), "{error}");
        drop(held);
    }

    #[test]
    fn a_directory_of_another_program_is_refused_and_a_copy_of_a_notifiers_needs_a_lock() {
        let place = tempfile::tempdir().unwrap();
        let other = place.path().join("bot.session");
        aged(&other, Duration::from_hours(99));
        let error = StateDirectory::open(place.path()).unwrap_err().to_string();
        assert!(error.contains("bot.session is no notifier's, as there is no .lock"), "{error}");
        assert_eq!(names(place.path()), ["bot.session"]);
        File::create(place.path().join(".lock")).unwrap();
        StateDirectory::open(place.path()).unwrap();
    }
}
