//! `leadtime replay`: the observations of a recording again, and whether the same is said.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use leadtime_certs::Role;
use leadtime_link::live::LiveClientLink;
use leadtime_proto::phrase::counted;
use leadtime_recording::{
    Error as RecordingError, RecordedInput, RecordedSession, ReplayDifference, ReplayOutcome,
    ReplayTarget, SessionAtHand, SessionOverNetwork, StartedMessage, Stretch, check_for_network,
    replay,
};
use leadtime_runs::{Tasks, clock};
use leadtime_serve::{
    HeardSay, PolicyOrigin, SayEvent, SayForm, SessionNote, StepClock, WordClock, WorkingPolicy,
    told_voice,
};
use leadtime_table::{Table, beginning, columns};
use leadtime_voice::VoiceChoice;
use serde_json::{Value, json};
use tokio::runtime::Handle;
use tokio_util::sync::CancellationToken;

use super::{drive, recorded, serve};
use crate::cli::{ReplayArgs, ReplaySpeed, ServeArgs};
use crate::credentials::{dialling_failure, notifier_settings};
use crate::ending::{Watch, unless_cancelled, watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, WIDTH};

/// The most messages that stand side by side.
const MAX_ROWS: usize = 24;
/// How wide each of two messages beside each other may be.
const MESSAGE_WIDTH: usize = 30;

pub(super) async fn run(tasks: &Tasks, args: &ReplayArgs) -> Result<(), Failure> {
    if args.connect.is_empty() && args.notifier.tls.tls.is_some() {
        return Err(Failure::input("--tls: nobody is asked without --connect"));
    }
    let shutdown = watch(Watch::Signals).blame(ExitCode::Failed)?;
    let sessions = recorded::read(&args.file, args.live.as_ref())?;
    let pace = ReplayPace { speed: args.speed, is_told: !args.json, stop: shutdown.clone() };
    let played = if args.connect.is_empty() {
        let policies = Policies { tasks: tasks.clone(), args: args.clone(), known: Vec::new() };
        unless_cancelled(&shutdown, move || at_hand(sessions, policies, &pace)).await?
    } else {
        let settings = notifier_settings(&args.connect, &args.notifier, &[Role::Robot])?;
        let link = LiveClientLink::open(&settings).await.map_err(dialling_failure)?;
        link.find(&args.notifier.service).await.map_err(dialling_failure)?;
        let client = drive::own_name(args.client.as_ref(), &settings, "replay")?;
        let port = link.port(&args.notifier.service, &client, clock::incarnation());
        let target = SessionOverNetwork::new(port.map_err(dialling_failure)?);
        let work = move || over_network(sessions, target, &pace);
        let played = unless_cancelled(&shutdown, work).await?;
        drop(link.close().await);
        played
    };
    show(&played, args)
}

/// A session that was replayed.
struct PlayedSession {
    session: RecordedSession,
    /// The policy, its words and its settings are those of the recording; of a notifier over the network, as far as it tells a client.
    is_same: bool,
    /// The voice is another one, and words end in its time: what is said differs for no fault of the policy.
    other_voice: Option<OtherVoice>,
    outcome: ReplayOutcome,
}

impl PlayedSession {
    /// Tells whether the same has to be said.
    fn is_comparable(&self) -> bool {
        self.is_same && self.other_voice.is_none()
    }
}

/// Two voices, as a person names them.
struct OtherVoice {
    recorded: String,
    given: String,
}

impl OtherVoice {
    /// Finds out whether a session is replayed with another voice than it was recorded with, and depends on it.
    fn of(
        session: &RecordedSession,
        note: &SessionNote,
        given: Option<&VoiceChoice>,
        policy: &WorkingPolicy,
    ) -> Option<Self> {
        let is_by_steps = note.question["word_clock"] == json!(WordClock::Steps);
        let is_timed = session.clock() != Some(StepClock::Observation) && !is_by_steps;
        if !is_timed {
            return None;
        }
        let recorded = note.policy.voice.clone();
        let given = given.map_or_else(|| recorded.clone(), ToString::to_string);
        if recorded != given {
            return Some(Self { recorded, given });
        }
        // The same voice measures less where what it needs is not there.
        let (then, now) = (note.answer["voice"]["estimated"].as_u64()?, policy.voice()?);
        let now = now.n_estimated() as u64;
        let told =
            |n: u64| format!("{recorded}, the times of {} estimated", counted(n, "sentence"));
        (then != now).then(|| Self { recorded: told(then), given: told(now) })
    }
}

/// How fast inputs follow each other.
struct ReplayPace {
    speed: ReplaySpeed,
    /// What was said is printed when it was said.
    is_told: bool,
    stop: CancellationToken,
}

