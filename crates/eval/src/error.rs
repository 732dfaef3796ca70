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
    /// There is no reaction delay to be known, or too little to learn it from; the sentence says why.
    #[error("{0}")]
    Probe(String),
    /// Data to which no line can be fitted.
    #[error(
        "no regression can be fitted to {n_rows} rows of {n_features} features, or they are not finite"
    )]
    NoRegression {
        /// How many rows there are.
        n_rows: usize,
        /// How many features each row has.
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
        /// Width that was asked for, in pixels.
        width: f32,
        /// Height that was asked for, in pixels.
        height: f32,
    },
    /// The PNG encoder failed.
    #[error("the PNG file cannot be written: {0}")]
    Png(String),
    /// The GIF encoder failed.
    #[error("the GIF file cannot be written")]
    Gif(#[from] gif::EncodingError),
}
