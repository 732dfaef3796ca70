//! Keeping a run going: status pages, logs, signals, the service manager, a full disk, old runs.

#![expect(clippy::print_stdout, reason = "a part that is skipped says so")]

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpListener;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;

use serde_json::Value;

use crate::support::{
    PATIENCE, Place, Running, SOON, ask, get, record, signal, updates, wait_for_updates,
    wait_for_words, wait_until,
};

/// A CartPole run that ends by a signal only.
const LONG: &str = "learner --name r -c cartpole --seed 3 --set learner.n_steps=64 --set learner.total_steps=1000000000 \
                    --set learner.anneal=false --set run.checkpoint_every=4 --status 127.0.0.1:0 --listen";

fn learner(place: &Place, extra: &str) -> Running {
    place.start(&[LONG, &place.endpoint("learner"), extra])
}

fn actor(place: &Place, extra: &str) -> Running {
    let endpoint = place.endpoint("learner");
    place.start(&["actor --connect-timeout 10s --id a --connect", &endpoint, extra])
}

/// Waits until a process says where its status page is.
fn address(process: &Running) -> String {
    wait_for_words(process, "status at http://");
    let said = process.stderr();
    let (_, rest) = said.split_once("status at http://").unwrap();
    rest.split('/').next().unwrap().to_owned()
}

/// Returns the value of a sample whose name and labels begin like this.
fn sample(page: &str, start: &str) -> Option<f64> {
    let line = page.lines().find(|line| line.starts_with(start))?;
    line.rsplit(' ').next()?.parse().ok()
}

#[test]
fn a_status_page_tells_what_a_run_does_and_whether_it_is_well() {
    let place = Place::new();
    let learner = learner(&place, "");
    let at = address(&learner);
    assert_eq!(get(&at, "/live").0, 200);
    wait_until("the learner listens", PATIENCE, || {
        get(&at, "/ready").1.contains("actors are missing")
    });
    assert_eq!(get(&at, "/ready"), (503, "actors are missing: 0 are here\n".to_owned()));
    place.finish(&["health", &at]).with_code(1).saying(&["/ready: actors are missing"]);
    let actor = actor(&place, "--status localhost:0");
    let actor_at = address(&actor);
    wait_for_updates(&place.run("r"), 4);
    wait_until("the learner is ready", PATIENCE, || get(&at, "/ready").0 == 200);
    wait_until("the actor is ready", PATIENCE, || get(&actor_at, "/ready").0 == 200);
    place.finish(&["health --live", &at]).with_code(0);

    let (code, head, page) = ask(&at, "/metrics", "localhost");
    assert_eq!(code, 200);
    assert!(head.contains("application/openmetrics-text; version=1.0.0; charset=utf-8"), "{head}");
    assert!(page.len() < 20_000, "{} bytes", page.len());
    let n_updates = sample(&page, "leadtime_updates_total{run=\"r\"}").unwrap();
    assert!(n_updates >= 4.0, "{page}");
    assert!(
        sample(&page, "leadtime_books_total{run=\"r\",entry=\"trained\"").unwrap() > 0.0,
        "{page}"
    );
    assert_eq!(sample(&page, "leadtime_books_imbalance"), Some(0.0), "{page}");
    assert!(sample(&page, "leadtime_disk_size_bytes").unwrap() > 0.0, "{page}");
    assert_eq!(sample(&page, "leadtime_lines_dropped_total"), Some(0.0), "{page}");
    // An actor says once a second how it stands.
    wait_until("the actor counts its steps", PATIENCE, || {
        let page = get(&actor_at, "/metrics").1;
        sample(&page, "leadtime_actor_steps_total{actor=\"a\"}").is_some_and(|n| n > 0.0)
    });
    let (_, actor_page) = get(&actor_at, "/metrics");
    for page in [&page, &actor_page] {
        read_strictly(&place, page);
    }

    let (_, version) = get(&at, "/version");
    let version: Value = serde_json::from_str(&version).unwrap();
    let told = place.finish(&["version --protocol"]).with_code(0).stdout;
    assert_eq!(version["protocol"].to_string(), told.trim());
    assert_eq!(ask(&at, "/metrics", "evil.example").0, 421, "a name that is not ours");

    // Asked to stop, an actor ends by itself, for it says so, and everything that it sent is acknowledged.
    signal("TERM", actor.id());
    let said = actor.finish(PATIENCE).with_code(130).stdout;
    let counts: Vec<u64> = said.split([' ', ',']).filter_map(|word| word.parse().ok()).collect();
    assert_eq!(counts[1], counts[2], "sent and acknowledged: {said}");

    // Drained, a learner ends well and can be resumed.
    signal("USR1", learner.id());
    learner.finish(PATIENCE).with_code(0).saying(&["asked to drain", "To go on from update"]);
    assert_eq!(record(&place.run("r"))["result"], Value::Null);
    let told = format!("nobody answers at {at}: Connection refused");
    let advice = format!("; start a learner or an actor with --status {at}\n");
    place.finish(&["health", &at]).with_code(3).saying(&[&told, &advice]);
    place.finish(&["health localhost"]).with_code(2).saying(&["such as 127.0.0.1:9464"]);
}

