//! What can go wrong when measuring and drawing.

use leadtime_sims::TaskError;
use thiserror::Error;

/// Why an evaluation or a picture failed.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum Error {
    #[error(transparent)]
    Play(#[from] leadtime_episodes::Error),
    #[error(transparent)]
    Task(#[from] TaskError),
    /// There is no reaction delay to be known, or too little to learn it from; the sentence says why.
    #[error("{0}")]
    Probe(String),
    #[error(
        "no regression can be fitted to {n_rows} rows of {n_features} features, or they are not finite"
    )]
    NoRegression { n_rows: usize, n_features: usize },
    #[error("this task has nothing to draw")]
    NoScene,
    /// The sentences are for other topics than the task's.
    #[error(transparent)]
    Words(#[from] leadtime_taxonomy::TaxonomyError),
    #[error("the picture is not a valid SVG file")]
    Svg(#[from] resvg::usvg::Error),
    /// The picture is empty, gigantic, or of another size than its neighbours.
    #[error("a picture of {width} x {height} pixels cannot be made")]
    PictureSize { width: f32, height: f32 },
    #[error("the PNG file cannot be written: {0}")]
    Png(String),
    #[error("the GIF file cannot be written")]
    Gif(#[from] gif::EncodingError),
}
