//! Which bodies are near enough to the ground to be tested against it, and in which order the solver meets them.
//!
//! This is rapier's broad phase for a ground and three bodies, call for call on parry's tree: the order in which
//! pairs appear is the order of the solver's rows, and decides the last bits of every velocity.

use rapier2d::parry::bounding_volume::Aabb;
use rapier2d::parry::partitioning::{Bvh, BvhLeafUpdateStatus, BvhWorkspace};
use serde::{Deserialize, Serialize};

use super::tree;

/// Leaf of the ground; the bodies' leaves follow in their order.
const GROUND: u32 = 0;
/// How far a box may move before the tree notices, in metres.
const SKIN: f32 = 0.04;

/// The tree of boxes, and what its last update left.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(super) struct Pairs {
    tree: Bvh,
    /// Leaves that the last update changed.
    changed: Leaves,
    /// Leaves that have changed since.
    pending: Leaves,
    /// The tree is worse than before since its last optimization.
    worse: bool,
    /// Nothing moved in the last frame, so a leaf that moves has to be inserted again.
    reinsert: bool,
    /// The bodies that are paired with the ground, in the order of their appearance.
    order: Vec<usize>,
    #[serde(skip)]
    workspace: BvhWorkspace,
}

/// A set of leaves.
#[derive(Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
struct Leaves(u8);

impl Leaves {
    fn insert(&mut self, leaf: u32) {
        self.0 |= 1 << leaf;
    }

    fn contains(self, leaf: u32) -> bool {
        self.0 & (1 << leaf) != 0
    }

    fn is_empty(self) -> bool {
        self.0 == 0
    }
}

impl Pairs {
    pub(super) fn order(&self) -> &[usize] {
        &self.order
    }

    /// Returns whether every pair has a body and a leaf.
    pub(super) fn is_complete(&self) -> bool {
        tree::is_whole(&self.tree, 4) && self.order.iter().all(|&body| body < 3)
    }

    /// Moves a body's box at the end of a frame.
    pub(super) fn follow(&mut self, body: usize, aabb: Aabb) {
        let leaf = body as u32 + 1;
        let status = if self.reinsert {
            self.tree.reinsert_or_update_with_change_detection(aabb, leaf, SKIN)
        } else {
            self.tree.insert_with_change_detection(aabb, leaf, SKIN)
        };
        if status != BvhLeafUpdateStatus::Unchanged {
            self.worse |= !self.reinsert && status == BvhLeafUpdateStatus::UpdatedInPlace;
            self.pending.insert(leaf);
        }
    }

    /// Finds the pairs of a frame. `placed` has the boxes of ground and bodies if the lander was put where it is, and
    /// is empty if it came there by itself. Calls `gone` with each body whose pair is no more.
    pub(super) fn update(&mut self, placed: &[Aabb], mut gone: impl FnMut(usize)) {
        self.reinsert = placed.is_empty() && self.pending.is_empty();
        if self.reinsert && self.changed.is_empty() {
            return;
        }
        self.changed = self.take_changes(placed);
        let optimize = std::mem::take(&mut self.worse);
        self.tree.refit(&mut self.workspace);
        self.append_new();
        self.remove_stale(&mut gone);
        if optimize {
            // Rapier does it while the solver works; nothing reads the tree in between.
            self.tree.optimize_incremental(&mut self.workspace);
            self.tree.refit_without_resolve(&mut self.workspace);
        }
    }

    /// Writes the placed boxes to the tree, and returns the leaves that have changed.
    fn take_changes(&mut self, placed: &[Aabb]) -> Leaves {
        let mut changed = std::mem::take(&mut self.pending);
        // Every leaf that is there is moved before any is inserted, so that an insertion sees all boxes of the frame.
        let mut missing = Leaves::default();
        for (leaf, aabb) in (0..).zip(placed) {
            match self.tree.update_partially_if_present(*aabb, leaf, SKIN) {
                None => missing.insert(leaf),
                Some(BvhLeafUpdateStatus::Unchanged) => {}
                Some(status) => {
                    self.worse |= status == BvhLeafUpdateStatus::UpdatedInPlace;
                    changed.insert(leaf);
                }
            }
        }
        for (leaf, aabb) in (0..).zip(placed).filter(|&(leaf, _)| missing.contains(leaf)) {
            self.tree.insert_or_update_partially(*aabb, leaf, SKIN);
            changed.insert(leaf);
        }
        changed
    }

    fn append_new(&mut self) {
        let order = &mut self.order;
        self.tree.traverse_bvtt_single_tree::<true>(&mut self.workspace, &mut |a, b| {
            let body = a.max(b) as usize - 1;
            if a.min(b) == GROUND && !order.contains(&body) {
                order.push(body);
            }
        });
    }

    fn remove_stale(&mut self, gone: &mut impl FnMut(usize)) {
        let Some(ground) = self.tree.leaf_node(GROUND) else { return };
        for (body, leaf) in (1..4).enumerate() {
            let place = self.order.iter().position(|&paired| paired == body);
            let (Some(place), Some(node)) = (place, self.tree.leaf_node(leaf)) else { continue };
            let updated = self.changed.contains(leaf) || self.changed.contains(GROUND);
            let changed = ground.is_changed() || node.is_changed();
            if updated && changed && !ground.intersects(node) {
                self.order.swap_remove(place);
                gone(body);
            }
        }
    }
}