impl ReplayPace {
    /// Replays a stretch at this pace, until it ends or the command is stopped.
    fn replay(
        &self,
        stretch: &Stretch,
        target: &mut impl ReplayTarget,
    ) -> Result<ReplayOutcome, RecordingError> {
        let began = Instant::now();
        let first = stretch.inputs.first().map_or(0, |input| input.now);
        replay(stretch, target, |input| {
            if self.speed == ReplaySpeed::AsRecorded {
                let after = Duration::from_nanos(input.now.saturating_sub(first));
                thread::sleep((began + after).saturating_duration_since(Instant::now()));
                if self.is_told {
                    say(input, after);
                }
            }
            !self.stop.is_cancelled()
        })
    }
}

/// Prints what was said, when it was said.
fn say(input: &RecordedInput, after: Duration) {
    for event in input.events.iter().filter(|event| event.event == SayEvent::Start) {
        let shown = cell(Some(&StartedMessage::of(event, event.episode)), WIDTH - 12);
        output::line(&format!("{:9.2} s  {shown}", after.as_secs_f64()));
    }
}

/// The policies that sessions are replayed with, each loaded once.
struct Policies {
    tasks: Tasks,
    args: ReplayArgs,
    known: Vec<(PolicyOrigin, Arc<WorkingPolicy>)>,
}

impl Policies {
    /// Returns the policy that a session is replayed with, and whether it is that of the recording.
    fn of(&mut self, note: &SessionNote) -> Result<(Arc<WorkingPolicy>, bool), Failure> {
        let found = self.known.iter().find(|(origin, _)| *origin == note.policy);
        let policy = if let Some((_, policy)) = found {
            Arc::clone(policy)
        } else {
            let policy = Arc::new(self.load(&note.policy)?);
            self.known.push((note.policy.clone(), Arc::clone(&policy)));
            policy
        };
        let is_file = policy.sha256 == note.policy.sha256;
        let is_same = is_file && policy.has_words(note.words_checksum);
        if self.args.policy.is_none() && !is_same {
            let (path, sha256) = (&note.policy.path, &note.policy.sha256);
            let what = if is_file { "its words are others" } else { "it is another policy" };
            return Err(Failure::input(format!(
                "{path}: {what} by now; the recording was made with SHA-256 {sha256}: name that file with --policy"
            )));
        }
        Ok((policy, is_same))
    }

    fn load(&self, origin: &PolicyOrigin) -> Result<WorkingPolicy, Failure> {
        let path = self.args.policy.as_deref().unwrap_or(Path::new(&origin.path));
        if self.args.policy.is_none() && !path.exists() {
            let sha256 = &origin.sha256;
            return Err(Failure::input(format!(
                "the policy of the recording is not where it was, {}: name the file with SHA-256 {sha256} by --policy",
                path.display()
            )));
        }
        // Of a command and of a directory a recording has the kind alone; one that has more must not be able to start a command.
        let voice = match (&self.args.voice, told_voice(&origin.voice)) {
            (Some(given), _) => given.clone(),
            (None, kind @ ("pipe" | "recorded")) => {
                return Err(Failure::input(format!(
                    "the voice of the recording is of the kind `{kind}`, and what belongs to it is on the machine of its notifier: \
                     give it with --voice, or `--voice text` if every observation was a step"
                )));
            }
            (None, name) => name.parse::<VoiceChoice>().blame(ExitCode::WrongInput)?,
        };
        let args = ServeArgs::of_origin(path, origin, &voice, &self.args.runs);
        let args = args.map_err(|error| Failure::input(error.kind().to_string()))?;
        serve::with_voice(serve::load(&self.tasks, &args)?, &args)
    }
}

fn at_hand(
    sessions: Vec<RecordedSession>,
    mut policies: Policies,
    pace: &ReplayPace,
) -> Result<Vec<PlayedSession>, Failure> {
    let play = |mut session: RecordedSession| {
        let Some(note) = &session.note else { return Ok(unplayed(session)) };
        let (policy, is_same) = policies.of(note)?;
        let mut outcome = ReplayOutcome::default();
        // Large, and not needed any more.
        for stretch in std::mem::take(&mut session.stretches) {
            let target = SessionAtHand::open(note, &policy, &stretch, is_same);
            let mut target = target.blame(ExitCode::WrongInput)?;
            outcome.add(pace.replay(&stretch, &mut target).map_err(failure)?);
        }
        let other_voice = OtherVoice::of(&session, note, policies.args.voice.as_ref(), &policy);
        Ok(PlayedSession { session, is_same, other_voice, outcome })
    };
    sessions.into_iter().map(play).collect()
}

