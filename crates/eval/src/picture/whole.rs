//! The whole picture: title, world, legend, strip.

use super::legend::{Legend, LegendEntry, Mark};
use super::strip;
use super::world_view::{WorldView, areas};
use crate::draw::{Canvas, Ink, Paint, Rasterizer, Svg, TextStyle, compact};
use crate::error::Error;
use crate::playthrough::{Activity, Spoken};

const WIDTH: f64 = 860.0;
const MARGIN: f64 = 16.0;
const TITLE_HEIGHT: f64 = 58.0;
/// Of a legend of one line.
const LEGEND_HEIGHT: f64 = 40.0;

impl Spoken {
    /// Draws the episode. `id` must be unique on the page that will hold the picture.
    pub fn svg(&self, id: &str) -> Svg {
        self.svg_over(id, self.played.n_steps())
    }

    /// Draws the episode over an axis of at least `n_steps` steps, so that episodes of different lengths compare.
    pub fn svg_over(&self, id: &str, n_steps: usize) -> Svg {
        let (scenes, timeline) = (&self.played.scenes, &self.timeline);
        let width = WIDTH - 2.0 * MARGIN;
        let world = WorldView::new([MARGIN, TITLE_HEIGHT], width, scenes);
        let legend = Legend::new(self.entries(), width - 8.0);
        let legend_y = world.area.bottom() + 22.0;
        let strip_y = world.area.bottom() + LEGEND_HEIGHT + legend.extra_height();
        let mut canvas = Canvas::new(id, WIDTH, strip_y + strip::HEIGHT);
        self.draw_title(&mut canvas);
        if let Some(last) = scenes.last() {
            world.draw_place(&mut canvas, last);
            world.draw_others(&mut canvas, scenes);
            world.draw_ghosts(&mut canvas, scenes);
            world.draw_path(&mut canvas, scenes, timeline);
            world.draw_body(&mut canvas, last, 1.0);
            world.draw_starts(&mut canvas, scenes, timeline);
            world.draw_labels(&mut canvas, self);
            legend.draw(&mut canvas, [MARGIN + 4.0, legend_y]);
            let n_steps = n_steps.max(self.played.n_steps());
            strip::draw(&mut canvas, [MARGIN, strip_y], width, self, n_steps);
        }
        canvas.finish(&self.played.title())
    }

    /// Draws the episode as a PNG file, `scale` pixels per unit of the 860 units wide picture.
    ///
    /// # Errors
    ///
    /// As [`Rasterizer::png`].
    pub fn png(&self, rasterizer: &Rasterizer, scale: f32) -> Result<Vec<u8>, Error> {
        rasterizer.png(&self.svg("playthrough").text, scale)
    }

    fn draw_title(&self, canvas: &mut Canvas) {
        canvas.text([MARGIN, 27.0], &self.played.title(), TextStyle::new(18.0, Ink::Text).bold());
        let (played, said) = (&self.played, self.timeline.utterances.len());
        let line = format!(
            "return {}   \u{b7}   {} steps   \u{b7}   {said} notifications   \u{b7}   episode {} of seed {}",
            compact((played.total_reward * 10.0).round() / 10.0),
            played.n_steps(),
            played.index,
            played.seed,
        );
        canvas.text([MARGIN, 47.0], &line, TextStyle::new(12.0, Ink::Muted));
    }

    /// Lists what the marks of the episode mean.
    fn entries(&self) -> Vec<LegendEntry> {
        let speaks = self.played.scenes.iter().any(|scene| !scene.listener.topics.is_empty());
        let activity =
            Activity::ALL.into_iter().filter(|activity| speaks || *activity == Activity::OwnPlan);
        let mut entries: Vec<LegendEntry> = activity.map(LegendEntry::activity).collect();
        if speaks {
            entries.push(LegendEntry { mark: Mark::Start, label: "notification starts" });
        }
        if self.played.scenes.last().is_some_and(|scene| !scene.others.is_empty()) {
            let mark = Mark::Dotted(Paint::stroke(Ink::Muted, 1.0), Ink::Muted);
            entries.push(LegendEntry { mark, label: "others" });
        }
        entries.extend(areas(&self.played.scenes));
        entries
    }
}

#[cfg(test)]
mod tests {
    use leadtime_sims::{Shape, Tone};

    use crate::draw::Rasterizer;
    use crate::playthrough::{Playthrough, Spoken, Voice, synthetic};

    #[test]
    fn a_playthrough_becomes_a_picture_with_everything_named() {
        let svg = Spoken::from(synthetic::playthrough()).svg("p").text;
        let title = "trained &amp; tested: landed &lt;safely&gt;, success";
        for text in [title, "shift right \u{d7}3", "ascend"] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(Rasterizer::new().pixmap(&svg, 1.0).unwrap().width(), 860);
    }

    #[test]
    fn sentences_are_quoted_where_topics_stood() {
        let topics = ["ascend", "shift_left", "shift_right", "descend"];
        let voice = Voice::shipped("lander", &topics).unwrap();
        let spoken = voice.speak(synthetic::playthrough()).unwrap();
        let (said, svg) = (&spoken.sentences, spoken.svg("p").text);
        // The first three say to shift right, each in its own words.
        assert!(svg.contains(&format!("{} and 2 more", said[0])), "{}", said[0]);
        assert!(svg.contains(&said[5].to_string()), "{}", said[5]);
    }

    #[test]
    fn a_legend_that_is_too_long_has_another_line_and_the_picture_holds_it() {
        let mut playthrough = synthetic::playthrough();
        let height = |p: &Playthrough| Spoken::from(p.clone()).svg("p").height;
        let before = height(&playthrough);
        let area = |tone| Shape::Rectangle { min: [0.0; 2], max: [0.1; 2], tone };
        playthrough.scenes[0].shapes.extend([Tone::Mistaken, Tone::Hint].map(area));
        assert_eq!(height(&playthrough), before + 16.0);
    }

    #[test]
    fn an_episode_of_one_scene_can_be_drawn() {
        let mut playthrough = synthetic::playthrough();
        playthrough.scenes.truncate(1);
        Spoken::from(playthrough).png(&Rasterizer::new(), 1.0).unwrap();
    }
}
