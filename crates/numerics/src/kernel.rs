//! One matrix product for inference and learning, whose bits depend on nothing but its operands.
//!
//! `C = start + A·B` is computed as independent chains of fused multiply-adds, one chain per element of `C`, each in
//! the order of the inner index. So an element's bits do not depend on the number of rows, on its place among them, on
//! how the work is cut into tiles, or on the width of the machine's vectors: the same policy gives the same answer for
//! an observation alone and in a batch of a thousand, on AVX2, on NEON and (slowly) on a machine without either.
//!
//! ```text
//!            B packed in panels of 16 columns, [k][16] each, zero-padded
//!            ┌────────┐
//!   A [m,k]  │ panel 0│  panel 1 …
//!   ┌──────┐ ├────────┤
//!   │6 rows│→│6 x 16 accumulators in registers│
//!   └──────┘ └────────┘
//! ```
//!
//! # Where to start
//!
//! [`Panels`] holds B; [`Panels::multiply`] is the product with `A`, [`add_outer_products`] the one with `Aᵀ`.

#![expect(
    clippy::inline_always,
    reason = "kernels must be compiled inside the dispatched target features"
)]

use pulp::{Arch, Simd, WithSimd};

use crate::elementary::tanh_vector;

/// Columns per panel: one AVX-512 vector, two of AVX2, four of NEON.
const PANEL: usize = 16;
/// Rows per tile: with two AVX2 vectors per panel, twelve of the sixteen registers accumulate.
const ROWS: usize = 6;
/// Rows per tile where one vector is a panel: as many chains as keep both multipliers busy.
const WIDE_ROWS: usize = 2 * ROWS;
/// Inner indices per pass of [`add_outer_products`]: what one pass reads stays in the first-level cache.
const DEPTH: usize = 256;

/// What happens to an output before it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// The output is stored as it is.
    Linear,
    /// The hyperbolic tangent ([`crate::tanh_inplace`]).
    Tanh,
    /// Zero where it is negative.
    Relu,
}

/// The right operand of a product, packed for it.
#[derive(Clone, Debug, Default)]
pub struct Panels {
    depth: usize,
    n_columns: usize,
    /// `[panel][depth][PANEL]`, zeros behind the last column.
    data: Vec<[f32; PANEL]>,
}

impl Panels {
    /// Packs a matrix given by rows.
    ///
    /// # Shapes
    ///
    /// `rows`: `[depth, n_columns]`.
    ///
    /// # Panics
    ///
    /// If the length is another.
    pub fn from_rows(rows: &[f32], depth: usize, n_columns: usize) -> Self {
        let mut panels = Self::default();
        panels.pack_rows(rows, depth, n_columns);
        panels
    }

    /// Packs a matrix given by columns, such as a layer's weights `[n_out, n_in]`.
    ///
    /// # Shapes
    ///
    /// `columns`: `[n_columns, depth]`.
    ///
    /// # Panics
    ///
    /// If the length is another.
    pub fn from_columns(columns: &[f32], n_columns: usize, depth: usize) -> Self {
        assert_eq!(columns.len(), n_columns * depth, "`columns` must be [n_columns, depth]");
        let mut data = Vec::with_capacity(n_columns.div_ceil(PANEL) * depth);
        for columns in columns.chunks(PANEL * depth.max(1)) {
            if let Some(columns) = whole_panel(columns, depth) {
                data.extend((0..depth).map(|k| columns.map(|column| column[k])));
                continue;
            }
            let column = |c: usize, k: usize| columns.get(c * depth + k).copied().unwrap_or(0.0);
            data.extend((0..depth).map(|k| std::array::from_fn(|c| column(c, k))));
        }
        Self { depth, n_columns, data }
    }

