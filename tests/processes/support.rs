//! What the process tests share: starting the program, waiting for a condition, looking at runs and processes.
//!
//! Every wait has a condition and a time-out; nothing sleeps in the hope that something has happened meanwhile. Each
//! test has a directory of its own, and addresses are unix sockets in it.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use leadtime_link::{ActorEvent, ActorLink, ConnectSettings, Endpoint, Events, StartKey};
use leadtime_proto::message::Hello;
use leadtime_proto::{ActorId, fakes};
use serde_json::Value;
use tempfile::TempDir;

/// The exit codes of a failed check, of wrong input and of a peer that is not there.
pub(crate) const FAILED: i32 = 1;
pub(crate) const WRONG_INPUT: i32 = 2;
pub(crate) const PEER_LOST: i32 = 3;

/// The longest that anything in these tests may take.
pub(crate) const PATIENCE: Duration = Duration::from_mins(1);
/// The longest wait for one message, and what tells a promise of seconds from a wait in vain on a busy machine.
pub(crate) const SOON: Duration = Duration::from_secs(20);
/// A process that is asked to end and does not is ended after 4.4 seconds: what ends sooner has done so by itself.
pub(crate) const BEFORE_DEADLINE: Duration = Duration::from_secs(4);
/// Pause between two looks at a condition.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// A place of one's own for a test: runs, sockets, files.
pub(crate) struct Place(TempDir);

impl Place {
    /// Makes one; its path is short enough for sockets.
    pub(crate) fn new() -> Self {
        let dir = tempfile::Builder::new().prefix("lt-").tempdir_in("/tmp");
        Self(dir.expect("a temporary directory can be made"))
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }

    /// Returns a file in it as text.
    pub(crate) fn file(&self, name: &str) -> String {
        self.0.path().join(name).to_str().expect("paths are UTF-8").to_owned()
    }

    /// Writes a file and returns its path.
    pub(crate) fn write(&self, name: &str, text: &str) -> String {
        let path = self.file(name);
        fs::write(&path, text).expect("the file can be written");
        path
    }

    /// Returns an address that nobody else uses.
    pub(crate) fn endpoint(&self, name: &str) -> String {
        format!("unixsock-stream/{}", self.file(&format!("{name}.sock")))
    }

    pub(crate) fn run(&self, name: &str) -> PathBuf {
        self.0.path().join("runs").join(name)
    }

    /// Prepares the program, to be run in this place; each text is one argument, or several with a space between.
    pub(crate) fn program(&self, args: &[&str]) -> Command {
        self.program_at(Path::new(env!("CARGO_BIN_EXE_leadtime")), args)
    }

    /// Makes a copy of the program, which may be replaced or removed.
    pub(crate) fn copy_of_program(&self, name: &str) -> PathBuf {
        self.executable(name, Path::new(env!("CARGO_BIN_EXE_leadtime")))
    }

    /// Makes a program in this place of a file.
    ///
    /// Another process writes it: a file that is open for writing cannot be executed, and what this process writes is open
    /// for a moment in every process that another test is just starting.
    pub(crate) fn executable(&self, name: &str, file: &Path) -> PathBuf {
        let made = self.path().join(name);
        let status = Command::new("install").args(["-m", "755"]).arg(file).arg(&made).status();
        assert!(status.expect("install(1) is there").success(), "{name} can be made");
        made
    }

    /// As [`Place::program`], for a copy of it.
    pub(crate) fn program_at(&self, program: &Path, args: &[&str]) -> Command {
        let mut command = Command::new(program);
        command.args(args.iter().flat_map(|text| text.split_whitespace())).current_dir(self.path());
        command.env_remove("RUST_LOG");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Runs the program to its end.
    pub(crate) fn finish(&self, args: &[&str]) -> Finished {
        self.start(args).finish(PATIENCE)
    }

    /// Starts the program; its output is collected in files, so that it never waits for a reader.
    pub(crate) fn start(&self, args: &[&str]) -> Running {
        self.start_with(self.program(args))
    }

    /// As [`Place::start`], for a prepared command.
    pub(crate) fn start_with(&self, command: Command) -> Running {
        self.start_to(command, None, None)
    }

    /// As [`Place::start_with`], with standard output or standard error going somewhere else.
    pub(crate) fn start_to(
        &self,
        mut command: Command,
        stdout: Option<&str>,
        stderr: Option<&str>,
    ) -> Running {
        let log = || {
            let log = tempfile::Builder::new().prefix("log-").tempfile_in(self.path());
            log.and_then(|log| Ok(log.keep()?)).expect("a log can be made")
        };
        let ((out, out_path), (err, err_path)) = (log(), log());
        let elsewhere = |path: &str| fs::File::options().write(true).open(path);
        let elsewhere = |path: &str| elsewhere(path).expect("the file can be opened");
        command.stdout(stdout.map_or(out, elsewhere)).stderr(stderr.map_or(err, elsewhere));
        let child = command.spawn().expect("the program starts");
        Running { child, out: out_path, err: err_path }
    }
}

/// Returns a file of the repository.
pub(crate) fn repository(path: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("deploy lies in it");
    root.join(path).to_str().expect("paths are UTF-8").to_owned()
}

/// Lists the checkpoints of a run, the oldest first.
pub(crate) fn checkpoints(run: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(run.join("checkpoints")).expect("the run has checkpoints");
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "checkpoint"));
    files.sort();
    files
}