#[test]
fn health_tells_a_program_that_stands_still_or_is_another_one_from_nobody() {
    let place = Place::new();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = listener.local_addr().unwrap().to_string();
    // The system accepts the connection; nobody reads it.
    let told = format!("what listens at {at} does not answer within 2s");
    place.finish(&["health", &at]).with_code(3).saying(&[&told]);
    // The first to be accepted is the one that has given up.
    drop(listener.accept().unwrap());
    let named = thread::Builder::new().name("foreign".to_owned());
    let answering = named.spawn(move || {
        for answer in ["SSH-2.0-OpenSSH_9.6\r\n", "HTTP/1.1 200 OK\r\n\r\nhello\n"] {
            let (stream, _) = listener.accept().unwrap();
            // The whole question.
            let mut lines = BufReader::new(&stream).lines();
            assert!(lines.any(|line| line.unwrap().is_empty()));
            (&stream).write_all(answer.as_bytes()).unwrap();
        }
        // Closed before all of the question is read, the connection is broken off.
        listener.accept().unwrap().0.read_exact(&mut [0]).unwrap();
    });
    let told = format!("what listens at {at} is no status page of a learner or an actor");
    for _ in 0..3 {
        place.finish(&["health", &at]).with_code(3).saying(&[&told]);
    }
    answering.unwrap().join().unwrap();
}

/// Has Python's strict parser read a page, where it is installed.
fn read_strictly(place: &Place, page: &str) {
    let file = place.write("page.txt", page);
    let program = "import sys\nfrom prometheus_client.openmetrics.parser import text_string_to_metric_families as read\n\
                   found = list(read(open(sys.argv[1]).read()))\nassert len(found) > 4, found\n\
                   assert all(it.type != 'unknown' for it in found), found\n";
    let read = |file: &str| Command::new("python3").args(["-c", program, file]).output();
    match read(&file) {
        Ok(done) if done.status.success() => {}
        Ok(done) => {
            let error = String::from_utf8_lossy(&done.stderr).into_owned();
            assert!(error.contains("No module named"), "{error}\n{page}");
            println!("not read strictly: prometheus_client is not installed");
        }
        Err(error) => println!("not read strictly: {error}"),
    }
}

#[test]
fn a_status_address_that_cannot_be_had_is_wrong_input() {
    let place = Place::new();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = taken.local_addr().unwrap().to_string();
    for (address, said) in [
        (taken.as_str(), "is in use"),
        ("here", "is not an address"),
        ("host:1", "is not an address"),
        ("localhost", "such as 127.0.0.1:9464"),
    ] {
        let endpoint = place.endpoint("learner");
        let learner = ["learner -c cartpole --listen", &endpoint, "--status", address];
        place.finish(&learner).with_code(2).saying(&["--status", said]);
        let actor = ["actor --connect", &endpoint, "--status", address];
        place.finish(&actor).with_code(2).saying(&["--status", said]);
    }
    assert!(!place.path().join("runs").exists(), "nothing was begun");
}