    /// Packs a matrix given by rows into the memory of this one.
    fn pack_rows(&mut self, rows: &[f32], depth: usize, n_columns: usize) {
        assert_eq!(rows.len(), depth * n_columns, "`rows` must be [depth, n_columns]");
        self.depth = depth;
        self.n_columns = n_columns;
        self.data.resize(n_columns.div_ceil(PANEL) * depth, [0.0; PANEL]);
        for (p, panel) in self.data.chunks_exact_mut(depth.max(1)).enumerate() {
            let first = p * PANEL;
            let width = PANEL.min(n_columns - first);
            for (slot, row) in panel.iter_mut().zip(rows.chunks_exact(n_columns)) {
                slot[..width].copy_from_slice(&row[first..first + width]);
                slot[width..].fill(0.0);
            }
        }
    }

    /// Returns the inner dimension.
    pub fn depth(&self) -> usize {
        self.depth
    }

    /// Returns the number of columns.
    pub fn n_columns(&self) -> usize {
        self.n_columns
    }

    /// Computes `activation(start + A·B)`, each row of it by itself.
    ///
    /// # Shapes
    ///
    /// `a`: `[m, depth]`; `start`: `[n_columns]`, or empty for zeros; `out`: `[m, n_columns]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn multiply(&self, a: &[f32], start: &[f32], activation: Activation, out: &mut [f32]) {
        let m = out.len().checked_div(self.n_columns).unwrap_or(0);
        assert_eq!(out.len(), m * self.n_columns, "`out` must be [m, {}]", self.n_columns);
        assert_eq!(a.len(), m * self.depth, "`a` must be [{m}, {}]", self.depth);
        assert!(start.is_empty() || start.len() == self.n_columns, "`start` must be [n_columns]");
        Arch::new().dispatch(Multiply { panels: self, a, start, activation, out });
    }
}

/// Returns the columns of a full panel, or `None` where there are fewer.
fn whole_panel(columns: &[f32], depth: usize) -> Option<[&[f32]; PANEL]> {
    let whole = depth > 0 && columns.len() == PANEL * depth;
    whole.then(|| std::array::from_fn(|c| &columns[c * depth..][..depth]))
}

/// Adds `Aᵀ·B` to `out`: the sum over rows of the outer products of A's and B's rows, in the order of the rows.
///
/// # Shapes
///
/// `a`: `[depth, m]`; `b`: `[depth, n]`; `out`: `[m, n]`.
///
/// # Panics
///
/// If the shapes do not hold.
pub fn add_outer_products(a: &[f32], b: &[f32], m: usize, n: usize, out: &mut [f32]) {
    assert_eq!(out.len(), m * n, "`out` must be [m, n]");
    assert_eq!(a.len() * n, b.len() * m, "`a` and `b` must have the same number of rows");
    if m == 0 || n == 0 {
        return;
    }
    let mut panels = Panels::default();
    for (a, b) in a.chunks(DEPTH * m).zip(b.chunks(DEPTH * n)) {
        panels.pack_rows(b, a.len() / m, n);
        Arch::new().dispatch(Outer { panels: &panels, a, m, out: &mut *out });
    }
}

struct Multiply<'a> {
    panels: &'a Panels,
    a: &'a [f32],
    start: &'a [f32],
    activation: Activation,
    out: &'a mut [f32],
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F32_LANES {
            16 => self.run::<S, 1>(simd),
            8 => self.run::<S, 2>(simd),
            4 => self.run::<S, 4>(simd),
            _ => self.run::<S, PANEL>(simd),
        }
    }
}

