//! Measures and draws from policy files, in process.
//!
//! What this crate does not know: the network, the clock, files and arguments. It is given environments and
//! policies, and gives numbers, tables and pictures as text and bytes; `deploy` puts them where they belong.
//!
//! ```text
//! measure      players x environments --> episodes --> means with intervals, tables
//! probe        how well the listener's reaction delay can be read off a policy's features --> table
//! playthrough  one recorded episode: its scenes, its words as a listener would hear them
//! picture      a playthrough --> SVG, PNG, GIF
//! figure       means with bands, histograms, shares of time --> SVG
//! report       all of it --> one self-contained HTML file
//! draw         canvas, palette, typeface, axes, pixels
//! ```
//!
//! # Where to start
//!
//! [`measure::evaluate`] and [`measure::Comparison`]; [`playthrough::Playthrough::record`]; [`report::Report`].

mod description;
pub mod draw;
mod error;
pub mod figure;
pub mod measure;
pub mod picture;
pub mod playthrough;
pub mod probe;
pub mod report;
mod steps;

pub use description::describe;
pub use error::Error;
pub use steps::record_steps;
