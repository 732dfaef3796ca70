//! The marks that world, strip and legend share: an activity's colour and stroke, and where a message starts.

use crate::draw::{Canvas, Ink, Paint};
use crate::playthrough::Activity;

pub(super) fn ink(activity: Activity) -> Ink {
    match activity {
        Activity::OwnPlan => Ink::Neutral,
        Activity::Hearing => Ink::Orange,
        Activity::Waiting => Ink::Purple,
        Activity::Following => Ink::Blue,
    }
}

/// Returns the stroke of a trajectory during an activity.
pub(super) fn stroke(activity: Activity) -> Paint {
    Paint::stroke(ink(activity), stroke_width(activity))
}

/// Returns the width of that stroke, in pixels.
pub(super) fn stroke_width(activity: Activity) -> f64 {
    if activity == Activity::OwnPlan { 2.0 } else { 3.6 }
}

/// Draws the mark of a message's start.
pub(super) fn draw_marker(canvas: &mut Canvas, at: [f64; 2]) {
    canvas.circle(at, 4.6, Paint::fill(Ink::Paper).outlined(ink(Activity::Hearing), 2.4));
}
