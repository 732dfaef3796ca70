//! The scripted notifier: near a zone, it directs the pilot to the next point of a path that avoids them all.

use leadtime_sims::Message;

use super::maneuver::Maneuver;

/// How exactly a point of the path is to be met, sideways.
const TOLERANCE: f64 = 0.1;
/// How far below a point the lander may be before it is asked to climb.
const SAG: f64 = 0.2;

/// Chooses what to say at a place, on the way along a path from high to low.
///
/// The next point is the first that is lower than the lander, else the last. Sideways comes first: a zone below is
/// avoided by not being above it.
pub(super) fn direct([x, y]: [f64; 2], path: &[[f64; 2]]) -> Option<Message> {
    let target = path.iter().find(|point| point[1] < y + SAG / 2.0).or(path.last())?;
    let (dx, dy) = (target[0] - x, target[1] - y);
    let asked = if dx < -TOLERANCE {
        Maneuver::ShiftLeft
    } else if dx > TOLERANCE {
        Maneuver::ShiftRight
    } else if dy > SAG {
        Maneuver::Ascend
    } else {
        Maneuver::Descend
    };
    Some(Message { topic: asked.topic(), comprehension: 2, conveyance: 3 })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATH: &[[f64; 2]] = &[[0.0, 0.9], [-0.5, 0.8], [-0.5, 0.4], [0.0, 0.0]];

    #[test]
    fn the_path_is_followed_from_high_to_low() {
        let asked = |place| direct(place, PATH).map(|message| Maneuver::of(message.topic));
        assert_eq!(asked([0.02, 1.3]), Some(Maneuver::Descend));
        assert_eq!(asked([-0.4, 1.2]), Some(Maneuver::ShiftRight));
        assert_eq!(asked([0.0, 0.75]), Some(Maneuver::ShiftLeft));
        assert_eq!(asked([-0.5, 0.65]), Some(Maneuver::Descend));
        assert_eq!(asked([-0.5, 0.2]), Some(Maneuver::ShiftRight));
        assert_eq!(direct([0.0, 1.0], &[]), None);
    }
}
