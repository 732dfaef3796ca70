//! The episode moment by moment, for an animated GIF and for a page: the world, with a line that describes what is
//! happening.

use leadtime_sims::Scene;

use super::marker;
use super::world_view::WorldView;
use crate::draw::{Area, Canvas, Ink, Paint, Rasterizer, Svg, TextStyle, gif};
use crate::error::Error;
use crate::playthrough::{Activity, Spoken, topic_name};

/// Of a frame of a GIF and of a page.
const WIDTH: f64 = 600.0;
const PAGE_WIDTH: f64 = 860.0;
const MARGIN: f64 = 10.0;
const CAPTION_HEIGHT: f64 = 40.0;
/// Size of the world's own labels in a GIF, so that three lines fit onto a tile.
const LABEL_SIZE: f64 = 8.5;

/// The last frame stays this long, in hundredths of a second.
const LAST_DELAY: u16 = 250;

/// A picture's pixels, row by row from the top; three bytes each: red, green, blue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pixels {
    /// Pixels of a row.
    pub width: usize,
    /// Rows of pixels, from the top.
    pub height: usize,
    /// Red, green and blue of each pixel. `[height, width, 3]`
    pub rgb: Vec<u8>,
}

/// A moment of an episode, for a page.
pub(crate) struct Still {
    pub(crate) step: usize,
    pub(crate) svg: String,
    pub(crate) caption: String,
}

impl Spoken {
    /// Draws the episode as an animated GIF of at most `max_frames` frames; the whole lasts `seconds`, and the last
    /// frame a little longer.
    ///
    /// # Errors
    ///
    /// [`Error::PictureSize`] if a frame would be empty, gigantic, or higher than a GIF can be.
    pub fn gif(
        &self,
        rasterizer: &Rasterizer,
        max_frames: usize,
        seconds: f64,
    ) -> Result<Vec<u8>, Error> {
        let moments = self.moments(max_frames);
        let draw = |&i: &usize| {
            let svg = self.frame(i, &self.caption(i), self.is_end(i));
            rasterizer.pixmap(&svg.text, 1.0)
        };
        let frames = moments.iter().map(draw).collect::<Result<Vec<_>, _>>()?;
        let delay = (100.0 * seconds / moments.len().max(1) as f64).round().clamp(2.0, 200.0);
        gif(&frames, delay as u16, LAST_DELAY)
    }

