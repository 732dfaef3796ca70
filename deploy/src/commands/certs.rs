//! `leadtime certs`: an authority of one's own, and a certificate for every process.

use std::io;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use jiff::{SignedDuration, Timestamp};
use leadtime_certs::{Authority, Certificate, IssueRequest, Issued, Listing, Role};
use leadtime_link::AccessList;
use leadtime_proto::phrase::{counted, duration};
use leadtime_proto::text::quoted;
use leadtime_runs::{clock, regular};
use serde_json::json;

use crate::cli::{
    CertsAclArgs, CertsCommand, CertsInitArgs, CertsIssueArgs, CertsRenewArgs, CertsShowArgs,
};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

pub(super) fn run(command: &CertsCommand) -> Result<(), Failure> {
    let done = match command {
        CertsCommand::Init(args) => init(args),
        CertsCommand::Issue(args) => issue(args),
        CertsCommand::Renew(args) => renew(args),
        CertsCommand::Show(args) => show(args),
        CertsCommand::Acl(args) => acl(args),
    };
    done.blame(ExitCode::WrongInput)
}

fn init(args: &CertsInitArgs) -> anyhow::Result<()> {
    let CertsInitArgs { directory, name } = args;
    let made = Authority::create(directory, name, clock::now())?;
    let (pem, key) = (directory.join("ca.pem"), directory.join("ca.key"));
    output::line(&format!("authority {} until {}", pem.display(), date(made.ends)));
    output::note(&format!(
        "Keep {} where nobody else can read it: it makes certificates for everybody.",
        key.display()
    ));
    Ok(())
}

fn issue(args: &CertsIssueArgs) -> anyhow::Result<()> {
    let now = clock::now();
    let requests = args.requests()?;
    let mut authority = Authority::open(&args.directory, now)?;
    let list = OwnList::find(&args.directory)?;
    let issued = authority.issue_all(&requests, args.lifetime, now)?;
    let listed = list.write().inspect_err(|_told| authority.withdraw(&requests))?;
    for issued in &issued {
        output::line(&line("issued", issued));
    }
    let lacks_host = |request: &&IssueRequest| {
        request.hosts.is_empty() && matches!(request.role, Role::Router | Role::Learner)
    };
    for IssueRequest { name, .. } in requests.iter().filter(lacks_host) {
        output::note(&format!(
            "`{name}` has no host, so nobody can dial it; it can dial a router."
        ));
    }
    if let Some(n) = listed {
        output::line(&access_list_line(&list.path, n));
    } else {
        tracing::warn!(
            "{0} does not list exactly the certificates that were here, and stays as it is: `leadtime certs acl {1} -o {0}` replaces it",
            list.path.display(),
            args.directory.display()
        );
    }
    let authority = args.directory.join("ca.pem");
    output::note(&format!(
        "The machine of a process needs its .pem and its .key, and {}; a process that listens needs the list, too.",
        authority.display()
    ));
    Ok(())
}

/// The access list beside the certificates, `acl.json5`, which follows them unless somebody has changed it.
struct OwnList {
    path: PathBuf,
    /// Whether it is there as `certs acl` would write it, or not at all.
    is_ours: bool,
}

impl OwnList {
    /// Looks at it, before anything is issued. Says what is left out of it.
    fn find(directory: &Path) -> anyhow::Result<Self> {
        let path = directory.join("acl.json5");
        let issued = issued(directory)?;
        let is_ours = match regular::read_to_string(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => true,
            text => {
                let text = text.with_context(|| format!("reading {}", path.display()))?;
                list_of(issued).is_some_and(|(_, list)| list.to_text() == text)
            }
        };
        Ok(Self { path, is_ours })
    }

    /// Writes it for everybody who has a certificate now; returns how many they are, or `None` where it is not ours.
    fn write(&self) -> anyhow::Result<Option<usize>> {
        let directory = self.path.parent().unwrap_or(Path::new("."));
        match list_of(Authority::list(directory)?.issued) {
            Some((n, list)) if self.is_ours => {
                output::file(&self.path, list.to_text().as_bytes())?;
                Ok(Some(n))
            }
            _ => Ok(None),
        }
    }
}

