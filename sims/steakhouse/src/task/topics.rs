//! The topics of messages to the cook, and what each asks for.

use leadtime_sims::Message;

use crate::world::{Action, Direction};

/// The topics, by id. Directions are those of the grid, whichever way the cook looks.
pub(super) const TOPICS: &[&str] = &["move_up", "move_down", "move_left", "move_right", "inform"];
/// Where the first of them ask the cook to go.
const DIRECTIONS: [Direction; 4] =
    [Direction::North, Direction::South, Direction::West, Direction::East];
/// The id of `move_down`.
pub(super) const DOWN: usize = 1;
/// The id of `inform`, which only tells what the stations hold.
pub(super) const INFORM: usize = 4;

/// The message of the paper's demonstration: "Go down, all stations occupied".
pub const DEMONSTRATION: Message = Message { topic: DOWN, comprehension: 2, conveyance: 5 };

/// Returns the direction that a topic asks for, if any.
pub(super) fn direction(topic: usize) -> Option<Direction> {
    DIRECTIONS.get(topic).copied()
}

/// Returns the topic that asks for an action; other actions than going can only be brought about by informing.
pub(super) fn topic(action: Action) -> usize {
    DIRECTIONS.iter().position(|&way| action == Action::Go(way)).unwrap_or(INFORM)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_asks_for_what_it_is_called() {
        for (name, way) in [
            ("move_up", Direction::North),
            ("move_down", Direction::South),
            ("move_left", Direction::West),
            ("move_right", Direction::East),
        ] {
            let id = topic(Action::Go(way));
            assert_eq!((TOPICS[id], direction(id)), (name, Some(way)));
        }
        assert_eq!((topic(Action::Interact), direction(INFORM)), (INFORM, None));
        assert_eq!((TOPICS[INFORM], TOPICS[DOWN]), ("inform", "move_down"));
    }
}
