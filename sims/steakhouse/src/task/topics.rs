//! The topics of messages to the cook, and what each asks for.

use leadtime_sims::Message;

use crate::world::{Action, Direction};

/// The topics, by id. Directions are those of the grid, whichever way the cook looks.
pub const TOPICS: &[&str] = &["move_up", "move_down", "move_left", "move_right", "inform"];
/// Go north.
pub const UP: usize = 0;
/// Go south.
pub const DOWN: usize = 1;
/// Go west.
pub const LEFT: usize = 2;
/// Go east.
pub const RIGHT: usize = 3;
/// Only tells what the stations hold.
pub const INFORM: usize = 4;

/// The message of the paper's demonstration: "Go down, all stations occupied".
pub const DEMONSTRATION: Message = Message { topic: DOWN, comprehension: 2, conveyance: 5 };

/// Returns the direction that a topic asks for, if any.
pub(super) fn direction(topic: usize) -> Option<Direction> {
    match topic {
        UP => Some(Direction::North),
        DOWN => Some(Direction::South),
        LEFT => Some(Direction::West),
        RIGHT => Some(Direction::East),
        _ => None,
    }
}

/// Returns the topic that asks for an action; other actions than going can only be brought about by informing.
pub(super) fn topic(action: Action) -> usize {
    match action {
        Action::Go(Direction::North) => UP,
        Action::Go(Direction::South) => DOWN,
        Action::Go(Direction::West) => LEFT,
        Action::Go(Direction::East) => RIGHT,
        Action::Stay | Action::Interact => INFORM,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_asks_for_what_it_is_called() {
        use Direction::{East, North, South, West};
        let directions: Vec<_> = (0..TOPICS.len()).map(direction).collect();
        assert_eq!(directions, [Some(North), Some(South), Some(West), Some(East), None]);
        for id in UP..=RIGHT {
            assert_eq!(direction(id).map(|way| topic(Action::Go(way))), Some(id));
        }
        assert_eq!(topic(Action::Interact), INFORM);
    }
}
