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
//! A matrix by panels can also be the left operand and the result: then a layer's output is the next layer's input as
//! it is, and the right operand of the outer products that are the gradient.
//!
//! # Where to start
//!
//! [`Panels`] holds B; [`Panels::multiply`] is the product with `A`, [`add_outer_products`] the one with `Aᵀ`.
//! [`Panels::multiply_panels`] and [`Panels::add_outer_products`] are the same of operands by panels, and
//! [`RowPairs`] says which rows are taken where they lie in several matrices.

#![expect(
    clippy::inline_always,
    reason = "kernels must be compiled inside the dispatched target features"
)]
#![expect(
    clippy::needless_range_loop,
    reason = "arrays of registers are unrolled where they are indexed: iterators over them cost a tenth"
)]

use pulp::{Arch, Simd, WithSimd};

use crate::elementary::tanh_vector;

/// Columns per panel: one AVX-512 vector, two of AVX2, four of NEON.
pub const PANEL: usize = 16;
/// Rows per tile: with two AVX2 vectors per panel, twelve of the sixteen registers accumulate.
const ROWS: usize = 6;
/// Rows per tile of one panel where one vector is a panel: as many chains as keep both multipliers busy.
const WIDE_ROWS: usize = 2 * ROWS;
/// Rows per tile of two panels: every number of A that is read is multiplied twice.
const PAIR_ROWS: usize = 8;
/// Inner indices per pass of [`add_outer_products`]: what one pass reads stays in the first-level cache. Not a power of
/// two, with which the panels of a row would share a cache set.
const DEPTH: usize = 248;

/// What happens to an output before it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// The output is stored as it is.
    Linear,
    /// The hyperbolic tangent ([`crate::elementary`]).
    Tanh,
    /// Zero where it is negative.
    Relu,
}

