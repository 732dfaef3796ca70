//! A kitchen as a gridworld, and a cook who knows of its stations only what they have seen or been told.
//!
//! ```text
//!   XXPXPXXXX    P grill   B board   W sink      two of each, on the north, west and south walls
//!   B       M    M meat    O onions  D plates    on the east wall: from there no station is in view
//!   X  XXX  X
//!   B  XXX1 O    1 the cook, who sees two rows of three tiles ahead
//!   X  XXX  X
//!   W       D
//!   XXWXXXSXX    S serving window
//! ```
//!
//! A dish is a grilled steak on a washed plate with a chopped garnish: 10 + chops + washes interactions.
//!
//! What this module does not know: notifications, delays, rewards. Those are [`task`](crate::task)'s.
//!
//! # Where to start
//!
//! [`Kitchen::step`].
//!
//! # Source
//!
//! The world is that of FOV-aware-planner (Hsu et al.), after Overcooked-AI; the task that of Hsu et al.
//! (arXiv:2509.07438), which gives no layout: `ring` is ours.

mod belief;
mod grid;
mod interact;
mod kinds;
mod kitchen;
mod layouts;
mod mind;
mod paths;
mod progress;
mod sight;
mod start;
mod state;
mod subtask;

pub use belief::Belief;
pub use grid::{Grid, GridPlace, LayoutError, Pose, Slot};
pub use kinds::{Action, ActionOutcome, Content, Direction, Event, Item, Station};
pub use kinds::{StationPhase, Tile, WorkTimes};
pub use kitchen::{Floorplan, Kitchen, KitchenState};
pub use layouts::{LAYOUTS, kitchen};
pub use mind::{Mind, Ties};
pub use paths::{Paths, Route};
pub use progress::{interactions_left, is_misled, is_redundant};
pub use sight::{FieldOfView, Sight};
pub use start::{KitchenStart, StartFamily, random_pose};
pub use state::{Cook, KitchenWorld, Order, OrdersEnd, WorldState, start_pose};
pub use subtask::Subtask;
