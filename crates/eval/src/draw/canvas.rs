//! An SVG file in the making: elements are appended, coordinates are rounded, text is escaped.
//!
//! It cannot be asked for anything that is not well formed: groups are closures, every text and attribute value
//! goes through [`escape`], and a coordinate that is no number is written as 0.

use std::fmt::Write as _;

use leadtime_table::escape;

use super::font::{FAMILY, Weight, text_width};
use super::palette::Ink;

/// Writes a coordinate with at most two decimals.
pub(crate) fn number(value: f64) -> String {
    if value.is_finite() { trimmed(&format!("{value:.2}")).to_owned() } else { "0".to_owned() }
}

/// Drops the zeros at the end of a fraction, and the sign of a zero.
pub(super) fn trimmed(text: &str) -> &str {
    let fraction = text.contains('.');
    let text = if fraction { text.trim_end_matches('0').trim_end_matches('.') } else { text };
    if text == "-0" { "0" } else { text }
}

/// A rectangle on the canvas, in pixels; y grows downward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    /// Left edge, in pixels.
    pub x: f64,
    /// Top edge, in pixels.
    pub y: f64,
    /// Width, in pixels, at least 0.
    pub width: f64,
    /// Height, in pixels, at least 0.
    pub height: f64,
}

impl Area {
    /// Names a rectangle by its upper left corner and its size.
    pub fn new(x: f64, y: f64, width: f64, height: f64) -> Self {
        Self { x, y, width, height }
    }

    /// Returns the right edge.
    pub fn right(&self) -> f64 {
        self.x + self.width
    }

    /// Returns the bottom edge.
    pub fn bottom(&self) -> f64 {
        self.y + self.height
    }

    /// Returns whether two rectangles share any point.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.x < other.right()
            && other.x < self.right()
            && self.y < other.bottom()
            && other.y < self.bottom()
    }

    /// Returns whether `other` lies wholly inside.
    pub fn encloses(&self, other: &Self) -> bool {
        self.x <= other.x
            && other.right() <= self.right()
            && self.y <= other.y
            && other.bottom() <= self.bottom()
    }
}

/// How a shape is filled and outlined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paint {
    fill: Option<Ink>,
    stroke: Option<Ink>,
    width: f64,
    opacity: f64,
    fill_opacity: f64,
    dash: Option<(f64, f64)>,
}

impl Paint {
    /// Fills, without an outline.
    pub fn fill(ink: Ink) -> Self {
        Self { fill: Some(ink), stroke: None, ..Self::stroke(ink, 0.0) }
    }

    /// Outlines, without a filling; `width` in pixels.
    pub fn stroke(ink: Ink, width: f64) -> Self {
        let (fill, stroke) = (None, Some(ink));
        Self { fill, stroke, width, opacity: 1.0, fill_opacity: 1.0, dash: None }
    }

    /// Adds an outline of `width` pixels.
    pub fn outlined(self, ink: Ink, width: f64) -> Self {
        Self { stroke: Some(ink), width, ..self }
    }