impl Activation {
    /// Turns slopes in outputs `y` into slopes in what was before the activation: `dy (1 - y²)` behind a tanh, `dy` where
    /// y > 0 behind a rectifier.
    ///
    /// # Shapes
    ///
    /// `y`, `slopes`: `[N]`.
    pub fn backward(self, y: &[f32], slopes: &mut [f32]) {
        Arch::new().dispatch(
            #[inline(always)]
            || {
                let rows = slopes.iter_mut().zip(y);
                match self {
                    Self::Linear => {}
                    Self::Tanh => rows.for_each(|(d, y)| *d *= 1.0 - y * y),
                    Self::Relu => rows.for_each(|(d, y)| *d = if *y <= 0.0 { 0.0 } else { *d }),
                }
            },
        );
    }
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
        let mut panels = Self::default();
        panels.pack_columns(columns, n_columns, depth);
        panels
    }

    /// Packs a matrix given by columns into the memory of this one; see [`Panels::from_columns`].
    ///
    /// # Panics
    ///
    /// If the length is another.
    pub fn pack_columns(&mut self, columns: &[f32], n_columns: usize, depth: usize) {
        assert_eq!(columns.len(), n_columns * depth, "`columns` must be [n_columns, depth]");
        self.resize(depth, n_columns);
        self.data.fill([0.0; PANEL]);
        for (c, column) in columns.chunks_exact(depth.max(1)).enumerate() {
            let panel = &mut self.data[c / PANEL * depth..][..depth];
            panel.iter_mut().zip(column).for_each(|(row, x)| row[c % PANEL] = *x);
        }
    }

    /// Packs a matrix given by rows into the memory of this one; see [`Panels::from_rows`].
    ///
    /// # Panics
    ///
    /// If the length is another.
    pub fn pack_rows(&mut self, rows: &[f32], depth: usize, n_columns: usize) {
        assert_eq!(rows.len(), depth * n_columns, "`rows` must be [depth, n_columns]");
        self.resize(depth, n_columns);
        for (k, row) in rows.chunks_exact(n_columns.max(1)).enumerate() {
            self.set_row(k, row);
        }
    }

    /// Gives it another shape and keeps its memory; every row must be set then, or be a product's result.
    pub fn resize(&mut self, depth: usize, n_columns: usize) {
        self.depth = depth;
        self.n_columns = n_columns;
        self.data.resize(n_columns.div_ceil(PANEL) * depth, [0.0; PANEL]);
    }

    /// Writes one row.
    ///
    /// # Shapes
    ///
    /// `row`: `[n_columns]`.
    ///
    /// # Panics
    ///
    /// If there is no such row, or its length is another.
    #[inline]
    pub fn set_row(&mut self, k: usize, row: &[f32]) {
        assert!(k < self.depth && row.len() == self.n_columns, "`row` must be [n_columns]");
        let (whole, rest) = row.as_chunks::<PANEL>();
        for (p, part) in whole.iter().enumerate() {
            self.data[p * self.depth + k] = *part;
        }
        if !rest.is_empty() {
            let mut last = [0.0; PANEL];
            last.iter_mut().zip(rest).for_each(|(slot, x)| *slot = *x);
            self.data[whole.len() * self.depth + k] = last;
        }
    }

    /// Becomes rows of other matrices, one behind the other, of each the columns from panel `first` on.
    ///
    /// # Panics
    ///
    /// If a matrix has no such row, or not so many columns.
    pub fn gather<'a>(
        &mut self,
        rows: impl ExactSizeIterator<Item = (&'a Self, usize)>,
        first: usize,
        n_columns: usize,
    ) {
        self.resize(rows.len(), n_columns);
        let depth = self.depth;
        for (k, (matrix, row)) in rows.enumerate() {
            assert!(row < matrix.depth && first * PANEL + n_columns <= matrix.n_columns);
            for p in 0..n_columns.div_ceil(PANEL) {
                self.data[p * depth + k] = matrix.data[(first + p) * matrix.depth + row];
            }
        }
    }

    /// Copies one row out.
    ///
    /// # Shapes
    ///
    /// `row`: `[n_columns]`.
    ///
    /// # Panics
    ///
    /// If there is no such row, or its length is another.
    #[inline]
    pub fn copy_row(&self, k: usize, row: &mut [f32]) {
        assert!(k < self.depth && row.len() == self.n_columns, "`row` must be [n_columns]");
        let (whole, rest) = row.as_chunks_mut::<PANEL>();
        for (p, part) in whole.iter_mut().enumerate() {
            *part = self.data[p * self.depth + k];
        }
        if !rest.is_empty() {
            let last = &self.data[whole.len() * self.depth + k];
            rest.iter_mut().zip(last).for_each(|(slot, x)| *slot = *x);
        }
    }

    /// Returns all panels, one behind the other: `[panel][depth][PANEL]`, zeros behind the last column.
    pub fn data(&self) -> &[[f32; PANEL]] {
        &self.data
    }

    /// Returns one panel's rows.
    #[inline(always)]
    fn panel(&self, panel: usize) -> &[[f32; PANEL]] {
        &self.data[panel * self.depth..][..self.depth]
    }

    /// Returns all panels to be changed; what is behind the last column must stay zero.
    pub fn data_mut(&mut self) -> &mut [[f32; PANEL]] {
        &mut self.data
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
        self.check_start(start);
        let a = LeftRows { data: a, panel_step: PANEL, row_step: self.depth };
        let out =
            OutRows { data: out, panel_step: PANEL, row_step: self.n_columns, is_padded: false };
        Arch::new().dispatch(ByPanel(Multiply { panels: self, a, m, start, activation, out }));
    }

    /// Computes what [`Panels::multiply`] computes, of a left operand by panels to a result by panels.
    ///
    /// # Shapes
    ///
    /// `a`: `[m, depth]`; `start`: `[n_columns]`, or empty for zeros; `out`: becomes `[m, n_columns]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn multiply_panels(&self, a: &Self, start: &[f32], activation: Activation, out: &mut Self) {
        let m = a.depth;
        assert_eq!(a.n_columns, self.depth, "`a` must be [{m}, {}]", self.depth);
        self.check_start(start);
        out.resize(m, self.n_columns);
        let a = LeftRows { data: a.data.as_flattened(), panel_step: m * PANEL, row_step: PANEL };
        let data = out.data.as_flattened_mut();
        let out = OutRows { data, panel_step: m * PANEL, row_step: PANEL, is_padded: true };
        Arch::new().dispatch(ByPanel(Multiply { panels: self, a, m, start, activation, out }));
    }

    /// Computes what [`Panels::multiply`] computes without an activation, of a left operand by panels.
    ///
    /// # Shapes
    ///
    /// `a`: `[m, depth]`; `start`: `[n_columns]`, or empty for zeros; `out`: `[m, n_columns]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn multiply_to_rows(&self, a: &Self, start: &[f32], out: &mut [f32]) {
        let activation = Activation::Linear;
        let m = a.depth;
        assert_eq!(a.n_columns, self.depth, "`a` must be [{m}, {}]", self.depth);
        assert_eq!(out.len(), m * self.n_columns, "`out` must be [{m}, {}]", self.n_columns);
        self.check_start(start);
        let a = LeftRows { data: a.data.as_flattened(), panel_step: m * PANEL, row_step: PANEL };
        let out =
            OutRows { data: out, panel_step: PANEL, row_step: self.n_columns, is_padded: false };
        Arch::new().dispatch(ByPanel(Multiply { panels: self, a, m, start, activation, out }));
    }

    fn check_start(&self, start: &[f32]) {
        assert!(start.is_empty() || start.len() == self.n_columns, "`start` must be [n_columns]");
    }

    /// Adds all rows to `sums`, in their order.
    ///
    /// # Shapes
    ///
    /// `sums`: `[n_columns]`.
    ///
    /// # Panics
    ///
    /// If the length is another.
    pub fn add_rows(&self, sums: &mut [f32]) {
        assert_eq!(sums.len(), self.n_columns, "`sums` must be [n_columns]");
        add_left_rows(&[RowPairs { left: self, right: self, first: 0, len: self.depth }], 0, sums);
    }

    /// Adds to `out` the rows of `Aᵀ·B` that belong to one panel of A, where B is this matrix: [`add_outer_products`]
    /// of operands by panels.
    ///
    /// # Shapes
    ///
    /// B: `[depth, n]`; `a`: `[depth, m]`; `out`: `[columns of A's panel, n]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn add_outer_products(&self, a: &Self, panel: usize, out: &mut [f32]) {
        assert_eq!(a.depth, self.depth, "`a` and B must have the same number of rows");
        add_row_products(
            &[RowPairs { left: a, right: self, first: 0, len: self.depth }],
            panel,
            out,
        );
    }
}