impl Multiply<'_> {
    #[inline(always)]
    fn run<S: Simd, const V: usize>(mut self, simd: S) {
        let (depth, n) = (self.panels.depth, self.panels.n_columns);
        let activation = self.activation;
        for first in (0..n).step_by(PANEL) {
            let panel = &self.panels.data[first / PANEL * depth..][..depth];
            let width = PANEL.min(n - first);
            let mut start = [0.0; PANEL];
            if !self.start.is_empty() {
                start[..width].copy_from_slice(&self.start[first..first + width]);
            }
            let start = load::<S, V>(&start);
            let m = self.out.len() / n;
            let part = PanelPart { panel, start, first, activation };
            let mut row = 0;
            while V == 1 && row + WIDE_ROWS <= m {
                self.tile::<S, V, WIDE_ROWS>(simd, &part, row);
                row += WIDE_ROWS;
            }
            while row + ROWS <= m {
                self.tile::<S, V, ROWS>(simd, &part, row);
                row += ROWS;
            }
            while row < m {
                row += match m - row {
                    1 => self.tile::<S, V, 1>(simd, &part, row),
                    2 => self.tile::<S, V, 2>(simd, &part, row),
                    3 => self.tile::<S, V, 3>(simd, &part, row),
                    _ => self.tile::<S, V, 4>(simd, &part, row),
                };
            }
        }
    }

    /// Computes R rows of one panel and returns R.
    #[inline(always)]
    fn tile<S: Simd, const V: usize, const R: usize>(
        &mut self,
        simd: S,
        part: &PanelPart<'_, [S::f32s; V]>,
        row: usize,
    ) -> usize {
        let depth = part.panel.len();
        let rows: [&[f32]; R] = std::array::from_fn(|r| &self.a[(row + r) * depth..][..depth]);
        let mut sums = [part.start; R];
        for (k, b) in part.panel.iter().enumerate() {
            let b = load::<S, V>(b);
            for r in 0..R {
                let a = simd.splat_f32s(rows[r][k]);
                for v in 0..V {
                    sums[r][v] = simd.mul_add_f32s(a, b[v], sums[r][v]);
                }
            }
        }
        let n = self.panels.n_columns;
        for (r, sums) in sums.iter_mut().enumerate() {
            for sum in &mut *sums {
                *sum = match part.activation {
                    Activation::Linear => *sum,
                    Activation::Tanh => tanh_vector(simd, *sum),
                    Activation::Relu => simd.max_f32s(*sum, simd.splat_f32s(0.0)),
                };
            }
            let start = (row + r) * n + part.first;
            let width = PANEL.min(n - part.first);
            store::<S, V>(*sums, &mut self.out[start..start + width]);
        }
        R
    }
}

/// One panel's share of a product.
struct PanelPart<'a, T> {
    panel: &'a [[f32; PANEL]],
    start: T,
    /// The panel's first column.
    first: usize,
    activation: Activation,
}

struct Outer<'a> {
    panels: &'a Panels,
    /// `[depth, m]`
    a: &'a [f32],
    m: usize,
    out: &'a mut [f32],
}

impl WithSimd for Outer<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F32_LANES {
            16 => self.run::<S, 1>(simd),
            8 => self.run::<S, 2>(simd),
            4 => self.run::<S, 4>(simd),
            _ => self.run::<S, PANEL>(simd),
        }
    }
}

impl Outer<'_> {
    #[inline(always)]
    fn run<S: Simd, const V: usize>(mut self, simd: S) {
        for first in (0..self.panels.n_columns).step_by(PANEL) {
            let mut row = 0;
            while V == 1 && row + WIDE_ROWS <= self.m {
                self.tile::<S, V, WIDE_ROWS>(simd, row, first);
                row += WIDE_ROWS;
            }
            while row + ROWS <= self.m {
                self.tile::<S, V, ROWS>(simd, row, first);
                row += ROWS;
            }
            while row + 2 <= self.m {
                self.tile::<S, V, 2>(simd, row, first);
                row += 2;
            }
            while row < self.m {
                self.tile::<S, V, 1>(simd, row, first);
                row += 1;
            }
        }
    }

    #[inline(always)]
    fn tile<S: Simd, const V: usize, const R: usize>(&mut self, simd: S, row: usize, first: usize) {
        let (depth, n) = (self.panels.depth, self.panels.n_columns);
        let panel = &self.panels.data[first / PANEL * depth..][..depth];
        let width = PANEL.min(n - first);
        let mut sums: [[S::f32s; V]; R] = std::array::from_fn(|r| {
            let mut start = [0.0; PANEL];
            start[..width].copy_from_slice(&self.out[(row + r) * n + first..][..width]);
            load::<S, V>(&start)
        });
        for (b, a) in panel.iter().zip(self.a.chunks_exact(self.m)) {
            let b = load::<S, V>(b);
            let a = &a[row..row + R];
            for r in 0..R {
                let a = simd.splat_f32s(a[r]);
                for v in 0..V {
                    sums[r][v] = simd.mul_add_f32s(a, b[v], sums[r][v]);
                }
            }
        }
        for (r, sums) in sums.iter().enumerate() {
            store::<S, V>(*sums, &mut self.out[(row + r) * n + first..][..width]);
        }
    }
}

