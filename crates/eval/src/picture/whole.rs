//! The whole picture: title, world, legend, strip.

use super::legend::{Legend, LegendEntry, Mark};
use super::strip;
use super::world_view::{WorldView, areas};
use crate::draw::{Canvas, Ink, Paint, Rasterizer, Svg, TextStyle};
use crate::error::Error;
use crate::playthrough::{Activity, Spoken};

const WIDTH: f64 = 860.0;
const MARGIN: f64 = 16.0;
const TITLE_HEIGHT: f64 = 58.0;
/// Of a legend of one line, and of the line that says which moment the world shows.
const LEGEND_HEIGHT: f64 = 56.0;

impl Spoken {
    /// Draws the episode. `id` must be unique on the page that will hold the picture.
    pub fn svg(&self, id: &str) -> Svg {
        self.svg_over(id, self.played.n_steps())
    }

    /// Draws the episode over an axis of at least `n_steps` steps, so that episodes of different lengths compare.
    pub fn svg_over(&self, id: &str, n_steps: usize) -> Svg {
        self.draw(id, n_steps, true)
    }

    /// Draws the episode for a page that says its title and its numbers itself.
    pub(crate) fn svg_untitled(&self, id: &str) -> Svg {
        self.draw(id, self.played.n_steps(), false)
    }

    fn draw(&self, id: &str, n_steps: usize, is_titled: bool) -> Svg {
        let (scenes, timeline) = (&self.played.scenes, &self.timeline);
        let width = WIDTH - 2.0 * MARGIN;
        let top = if is_titled { TITLE_HEIGHT } else { 4.0 };
        let world = WorldView::new([MARGIN, top], width, scenes);
        let legend = Legend::new(self.entries(), width - 8.0);
        let legend_y = world.area.bottom() + 22.0;
        let strip_y = world.area.bottom() + LEGEND_HEIGHT + legend.extra_height();
        let mut canvas = Canvas::new(id, WIDTH, strip_y + strip::HEIGHT);
        canvas.describe(&self.transcript());
        if is_titled {
            self.draw_title(&mut canvas);
        }
        if let Some(last) = scenes.last() {
            world.draw_place(&mut canvas, last);
            world.draw_others(&mut canvas, scenes);
            world.draw_ghosts(&mut canvas, scenes);
            world.draw_path(&mut canvas, scenes, timeline);
            world.draw_body(&mut canvas, last, 1.0);
            world.draw_starts(&mut canvas, scenes, timeline);
            world.draw_labels(&mut canvas, self);
            legend.draw(&mut canvas, [MARGIN + 4.0, legend_y]);
            let below = [MARGIN + 4.0, legend_y + legend.extra_height() + 17.0];
            canvas.text(below, &self.moment_shown(), TextStyle::new(11.0, Ink::Muted));
            let n_steps = n_steps.max(self.played.n_steps());
            strip::draw(&mut canvas, [MARGIN, strip_y], width, self, n_steps);
        }
        canvas.finish(&self.played.title())
    }

    /// Draws the episode as a PNG file, `scale` pixels per unit of the 860 units wide picture.
    ///
    /// # Errors
    ///
    /// [`Error::PictureSize`] if the picture would be empty or gigantic at that scale.
    pub fn png(&self, rasterizer: &Rasterizer, scale: f32) -> Result<Vec<u8>, Error> {
        rasterizer.png(&self.svg("playthrough").text, scale)
    }

    fn draw_title(&self, canvas: &mut Canvas) {
        canvas.text([MARGIN, 27.0], &self.played.title(), TextStyle::new(18.0, Ink::Text).bold());
        canvas.text([MARGIN, 47.0], &self.numbers(), TextStyle::new(12.0, Ink::Muted));
    }

    /// Says which moment of the episode the world shows: the path is of all of it, everything else of one.
    fn moment_shown(&self) -> String {
        let world = format!("The world is shown at the end, step {}", self.played.n_steps());
        match self.timeline.utterances.len() {
            0 => format!("{world}."),
            _ => format!("{world}; each message stands where it started."),
        }
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
    use leadtime_proto::TaskSpec;
    use leadtime_sims::{Shape, Tone};

    use crate::draw::Rasterizer;
    use crate::draw::inspect::{assert_apart, assert_legible, texts};
    use crate::measure::Player;
    use crate::playthrough::{Playthrough, Spoken, Voice, synthetic};

    #[test]
    fn all_texts_of_every_world_can_be_read_and_do_not_overlap() {
        let registry = leadtime_worlds::builtin();
        for domain in ["lander", "highway", "steakhouse"] {
            let task = TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() };
            let make = || registry.build(&task);
            let player = Player::baseline("heuristic");
            let played = Playthrough::record(&make, &player, 1, 0).unwrap();
            let topics = played.scenes[0].listener.topics.clone();
            let spoken = Voice::shipped(domain, &topics).unwrap().speak(played).unwrap();
            let svg = spoken.svg("p").text;
            let frames = spoken.stills(5).into_iter().map(|still| still.svg);
            let strip = spoken.frames_svg("f", 0..4).text;
            for svg in frames.chain([svg.clone(), strip]) {
                assert_legible(&svg);
                assert_apart(&svg);
            }
            let said = spoken.timeline.utterances.len();
            let end = format!("step {}; each message", spoken.played.n_steps());
            assert!(
                said > 0 && texts(&svg).iter().any(|found| found.text.contains(&end)),
                "{domain}"
            );
            // Readers who cannot see the picture get what was said.
            let described = svg.split("<desc>").nth(1).unwrap().split("</desc>").next().unwrap();
            assert!(
                described.contains("hears") && described.contains(&format!("{said} notification"))
            );
        }
    }

    #[test]
    fn one_message_is_one_notification() {
        let mut playthrough = synthetic::playthrough();
        playthrough.scenes = synthetic::scenes(20, &[(2, 1, 2, 3)]);
        let numbers = Spoken::from(playthrough.clone()).numbers();
        assert!(numbers.contains("1 notification "), "{numbers}");
        playthrough.scenes = synthetic::scenes(20, &[]);
        let silent = Spoken::from(playthrough);
        assert!(silent.numbers().contains("0 notifications "));
        assert!(silent.svg("p").text.contains("shown at the end, step 19.<"));
    }

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
