//! The arguments of what goes over a network: certificates, access, routers.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use leadtime_certs::{PeerName, Role};

use super::duration;

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
    /// Routers above this one; routers make a tree.
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
    /// Make the certificate and key of one process.
    Issue(CertsIssueArgs),
    /// Make the certificates anew that end soon; keys stay, and processes take the new files by themselves.
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
    /// What the process is: router, learner, actor, observer (reads metrics and weights), recorder (also rollouts), service
    /// (a notifier at work) or robot (one of its clients).
    pub role: Role,
    /// Its name: a-z, 0-9 and `-`; an actor takes part under it, and a robot is a client of that name.
    pub id: PeerName,
    /// A host's name or address under which it is dialled; repeatable. Who only dials others needs none.
    #[arg(long, value_name = "NAME")]
    pub host: Vec<String>,
    /// How long it lasts.
    #[arg(long, value_name = "DURATION", default_value = "90d", value_parser = duration_or_days)]
    pub lifetime: Duration,
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
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Reads `30d`, or what [`duration`] reads; a day has 24 hours.
pub(super) fn duration_or_days(text: &str) -> Result<Duration, String> {
    let days = text.strip_suffix('d').and_then(|days| days.trim().parse::<u32>().ok());
    match days {
        Some(days) => Ok(Duration::from_hours(24 * u64::from(days))),
        None => {
            duration(text).map_err(|_other| "write a number with its unit: 30d or 12h".to_owned())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_read_as_people_write_them() {
        assert_eq!(duration_or_days("30d"), Ok(Duration::from_hours(720)));
        assert_eq!(duration_or_days("90m"), Ok(Duration::from_mins(90)));
        assert!(["d", "-1d", "1.5d", "30"].iter().all(|text| duration_or_days(text).is_err()));
    }
}
