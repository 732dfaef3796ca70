//! Random matrices with orthonormal rows or columns: the usual start of a policy network.

use crate::Pcg64;

/// Draws a matrix whose rows (or columns, whichever are fewer) are orthonormal, times `gain`.
///
/// The draw is uniform over such matrices: standard normal vectors, orthonormalised one after another (modified
/// Gram-Schmidt, twice, in 64 bits).
///
/// # Shapes
///
/// Result: `[rows, columns]` by rows.
///
/// # Source
///
/// Saxe, `McClelland`, Ganguli, *Exact solutions to the nonlinear dynamics of learning in deep linear neural networks*,
/// ICLR 2014; as `torch.nn.init.orthogonal_`, with our own generator.
pub fn orthogonal(rows: usize, columns: usize, gain: f64, generator: &mut Pcg64) -> Vec<f32> {
    let (n_vectors, length) = (rows.min(columns), rows.max(columns));
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(n_vectors);
    while basis.len() < n_vectors {
        let mut vector: Vec<f64> = (0..length).map(|_| generator.normal()).collect();
        let drawn = norm(&vector);
        // The second pass removes what rounding left of the first.
        for _ in 0..2 {
            for earlier in &basis {
                let overlap: f64 = vector.iter().zip(earlier).map(|(a, b)| a * b).sum();
                vector.iter_mut().zip(earlier).for_each(|(a, b)| *a -= overlap * b);
            }
        }
        let left = norm(&vector);
        // A vector within the span of the others is drawn again: its direction would be rounding noise.
        if left > 1e-9 * drawn {
            basis.push(vector.iter().map(|a| a / left).collect());
        }
    }
    let element = |row: usize, column: usize| {
        if rows <= columns { basis[row][column] } else { basis[column][row] }
    };
    (0..rows * columns).map(|i| (gain * element(i / columns, i % columns)) as f32).collect()
}

fn norm(vector: &[f64]) -> f64 {
    libm::sqrt(vector.iter().map(|a| a * a).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shorter_side_is_orthonormal() {
        for (rows, columns) in [(64, 60), (14, 64), (1, 64), (64, 64), (3, 1)] {
            let gain = std::f64::consts::SQRT_2;
            let matrix = orthogonal(rows, columns, gain, &mut Pcg64::seed_from_u64(7));
            let by_rows = rows <= columns;
            let (n_vectors, length) = (rows.min(columns), rows.max(columns));
            let at = |v: usize, i: usize| {
                let index = if by_rows { v * columns + i } else { i * columns + v };
                f64::from(matrix[index])
            };
            for (v, w) in (0..n_vectors).flat_map(|v| (0..n_vectors).map(move |w| (v, w))) {
                let product: f64 = (0..length).map(|i| at(v, i) * at(w, i)).sum();
                let expected = if v == w { gain * gain } else { 0.0 };
                assert!((product - expected).abs() < 1e-5, "{rows}x{columns}: {v}.{w} = {product}");
            }
        }
    }

    #[test]
    fn the_same_stream_draws_the_same_matrix() {
        let draw = |seed| orthogonal(4, 6, 1.0, &mut Pcg64::seed_from_u64(seed));
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
    }
}
