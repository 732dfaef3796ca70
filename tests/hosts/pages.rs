//! The commands that README and docs/operations.md have for several hosts, as they stand there: each on its host, in a directory
//! of that host's own, with the files that the text has copied.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use serde_json::Value;

use super::namespaces::Hosts;
use super::support::{
    PATIENCE, Place, Running, repository, signal, updates, wait_for_updates, wait_until,
};

/// Updates that a run must make to be at work.
const SOME: u64 = 2;
/// How the commands of those begin who make an authority of their own.
const AUTHORITY: &str = "leadtime certs init ";
/// How README says on which host a command is run.
const README_HOSTS: [(&str, &str); 4] = [
    ("on ROUTER", "router"),
    ("on the second host", "learner"),
    ("on the third", "near"),
    ("on the fourth", "page"),
];

/// A command with what its comment says.
struct Step {
    line: String,
    about: String,
}

impl Step {
    /// Returns the certificate that it shows, as `pki/ID`.
    fn certificate(&self) -> Option<&str> {
        self.line.split_once(" --tls ")?.1.split_whitespace().next()
    }
}

/// Reads the commands of a page for several hosts, of which the first begins so, after a look at the text around them.
fn steps(page: &str, begins: &str, copies: &str) -> Vec<Step> {
    let text = fs::read_to_string(repository(page)).expect("the page is there");
    let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains(copies), "{page} has other files copied than this test does");
    let mut blocks = text.split("<!-- not run: several machines -->\n```console\n").skip(1);
    let block = blocks.find(|block| block.starts_with(begins));
    let block = block.unwrap_or_else(|| panic!("{page} has no commands that begin with {begins}"));
    let lines = block.split("```").next().unwrap_or_default().lines();
    lines
        .map(|line| {
            let (line, about) = line.split_once(" # ").unwrap_or((line, ""));
            Step { line: line.trim().to_owned(), about: about.trim().to_owned() }
        })
        .collect()
}

/// What lies and is at work on a host.
struct Site {
    // Ended before its directory is removed.
    process: Option<Running>,
    host: &'static str,
    place: Place,
}

impl Site {
    fn new(host: &'static str) -> Self {
        Self { process: None, host, place: Place::new() }
    }

    fn process(&self) -> &Running {
        self.process.as_ref().expect("a command was started there")
    }

    /// Copies the files that the process of a step needs from where the certificates were made.
    fn copy(&self, authority: &Self, step: &Step) {
        let pki = |site: &Self| site.place.path().join("pki");
        fs::create_dir_all(pki(self)).expect("a folder can be made");
        let id = step.certificate().and_then(|shown| shown.strip_prefix("pki/"));
        let id = id.unwrap_or_else(|| panic!("`{}` shows no certificate of pki", step.line));
        let mut files = vec!["ca.pem".to_owned(), format!("{id}.pem"), format!("{id}.key")];
        if self.host == "router" {
            files.push("acl.json5".to_owned());
        }
        for file in files {
            let copied = fs::copy(pki(authority).join(&file), pki(self).join(&file));
            copied.unwrap_or_else(|error| panic!("`{}`, pki/{file}: {error}", step.line));
        }
    }

    /// Has a shell start a line here.
    fn start(&self, line: &str) -> Running {
        let program =
            Path::new(env!("CARGO_BIN_EXE_leadtime")).parent().expect("it lies in a folder");
        let usual = std::env::var("PATH").expect("there is a path");
        let mut shell = Command::new("sh");
        shell.args(["-c", &format!("exec {line}")]).current_dir(self.place.path());
        shell.env("PATH", format!("{}:{usual}", program.display()));
        self.place.start_with(Hosts::program(self.host, &shell))
    }

    fn finish(&self, line: &str) {
        self.start(line).finish(PATIENCE).with_code(0);
    }

    /// Ends what is at work here, and returns what it has printed.
    fn end(mut self, name: &str, code: i32) -> String {
        let process = self.process.take().expect("a command was started there");
        signal(name, process.id());
        process.finish(PATIENCE).with_code(code).stdout
    }

