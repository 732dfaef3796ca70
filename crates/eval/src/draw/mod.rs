//! Drawing: a small SVG writer, its palette and fonts, axes, and rasterisation.
//!
//! Why not a plotting crate: half of our pictures are worlds with paths and speech, which no such crate draws, so
//! a canvas is needed anyway; on top of it the three charts of a report are a few hundred lines. `kuva` (MIT), the
//! best candidate, would add tens of thousands of lines to every build, and its own look to half of the pictures.
//!
//! A picture is written for a light page with its colours as attributes, so that it is complete on its own and in
//! PNG; the same elements carry classes (`f-text`, `s-grid`, ...), with which a page may recolour them for
//! dark surroundings ([`Ink::dark_css`]).

mod axis;
mod canvas;
mod font;
#[cfg(test)]
pub(crate) mod inspect;
mod palette;
mod raster;
mod wrap;

pub use axis::{Panel, Scale, compact};
pub(crate) use canvas::number;
pub use canvas::{Anchor, Area, Canvas, Paint, Svg, TextStyle};
pub use font::{FAMILY, Weight, text_width};
pub use palette::Ink;
pub use raster::Rasterizer;
pub(crate) use raster::gif;
pub use wrap::wrapped;
