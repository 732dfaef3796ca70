//! Several pictures on one sheet.

use crate::draw::{Ink, number};

/// Space between pictures, in units.
const GAP: f64 = 16.0;

/// Lays pictures out in rows of `n_columns`, each as large as it is. The pictures are SVG files of ours, with ids that
/// differ.
pub fn sheet(title: &str, pictures: &[String], n_columns: usize) -> String {
    let mut body = String::new();
    let (mut top, mut width) = (0.0, 1.0_f64);
    for row in pictures.chunks(n_columns.max(1)) {
        let (mut left, mut height) = (0.0, 0.0_f64);
        for picture in row {
            let [own_width, own_height] = size(picture).unwrap_or([0.0, 0.0]);
            let place = format!("<svg x=\"{}\" y=\"{}\" ", number(left), number(top));
            body.push_str(&picture.replacen("<svg ", &place, 1));
            left += own_width + GAP;
            height = height.max(own_height);
        }
        width = width.max(left - GAP);
        top += height + GAP;
    }
    let [width, height] = [width, (top - GAP).max(1.0)].map(number);
    let (title, paper) = (crate::draw::escape(title), Ink::Paper.light());
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" role=\"img\">\n<title>{title}</title>\n<rect width=\"{width}\" height=\"{height}\" \
         fill=\"{paper}\"/>\n{body}</svg>\n"
    )
}

/// Reads a picture's width and height from its first line.
fn size(picture: &str) -> Option<[f64; 2]> {
    let read = |name: &str| {
        let (_, after) = picture.split_once(&format!(" {name}=\""))?;
        after.split_once('"')?.0.parse().ok()
    };
    Some([read("width")?, read("height")?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{Area, Canvas, Paint, Rasterizer};

    fn picture(id: &str, ink: Ink) -> String {
        let mut canvas = Canvas::new(id, 100.0, 40.0);
        canvas.rectangle(Area::new(0.0, 0.0, 100.0, 40.0), 0.0, Paint::fill(ink));
        canvas.finish(id)
    }

    #[test]
    fn pictures_stand_in_rows_and_columns() {
        let inks = [Ink::Blue, Ink::Green, Ink::Orange];
        let pictures: Vec<String> = inks.iter().map(|ink| picture(ink.class(), *ink)).collect();
        let pixels = Rasterizer::new().pixels(&sheet("t", &pictures, 2), 1.0).unwrap();
        assert_eq!((pixels.width, pixels.height), (216, 96));
        let at = |x: usize, y: usize| &pixels.rgba[(y * 216 + x) * 4..][..3];
        assert_eq!(at(150, 20), [0, 0x9e, 0x73]);
        assert_eq!(at(50, 80), [0xe6, 0x9f, 0]);
        assert_eq!(at(150, 80), [255, 255, 255]);
    }
}
