//! Does our lander fly like the original? Recorded episodes, replayed open loop.
//!
//! A trace holds an episode of Gymnasium's `LunarLander-v3`: the seed, the wind, and for every frame the action and
//! the observation after it. The replay resets our world with the same seed, so it draws the same ground, start,
//! wind and dispersion, takes the recorded actions, and compares observations until the first contact with the
//! ground in either world (from there on chaos decides), for at most 100 frames.
//!
//! # Source
//!
//! The format is that of the script that recorded them (`{"source", "episodes": [{"seed", "wind", "driver",
//! "reset_obs", "steps": [{"a", "obs", "end", ...}]}]}`); fields that are not needed are ignored.

use leadtime_lander::world::{
    Engine, Lander, LanderOutcome, NoSuchEngine, Physics, PhysicsSettings,
};
use leadtime_numerics::Pcg64;
use serde::{Deserialize, Serialize};

use crate::error::ReplayError;
use crate::section::{Section, mark};

/// The compared components of an observation; the leg flags are all zero before the first contact.
const COMPONENTS: [&str; 6] = ["x", "y", "vx", "vy", "angle", "angular_velocity"];
/// The most frames of an episode that are compared.
const MAX_FRAMES: usize = 100;
/// Largest error per component without wind.
const CALM_BOUNDS: [f64; 6] = [6e-4, 3e-4, 4e-3, 1e-3, 4e-3, 1.2e-2];
/// Largest error per component with wind.
const WIND_BOUNDS: [f64; 6] = [1.6e-3, 3e-4, 6e-3, 1e-3, 4e-3, 1.2e-2];
/// Largest error of any component of a first observation.
const RESET_BOUND: f64 = 1e-4;

#[derive(Deserialize)]
struct LanderTraces {
    source: String,
    episodes: Vec<LanderTrace>,
}

#[derive(Deserialize)]
struct LanderTrace {
    seed: u64,
    wind: bool,
    reset_obs: [f64; 8],
    steps: Vec<RecordedFrame>,
}

#[derive(Deserialize)]
struct RecordedFrame {
    #[serde(rename = "a")]
    action: u8,
    obs: [f64; 8],
    end: bool,
}

impl RecordedFrame {
    /// Tells whether anything touched the ground in this frame: a leg flag, or an end inside the view.
    fn contact(&self) -> bool {
        self.obs[6] != 0.0 || self.obs[7] != 0.0 || (self.end && self.obs[0].abs() < 1.0)
    }
}

/// Errors of one observation component.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ComponentError {
    /// What the component is called.
    pub name: &'static str,
    /// The largest error of all compared frames.
    pub maximum: f64,
    /// The median over episodes of an episode's largest error.
    pub median: f64,
    /// What `maximum` may be.
    pub bound: f64,
}

/// The episodes with, or those without, wind.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WindComparison {
    /// Whether the wind blew.
    pub wind: bool,
    /// Number of episodes.
    pub n_episodes: usize,
    /// Number of compared frames.
    pub n_frames: usize,
    /// The largest error of a first observation, over all components.
    pub reset_error: f64,
    /// Errors before the first contact.
    pub components: Vec<ComponentError>,
    /// Whether every error is within its bound.
    pub passed: bool,
}

/// What a replay found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LanderReport {
    /// What recorded the traces.
    pub source: String,
    /// What a reset error may be.
    pub reset_bound: f64,
    /// Without wind, then with; only what the traces hold.
    pub comparisons: Vec<WindComparison>,
    /// Whether every comparison passed.
    pub passed: bool,
}

impl LanderReport {
    pub(crate) fn sections(&self) -> Vec<Section> {
        let section = |comparison: &WindComparison| {
            let WindComparison { wind, n_episodes, n_frames, reset_error, components, .. } =
                comparison;
            let wind = if *wind { "with wind" } else { "without wind" };
            let row = |name: &str, maximum: f64, median: String, bound: f64| {
                let [largest, allowed] = [maximum, bound].map(|error| format!("{error:.2e}"));
                vec![name.to_owned(), largest, median, allowed, mark(maximum <= bound)]
            };
            let mut rows = vec![row("reset", *reset_error, "-".to_owned(), self.reset_bound)];
            rows.extend(components.iter().map(|error| {
                row(error.name, error.maximum, format!("{:.2e}", error.median), error.bound)
            }));
            let title =
                format!("{wind}: {n_episodes} episodes, {n_frames} frames before first contact");
            let head = vec!["component", "maximum", "median", "bound", ""];
            Section { title, head, rows, notes: Vec::new() }
        };
        self.comparisons.iter().map(section).collect()
    }
}

