//! The whole picture: title, world, legend, strip.

use super::legend::{Entry, Legend, Sample};
use super::record::Playthrough;
use super::story::{Doing, Story};
use super::strip;
use super::world::{World, areas};
use crate::draw::{Canvas, Ink, Paint, Rasterizer, TextStyle, compact};
use crate::error::Error;

const WIDTH: f64 = 860.0;
const MARGIN: f64 = 16.0;
const TITLE_HEIGHT: f64 = 58.0;
/// Of a legend of one line.
const LEGEND_HEIGHT: f64 = 40.0;

impl Playthrough {
    /// Draws the episode. `id` must be unique on the page that will hold the picture.
    pub fn svg(&self, id: &str) -> String {
        self.svg_over(id, self.n_steps())
    }

    /// Draws the episode over an axis of at least `n_steps` steps, so that episodes of different lengths compare.
    pub fn svg_over(&self, id: &str, n_steps: usize) -> String {
        let story = Story::new(&self.scenes);
        let width = WIDTH - 2.0 * MARGIN;
        let world = World::new([MARGIN, TITLE_HEIGHT], width, &self.scenes);
        let legend = Legend::new(&self.entries(), width - 8.0);
        let legend_y = world.area.bottom() + 22.0;
        let strip_y = world.area.bottom() + LEGEND_HEIGHT + legend.extra_height();
        let mut canvas = Canvas::new(id, WIDTH, strip_y + strip::HEIGHT);
        self.draw_title(&mut canvas);
        if let Some(last) = self.scenes.last() {
            world.draw_place(&mut canvas, last);
            world.draw_others(&mut canvas, &self.scenes);
            world.draw_ghosts(&mut canvas, &self.scenes);
            world.draw_path(&mut canvas, &self.scenes, &story);
            world.draw_body(&mut canvas, last, 1.0);
            world.draw_starts(&mut canvas, &self.scenes, &story);
            world.draw_labels(&mut canvas, self, &story);
            legend.draw(&mut canvas, [MARGIN + 4.0, legend_y]);
            let n_steps = n_steps.max(self.n_steps());
            strip::draw(&mut canvas, [MARGIN, strip_y], width, self, &story, n_steps);
        }
        canvas.finish(&self.title())
    }

    /// Draws the episode as a PNG file, `scale` pixels per unit of the 860 units wide picture.
    ///
    /// # Errors
    ///
    /// As [`Rasterizer::png`].
    pub fn png(&self, rasterizer: &Rasterizer, scale: f32) -> Result<Vec<u8>, Error> {
        rasterizer.png(&self.svg("playthrough"), scale)
    }

    /// Returns the picture's title: who played, and how it ended.
    pub fn title(&self) -> String {
        let outcome = self.scenes.last().map_or("", |scene| scene.outcome.as_str());
        let verdict = match self.success {
            Some(true) => "success",
            Some(false) => "no success",
            None => "",
        };
        let parts = [outcome, verdict].into_iter().filter(|part| !part.is_empty());
        let end = parts.collect::<Vec<_>>().join(", ");
        if end.is_empty() { self.player.clone() } else { format!("{}: {end}", self.player) }
    }

    fn draw_title(&self, canvas: &mut Canvas) {
        canvas.text([MARGIN, 27.0], &self.title(), TextStyle::new(18.0, Ink::Text).bold());
        let said = Story::new(&self.scenes).utterances.len();
        let line = format!(
            "return {}   \u{b7}   {} steps   \u{b7}   {said} notifications   \u{b7}   episode {} of seed {}",
            compact((self.total_reward * 10.0).round() / 10.0),
            self.n_steps(),
            self.index,
            self.seed,
        );
        canvas.text([MARGIN, 47.0], &line, TextStyle::new(12.0, Ink::Muted));
    }

    /// Lists what the marks of the episode mean.
    fn entries(&self) -> Vec<Entry> {
        let speaks = self.scenes.iter().any(|scene| !scene.listener.topics.is_empty());
        let doing = Doing::ALL.into_iter().filter(|doing| speaks || *doing == Doing::OwnPlan);
        let mut entries: Vec<Entry> = doing.map(Entry::doing).collect();
        if speaks {
            entries.push(Entry { sample: Sample::Start, label: "notification starts" });
        }
        if self.scenes.last().is_some_and(|scene| !scene.others.is_empty()) {
            let sample = Sample::Dotted(Paint::stroke(Ink::Muted, 1.0), Ink::Muted);
            entries.push(Entry { sample, label: "others" });
        }
        entries.extend(areas(&self.scenes));
        entries
    }
}

#[cfg(test)]
mod tests {
    use leadtime_sims::{Shape, Tone};

    use crate::draw::Rasterizer;
    use crate::playthrough::{Playthrough, Voice, synthetic};

    #[test]
    fn a_playthrough_becomes_a_picture_with_everything_named() {
        let playthrough = synthetic::playthrough();
        let svg = playthrough.svg("p");
        for text in [
            "trained &amp; tested: landed &lt;safely&gt;, success",
            "shift right \u{d7}3",
            "ascend",
        ] {
            assert!(svg.contains(text), "{text}");
        }
        let pixels = Rasterizer::new().pixels(&svg, 1.0).unwrap();
        assert_eq!(pixels.width, 860);
    }

    #[test]
    fn sentences_are_quoted_where_topics_stood() {
        let mut playthrough = synthetic::playthrough();
        let topics = ["ascend", "shift_left", "shift_right", "descend"];
        let voice = Voice::shipped("lander", &topics).unwrap();
        voice.speak(&mut playthrough).unwrap();
        let said = playthrough.sentences.clone();
        let svg = playthrough.svg("p");
        // The first three say to shift right, each in its own words.
        assert!(svg.contains(&format!("{} and 2 more", said[0])), "{}", said[0]);
        assert!(svg.contains(&said[5].to_string()), "{}", said[5]);
    }

    #[test]
    fn a_legend_that_is_too_long_has_another_line_and_the_picture_holds_it() {
        let mut playthrough = synthetic::playthrough();
        let height = |p: &Playthrough| Rasterizer::new().pixels(&p.svg("p"), 1.0).unwrap().height;
        let before = height(&playthrough);
        let unit = |tone| Shape::Rectangle { min: [0.0; 2], max: [0.1; 2], tone };
        let seen = [Tone::Mistaken, Tone::Hint].map(unit);
        playthrough.scenes[0].shapes.extend(seen);
        assert_eq!(height(&playthrough), before + 16);
    }

    #[test]
    fn an_episode_of_one_scene_can_be_drawn() {
        let mut playthrough = synthetic::playthrough();
        playthrough.scenes.truncate(1);
        Rasterizer::new().png(&playthrough.svg("p"), 1.0).unwrap();
    }
}
