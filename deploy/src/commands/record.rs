//! `leadtime record`: everything that a notifier at work sees and says, in a file.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufWriter;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use leadtime_certs::Role;
use leadtime_link::live::{LiveMessage, LiveRecorderLink, LiveSample, LiveTopic, SessionAsker};
use leadtime_process::NewFile;
use leadtime_proto::phrase::{counted, duration};
use leadtime_proto::{ClientName, ServiceName};
use leadtime_recording::{Error as RecordingError, LiveRecorder, MAX_READ_BYTES, RecordingWriter};
use leadtime_runs::clock;
use tokio::time::{MissedTickBehavior, interval, sleep};
use tokio_util::sync::CancellationToken;

use crate::cli::RecordArgs;
use crate::credentials::{dialling_failure, notifier_settings};
use crate::ending::{Watch, watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// How often what was recorded is handed to the disk: what a killed recorder may lose.
pub(super) const FLUSH_EVERY: Duration = Duration::from_secs(1);
/// The most sessions that are asked for at once.
const MAX_ASKED: usize = 64;
/// The shortest time between two looks at who has to be asked for: there may be many.
const ASK_PAUSE: Duration = Duration::from_millis(20);

pub(super) async fn run(args: &RecordArgs) -> Result<(), Failure> {
    let shutdown = watch(Watch::Signals).blame(ExitCode::Failed)?;
    let settings = notifier_settings(&args.connect, &args.notifier, &[Role::Recorder])?;
    let mut file = create(args)?;
    let open = LiveRecorderLink::open(&settings, &args.notifier.service, args.live.as_ref());
    let (link, samples) = tokio::select! {
        () = shutdown.cancelled() => return Err(Failure::silent(ExitCode::Interrupted)),
        opened = open => opened.map_err(dialling_failure)?,
    };
    let (writer, clock) = (begin(&mut file)?, RecordClock::start());
    let recorder = LiveRecorder::new(writer, args.notifier.service.clone());
    let (shown, service) = (args.output.display(), &args.notifier.service);
    tracing::info!("recording notifier `{service}` to {shown} until {}", end(args));
    stop_after(args, &shutdown);
    let mut recording = RunningRecording {
        link,
        samples,
        recorder,
        clock,
        service: service.clone(),
        is_gone: false,
        asked: BTreeSet::new(),
        asked_at: None,
        n_dropped: 0,
        n_passed_over: 0,
        is_large: false,
    };
    let ended = recording.run(&shutdown).await;
    let (n_messages, n_sessions) = recording.recorder.counts();
    // What was recorded is kept, whatever went wrong: with its index, if the disk takes one.
    let failure =
        ended.and(recording.recorder.writer().finish().map_err(RecordFailure::File)).err();
    drop(recording.link.close().await);
    let held = format!("{} of {}", counted(n_messages, "message"), counted(n_sessions, "session"));
    close(args, &held, failure)
}

/// Makes the file, which must not be there.
pub(super) fn create(args: &RecordArgs) -> Result<NewFile, Failure> {
    let file = NewFile::create(&args.output);
    let file = file.with_context(|| format!("cannot record to {}", args.output.display()));
    file.blame(ExitCode::WrongInput)
}

/// Says how many messages a count has more than was `told`, and takes them for told; `None` if there are none.
pub(super) fn newly(n: u64, told: &mut u64) -> Option<String> {
    let n_new = n.saturating_sub(std::mem::replace(told, n));
    (n_new > 0).then(|| counted(n_new, "message"))
}

/// Begins the file, which stays from now on.
pub(super) fn begin(file: &mut NewFile) -> Result<RecordingWriter<BufWriter<File>>, Failure> {
    let program = concat!("leadtime ", env!("CARGO_PKG_VERSION"));
    let out = BufWriter::new(file.handle().blame(ExitCode::WrongInput)?);
    let writer = RecordingWriter::new(out, program);
    let writer = writer.with_context(|| file.path().display().to_string());
    let writer = writer.blame(ExitCode::WrongInput)?;
    file.keep();
    Ok(writer)
}

/// Says until when it is recorded.
pub(super) fn end(args: &RecordArgs) -> String {
    let after = args.stop_after.map(|time| format!("{} from now, or ", duration(time)));
    format!("{}Ctrl-C", after.unwrap_or_default())
}

/// Ends the recording after the time that is asked for.
pub(super) fn stop_after(args: &RecordArgs, shutdown: &CancellationToken) {
    let (Some(time), stop) = (args.stop_after, shutdown.clone()) else { return };
    tokio::spawn(async move {
        sleep(time).await;
        stop.cancel();
    });
}

/// Says what the file holds, and why it ends if it should not.
pub(super) fn close(
    args: &RecordArgs,
    held: &str,
    failure: Option<RecordFailure>,
) -> Result<(), Failure> {
    let shown = args.output.display();
    match failure {
        None => {
            output::line(&format!("{shown}: {held}"));
            Ok(())
        }
        Some(RecordFailure::File(error)) => {
            let sentence = format!("{shown} ends here, with at most {held} that can be read");
            let error = anyhow::Error::new(error).context(sentence);
            Err(Failure::of(ExitCode::WrongInput, error))
        }
        Some(RecordFailure::Link(error)) => {
            let error = anyhow::Error::new(error).context(format!("{shown} ends with {held}"));
            Err(Failure::of(ExitCode::PeerLost, error))
        }
    }
}

/// Why a recording ends before it should.
pub(super) enum RecordFailure {
    File(RecordingError),
    Link(leadtime_link::Error),
}

impl From<RecordingError> for RecordFailure {
    fn from(error: RecordingError) -> Self {
        Self::File(error)
    }
}

impl From<leadtime_link::Error> for RecordFailure {
    fn from(error: leadtime_link::Error) -> Self {
        Self::Link(error)
    }
}

/// A client, and what the notifier says its session is; nothing if it did not answer.
type AskedSession = (ClientName, Option<Vec<u8>>);

/// A recording under way.
struct RunningRecording {
    link: LiveRecorderLink,
    samples: flume::Receiver<LiveSample>,
    recorder: LiveRecorder<BufWriter<File>>,
    clock: RecordClock,
    service: ServiceName,
    /// The notifier is not there.
    is_gone: bool,
    /// The clients whose session is being asked for.
    asked: BTreeSet<ClientName>,
    /// When it was looked last who has to be asked for.
    asked_at: Option<Instant>,
    n_dropped: u64,
    n_passed_over: u64,
    /// It was said that there is more than is read at a time.
    is_large: bool,
}

impl RunningRecording {
    async fn run(&mut self, stop: &CancellationToken) -> Result<(), RecordFailure> {
        let (sender, answers) = flume::bounded(MAX_ASKED);
        let asker = self.link.asker();
        let presence = self.link.presence().clone();
        let mut flushes = interval(FLUSH_EVERY);
        flushes.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                () = stop.cancelled() => return Ok(()),
                sample = self.samples.recv_async() => {
                    let Ok(sample) = sample else { return Ok(()) };
                    self.recorder.take(self.clock.at(sample.arrival.at), &sample)?;
                    if matches!(sample.topic, LiveTopic::Status | LiveTopic::Taken) {
                        self.ask(&asker, &sender);
                    }
                }
                change = presence.recv_async() => {
                    let Ok(change) = change else { return Ok(()) };
                    self.tell_presence(&change);
                }
                answer = answers.recv_async() => {
                    let Ok((client, answer)) = answer else { return Ok(()) };
                    self.asked.remove(&client);
                    if let Some(answer) = answer {
                        self.recorder.note(self.clock.at(Instant::now()), &client, &answer)?;
                    }
                }
                _ = flushes.tick() => {
                    self.recorder.writer().flush()?;
                    self.ask(&asker, &sender);
                    self.tell_dropped();
                    self.tell_size();
                    self.link.health().await?;
                }
            }
        }
    }

    /// Asks for sessions that are not known yet.
    fn ask(&mut self, asker: &SessionAsker, sender: &flume::Sender<AskedSession>) {
        let now = Instant::now();
        let is_due = self.asked_at.is_none_or(|at| now.saturating_duration_since(at) >= ASK_PAUSE);
        let n = MAX_ASKED.saturating_sub(self.asked.len());
        if !is_due || n == 0 {
            return;
        }
        self.asked_at = Some(now);
        for client in self.recorder.next_to_ask(self.clock.at(now), n, &self.asked) {
            self.asked.insert(client.clone());
            let (asker, sender) = (asker.clone(), sender.clone());
            tokio::spawn(async move {
                let answer = asker.ask(&client).await.ok();
                drop(sender.send_async((client, answer)).await);
            });
        }
    }

    /// Says that the notifier has gone, or is back.
    fn tell_presence(&mut self, change: &LiveMessage) {
        let service = &self.service;
        match change {
            LiveMessage::ServiceGone(_) => {
                self.is_gone = true;
                tracing::warn!(
                    "notifier `{service}` is gone: nothing is recorded until it is back"
                );
            }
            LiveMessage::ServiceHere(_) if std::mem::take(&mut self.is_gone) => {
                tracing::info!("notifier `{service}` is back");
            }
            _ => {}
        }
    }

    /// Says once that the file has become too large to be read as a whole.
    fn tell_size(&mut self) {
        let is_large = self.recorder.writer().n_bytes() > MAX_READ_BYTES;
        if is_large && !std::mem::replace(&mut self.is_large, true) {
            tracing::warn!(
                "there is more in the file than `replay` and `play` read at a time, {MAX_READ_BYTES} bytes of messages: they need --live CLIENT; of one client, record shorter pieces"
            );
        }
    }

    fn tell_dropped(&mut self) {
        if let Some(n_new) = newly(self.link.n_dropped(), &mut self.n_dropped) {
            tracing::warn!("{n_new} came faster than they can be written: not recorded");
        }
        if let Some(n_new) = newly(self.recorder.n_passed_over(), &mut self.n_passed_over) {
            tracing::warn!(
                "{n_new} came of more clients than a recording has room for, or than it has for those that the notifier has not described: not recorded"
            );
        }
    }
}