#[test]
fn a_log_for_machines_goes_to_a_file_that_is_opened_again_on_hangup() {
    let place = Place::new();
    let log = place.file("log");
    let up = place.start(&[
        "up --name r -c cartpole --set learner.total_steps=1000000000 --log-format json --log-file",
        &log,
    ]);
    let run = place.run("r");
    wait_for_updates(&run, 2);
    fs::rename(&log, place.file("log.1")).unwrap();
    signal("HUP", up.id());
    wait_until("the file is made again", PATIENCE, || Path::new(&log).exists());
    signal("TERM", up.id());
    let done = up.finish(PATIENCE).with_code(130);
    assert!(!done.stderr.contains("\"level\""), "{}", done.stderr);
    let mut runs = 0;
    for file in ["log.1", "log"] {
        let text = fs::read_to_string(place.file(file)).unwrap();
        assert!(!text.is_empty(), "{file}");
        for line in text.lines() {
            let line: Value = serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"));
            assert!(line["message"].is_string() && line["fields"].is_object(), "{line}");
            runs += usize::from(line["run"] == "r");
        }
    }
    assert!(runs > 0, "the learner says which run it is about");
    let nowhere = place.file("no/log");
    place.finish(&["runs --log-file", &nowhere]).with_code(2).saying(&["--log-file"]);
}

#[test]
fn a_command_without_anything_to_finish_hears_signals_as_well() {
    let place = Place::new();
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/v1", silent.local_addr().unwrap());
    let rate = |handling: &str, more: &str| {
        let mut shell = place.program_at(Path::new("sh"), &["-c"]);
        shell.args([handling, env!("CARGO_BIN_EXE_leadtime")]);
        let asked = "taxonomy rate highway --topic slow_down --backend http --model m Slow. --url";
        shell.args(asked.split(' ')).arg(&url).args(more.split_whitespace());
        let rate = place.start_with(shell);
        // It waits for an answer that never comes.
        let (stream, _) = silent.accept().unwrap();
        (rate, stream)
    };
    let log = place.file("log");
    // The log file is opened again below `nohup` as well.
    let (mut logged, _waits) =
        rate("trap '' HUP; exec \"$0\" \"$@\"", &format!("--log-file {log}"));
    fs::rename(&log, place.file("log.1")).unwrap();
    signal("HUP", logged.id());
    wait_until("the file is made again", PATIENCE, || Path::new(&log).exists());
    assert!(logged.is_running());
    signal("TERM", logged.id());
    logged.finish(PATIENCE).with_code(130);
    // Without a log file it was the terminal that was closed.
    let (hung_up, _waits) = rate("exec env --default-signal=HUP \"$0\" \"$@\"", "");
    signal("HUP", hung_up.id());
    hung_up.finish(PATIENCE).with_code(130);
}