    /// Waits until what is at work here has ended well by itself.
    fn ended(mut self) {
        let process = self.process.take().expect("a command was started there");
        process.finish(PATIENCE).with_code(0);
    }

    /// Waits until the learner here has made some updates, and returns the directory of its run.
    fn run_under_way(&self) -> PathBuf {
        let runs = self.place.path().join("runs");
        let mut run = PathBuf::new();
        wait_until("a run is under way", PATIENCE, || {
            let made = fs::read_dir(&runs).into_iter().flatten().flatten().map(|run| run.path());
            run = made.last().unwrap_or_default();
            updates(&run) >= SOME
        });
        run
    }
}

/// Runs the steps of a page in their order, each where its comment says, the others at `first`. The processes go on.
fn perform(steps: &[Step], first: &'static str, hosts: &[(&str, &'static str)]) -> Vec<Site> {
    let mut sites = vec![Site::new(first)];
    for step in steps {
        let named = hosts.iter().find(|(words, _)| step.about.starts_with(words));
        let host = named.map_or(first, |(_, host)| host);
        if sites.iter().all(|site| site.host != host) {
            let site = Site::new(host);
            site.copy(&sites[0], step);
            sites.push(site);
        }
        let site = sites.iter_mut().find(|site| site.host == host).expect("it was made");
        if step.line.starts_with("leadtime certs ") {
            site.finish(&step.line);
        } else {
            site.process = Some(site.start(&step.line));
        }
    }
    sites
}

/// Puts the addresses of hosts in place of their names.
fn with_address(steps: Vec<Step>, name: &str, address: &str) -> Vec<Step> {
    let line = |step: Step| Step { line: step.line.replace(name, address), ..step };
    steps.into_iter().map(line).collect()
}

pub(crate) fn the_commands_of_readme_work_on_hosts_of_their_own(hosts: &Hosts) {
    let copies = "copy `ca.pem` and each process's `.pem` and `.key` to its host, and `acl.json5` to the router.";
    let steps =
        with_address(steps("README.md", AUTHORITY, copies), "ROUTER", &hosts.address("router"));
    assert!(steps.len() <= 6, "six commands are enough");
    let sites = perform(&steps, "authority", &README_HOSTS);
    let sites =
        <[Site; 5]>::try_from(sites).unwrap_or_else(|_| panic!("four hosts have a process"));
    let [authority, router, learner, near, page] = sites;

    // "another one shows pki/a2"
    let step = steps.iter().find(|step| step.line.starts_with("leadtime actor "));
    let step = step.expect("README starts an actor");
    let (_, other) = step.about.split_once("another one shows ").expect("README names another");
    let shown = step.certificate().expect("it has been copied");
    let step = Step { line: step.line.replace(shown, other), about: String::new() };
    let mut far = Site::new("far");
    far.copy(&authority, &step);
    far.process = Some(far.start(&step.line));

    let started = Instant::now();
    let run = learner.run_under_way();
    println!("at work after {:.1?}", started.elapsed());
    let (_, link) =
        steps[steps.len() - 1].about.split_once("http://").expect("README has the link");
    wait_until("the page is served where README says", PATIENCE, || {
        page.process().stdout().contains(&format!("http://{link}\n"))
    });
    let address = link.trim_end_matches('/');
    let shown = Hosts::get("page", address, "/");
    assert!(shown.contains("<title>Leadtime</title>"), "{shown}");
    wait_for_page(address, "both actors are there", |[one, two]| one.is_null() && two.is_null());

    let cut = Instant::now();
    Hosts::cut("near");
    wait_until("the learner names the host that is gone", PATIENCE, || {
        learner.process().n_said("actor left: a1,") == 1
    });
    wait_for_page(address, "one is gone", |[one, two]| one.is_number() && two.is_null());
    wait_for_updates(&run, updates(&run) + SOME);
    println!("named as gone, and the page says so, and the others go on: {:.1?}", cut.elapsed());
    let mended = Instant::now();
    Hosts::mend("near");
    wait_until("the host is back", PATIENCE, || learner.process().n_said("actor joined: a1 ") == 2);
    wait_for_page(address, "both are there again", |[one, two]| one.is_null() && two.is_null());
    wait_for_updates(&run, updates(&run) + SOME);

    println!("back, and the page says so: {:.1?}", mended.elapsed());
    let told = learner.end("TERM", 130);
    assert!(told.contains("all accounted for"), "{told}");
    near.ended();
    far.ended();
    page.end("TERM", 130);
    router.end("TERM", 0);
}