/// Some rows of two matrices A and B, whose outer products are wanted.
#[derive(Clone, Copy, Debug)]
pub struct RowPairs<'a> {
    /// The matrix A: the sum has a row for each of its columns.
    pub left: &'a Panels,
    /// The matrix B: the sum has a column for each of its columns.
    pub right: &'a Panels,
    /// The first of the rows, in A as in B.
    pub first: usize,
    /// How many rows are taken from there on.
    pub len: usize,
}

/// Adds to `out` the outer products of rows, wherever they lie, in their order, as far as they belong to one panel of A.
///
/// # Shapes
///
/// Each A: `[_, m]`; each B: `[_, n]`; `out`: `[columns of A's panel, n]`.
///
/// # Panics
///
/// If the shapes do not hold, or a matrix has no such rows.
pub fn add_row_products(rows: &[RowPairs<'_>], panel: usize, out: &mut [f32]) {
    let Some(RowPairs { left, right, .. }) = rows.first() else { return };
    let (n, m) = (right.n_columns, PANEL.min(left.n_columns - panel * PANEL));
    assert_eq!(out.len(), m * n, "`out` must be [{m}, {n}]");
    let is_alike =
        |pairs: &RowPairs<'_>| pairs.left.n_columns == left.n_columns && pairs.right.n_columns == n;
    assert!(rows.iter().all(is_alike), "all rows must be of one length");
    Arch::new().dispatch(ByPanel(Outer { rows, panel, m, n, out }));
}

/// Adds rows of the left matrices to `sums`, in their order: the columns from panel `first` on.
///
/// # Shapes
///
/// Each A: `[_, m]`; `sums`: at most the m - 16 `first` columns from there on, in whole panels but for the last.
///
/// # Panics
///
/// If the shapes do not hold, or a matrix has no such rows.
pub fn add_left_rows(rows: &[RowPairs<'_>], first: usize, sums: &mut [f32]) {
    let has_columns = |pairs: &RowPairs<'_>| first * PANEL + sums.len() <= pairs.left.n_columns;
    assert!(rows.iter().all(has_columns), "`sums` must be columns of all rows");
    Arch::new().dispatch(ByPanel(RowSums { rows, first, sums }));
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
    // Both by panels: what one pass reads of a row of A would otherwise lie far from what it reads of the next.
    let (mut left, mut right) = (Panels::default(), Panels::default());
    for (a, b) in a.chunks(DEPTH * m).zip(b.chunks(DEPTH * n)) {
        left.pack_rows(a, a.len() / m, m);
        right.pack_rows(b, a.len() / m, n);
        for (panel, out) in out.chunks_mut(PANEL * n).enumerate() {
            right.add_outer_products(&left, panel, out);
        }
    }
}

/// A kernel over the panels of its right operand, V vectors each.
trait PanelKernel {
    fn n_panels(&self) -> usize;

    /// Computes P panels at once, from panel `first` on.
    fn panels<S: Simd, const V: usize, const P: usize>(&mut self, simd: S, first: usize);
}

/// A kernel, to be run with the widest vectors that there are.
struct ByPanel<K>(K);

impl<K: PanelKernel> WithSimd for ByPanel<K> {
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

impl<K: PanelKernel> ByPanel<K> {
    /// Takes panels in pairs where a panel is one vector: only then there are registers for two.
    #[inline(always)]
    fn run<S: Simd, const V: usize>(mut self, simd: S) {
        let n_panels = self.0.n_panels();
        let mut panel = 0;
        while V == 1 && panel + 2 <= n_panels {
            self.0.panels::<S, V, 2>(simd, panel);
            panel += 2;
        }
        while panel < n_panels {
            self.0.panels::<S, V, 1>(simd, panel);
            panel += 1;
        }
    }
}

/// The left operand, by rows or by panels: where its numbers lie.
#[derive(Clone, Copy)]
struct LeftRows<'a> {
    data: &'a [f32],
    /// From one group of [`PANEL`] columns to the next.
    panel_step: usize,
    row_step: usize,
}

/// The result, by rows or by panels.
struct OutRows<'a> {
    data: &'a mut [f32],
    panel_step: usize,
    row_step: usize,
    /// Whether there is room for whole panels.
    is_padded: bool,
}

struct Multiply<'a> {
    panels: &'a Panels,
    a: LeftRows<'a>,
    /// Number of rows of A.
    m: usize,
    start: &'a [f32],
    activation: Activation,
    out: OutRows<'a>,
}

