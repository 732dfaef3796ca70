//! Who gets a certificate, as a person writes it: `learner:l1@train.example.org`.

use std::fmt;
use std::str::FromStr;

use crate::{Error, PeerName, Role};

/// A certificate that is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IssueRequest {
    /// What its process does.
    pub role: Role,
    /// The name of its process.
    pub name: PeerName,
    /// The names and addresses under which it is dialled; a process that only dials others needs none.
    pub hosts: Vec<String>,
}

impl FromStr for IssueRequest {
    type Err = Error;

    /// Reads `ROLE:NAME` or `ROLE:NAME@HOST`, with commas between several hosts; an address of IPv6 may be one.
    fn from_str(text: &str) -> Result<Self, Error> {
        let (role, rest) =
            text.split_once(':').ok_or_else(|| Error::Request(text.chars().take(80).collect()))?;
        let (name, hosts) =
            rest.split_once('@').map_or((rest, None), |(name, hosts)| (name, Some(hosts)));
        let hosts = hosts.map(|hosts| hosts.split(',').map(str::to_owned).collect());
        Ok(Self { role: role.parse()?, name: name.parse()?, hosts: hosts.unwrap_or_default() })
    }
}

impl fmt::Display for IssueRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.role, self.name)?;
        if self.hosts.is_empty() { Ok(()) } else { write!(f, "@{}", self.hosts.join(",")) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_read_as_it_is_written() {
        for (text, hosts) in [
            ("actor:a1", &[][..]),
            ("router:r1@gate.example.org", &["gate.example.org"]),
            ("learner:l1@train,10.0.0.1,fe80::1", &["train", "10.0.0.1", "fe80::1"]),
        ] {
            let request: IssueRequest = text.parse().unwrap();
            assert_eq!(
                (request.hosts.as_slice(), request.to_string()),
                (&*hosts.iter().map(|&host| host.to_owned()).collect::<Vec<_>>(), text.to_owned())
            );
        }
        for (text, told) in [
            ("actor", "ROLE:NAME"),
            ("king:a1", "`king` is not a role"),
            ("actor:A", "`A` is not a name"),
            ("actor:", "`` is not a name"),
            (":a1", "`` is not a role"),
        ] {
            let error = text.parse::<IssueRequest>().unwrap_err().to_string();
            assert!(error.contains(told), "{text}: {error}");
        }
    }
}