/// Waits until a page shows a run at work in which the actors a1 and a2 are known and are so long gone; null is not at all.
fn wait_for_page(address: &str, what: &str, mut is_so: impl FnMut([&Value; 2]) -> bool) {
    wait_until(what, PATIENCE, || {
        let state = Hosts::get("page", address, "/state.json");
        let seen: Value = serde_json::from_str(&state).unwrap_or_else(|e| panic!("{e}: {state}"));
        let actors = seen["actors"].as_array().map(Vec::as_slice).unwrap_or_default();
        let rows = ["a1", "a2"].map(|id| actors.iter().find(|row| row["id"] == id));
        let [Some(one), Some(two)] = rows else { return false };
        let is_at_work =
            seen["state"]["state"] == "training" && seen["about"]["domain"] == "lander";
        is_at_work && is_so([&one["gone_s"], &two["gone_s"]])
    });
}

pub(crate) fn the_commands_without_a_router_work_on_two_hosts(hosts: &Hosts) {
    let copies = "take four commands, three of them on the first; copy `ca.pem` and the files of its process to each of the others:";
    let steps = steps("docs/operations.md", AUTHORITY, copies);
    let steps = with_address(steps, "HOST", &hosts.address("learner"));
    assert_eq!(steps.len(), 4, "four commands are enough");
    let sites = perform(&steps, "learner", &[("on another host", "near")]);
    let [learner, near] = <[Site; 2]>::try_from(sites).unwrap_or_else(|_| panic!("two hosts"));
    learner.run_under_way();
    let told = learner.end("TERM", 130);
    assert!(told.contains("all accounted for"), "{told}");
    near.ended();
}

/// The environment that docs/worlds/python.md has, trained by README's two commands.
pub(crate) fn an_environment_of_ones_own_trains_on_two_hosts(hosts: &Hosts) {
    let found = Command::new("python3").args(["-c", "import leadtime.worker, gymnasium"]).output();
    if !found.is_ok_and(|found| found.status.success()) {
        println!("skipped: this python3 has no package leadtime, or no Gymnasium");
        return;
    }
    let page = fs::read_to_string(repository("docs/worlds/python.md")).expect("the page is there");
    let part = |kind: &str| {
        let (_, rest) = page.split_once(&format!("```{kind}\n")).expect("it has a whole one");
        rest.split("```").next().unwrap_or_default().to_owned()
    };
    let has = "On two hosts that have the package and `crossing.py`, two commands train it:";
    let steps = steps("README.md", "leadtime learner -c crossing.toml ", has);
    let steps = with_address(steps, "HOST", &hosts.address("learner"));
    let [Step { line: learner, .. }, Step { line: actor, about }] = &steps[..] else {
        panic!("two commands are enough")
    };
    assert_eq!(about, "on the other");

    let [mut first, mut other] = ["learner", "near"].map(Site::new);
    for site in [&first, &other] {
        site.place.write("crossing.py", &part("python"));
    }
    first.place.write("crossing.toml", &part("toml"));
    let short = "--steps 8192 --json --name";
    first.process = Some(first.start(&format!("{learner} {short} apart")));
    other.process = Some(other.start(actor));
    let apart = first.process.take().expect("it was started").finish(PATIENCE).with_code(0).json();
    other.ended();
    assert_eq!(apart["books"]["balanced"], true, "{apart}");
    let alone = first.start(&format!("leadtime up -c crossing.toml {short} alone"));
    let alone = alone.finish(PATIENCE).with_code(0).json();
    assert_eq!(apart["weights_sha256"], alone["weights_sha256"]);
    println!("same weights on two hosts and on one: {}", alone["weights_sha256"]);
}