/// How a process ended and what it said.
#[derive(Debug)]
pub(crate) struct Finished {
    /// Exit code; `None` if it was killed.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl Finished {
    /// Asserts the exit code and returns the rest.
    #[track_caller]
    pub(crate) fn with_code(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "stdout: {}\nstderr: {}", self.stdout, self.stderr);
        self
    }

    /// Asserts that standard error holds each of the texts, in any order.
    #[track_caller]
    pub(crate) fn saying(self, texts: &[&str]) -> Self {
        for text in texts {
            assert!(self.stderr.contains(text), "`{text}` is not in: {}", self.stderr);
        }
        self
    }

    /// Reads standard output as one JSON value.
    #[track_caller]
    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}: {}", self.stdout))
    }
}

/// Returns the weights and the number of updates that a learner prints at its end.
#[track_caller]
pub(crate) fn outcome(learner: &Finished) -> (String, String) {
    let line = |name: &str| {
        let line = learner.stdout.lines().find_map(|line| line.strip_prefix(name));
        line.unwrap_or_else(|| panic!("no {name} in: {}", learner.stdout)).trim().to_owned()
    };
    let n_updates = line("updates").split(' ').next().expect("a number").to_owned();
    (line("weights"), n_updates)
}

/// A started process; killed if the test lets go of it.
pub(crate) struct Running {
    child: Child,
    out: PathBuf,
    err: PathBuf,
}

impl Running {
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Returns what it has said on standard error so far.
    pub(crate) fn stderr(&self) -> String {
        fs::read_to_string(&self.err).unwrap_or_default()
    }

    /// Returns how often it has said these words on standard error.
    pub(crate) fn n_said(&self, words: &str) -> usize {
        self.stderr().matches(words).count()
    }

    /// Returns what it has printed so far.
    pub(crate) fn stdout(&self) -> String {
        fs::read_to_string(&self.out).unwrap_or_default()
    }

    pub(crate) fn is_running(&mut self) -> bool {
        self.child.try_wait().expect("a child can be waited for").is_none()
    }

    /// Waits for its end.
    #[track_caller]
    pub(crate) fn finish(mut self, patience: Duration) -> Finished {
        let deadline = Instant::now() + patience;
        while self.is_running() {
            assert!(Instant::now() < deadline, "it did not end: {}", self.stderr());
            thread::sleep(LOOK_EVERY);
        }
        let code = self.child.wait().expect("a child can be waited for").code();
        let text = |path: &Path| fs::read_to_string(path).unwrap_or_default();
        Finished { code, stdout: text(&self.out), stderr: text(&self.err) }
    }

    /// Kills it at once, as `kill -9` does, and waits until it is gone.
    pub(crate) fn kill(mut self) {
        self.child.kill().expect("a child can be killed");
        self.child.wait().expect("a child can be waited for");
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if self.is_running() {
            drop(self.child.kill());
            drop(self.child.wait());
        }
    }
}

/// Waits until a run has made so many updates.
#[track_caller]
pub(crate) fn wait_for_updates(run: &Path, n_updates: u64) {
    wait_until("the run is under way", PATIENCE, || updates(run) >= n_updates);
}

/// Waits until a process says something on standard error.
#[track_caller]
pub(crate) fn wait_for_words(process: &Running, words: &str) {
    wait_until(words, PATIENCE, || process.stderr().contains(words));
}

#[track_caller]
pub(crate) fn wait_until(what: &str, patience: Duration, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + patience;
    while !condition() {
        assert!(Instant::now() < deadline, "waited {patience:?} in vain: {what}");
        thread::sleep(LOOK_EVERY);
    }
}

/// Sends a signal by name, such as `KILL` or `TERM`, to a process that is not our child.
pub(crate) fn signal(name: &str, id: u32) {
    let status = Command::new("kill").args([&format!("-{name}"), &id.to_string()]).status();
    assert!(status.expect("kill runs").success(), "process {id} cannot be signalled");
}

/// Lists the children of a process.
pub(crate) fn children(id: u32) -> Vec<u32> {
    let Ok(entries) = fs::read_dir("/proc") else { return Vec::new() };
    let ids = entries.filter_map(Result::ok).filter_map(|e| e.file_name().to_str()?.parse().ok());
    ids.filter(|child| parent(*child) == Some(id)).collect()
}

