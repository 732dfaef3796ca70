//! A router: it passes on what others send, where a learner cannot be dialled by everybody.
//!
//! Learner, actors and observers dial it; routers dial upwards only, so that they make a tree.

use leadtime_proto::RegionName;
use zenoh::session::Session;

use crate::relay::{Relay, RelayCounts};
use crate::{Error, ListenSettings, Result, session};

/// A router's place on the network.
#[derive(Debug)]
pub struct RouterLink {
    locators: Vec<String>,
    relay: Option<Relay>,
    /// Last, because fields are dropped in order: everything declared on the session is undeclared before it closes.
    session: Session,
}

impl RouterLink {
    /// Listens, and passes messages on from now on. Keeps trying to reach an upstream router that is absent.
    ///
    /// # Errors
    ///
    /// [`Error::NoEndpoint`], [`Error::AddressInUse`], [`Error::NotOurAddress`], [`Error::NotASocket`] or [`Error::Listen`].
    pub async fn open(settings: &ListenSettings) -> Result<Self> {
        if settings.endpoints.is_empty() {
            return Err(Error::NoEndpoint);
        }
        let session = session::listen_as_router(settings).await?;
        let locators = session.info().locators().await;
        Ok(Self {
            locators: locators.iter().map(ToString::to_string).collect(),
            relay: None,
            session,
        })
    }

    /// Returns the addresses at which it can be reached, with the ports that were taken.
    pub fn locators(&self) -> &[String] {
        &self.locators
    }

    /// Also pulls weights for the actors of a region from now on: each version once, whatever the number of actors.
    ///
    /// # Errors
    ///
    /// [`Error::Thread`], or [`Error::Network`] if the questions' place cannot be declared.
    pub fn relay_weights(&mut self, region: &RegionName) -> Result<()> {
        self.relay = Some(Relay::start(&self.session, region)?);
        Ok(())
    }

    /// Returns the relay's counts since it started; zeros without a relay.
    pub fn relay_counts(&self) -> RelayCounts {
        self.relay.as_ref().map(Relay::counts).unwrap_or_default()
    }

    /// Counts the routers that are connected now: those that this one has dialled, and those that have dialled it.
    pub async fn n_routers(&self) -> (usize, usize) {
        let info = self.session.info();
        let routers: Vec<_> = info.routers_zid().await.collect();
        let links: Vec<_> = info.links().await.collect();
        let is_accepted = |source: &str| self.locators.iter().any(|own| door(own) == door(source));
        let (mut n_above, mut n_below) = (0, 0);
        for router in routers {
            let mut links = links.iter().filter(|link| *link.zid() == router);
            if links.any(|link| !is_accepted(&link.src().to_string())) {
                n_above += 1;
            } else {
                n_below += 1;
            }
        }
        (n_above, n_below)
    }

    /// Checks that the router can still be reached. Call it regularly: no event reports that it cannot.
    ///
    /// # Errors
    ///
    /// [`Error::Dead`] if it cannot.
    pub async fn health(&self) -> Result<()> {
        if session::is_dead(&self.session, true).await { Err(Error::Dead) } else { Ok(()) }
    }

    /// Leaves the network, within a limited time.
    ///
    /// # Errors
    ///
    /// [`Error::Close`] if it takes too long.
    pub async fn close(&self) -> Result<()> {
        session::close(&self.session).await
    }
}

/// Returns what this end of a connection has in common with the address that accepted it: the protocol, with a socket's path or else
/// the port. A peer that dials has a port, or a path, of its own.
fn door(locator: &str) -> (&str, &str) {
    let (protocol, rest) = locator.split_once('/').unwrap_or((locator, ""));
    let address = rest.split(['?', '#']).next().unwrap_or_default();
    let port = address.rsplit_once(':').filter(|_| !address.starts_with('/'));
    (protocol, port.map_or(address, |(_, port)| port))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_accepted_connection_ends_at_the_door_where_somebody_listens() {
        for (listens, source, is_accepted) in [
            ("tcp/10.0.0.1:7447", "tcp/10.0.0.2:7447", true),
            ("tls/[::]:7447", "tls/[fe80::1]:7447", true),
            ("tcp/127.0.0.1:7447", "tcp/127.0.0.1:40404", false),
            ("tls/10.0.0.1:7447", "tcp/10.0.0.1:7447", false),
            ("unixsock-stream//run/r:1", "unixsock-stream//run/r:1", true),
            ("unixsock-stream//run/r:1", "unixsock-stream/0b8c-77", false),
        ] {
            assert_eq!(door(listens) == door(source), is_accepted, "{source} at {listens}");
        }
    }
}
