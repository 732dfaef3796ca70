//! The arguments of what goes over a network: certificates, access, routers.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use leadtime_certs::IssueRequest;

use super::durations::{TOO_LONG, duration};

/// How a process shows who it is.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct TlsArgs {
    /// Encrypt, and show this certificate: DIR/ID.pem with its key DIR/ID.key and the authority DIR/ca.pem, as
    /// `leadtime certs` makes them. A peer that shows none of that authority is refused.
    #[arg(long, value_name = "DIR/ID")]
    pub tls: Option<PathBuf>,
}

/// Who is let in where a process listens.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct GuardArgs {
    #[command(flatten)]
    pub tls: TlsArgs,
    /// Who may do what, by certificate (`leadtime certs acl` writes it); without it, everybody with a certificate may do
    /// everything.
    #[arg(long, value_name = "FILE", requires = "tls")]
    pub acl: Option<PathBuf>,
    /// Do not warn that an address is open to everybody.
    #[arg(long)]
    pub insecure: bool,
}

/// `leadtime router`
#[derive(Debug, Args)]
pub(crate) struct RouterArgs {
    /// Where to listen: `tls/0.0.0.0:7447`, `tcp/127.0.0.1:7447`; repeatable.
    #[arg(long, value_name = "ENDPOINT", required = true)]
    pub listen: Vec<String>,
    /// Routers above this one; routers make a tree; repeatable.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Also pull weights for the actors of this region, each version once: for actors started with the same --region.
    #[arg(long, value_name = "NAME")]
    pub region: Option<String>,
    #[command(flatten)]
    pub guard: GuardArgs,
}

/// `leadtime certs ...`
#[derive(Debug, Subcommand)]
pub(crate) enum CertsCommand {
    /// Make an authority: the certificate and key that sign all others.
    Init(CertsInitArgs),
    /// Make certificates and keys of processes, all or none, and the list of who may do what (DIR/acl.json5).
    Issue(CertsIssueArgs),
    /// Renew the certificates that end soon; keys stay, and processes load the new files by themselves.
    Renew(CertsRenewArgs),
    /// Say whose a certificate is, for which hosts, and until when.
    Show(CertsShowArgs),
    /// Write who may do what, for everybody who has a certificate here.
    Acl(CertsAclArgs),
}

/// `leadtime certs init`
#[derive(Debug, Args)]
pub(crate) struct CertsInitArgs {
    /// The directory of the authority; it is made.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Name of the authority.
    #[arg(long, value_name = "TEXT", default_value = "Leadtime authority")]
    pub name: String,
}

/// `leadtime certs issue`
#[derive(Debug, Args)]
pub(crate) struct CertsIssueArgs {
    /// The directory of the authority.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Whose they are: ROLE:NAME, or ROLE:NAME@HOST with the names or addresses under which a router or learner is dialled
    /// (commas between several). Roles: router, learner, actor, observer (reads metrics and weights), recorder (also
    /// rollouts), service (a notifier at work), robot (one of its clients). Names: a-z, 0-9 and `-`; an actor takes part
    /// under it, and a robot is a client of that name. ROLE NAME, without the colon, is one process.
    #[arg(value_name = "ROLE:NAME[@HOST]", required = true)]
    pub peers: Vec<String>,
    /// A host of the one process that is named; repeatable, as @HOST.
    #[arg(long, value_name = "NAME")]
    pub host: Vec<String>,
    /// How long they last.
    #[arg(long, value_name = "DURATION", default_value = "90d", value_parser = duration_or_days)]
    pub lifetime: Duration,
}