impl PanelKernel for Multiply<'_> {
    fn n_panels(&self) -> usize {
        self.panels.n_columns.div_ceil(PANEL)
    }

    #[inline(always)]
    fn panels<S: Simd, const V: usize, const P: usize>(&mut self, simd: S, first: usize) {
        let start = std::array::from_fn(|p| {
            let mut start = [0.0; PANEL];
            if !self.start.is_empty() {
                let columns = self.start.chunks(PANEL).nth(first + p).unwrap_or_default();
                start[..columns.len()].copy_from_slice(columns);
            }
            load::<S, V>(&start)
        });
        let (m, mut row) = (self.m, 0);
        // A rest of one or two rows has too few chains for the multipliers: six and a few are better.
        while P == 2 && row + PAIR_ROWS <= m && !matches!(m - row, 9 | 10) {
            row += self.tile::<S, V, P, PAIR_ROWS>(simd, &start, first, row);
        }
        while V == 1 && P == 1 && row + WIDE_ROWS <= m {
            row += self.tile::<S, V, P, WIDE_ROWS>(simd, &start, first, row);
        }
        while row + ROWS <= m {
            row += self.tile::<S, V, P, ROWS>(simd, &start, first, row);
        }
        while row < m {
            row += match m - row {
                1 => self.tile::<S, V, P, 1>(simd, &start, first, row),
                2 => self.tile::<S, V, P, 2>(simd, &start, first, row),
                3 => self.tile::<S, V, P, 3>(simd, &start, first, row),
                _ => self.tile::<S, V, P, 4>(simd, &start, first, row),
            };
        }
    }
}

