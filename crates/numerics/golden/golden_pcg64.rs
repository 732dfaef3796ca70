// Written by golden_pcg64.py; do not edit.
struct Golden {
    entropy: &'static [u32],
    units: [f64; 3],
    integers: [i64; 4],
    uniform: f64,
}
const GOLDEN: &[Golden] = &[
    Golden {
        entropy: &[0],
        units: [0.6369616873214543, 0.2697867137638703, 0.04097352393619469],
        integers: [-8495, -9669, -6495, 6264],
        uniform: 825.5111545554435,
    },
    Golden {
        entropy: &[42],
        units: [0.7739560485559633, 0.4388784397520523, 0.8585979199113825],
        integers: [-8281, 3946, -5971, -8116],
        uniform: 951.244703273512,
    },
    Golden {
        entropy: &[7, 1],
        units: [0.7701409510034741, 0.1119272443176843, 0.18909773329712753],
        integers: [-5615, -6801, 737, -1361],
        uniform: 3.456943005700964,
    },
    Golden {
        entropy: &[1, 2, 3, 4, 5, 6, 7],
        units: [0.9607564144245102, 0.7833112431696503, 0.9214180050601017],
        integers: [-6941, 8531, 6121, -837],
        uniform: -192.97820022030737,
    },
];
