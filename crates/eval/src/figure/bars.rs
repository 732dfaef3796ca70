//! Bars: how often each value occurs, and what time went into.

use std::collections::BTreeMap;

use crate::draw::{
    Anchor, Area, Canvas, Ink, Paint, Panel, Svg, TextStyle, Weight, compact, text_width, wrapped,
};

const WIDTH: f64 = 760.0;

/// The most bars that a histogram shows; what lies beyond shares the last one.
const MAX_BARS: usize = 24;

/// Draws how often each whole number occurs, as shares of all. `id` must be unique on the page.
pub fn histogram(id: &str, title: &str, x_label: &str, counts: &BTreeMap<u64, u64>) -> Svg {
    let (left, right, top, height) = (68.0, 18.0, 34.0, 150.0);
    let mut canvas = Canvas::new(id, WIDTH, top + height + 46.0);
    canvas.text([left, 20.0], title, TextStyle::new(14.0, Ink::Text).bold());
    let bars = binned(counts);
    let total = counts.values().sum::<u64>().max(1);
    let share = |count: u64| count as f64 / total as f64;
    let highest = bars.iter().map(|bar| share(bar.1)).fold(0.0, f64::max).max(1e-9);
    let area = Area::new(left, top, WIDTH - left - right, height);
    let frame = Panel::new(area, [0.0, bars.len().max(1) as f64], [0.0, highest * 1.15]);
    frame.draw_y(&mut canvas, 5, "share");
    let base = area.bottom();
    canvas.line(&[[area.x, base], [area.right(), base]], Paint::stroke(Ink::Axis, 1.0));
    for (i, (label, count)) in bars.iter().enumerate() {
        let (from, to) = (frame.x.at(i as f64), frame.x.at(i as f64 + 1.0));
        let slot = (to - from).min(90.0);
        let middle = f64::midpoint(from, to);
        let y = frame.y.at(share(*count));
        let bar = Area::new(middle - 0.38 * slot, y, 0.76 * slot, base - y);
        canvas.rectangle(bar, 0.0, Paint::fill(Ink::Blue));
        let style = TextStyle::new(11.0, Ink::Muted).anchored(Anchor::Middle);
        canvas.text([middle, base + 17.0], label, style);
        if bars.len() <= 12 && *count > 0 {
            let value = format!("{:.1} %", 100.0 * share(*count));
            canvas.text([middle, y - 5.0], &value, TextStyle { ink: Ink::Text, ..style });
        }
    }
    let style = TextStyle::new(12.0, Ink::Muted).anchored(Anchor::Middle);
    canvas.text([area.x + area.width / 2.0, base + 36.0], x_label, style);
    canvas.finish(title)
}

/// Makes one bar per number from 0 (so that gaps show), the last one open-ended if there are too many.
fn binned(counts: &BTreeMap<u64, u64>) -> Vec<(String, u64)> {
    let Some((&highest, _)) = counts.last_key_value() else { return Vec::new() };
    let last = highest.min(MAX_BARS as u64 - 1);
    let bar = |value: u64| (value.to_string(), counts.get(&value).copied().unwrap_or_default());
    let mut bars: Vec<(String, u64)> = (0..=last).map(bar).collect();
    if highest > last {
        bars[last as usize] = (format!("{last}+"), counts.range(last..).map(|bin| bin.1).sum());
    }
    bars
}

/// What one process spent its time on.
#[derive(Clone, Debug, PartialEq)]
pub struct ShareRow {
    /// The process, as the row is labelled.
    pub label: String,
    /// Names of what it did, and for how many seconds.
    pub parts: Vec<(String, f64)>,
}

/// Draws one stacked bar per process, each of full width. `id` must be unique on the page.
pub fn shares(id: &str, title: &str, rows: &[ShareRow]) -> Svg {
    let names = part_names(rows);
    let labels = rows.iter().map(|row| text_width(&row.label, 12.0, Weight::Regular));
    let (left, right, row_height) = (labels.fold(40.0, f64::max).min(220.0) + 28.0, 70.0, 30.0);
    let entry_width = |name: &str| text_width(name, 11.5, Weight::Regular) + 36.0;
    let legend = wrapped(names.iter().map(|name| entry_width(name)).enumerate(), WIDTH - 32.0);
    let top = 40.0 + 20.0 * legend.len() as f64;
    let mut canvas = Canvas::new(id, WIDTH, top + row_height * rows.len() as f64 + 14.0);
    canvas.text([16.0, 20.0], title, TextStyle::new(14.0, Ink::Text).bold());
    for (below, line) in legend.iter().enumerate() {
        let (mut x, y) = (16.0, 46.0 + 20.0 * below as f64);
        for &i in line {
            canvas.rectangle(Area::new(x, y - 9.5, 11.0, 11.0), 2.0, part_paint(i));
            canvas.text([x + 17.0, y], names[i], TextStyle::new(11.5, Ink::Text));
            x += entry_width(names[i]);
        }
    }
    for (i, row) in rows.iter().enumerate() {
        let area = Area::new(left, top + row_height * i as f64, WIDTH - left - right, 20.0);
        let style = TextStyle::new(12.0, Ink::Text).anchored(Anchor::End);
        canvas.text([left - 10.0, area.y + 14.5], &row.label, style);
        draw_row(&mut canvas, area, row, &names);
    }
    canvas.finish(title)
}