impl Multiply<'_> {
    /// Computes R rows of P panels and returns R.
    #[inline(always)]
    fn tile<S: Simd, const V: usize, const P: usize, const R: usize>(
        &mut self,
        simd: S,
        start: &[[S::f32s; V]; P],
        first: usize,
        row: usize,
    ) -> usize {
        let depth = self.panels.depth;
        let LeftRows { data: a, panel_step, row_step } = self.a;
        let zero = simd.splat_f32s(0.0);
        let mut sums = [*start; R];
        for (part, k) in (0..depth).step_by(PANEL).enumerate() {
            let n = PANEL.min(depth - k);
            let rows: [&[f32]; R] =
                std::array::from_fn(|r| &a[part * panel_step + (row + r) * row_step..][..n]);
            let panels: [&[[f32; PANEL]]; P] =
                std::array::from_fn(|p| &self.panels.data[(first + p) * depth + k..][..n]);
            for k in 0..n {
                let mut b = [[zero; V]; P];
                for p in 0..P {
                    b[p] = load::<S, V>(&panels[p][k]);
                }
                for r in 0..R {
                    multiply_add(simd, rows[r][k], &b, &mut sums[r]);
                }
            }
        }
        for (r, sums) in sums.iter_mut().enumerate() {
            for (p, sums) in sums.iter_mut().enumerate() {
                for sum in &mut *sums {
                    *sum = match self.activation {
                        Activation::Linear => *sum,
                        Activation::Tanh => tanh_vector(simd, *sum),
                        Activation::Relu => simd.max_f32s(*sum, zero),
                    };
                }
                let OutRows { panel_step, row_step, is_padded, .. } = self.out;
                let n_left = self.panels.n_columns - (first + p) * PANEL;
                let width = if is_padded { PANEL } else { PANEL.min(n_left) };
                let start = (first + p) * panel_step + (row + r) * row_step;
                store::<S, V>(*sums, &mut self.out.data[start..start + width]);
            }
        }
        R
    }
}

struct RowSums<'a> {
    rows: &'a [RowPairs<'a>],
    /// The panel whose sums stand first in `sums`.
    first: usize,
    sums: &'a mut [f32],
}

impl PanelKernel for RowSums<'_> {
    fn n_panels(&self) -> usize {
        self.sums.len().div_ceil(PANEL)
    }

    #[inline(always)]
    fn panels<S: Simd, const V: usize, const P: usize>(&mut self, simd: S, first: usize) {
        let mut sums = [[simd.splat_f32s(0.0); V]; P];
        for (sums, own) in sums.iter_mut().zip(self.sums.chunks(PANEL).skip(first)) {
            let mut start = [0.0; PANEL];
            start[..own.len()].copy_from_slice(own);
            *sums = load::<S, V>(&start);
        }
        for &RowPairs { left, first: row, len, .. } in self.rows {
            let panels: [&[[f32; PANEL]]; P] =
                std::array::from_fn(|p| &left.panel(self.first + first + p)[row..row + len]);
            for k in 0..len {
                for p in 0..P {
                    add(simd, load::<S, V>(&panels[p][k]), &mut sums[p]);
                }
            }
        }
        for (sums, own) in sums.iter().zip(self.sums.chunks_mut(PANEL).skip(first)) {
            store::<S, V>(*sums, own);
        }
    }
}

struct Outer<'a> {
    rows: &'a [RowPairs<'a>],
    /// The panel of A.
    panel: usize,
    /// Columns of it that count.
    m: usize,
    /// Columns of B.
    n: usize,
    out: &'a mut [f32],
}

impl PanelKernel for Outer<'_> {
    fn n_panels(&self) -> usize {
        self.n.div_ceil(PANEL)
    }

    #[inline(always)]
    fn panels<S: Simd, const V: usize, const P: usize>(&mut self, simd: S, first: usize) {
        let (m, mut row) = (self.m, 0);
        while P == 2 && row + PAIR_ROWS <= m {
            row += self.tile::<S, V, P, PAIR_ROWS>(simd, first, row);
        }
        while V == 1 && P == 1 && row + WIDE_ROWS <= m {
            row += self.tile::<S, V, P, WIDE_ROWS>(simd, first, row);
        }
        while row + ROWS <= m {
            row += self.tile::<S, V, P, ROWS>(simd, first, row);
        }
        while row + 2 <= m {
            row += self.tile::<S, V, P, 2>(simd, first, row);
        }
        while row < m {
            row += self.tile::<S, V, P, 1>(simd, first, row);
        }
    }
}