impl CertsIssueArgs {
    /// Returns the certificates that are asked for.
    ///
    /// # Errors
    ///
    /// A sentence about the first that cannot be read, or about `--host` with several of them.
    pub(crate) fn requests(&self) -> anyhow::Result<Vec<IssueRequest>> {
        let mut requests = match self.peers.as_slice() {
            [role, name] if !role.contains(':') && !name.contains(':') => {
                vec![IssueRequest { role: role.parse()?, name: name.parse()?, hosts: Vec::new() }]
            }
            several => several.iter().map(|text| text.parse()).collect::<Result<_, _>>()?,
        };
        match requests.as_mut_slice() {
            [only] => only.hosts.extend(self.host.iter().cloned()),
            _ if self.host.is_empty() => {}
            _ => anyhow::bail!(
                "--host cannot say whose it is of several: write it behind the name, as in learner:l1@HOST"
            ),
        }
        Ok(requests)
    }
}

/// `leadtime certs renew`
#[derive(Debug, Args)]
pub(crate) struct CertsRenewArgs {
    /// The directory of the authority.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Those that end within this time.
    #[arg(long, value_name = "DURATION", default_value = "30d", value_parser = duration_or_days)]
    pub before: Duration,
}

/// `leadtime certs show`
#[derive(Debug, Args)]
pub(crate) struct CertsShowArgs {
    /// A certificate.
    pub file: PathBuf,
    /// Print it as JSON.
    #[arg(long)]
    pub json: bool,
}

/// `leadtime certs acl`
#[derive(Debug, Args)]
pub(crate) struct CertsAclArgs {
    /// The directory of the authority.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// The file (default: standard output).
    #[arg(short, long, alias = "output", value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Reads `30d`, or what [`duration`] reads; a day has 24 hours.
pub(super) fn duration_or_days(text: &str) -> Result<Duration, String> {
    let days = text.strip_suffix('d').and_then(|days| days.trim().parse::<u32>().ok());
    match days {
        Some(days) => Ok(Duration::from_hours(24 * u64::from(days))),
        None => duration(text).map_err(|why| {
            let unspecific = "write a number with its unit: 30d or 12h".to_owned();
            if why == TOO_LONG { why } else { unspecific }
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(peers: &[&str], host: &[&str]) -> Result<String, String> {
        let owned = |texts: &[&str]| texts.iter().map(|&text| text.to_owned()).collect();
        let (peers, host) = (owned(peers), owned(host));
        let (directory, lifetime) = (PathBuf::new(), Duration::from_hours(24));
        let requests = CertsIssueArgs { directory, peers, host, lifetime }.requests();
        let requests = requests.map_err(|error| error.to_string())?;
        Ok(requests.iter().map(ToString::to_string).collect::<Vec<_>>().join(" "))
    }

    #[test]
    fn one_process_is_named_by_two_words_and_several_by_one_word_each() {
        let fine = |peers: &[&str], host: &[&str]| asked(peers, host).unwrap();
        assert_eq!(fine(&["actor", "a1"], &[]), "actor:a1");
        assert_eq!(fine(&["learner", "l1"], &["box", "::1"]), "learner:l1@box,::1");
        assert_eq!(fine(&["learner:l1@box"], &["::1"]), "learner:l1@box,::1");
        assert_eq!(fine(&["router:r1@gate", "actor:a1"], &[]), "router:r1@gate actor:a1");
        for (peers, host, told) in [
            (&["actor"][..], &[][..], "ROLE:NAME"),
            (&["actor", "a1", "a2"], &[], "ROLE:NAME"),
            (&["router:r1", "a1"], &[], "`a1` does not say"),
            (&["king", "a1"], &[], "`king` is not a role"),
            (&["learner:l1", "actor:a1"], &["box"], "learner:l1@HOST"),
        ] {
            let error = asked(peers, host).unwrap_err();
            assert!(error.contains(told), "{peers:?}: {error}");
        }
    }

    #[test]
    fn days_read_as_people_write_them() {
        assert_eq!(duration_or_days("30d"), Ok(Duration::from_hours(720)));
        assert_eq!(duration_or_days("90m"), Ok(Duration::from_mins(90)));
        assert!(["d", "-1d", "1.5d", "30"].iter().all(|text| duration_or_days(text).is_err()));
    }
}
