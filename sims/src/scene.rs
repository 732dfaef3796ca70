//! The present moment as a picture's ingredients: shapes in the world's own units, and what the listener hears and
//! does.
//!
//! Worlds describe, the crate `leadtime-eval` draws: no colour, size or file format is decided here.

use serde::Serialize;

/// What a shape means; the painter chooses the colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Tone {
    /// Ground, road and walls.
    Ground,
    /// Where the task ends well.
    Goal,
    /// Where one must not be.
    Danger,
    /// What the listener believes to be otherwise.
    Mistaken,
    /// The listener's vehicle or body.
    Own,
    /// Other vehicles and things.
    Other,
    /// Faint help lines: lane markings, field of view.
    Hint,
}

/// One thing to draw.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A filled axis-parallel rectangle.
    Rectangle {
        /// Lower left corner, in the world's units.
        min: [f64; 2],
        /// Upper right corner, in the world's units.
        max: [f64; 2],
        /// What the rectangle means.
        tone: Tone,
    },
    /// A line through points.
    Line {
        /// From one end to the other.
        points: Vec<[f64; 2]>,
        /// What the line means.
        tone: Tone,
    },
    /// A filled polygon, such as the soil or a car.
    Polygon {
        /// Its corners in order, either way round.
        points: Vec<[f64; 2]>,
        /// What the polygon means.
        tone: Tone,
    },
    /// A short text in the picture.
    Label {
        /// Where it is centred.
        at: [f64; 2],
        /// The words that are drawn.
        text: String,
    },
}

/// The part of the world to show.
///
/// A picture stretches it over its own area, x and y independently. Squares stay squares where the view is 1.5 to 4 times as
/// wide as high; a view of another shape is stretched to the nearer of the two.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct View {
    /// Lower left corner, in the world's units.
    pub min: [f64; 2],
    /// Upper right corner, in the world's units.
    pub max: [f64; 2],
}

/// The word that the listener has heard in a step, and of what it is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Word {
    /// Index of the topic in [`Listener::topics`].
    pub topic: usize,
    /// Comprehension time k, in words.
    pub comprehension: u32,
    /// Conveyance time l, in words.
    pub conveyance: u32,
    /// Words after which this listener has understood it: k, unless they understand sooner; 0 if before the first.
    pub needed: u32,
    /// Words heard so far, this one among them.
    pub heard: u32,
    /// The message was started in that step.
    pub started: bool,
}

/// What the listener hears and does.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Listener {
    /// Names of the topics, by id.
    pub topics: Vec<&'static str>,
    /// The word that was heard in the last step, be it the last one of its message; `None` in silence.
    pub word: Option<Word>,
    /// Topic of the comprehended message that waits for the reaction delay.
    pub pending: Option<usize>,
    /// Topic of the reaction carried out in the last step.
    pub reacting: Option<usize>,
}

/// One number of where or how the listener is, such as height or speed; plotted over the steps of an episode.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gauge {
    /// What it is, with its unit if it has one; the same in every moment of a task.
    pub label: &'static str,
    /// Its value in that unit.
    pub value: f64,
}

/// A moment to draw.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// What to show of the world.
    pub view: View,
    /// Everything that is there, back to front.
    pub shapes: Vec<Shape>,
    /// Where the listener is.
    pub position: [f64; 2],
    /// What to plot over time.
    pub gauge: Gauge,
    /// Where others are that move by themselves; each keeps its place in the list for the whole episode.
    pub others: Vec<[f64; 2]>,
    /// What the listener hears and does; filled in by the notifier environment.
    pub listener: Listener,
    /// Names of the facts that hold; filled in by the notifier environment.
    pub facts: Vec<&'static str>,
    /// How the episode stands, in a word or two: `landed`, `entered a danger zone`; empty while it goes on.
    pub outcome: String,
}