    /// Draws the last scene, with what the listener hears and does, for an episode that may go on.
    ///
    /// # Errors
    ///
    /// [`Error::NoScene`] if no scene has been recorded yet; [`Error::PictureSize`] if the picture would be empty or
    /// gigantic.
    pub fn now(&self, rasterizer: &Rasterizer) -> Result<Pixels, Error> {
        let last = self.played.scenes.len().checked_sub(1).ok_or(Error::NoScene)?;
        let drawn = rasterizer.pixmap(&self.frame(last, &self.caption_now(), false).text, 1.0)?;
        let (width, height) = (drawn.width() as usize, drawn.height() as usize);
        let rgb = drawn.data().chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]);
        Ok(Pixels { width, height, rgb: rgb.collect() })
    }

    /// Says in a line what the listener hears and does in the last scene.
    pub fn caption_now(&self) -> String {
        self.caption_of(self.played.scenes.len().saturating_sub(1))
    }

    /// Draws at most `max_frames` moments for a page, with the step and the caption of each; their ids differ.
    pub(crate) fn stills(&self, max_frames: usize) -> Vec<Still> {
        let draw = |step: usize| {
            let scenes = &self.played.scenes;
            let seen = scenes.get(step).map_or(&scenes[..], std::slice::from_ref);
            let world = WorldView::new([0.0, 0.0], PAGE_WIDTH, seen);
            let mut canvas = Canvas::new(&format!("frame-{step}"), PAGE_WIDTH, world.area.bottom());
            self.draw_world(&mut canvas, &world, step);
            let caption = self.caption(step);
            Still { step, svg: canvas.finish(&caption).text, caption }
        };
        self.moments(max_frames).into_iter().map(draw).collect()
    }

    /// Picks evenly spread scenes, the last one among them.
    fn moments(&self, max_frames: usize) -> Vec<usize> {
        let last = self.played.scenes.len().saturating_sub(1);
        let every = last.div_ceil(max_frames.max(2) - 1).max(1);
        let mut moments: Vec<usize> = (0..last).step_by(every).collect();
        moments.push(last);
        moments
    }

    /// Draws the moment of scene `i` with a caption.
    fn frame(&self, i: usize, caption: &str, is_bold: bool) -> Svg {
        let scenes = &self.played.scenes;
        // A world that is seen in parts is seen where the listener is.
        let seen = scenes.get(i).map_or(&scenes[..], std::slice::from_ref);
        let mut world = WorldView::new([MARGIN, CAPTION_HEIGHT], WIDTH - 2.0 * MARGIN, seen);
        world.label_size = LABEL_SIZE;
        let mut canvas = Canvas::new("frame", WIDTH, world.area.bottom() + MARGIN);
        self.draw_world(&mut canvas, &world, i);
        let swatch = Area::new(MARGIN, 12.0, 14.0, 14.0);
        canvas.rectangle(swatch, 3.0, Paint::fill(marker::ink(self.activity(i))));
        let style = TextStyle::new(14.0, Ink::Text);
        let style = if is_bold { style.bold() } else { style };
        canvas.text([MARGIN + 22.0, 24.0], caption, style);
        canvas.finish(&self.played.title())
    }

    fn draw_world(&self, canvas: &mut Canvas, world: &WorldView, i: usize) {
        let (scenes, timeline) = (&self.played.scenes, &self.timeline);
        let Some(scene) = scenes.get(i) else { return };
        let past = &scenes[..=i];
        world.draw_place(canvas, scene);
        world.draw_path(canvas, past, timeline);
        world.draw_starts(canvas, past, timeline);
        world.draw_body(canvas, scene, 1.0);
    }

    fn is_end(&self, i: usize) -> bool {
        i + 1 >= self.played.scenes.len()
    }

    /// Returns what the listener did in the step that led to scene `i`.
    fn activity(&self, i: usize) -> Activity {
        i.checked_sub(1).map_or(Activity::OwnPlan, |step| self.timeline.activities[step])
    }

    /// Describes scene `i` in one line: what is heard and done, or how it ended.
    fn caption(&self, i: usize) -> String {
        if self.is_end(i) { self.played.title() } else { self.caption_of(i) }
    }

    /// Describes scene `i` in one line: what is heard and done.
    fn caption_of(&self, i: usize) -> String {
        let timeline = &self.timeline;
        let sentence = timeline.spoken(i).and_then(|said| {
            let (sentence, utterance) = (self.sentences.get(said)?, &timeline.utterances[said]);
            Some(sentence.so_far(i - utterance.start, utterance.conveyance))
        });
        let scene = self.played.scenes.get(i);
        scene.map_or_else(String::new, |it| caption(it, self.activity(i), sentence.as_deref()))
    }
}

/// Describes in one line what the listener hears and does; `sentence` is what they have heard of it, if it is known.
fn caption(scene: &Scene, activity: Activity, sentence: Option<&str>) -> String {
    let listener = &scene.listener;
    let followed = listener.reacting.or(listener.pending);
    let followed = followed.filter(|_| activity == Activity::Following);
    let does = followed.map_or_else(
        || activity.label().to_owned(),
        |topic| format!("follows \u{201c}{}\u{201d}", topic_name(scene, topic)),
    );
    if let Some(words) = sentence {
        return format!("{does}   \u{b7}   \u{201c}{words}\u{201d}");
    }
    let Some(word) = listener.word else { return does };
    let (topic, n) = (topic_name(scene, word.topic), word.heard);
    format!("{does}   \u{b7}   \u{201c}{topic}\u{201d}, word {n} of {}", word.conveyance)
}

#[cfg(test)]
mod tests {
    use crate::draw::Rasterizer;
    use crate::playthrough::{Playthrough, Spoken, synthetic};

    #[test]
    fn without_a_sentence_every_word_is_counted_the_last_one_too() {
        let scenes = synthetic::scenes(20, &[(2, 1, 2, 3)]);
        let spoken = Spoken::from(Playthrough { scenes, ..synthetic::playthrough() });
        let heard = (2..7).map(|i| spoken.caption(i).split(", word ").nth(1).map(str::to_owned));
        let words = [None, Some("1 of 3"), Some("2 of 3"), Some("3 of 3"), None];
        assert_eq!(heard.collect::<Vec<_>>(), words.map(|word| word.map(str::to_owned)));
    }

    #[test]
    fn an_animation_has_few_frames_and_ends_with_the_last_scene() {
        let spoken = Spoken::from(synthetic::playthrough());
        let moments = spoken.moments(12);
        assert!(moments.len() <= 12 && moments.last() == Some(&109), "{moments:?}");
        let file = spoken.gif(&Rasterizer::new(), 5, 1.0).unwrap();
        let reader = gif::DecodeOptions::new().read_info(file.as_slice()).unwrap();
        assert_eq!(reader.into_iter().map(Result::unwrap).count(), spoken.moments(5).len());
    }
}