fn over_network(
    sessions: Vec<RecordedSession>,
    mut target: SessionOverNetwork,
    pace: &ReplayPace,
) -> Result<Vec<PlayedSession>, Failure> {
    let (runtime, mut n_opened) = (Handle::current(), 0);
    let play = |mut session: RecordedSession| {
        let Some(clock) = session.clock() else { return Ok(unplayed(session)) };
        let stretches = std::mem::take(&mut session.stretches).into_iter();
        let Some(note) = &session.note else { return Ok(unplayed(session)) };
        let about = || format!("session {} of {}", session.id, session.client);
        let stretches: Vec<_> = stretches.map(Stretch::up_to_last_observation).collect();
        let check = check_for_network(clock, &stretches).with_context(about);
        check.blame(ExitCode::WrongInput)?;
        let (mut outcome, mut is_same) = (ReplayOutcome::default(), true);
        for stretch in &stretches {
            n_opened += 1;
            let answer = runtime.block_on(target.open(note, n_opened)).map_err(failure)?;
            is_same &= answer["policy"]["sha256"] == note.policy.sha256.as_str();
            is_same &= is_answer_same(&answer, note);
            outcome.add(pace.replay(stretch, &mut target).map_err(failure)?);
        }
        let other_voice = None;
        Ok(PlayedSession { session, is_same, other_voice, outcome })
    };
    sessions.into_iter().map(play).collect()
}

/// Returns whether a client is told the same of the settings and of the words. One that reads few bytes is told no settings.
fn is_answer_same(answer: &Value, note: &SessionNote) -> bool {
    let is_brief = note.question["encoding"] == json!(SayForm::Binary);
    let is_told = |it: &&str| !(is_brief && answer[*it].is_null());
    let mut told = ["task", "topics", "sentences"].into_iter().filter(is_told);
    told.all(|it| answer[it] == note.answer[it])
}

/// A session of which it is not known what it was.
fn unplayed(session: RecordedSession) -> PlayedSession {
    let outcome = ReplayOutcome::default();
    PlayedSession { session, is_same: false, other_voice: None, outcome }
}

fn failure(error: RecordingError) -> Failure {
    use leadtime_serve::ClientError;
    match error {
        RecordingError::Client(ClientError::Link(error)) => dialling_failure(error),
        error @ RecordingError::Client(_) => Failure::of(ExitCode::PeerLost, error),
        error => Failure::of(ExitCode::WrongInput, error),
    }
}

/// Prints what came out; a difference where none may be is a failed check.
fn show(played: &[PlayedSession], args: &ReplayArgs) -> Result<(), Failure> {
    if args.json {
        let sessions: Vec<Value> = played.iter().map(as_json).collect();
        output::json(&json!({ "sessions": sessions }));
    } else {
        played.iter().for_each(show_session);
    }
    let n_fed: u64 = played.iter().map(|it| it.outcome.n_observations).sum();
    if n_fed == 0 {
        let file = args.file.display();
        return Err(Failure::input(format!("nothing in {file} can be replayed")));
    }
    let differs = |it: &&PlayedSession| it.is_comparable() && it.outcome.difference.is_some();
    match played.iter().filter(differs).count() {
        0 => Ok(()),
        n => {
            let sentence =
                format!("in {}, something else is said than was recorded", counted(n, "session"));
            Err(Failure::of(ExitCode::Failed, anyhow::Error::msg(sentence)))
        }
    }
}

fn show_session(played: &PlayedSession) {
    let PlayedSession { session, outcome, .. } = played;
    let n = counted(outcome.n_observations, "observation");
    output::line(&format!("{}, session {}: {n} replayed", session.client, session.id));
    for (gap, n) in &session.gaps {
        let times = if *n > 1 { format!(" ({n} times)") } else { String::new() };
        output::line(&format!("  {}{times}", gap.as_str()));
    }
    if session.note.is_none() {
        output::line("  what the session was is not in the recording: nothing can be compared");
        return;
    }
    if session.n_apart > 0 {
        let n = counted(session.n_apart, "observation");
        output::line(&format!("  {n} before the next beginning cannot be compared"));
    }
    if outcome.n_lost > 0 {
        let n = counted(outcome.n_lost, "event");
        output::line(&format!("  the recording lacks {n}"));
    }
    if outcome.n_observations == 0 {
        return;
    }
    if let Some(OtherVoice { recorded, given }) = &played.other_voice {
        let said = "is replayed with another voice, and words end in its time";
        output::line(&format!("  what was recorded with the voice {recorded} {said}: {given}"));
    }
    if played.is_comparable() {
        show_check(outcome);
    } else {
        show_beside(outcome);
    }
}