/// The clock of a recording: it shows the time of the wall clock at its beginning, and goes on however that is set meanwhile.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecordClock {
    began: Instant,
    /// What the wall clock showed then, in nanoseconds since 1970.
    unix: i128,
}

impl RecordClock {
    /// Starts the clock.
    pub(super) fn start() -> Self {
        Self { began: Instant::now(), unix: clock::now().as_nanosecond() }
    }

    /// Returns when something arrived, in nanoseconds since 1970.
    pub(super) fn at(self, moment: Instant) -> u64 {
        let signed = |time: Duration| i128::try_from(time.as_nanos()).unwrap_or(i128::MAX);
        // What arrived before the file was begun was waiting.
        let after = signed(moment.saturating_duration_since(self.began));
        let before = signed(self.began.saturating_duration_since(moment));
        u64::try_from(self.unix + after - before).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_of_a_recording_goes_on_whatever_the_wall_clock_says() {
        let second = Duration::from_secs(1);
        let began = Instant::now() + second;
        // Other than the wall clock of today: one that was set since.
        let clock = RecordClock { began, unix: 48_000_000_000 };
        assert_eq!(clock.at(began), 48_000_000_000);
        assert_eq!(clock.at(began + second), 49_000_000_000);
        assert_eq!(clock.at(began.checked_sub(second).unwrap()), 47_000_000_000);
    }
}
