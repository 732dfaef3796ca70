//! The charts of a report, each a plain function from numbers to an SVG file.
//!
//! | function | shows |
//! |---|---|
//! | [`curves()`] | how returns, success, ... change over training; raw values faint, smoothed ones strong |
//! | [`histogram`] | how often each small whole number occurs, such as staleness |
//! | [`shares`] | what processes spent their time on |

mod bars;
mod curves;

pub use bars::{ShareRow, histogram, shares};
pub use curves::{CurvePanel, Series, curves, smoothed};
