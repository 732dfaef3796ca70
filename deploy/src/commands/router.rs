//! `leadtime router`: passes on what learners, actors and observers send, where they cannot dial each other.

use std::time::Duration;

use anyhow::Context as _;
use leadtime_certs::Role;
use leadtime_link::{RelayCounts, RouterLink};
use leadtime_proto::RegionName;
use leadtime_proto::phrase::counted;
use tokio::time::interval;

use crate::cli::RouterArgs;
use crate::credentials::{listen_settings, listening_failure};
use crate::ending::{Watch, watch};
use crate::exit::{Blame as _, ExitCode, Failure};

/// Pause between two looks at the connections.
const LOOK_EVERY: Duration = Duration::from_secs(1);

pub(super) async fn run(args: &RouterArgs) -> Result<(), Failure> {
    let shutdown = watch(Watch::Signals).blame(ExitCode::Failed)?;
    let settings = listen_settings(&args.listen, &args.connect, &args.guard, Role::Router)
        .blame(ExitCode::WrongInput)?;
    let region = args.region.clone().map(RegionName::new).transpose();
    let region = region.context("--region").blame(ExitCode::WrongInput)?;
    let mut router = RouterLink::open(&settings).await.map_err(listening_failure)?;
    if let Some(region) = &region {
        router.relay_weights(region).map_err(listening_failure)?;
    }
    tracing::info!("router listens at {}", router.locators().join(", "));
    let mut ticks = interval(LOOK_EVERY);
    let mut is_linked = settings.connect.is_empty();
    let above = args.connect.join(", ");
    loop {
        tokio::select! {
            () = shutdown.cancelled() => break,
            _ = ticks.tick() => {}
        }
        router.health().await.map_err(listening_failure)?;
        if settings.connect.is_empty() {
            continue;
        }
        let (n_above, _) = router.n_routers().await;
        if is_linked != (n_above > 0) {
            is_linked = n_above > 0;
            if is_linked {
                tracing::info!("connected to the router at {above}");
            } else {
                tracing::warn!("the router at {above} is gone; looking for it");
            }
        }
    }
    if let Some(region) = region {
        let RelayCounts { pulled, answered, refused } = router.relay_counts();
        let pulled = counted(pulled, "version");
        tracing::info!(
            "region {region}: {pulled} of weights pulled for {answered} questions of actors, {refused} refused"
        );
    }
    // It has no other way to end.
    router.close().await.map_err(listening_failure)
}
