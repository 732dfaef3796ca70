//! Contacts of the bodies with the ground: where they touch, and what the solver keeps from frame to frame.

use rapier2d::math::{Pose, Vector};
use rapier2d::parry::bounding_volume::{Aabb, BoundingVolume as _};
use rapier2d::parry::query::ContactManifold;
use rapier2d::parry::query::details::contact_manifold_pfm_pfm;
use rapier2d::parry::shape::{HeightField, PolygonalFeatureMap, Segment, Shape};
use serde::{Deserialize, Serialize};

use super::super::constants::HULL;
use super::super::terrain::N_POINTS;
use super::articulation::LinkVelocity;
use super::model::{GROUND_CENTER, GROUND_SCALE, LanderModel, PREDICTION, REACH, SKIN, TIME_STEP};

/// Impulses of a contact point in the last frame, with which the next one starts.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct Impulses {
    pub(super) normal: f32,
    pub(super) tangent: f32,
}

pub(super) type Manifold = ContactManifold<(), Impulses>;

pub(super) fn shape(heights: &[f64; N_POINTS]) -> HeightField {
    let heights = heights.iter().map(|&y| y as f32).collect();
    HeightField::new(heights, GROUND_SCALE)
}

pub(super) fn pose() -> Pose {
    Pose::from_translation(GROUND_CENTER)
}

/// The box in which a body is looked for.
pub(super) fn search_box(shape: &dyn Shape, pose: &Pose) -> Aabb {
    shape.compute_aabb(pose).loosened(SKIN + PREDICTION / 2.0)
}

/// Finds the points at which a body touches the segments of the ground, one manifold per segment; what `manifolds`
/// knew of a segment is carried over.
pub(super) fn touch(
    model: &LanderModel,
    ground: &HeightField,
    body: usize,
    pose: &Pose,
    manifolds: &mut Vec<Manifold>,
) {
    let local = self::pose().inv_mul(pose);
    if body == HULL {
        touch_shape(&model.hull, ground, &local, manifolds);
    } else {
        touch_shape(&model.leg, ground, &local, manifolds);
    }
}

fn touch_shape<S: Shape + PolygonalFeatureMap>(
    shape: &S,
    ground: &HeightField,
    local: &Pose,
    manifolds: &mut Vec<Manifold>,
) {
    let near = shape.compute_aabb(local).loosened(REACH);
    let mut known = std::mem::take(manifolds);
    ground.map_elements_in_local_aabb(&near, &mut |i, segment: &Segment| {
        let before = known.iter_mut().find(|manifold| manifold.subshape1 == i);
        let mut manifold = before.map_or_else(|| Manifold::with_data(i, 0, ()), Manifold::take);
        contact_manifold_pfm_pfm(local, segment, 0.0, None, shape, 0.0, None, REACH, &mut manifold);
        manifolds.push(manifold);
    });
}

/// Where a body is while its contacts are gathered.
pub(super) struct BodyPlace {
    pub(super) body: usize,
    /// Where the last frame ended.
    pub(super) seen: Pose,
    /// With every link at the hull.
    pub(super) pose: Pose,
    /// Before the last frame's solution.
    pub(super) velocity: LinkVelocity,
}

/// A point at which the solver holds a body off the ground.
pub(super) struct ContactPoint {
    /// Index in its manifold.
    pub(super) index: usize,
    /// From the body's centre, in metres.
    pub(super) arm: Vector,
    /// The gap without the skins, in metres; negative in the ground.
    pub(super) gap: f32,
    /// From the body's anchor to the ground's, in metres: nothing but rounding.
    pub(super) offset: Vector,
}

/// Calls `found` with each point of a manifold that may carry load within the frame.
pub(super) fn points(manifold: &Manifold, place: &BodyPlace, mut found: impl FnMut(ContactPoint)) {
    let BodyPlace { seen, pose: body, velocity, .. } = place;
    let (ground, normal) = (pose(), manifold.local_n1);
    for (index, contact) in manifold.points.iter().enumerate() {
        let distance = contact.dist - SKIN - SKIN;
        let (on_ground, on_body) = (ground * contact.local_p1, *seen * contact.local_p2);
        let closing = velocity.at(on_body - body.translation).dot(normal) * TIME_STEP;
        if distance >= PREDICTION && distance + closing >= PREDICTION {
            continue;
        }
        let on_skin = on_ground + normal * ((on_body - on_ground).dot(normal) - distance);
        let middle = (on_skin + on_body) * 0.5;
        let arm = middle - body.translation;
        let anchored = *body * body.inverse_transform_point(on_body);
        let lever = body.translation + arm;
        let gap = (on_skin - anchored).dot(-normal) - (middle - lever).dot(-normal);
        let offset = middle - *body * body.inverse_transform_point(lever);
        found(ContactPoint { index, arm, gap: gap + offset.dot(-normal), offset });
    }
}
