//! Which entities are present: a history's frames of entities, without the absent ones.
//!
//! A frame has room for N entities of F numbers, presence first, and most of that room is often empty. An absent
//! entity gets no share of attention, so nothing need be computed for it:
//!
//! ```text
//! frames  [M, N F + ...]  ─►  egos [M, F]    others [P, F], frame by frame    presence [M]
//! ```

use leadtime_proto::EgoAttention;

/// Least presence of a present entity.
const PRESENT: f32 = 0.5;

/// Lists which numbers of an observation say whether an entity is present, and so must be read as they are.
pub fn presence_flags(spec: &EgoAttention) -> impl Iterator<Item = usize> {
    let &EgoAttention { n_frames, n_entities, n_features, .. } = spec;
    let frame_dim = spec.frame_dim();
    let of_frame =
        move |frame| (0..n_entities).map(move |entity| frame * frame_dim + entity * n_features);
    (0..n_frames).flat_map(of_frame)
}

/// Which entities are present in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FramePresence {
    /// Entities listed besides the ego, n.
    pub n_others: usize,
    /// Whether the ego is present.
    pub ego: bool,
    /// Whether the listed others are present. In a frame without anyone they are all listed, and all absent.
    pub others: bool,
}

impl FramePresence {
    /// Returns how many entities share the attention.
    pub fn n_entities(self) -> usize {
        1 + self.n_others
    }

    /// Returns whether entity i of those that share the attention, the ego first, is present.
    pub fn has(self, i: usize) -> bool {
        if i == 0 { self.ego } else { self.others }
    }
}

/// The present entities of a batch of frames. Refilled in place, so that acting does not allocate.
#[derive(Clone, Debug, Default)]
pub struct PresentEntities {
    /// The egos, `[M, F]`.
    pub egos: Vec<f32>,
    /// The present others, one frame's behind the other's, `[P, F]`.
    pub others: Vec<f32>,
    /// Who is present in each frame, `[M]`.
    pub frames: Vec<FramePresence>,
}

impl PresentEntities {
    /// Makes room for `n_frames` frames.
    pub(super) fn with_capacity(n_frames: usize, spec: &EgoAttention) -> Self {
        let entities = |n| Vec::with_capacity(n_frames * n * spec.n_features);
        let (egos, others) = (entities(1), entities(spec.n_entities - 1));
        Self { egos, others, frames: Vec::with_capacity(n_frames) }
    }

    /// Replaces the list by the entities of these frames.
    ///
    /// # Shapes
    ///
    /// `frames`: `[M, frame_dim]`.
    pub fn list(&mut self, frames: &[f32], spec: &EgoAttention) {
        let &EgoAttention { n_entities, n_features, .. } = spec;
        self.egos.clear();
        self.others.clear();
        self.frames.clear();
        let is_present = |entity: &&[f32]| entity[0] >= PRESENT;
        for frame in frames.chunks_exact(spec.frame_dim()) {
            let (ego, others) = frame[..n_entities * n_features].split_at(n_features);
            let others = others.chunks_exact(n_features);
            let anybody = is_present(&ego) || others.clone().any(|other| is_present(&other));
            self.egos.extend_from_slice(ego);
            let before = self.others.len();
            for other in others.filter(|other| is_present(other) || !anybody) {
                self.others.extend_from_slice(other);
            }
            let n_others = (self.others.len() - before) / n_features;
            self.frames.push(FramePresence { n_others, ego: is_present(&ego), others: anybody });
        }
    }

    /// Returns how many others are listed in all frames, P.
    pub fn n_others(&self) -> usize {
        self.frames.iter().map(|frame| frame.n_others).sum()
    }
}

/// Two frames of three entities of two numbers and an action.
#[cfg(test)]
pub(crate) const TWO_FRAMES: EgoAttention =
    EgoAttention { n_frames: 2, n_entities: 3, n_features: 2, action_dim: 1, width: 4, n_heads: 1 };

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absent_entities_are_left_out_unless_all_are_absent() {
        let spec = EgoAttention { n_frames: 1, ..TWO_FRAMES };
        let frames = [
            [1.0, 10.0, 0.0, 11.0, 1.0, 12.0, 99.0],
            [0.0, 20.0, 1.0, 21.0, 0.4, 22.0, 99.0],
            [0.0, 30.0, 0.0, 31.0, 0.0, 32.0, 99.0],
        ];
        let mut present = PresentEntities::with_capacity(3, &spec);
        present.list(frames.as_flattened(), &spec);
        present.list(frames.as_flattened(), &spec);
        assert_eq!(present.egos, [1.0, 10.0, 0.0, 20.0, 0.0, 30.0]);
        assert_eq!(present.others, [1.0, 12.0, 1.0, 21.0, 0.0, 31.0, 0.0, 32.0]);
        let frame = |n_others, ego, others| FramePresence { n_others, ego, others };
        let expected = [frame(1, true, true), frame(1, false, true), frame(2, false, false)];
        assert_eq!(present.frames, expected);
        assert_eq!(present.n_others(), 4);
    }

    #[test]
    fn every_entity_of_every_frame_begins_with_a_flag() {
        assert_eq!(presence_flags(&TWO_FRAMES).collect::<Vec<_>>(), [0, 2, 4, 7, 9, 11]);
    }
}