    /// Makes the whole shape translucent, 0 to 1.
    pub fn opacity(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    /// Makes the filling alone translucent, 0 to 1.
    pub fn fill_opacity(self, fill_opacity: f64) -> Self {
        Self { fill_opacity, ..self }
    }

    /// Dashes the outline: drawn and skipped lengths in pixels.
    pub fn dashed(self, drawn: f64, skipped: f64) -> Self {
        Self { dash: Some((drawn, skipped)), ..self }
    }

    fn attributes(&self) -> String {
        let mut classes = Vec::new();
        let mut out = String::new();
        match self.fill {
            Some(ink) => {
                classes.push(format!("f-{}", ink.class()));
                attribute(&mut out, "fill", ink.light());
            }
            None => attribute(&mut out, "fill", "none"),
        }
        if let Some(ink) = self.stroke {
            classes.push(format!("s-{}", ink.class()));
            attribute(&mut out, "stroke", ink.light());
            attribute(&mut out, "stroke-width", &number(self.width));
            attribute(&mut out, "stroke-linejoin", "round");
            attribute(&mut out, "stroke-linecap", "round");
        }
        if let Some((drawn, skipped)) = self.dash {
            let pattern = format!("{} {}", number(drawn), number(skipped));
            attribute(&mut out, "stroke-dasharray", &pattern);
        }
        if self.opacity < 1.0 {
            attribute(&mut out, "opacity", &number(self.opacity));
        }
        if self.fill_opacity < 1.0 {
            attribute(&mut out, "fill-opacity", &number(self.fill_opacity));
        }
        attribute(&mut out, "class", &classes.join(" "));
        out
    }
}

fn attribute(out: &mut String, name: &str, value: &str) {
    write!(out, " {name}=\"{}\"", escape(value)).expect("a string takes what is written");
}

/// Which point of a text its position names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// The left end of its baseline.
    Start,
    /// The middle of its baseline.
    Middle,
    /// The right end of its baseline.
    End,
}

/// How text is set; the position is on its baseline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextStyle {
    /// Size of the face, in pixels.
    pub size: f64,
    /// How heavy the text is.
    pub weight: Weight,
    /// Colour of the letters.
    pub ink: Ink,
    /// Point that is placed.
    pub anchor: Anchor,
    /// A halo in this colour keeps the text legible on lines.
    pub halo: Option<Ink>,
}

impl TextStyle {
    /// Sets regular text that starts at its position.
    pub fn new(size: f64, ink: Ink) -> Self {
        Self { size, weight: Weight::Regular, ink, anchor: Anchor::Start, halo: None }
    }

    /// Sets the text in the semi-bold face.
    pub fn bold(self) -> Self {
        Self { weight: Weight::Bold, ..self }
    }

    /// Changes the point that is placed.
    pub fn anchored(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }

    /// Adds a halo, so that the text can be read on any ground.
    pub fn haloed(self, ink: Ink) -> Self {
        Self { halo: Some(ink), ..self }
    }
}

/// A finished picture, with its size.
#[derive(Clone, Debug, PartialEq)]
pub struct Svg {
    /// The SVG file as text; it names its font and does not embed it.
    pub text: String,
    /// Width, in units of the picture: pixels at scale 1.
    pub width: f64,
    /// Height, in units of the picture: pixels at scale 1.
    pub height: f64,
}

/// A picture to draw on.
#[derive(Clone, Debug)]
pub struct Canvas {
    width: f64,
    height: f64,
    body: String,
    n_clips: usize,
    description: String,
    /// Keeps clip ids of several pictures on one page apart.
    id: String,
}

