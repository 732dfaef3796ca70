//! Who this process is on the network, and whom it lets in: from arguments to what the network's crate takes.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, bail};
use leadtime_certs::{Identity, Role};
use leadtime_link::{AccessList, ConnectSettings, Endpoint, Error as LinkError, ListenSettings};
use leadtime_runs::{clock, regular};

use crate::cli::{self, GuardArgs, NotifierArgs, TlsArgs};
use crate::exit::{Blame as _, ExitCode, Failure};

/// Reads and checks the certificate of this process, which has to be of one of these roles; `None` without --tls.
pub(crate) fn identity(args: &TlsArgs, roles: &[Role]) -> anyhow::Result<Option<Identity>> {
    let Some(prefix) = &args.tls else { return Ok(None) };
    let identity = Identity::read(prefix, clock::now()).context("--tls")?;
    // A certificate of somebody else's making may have no role of ours.
    if let Some(role) = identity.shown.role
        && !roles.contains(&role)
    {
        let roles: Vec<&str> = roles.iter().map(|role| role.as_str()).collect();
        let (wanted, file) = (roles.join(" or "), identity.certificate().display());
        bail!("--tls: {file} is for role {role}; this command needs one for role {wanted}");
    }
    Ok(Some(identity))
}

/// Reads addresses; without a protocol they are TLS where the process has a certificate.
pub(crate) fn endpoints(
    texts: &[String],
    identity: Option<&Identity>,
) -> Result<Vec<Endpoint>, LinkError> {
    match identity {
        None => cli::endpoints(texts),
        Some(_) => texts.iter().map(|text| Endpoint::encrypted(text)).collect(),
    }
}

/// Returns how to dial these addresses, and for how long to look for the peer that is wanted there.
pub(crate) fn connect_settings(
    connect: &[String],
    args: &TlsArgs,
    timeout: Duration,
    roles: &[Role],
) -> anyhow::Result<ConnectSettings> {
    let identity = identity(args, roles)?;
    let endpoints = endpoints(connect, identity.as_ref()).context("--connect")?;
    let settings = ConnectSettings { identity, timeout, ..ConnectSettings::new(endpoints) };
    settings.check().context("--connect")?;
    Ok(settings)
}

/// Returns how to reach a notifier at work.
pub(crate) fn notifier_settings(
    connect: &[String],
    args: &NotifierArgs,
    roles: &[Role],
) -> Result<ConnectSettings, Failure> {
    let settings = connect_settings(connect, &args.tls, args.connect_timeout, roles);
    settings.blame(ExitCode::WrongInput)
}

/// Returns how to listen at these addresses, and warns if strangers can reach one.
pub(crate) fn listen_settings(
    listen: &[String],
    connect: &[String],
    args: &GuardArgs,
    role: Role,
) -> anyhow::Result<ListenSettings> {
    let identity = identity(&args.tls, &[role])?;
    let listen = endpoints(listen, identity.as_ref()).context("--listen")?;
    let connect = endpoints(connect, identity.as_ref()).context("--connect")?;
    let access = args.acl.as_deref().map(access_list).transpose().context("--acl")?;
    let settings = ListenSettings { connect, identity, access, ..ListenSettings::new(listen) };
    settings.check()?;
    warn_of_strangers(&settings, args, role);
    Ok(settings)
}

/// Says to whom everything is open, where that is so.
fn warn_of_strangers(settings: &ListenSettings, args: &GuardArgs, role: Role) {
    let ListenSettings { endpoints: listen, identity, access, .. } = settings;
    if !args.insecure {
        warn_if_open(listen, identity.as_ref());
    }
    if identity.is_some() && access.is_none() && !listen.is_empty() {
        let told = "every process with a certificate of this authority may do everything; --acl FILE limits it";
        // Everybody's messages go through a router: where other machines reach it, that is worth as much as an open address.
        if role == Role::Router
            && listen.iter().any(Endpoint::is_beyond_this_machine)
            && !args.insecure
        {
            tracing::warn!(
                "{told} (`leadtime certs acl` writes it), or say --insecure where everybody may"
            );
        } else {
            tracing::info!("{told}");
        }
    }
}

