//! Hosts of their own on one machine: a network namespace each, and a switch between them in another one.

use std::path::Path;
use std::process::{Child, Command, Stdio};

/// The first three parts of every address.
const NETWORK: &str = "10.77.0";
/// The address of a network card that does not exist.
const NOBODY: &str = "02:00:00:00:00:99";

/// Hosts with a cable each to one switch. Everything is removed when it is dropped.
pub(crate) struct Hosts {
    names: Vec<&'static str>,
    made: Vec<String>,
}

/// Tries whether a namespace can be made here.
pub(crate) fn probe() -> Result<(), String> {
    let tried = namespace("probe");
    ip(&["netns", "add", &tried])?;
    ip(&["netns", "delete", &tried])
}

impl Hosts {
    /// Makes them, or says why that cannot be done.
    pub(crate) fn make(names: &[&'static str]) -> Result<Self, String> {
        let mut hosts = Self { names: names.to_vec(), made: Vec::new() };
        let switch = hosts.add("switch")?;
        ip(&["-n", &switch, "link", "add", "br0", "type", "bridge"])?;
        ip(&["-n", &switch, "link", "set", "br0", "up"])?;
        for name in names {
            let host = hosts.add(name)?;
            let cable =
                ["link", "add", "eth0", "netns", &host, "type", "veth", "peer", "name", name];
            ip(&[&cable[..], &["netns", &switch]].concat())?;
            ip(&["-n", &switch, "link", "set", name, "master", "br0", "up"])?;
            let address = format!("{}/24", hosts.address(name));
            ip(&["-n", &host, "addr", "add", &address, "dev", "eth0"])?;
            ip(&["-n", &host, "link", "set", "eth0", "up"])?;
            ip(&["-n", &host, "link", "set", "lo", "up"])?;
        }
        Ok(hosts)
    }

    fn add(&mut self, name: &str) -> Result<String, String> {
        let namespace = namespace(name);
        ip(&["netns", "add", &namespace])?;
        self.made.push(namespace.clone());
        Ok(namespace)
    }

    /// Returns the address of a host.
    pub(crate) fn address(&self, name: &str) -> String {
        let place = self.names.iter().position(|known| *known == name).expect("a host of ours");
        format!("{NETWORK}.{}", place + 1)
    }

    /// Has a command run in a host.
    pub(crate) fn program(host: &str, inner: &Command) -> Command {
        let mut outer = Command::new("ip");
        outer.args(["netns", "exec", &namespace(host)]).arg(inner.get_program());
        outer.args(inner.get_args()).stdin(Stdio::null()).env_remove("RUST_LOG");
        outer.current_dir(inner.get_current_dir().unwrap_or(Path::new(".")));
        for (name, value) in inner.get_envs() {
            match value {
                Some(value) => outer.env(name, value),
                None => outer.env_remove(name),
            };
        }
        outer
    }

    /// Starts a slow line in a host, from an address there to one anywhere.
    pub(crate) fn relay(host: &str, listen: &str, target: &str) -> SlowLine {
        let mut line = Self::this_program(host, &["relay", listen, target]);
        SlowLine(line.spawn().expect("the relay starts"))
    }

    /// Returns what a server shows to somebody in its host.
    pub(crate) fn get(host: &str, address: &str, path: &str) -> String {
        let asked = Self::this_program(host, &["get", address, path]).output();
        let asked = asked.expect("the question can be asked");
        let told = String::from_utf8_lossy(&asked.stderr);
        assert!(asked.status.success(), "{address}{path}: {told}");
        String::from_utf8_lossy(&asked.stdout).into_owned()
    }

    /// Has this program do something else in a host.
    fn this_program(host: &str, arguments: &[&str]) -> Command {
        let mut this = Command::new(std::env::current_exe().expect("this program has a path"));
        this.args(arguments);
        Self::program(host, &this)
    }

    /// Pulls out the cable of a host.
    pub(crate) fn cut(name: &str) {
        ip(&["-n", &namespace("switch"), "link", "set", name, "down"]).expect("a cable of ours");
    }

    /// Puts it back.
    pub(crate) fn mend(name: &str) {
        ip(&["-n", &namespace("switch"), "link", "set", name, "up"]).expect("a cable of ours");
    }

    /// Loses what one host sends to another, without a word to either, and in this direction only: it goes to a card that nobody has.
    pub(crate) fn lose(&self, from: &str, to: &str) {
        self.neighbour(from, "replace", to, &["lladdr", NOBODY, "nud", "permanent"]);
    }

    /// Delivers it again.
    pub(crate) fn deliver(&self, from: &str, to: &str) {
        self.neighbour(from, "del", to, &[]);
    }

    fn neighbour(&self, host: &str, verb: &str, other: &str, more: &[&str]) {
        let (namespace, address) = (namespace(host), self.address(other));
        let entry = ["-n", &namespace, "neigh", verb, &address, "dev", "eth0"];
        ip(&[&entry[..], more].concat()).expect("a neighbour of ours");
    }

    /// Lists the processes of a host.
    pub(crate) fn processes(name: &str) -> Vec<u32> {
        let listed = Command::new("ip").args(["netns", "pids", &namespace(name)]).output();
        let listed = listed.expect("ip runs").stdout;
        let ids = String::from_utf8_lossy(&listed);
        ids.lines().map(|id| id.trim().parse().expect("a process id")).collect()
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        // Cables and the switch go with their namespaces.
        for namespace in &self.made {
            drop(ip(&["netns", "del", namespace]));
        }
    }
}

/// A relay at work; it ends when this is dropped.
pub(crate) struct SlowLine(Child);

impl Drop for SlowLine {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

/// Names a namespace so that two of these tests do not meet.
fn namespace(name: &str) -> String {
    format!("lt{}-{name}", std::process::id())
}

fn ip(arguments: &[&str]) -> Result<(), String> {
    let done =
        Command::new("ip").args(arguments).output().map_err(|error| format!("ip: {error}"))?;
    if done.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&done.stderr);
    Err(format!("`ip {}`: {}", arguments.join(" "), said.trim()))
}
