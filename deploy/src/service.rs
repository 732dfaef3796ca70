//! Notifies the service manager through the socket in `NOTIFY_SOCKET`; does nothing without one.
//!
//! READY: the first complete roster is here. WATCHDOG: the run's loop goes round. STOPPING: the process is about to end.

use std::ffi::OsStr;
use std::io;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use sd_notify::{NotifyState, watchdog_enabled};

/// The variable that names the manager's socket: a path, or a name after `@` that no file has.
const SOCKET_VARIABLE: &str = "NOTIFY_SOCKET";
/// Whether it was logged that nobody can be notified there.
static HAS_WARNED: AtomicBool = AtomicBool::new(false);

/// The run's side of the service manager.
#[derive(Debug)]
pub(crate) struct Service {
    is_ready: bool,
    /// How often the watchdog wants to hear something, at least.
    watchdog: Option<Duration>,
    last_sign: Option<Instant>,
}

impl Service {
    /// Looks whether there is a service manager, and whether it watches.
    pub(crate) fn find() -> Self {
        Self { is_ready: false, watchdog: watchdog_enabled(), last_sign: None }
    }

    /// Notes that the run's loop went round, with or without enough actors.
    pub(crate) fn tick(&mut self, is_complete: bool) {
        if is_complete && !std::mem::replace(&mut self.is_ready, true) {
            tell(&NotifyState::Ready);
        }
        let Some(watchdog) = self.watchdog else { return };
        if self.last_sign.is_none_or(|at| at.elapsed() >= watchdog / 3) {
            self.last_sign = Some(Instant::now());
            tell(&NotifyState::Watchdog);
        }
    }
}

/// Says that the process needs nothing more: a manager that waits for it to be ready would take its end for a failure.
pub(crate) fn ready() {
    tell(&NotifyState::Ready);
}

/// Says that the process is about to end.
pub(crate) fn stopping() {
    tell(&NotifyState::Stopping);
}

/// Asks for more time to end.
pub(crate) fn extend(time: Duration) {
    let micros = u32::try_from(time.as_micros()).unwrap_or(u32::MAX);
    tell(&NotifyState::ExtendTimeoutUsec(micros));
}

fn tell(state: &NotifyState<'_>) {
    let place = std::env::var_os(SOCKET_VARIABLE).filter(|place| !place.is_empty());
    let Some(place) = place else { return };
    if let Err(error) = send(&place, &format!("{state}\n"))
        && !HAS_WARNED.swap(true, Ordering::Relaxed)
    {
        let place = place.display();
        tracing::warn!(
            "the service manager at `{place}` ({SOCKET_VARIABLE}) cannot be notified: {error}"
        );
    }
}

/// Sends the manager a message. The crate that knows the messages takes a name after `@` for a path.
fn send(place: &OsStr, message: &str) -> io::Result<()> {
    let address = match place.as_bytes().split_first() {
        Some((b'@', name)) => SocketAddr::from_abstract_name(name)?,
        _ => SocketAddr::from_pathname(place)?,
    };
    let socket = UnixDatagram::unbound()?;
    socket.connect_addr(&address)?;
    socket.send(message.as_bytes()).map(drop)
}