/// Reads one row of a panel.
#[inline(always)]
fn load<S: Simd, const V: usize>(row: &[f32; PANEL]) -> [S::f32s; V] {
    let (vectors, _) = S::as_simd_f32s(row.as_slice());
    std::array::from_fn(|v| vectors[v])
}

/// Writes as many columns as `out` has room for.
#[inline(always)]
fn store<S: Simd, const V: usize>(vectors: [S::f32s; V], out: &mut [f32]) {
    if out.len() == PANEL {
        let (slots, _) = S::as_mut_simd_f32s(out);
        slots[..V].copy_from_slice(&vectors);
        return;
    }
    let mut row = [0.0; PANEL];
    let (slots, _) = S::as_mut_simd_f32s(row.as_mut_slice());
    slots[..V].copy_from_slice(&vectors);
    out.copy_from_slice(&row[..out.len()]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pcg64;

    fn draws(n: usize, seed: u64) -> Vec<f32> {
        let mut generator = Pcg64::seed_from_u64(seed);
        (0..n).map(|_| generator.uniform(-1.0, 1.0) as f32).collect()
    }

    /// The definition: one chain of fused multiply-adds per element, in the order of the inner index.
    fn by_definition(
        a: &[f32],
        b: &[f32],
        start: &[f32],
        m: usize,
        k: usize,
        n: usize,
    ) -> Vec<f32> {
        let element = |i: usize, j: usize| {
            let first = start.get(j).copied().unwrap_or(0.0);
            (0..k).fold(first, |sum, l| a[i * k + l].mul_add(b[l * n + j], sum))
        };
        (0..m * n).map(|index| element(index / n, index % n)).collect()
    }

    #[test]
    fn the_product_is_the_definition_bit_for_bit() {
        for (m, k, n) in [(1, 1, 1), (7, 60, 64), (13, 64, 14), (64, 5, 33), (6, 0, 3)] {
            let (a, b, start) = (draws(m * k, 1), draws(k * n, 2), draws(n, 3));
            let mut out = vec![f32::NAN; m * n];
            Panels::from_rows(&b, k, n).multiply(&a, &start, Activation::Linear, &mut out);
            assert_eq!(out, by_definition(&a, &b, &start, m, k, n), "{m} {k} {n}");
        }
    }

    #[test]
    fn packing_columns_is_packing_the_transpose() {
        let (k, n) = (5, 19);
        let rows = draws(k * n, 4);
        let columns: Vec<f32> = (0..n * k).map(|i| rows[i % k * n + i / k]).collect();
        let (by_rows, by_columns) =
            (Panels::from_rows(&rows, k, n), Panels::from_columns(&columns, n, k));
        assert_eq!(by_rows.data, by_columns.data);
    }

    #[test]
    fn outer_products_are_summed_in_the_order_of_rows() {
        for (depth, m, n) in [(1, 1, 1), (300, 14, 60), (600, 7, 17), (0, 2, 2)] {
            let (a, b) = (draws(depth * m, 5), draws(depth * n, 6));
            let transposed: Vec<f32> =
                (0..m * depth).map(|i| a[i % depth.max(1) * m + i / depth.max(1)]).collect();
            let mut out = vec![0.0; m * n];
            add_outer_products(&a, &b, m, n, &mut out);
            assert_eq!(out, by_definition(&transposed, &b, &[], m, depth, n), "{depth} {m} {n}");
        }
    }
}
