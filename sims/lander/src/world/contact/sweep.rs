//! Stops fast links at the ground, where a frame's step would take them through it.

use rapier2d::math::{Pose, Vector};
use rapier2d::parry::bounding_volume::BoundingVolume as _;
use rapier2d::parry::query::sweep_toi::{
    Sweep, SweepCompositeFastShape, ToiProxy, sweep_time_of_impact_composite,
};
use rapier2d::parry::shape::HeightField;

use super::ground;
use super::model::{LanderModel, PREDICTION};

/// A body is swept if it moves by more than this part of its thickness in a frame.
const FAST: f32 = 0.5;
/// A sweep may end this far inside, in metres.
const SLOP: f32 = 0.005;

/// Returns where a body stops on its way from one pose to the next.
pub(super) fn stop(
    model: &LanderModel,
    field: &HeightField,
    body: usize,
    from: &Pose,
    to: &Pose,
) -> Pose {
    let turn = (to.rotation * from.rotation.inverse()).sin().abs() * model.extents[body];
    let motion = (to.translation - from.translation).length() + turn;
    if motion <= FAST * model.thicknesses[body] {
        return *to;
    }
    let shape = model.shape(body);
    let swept = shape.compute_aabb(from).merged(&shape.compute_aabb(to));
    let target = field.aabb(&ground::pose()).loosened(PREDICTION);
    let Some(proxy) = ToiProxy::from_shape(shape).filter(|_| target.intersects(&swept)) else {
        return *to;
    };
    let sweep = Sweep::from_poses(from, to, Vector::ZERO);
    let fast = SweepCompositeFastShape {
        proxy: &proxy,
        sweep: &sweep,
        local_centroid: model.middles[body],
        min_extent: model.thicknesses[body],
    };
    let impact =
        sweep_time_of_impact_composite(field, &ground::pose(), fast, false, false, 1.0, SLOP);
    let stopped = impact.filter(|impact| 0.0 < impact.fraction && impact.fraction < 1.0);
    stopped.map_or(*to, |impact| sweep.transform_at(impact.fraction))
}
