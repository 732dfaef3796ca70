//! The kitchens that are part of the program: three public ones, and three of our own with two of every station.

use leadtime_sims::check::{SettingError, require};

use super::grid::Grid;

/// Names and rows of the built-in kitchens. The public ones are those of FOV-aware-planner, with the starts of both
/// cooks. In `ring` no station can be seen from a supply, and its island makes "up or down" a real choice; both
/// stations of a kind lie on one way, though, so that it hardly costs anything to find one of them taken. In `wings`
/// they lie at opposite ends. In `annex` one of each kind is near the supplies and the other at the far end, so that it
/// is dear to walk to the far one when the near one has become free.
pub const LAYOUTS: [(&str, &str); 6] = [
    ("ring", include_str!("layouts/ring.txt")),
    ("wings", include_str!("layouts/wings.txt")),
    ("annex", include_str!("layouts/annex.txt")),
    ("steak_mid_2", include_str!("layouts/steak_mid_2.txt")),
    ("steak_side_2", include_str!("layouts/steak_side_2.txt")),
    ("steak_none_3", include_str!("layouts/steak_none_3.txt")),
];

/// Reads a kitchen, given by a built-in one's name or by its rows, and checks that a dish can come out of it.
///
/// # Errors
///
/// [`SettingError`] about `world.layout`, naming row and column where it can.
pub fn kitchen(layout: &str) -> Result<Grid, SettingError> {
    const KEY: &str = "world.layout";
    let built_in = LAYOUTS.iter().find(|(name, _)| *name == layout).map(|(_, rows)| *rows);
    let names = LAYOUTS.map(|(name, _)| name).join(", ");
    let is_known = built_in.is_some() || layout.trim().contains('\n');
    let allowed = format!("{names}, or the rows of a kitchen");
    require(is_known, KEY, format_args!("{layout:?}"), allowed)?;
    let grid = Grid::parse(built_in.unwrap_or(layout));
    let checked = grid.and_then(|grid| grid.check_kitchen().map(|()| grid));
    checked.map_err(|error| {
        let given = format!("a kitchen in which {error}");
        SettingError { key: KEY, given, allowed: error.allowed.into() }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_kitchen_works() {
        for (name, _) in LAYOUTS {
            kitchen(name).unwrap();
        }
        let ring = kitchen("ring").unwrap();
        assert_eq!((ring.width, ring.height(), ring.floor.len()), (9, 7, 26));
        let mid = kitchen("steak_mid_2").unwrap();
        assert_eq!(mid.person_start, mid.place(3, 3));
    }

    #[test]
    fn a_text_that_is_neither_a_name_nor_a_kitchen_gets_one_sentence() {
        let refused = |layout| kitchen(layout).unwrap_err().to_string();
        assert_eq!(
            refused("rings"),
            "`world.layout` is \"rings\"; allowed: ring, wings, annex, steak_mid_2, \
             steak_side_2, steak_none_3, or the rows of a kitchen"
        );
        assert_eq!(
            refused("XPBWX\nO?1 S\nXMDXX"),
            "`world.layout` is a kitchen in which row 2, column 2 is `?`; allowed: space, X, O, M, \
             D, P, B, W, S and 1 to 9"
        );
    }
}
