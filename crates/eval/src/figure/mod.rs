//! The charts of a report, each a plain function from numbers to an SVG file.
//!
//! | function | shows |
//! |---|---|
//! | [`bands()`] | means with their spread: over training, over training runs, over conditions |
//! | [`sheet()`] | several pictures side by side |
//! | [`histogram`] | how often each small whole number occurs, such as staleness |
//! | [`shares`] | what processes spent their time on |

mod bands;
mod bars;
mod legend;
mod sheet;

pub use bands::{Band, BandPanel, bands};
pub use bars::{ShareRow, histogram, shares};
pub use sheet::sheet;
