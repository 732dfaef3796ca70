//! Measures and draws from policy files, in process.
//!
//! What this crate does not know: the network, the clock, files and arguments. It is given environments and
//! policies, and gives numbers, tables and pictures as text and bytes; `deploy` puts them where they belong.
//!
//! ```text
//! measure      players x environments --> episodes --> means with intervals, tables
//! probe        what a policy's features tell of the person's reaction delay --> table
//! playthrough  one episode --> SVG, PNG, GIF, and its words as a person would hear them
//! figure       curves, histograms, shares of time --> SVG
//! report       all of it --> one self-contained HTML file
//! study        policies of several training seeds beside published figures --> Markdown, JSON
//! draw         canvas, inks, typeface, axes, pixels
//! ```
//!
//! # Where to start
//!
//! [`measure::evaluate`] and [`measure::Comparison`]; [`playthrough::Playthrough::record`]; [`report::Report`].

pub mod draw;
mod error;
pub mod figure;
pub mod measure;
pub mod playthrough;
pub mod probe;
pub mod report;
pub mod study;

pub use error::Error;