fn parent(id: u32) -> Option<u32> {
    let status = fs::read_to_string(format!("/proc/{id}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("PPid:"))?;
    line.trim().parse().ok()
}

/// Tells whether a process exists and is no zombie.
pub(crate) fn is_alive(id: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{id}/status")).unwrap_or_default();
    status.lines().any(|line| line.starts_with("State:") && !line.contains('Z'))
}

/// Returns the arguments of a process, joined by spaces.
pub(crate) fn arguments(id: u32) -> String {
    fs::read_to_string(format!("/proc/{id}/cmdline")).unwrap_or_default().replace('\0', " ")
}

/// Returns the learner and the two actors of a supervisor, once all are there.
pub(crate) fn family(id: u32) -> (u32, Vec<u32>) {
    let mut found = (0, Vec::new());
    wait_until("learner and actors are there", PATIENCE, || {
        let with = |word: &str| {
            let named = |child: &u32| arguments(*child).contains(word);
            children(id).into_iter().filter(named).collect::<Vec<_>>()
        };
        let (learners, actors) = (with(" learner "), with(" actor "));
        found = (learners.first().copied().unwrap_or(0), actors);
        found.0 != 0 && found.1.len() == 2
    });
    found
}

/// Returns the number of updates that a run has written to its journal.
pub(crate) fn updates(run: &Path) -> u64 {
    let journal = fs::read_to_string(run.join("metrics.jsonl")).unwrap_or_default();
    let last = journal.lines().rev().find_map(|line| serde_json::from_str::<Value>(line).ok());
    last.and_then(|line| line["update"].as_u64()).unwrap_or(0)
}

/// Returns the number of every update in a run's journal.
pub(crate) fn journal(run: &Path) -> Vec<u64> {
    let journal = fs::read_to_string(run.join("metrics.jsonl")).expect("the run has a journal");
    let number = |line: &str| serde_json::from_str::<Value>(line).ok()?["update"].as_u64();
    journal.lines().map(|line| number(line).expect("every line has its update")).collect()
}

pub(crate) fn record(run: &Path) -> Value {
    let text = fs::read_to_string(run.join("run.json")).expect("the run has a record");
    serde_json::from_str(&text).expect("the record is JSON")
}

/// Returns the result in a run's record; null while it is unfinished.
pub(crate) fn result(run: &Path) -> Value {
    record(run)["result"].clone()
}

/// How a client is driven that is recorded. Nobody waits for a recorder, and at full speed a busy machine may leave something out
/// on the way to it.
pub(crate) const PACE: &str = "--clock observation --seconds-per-step 0.03";

/// Returns what a replay finds missing in a session, but for one message in twenty, which a machine with too much to do may leave
/// out at any pace: that is told as well.
pub(crate) fn gaps(session: &Value) -> Vec<&str> {
    let count = |value: &Value| value.as_u64().expect("a replay tells how many");
    let n_all = count(&session["observations"]) + count(&session["observations_not_compared"]);
    let gaps = session["gaps"].as_object().expect("a replay tells the gaps");
    let told = gaps.iter().filter(|(gap, n)| {
        let n_allowed = if gap.contains("missing") { n_all.div_ceil(20) } else { 0 };
        count(n) > n_allowed
    });
    told.map(|(gap, _)| gap.as_str()).collect()
}

/// Opens the link of an actor that the test plays itself, and returns with it the hello that it may say.
pub(crate) async fn fake_actor(
    endpoint: &Endpoint,
    name: &str,
) -> (ActorLink, Events<ActorEvent>, Hello) {
    let (actor, start) =
        (ActorId::new(name).expect("it is a name"), StartKey::draw().expect("random bytes"));
    let settings =
        ConnectSettings { timeout: SOON, ..ConnectSettings::new(vec![endpoint.clone()]) };
    let opened = ActorLink::open(&settings, &actor, &start).await;
    let (link, events) = opened.expect("the learner listens");
    let hello = fakes::hello(actor, start.incarnation());
    (link, events, hello)
}

/// Asks an HTTP server by one of its names; returns the status code, the head and the body.
pub(crate) fn ask(address: &str, path: &str, host: &str) -> (u16, String, String) {
    let mut stream = TcpStream::connect(address).expect("somebody listens there");
    stream.set_read_timeout(Some(PATIENCE)).expect("a socket of ours");
    let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("the question is taken");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("the answer comes");
    let (head, body) = answer.split_once("\r\n\r\n").expect("an answer has a head");
    let code = head.split(' ').nth(1).and_then(|code| code.parse().ok()).expect("a status code");
    (code, head.to_owned(), body.to_owned())
}

/// Asks an HTTP server; returns the status code and the body.
pub(crate) fn get(address: &str, path: &str) -> (u16, String) {
    let (code, _, body) = ask(address, path, address);
    (code, body)
}
