//! Means with bands, in panels above each other that share the horizontal axis.

use super::legend;
use crate::draw::{Area, Canvas, Ink, Paint, Panel, Svg, TextStyle};

const WIDTH: f64 = 760.0;
const LEFT: f64 = 68.0;
const RIGHT: f64 = 18.0;
const BOTTOM: f64 = 46.0;
const PLOT_WIDTH: f64 = WIDTH - LEFT - RIGHT;
const PANEL_HEIGHT: f64 = 190.0;
/// Room above the first panel, with a legend of one line.
const TOP: f64 = 56.0;
/// Room between two panels, likewise.
const GAP: f64 = 40.0;
/// So few points are shown one by one.
const FEW: usize = 12;

/// One line with its band.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Band {
    /// What it is, for the legend; empty if the panel's label says it.
    pub label: String,
    /// Points (x, mean, lower, upper) in order; those that are no numbers are left out.
    pub points: Vec<[f64; 4]>,
    /// Published points (x, mean) of the same thing, drawn dashed.
    pub published: Vec<[f64; 2]>,
}

/// Lines of one unit in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct BandPanel {
    /// The vertical axis' label.
    pub label: String,
    /// Fixed range of the axis, such as 0 to 1 for a rate; `None`: that of the data.
    pub range: Option<[f64; 2]>,
    /// The lines, drawn in this order.
    pub bands: Vec<Band>,
}

impl Band {
    /// Summarises a long series of (x, value) in at most `n` pieces: the mean of each, with its least and greatest value.
    pub fn summary(series: &[[f64; 2]], n: usize) -> Self {
        let piece = |piece: &[[f64; 2]]| {
            let mean = |i: usize| piece.iter().map(|p| p[i]).sum::<f64>() / piece.len() as f64;
            let [low, high] = extent(piece.iter().map(|p| p[1])).unwrap_or_default();
            [mean(0), mean(1), low, high]
        };
        let size = series.len().div_ceil(n.max(1)).max(1);
        Self { points: series.chunks(size).map(piece).collect(), ..Self::default() }
    }
}

/// Draws panels above each other, with about `n_ticks` ticks on the axis that they share. `id` must be unique on the page.
pub fn bands(id: &str, title: &str, x_label: &str, n_ticks: usize, panels: &[BandPanel]) -> Svg {
    let panels: Vec<BandPanel> = panels.iter().map(without_gaps).collect();
    let lines = || panels.iter().flat_map(|panel| &panel.bands);
    let points = lines().flat_map(|band| &band.points).map(|p| p[0]);
    let published = lines().flat_map(|band| &band.published).map(|p| p[0]);
    let x_range = extent(points.chain(published)).unwrap_or([0.0, 1.0]);
    let legend = |panel: &BandPanel| legend::lines(&labels(panel), PLOT_WIDTH);
    let legends: Vec<_> = panels.iter().map(legend).collect();
    let room = legends.iter().map(|lines| legend::extra_height(lines)).fold(0.0, f64::max);
    let (above, gap) = (TOP + room, GAP + room);
    let n = panels.len().max(1) as f64;
    let height = above + n * PANEL_HEIGHT + (n - 1.0) * gap + BOTTOM;
    let mut canvas = Canvas::new(id, WIDTH, height);
    canvas.text([LEFT, 20.0], title, TextStyle::new(14.0, Ink::Text).bold());
    for (i, panel) in panels.iter().enumerate() {
        let top = above + i as f64 * (PANEL_HEIGHT + gap);
        let area = Area::new(LEFT, top, PLOT_WIDTH, PANEL_HEIGHT);
        let frame = Panel::new(area, x_range, y_range(panel));
        frame.draw_y(&mut canvas, 4, &panel.label);
        frame.draw_x(&mut canvas, n_ticks, (i + 1 == panels.len()).then_some(x_label));
        canvas.clipped(frame.area, |canvas| draw(canvas, &frame, &panel.bands));
        legend::draw(&mut canvas, &frame, &labels(panel), &legends[i]);
    }
    canvas.finish(title)
}

fn labels(panel: &BandPanel) -> Vec<&str> {
    panel.bands.iter().map(|band| band.label.as_str()).collect()
}

