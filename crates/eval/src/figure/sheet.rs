//! Several pictures on one sheet.

use leadtime_table::escape;

use crate::draw::{Ink, Svg, number};

/// Space between pictures, in units.
const GAP: f64 = 16.0;

/// Lays pictures out in rows of `n_columns`, each as large as it is; their ids must differ.
pub fn sheet(title: &str, pictures: &[Svg], n_columns: usize) -> Svg {
    let mut body = String::new();
    let (mut top, mut width) = (0.0, 1.0_f64);
    for row in pictures.chunks(n_columns.max(1)) {
        let (mut left, mut height) = (0.0, 0.0_f64);
        for picture in row {
            let place = format!("<svg x=\"{}\" y=\"{}\" ", number(left), number(top));
            body.push_str(&picture.text.replacen("<svg ", &place, 1));
            left += picture.width + GAP;
            height = height.max(picture.height);
        }
        width = width.max(left - GAP);
        top += height + GAP;
    }
    let height = (top - GAP).max(1.0);
    let [w, h] = [width, height].map(number);
    let (title, paper) = (escape(title), Ink::Paper.light());
    let text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" width=\"{w}\" height=\"{h}\" \
         role=\"img\">\n<title>{title}</title>\n<rect width=\"{w}\" height=\"{h}\" fill=\"{paper}\"/>\n{body}</svg>\n"
    );
    Svg { text, width, height }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{Area, Canvas, Paint, Rasterizer};

    fn picture(id: &str, ink: Ink) -> Svg {
        let mut canvas = Canvas::new(id, 100.0, 40.0);
        canvas.rectangle(Area::new(0.0, 0.0, 100.0, 40.0), 0.0, Paint::fill(ink));
        canvas.finish(id)
    }

    #[test]
    fn pictures_stand_in_rows_and_columns() {
        let inks = [Ink::Blue, Ink::Green, Ink::Orange];
        let pictures: Vec<Svg> = inks.iter().map(|ink| picture(ink.class(), *ink)).collect();
        let sheet = sheet("t", &pictures, 2);
        assert_eq!([sheet.width, sheet.height], [216.0, 96.0]);
        let pixels = Rasterizer::new().pixmap(&sheet.text, 1.0).unwrap();
        assert_eq!((pixels.width(), pixels.height()), (216, 96));
        let at = |x: usize, y: usize| &pixels.data()[(y * 216 + x) * 4..][..3];
        assert_eq!(at(150, 20), [0, 0x9e, 0x73]);
        assert_eq!(at(50, 80), [0xe6, 0x9f, 0]);
        assert_eq!(at(150, 80), [255, 255, 255]);
    }
}
