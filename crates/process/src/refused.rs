//! Logs who is refused in a TLS handshake, from the network library's warnings: one line for each cause and minute.
//!
//! The peer itself only learns that no connection comes about, or a short alert. The one who can put it right often sits at
//! this end, so the cause is told here; but a peer tries again every second, and strangers as often as they like.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Instant;

use leadtime_link::RareLine;
use tracing::field::{Field, Visit};
use tracing::{Event, Metadata, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::{FilterFn, filter_fn};
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

/// Whose warnings these are.
const LIBRARY: &str = "zenoh_link";
/// The most refusals that wait to be logged; more than that are not logged.
const MAX_WAITING: usize = 64;

/// Why a peer was refused, or its connection ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum DoorCause {
    Foreign,
    Ended,
    NotYetValid,
    Missing,
    NoTls,
    RefusesUs,
    OwnEnded,
    EndedMeanwhile,
}

impl DoorCause {
    /// Reads the cause off a warning; the library has only words.
    fn of(warning: &str) -> Option<Self> {
        let words = [
            ("certificate chain expired", Self::EndedMeanwhile),
            ("UnknownIssuer", Self::Foreign),
            ("BadSignature", Self::Foreign),
            ("certificate expired", Self::Ended),
            ("not valid yet", Self::NotYetValid),
            ("peer sent no certificates", Self::Missing),
            ("corrupt message", Self::NoTls),
            ("received fatal alert: CertificateExpired", Self::OwnEnded),
            ("received fatal alert", Self::RefusesUs),
        ];
        words.into_iter().find(|(words, _)| warning.contains(words)).map(|(_, cause)| cause)
    }

    fn sentence(self) -> &'static str {
        match self {
            Self::Foreign => "its certificate is not signed by our authority",
            Self::Ended => "its certificate has ended; `leadtime certs renew` makes it anew",
            Self::NotYetValid => "its certificate is not valid yet; do the clocks agree?",
            Self::Missing => "it shows no certificate; it needs --tls DIR/ID",
            Self::NoTls => "it speaks no TLS; it needs `tls/` in its address and --tls DIR/ID",
            Self::RefusesUs => {
                "it refuses our certificate: it has another authority, or dials a name that is not in it"
            }
            Self::OwnEnded => {
                "it refuses our certificate, which has ended; `leadtime certs renew` makes it anew"
            }
            Self::EndedMeanwhile => "",
        }
    }
}

/// Listens to the library's warnings.
#[derive(Debug)]
pub(crate) struct RefusedPeers(Mutex<Option<SyncSender<DoorCause>>>);

/// Makes the layer that tells who is refused.
pub(crate) fn layer<S>() -> impl Layer<S>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
{
    let filter: FilterFn = filter_fn(|event: &Metadata<'_>| {
        event.target().starts_with(LIBRARY) && *event.level() <= tracing::Level::WARN
    });
    RefusedPeers(Mutex::default()).with_filter(filter)
}

impl<S: Subscriber> Layer<S> for RefusedPeers {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut text = EventText(String::new());
        event.record(&mut text);
        let Some(cause) = DoorCause::of(&text.0) else { return };
        let mut sender = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if sender.is_none() {
            *sender = start();
        }
        // What is logged here cannot be logged from here; and a refusal does not wait.
        if let Some(Err(TrySendError::Disconnected(_))) =
            sender.as_ref().map(|it| it.try_send(cause))
        {
            *sender = None;
        }
    }
}

/// Starts the thread that tells; it lives as long as the program.
fn start() -> Option<SyncSender<DoorCause>> {
    let (sender, causes) = sync_channel(MAX_WAITING);
    let work = move || tell(&causes);
    thread::Builder::new().name("leadtime-refused".to_owned()).spawn(work).ok().map(|_| sender)
}

fn tell(causes: &Receiver<DoorCause>) {
    let mut told: BTreeMap<DoorCause, RareLine> = BTreeMap::new();
    for cause in causes {
        let counted = told.entry(cause).or_default();
        if let Some(others) = counted.suffix(Instant::now()) {
            match cause {
                DoorCause::EndedMeanwhile => {
                    tracing::warn!(
                        "a connection is closed: the peer's certificate has ended{others}"
                    );
                }
                cause => tracing::warn!("a peer is refused: {}{others}", cause.sentence()),
            }
        }
    }
}

/// The text of an event.
struct EventText(String);

impl Visit for EventText {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            // Writing to a string does not fail.
            write!(self.0, "{value:?}").unwrap_or_default();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_the_library_are_understood() {
        let hint = "Hint: increase the system open file limit.";
        for (words, cause) in [
            ("invalid peer certificate: UnknownIssuer", Some(DoorCause::Foreign)),
            (
                "invalid peer certificate: certificate expired: verification time 1 (UNIX), but certificate is not valid after 0",
                Some(DoorCause::Ended),
            ),
            ("peer sent no certificates", Some(DoorCause::Missing)),
            ("received corrupt message of type InvalidContentType", Some(DoorCause::NoTls)),
            ("invalid peer certificate: BadSignature", Some(DoorCause::Foreign)),
            ("invalid peer certificate: certificate not valid yet", Some(DoorCause::NotYetValid)),
            ("received fatal alert: CertificateExpired", Some(DoorCause::OwnEnded)),
            ("received fatal alert: UnknownCA", Some(DoorCause::RefusesUs)),
            ("certificate chain expired", Some(DoorCause::EndedMeanwhile)),
            ("tls handshake eof", None),
        ] {
            assert_eq!(DoorCause::of(&format!("{words}. {hint}")), cause, "{words}");
        }
    }
}