fn draw(canvas: &mut Canvas, frame: &Panel, bands: &[Band]) {
    for (i, band) in bands.iter().enumerate() {
        let upper = band.points.iter().map(|p| frame.at([p[0], p[3]]));
        let lower = band.points.iter().rev().map(|p| frame.at([p[0], p[2]]));
        let outline: Vec<[f64; 2]> = upper.chain(lower).collect();
        canvas.polygon(&outline, Paint::fill(Ink::series(i)).opacity(0.16));
    }
    for (i, band) in bands.iter().enumerate() {
        let ink = Ink::series(i);
        let published: Vec<[f64; 2]> = band.published.iter().map(|p| frame.at(*p)).collect();
        canvas.line(&published, Paint::stroke(ink, 1.6).dashed(5.0, 4.0));
        for point in &published {
            canvas.circle(*point, 3.2, Paint::fill(Ink::Paper).outlined(ink, 1.4));
        }
        let mean: Vec<[f64; 2]> = band.points.iter().map(|p| frame.at([p[0], p[1]])).collect();
        canvas.line(&mean, Paint::stroke(ink, 2.2));
        for point in mean.iter().filter(|_| mean.len() <= FEW) {
            canvas.circle(*point, 3.2, Paint::fill(ink));
        }
    }
}

fn without_gaps(panel: &BandPanel) -> BandPanel {
    let mut panel = panel.clone();
    for band in &mut panel.bands {
        band.points.retain(|p| p.iter().all(|v| v.is_finite()));
        band.published.retain(|p| p.iter().all(|v| v.is_finite()));
    }
    panel
}

/// Returns the least and the greatest of some values.
fn extent(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    values.fold(None, |range: Option<[f64; 2]>, value| {
        let [low, high] = range.unwrap_or([value, value]);
        Some([low.min(value), high.max(value)])
    })
}

/// Returns the fixed range, or that of the data, with a small margin.
fn y_range(panel: &BandPanel) -> [f64; 2] {
    let points = panel.bands.iter().flat_map(|band| &band.points).flat_map(|p| [p[2], p[3]]);
    let published = panel.bands.iter().flat_map(|band| &band.published).map(|p| p[1]);
    let [low, high] = panel.range.or_else(|| extent(points.chain(published))).unwrap_or([0.0, 1.0]);
    let margin = 0.05 * (high - low);
    [low - margin, high + margin]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::Rasterizer;
    use crate::draw::inspect::{assert_apart, assert_legible};

    fn panel(points: Vec<[f64; 4]>) -> BandPanel {
        let published = vec![[0.0, 0.4], [1.0, f64::NAN]];
        let bands = vec![Band { label: "a <b>".to_owned(), points, published }];
        BandPanel { label: "success".to_owned(), range: None, bands }
    }

    #[test]
    fn bands_survive_no_data_one_point_and_points_that_are_no_numbers() {
        let odd = vec![[0.0, f64::NAN, 0.0, 1.0], [1.0, 0.5, 0.4, f64::INFINITY]];
        for points in [vec![], vec![[5.0, 0.5, 0.4, 0.6]], odd] {
            let svg = bands("b", "t & t", "steps", 5, &[panel(points)]).text;
            assert!(!svg.contains("NaN") && !svg.contains("inf") && svg.contains("a &lt;b&gt;"));
            Rasterizer::new().png(&svg, 1.0).unwrap();
        }
        Rasterizer::new().png(&bands("b", "nothing", "steps", 5, &[]).text, 1.0).unwrap();
    }

    #[test]
    fn a_chart_can_be_read() {
        let svg =
            bands("b", "t", "steps", 7, &[panel(vec![[0.0, 0.2, 0.1, 0.3], [9e5, 0.5, 0.4, 0.6]])]);
        assert_legible(&svg.text);
        assert_apart(&svg.text);
    }

    #[test]
    fn the_axis_holds_the_bands_and_what_was_published() {
        let [low, high] = y_range(&panel(vec![[0.0, 0.5, 0.45, 0.8]]));
        assert!(low < 0.4 && high > 0.8);
    }

    #[test]
    fn a_long_series_becomes_means_between_its_extremes() {
        let series: Vec<[f64; 2]> = (0..9).map(|i| [f64::from(i), f64::from(i % 2)]).collect();
        let expected = [[1.0, 1.0 / 3.0], [4.0, 2.0 / 3.0], [7.0, 1.0 / 3.0]];
        assert_eq!(Band::summary(&series, 4).points, expected.map(|[x, y]| [x, y, 0.0, 1.0]));
        assert_eq!(Band::summary(&[], 4), Band::default());
    }
}
