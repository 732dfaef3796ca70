//! The contact world: hull, legs and ground as rapier2d treats them, and as Box2D would.
//!
//! Rapier's general engine spends most of a frame on what a single lander on fixed ground does not need: islands,
//! graphs, sleeping, colours of constraints, matrices of any size. This is the rest of it, on parry's geometry and
//! with the same bits in every speed and pose; the tests fly both side by side.
//!
//! ```text
//! place -> settle -> pairs -> touch -> forces -> rows -> sweeps -> move -> sweeps -> stop
//!          articulation       ground   articulation      solve                       sweep
//! ```

mod articulation;
mod ground;
mod model;
mod pairs;
mod solve;
mod sweep;
mod tree;
mod world;

#[cfg(test)]
pub(super) mod rapier;

pub(super) use world::ContactWorld;
