//! What a crate must not depend on, directly or through others.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use toml::{Table, Value};

use crate::code::root;

/// Crates (ours without `leadtime-`), and what none of them may reach: the last column of ARCHITECTURE.md's map, as far as
/// it names crates. What a crate may not name itself but has through others is in `heavy_dependencies_belong_to_few_crates`.
const UNREACHABLE: &[(&str, &str)] = &[
    ("proto certs web trace numerics table", "sims policy link learner actor zenoh"),
    ("proto numerics table policy ppo sims", "tokio zenoh tracing"),
    ("taxonomy", "proto sims policy link"),
    ("link", "policy sims taxonomy"),
    ("policy", "ppo sims"),
    ("ppo", "link sims episodes actor zenoh"),
    ("voice", "proto policy link sims serve zenoh"),
    ("sims lander highway steakhouse worlds", "policy link taxonomy zenoh tokio"),
    ("conformance", "policy link zenoh"),
    ("worker", "policy link actor learner zenoh tokio"),
    ("episodes", "link ppo taxonomy zenoh"),
    ("learner", "sims worlds lander highway steakhouse worker episodes config actor"),
    ("actor", "ppo worlds lander highway steakhouse worker config learner"),
    ("eval", "link ppo worker config zenoh tokio"),
    ("scripts", "lander highway steakhouse worlds table link eval"),
    ("serve", "lander highway steakhouse worlds ppo actor learner config clap"),
    ("config", "link learner actor eval zenoh tokio clap"),
    ("python", "link learner actor runs zenoh tokio clap"),
    ("recording", "ppo actor learner config runs clap"),
    ("watch", "ppo actor learner worker worlds config runs clap"),
    ("status", "worlds lander highway steakhouse worker config runs clap"),
    ("runs", "actor serve scripts clap anyhow"),
    ("studies", "actor serve clap anyhow"),
    ("process", "actor serve scripts studies watch web clap anyhow"),
];

#[test]
fn no_crate_reaches_what_it_must_not_know() {
    let packages = packages();
    for (names, forbidden) in UNREACHABLE {
        for from in names.split(' ') {
            for to in forbidden.split(' ') {
                if let Some(way) = way(&packages, &ours(from), &ours(to)) {
                    panic!("`{from}` must not know `{to}`, but has it: {}", way.join(" -> "));
                }
            }
        }
    }
}

/// Every name of the table must be known, or it would forbid nothing.
#[test]
fn what_must_not_be_reached_is_there() {
    let packages = packages();
    let all: BTreeSet<&String> = packages.values().flatten().chain(packages.keys()).collect();
    for (names, forbidden) in UNREACHABLE {
        for name in names.split(' ').chain(forbidden.split(' ')) {
            assert!(all.contains(&ours(name)), "nothing is called `{name}`");
        }
        assert!(names.split(' ').all(|name| packages.contains_key(&ours(name))), "{names}");
    }
}

/// Returns the full name of a package: ours are meant by their short ones.
fn ours(name: &str) -> String {
    const OTHERS: &str = "zenoh tokio tracing clap anyhow";
    let is_other = OTHERS.split(' ').any(|other| other == name);
    if is_other { name.to_owned() } else { format!("leadtime-{name}") }
}

/// Returns the shortest way from a package to another one, both included.
fn way(packages: &BTreeMap<String, Vec<String>>, from: &str, to: &str) -> Option<Vec<String>> {
    let mut ways = vec![vec![from.to_owned()]];
    let mut seen = BTreeSet::new();
    while !ways.is_empty() {
        if let Some(found) = ways.iter().find(|way| way.last().is_some_and(|last| last == to)) {
            return Some(found.clone());
        }
        let mut longer = Vec::new();
        for way in ways {
            let next = way.last().and_then(|last| packages.get(last)).into_iter().flatten();
            let next = next.filter(|name| seen.insert((*name).clone()));
            longer.extend(next.map(|name| [&way[..], std::slice::from_ref(name)].concat()));
        }
        ways = longer;
    }
    None
}

/// Returns the workspace's packages with what each needs to be built, as their manifests say; tests may need more.
fn packages() -> BTreeMap<String, Vec<String>> {
    let read = |path: &str| -> Table {
        let path = root().join(path).join("Cargo.toml");
        let text = fs::read_to_string(&path).expect("the manifest is there");
        text.parse().unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    };
    let workspace = read("");
    let members = workspace["workspace"]["members"].as_array().expect("there are members");
    let folders = members.iter().flat_map(|member| {
        let member = member.as_str().expect("a member is a path");
        match member.strip_suffix("/*") {
            None => vec![member.to_owned()],
            Some(folder) => {
                let entries = fs::read_dir(root().join(folder)).expect("the folder is there");
                let names = entries.map(|entry| entry.expect("it can be listed").file_name());
                names.map(|name| format!("{folder}/{}", name.to_string_lossy())).collect()
            }
        }
    });
    folders.map(|folder| package(&read(&folder))).collect()
}

fn package(manifest: &Table) -> (String, Vec<String>) {
    let name = manifest["package"]["name"].as_str().expect("a package has a name").to_owned();
    let targets = manifest.get("target").and_then(Value::as_table);
    let targets = targets.into_iter().flat_map(Table::values).filter_map(Value::as_table);
    let of = |part: &Table| {
        let kinds = ["dependencies", "build-dependencies"];
        let tables = kinds.iter().filter_map(|kind| part.get(*kind).and_then(Value::as_table));
        tables.flat_map(Table::keys).cloned().collect::<Vec<_>>()
    };
    (name, [manifest].into_iter().chain(targets).flat_map(of).collect())
}

#[test]
fn a_way_is_found_through_others() {
    let needs = |name: &str, others: &[&str]| {
        (name.to_owned(), others.iter().map(|&other| other.to_owned()).collect())
    };
    let packages =
        BTreeMap::from([needs("a", &["b", "c"]), needs("b", &["a"]), needs("c", &["zenoh"])]);
    let found = way(&packages, "a", "zenoh").expect("there is a way");
    assert_eq!(found, ["a", "c", "zenoh"]);
    assert_eq!(way(&packages, "zenoh", "a"), None);
    let manifest = "[package]\nname = \"d\"\n[dependencies]\nx = \"1\"\n[dev-dependencies]\ny = \"1\"\n\
                    [target.'cfg(unix)'.dependencies]\nz = \"1\"";
    let found = package(&manifest.parse().expect("it is TOML"));
    assert_eq!(found, needs("d", &["x", "z"]));
}
