//! What stands between observations and stacks, as a graph with gradients: what [`leadtime_policy::encoder`] computes.

mod attention;
mod graph;
mod lstm;

pub(crate) use graph::EncoderGraph;