impl Canvas {
    /// Starts a picture on white paper, its sides rounded up to whole pixels. `id` must be unique on the page that
    /// will hold the picture.
    pub fn new(id: &str, width: f64, height: f64) -> Self {
        let (width, height) = (width.ceil(), height.ceil());
        let id = id.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '-').collect();
        let (body, description) = (String::new(), String::new());
        let mut canvas = Self { width, height, body, n_clips: 0, description, id };
        canvas.rectangle(Area::new(0.0, 0.0, width, height), 0.0, Paint::fill(Ink::Paper));
        canvas
    }

    /// Describes the picture in words, for readers who cannot see it.
    pub fn describe(&mut self, description: &str) {
        self.description = format!("<desc>{}</desc>\n", escape(description));
    }

    /// Draws a rectangle with corners rounded by `radius` pixels.
    pub fn rectangle(&mut self, area: Area, radius: f64, paint: Paint) {
        let mut place = placed(area);
        if radius > 0.0 {
            attribute(&mut place, "rx", &number(radius));
        }
        self.element("rect", &place, paint);
    }

    /// Draws a line through points; fewer than two are nothing.
    pub fn line(&mut self, points: &[[f64; 2]], paint: Paint) {
        if points.len() >= 2 {
            self.element("polyline", &joined(points), paint);
        }
    }

    /// Draws a closed polygon; fewer than three corners are nothing.
    pub fn polygon(&mut self, points: &[[f64; 2]], paint: Paint) {
        if points.len() >= 3 {
            self.element("polygon", &joined(points), paint);
        }
    }

    /// Draws a circle; centre and radius are in pixels.
    pub fn circle(&mut self, center: [f64; 2], radius: f64, paint: Paint) {
        let [x, y] = center.map(number);
        self.element("circle", &format!("cx=\"{x}\" cy=\"{y}\" r=\"{}\"", number(radius)), paint);
    }

    /// Sets a line of text.
    pub fn text(&mut self, at: [f64; 2], text: &str, style: TextStyle) {
        self.set_text(at, text, style, "");
    }

    /// Sets a line of text that runs upward, for the label of a vertical axis.
    pub fn text_upward(&mut self, at: [f64; 2], text: &str, style: TextStyle) {
        let turn = format!(" transform=\"rotate(-90 {} {})\"", number(at[0]), number(at[1]));
        self.set_text(at, text, style, &turn);
    }

    fn set_text(&mut self, at: [f64; 2], text: &str, style: TextStyle, extra: &str) {
        // As it is shown: SVG takes any white space for one space.
        let text = &text.split_whitespace().collect::<Vec<_>>().join(" ");
        if text.is_empty() {
            return;
        }
        let mut attributes = String::new();
        let width = text_width(text, style.size, style.weight);
        attribute(&mut attributes, "textLength", &number(width));
        attribute(&mut attributes, "lengthAdjust", "spacingAndGlyphs");
        attribute(&mut attributes, "font-size", &number(style.size));
        if style.weight == Weight::Bold {
            attribute(&mut attributes, "font-weight", "600");
        }
        match style.anchor {
            Anchor::Start => {}
            Anchor::Middle => attribute(&mut attributes, "text-anchor", "middle"),
            Anchor::End => attribute(&mut attributes, "text-anchor", "end"),
        }
        attributes.push_str(extra);
        if let Some(halo) = style.halo {
            // Set twice, the outline beneath: not every renderer knows `paint-order`.
            let outline = Paint::fill(halo).outlined(halo, 0.3 * style.size).attributes();
            self.push_text(at, text, &format!("{attributes} aria-hidden=\"true\"{outline}"));
        }
        self.push_text(at, text, &format!("{attributes}{}", Paint::fill(style.ink).attributes()));
    }

    fn push_text(&mut self, at: [f64; 2], text: &str, attributes: &str) {
        let [x, y] = at.map(number);
        let line = format!("<text x=\"{x}\" y=\"{y}\"{attributes}>{}</text>\n", escape(text));
        self.body.push_str(&line);
    }

    /// Draws with everything outside `area` cut off.
    pub fn clipped(&mut self, area: Area, draw: impl FnOnce(&mut Self)) {
        self.n_clips += 1;
        let name = format!("{}-clip{}", self.id, self.n_clips);
        let clip = format!("<clipPath id=\"{name}\"><rect {}/></clipPath>\n", placed(area));
        self.body.extend([&clip, "<g clip-path=\"url(#", &name, ")\">\n"]);
        draw(self);
        self.body.push_str("</g>\n");
    }

    fn element(&mut self, name: &str, place: &str, paint: Paint) {
        let line = format!("<{name} {place}{}/>\n", paint.attributes());
        self.body.push_str(&line);
    }

    /// Closes the picture; the title is what a screen reader reads out.
    pub fn finish(self, title: &str) -> Svg {
        let [width, height] = [self.width, self.height].map(number);
        let (family, title) = (escape(FAMILY), escape(title));
        let text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
             height=\"{height}\" role=\"img\" font-family=\"{family}\">\n<title>{title}</title>\n{}{}</svg>\n",
            self.description, self.body
        );
        Svg { text, width: self.width, height: self.height }
    }
}