/// Makes the list of everybody who has a certificate, with their number; `None` if nobody has.
fn list_of(issued: Vec<Issued>) -> Option<(usize, AccessList)> {
    let peers: Vec<_> = issued.into_iter().map(|issued| (issued.role, issued.name)).collect();
    AccessList::of(&peers).map(|list| (peers.len(), list))
}

/// Lists the certificates of a directory, and warns of the files beside them that may be meant to be some.
fn issued(directory: &Path) -> anyhow::Result<Vec<Issued>> {
    let Listing { issued, left_out } = Authority::list(directory)?;
    for error in left_out {
        let error = anyhow::Error::new(error);
        tracing::warn!("{error:#}; neither listed nor renewed");
    }
    Ok(issued)
}

fn access_list_line(file: &Path, n: usize) -> String {
    format!("access list {} for {}", file.display(), counted(n, "certificate"))
}

fn renew(args: &CertsRenewArgs) -> anyhow::Result<()> {
    let now = clock::now();
    issued(&args.directory)?;
    let renewed = Authority::open(&args.directory, now)?.renew(args.before, now)?;
    for issued in &renewed {
        output::line(&line("renewed", issued));
    }
    if renewed.is_empty() {
        let (directory, before) = (args.directory.display(), duration(args.before));
        output::line(&format!("no certificate in {directory} ends within {before}"));
    }
    Ok(())
}

fn show(args: &CertsShowArgs) -> anyhow::Result<()> {
    let found = Certificate::read(&args.file)?;
    let now = clock::now();
    let left = found.ends.duration_since(now);
    if args.json {
        output::json(&json!({
            "role": found.role.map(Role::as_str),
            "id": found.name,
            "hosts": found.hosts,
            "begins": found.begins.to_string(),
            "ends": found.ends.to_string(),
            "seconds_left": left.as_secs(),
            "authority": found.is_authority,
        }));
        return Ok(());
    }
    let role = match (found.role, found.is_authority) {
        (Some(role), _) => role.as_str(),
        (None, true) => "authority",
        (None, false) => "none of ours",
    };
    // The texts are those of the program that made the file.
    let hosts: Vec<String> = found.hosts.iter().map(|host| quoted(host)).collect();
    let hosts = if hosts.is_empty() { "none: it only dials".to_owned() } else { hosts.join(", ") };
    output::line(&format!("role    {role}"));
    output::line(&format!("id      {}", quoted(found.name.as_deref().unwrap_or("none"))));
    if !found.is_authority {
        output::line(&format!("hosts   {hosts}"));
    }
    output::line(&format!("begins  {}", date(found.begins)));
    output::line(&format!("ends    {} ({})", date(found.ends), remaining(left)));
    Ok(())
}

fn acl(args: &CertsAclArgs) -> anyhow::Result<()> {
    let (n, list) = list_of(issued(&args.directory)?).with_context(|| nobody(&args.directory))?;
    match &args.out {
        None => output::data(list.to_text().trim_end()),
        Some(file) => {
            output::file(file, list.to_text().as_bytes())?;
            output::line(&access_list_line(file, n));
        }
    }
    Ok(())
}

fn nobody(directory: &Path) -> String {
    let directory = directory.display();
    format!(
        "nobody has a certificate in {directory} yet: `leadtime certs issue {directory} learner:NAME`"
    )
}

fn line(what: &str, Issued { role, name, path, certificate }: &Issued) -> String {
    let (path, ends) = (path.display(), date(certificate.ends));
    format!("{what} {path} ({role} `{name}`) until {ends}")
}

fn date(moment: Timestamp) -> String {
    moment.strftime("%Y-%m-%d %H:%M:%S UTC").to_string()
}

fn remaining(left: SignedDuration) -> String {
    let days = left.as_hours() / 24;
    match left.as_secs() {
        ..=0 => "it is over".to_owned(),
        _ if days >= 2 => format!("in {days} days"),
        seconds if seconds >= 7_200 => format!("in {} hours", seconds / 3_600),
        seconds => format!("in {}", counted(seconds, "second")),
    }
}
