//! `leadtime conformance`: our worlds against recorded traces of their public originals.

mod highway;
mod lander;
mod replay;
mod steakhouse;

pub(super) use replay::run;
