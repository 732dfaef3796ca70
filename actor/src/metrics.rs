//! What an actor tells observers once a second: progress, and where its time goes.

use std::time::Duration;

use serde_json::json;

use crate::collect::{CollectTimes, Collected};
use crate::state::Actor;

/// Sums since the actor's start.
#[derive(Debug, Default)]
pub(crate) struct Metrics {
    pub(crate) n_steps: u64,
    pub(crate) publish: Duration,
    times: CollectTimes,
}

impl Metrics {
    /// Adds what the collecting thread did for one job.
    pub(crate) fn add(&mut self, collected: &Collected, n_steps: u32) {
        self.n_steps += collected.rollouts.len() as u64 * u64::from(n_steps);
        self.times.infer += collected.times.infer;
        self.times.simulate += collected.times.simulate;
        self.times.encode += collected.times.encode;
        self.times.wait += collected.times.wait;
    }

    /// Writes the report; times in seconds.
    pub(crate) fn report<W, R, E>(&self, actor: &Actor<W, R, E>) -> String {
        let report = json!({
            "n_steps": self.n_steps,
            "n_rollouts_published": actor.outbox.sent.0,
            "n_rollouts_acknowledged": actor.outbox.acknowledged.0,
            "iteration": actor.next.map(|iteration| iteration.0),
            "n_reconnects": actor.n_reconnects,
            "infer_s": self.times.infer.as_secs_f64(),
            "simulate_s": self.times.simulate.as_secs_f64(),
            "encode_s": self.times.encode.as_secs_f64(),
            "wait_s": self.times.wait.as_secs_f64(),
            "publish_s": self.publish.as_secs_f64(),
        });
        report.to_string()
    }
}
