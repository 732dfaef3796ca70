//! Robots and clients as tests need them: any key, any form.

use std::time::Duration;

use zenoh::Wait as _;
use zenoh::key_expr::OwnedKeyExpr;
use zenoh::pubsub::Subscriber;

use super::client::{ClientPort, LOOK, LiveClientLink, MAX_MESSAGES, MAX_SERVICES};
use crate::pubsub::subscribe;
use crate::{Error, Result, discovery};

impl LiveClientLink {
    /// Puts bytes on any key, as a robot does that knows nothing of ours.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network has ended.
    pub fn put_at(&self, key: &str, bytes: &[u8], beside: Option<&[u8]>) -> Result<()> {
        let put = self.session.put(any_key(key)?, bytes).attachment(beside).wait();
        put.map_err(Error::network("publish on", key))
    }

    /// Takes what is put on any key, with what is beside it, for as long as the answer is kept.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if it cannot be declared.
    pub fn take_at(&self, key: &str) -> Result<TakenAt> {
        let (sender, taken) = flume::bounded(MAX_MESSAGES);
        let subscriber = subscribe(&self.session, any_key(key)?, move |sample| {
            let beside = sample.attachment().map(|beside| beside.to_bytes().into_owned());
            drop(sender.try_send((sample.payload().to_bytes().into_owned(), beside)));
        })?;
        Ok(TakenAt { taken, _subscriber: subscriber })
    }

    /// Lists who shows presence at keys now.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network cannot be asked.
    pub async fn presence_at(&self, keys: &str) -> Result<Vec<String>> {
        let (keys, action) = (any_key(keys)?, "look for presence on");
        let found = discovery::tokens(&self.session, keys, action, LOOK, MAX_SERVICES).await?;
        Ok(found.iter().map(ToString::to_string).collect())
    }
}

impl ClientPort {
    /// Puts an observation in a form of the caller's.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network has ended.
    pub fn observe_as(&self, form: &str, bytes: &[u8], beside: Option<&[u8]>) -> Result<()> {
        let put = self.observations.put(bytes).encoding(form).attachment(beside).wait();
        put.map_err(Error::network("publish on", self.observations.key_expr()))
    }
}

/// What is put on a key of somebody else's.
#[derive(Debug)]
pub struct TakenAt {
    taken: flume::Receiver<(Vec<u8>, Option<Vec<u8>>)>,
    _subscriber: Subscriber<()>,
}

impl TakenAt {
    /// Waits for the next message and what is beside it; `None` once `timeout` is over.
    pub fn next(&self, timeout: Duration) -> Option<(Vec<u8>, Option<Vec<u8>>)> {
        self.taken.recv_timeout(timeout).ok()
    }
}

fn any_key(key: &str) -> Result<OwnedKeyExpr> {
    OwnedKeyExpr::autocanonize(key.to_owned()).map_err(Error::network("use", key))
}