/// Writes a rectangle's attributes.
fn placed(area: Area) -> String {
    let Area { x, y, width, height } = area;
    let [x, y, width, height] = [x, y, width.max(0.0), height.max(0.0)].map(number);
    format!("x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\"")
}

/// How far a point may lie off the line between its neighbours to be left out, in pixels.
const STRAIGHT: f64 = 0.01;

/// Leaves out points on the straight way from the point before to the point after.
fn without_straight(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut kept: Vec<[f64; 2]> = Vec::new();
    for (i, &[x, y]) in points.iter().enumerate() {
        let is_on_the_way =
            kept.last().zip(points.get(i + 1)).is_some_and(|([x0, y0], [x1, y1])| {
                let ([ax, ay], [bx, by]) = ([x - x0, y - y0], [x1 - x, y1 - y]);
                let whole = (x1 - x0).hypot(y1 - y0);
                ax * bx + ay * by > 0.0 && (ax * by - ay * bx).abs() < STRAIGHT * whole
            });
        if !is_on_the_way {
            kept.push([x, y]);
        }
    }
    kept
}

fn joined(points: &[[f64; 2]]) -> String {
    let pairs =
        without_straight(points).into_iter().map(|p| format!("{},{}", number(p[0]), number(p[1])));
    format!("points=\"{}\"", pairs.collect::<Vec<_>>().join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_finite() {
        let texts = [1.0, -0.001, 2.346, 10.0, f64::NAN].map(number);
        assert_eq!(texts, ["1", "0", "2.35", "10", "0"]);
    }

    #[test]
    fn a_picture_of_everything_is_an_svg_file() {
        let mut canvas = Canvas::new("a<b", 100.0, 50.0);
        canvas.clipped(Area::new(0.0, 0.0, 10.0, 10.0), |c| {
            c.line(
                &[[0.0, 0.0], [5.0, f64::INFINITY]],
                Paint::stroke(Ink::Blue, 2.0).dashed(3.0, 2.0),
            );
            c.polygon(&[[0.0, 0.0], [5.0, 0.0], [0.0, 5.0]], Paint::fill(Ink::Green).opacity(0.5));
        });
        canvas.circle([3.0, 3.0], 2.0, Paint::fill(Ink::Orange).outlined(Ink::Paper, 1.0));
        canvas.text([1.0, 9.0], "<&\"'>", TextStyle::new(9.0, Ink::Text).haloed(Ink::Paper));
        canvas.text_upward([1.0, 9.0], "up", TextStyle::new(9.0, Ink::Text).anchored(Anchor::End));
        let svg = canvas.finish("title & more").text;
        let tree = resvg::usvg::Tree::from_str(&svg, &resvg::usvg::Options::default()).unwrap();
        assert_eq!((tree.size().width(), tree.size().height()), (100.0, 50.0));
    }

    #[test]
    fn points_on_a_straight_way_are_left_out_and_turns_and_returns_kept() {
        let line = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 3.0], [2.0, 1.0], [2.0, 1.0]];
        let kept = [[0.0, 0.0], [2.0, 0.0], [2.0, 3.0], [2.0, 1.0], [2.0, 1.0]];
        assert_eq!(without_straight(&line), kept);
        let circle =
            |i: i32| [f64::from(i) / 20.0, 1.0].map(|s| 100.0 * (s * f64::from(i % 7)).sin());
        let points: Vec<[f64; 2]> = (0..40).map(circle).collect();
        assert!(without_straight(&points).len() > 20);
        assert!(without_straight(&[]).is_empty());
    }

    #[test]
    fn rectangles_know_their_neighbours() {
        let area = Area::new(0.0, 0.0, 10.0, 10.0);
        assert!(area.overlaps(&Area::new(9.0, 9.0, 5.0, 5.0)));
        assert!(!area.overlaps(&Area::new(10.0, 0.0, 5.0, 5.0)));
        assert!(area.encloses(&Area::new(1.0, 1.0, 9.0, 9.0)));
        assert!(!area.encloses(&Area::new(1.0, 1.0, 9.5, 9.0)));
    }
}
