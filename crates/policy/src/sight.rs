//! Who is in sight: a history's frames of entities, without those that are not there.
//!
//! A frame has room for N entities of F numbers, presence first, and most of that room is often empty. What is empty
//! gets no share of attention, so that nothing need be computed for it:
//!
//! ```text
//! frames  [M, N F + ...]  ─►  egos [M, F]    others [P, F], frame by frame    seen [M]
//! ```

/// Least presence of an entity that is there.
const PRESENT: f32 = 0.5;

/// Who is in sight in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Entities in sight beside the ego, n.
    pub n_others: usize,
    /// Whether the ego is there.
    pub ego: bool,
    /// Whether the others are: all are listed, and all alike, where nobody is there.
    pub others: bool,
}

impl Seen {
    /// Returns how many entities share the attention.
    pub fn n_entities(self) -> usize {
        1 + self.n_others
    }

    /// Tells whether entity i of those that share the attention, the ego first, is there.
    pub fn has(self, i: usize) -> bool {
        if i == 0 { self.ego } else { self.others }
    }
}

/// Shape of a frame: N entities of F numbers, then whatever else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameShape {
    /// Entities, N, the ego included and first.
    pub n_entities: usize,
    /// Numbers per entity, F; the first is the presence.
    pub n_features: usize,
    /// Numbers per frame, at least N F.
    pub frame_dim: usize,
}

/// The entities in sight of a batch of frames. Made anew in place, so that it need not allocate.
#[derive(Clone, Debug, Default)]
pub struct Sight {
    /// The egos, `[M, F]`.
    pub egos: Vec<f32>,
    /// The others in sight, one frame's behind the other's, `[P, F]`.
    pub others: Vec<f32>,
    /// Who is in sight, `[M]`.
    pub seen: Vec<Seen>,
}

impl Sight {
    /// Makes room for `n_frames` frames.
    pub fn with_capacity(n_frames: usize, shape: &FrameShape) -> Self {
        let entity = |n| Vec::with_capacity(n_frames * n * shape.n_features);
        Self {
            egos: entity(1),
            others: entity(shape.n_entities - 1),
            seen: Vec::with_capacity(n_frames),
        }
    }

    /// Replaces what is listed by the entities of these frames, `[M, frame_dim]`.
    pub fn list(&mut self, frames: &[f32], shape: &FrameShape) {
        self.clear();
        self.add(frames, shape);
    }

    /// Forgets all frames.
    pub fn clear(&mut self) {
        self.egos.clear();
        self.others.clear();
        self.seen.clear();
    }

    /// Adds the entities of these frames, `[M, frame_dim]`, to what is listed.
    pub fn add(&mut self, frames: &[f32], shape: &FrameShape) {
        let is_there = |entity: &&[f32]| entity[0] >= PRESENT;
        for frame in frames.chunks_exact(shape.frame_dim) {
            let entities =
                frame[..shape.n_entities * shape.n_features].chunks_exact(shape.n_features);
            let anybody = entities.clone().any(|entity| is_there(&entity));
            let (ego, others) = frame.split_at(shape.n_features);
            self.egos.extend_from_slice(ego);
            let before = self.others.len();
            let others =
                others[..(shape.n_entities - 1) * shape.n_features].chunks_exact(shape.n_features);
            for other in others.filter(|other| is_there(other) || !anybody) {
                self.others.extend_from_slice(other);
            }
            let n_others = (self.others.len() - before) / shape.n_features;
            self.seen.push(Seen { n_others, ego: is_there(&ego), others: anybody });
        }
    }

    /// Returns how many others are in sight in all frames, P.
    pub fn n_others(&self) -> usize {
        self.seen.iter().map(|seen| seen.n_others).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_not_there_is_left_out_unless_nobody_is() {
        let shape = FrameShape { n_entities: 3, n_features: 2, frame_dim: 7 };
        let frames = [
            [1.0, 10.0, 0.0, 11.0, 1.0, 12.0, 99.0],
            [0.0, 20.0, 1.0, 21.0, 0.4, 22.0, 99.0],
            [0.0, 30.0, 0.0, 31.0, 0.0, 32.0, 99.0],
        ];
        let mut sight = Sight::with_capacity(3, &shape);
        sight.list(frames.as_flattened(), &shape);
        sight.list(frames.as_flattened(), &shape);
        assert_eq!(sight.egos, [1.0, 10.0, 0.0, 20.0, 0.0, 30.0]);
        assert_eq!(sight.others, [1.0, 12.0, 1.0, 21.0, 0.0, 31.0, 0.0, 32.0]);
        let seen = |n_others, ego, others| Seen { n_others, ego, others };
        assert_eq!(sight.seen, [seen(1, true, true), seen(1, false, true), seen(2, false, false)]);
        assert_eq!(sight.n_others(), 4);
    }
}
