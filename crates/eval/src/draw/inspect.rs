//! What can be read off a written picture: where its texts stand, and whether they can be read. For tests.

use super::{Area, Ink, Rasterizer};

/// The contrast that text of ordinary size needs (WCAG 2.2, 1.4.3).
pub(crate) const LEGIBLE: f64 = 4.5;
/// The share of a text's ground that thin lines and edges may take.
const MAX_CROSSED: f64 = 0.12;

/// A text of a picture, but no halo.
pub(crate) struct FoundText {
    pub(crate) text: String,
    pub(crate) area: Area,
    /// Colour of the letters, as `#rrggbb`.
    colour: String,
    /// The colour of its halo, if it has one.
    halo: Option<String>,
}

/// Computes the contrast of two colours, written as `#rrggbb`.
pub(crate) fn contrast(a: &str, b: &str) -> f64 {
    ratio(luminance(channels(a)), luminance(channels(b)))
}

fn ratio(a: f64, b: f64) -> f64 {
    (a.max(b) + 0.05) / (a.min(b) + 0.05)
}

fn channels(colour: &str) -> [u8; 3] {
    [1, 3, 5].map(|at| u8::from_str_radix(&colour[at..at + 2], 16).expect("#rrggbb"))
}

fn luminance(channels: [u8; 3]) -> f64 {
    let linear = channels.map(|channel| match f64::from(channel) / 255.0 {
        c if c <= 0.04045 => c / 12.92,
        c => ((c + 0.055) / 1.055).powf(2.4),
    });
    0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
}

/// Finds the texts of a picture; they stand one to a line.
pub(crate) fn texts(svg: &str) -> Vec<FoundText> {
    let mut found = Vec::new();
    let mut halo = None;
    for line in svg.lines().filter(|line| line.starts_with("<text ")) {
        let value = |name: &str| {
            let (_, rest) = line.split_once(&format!(" {name}=\""))?;
            Some(rest.split('"').next().expect("closed").to_owned())
        };
        let colour = value("fill").expect("text has a colour");
        if value("aria-hidden").is_some() {
            halo = Some(colour);
            continue;
        }
        let number = |name: &str| value(name).map_or(0.0, |n| n.parse::<f64>().expect("a number"));
        let inner = line.split_once('>').and_then(|(_, rest)| rest.strip_suffix("</text>"));
        let text = inner.expect("one line").replace("&#39;", "'").replace("&quot;", "\"");
        let (x, y, size, width) =
            (number("x"), number("y"), number("font-size"), number("textLength"));
        let start = match value("text-anchor").as_deref() {
            Some("middle") => -width / 2.0,
            Some(_) => -width,
            None => 0.0,
        };
        let (up, height) = (0.75 * size, 0.95 * size);
        let area = match value("transform") {
            None => Area::new(x + start, y - up, width, height),
            Some(_) => Area::new(x - up, y - start - width, height, width),
        };
        found.push(FoundText { text, area, colour, halo: halo.take() });
    }
    found
}

/// Checks that no two texts of a picture lie on each other.
pub(crate) fn assert_apart(svg: &str) {
    let found = texts(svg);
    for (i, a) in found.iter().enumerate() {
        for b in &found[i + 1..] {
            // One that is set a second time, above everything else, is no other text.
            let same = a.text == b.text && a.area == b.area;
            assert!(same || !a.area.overlaps(&b.area), "`{}` and `{}`", a.text, b.text);
        }
    }
}

/// Checks that every text of a picture has enough contrast with what is drawn beneath it, in light and in dark.
pub(crate) fn assert_legible(svg: &str) {
    for svg in [svg.to_owned(), Ink::darkened(svg)] {
        let bare: String =
            svg.split_inclusive('\n').filter(|line| !line.starts_with("<text ")).collect();
        let ground = Rasterizer::new().pixmap(&bare, 1.0).expect("a picture");
        let width = ground.width() as usize;
        let rows: Vec<&[u8]> = ground.data().chunks_exact(4 * width).collect();
        for FoundText { text, area, colour, halo } in texts(&svg) {
            if let Some(halo) = halo {
                assert!(contrast(&colour, &halo) >= LEGIBLE, "`{text}` on its halo");
                continue;
            }
            let own = luminance(channels(&colour));
            let [left, right] = [area.x, area.right()].map(|x| (x.max(0.0) as usize).min(width));
            let [top, bottom] =
                [area.y, area.bottom()].map(|y| (y.max(0.0) as usize).min(rows.len()));
            let pixels =
                rows[top..bottom].iter().flat_map(|row| row[4 * left..4 * right].chunks_exact(4));
            let all: Vec<f64> = pixels.map(|p| ratio(own, luminance([p[0], p[1], p[2]]))).collect();
            let faint = all.iter().filter(|contrast| **contrast < LEGIBLE).count() as f64;
            let worst = all.iter().copied().fold(f64::MAX, f64::min);
            assert!(faint <= MAX_CROSSED * all.len() as f64, "`{text}` ({colour}): {worst:.2}");
        }
    }
}

#[test]
fn contrasts_are_those_of_the_standard() {
    assert!((contrast("#ffffff", "#000000") - 21.0).abs() < 1e-9);
    assert!((contrast("#777777", "#ffffff") - 4.48).abs() < 0.005);
}

#[test]
#[should_panic(expected = "faint")]
fn a_faint_text_is_found() {
    let mut canvas = super::Canvas::new("c", 100.0, 30.0);
    canvas.text([5.0, 20.0], "faint", super::TextStyle::new(12.0, Ink::Grid));
    assert_legible(&canvas.finish("t").text);
}