#[test]
fn a_service_manager_hears_that_a_learner_is_ready_alive_and_about_to_end() {
    let place = Place::new();
    let path = place.file("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut command = place.program(&[LONG, &place.endpoint("learner")]);
    command.env("NOTIFY_SOCKET", &path).env("WATCHDOG_USEC", "600000");
    let learner = place.start_with(command);
    let hear = |wanted: &str| {
        let mut heard = Vec::new();
        while heard.last().is_none_or(|last: &String| last != wanted) {
            let mut bytes = [0; 256];
            let n_bytes = socket.recv(&mut bytes).unwrap_or_else(|e| panic!("{e}: {heard:?}"));
            heard.push(String::from_utf8_lossy(&bytes[..n_bytes]).trim().to_owned());
        }
        heard
    };
    let before = hear("WATCHDOG=1");
    assert!(!before.contains(&"READY=1".to_owned()), "nobody is there: {before:?}");
    let actor = actor(&place, "");
    hear("READY=1");
    hear("WATCHDOG=1");
    signal("TERM", learner.id());
    hear("STOPPING=1");
    learner.finish(PATIENCE).with_code(130);
    actor.finish(PATIENCE).with_code(0);
    // One that is finished is ready at once: its manager would take its end for a failure.
    let short =
        "up --name short -c cartpole --set learner.n_steps=32 --set learner.total_steps=512";
    place.finish(&[short]).with_code(0);
    let again = short.replace("up ", "learner ");
    let mut command = place.program(&[&again]);
    command.env("NOTIFY_SOCKET", &path);
    let learner = place.start_with(command);
    hear("READY=1");
    learner.finish(PATIENCE).with_code(0);
    // A name without a file, as in some containers.
    let name = format!("leadtime-test-{}", std::process::id());
    let unnamed = SocketAddr::from_abstract_name(&name).unwrap();
    let unnamed = UnixDatagram::bind_addr(&unnamed).unwrap();
    unnamed.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut command = place.program(&[&again]);
    command.env("NOTIFY_SOCKET", format!("@{name}"));
    place.start_with(command).finish(PATIENCE).with_code(0);
    let mut bytes = [0; 256];
    let n_bytes = unnamed.recv(&mut bytes).unwrap();
    assert_eq!(&bytes[..n_bytes], b"READY=1\n");
    // Where nobody listens, the manager would wait in vain.
    let mut command = place.program(&[&again]);
    command.env("NOTIFY_SOCKET", place.file("nobody"));
    let told = "(NOTIFY_SOCKET) cannot be notified";
    place.start_with(command).finish(PATIENCE).with_code(0).saying(&[told]);
}

#[test]
fn a_process_has_threads_for_many_connections_unless_its_person_says_otherwise() {
    let place = Place::new();
    let variables = |process: &Running| {
        let read = || fs::read_to_string(format!("/proc/{}/environ", process.id()));
        let has_both =
            |text: &String| text.contains("ZENOH_RUNTIME=") && text.contains("RAYON_NUM");
        wait_until("it has set them", PATIENCE, || read().is_ok_and(|text| has_both(&text)));
        read().unwrap()
    };
    let learner = place.start(&[LONG, &place.endpoint("learner")]);
    assert!(variables(&learner).contains("max_blocking_threads: 2048"));
    wait_for_words(&learner, "listening");
    let own = "ZENOH_RUNTIME=(net: (worker_threads: 1))";
    let mut command = place.program(&["actor --connect", &place.endpoint("learner")]);
    let (name, value) = own.split_once('=').unwrap();
    command.env(name, value);
    let actor = place.start_with(command);
    assert!(variables(&actor).split('\0').any(|variable| variable == own));
    wait_for_words(&actor, "joined");
}

/// A disk of four megabytes, taken away when dropped; `None` where none can be made, which needs root.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(place: &Place) -> Option<Self> {
        let path = place.path().join("runs");
        fs::create_dir(&path).unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", "size=4m", "tmpfs"])
            .arg(&path)
            .output();
        if mounted.is_ok_and(|done| done.status.success()) {
            return Some(Self(path));
        }
        println!("skipped: no small disk can be mounted here");
        None
    }

    /// Takes all room, and gives back a little that no checkpoint fits into.
    fn fill(&self) {
        let mut filler = fs::File::create(self.0.join("filler")).unwrap();
        while filler.write_all(&[1; 4_096]).is_ok() {}
    }

    fn free(&self) {
        fs::remove_file(self.0.join("filler")).unwrap();
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        drop(Command::new("umount").arg("-l").arg(&self.0).output());
    }
}

/// How the room for a learner's files is taken away.
enum Shortage {
    /// The disk is full.
    Disk(SmallDisk),
    /// No file may be as large as a checkpoint, or as the journal is by then. This needs no root.
    Limit,
}

impl Shortage {
    fn begin(&self, learner: &Running) {
        match self {
            Self::Disk(disk) => disk.fill(),
            Self::Limit => limit_files(learner, "32768:"),
        }
    }

    /// Gives the room back; a learner that has ended needs none.
    fn end(&self, learner: Option<&Running>) {
        match (self, learner) {
            (Self::Disk(disk), _) => disk.free(),
            (Self::Limit, Some(learner)) => limit_files(learner, "unlimited:"),
            (Self::Limit, None) => {}
        }
    }
}

/// Limits how large the files of a process may become, and leaves its right to be allowed more.
fn limit_files(process: &Running, limit: &str) {
    let (id, limit) = (process.id().to_string(), format!("--fsize={limit}"));
    let limited = Command::new("prlimit").args(["--pid", &id, &limit]).status();
    assert!(limited.expect("prlimit runs").success(), "process {id} cannot be limited");
}

