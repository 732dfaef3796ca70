//! The episode as an animated GIF: the world, with a line that describes what is happening.

use leadtime_sims::Scene;

use super::marker;
use super::world_view::WorldView;
use crate::draw::{Area, Canvas, Ink, Paint, Rasterizer, Svg, TextStyle, gif};
use crate::error::Error;
use crate::playthrough::{Activity, Spoken, topic_name};

const WIDTH: f64 = 600.0;
const MARGIN: f64 = 10.0;
const CAPTION_HEIGHT: f64 = 40.0;

/// The last frame stays this long, in hundredths of a second.
const LAST_DELAY: u16 = 250;

impl Spoken {
    /// Draws the episode as an animated GIF of at most `max_frames` frames; the whole lasts `seconds`, and the last
    /// frame a little longer.
    ///
    /// # Errors
    ///
    /// [`Error::PictureSize`] if a frame is higher than a GIF can be; as [`Rasterizer::png`].
    pub fn gif(
        &self,
        rasterizer: &Rasterizer,
        max_frames: usize,
        seconds: f64,
    ) -> Result<Vec<u8>, Error> {
        let moments = self.moments(max_frames);
        let draw = |&i: &usize| rasterizer.pixmap(&self.frame(i).text, 1.0);
        let frames = moments.iter().map(draw).collect::<Result<Vec<_>, _>>()?;
        let delay = (100.0 * seconds / moments.len().max(1) as f64).round().clamp(2.0, 200.0);
        gif(&frames, delay as u16, LAST_DELAY)
    }

    /// Picks evenly spread scenes, the last one among them.
    fn moments(&self, max_frames: usize) -> Vec<usize> {
        let last = self.played.scenes.len().saturating_sub(1);
        let every = last.div_ceil(max_frames.max(2) - 1).max(1);
        let mut moments: Vec<usize> = (0..last).step_by(every).collect();
        moments.push(last);
        moments
    }

    /// Draws the moment of scene `i`.
    fn frame(&self, i: usize) -> Svg {
        let (scenes, timeline) = (&self.played.scenes, &self.timeline);
        // A world that is seen in parts is seen where the person is.
        let seen = scenes.get(i).map_or(&scenes[..], std::slice::from_ref);
        let world = WorldView::new([MARGIN, CAPTION_HEIGHT], WIDTH - 2.0 * MARGIN, seen);
        let mut canvas = Canvas::new("frame", WIDTH, world.area.bottom() + MARGIN);
        if let Some(scene) = scenes.get(i) {
            let past = &scenes[..=i];
            world.draw_place(&mut canvas, scene);
            world.draw_path(&mut canvas, past, timeline);
            world.draw_starts(&mut canvas, past, timeline);
            world.draw_body(&mut canvas, scene, 1.0);
            self.draw_caption(&mut canvas, i, scene);
        }
        canvas.finish(&self.played.title())
    }

    fn draw_caption(&self, canvas: &mut Canvas, i: usize, scene: &Scene) {
        let timeline = &self.timeline;
        let activity = i.checked_sub(1).map_or(Activity::OwnPlan, |step| timeline.activities[step]);
        let swatch = Area::new(MARGIN, 12.0, 14.0, 14.0);
        canvas.rectangle(swatch, 3.0, Paint::fill(marker::ink(activity)));
        let ended = i == self.played.scenes.len() - 1;
        let sentence = timeline.spoken(i).and_then(|said| {
            let (sentence, utterance) = (self.sentences.get(said)?, &timeline.utterances[said]);
            Some(sentence.so_far(i - utterance.start, utterance.conveyance))
        });
        let text =
            if ended { self.played.title() } else { caption(scene, activity, sentence.as_deref()) };
        let style = TextStyle::new(14.0, Ink::Text);
        canvas.text([MARGIN + 22.0, 24.0], &text, if ended { style.bold() } else { style });
    }
}

/// Describes in one line what the person hears and does; `sentence` is what they have heard of it, if it is known.
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
    let Some(speech) = listener.speech else { return does };
    let (topic, n) = (topic_name(scene, speech.topic), speech.heard);
    format!("{does}   \u{b7}   \u{201c}{topic}\u{201d}, word {n} of {}", speech.conveyance)
}

#[cfg(test)]
mod tests {
    use crate::draw::Rasterizer;
    use crate::playthrough::{Spoken, synthetic};

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
