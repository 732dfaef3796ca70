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

    /// Counts the routers and the other processes that are connected now.
    pub async fn n_connected(&self) -> (usize, usize) {
        let info = self.session.info();
        (info.routers_zid().await.count(), info.peers_zid().await.count())
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
