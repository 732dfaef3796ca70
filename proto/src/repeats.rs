//! What the observations of a rollout repeat of the one before, and how it is left out of a message.
//!
//! An observation with a history holds the last few frames, and all but one of them were in the observation before:
//!
//! ```text
//! row t - 1     a b c d  u          stride 1, length 3: the overlap
//! row t         b c d e  v          its front b c d is row t - 1 from the stride on, so only e v travels
//! ```
//!
//! Bits are compared and not numbers, so what comes out is what went in. A row that repeats nothing, because an episode
//! has begun, travels whole. A receiver believes nothing: [`RowRepeats::n_sent`] looks whether what is left out can be
//! put back, and the run says how many numbers that makes.

use serde::{Deserialize, Serialize};

use crate::packed;
use crate::refusal::{Refusal, RefusalCause};

/// Where observations may repeat the one before; by default nowhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RowOverlap {
    /// Where in a row that begins which the next one may have at its front, in numbers.
    stride: u32,
    /// How many numbers that is.
    length: u32,
}

impl RowOverlap {
    /// Says that an observation may have at its front `length` numbers of the one before, from the `stride` on.
    pub fn new(stride: usize, length: usize) -> Self {
        let word = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        Self { stride: word(stride), length: word(length) }
    }

    /// Returns stride and length if rows of this width can overlap so.
    fn within(self, width: usize) -> Option<(usize, usize)> {
        let (stride, length) = (self.stride as usize, self.length as usize);
        let fits = stride > 0 && length > 0 && stride.saturating_add(length) <= width;
        fits.then_some((stride, length))
    }
}

/// Which observations of a rollout travel without their front, because the one before has it; by default none does.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RowRepeats {
    overlap: RowOverlap,
    /// A bit for each row, beginning with the lowest of the first word: whether its front is left out.
    #[serde(with = "packed")]
    rows: Vec<u64>,
}

impl RowRepeats {
    /// Returns an upper bound on the encoded size for so many rows, in bytes.
    pub(crate) fn max_bytes(n_rows: usize) -> usize {
        size_of::<RowOverlap>() + 8 * n_rows.div_ceil(64)
    }

    /// Takes out of rows of `width` numbers each what they repeat of the row before.
    pub(crate) fn take_out(numbers: &mut Vec<f32>, width: usize, overlap: RowOverlap) -> Self {
        let Some((stride, length)) = overlap.within(width) else { return Self::default() };
        let n_rows = numbers.len() / width;
        let mut rows = vec![0_u64; n_rows.div_ceil(64)];
        let bits: &[u32] = bytemuck::cast_slice(numbers);
        for row in 1..n_rows {
            let (front, source) = (row * width, (row - 1) * width + stride);
            if bits[front..front + length] == bits[source..source + length] {
                rows[row / 64] |= 1 << (row % 64);
            }
        }
        if rows.iter().all(|word| *word == 0) {
            return Self::default();
        }
        let repeats = Self { overlap, rows };
        // Every row moves to where the one before it ends, which is never beyond its own place.
        let mut end = 0;
        for row in 0..n_rows {
            let start = row * width + repeats.left_out(row);
            numbers.copy_within(start..(row + 1) * width, end);
            end += (row + 1) * width - start;
        }
        numbers.truncate(end);
        repeats
    }

    /// Returns how many numbers travel of `n_rows` rows of `width` numbers each.
    ///
    /// # Errors
    ///
    /// [`Refusal`] without a sender, with the cause [`RefusalCause::Shape`], if rows of this width cannot overlap so, or a
    /// row is named that has none before it.
    pub(crate) fn n_sent(&self, n_rows: usize, width: usize) -> Result<usize, Refusal> {
        if *self == Self::default() {
            return Ok(n_rows * width);
        }
        let refused = |text| Err(Refusal::new(RefusalCause::Shape, text));
        let Some((_, length)) = self.overlap.within(width) else {
            return refused("`repeats` takes numbers from where no observation has them");
        };
        let used = n_rows % 64;
        let beyond = if used == 0 { 0 } else { u64::MAX << used };
        let (Some(first), Some(last)) = (self.rows.first(), self.rows.last()) else {
            return refused("`repeats` names no rows");
        };
        if self.rows.len() != n_rows.div_ceil(64) || first & 1 == 1 || last & beyond != 0 {
            return refused("`repeats` names a row that has none before it");
        }
        let n_repeating: usize = self.rows.iter().map(|word| word.count_ones() as usize).sum();
        Ok(n_rows * width - n_repeating * length)
    }

