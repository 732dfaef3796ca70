//! The charts of a report, each a plain function from numbers to an SVG file.
//!
//! | function | shows |
//! |---|---|
//! | [`curves()`] | how returns, success, ... change over training; raw values faint, smoothed ones strong |
//! | [`bands()`] | the same over several training runs, or any mean with its interval |
//! | [`sheet()`] | several pictures side by side |
//! | [`histogram`] | how often each small whole number occurs, such as staleness |
//! | [`shares`] | what processes spent their time on |

mod bands;
mod bars;
mod curves;
mod legend;
mod sheet;
mod stack;

pub use bands::{Band, BandPanel, bands};
pub use bars::{ShareRow, histogram, shares};
pub use curves::{CurvePanel, Series, curves, smoothed};
pub use sheet::sheet;
