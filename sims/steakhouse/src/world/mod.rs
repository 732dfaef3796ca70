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
//! | file | what |
//! |---|---|
//! | `kinds`, `grid`, `layouts` | tiles and items; floor plans and what is wrong with them; the built-in ones |
//! | `state`, `interact`, `outcome` | one step of the kitchen; what using a tile does |
//! | `paths`, `sight` | shortest ways and fields of view, all computed beforehand |
//! | `belief`, `subtask`, `mind` | what the cook knows, may do, and chooses |
//! | `start`, `progress` | how episodes start; how much work is left, and what is in vain |
//! | `kitchen` | world and cook together, step by step |
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
mod layout_error;
mod layouts;
mod mind;
mod outcome;
mod paths;
mod progress;
mod sight;
mod start;
mod state;
mod subtask;

pub use belief::Belief;
pub use grid::{Grid, GridPlace, MAX_SIDE, MAX_STATIONS, Pose, Slot};
pub use kinds::{Action, Content, Direction, Item, Station, StationPhase, Tile, WorkTimes};
pub use kitchen::{Floorplan, Kitchen, KitchenState};
pub use layout_error::LayoutError;
pub use layouts::{LAYOUTS, kitchen};
pub use mind::{Mind, Ties};
pub use outcome::{ActionOutcome, DELIVERY_REWARD, Event};
pub use paths::{Paths, Route};
pub use progress::{interactions_left, is_misled, is_redundant};
pub use sight::{FieldOfView, Sight};
pub use start::{KitchenStart, StartFamily, random_pose};
pub use state::{Cook, KitchenWorld, Order, OrdersEnd, WorldState, start_pose};
pub use subtask::{Options, Phases, Subtask};