    /// Puts back what was left out of as many numbers as [`RowRepeats::n_sent`] said.
    pub(crate) fn put_back(&self, sent: Vec<f32>, n_rows: usize, width: usize) -> Vec<f32> {
        if *self == Self::default() {
            return sent;
        }
        let (mut whole, mut rest) = (Vec::with_capacity(n_rows * width), sent.as_slice());
        for row in 0..n_rows {
            let left_out = self.left_out(row);
            if left_out > 0 {
                let source = whole.len() - width + self.overlap.stride as usize;
                whole.extend_from_within(source..source + left_out);
            }
            let (own, after) = rest.split_at(width - left_out);
            whole.extend_from_slice(own);
            rest = after;
        }
        whole
    }

    /// Returns how many numbers are left out of a row.
    fn left_out(&self, row: usize) -> usize {
        let is_left_out = self.rows[row / 64] >> (row % 64) & 1 == 1;
        if is_left_out { self.overlap.length as usize } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 5;

    /// Three frames of one number and two numbers more; an episode begins where it is said.
    fn rows(n: usize, begins: &[usize]) -> Vec<f32> {
        let mut frames = [0.0; 3];
        let row = |t: usize| {
            let newest = t as f32;
            frames = if begins.contains(&t) { [newest; 3] } else { [frames[1], frames[2], newest] };
            [frames[0], frames[1], frames[2], -newest, 0.5]
        };
        (0..n).flat_map(row).collect()
    }

    fn repeats(n: usize, begins: &[usize]) -> (Vec<f32>, RowRepeats) {
        let mut sent = rows(n, begins);
        let repeats = RowRepeats::take_out(&mut sent, WIDTH, RowOverlap::new(1, 2));
        (sent, repeats)
    }

    #[test]
    fn a_frame_travels_once() {
        for (n, begins) in
            [(1, [0].as_slice()), (2, &[0]), (64, &[0, 7, 63]), (65, &[0, 64]), (200, &[0])]
        {
            let (sent, repeats) = repeats(n, begins);
            assert_eq!(sent.len(), n * WIDTH - 2 * (n - begins.len()), "{n}");
            assert_eq!(repeats.n_sent(n, WIDTH).unwrap(), sent.len());
            assert_eq!(repeats.put_back(sent, n, WIDTH), rows(n, begins), "{n}");
        }
        let sent = repeats(3, &[0]).0;
        assert_eq!(sent, [0.0, 0.0, 0.0, -0.0, 0.5, 1.0, -1.0, 0.5, 2.0, -2.0, 0.5]);
    }

    #[test]
    fn equal_numbers_with_other_bits_travel() {
        let mut sent = vec![1.0, 0.0, -0.0, 3.0];
        let repeats = RowRepeats::take_out(&mut sent, 2, RowOverlap::new(1, 1));
        assert_eq!((sent.len(), repeats), (4, RowRepeats::default()));
        let no_number = f32::from_bits(0x7fc0_1234);
        let mut sent = vec![1.0, no_number, no_number, 3.0];
        let repeats = RowRepeats::take_out(&mut sent, 2, RowOverlap::new(1, 1));
        assert_eq!((sent.len(), repeats.n_sent(2, 2).unwrap()), (3, 3));
        assert_eq!(repeats.put_back(sent, 2, 2)[2].to_bits(), no_number.to_bits());
    }

    #[test]
    fn an_overlap_that_no_row_has_leaves_nothing_out() {
        let overlaps = [(0, 0), (0, 2), (1, 0), (1, WIDTH), (WIDTH, 1), (usize::MAX, usize::MAX)];
        for (stride, length) in overlaps {
            let mut sent = rows(4, &[0]);
            let overlap = RowOverlap::new(stride, length);
            assert_eq!(RowRepeats::take_out(&mut sent, WIDTH, overlap), RowRepeats::default());
            assert_eq!(sent, rows(4, &[0]), "{overlap:?}");
            let repeats = RowRepeats { overlap, rows: vec![0b10] };
            assert_eq!(repeats.n_sent(4, WIDTH).unwrap_err().cause, RefusalCause::Shape);
        }
        let none = RowRepeats::take_out(&mut Vec::new(), 0, RowOverlap::new(1, 2));
        assert_eq!(none.n_sent(0, 0).unwrap(), 0);
    }

    #[test]
    fn rows_without_one_before_them_are_refused() {
        let n_sent = |rows: &[u64], n_rows| {
            let overlap = RowOverlap::new(1, 2);
            RowRepeats { overlap, rows: rows.to_vec() }.n_sent(n_rows, WIDTH).ok()
        };
        assert_eq!(n_sent(&[0b1110], 4), Some(4 * WIDTH - 6));
        assert_eq!(n_sent(&[1 << 63], 64), Some(64 * WIDTH - 2));
        for (rows, n_rows) in [
            ([0b1111].as_slice(), 4),
            (&[0b1_1110], 4),
            (&[], 4),
            (&[], 0),
            (&[0b10, 0], 4),
            (&[0b10], 65),
            (&[0b10, 0b10], 65),
            (&[u64::MAX; 1000], 4),
        ] {
            assert_eq!(n_sent(rows, n_rows), None, "{rows:?} of {n_rows}");
        }
    }
}
