//! The episode as an animated GIF: the world, with a line that says what is happening.

use leadtime_sims::Scene;

use super::record::Playthrough;
use super::story::{Doing, Story};
use super::world::{World, topic_name};
use crate::draw::{Area, Canvas, Ink, Paint, Pixels, Rasterizer, TextStyle, gif};
use crate::error::Error;

const WIDTH: f64 = 600.0;
const MARGIN: f64 = 10.0;
const CAPTION_HEIGHT: f64 = 40.0;

/// The last frame stays this long, in hundredths of a second.
const LAST_DELAY: u16 = 250;

impl Playthrough {
    /// Draws the episode as an animated GIF of at most `max_frames` frames; the whole lasts `seconds`, and the last
    /// frame a little longer.
    ///
    /// # Errors
    ///
    /// As [`gif()`].
    pub fn gif(
        &self,
        rasterizer: &Rasterizer,
        max_frames: usize,
        seconds: f64,
    ) -> Result<Vec<u8>, Error> {
        let story = Story::new(&self.scenes);
        let moments = self.moments(max_frames);
        let draw = |&i: &usize| rasterizer.pixels(&self.frame(&story, i), 1.0);
        let frames: Vec<Pixels> = moments.iter().map(draw).collect::<Result<_, _>>()?;
        let delay = (100.0 * seconds / moments.len().max(1) as f64).round().clamp(2.0, 200.0);
        let mut delays = vec![delay as u16; frames.len()];
        if let Some(last) = delays.last_mut() {
            *last = LAST_DELAY;
        }
        gif(&frames, &delays)
    }

    /// Picks evenly spread scenes, the last one among them.
    fn moments(&self, max_frames: usize) -> Vec<usize> {
        let last = self.scenes.len().saturating_sub(1);
        let every = last.div_ceil(max_frames.max(2) - 1).max(1);
        let mut moments: Vec<usize> = (0..last).step_by(every).collect();
        moments.push(last);
        moments
    }

    /// Draws the moment of scene `i`.
    fn frame(&self, story: &Story, i: usize) -> String {
        // A world that is seen in parts is seen where the person is.
        let seen = self.scenes.get(i).map_or(&self.scenes[..], std::slice::from_ref);
        let world = World::new([MARGIN, CAPTION_HEIGHT], WIDTH - 2.0 * MARGIN, seen);
        let mut canvas = Canvas::new("frame", WIDTH, world.area.bottom() + MARGIN);
        if let Some(scene) = self.scenes.get(i) {
            let past = &self.scenes[..=i];
            world.draw_place(&mut canvas, scene);
            world.draw_path(&mut canvas, past, story);
            world.draw_starts(&mut canvas, past, story);
            world.draw_body(&mut canvas, scene, 1.0);
            self.draw_caption(&mut canvas, story, i, scene);
        }
        canvas.finish(&self.title())
    }

    fn draw_caption(&self, canvas: &mut Canvas, story: &Story, i: usize, scene: &Scene) {
        let doing = i.checked_sub(1).map_or(Doing::OwnPlan, |step| story.doing[step]);
        canvas.rectangle(Area::new(MARGIN, 12.0, 14.0, 14.0), 3.0, Paint::fill(doing.ink()));
        let ended = i == self.scenes.len() - 1;
        let sentence = story.spoken(i).and_then(|said| {
            let (sentence, utterance) = (self.sentences.get(said)?, &story.utterances[said]);
            Some(sentence.so_far(i - utterance.start, utterance.conveyance))
        });
        let text = if ended { self.title() } else { caption(scene, doing, sentence.as_deref()) };
        let style = TextStyle::new(14.0, Ink::Text);
        canvas.text([MARGIN + 22.0, 24.0], &text, if ended { style.bold() } else { style });
    }
}

/// Says in a line what the person hears and does; `sentence` is what they have heard of it, if it is known.
fn caption(scene: &Scene, doing: Doing, sentence: Option<&str>) -> String {
    let listener = &scene.listener;
    let does = match (doing, listener.reacting.or(listener.pending)) {
        (Doing::Following, Some(topic)) => {
            format!("follows \u{201c}{}\u{201d}", topic_name(scene, topic))
        }
        _ => doing.label().to_owned(),
    };
    if let Some(words) = sentence {
        return format!("{does}   \u{b7}   \u{201c}{words}\u{201d}");
    }
    let Some(speech) = listener.speech else { return does };
    let topic = topic_name(scene, speech.topic);
    format!(
        "{does}   \u{b7}   \u{201c}{topic}\u{201d}, word {} of {}",
        speech.heard, speech.conveyance
    )
}

#[cfg(test)]
mod tests {
    use crate::draw::Rasterizer;
    use crate::playthrough::synthetic;

    #[test]
    fn an_animation_has_few_frames_and_ends_with_the_last_scene() {
        let playthrough = synthetic::playthrough();
        let moments = playthrough.moments(12);
        assert!(moments.len() <= 12 && moments.last() == Some(&109), "{moments:?}");
        let file = playthrough.gif(&Rasterizer::new(), 5, 1.0).unwrap();
        let mut reader = gif::DecodeOptions::new().read_info(file.as_slice()).unwrap();
        let mut n_frames = 0;
        while reader.read_next_frame().unwrap().is_some() {
            n_frames += 1;
        }
        assert_eq!(n_frames, playthrough.moments(5).len());
    }
}