impl Outer<'_> {
    /// Adds to R rows of P panels and returns R.
    #[inline(always)]
    fn tile<S: Simd, const V: usize, const P: usize, const R: usize>(
        &mut self,
        simd: S,
        first: usize,
        row: usize,
    ) -> usize {
        let n = self.n;
        let zero = simd.splat_f32s(0.0);
        let mut sums = [[[zero; V]; P]; R];
        for r in 0..R {
            for p in 0..P {
                let mut start = [0.0; PANEL];
                let first = (first + p) * PANEL;
                let columns = &self.out[(row + r) * n..][first..n.min(first + PANEL)];
                start[..columns.len()].copy_from_slice(columns);
                sums[r][p] = load::<S, V>(&start);
            }
        }
        for &RowPairs { left, right, first: from, len } in self.rows {
            let left = &left.panel(self.panel)[from..from + len];
            let panels: [&[[f32; PANEL]]; P] =
                std::array::from_fn(|p| &right.panel(first + p)[from..from + len]);
            for (k, a) in left.iter().enumerate() {
                let a = &a[row..row + R];
                let mut b = [[zero; V]; P];
                for p in 0..P {
                    b[p] = load::<S, V>(&panels[p][k]);
                }
                for r in 0..R {
                    multiply_add(simd, a[r], &b, &mut sums[r]);
                }
            }
        }
        for r in 0..R {
            for p in 0..P {
                let first = (first + p) * PANEL;
                let columns = &mut self.out[(row + r) * n..][first..n.min(first + PANEL)];
                store::<S, V>(sums[r][p], columns);
            }
        }
        R
    }
}

/// Adds a row of a panel to sums.
#[inline(always)]
fn add<S: Simd, const V: usize>(simd: S, row: [S::f32s; V], sums: &mut [S::f32s; V]) {
    for v in 0..V {
        sums[v] = simd.add_f32s(sums[v], row[v]);
    }
}

