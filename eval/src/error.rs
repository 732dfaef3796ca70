//! What can go wrong when measuring and drawing.

use leadtime_sims::TaskError;
use thiserror::Error;

/// Why an evaluation or a picture failed.
#[derive(Debug, Error)]
pub enum Error {
    /// The environment cannot be made.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// The policy cannot be made.
    #[error("the policy cannot be used")]
    Policy(#[from] leadtime_policy::Error),
    /// The policy is for another task.
    #[error(
        "the policy takes {} observations and has {} choices, the task has {} and {}: it was trained for another \
         task or with other settings",
        found[0], found[1], expected[0], expected[1]
    )]
    PolicyShape {
        /// The policy's observation length and number of choices.
        found: [usize; 2],
        /// The task's.
        expected: [usize; 2],
    },
    /// The task has no such scripted player.
    #[error("the task has no scripted player `{name}`; known: {}", known.join(", "))]
    UnknownBaseline {
        /// As asked for.
        name: String,
        /// What there is.
        known: &'static [&'static str],
    },
    /// An episode that does not come to an end.
    #[error("episode {index} did not end within {n_steps} steps")]
    Endless {
        /// The episode's number.
        index: u64,
        /// Where it was given up.
        n_steps: u64,
    },
    /// A thread cannot be started.
    #[error("a thread for the evaluation cannot be started")]
    Thread(#[source] std::io::Error),
    /// The task describes nothing that could be drawn.
    #[error("this task has nothing to draw")]
    NoScene,
    /// The sentences are for other topics than the task's.
    #[error(transparent)]
    Words(#[from] leadtime_taxonomy::TaxonomyError),
    /// The rasteriser does not take the picture.
    #[error("the picture is not a valid SVG file")]
    Svg(#[from] resvg::usvg::Error),
    /// The picture is empty, gigantic, or of another size than its neighbours.
    #[error("a picture of {width} x {height} pixels cannot be made")]
    PictureSize {
        /// Width in pixels.
        width: f32,
        /// Height in pixels.
        height: f32,
    },
    /// The PNG encoder failed.
    #[error("the PNG file cannot be written: {0}")]
    Png(String),
    /// The GIF encoder failed.
    #[error("the GIF file cannot be written")]
    Gif(#[from] gif::EncodingError),
    /// An animation of nothing.
    #[error("an animation needs at least one frame")]
    NoFrames,
}
