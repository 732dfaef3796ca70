//! Which entities are present: a history's frames of entities, without the absent ones.
//!
//! A frame has room for N entities of F numbers, presence first, and most of that room is often empty. An absent
//! entity gets no share of attention, so nothing need be computed for it:
//!
//! ```text
//! frames  [M, N F + ...]  ─►  egos [M, F]    others [P, F], frame by frame    presence [M]
//! ```

/// Least presence of a present entity.
const PRESENT: f32 = 0.5;

/// Which entities are present in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FramePresence {
    /// Entities listed beside the ego, n.
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

    /// Tells whether entity i of those that share the attention, the ego first, is present.
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
    pub fn with_capacity(n_frames: usize, shape: &FrameShape) -> Self {
        let entity = |n| Vec::with_capacity(n_frames * n * shape.n_features);
        Self {
            egos: entity(1),
            others: entity(shape.n_entities - 1),
            frames: Vec::with_capacity(n_frames),
        }
    }

    /// Replaces the list by the entities of these frames.
    ///
    /// # Shapes
    ///
    /// `frames`: `[M, frame_dim]`.
    pub fn list(&mut self, frames: &[f32], shape: &FrameShape) {
        self.egos.clear();
        self.others.clear();
        self.frames.clear();
        let is_present = |entity: &&[f32]| entity[0] >= PRESENT;
        for frame in frames.chunks_exact(shape.frame_dim) {
            let entities =
                frame[..shape.n_entities * shape.n_features].chunks_exact(shape.n_features);
            let anybody = entities.clone().any(|entity| is_present(&entity));
            let (ego, others) = frame.split_at(shape.n_features);
            self.egos.extend_from_slice(ego);
            let before = self.others.len();
            let others =
                others[..(shape.n_entities - 1) * shape.n_features].chunks_exact(shape.n_features);
            for other in others.filter(|other| is_present(other) || !anybody) {
                self.others.extend_from_slice(other);
            }
            let n_others = (self.others.len() - before) / shape.n_features;
            self.frames.push(FramePresence { n_others, ego: is_present(&ego), others: anybody });
        }
    }

    /// Returns how many others are listed in all frames, P.
    pub fn n_others(&self) -> usize {
        self.frames.iter().map(|frame| frame.n_others).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absent_entities_are_left_out_unless_all_are_absent() {
        let shape = FrameShape { n_entities: 3, n_features: 2, frame_dim: 7 };
        let frames = [
            [1.0, 10.0, 0.0, 11.0, 1.0, 12.0, 99.0],
            [0.0, 20.0, 1.0, 21.0, 0.4, 22.0, 99.0],
            [0.0, 30.0, 0.0, 31.0, 0.0, 32.0, 99.0],
        ];
        let mut present = PresentEntities::with_capacity(3, &shape);
        present.list(frames.as_flattened(), &shape);
        present.list(frames.as_flattened(), &shape);
        assert_eq!(present.egos, [1.0, 10.0, 0.0, 20.0, 0.0, 30.0]);
        assert_eq!(present.others, [1.0, 12.0, 1.0, 21.0, 0.0, 31.0, 0.0, 32.0]);
        let frame = |n_others, ego, others| FramePresence { n_others, ego, others };
        assert_eq!(
            present.frames,
            [frame(1, true, true), frame(1, false, true), frame(2, false, false)]
        );
        assert_eq!(present.n_others(), 4);
    }
}