/// Adds a number times one row of P panels to the sums.
#[inline(always)]
fn multiply_add<S: Simd, const V: usize, const P: usize>(
    simd: S,
    a: f32,
    b: &[[S::f32s; V]; P],
    sums: &mut [[S::f32s; V]; P],
) {
    let a = simd.splat_f32s(a);
    for p in 0..P {
        for v in 0..V {
            sums[p][v] = simd.mul_add_f32s(a, b[p][v], sums[p][v]);
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

    /// Runs a product and outer products with one kind of vectors.
    fn with_vectors<S: Simd>(simd: S) -> [Vec<f32>; 3] {
        let (m, k, n) = (29, 37, 50);
        let (a, b) = (draws(m * k, 1), Panels::from_rows(&draws(k * n, 2), k, n));
        let mut out = vec![0.0; m * n];
        let left = LeftRows { data: &a, panel_step: PANEL, row_step: k };
        let rows = OutRows { data: &mut out, panel_step: PANEL, row_step: n, is_padded: false };
        let activation = Activation::Tanh;
        let product = Multiply { panels: &b, a: left, m, start: &[], activation, out: rows };
        simd.vectorize(ByPanel(product));
        let slopes = Panels::from_rows(&draws(k * 11, 3), k, 11);
        let mut gradient = draws(11 * n, 4);
        let rows = [RowPairs { left: &slopes, right: &b, first: 0, len: k }];
        let products = Outer { rows: &rows, panel: 0, m: 11, n, out: &mut gradient };
        simd.vectorize(ByPanel(products));
        let mut sums = draws(n, 5);
        let rows = [RowPairs { left: &b, right: &b, first: 0, len: k }];
        simd.vectorize(ByPanel(RowSums { rows: &rows, first: 0, sums: &mut sums }));
        [out, gradient, sums]
    }

    #[test]
    fn vectors_of_every_width_give_the_same_bits() {
        let one_lane = with_vectors(pulp::Scalar::new());
        #[cfg(target_arch = "x86_64")]
        {
            use pulp::x86::{V3, V4};
            let (eight_lanes, sixteen_lanes) = (V3::try_new(), V4::try_new());
            for found in [eight_lanes.map(with_vectors), sixteen_lanes.map(with_vectors)] {
                assert!(found.is_none_or(|found| found == one_lane));
            }
        }
        #[cfg(target_arch = "aarch64")]
        assert_eq!(with_vectors(pulp::aarch64::Neon::try_new().unwrap()), one_lane);
    }

    #[test]
    fn operands_by_panels_give_the_bits_of_operands_by_rows() {
        let (m, k, n) = (19, 37, 50);
        let (a, b) = (draws(m * k, 1), draws(k * n, 2));
        let (weights, start) = (Panels::from_rows(&b, k, n), draws(n, 3));
        let mut by_rows = vec![0.0; m * n];
        weights.multiply(&a, &start, Activation::Tanh, &mut by_rows);
        // Memory of another shape, so that what is left of it would show.
        let mut by_panels = Panels::from_rows(&draws(7 * 90, 4), 7, 90);
        let left = Panels::from_rows(&a, m, k);
        weights.multiply_panels(&left, &start, Activation::Tanh, &mut by_panels);
        let mut row = vec![0.0; n];
        for (i, expected) in by_rows.chunks_exact(n).enumerate() {
            by_panels.copy_row(i, &mut row);
            assert_eq!(row, expected);
        }
        let (mut linear, mut to_rows) = (vec![0.0; m * n], vec![0.0; m * n]);
        weights.multiply(&a, &start, Activation::Linear, &mut linear);
        weights.multiply_to_rows(&left, &start, &mut to_rows);
        assert_eq!(to_rows, linear);
        let mut sums = vec![0.0; n];
        by_panels.add_rows(&mut sums);
        let expected = (0..n).map(|j| by_rows[j..].iter().step_by(n).fold(0.0, |sum, x| sum + x));
        assert_eq!(sums, expected.collect::<Vec<f32>>());
        let (mut products, mut expected) = (vec![0.0; k * n], vec![0.0; k * n]);
        for (panel, out) in products.chunks_mut(PANEL * n).enumerate() {
            by_panels.add_outer_products(&left, panel, out);
        }
        add_outer_products(&a, &by_rows, k, n, &mut expected);
        assert_eq!(products, expected);
    }

    #[test]
    fn rows_may_lie_in_several_matrices() {
        let (m, k, n) = (40, 23, 50);
        let (a, b) = (draws(k * m, 1), draws(k * n, 2));
        let (mut expected, mut sums) = (vec![0.0; m * n], vec![0.0; m]);
        add_outer_products(&a, &b, m, n, &mut expected);
        Panels::from_rows(&a, k, m).add_rows(&mut sums);
        // The first seven rows, none, the next one behind a row that is not wanted, the rest.
        let part = |rows: std::ops::Range<usize>| {
            let cut =
                |x: &[f32], n| Panels::from_rows(&x[rows.start * n..rows.end * n], rows.len(), n);
            (cut(&a, m), cut(&b, n))
        };
        let (parts, wanted) =
            ([part(0..7), part(6..8), part(8..k)], [(0, 7), (0, 0), (1, 1), (0, 15)]);
        let rows: Vec<_> = [0, 0, 1, 2]
            .iter()
            .zip(wanted)
            .map(|(&i, (first, len))| {
                let (left, right): &(Panels, Panels) = &parts[i];
                RowPairs { left, right, first, len }
            })
            .collect();
        let (mut products, mut found) = (vec![0.0; m * n], vec![0.0; m]);
        for (panel, out) in products.chunks_mut(PANEL * n).enumerate() {
            add_row_products(&rows, panel, out);
        }
        let (first, rest) = found.split_at_mut(PANEL);
        add_left_rows(&rows, 0, first);
        add_left_rows(&rows, 1, rest);
        assert_eq!((products, found), (expected, sums));
        let single =
            rows.iter().flat_map(|pairs| (0..pairs.len).map(|k| (pairs.left, pairs.first + k)));
        let single: Vec<_> = single.collect();
        let mut gathered = Panels::from_rows(&draws(90, 3), 9, 10);
        gathered.gather(single.into_iter(), 1, m - PANEL);
        let expected: Vec<f32> = a.chunks_exact(m).flat_map(|row| &row[PANEL..]).copied().collect();
        assert_eq!(gathered.data, Panels::from_rows(&expected, k, m - PANEL).data);
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
