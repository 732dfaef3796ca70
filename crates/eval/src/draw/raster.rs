//! From SVG to pixels: PNG and animated GIF, with the embedded typeface and nothing of the machine's.

use std::sync::Arc;

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg;

use super::font::{BOLD_FACE, REGULAR_FACE};
use crate::error::Error;

/// The widest or highest picture that is made, in pixels.
const MAX_SIDE: u32 = 16_384;

/// Turns pictures into pixels.
#[derive(Clone, Debug)]
pub struct Rasterizer {
    fonts: Arc<usvg::fontdb::Database>,
}

impl Default for Rasterizer {
    fn default() -> Self {
        Self::new()
    }
}

impl Rasterizer {
    /// Loads the embedded typeface.
    pub fn new() -> Self {
        let mut fonts = usvg::fontdb::Database::new();
        fonts.load_font_data(REGULAR_FACE.to_vec());
        fonts.load_font_data(BOLD_FACE.to_vec());
        fonts.set_sans_serif_family("Inter");
        fonts.set_serif_family("Inter");
        Self { fonts: Arc::new(fonts) }
    }

    /// Renders an SVG file as a PNG file, `scale` pixels per unit.
    ///
    /// # Errors
    ///
    /// [`Error::Svg`] if it is not an SVG file, [`Error::PictureSize`] if the picture would be empty or gigantic.
    pub fn png(&self, svg: &str, scale: f32) -> Result<Vec<u8>, Error> {
        self.pixmap(svg, scale)?.encode_png().map_err(|error| Error::Png(error.to_string()))
    }

    /// Renders an SVG file as pixels; errors as [`Rasterizer::png`].
    pub(crate) fn pixmap(&self, svg: &str, scale: f32) -> Result<Pixmap, Error> {
        let options = usvg::Options {
            fontdb: Arc::clone(&self.fonts),
            font_family: "Inter".to_owned(),
            ..usvg::Options::default()
        };
        let tree = usvg::Tree::from_str(svg, &options)?;
        let [width, height] = [tree.size().width(), tree.size().height()].map(|side| side * scale);
        let error = Error::PictureSize { width, height };
        let fits = |side: f32| side >= 1.0 && side <= MAX_SIDE as f32;
        if !fits(width) || !fits(height) {
            return Err(error);
        }
        let mut pixmap = Pixmap::new(width.round() as u32, height.round() as u32).ok_or(error)?;
        resvg::render(&tree, Transform::from_scale(scale, scale), &mut pixmap.as_mut());
        Ok(pixmap)
    }
}

/// Joins frames of one size into an animated GIF that repeats for ever.
///
/// A frame stays for `delay`, and the last one for `last`, in hundredths of a second.
///
/// # Errors
///
/// [`Error::NoScene`] without frames, [`Error::PictureSize`] if a frame has another size than the first or is
/// wider or higher than a GIF can be, [`Error::Gif`] if the encoder fails.
pub(crate) fn gif(frames: &[Pixmap], delay: u16, last: u16) -> Result<Vec<u8>, Error> {
    let first = frames.first().ok_or(Error::NoScene)?;
    let error =
        |p: &Pixmap| Error::PictureSize { width: p.width() as f32, height: p.height() as f32 };
    let (Ok(width), Ok(height)) = (first.width().try_into(), first.height().try_into()) else {
        return Err(error(first));
    };
    let mut file = Vec::new();
    let mut encoder = gif::Encoder::new(&mut file, width, height, &[])?;
    encoder.set_repeat(gif::Repeat::Infinite)?;
    for (i, frame) in frames.iter().enumerate() {
        if (frame.width(), frame.height()) != (first.width(), first.height()) {
            return Err(error(frame));
        }
        let mut rgba = frame.data().to_vec();
        let mut coded = gif::Frame::from_rgba_speed(width, height, &mut rgba, GIF_SPEED);
        coded.delay = if i + 1 == frames.len() { last } else { delay };
        encoder.write_frame(&coded)?;
    }
    drop(encoder);
    Ok(file)
}

/// How hard the colour quantiser works, 1 (best) to 30 (fastest); our pictures have few colours.
const GIF_SPEED: i32 = 15;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{Canvas, Ink, TextStyle};

    fn picture_in(text: &str, style: TextStyle) -> String {
        let mut canvas = Canvas::new("t", 60.0, 30.0);
        canvas.text([5.0, 20.0], text, style);
        canvas.finish("t").text
    }

    fn picture(text: &str) -> String {
        picture_in(text, TextStyle::new(16.0, Ink::Text))
    }

    #[test]
    fn text_is_drawn_in_two_faces_without_any_font_of_the_machine() {
        let dark_pixels = |text: &str, style: TextStyle| {
            let pixels = Rasterizer::new().pixmap(&picture_in(text, style), 2.0).unwrap();
            assert_eq!((pixels.width(), pixels.height()), (120, 60));
            pixels.data().chunks_exact(4).filter(|p| p[0] < 128 && p[3] == 255).count()
        };
        let style = TextStyle::new(16.0, Ink::Text);
        assert_eq!(dark_pixels("", style), 0);
        let regular = dark_pixels("shift", style);
        assert!(regular > 100, "{regular}");
        assert!(dark_pixels("shift", style.bold()) > regular + 20);
    }

    #[test]
    fn a_png_file_is_one() {
        let png = Rasterizer::new().png(&picture("x"), 1.0).unwrap();
        assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
    }

    #[test]
    fn what_cannot_be_a_picture_is_refused() {
        let rasterizer = Rasterizer::new();
        assert!(matches!(rasterizer.png("no svg", 1.0), Err(Error::Svg(_))));
        assert!(matches!(rasterizer.png(&picture(""), 0.0), Err(Error::PictureSize { .. })));
        assert!(matches!(rasterizer.png(&picture(""), 1e6), Err(Error::PictureSize { .. })));
        assert!(matches!(gif(&[], 1, 1), Err(Error::NoScene)));
    }

    #[test]
    fn an_animation_holds_its_frames() {
        let rasterizer = Rasterizer::new();
        let frames = ["a", "b", "c"].map(|t| rasterizer.pixmap(&picture(t), 1.0).unwrap());
        let file = gif(&frames, 5, 70).unwrap();
        let mut reader = gif::DecodeOptions::new().read_info(file.as_slice()).unwrap();
        let mut delays = Vec::new();
        while let Some(frame) = reader.read_next_frame().unwrap() {
            assert_eq!((frame.width, frame.height), (60, 30));
            delays.push(frame.delay);
        }
        assert_eq!(delays, [5, 5, 70]);
        let small = Pixmap::new(1, 1).unwrap();
        assert!(matches!(gif(&[frames[0].clone(), small], 1, 1), Err(Error::PictureSize { .. })));
    }
}
