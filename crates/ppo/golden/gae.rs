#[expect(clippy::unreadable_literal, reason = "as golden.py wrote them")]
pub(super) const REWARDS: [f32; 8] = [0.618459, 0.30949572, -0.36856338, -1.0802863, -0.2822254, -0.42288154, -0.5591033, -1.4596043];
#[expect(clippy::unreadable_literal, reason = "as golden.py wrote them")]
pub(super) const VALUES: [f32; 8] = [-0.039960463, -0.5498223, 1.8132685, -0.7456917, 1.1617568, -0.3624775, 0.5965068, -0.050030004];
#[expect(clippy::unreadable_literal, reason = "as golden.py wrote them")]
pub(super) const ADVANTAGES: [f32; 8] = [0.68069124, 0.6024411, -2.1818318, -0.93345135, -1.8596449, -0.060404032, -2.7746239, -1.668776];
#[expect(clippy::unreadable_literal, reason = "as golden.py wrote them")]
pub(super) const NEXT_VALUE: f32 = -0.26182002;
