//! Every limit on what may cross the network, in one place.

/// The largest rollout message, in bytes.
pub const MAX_ROLLOUT_BYTES: usize = 16 << 20;
/// The largest control message (an assignment carries a snapshot per environment), in bytes.
pub const MAX_CONTROL_BYTES: usize = 8 << 20;
/// The largest hello, in bytes.
pub const MAX_HELLO_BYTES: usize = 64 << 10;
/// The largest credit or announcement (a digest for every version that the longest lag needs), in bytes.
pub const MAX_NOTICE_BYTES: usize = 4 << 10;
/// The largest report of metrics, in bytes.
pub const MAX_METRICS_BYTES: usize = 1 << 20;
/// The largest message of a client to a notifier at work, or back, in bytes.
pub const MAX_LIVE_BYTES: usize = 64 << 10;
/// The most points per number that an answer about a run's history has.
pub const MAX_HISTORY_POINTS: usize = 4_000;
/// The largest set of policy parameters, in bytes.
pub const MAX_WEIGHTS_BYTES: usize = 64 << 20;
/// The largest message of all, in bytes. A process takes a little more from the network, for keys and headers; learners and routers
/// take less, for they read no weights.
pub const MAX_MESSAGE_BYTES: usize = 64 << 20;
/// The largest snapshot of one environment, in bytes.
pub const MAX_SNAPSHOT_BYTES: usize = 256 << 10;
/// The most steps in one rollout.
pub const MAX_ROLLOUT_STEPS: usize = 65_536;
/// The most environments in one run.
pub const MAX_ENVS: usize = 65_536;
/// A number of an assignment, or of a rollout or an episode within its environment, that no run reaches: a message beyond it is
/// nonsense.
pub const MAX_COUNT: u64 = 1 << 48;
/// The highest number of an assignment above which a learner goes on counting, for the actor that names it. Half of
/// [`MAX_COUNT`], so that there is room above whatever somebody else has told its actors.
pub const MAX_HEARD_EPOCH: u64 = MAX_COUNT / 2;
/// The most rollouts that one actor may have unacknowledged.
pub const MAX_WINDOW: u32 = 4_096;
/// The most updates that acting may run ahead of learning in a deterministic schedule.
pub const MAX_LAG: u64 = 64;
/// The largest magnitude of a number in a rollout: squared and summed over an update it is still finite in `f32`.
pub const MAX_MAGNITUDE: f64 = 1e9;

/// Returns whether a rollout may hold a number. An actor that restores a state with larger ones is refused for what follows from them.
pub fn may_hold(value: impl Into<f64>) -> bool {
    value.into().abs() <= MAX_MAGNITUDE
}

/// The lowest log-probability of an action that was sampled; far below what rounding leaves of the least likely one.
pub const MIN_LOG_PROB: f32 = -1e4;
/// The highest log-probability of an action: 0, and what rounding adds to it.
pub const MAX_LOG_PROB: f32 = 1e-3;
/// The most choices over all heads of an action (a [`crate::Mask`] is one 64-bit word).
pub const MAX_CHOICES: usize = 64;
/// The most heads of an action.
pub const MAX_HEADS: usize = 8;
/// How many refused messages an actor may send before it is cut off.
pub const REFUSALS_BEFORE_CUT_OFF: u64 = 16;