/// Checks what another process of ours is given to listen with, before anything of it is made.
pub(crate) fn check_listening(
    listen: &[String],
    args: &GuardArgs,
    role: Role,
) -> anyhow::Result<()> {
    let identity = identity(&args.tls, &[role])?;
    let listen = endpoints(listen, identity.as_ref()).context("--listen")?;
    args.acl.as_deref().map(access_list).transpose().context("--acl")?;
    Ok(ListenSettings { identity, ..ListenSettings::new(listen) }.check()?)
}

fn access_list(file: &Path) -> anyhow::Result<AccessList> {
    let text = regular::read_to_string(file);
    let text = text.with_context(|| format!("cannot read {}", file.display()))?;
    AccessList::parse(&text).with_context(|| file.display().to_string())
}

fn warn_if_open(listen: &[Endpoint], identity: Option<&Identity>) {
    // TLS without any certificate is refused, not opened.
    let is_refused = |it: &&Endpoint| it.as_str().starts_with("tls/") && !it.as_str().contains('#');
    let open = listen.iter().filter(|it| it.is_open_to_strangers() && !is_refused(it));
    let open: Vec<String> =
        open.filter(|_| identity.is_none()).map(|endpoint| format!("`{endpoint}`")).collect();
    if !open.is_empty() {
        tracing::warn!(
            "anyone who reaches {} can take part, read and change everything: it asks for no certificate. Listen on `tls/…` with --tls \
             DIR/ID (`leadtime certs` makes the files), or say --insecure where everybody may",
            open.join(", ")
        );
    }
}

/// Returns the arguments that give another process of ours the same.
pub(crate) fn guard_options(args: &GuardArgs) -> Vec<std::ffi::OsString> {
    let paths = [("--tls", &args.tls.tls), ("--acl", &args.acl)];
    let given = paths.into_iter().filter_map(|(option, path)| Some((option, path.as_ref()?)));
    let mut options: Vec<std::ffi::OsString> =
        given.flat_map(|(option, path)| [option.into(), path.into()]).collect();
    options.extend(args.insecure.then(|| "--insecure".into()));
    options
}

/// Chooses the exit code for an error of a process that does nothing but listen and pass on or answer.
pub(crate) fn listening_failure(error: LinkError) -> Failure {
    let is_input = is_wrong_input(&error) || is_wrong_address(&error);
    Failure::of(if is_input { ExitCode::WrongInput } else { ExitCode::PeerLost }, error)
}

/// Chooses the exit code for an error of a process that dials a notifier, or a learner.
pub(crate) fn dialling_failure(error: LinkError) -> Failure {
    let is_input = is_wrong_input(&error) || matches!(error, LinkError::ReservedName(_));
    Failure::of(if is_input { ExitCode::WrongInput } else { ExitCode::PeerLost }, error)
}

/// Returns whether it is an address at which nobody can listen here.
pub(crate) fn is_wrong_address(error: &LinkError) -> bool {
    matches!(
        error,
        LinkError::AddressInUse(_)
            | LinkError::NotOurAddress(_)
            | LinkError::NotASocket(_)
            | LinkError::Listen { .. }
    )
}

/// Returns whether an error of the network is one of the arguments or files that were given.
pub(crate) fn is_wrong_input(error: &LinkError) -> bool {
    matches!(
        error,
        LinkError::Endpoint { .. }
            | LinkError::NoEndpoint
            | LinkError::TlsFile { .. }
            | LinkError::NotEncrypted(_)
            | LinkError::NoCertificate(_)
            | LinkError::TlsTwice(_)
            | LinkError::TlsPath(_)
            | LinkError::AccessList(_)
            | LinkError::AnotherLearner { .. }
            | LinkError::TooFewFiles(_)
    )
}
