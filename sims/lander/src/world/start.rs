//! The state after the hidden first frame of an episode.
//!
//! The original creates the legs 0.6 m off their joints, pushes the hull with a random force, and lets Box2D snap
//! everything together in one frame before the first observation. The state after that frame is linear in the
//! force (residual at most 5.6e-5 over 600 seeds), so a fitted map replaces the solver.

use nalgebra::Vector4;

use super::body::Body;
use super::constants::{HEIGHT, HULL, HULL_COM, PAD_X, Vec2};

/// In the first two frames Box2D turns the legs by a little more or less than their motors' speed, in proportion to
/// the vertical force. The legs start with that difference, so that they reach their stops in the right frame.
const LEG_LEAD: f64 = 3.02e-4;

/// Rows x - 10, y - H, angle, vx, vy, w of hull and legs (positions of body origins, velocities of centres of
/// mass); columns 1, horizontal force / 1000, vertical force / 1000, torque.
const MAP: [[[f64; 4]; 6]; 3] = [
    [
        [0.000_001_6, 0.079_826_9, 0.0, 0.000_039_7],
        [0.002_135_6, 0.0, 0.080_663_1, 0.0],
        [0.000_006_6, -0.009_249_9, 0.0, 0.000_439_5],
        [0.0, 4.042_798_7, 0.0, -0.000_457_9],
        [-0.2, 0.0, 4.033_161_4, 0.0],
        [0.0, -0.457_877_1, 0.0, 0.021_754_2],
    ],
    [
        [0.870_981_7, 0.077_260_6, 0.0, 0.000_160_5],
        [-0.211_867, -0.010_449_1, 0.080_663_4, 0.000_496_3],
        [0.491_884_5, -0.011_995_9, LEG_LEAD, 0.000_569_4],
        [0.0, 3.706_773_3, 0.0, 0.015_507],
        [-0.2, -0.291_139_2, 4.033_161_5, 0.013_832_3],
        [0.0, -0.457_877_6, 0.0, 0.021_754_2],
    ],
    [
        [-0.871_038_5, 0.077_260_1, 0.0, 0.000_162_9],
        [-0.211_639_2, 0.010_452_8, 0.080_663_4, -0.000_496_8],
        [-0.492_145_2, -0.012_000_8, -LEG_LEAD, 0.000_570_7],
        [0.0, 3.706_773_3, 0.0, 0.015_507],
        [-0.2, 0.291_139_4, 4.033_161_5, -0.013_832_3],
        [0.0, -0.457_877_4, 0.0, 0.021_754_1],
    ],
];

/// Computes hull and legs after the hidden frame, and the hull's angle.
///
/// `force`: newtons on the hull's centre of mass, wind included; `torque`: newton metres.
pub(super) fn after_hidden_frame(force: Vec2, torque: f64) -> ([Body; 3], f64) {
    let input = Vector4::new(1.0, force.x / 1000.0, force.y / 1000.0, torque);
    let bodies = std::array::from_fn(|i| body(i, &input));
    (bodies, Vector4::from(MAP[HULL][2]).dot(&input))
}

fn body(i: usize, input: &Vector4<f64>) -> Body {
    let [x, y, angle, vx, vy, spin] = MAP[i].map(|row| Vector4::from(row).dot(input));
    let (sin, cos) = libm::sincos(angle);
    let lift = if i == HULL { HULL_COM } else { 0.0 };
    let center = Vec2::new(PAD_X + x - sin * lift, HEIGHT + y + cos * lift);
    Body { center, cos, sin, velocity: Vec2::new(vx, vy), spin }
}