/// Replays recorded episodes.
///
/// # Errors
///
/// [`ReplayError`] if the text is no set of traces, or holds nothing to compare.
pub fn replay(json: &str, physics: Physics) -> Result<LanderReport, ReplayError> {
    let traces: LanderTraces = serde_json::from_str(json)
        .map_err(|source| ReplayError::Format { what: "traces", source })?;
    let mut comparisons = Vec::new();
    for wind in [false, true] {
        let mut errors = Vec::new();
        for (episode, trace) in traces.episodes.iter().enumerate() {
            if trace.wind == wind {
                let error = compare(trace, physics);
                errors.push(error.map_err(|source| ReplayError::Action { episode, source })?);
            }
        }
        if !errors.is_empty() {
            comparisons.push(summarize(wind, &errors));
        }
    }
    if comparisons.iter().all(|comparison| comparison.n_frames == 0) {
        return Err(ReplayError::Empty { what: "traces hold no frame" });
    }
    let passed = comparisons.iter().all(|comparison| comparison.passed);
    Ok(LanderReport { source: traces.source, reset_bound: RESET_BOUND, comparisons, passed })
}

/// The largest errors of one episode.
struct EpisodeError {
    reset: f64,
    components: [f64; 6],
    n_frames: usize,
}

fn compare(trace: &LanderTrace, physics: Physics) -> Result<EpisodeError, NoSuchEngine> {
    let settings = PhysicsSettings { physics, wind: trace.wind, ..PhysicsSettings::default() };
    let mut lander = Lander::new(&settings);
    let first = lander.reset(Pcg64::seed_from_u64(trace.seed));
    let reset = errors(&first, &trace.reset_obs).into_iter().fold(0.0, worse);
    let mut found = EpisodeError { reset, components: [0.0; 6], n_frames: 0 };
    for step in trace.steps.iter().take(MAX_FRAMES).take_while(|step| !step.contact()) {
        let frame = lander.step(Engine::try_from(step.action)?);
        if frame.outcome == Some(LanderOutcome::Crashed) || lander.leg_contacts() != [false; 2] {
            break;
        }
        let errors = errors(&frame.observation, &step.obs);
        for (largest, error) in found.components.iter_mut().zip(errors) {
            *largest = worse(*largest, error);
        }
        found.n_frames += 1;
        if frame.outcome.is_some() {
            break;
        }
    }
    Ok(found)
}

fn errors(ours: &[f32; 8], theirs: &[f64; 8]) -> [f64; 8] {
    std::array::from_fn(|i| (f64::from(ours[i]) - theirs[i]).abs())
}

/// Returns the larger error; a NaN is the largest of all.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

fn summarize(wind: bool, episodes: &[EpisodeError]) -> WindComparison {
    let bounds = if wind { WIND_BOUNDS } else { CALM_BOUNDS };
    let component = |i: usize| {
        let mut errors: Vec<f64> = episodes.iter().map(|episode| episode.components[i]).collect();
        errors.sort_by(f64::total_cmp);
        let middle = errors.len() / 2;
        let below = errors[(errors.len() - 1) / 2];
        let maximum = errors.iter().copied().fold(0.0, worse);
        let median = 0.5 * (errors[middle] + below);
        ComponentError { name: COMPONENTS[i], maximum, median, bound: bounds[i] }
    };
    let components: Vec<ComponentError> = (0..COMPONENTS.len()).map(component).collect();
    let reset_error = episodes.iter().map(|episode| episode.reset).fold(0.0, worse);
    let within = components.iter().all(|error| error.maximum <= error.bound);
    WindComparison {
        wind,
        n_episodes: episodes.len(),
        n_frames: episodes.iter().map(|episode| episode.n_frames).sum(),
        reset_error,
        components,
        passed: within && reset_error <= RESET_BOUND,
    }
}