#[test]
fn a_full_disk_stops_no_training_until_patience_ends_and_nothing_is_lost() {
    let place = Place::new();
    if let Some(disk) = SmallDisk::mount(&place) {
        outlasts(&place, &Shortage::Disk(disk));
    }
}

#[test]
fn a_limit_on_files_stops_no_training_until_patience_ends_and_nothing_is_lost() {
    outlasts(&Place::new(), &Shortage::Limit);
}

/// Lets a learner meet a shortage while it trains, when it is asked to end, and when it is drained.
#[track_caller]
fn outlasts(place: &Place, shortage: &Shortage) {
    let learner = learner(place, "--set run.checkpoint_patience=3");
    let at = address(&learner);
    let actor = actor(place, "");
    wait_for_updates(&place.run("r"), 40);
    let unsaved = || sample(&get(&at, "/metrics").1, "leadtime_unsaved_seconds");
    assert_eq!(unsaved(), Some(0.0));
    let n_updates = || sample(&get(&at, "/metrics").1, "leadtime_updates_total").unwrap();
    let before = n_updates();
    shortage.begin(&learner);
    wait_for_words(&learner, "training continues");
    wait_for_words(&learner, "training waits until there is room");
    wait_until("it is not ready", PATIENCE, || get(&at, "/ready").1.contains("free some space"));
    let (paused, dropped) =
        (n_updates(), sample(&get(&at, "/metrics").1, "leadtime_lines_dropped_total"));
    assert!(dropped.unwrap() > 0.0, "{dropped:?}");
    // A checkpoint is due after every fourth update.
    assert!(paused > before + 8.0, "training went on: {paused}, {before}");
    assert!(unsaved() >= Some(3.0), "also while it waits: {:?}", unsaved());
    shortage.end(Some(&learner));
    wait_for_words(&learner, "checkpoints can be written again");
    wait_until("it is saved", PATIENCE, || unsaved() == Some(0.0));
    wait_until("training goes on", PATIENCE, || n_updates() > paused + 2.0);
    let said = learner.stderr();
    assert_eq!(said.matches("training continues").count(), 1, "told once: {said}");
    // An end that cannot be saved is kept until somebody insists.
    shortage.begin(&learner);
    signal("TERM", learner.id());
    wait_for_words(&learner, "the end of the run cannot be saved");
    wait_until("the page tells it", PATIENCE, || unsaved() > Some(0.0));
    signal("TERM", learner.id());
    learner.finish(PATIENCE).with_code(2);
    actor.finish(PATIENCE).with_code(0);
    shortage.end(None);
    // Of an end that was planned, one interrupt is enough.
    let drained = self::learner(place, "");
    wait_for_words(&drained, "listening");
    shortage.begin(&drained);
    signal("USR1", drained.id());
    wait_for_words(&drained, "the end of the run cannot be saved");
    signal("TERM", drained.id());
    drained.finish(SOON).with_code(2);
    shortage.end(None);
    let resumed = self::learner(place, "--stop-after 1");
    resumed.finish(PATIENCE).with_code(0).saying(&["resumed from update"]);
    assert!(updates(&place.run("r")) > 0);
}

#[test]
fn old_runs_are_listed_and_removed_only_when_that_is_wanted() {
    let place = Place::new();
    let short = "up -c cartpole --set learner.n_steps=32 --set learner.total_steps=512 --name";
    for name in ["a", "b"] {
        place.finish(&[short, name]).with_code(0);
    }
    let prune = |more: &str| place.finish(&["runs prune --older", more]).with_code(0);
    prune("30d").saying(&["no run is to be removed"]);
    let listed = prune("0d");
    assert!(
        listed.stdout.starts_with("a  ") && listed.stdout.contains("would be removed"),
        "{}",
        listed.stdout
    );
    assert!(place.run("a").exists() && place.run("b").exists());
    prune("0s --keep-best --yes");
    assert_eq!(fs::read_dir(place.path().join("runs")).unwrap().count(), 1, "the best one");
    place.finish(&["runs prune --older soon"]).with_code(2).saying(&["30d or 12h"]);
}
