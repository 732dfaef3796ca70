//! Arrows between the spans of several processes: who ended whose wait.

/// Numbers in JSON are exact below 2^53.
const BITS: u32 = 53;

/// Names one arrow; both of its ends compute the same name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraceArrow(pub(crate) u64);

impl TraceArrow {
    /// Names the arrow from a rollout that an actor's start published to the update that had waited for it.
    pub fn of_rollout(actor: u64, sequence: u64) -> Self {
        Self::of(1, actor, sequence)
    }

    /// Names the arrows from weights that a learner's start put on offer to whatever had waited for them.
    pub fn of_weights(learner: u64, version: u64) -> Self {
        Self::of(2, learner, version)
    }

    fn of(kind: u64, start: u64, number: u64) -> Self {
        // The finaliser of SplitMix64: starts and numbers that differ in one bit give unrelated names.
        let mix = |x: u64| {
            let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            x ^ (x >> 31)
        };
        Self(mix(mix(start ^ kind) ^ number) >> (u64::BITS - BITS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rollouts_and_weights_of_every_start_have_names_of_their_own() {
        let starts = [7, 8, 7 << 48];
        let all = starts.iter().flat_map(|&start| {
            let of = move |number| {
                [TraceArrow::of_rollout(start, number), TraceArrow::of_weights(start, number)]
            };
            (0..1_000).flat_map(of)
        });
        let mut names: Vec<u64> = all.map(|arrow| arrow.0).collect();
        assert!(names.iter().all(|name| *name < 1 << BITS));
        let n = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), n);
    }
}
