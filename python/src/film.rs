//! What is kept of an episode in order to draw it.

use leadtime_eval::draw::Rasterizer;
use leadtime_eval::picture::Pixels;
use leadtime_eval::playthrough::{Playthrough, Spoken, Voice};
use leadtime_sims::{Environment, StepOutcome};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::task::wrong;

/// The scenes of an episode so far, and what turns them into pixels.
pub(crate) struct Film {
    rasterizer: Rasterizer,
    /// The sentences that come with the program, where there are some for this task.
    voice: Option<Voice>,
    played: Playthrough,
}

impl Film {
    /// Prepares to draw a task.
    ///
    /// # Errors
    ///
    /// `ValueError` if the task draws no pictures.
    pub(crate) fn new(domain: &str, environment: &dyn Environment) -> PyResult<Self> {
        let scene = environment.scene().ok_or_else(|| {
            PyValueError::new_err(format!("`{domain}` cannot be drawn: leave out render_mode"))
        })?;
        let voice = Voice::shipped(domain, &scene.listener.topics);
        Ok(Self { rasterizer: Rasterizer::new(), voice, played: Playthrough::default() })
    }

    /// Begins an episode anew; one that goes on from a snapshot has no past.
    pub(crate) fn begin(&mut self, seed: u64, index: u64, environment: &dyn Environment) {
        let scenes = environment.scene().into_iter().collect();
        (self.played.seed, self.played.index) = (seed, index);
        (self.played.scenes, self.played.total_reward) = (scenes, 0.0);
    }

    /// Takes in a step.
    pub(crate) fn step(&mut self, outcome: StepOutcome, environment: &dyn Environment) {
        self.played.total_reward += f64::from(outcome.reward);
        self.played.scenes.extend(environment.scene());
    }

    /// Draws the present moment.
    pub(crate) fn picture(&self) -> PyResult<Pixels> {
        self.spoken()?.now(&self.rasterizer).map_err(wrong)
    }

    /// Says what the listener hears and does now.
    pub(crate) fn caption(&self) -> PyResult<String> {
        Ok(self.spoken()?.caption_now())
    }

    fn spoken(&self) -> PyResult<Spoken> {
        let played = self.played.clone();
        match &self.voice {
            Some(voice) => voice.speak(played).map_err(wrong),
            None => Ok(Spoken::from(played)),
        }
    }
}
