//! Where the tiles of a picture stand: several worlds on one scale, in rows, with room for a caption above each.

use leadtime_sims::Scene;

use super::world_view::WorldView;

/// What a picture of tiles leaves to its maker: lengths in pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct TileStyle {
    /// Of the whole picture.
    pub(super) width: f64,
    /// At its left and right.
    pub(super) margin: f64,
    /// Between tiles, and below the last ones.
    pub(super) gap: f64,
    /// Above the first row: title and legend.
    pub(super) top: f64,
    /// Above every world: its caption.
    pub(super) caption: f64,
}

/// Tiles of one size, side by side and in rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tiles {
    style: TileStyle,
    n_columns: usize,
    /// Of one tile, which is that of its world.
    pub(super) width: f64,
    /// Of one tile with its caption and the gap below.
    height: f64,
}

impl Tiles {
    /// Makes tiles that show worlds on the one scale of everything that is `seen`.
    pub(super) fn new(style: TileStyle, n_columns: usize, seen: &[Scene]) -> Self {
        let n = n_columns.max(1) as f64;
        let width = (style.width - 2.0 * style.margin - (n - 1.0) * style.gap) / n;
        let world = WorldView::new([0.0, 0.0], width, seen);
        let height = style.caption + world.area.height + style.gap;
        Self { style, n_columns: n_columns.max(1), width, height }
    }

    /// Returns the upper left corner of the `i`-th tile, in reading order.
    pub(super) fn corner(&self, i: usize) -> [f64; 2] {
        let (row, column) = (i / self.n_columns, i % self.n_columns);
        let x = self.style.margin + column as f64 * (self.width + self.style.gap);
        [x, self.style.top + row as f64 * self.height]
    }

    /// Returns the height of a picture of `n` tiles.
    pub(super) fn bottom(&self, n: usize) -> f64 {
        self.style.top + n.div_ceil(self.n_columns) as f64 * self.height
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::playthrough::synthetic;

    #[test]
    fn tiles_fill_the_width_row_by_row() {
        let style = TileStyle { width: 100.0, margin: 5.0, gap: 10.0, top: 30.0, caption: 20.0 };
        let tiles = Tiles::new(style, 2, &synthetic::playthrough().scenes);
        assert_eq!(tiles.width, 40.0);
        assert_eq!((tiles.corner(0), tiles.corner(1)), ([5.0, 30.0], [55.0, 30.0]));
        let [x, y] = tiles.corner(2);
        assert!(x == 5.0 && y > 60.0, "{y}");
        assert_eq!(tiles.bottom(2), y);
        assert_eq!((tiles.bottom(3), tiles.bottom(0)), (tiles.bottom(4), 30.0));
    }
}
