//! A few moments of an episode side by side: what was heard so far, what the listener sees, believes and does.

use std::ops::Range;

use super::legend::{Legend, LegendEntry};
use super::marker;
use super::tiles::{TileStyle, Tiles};
use super::world_view::{WorldView, areas};
use crate::draw::{Area, Canvas, Ink, Paint, Svg, TextStyle};
use crate::playthrough::{Activity, Spoken, topic_name};

const MARGIN: f64 = 16.0;
/// Title and a legend of one line above, two lines above every frame.
const TILES: TileStyle =
    TileStyle { width: 860.0, margin: MARGIN, gap: 20.0, top: 64.0, caption: 44.0 };
const COLUMNS: usize = 2;
/// Size of the world's own labels, so that three lines of twelve letters fit into a tile.
const LABEL_SIZE: f64 = 7.4;

impl Spoken {
    /// Draws the moments of some scenes as a strip of frames, in reading order; scenes beyond the last are left out.
    /// `id` must be unique on the page that will hold the picture.
    pub fn frames_svg(&self, id: &str, moments: Range<usize>) -> Svg {
        let (scenes, activities) = (&self.played.scenes, &self.timeline.activities);
        let moments = moments.start..moments.end.min(scenes.len());
        let shown = Activity::ALL.into_iter().filter(|activity| activities.contains(activity));
        let entries = shown.map(LegendEntry::activity).chain(areas(scenes));
        let legend = Legend::new(entries, TILES.width - 2.0 * MARGIN);
        let style = TileStyle { top: TILES.top + legend.extra_height(), ..TILES };
        let tiles = Tiles::new(style, COLUMNS, scenes);
        let mut canvas = Canvas::new(id, TILES.width, tiles.bottom(moments.len()));
        canvas.text([MARGIN, 27.0], &self.played.title(), TextStyle::new(18.0, Ink::Text).bold());
        legend.draw(&mut canvas, [MARGIN, 50.0]);
        for (place, moment) in moments.enumerate() {
            self.draw_moment(&mut canvas, tiles.corner(place), tiles.width, moment);
        }
        canvas.finish(&self.played.title())
    }

    fn draw_moment(&self, canvas: &mut Canvas, [x, y]: [f64; 2], width: f64, moment: usize) {
        let (scenes, timeline) = (&self.played.scenes, &self.timeline);
        let scene = &scenes[moment];
        let mut world = WorldView::new([x, y + TILES.caption - 4.0], width, scenes);
        world.label_size = LABEL_SIZE;
        let bold = TextStyle::new(13.5, Ink::Text).bold();
        canvas.text([x, y + 13.0], &format!("t = {moment}"), bold);
        canvas.text([x + 58.0, y + 13.0], &self.heard(moment), bold);
        let activity = moment.checked_sub(1).map(|step| timeline.activities[step]);
        if let Some(activity) = activity {
            let swatch = Area::new(x, y + 21.0, 11.0, 11.0);
            canvas.rectangle(swatch, 2.0, Paint::fill(marker::ink(activity)));
        }
        let done = match (activity, scene.listener.reacting) {
            (Some(Activity::Following), Some(topic)) => {
                format!("last step: {} as told", topic_name(scene, topic))
            }
            (Some(activity), _) => format!("last step: {}", activity.label()),
            (None, _) => "at the start".to_owned(),
        };
        canvas.text([x + 18.0, y + 31.0], &done, TextStyle::new(11.5, Ink::Muted));
        let past = &scenes[..=moment];
        world.draw_place(canvas, scene);
        world.draw_path(canvas, past, timeline);
        world.draw_body(canvas, scene, 1.0);
        world.draw_texts(canvas, scene);
    }

    /// Quotes what has been spoken of the running message, or of the one that ends at this moment.
    fn heard(&self, moment: usize) -> String {
        let timeline = &self.timeline;
        let Some(said) = timeline.spoken(moment) else { return String::new() };
        let utterance = &timeline.utterances[said];
        let heard = moment - utterance.start;
        let Some(sentence) = self.sentences.get(said) else {
            let topic = topic_name(&self.played.scenes[moment], utterance.topic);
            return format!("{topic}: word {heard} of {}", utterance.conveyance);
        };
        let more = if heard < utterance.conveyance { " \u{2026}" } else { "" };
        format!("\u{201c}{}{more}\u{201d}", sentence.so_far(heard, utterance.conveyance))
    }
}

#[cfg(test)]
mod tests {
    use crate::draw::Rasterizer;
    use crate::playthrough::{Spoken, synthetic};

    #[test]
    fn frames_beyond_the_last_scene_are_left_out() {
        let spoken = Spoken::from(synthetic::playthrough());
        let last = spoken.played.n_steps();
        let svg = spoken.frames_svg("p", last - 2..last + 5).text;
        assert!(svg.contains(&format!("t = {last}")));
        assert!(!svg.contains(&format!("t = {}", last + 1)));
        Rasterizer::new().png(&svg, 1.0).unwrap();
    }

    #[test]
    fn the_demonstration_grows_word_by_word() {
        let svg = Spoken::demonstration().unwrap().frames_svg("p", 0..8).text;
        for text in [
            "\u{201c}Go \u{2026}\u{201d}",
            "\u{201c}Go down, \u{2026}\u{201d}",
            "\u{201c}Go down, all stations \u{2026}\u{201d}",
            "\u{201c}Go down, all stations occupied\u{201d}",
            "thinks empty",
            "last step: move down as told",
            "what the listener sees",
            "believed otherwise",
        ] {
            assert!(svg.contains(text), "{text}");
        }
    }
}
