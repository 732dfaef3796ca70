//! Traffic on a highway with merging ramps, as in highway-env: lanes, cars, drivers, collisions.
//!
//! ```text
//!  ──────────────────────────────────────────────    y = -2
//!    ▭▸  left lane (0)                     ▭▸
//!  - - - - - - - - - - - - - - - - - - - - - - - -   y = 2
//!             ▭▸  right lane (1)     ▭▸
//!  ─────────────────┐. . . . . . . . . . . . ┌───    y = 6
//!         ▭▸        ╱   ▭▸  parallel lane    ■       obstacle
//! ─────────────────╱──────────────────────────
//! ```
//!
//! Cars on a ramp are ordinary drivers who change lanes because an obstacle stands in their way. What makes the
//! three-merge road dangerous is who sees whom: they do not see the ego, and the ego counts on their yielding
//! ([`Blindness`]).
//!
//! All numbers are f64, and functions of angles come from `libm`: the same on every machine.
//!
//! # Where to start
//!
//! [`Traffic::step`] is a frame; [`RoadSettings`] describes a road.
//!
//! # Source
//!
//! highway-env 1.12.1, of which the merge environments are followed to the ninth decimal.

mod collision;
pub mod constants;
mod control;
mod idm;
mod lane;
mod network;
mod observe;
mod reward;
mod road;
mod traffic;
mod vehicle;

pub use collision::{Contact, Footprint, contact};
pub use control::{DriverCommand, SpeedGrid};
pub use lane::{Lane, LaneSettings, Wave};
pub use network::{LaneId, Lookup, RoadNetwork};
pub use observe::ObservationSettings;
pub(crate) use observe::quantities;
pub use reward::{RewardSettings, RewardTerms};
pub use road::{Ramp, RampSettings, Road, RoadSettings, Side};
pub use traffic::{Blindness, Traffic};
pub use vehicle::{CarRole, Driver, Idm, Vehicle};
