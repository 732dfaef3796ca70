//! What can go wrong when measuring and drawing.

use leadtime_sims::TaskError;
use thiserror::Error;

/// Why an evaluation or a picture failed.
#[derive(Debug, Error)]
pub enum Error {
    /// The episodes cannot be played.
    #[error(transparent)]
    Play(#[from] leadtime_episodes::Error),
    /// The environment cannot be made.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// The player is not a network.
    #[error("`{name}` is a script, which has no features to read anything from")]
    NoFeatures {
        /// The player's name.
        name: String,
    },
    /// The task has no listener, so there is no reaction delay.
    #[error("this task has no listener, so there is no reaction delay to be known")]
    NoListener,
    /// The delay is drawn anew for every message.
    #[error(
        "the person draws another reaction delay for every message, so there is nothing to be known before it; ask \
         for one that stays: drawn = \"per_episode\""
    )]
    DelayPerMessage,
    /// The delay is always the same.
    #[error(
        "the person's reaction delay is {delay} in every episode, so there is nothing to be found out; let it vary, as \
         with --set 'human.reaction_delay={{uniform={{low=0,high=5,drawn=\"per_episode\"}}}}'"
    )]
    DelayNeverVaries {
        /// In steps.
        delay: u32,
    },
    /// Too few episodes to learn from and to be evaluated on.
    #[error("{found} episodes are too few for a probe; allowed: at least {least}")]
    TooFewEpisodes {
        /// As asked for.
        found: u64,
        /// What there must be.
        least: u64,
    },
    /// Data to which no line can be fitted.
    #[error(
        "no regression can be fitted to {n_rows} rows of {n_features} features, or they are not finite"
    )]
    NoRegression {
        /// Rows.
        n_rows: usize,
        /// Features in each.
        n_features: usize,
    },
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