/// Says whether the same policy says the same.
fn show_check(outcome: &ReplayOutcome) {
    let messages = counted(outcome.replayed.n_messages, "message");
    let events = counted(outcome.n_events, "event");
    let Some(difference) = &outcome.difference else {
        if outcome.n_events == 0 {
            output::line("  no event could be compared");
            return;
        }
        output::line(&format!("  the same is said, event by event: {messages}, {events}"));
        return;
    };
    let ReplayDifference { seq, episode, recorded, replayed } = difference;
    output::line(&format!("  the first difference: observation {seq}, episode {episode}"));
    for (who, events) in [("recorded", recorded), ("replayed", replayed)] {
        let events: Vec<String> = events.iter().map(described).collect();
        let shown = if events.is_empty() { "nothing".to_owned() } else { events.join("; ") };
        output::line(&format!("    {who}  {}", shortened(&shown, WIDTH - 14)));
    }
}

fn described(event: &HeardSay) -> String {
    let name = json!(event.event);
    let name = name.as_str().unwrap_or_default();
    if event.event == SayEvent::Silent {
        return format!("step {}: {name}", event.step);
    }
    let message = cell(Some(&StartedMessage::of(event, event.episode)), WIDTH);
    format!("step {}: {name} {message}, {} heard", event.step, event.heard)
}

/// Shows what another policy would have said beside what was said.
fn show_beside(outcome: &ReplayOutcome) {
    let mut table = Table::new(["", "recorded", "replayed"]);
    let (recorded, replayed) = (&outcome.recorded, &outcome.replayed);
    let mean = |mean: Option<f64>| mean.map_or_else(|| "-".to_owned(), |it| format!("{it:.2}"));
    let row = |name: &str, a: String, b: String| [name.to_owned(), a, b];
    let count = |n: u64| n.to_string();
    table.push(row("messages", count(recorded.n_messages), count(replayed.n_messages)));
    table.push(row("cut", count(recorded.n_cut), count(replayed.n_cut)));
    table.push(row("mean k", mean(recorded.mean_k()), mean(replayed.mean_k())));
    table.push(row("mean l", mean(recorded.mean_l()), mean(replayed.mean_l())));
    output::line(&format!("\n{}", table.text().trim_end()));
    let is_other = |pair: &&[Option<StartedMessage>; 2]| pair[0] != pair[1];
    let others: Vec<_> = outcome.pairs.iter().filter(is_other).collect();
    let n_same = outcome.pairs.len() - others.len();
    output::line(&format!("\n{} the same, {} other:\n", counted(n_same, "message"), others.len()));
    let mut table = Table::new(["episode", "step", "recorded (k, l)", "replayed (k, l)"]);
    table = table.left(&[2, 3]);
    for pair in others.iter().take(MAX_ROWS) {
        let Some(one) = pair.iter().flatten().next() else { continue };
        let [a, b] = pair.each_ref().map(|it| cell(it.as_ref(), MESSAGE_WIDTH));
        table.push([one.episode.to_string(), one.step.to_string(), a, b]);
    }
    output::line(table.text_within(WIDTH).trim_end());
    if others.len() > MAX_ROWS {
        output::line(&format!("and {} more", others.len() - MAX_ROWS));
    }
    output::line(
        "\nBoth are for the observations of the recording. Had the other one spoken, the\n\
         listener might have done something else, and seen something else.",
    );
}

/// Writes a message with its k and l, in so many columns at most.
fn cell(message: Option<&StartedMessage>, width: usize) -> String {
    let Some(StartedMessage { topic, k, l, text, .. }) = message else { return "-".to_owned() };
    let numbers = format!(" ({k}, {l})");
    let text = if text.is_empty() { topic } else { &**text };
    shortened(text, width.saturating_sub(numbers.len())) + &numbers
}

fn shortened(text: &str, width: usize) -> String {
    if columns(text) <= width {
        return text.to_owned();
    }
    format!("{}\u{2026}", beginning(text, width.saturating_sub(1)).trim_end())
}

fn as_json(played: &PlayedSession) -> Value {
    let PlayedSession { session, is_same, other_voice, outcome } = played;
    let tally = |of: &leadtime_recording::MessageTally| json!({"messages": of.n_messages, "cut": of.n_cut, "mean_k": of.mean_k(), "mean_l": of.mean_l()});
    let gaps: BTreeMap<&str, usize> =
        session.gaps.iter().map(|(gap, n)| (gap.as_str(), *n)).collect();
    let difference = outcome.difference.as_ref().map(|it| {
        let list = |events: &[HeardSay]| events.iter().map(described).collect::<Vec<_>>();
        json!({
            "seq": it.seq, "episode": it.episode, "recorded": list(&it.recorded), "replayed": list(&it.replayed),
        })
    });
    json!({
        "client": session.client,
        "session": session.id,
        "notifier_start": session.start,
        "is_same_policy": is_same,
        "is_same_voice": other_voice.is_none(),
        "observations": outcome.n_observations,
        "observations_not_compared": session.n_apart,
        "gaps": gaps,
        "events": outcome.n_events,
        "events_lost": outcome.n_lost,
        "recorded": tally(&outcome.recorded),
        "replayed": tally(&outcome.replayed),
        "difference": difference,
    })
}
