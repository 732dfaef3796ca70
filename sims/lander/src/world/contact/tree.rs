//! Whether parry's tree of boxes is one: it follows its own indices without a look, so a tree out of a snapshot that was damaged, or
//! made up, would end the process.

use leadtime_proto::codec;
use leadtime_proto::limits::MAX_SNAPSHOT_BYTES;
use rapier2d::parry::partitioning::Bvh;
use serde::Deserialize;

/// What parry writes of a tree, field by field.
#[derive(Deserialize)]
struct TreeBytes {
    /// Pairs of siblings; the first has the root's children.
    pairs: Vec<[NodeBytes; 2]>,
    /// For each pair the node whose children they are: twice the index of its pair, plus its side.
    parents: Vec<usize>,
    /// For each leaf its node; a count stands before.
    leaves: (usize, Vec<Option<usize>>),
    /// Where optimization goes on.
    _optimization: [u32; 2],
    /// Pairs that are in no use.
    free: Vec<u32>,
}

#[derive(Deserialize)]
struct NodeBytes {
    lowest: [f32; 2],
    /// The pair of its children; of a leaf its number.
    below: u32,
    highest: [f32; 2],
    /// How many leaves it has, and two flags.
    packed: u32,
}

impl NodeBytes {
    fn n_leaves(&self) -> u32 {
        self.packed & 0x3fff_ffff
    }

    fn is_finite(&self) -> bool {
        self.lowest.iter().chain(&self.highest).all(|x| x.is_finite())
    }
}

/// Returns whether a tree has these leaves, 0 and up, each once, and every index in it leads where it should.
pub(super) fn is_whole(tree: &Bvh, n_leaves: usize) -> bool {
    let bytes = codec::encode(tree).expect("the tree is plain data");
    let Ok(tree) = codec::decode::<TreeBytes>(&bytes, MAX_SNAPSHOT_BYTES) else { return false };
    let mut seen = vec![false; tree.pairs.len()];
    let has_leaves = tree.leaves.1.iter().flatten().count() == n_leaves
        && tree.leaves.0 == n_leaves
        && tree.parents.len() == tree.pairs.len();
    let mut is_free = |&pair: &u32| {
        seen.get_mut(pair as usize).is_some_and(|seen| !std::mem::replace(seen, true))
    };
    has_leaves
        && tree.free.iter().all(&mut is_free)
        && tree.n_below(0, &mut seen) == Some(n_leaves as u32)
}

impl TreeBytes {
    /// Returns how many leaves are below a pair; `None` if something is wrong there.
    fn n_below(&self, pair: u32, seen: &mut [bool]) -> Option<u32> {
        let nodes = self.pairs.get(pair as usize)?;
        let seen_here = seen.get_mut(pair as usize)?;
        if std::mem::replace(seen_here, true) {
            return None;
        }
        let mut n_leaves = 0_u32;
        for (side, node) in nodes.iter().enumerate() {
            let here = 2 * pair as usize + side;
            let n = if node.n_leaves() == 1 {
                (*self.leaves.1.get(node.below as usize)? == Some(here)).then_some(1)?
            } else {
                (*self.parents.get(node.below as usize)? == here).then_some(())?;
                self.n_below(node.below, seen)?
            };
            (node.is_finite() && node.n_leaves() == n).then_some(())?;
            n_leaves = n_leaves.checked_add(n)?;
        }
        Some(n_leaves)
    }
}