fn draw_row(canvas: &mut Canvas, area: Area, row: &ShareRow, names: &[&str]) {
    let seconds = |part: &(String, f64)| if part.1.is_finite() { part.1.max(0.0) } else { 0.0 };
    let total: f64 = row.parts.iter().map(seconds).sum();
    let mut x = area.x;
    for (i, name) in names.iter().enumerate() {
        let spent: f64 = row.parts.iter().filter(|part| part.0 == *name).map(seconds).sum();
        if spent <= 0.0 {
            continue;
        }
        let width = spent / total * area.width;
        let piece = Area { x, width, ..area };
        canvas.rectangle(piece, 0.0, part_paint(i).outlined(Ink::Paper, 1.0));
        if width > 40.0 && i < Ink::SERIES.len() {
            let text = format!("{:.0} %", 100.0 * spent / total);
            let style = TextStyle::new(11.0, Ink::series(i).label()).anchored(Anchor::Middle);
            canvas.text([x + width / 2.0, area.y + 14.0], &text, style);
        }
        x += width;
    }
    let text = format!("{} s", compact(total));
    canvas.text([area.right() + 8.0, area.y + 14.5], &text, TextStyle::new(11.5, Ink::Muted));
}

/// More parts than colours: the second round is paler, and its bars have no labels.
fn part_paint(i: usize) -> Paint {
    let faded = if i < Ink::SERIES.len() { 1.0 } else { 0.45 };
    Paint::fill(Ink::series(i)).fill_opacity(faded)
}

/// Lists the names of all parts in the order in which they first occur.
fn part_names(rows: &[ShareRow]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in rows.iter().flat_map(|row| &row.parts) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::Rasterizer;
    use crate::draw::inspect::{assert_apart, assert_legible, texts};

    #[test]
    fn every_bar_has_a_label_that_can_be_read() {
        let parts = (0..Ink::SERIES.len() + 2).map(|i| (format!("part {i}"), 1.0));
        let svg = one(parts).text;
        let n_labels = texts(&svg).iter().filter(|found| found.text == "10 %").count();
        assert_eq!(n_labels, Ink::SERIES.len());
        let histogram = histogram("h", "t", "x", &BTreeMap::from([(0, 5), (1, 95)])).text;
        for svg in [svg, histogram] {
            assert_legible(&svg);
            assert_apart(&svg);
        }
    }

    #[test]
    fn a_histogram_shows_gaps_and_gathers_the_tail() {
        let counts = BTreeMap::from([(0, 5), (2, 3)]);
        let expected = [("0", 5), ("1", 0), ("2", 3)].map(|(l, n)| (l.to_owned(), n));
        assert_eq!(binned(&counts), expected);
        let counts = BTreeMap::from([(1, 7), (30, 2), (1000, 4)]);
        let bars = binned(&counts);
        assert_eq!(bars.len(), MAX_BARS);
        assert_eq!(bars.last(), Some(&("23+".to_owned(), 6)));
        assert!(binned(&BTreeMap::new()).is_empty());
    }

    /// Draws what one process did.
    fn one(parts: impl IntoIterator<Item = (String, f64)>) -> Svg {
        let parts = parts.into_iter().collect();
        shares("s", "t", &[ShareRow { label: "actor".to_owned(), parts }])
    }

    #[test]
    fn bars_survive_empty_data_and_a_time_that_is_not_a_number() {
        let rasterizer = Rasterizer::new();
        rasterizer.png(&histogram("h", "t", "x", &BTreeMap::new()).text, 1.0).unwrap();
        rasterizer.png(&shares("s", "t", &[]).text, 1.0).unwrap();
        let svg = one([("a <&>".to_owned(), f64::NAN), ("b".to_owned(), 0.0)]).text;
        assert!(svg.contains("a &lt;&amp;&gt;") && !svg.contains("NaN"));
        rasterizer.png(&svg, 1.0).unwrap();
    }

    #[test]
    fn many_parts_have_a_legend_of_several_lines_and_a_picture_that_holds_it() {
        let height = |n: usize| one((0..n).map(|i| (format!("part number {i}"), 1.0))).height;
        assert_eq!(height(2), height(5));
        assert_eq!(height(12), height(5) + 20.0, "six of twelve in each of two lines");
    }

    #[test]
    fn a_row_names_the_share_of_each_part() {
        let svg = one([("act".to_owned(), 30.0), ("wait".to_owned(), 10.0)]).text;
        assert!(svg.contains("75 %") && svg.contains("25 %") && svg.contains("40 s"));
    }
}
