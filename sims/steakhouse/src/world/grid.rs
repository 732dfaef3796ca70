//! A kitchen's floor plan, read from rows of characters.
//!
//! | character | tile |
//! |---|---|
//! | space | floor |
//! | `X` | counter, and every wall |
//! | `O` `M` `D` | supply of onions, meat, dirty plates |
//! | `P` `B` `W` | grill, chopping board, sink |
//! | `S` | serving window |
//! | `1` to `9` | floor on which a cook starts |
//!
//! Reading refuses what no kitchen is; [`Grid::check_kitchen`] refuses what no dish can come out of.

use serde::{Deserialize, Serialize};

use super::kinds::{Direction, Item, Station, Tile};
use super::layout_error::LayoutError;

/// The most rows, and the most columns.
pub const MAX_SIDE: usize = 32;
/// The most grills, boards and sinks together.
pub const MAX_STATIONS: usize = 16;

/// A tile of a grid: its index, row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct GridPlace(pub(super) u16);

impl GridPlace {
    /// Returns its index, row by row.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// Where a cook stands and looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pose {
    /// The tile.
    pub place: GridPlace,
    /// The direction of view.
    pub facing: Direction,
}

/// A station and where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// Its tile.
    pub place: GridPlace,
    /// What it is.
    pub station: Station,
}

/// The tiles of a kitchen. Lists of places run row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Grid {
    width: usize,
    tiles: Vec<Tile>,
    starts: Vec<GridPlace>,
    slots: Vec<Slot>,
    /// By tile: which slot it is.
    slot_at: Vec<Option<u8>>,
    /// By supplied item.
    supplies: [Vec<GridPlace>; 3],
    counters: Vec<GridPlace>,
    windows: Vec<GridPlace>,
    floor: Vec<GridPlace>,
}

impl Grid {
    /// Reads a kitchen, of which appliances may be missing.
    ///
    /// # Errors
    ///
    /// [`LayoutError`] naming row and column, from 1.
    pub fn parse(text: &str) -> Result<Self, LayoutError> {
        let rows: Vec<Vec<char>> =
            text.trim_matches(['\n', '\r']).lines().map(|row| row.chars().collect()).collect();
        let width = rows.first().map_or(0, Vec::len);
        let fits = |side: usize| (3..=MAX_SIDE).contains(&side);
        if !fits(rows.len()) || !fits(width) {
            return Err(LayoutError::Size { rows: rows.len(), columns: width });
        }
        let mut tiles = Vec::with_capacity(rows.len() * width);
        let mut starts = [None; 9];
        for (y, row) in rows.iter().enumerate() {
            if row.len() != width {
                let columns = row.len();
                return Err(LayoutError::Ragged { row: y + 1, columns, expected: width });
            }
            for (x, &character) in row.iter().enumerate() {
                let (row, column) = (y + 1, x + 1);
                let (tile, number) = read_tile(character).ok_or(LayoutError::Character {
                    row,
                    column,
                    character,
                })?;
                let is_border = y == 0 || y + 1 == rows.len() || x == 0 || x + 1 == width;
                if is_border && tile == Tile::Floor {
                    return Err(LayoutError::OpenBorder { row, column });
                }
                if let Some(number) = number
                    && starts[number - 1].replace(GridPlace(tiles.len() as u16)).is_some()
                {
                    return Err(LayoutError::RepeatedStart { row, column, number });
                }
                tiles.push(tile);
            }
        }
        let n_starts = 9 - starts.iter().rev().take_while(|start| start.is_none()).count();
        if let Some(gap) = starts[..n_starts].iter().position(Option::is_none) {
            return Err(LayoutError::StartGap { number: gap + 1 });
        }
        Self::of_tiles(width, tiles, starts.into_iter().flatten().collect())
    }

    fn of_tiles(
        width: usize,
        tiles: Vec<Tile>,
        starts: Vec<GridPlace>,
    ) -> Result<Self, LayoutError> {
        let places = |wanted: Tile| -> Vec<GridPlace> {
            let found = (0..tiles.len()).filter(|&index| tiles[index] == wanted);
            found.map(|index| GridPlace(index as u16)).collect()
        };
        let slots: Vec<Slot> = Station::ALL
            .into_iter()
            .flat_map(|station| {
                let found = places(Tile::Station(station)).into_iter();
                found.map(move |place| Slot { place, station })
            })
            .collect();
        if slots.len() > MAX_STATIONS {
            return Err(LayoutError::Stations { n_stations: slots.len() });
        }
        let mut slot_at = vec![None; tiles.len()];
        for (slot, at) in slots.iter().enumerate() {
            slot_at[at.place.index()] = Some(slot as u8);
        }
        Ok(Self {
            width,
            starts,
            slots,
            slot_at,
            supplies: [Item::Onion, Item::Meat, Item::Plate].map(|item| places(Tile::Supply(item))),
            counters: places(Tile::Counter),
            windows: places(Tile::Window),
            floor: places(Tile::Floor),
            tiles,
        })
    }

    /// Checks that a dish can be cooked and served by a cook at the highest start.
    ///
    /// # Errors
    ///
    /// [`LayoutError`] naming what is missing, or what cannot be reached.
    pub fn check_kitchen(&self) -> Result<(), LayoutError> {
        let start = self.person_start().ok_or(LayoutError::NoStart)?;
        for needed in NEEDED {
            if !self.tiles.contains(&needed) {
                return Err(LayoutError::Missing { what: name(needed) });
            }
        }
        let reached = self.reached_from(start);
        for place in self.places() {
            let tile = self.tile(place);
            let matters = tile != Tile::Counter;
            if matters && !reached[place.index()] {
                let [x, y] = self.position(place);
                let what = name(tile);
                return Err(LayoutError::Unreachable { row: y + 1, column: x + 1, what });
            }
        }
        Ok(())
    }

    /// Marks the floor that a cook can get to, and whatever that floor borders on.
    fn reached_from(&self, start: GridPlace) -> Vec<bool> {
        let mut reached = vec![false; self.tiles.len()];
        let mut open = vec![start];
        reached[start.index()] = true;
        while let Some(place) = open.pop() {
            for direction in Direction::ALL {
                let next = self.ahead(Pose { place, facing: direction });
                let is_new = !std::mem::replace(&mut reached[next.index()], true);
                if is_new && self.tile(next) == Tile::Floor {
                    open.push(next);
                }
            }
        }
        reached
    }

    /// Returns the number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the number of rows.
    pub fn height(&self) -> usize {
        self.tiles.len() / self.width
    }

    /// Lists all tiles.
    pub fn places(&self) -> impl Iterator<Item = GridPlace> + use<> {
        (0..self.tiles.len()).map(|index| GridPlace(index as u16))
    }

    /// Returns the tile at column x and row y, both from 0; `None` outside.
    pub fn place(&self, x: i32, y: i32) -> Option<GridPlace> {
        let inside = (0..self.width as i32).contains(&x) && (0..self.height() as i32).contains(&y);
        inside.then(|| GridPlace((y * self.width as i32 + x) as u16))
    }

    /// Returns column and row, both from 0.
    pub fn position(&self, place: GridPlace) -> [usize; 2] {
        [place.index() % self.width, place.index() / self.width]
    }

    /// Tells what a tile is.
    pub fn tile(&self, place: GridPlace) -> Tile {
        self.tiles[place.index()]
    }

    /// Tells whether a place, which may come from elsewhere, is floor of this grid.
    pub fn is_floor(&self, place: GridPlace) -> bool {
        self.tiles.get(place.index()) == Some(&Tile::Floor)
    }

    /// Returns the tile in front of a cook.
    ///
    /// There always is one, because cooks stand on floor and the border has none.
    pub fn ahead(&self, pose: Pose) -> GridPlace {
        let (dx, dy) = pose.facing.offset();
        GridPlace((i32::from(pose.place.0) + dx + dy * self.width as i32) as u16)
    }

    /// Lists the start tiles, by the cooks' numbers.
    pub fn starts(&self) -> &[GridPlace] {
        &self.starts
    }

    /// Returns the start of the person who is talked to: the highest number. In the public layouts the lower one is
    /// a robot's, which is not there.
    pub fn person_start(&self) -> Option<GridPlace> {
        self.starts.last().copied()
    }

    /// Lists the stations: grills, then boards, then sinks.
    pub fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// Tells which slot a tile is.
    pub fn slot_at(&self, place: GridPlace) -> Option<usize> {
        self.slot_at[place.index()].map(usize::from)
    }

    /// Lists the supplies of onions, meat or plates.
    pub fn supplies(&self, item: Item) -> &[GridPlace] {
        match item {
            Item::Onion => &self.supplies[0],
            Item::Meat => &self.supplies[1],
            Item::Plate => &self.supplies[2],
            Item::CleanPlate | Item::Steak | Item::Dish => &[],
        }
    }

    /// Lists the counters, walls included.
    pub fn counters(&self) -> &[GridPlace] {
        &self.counters
    }

    /// Lists the serving windows.
    pub fn windows(&self) -> &[GridPlace] {
        &self.windows
    }

    /// Lists the tiles on which a cook can stand.
    pub fn floor(&self) -> &[GridPlace] {
        &self.floor
    }
}

/// Without one of each, no dish is served.
const NEEDED: [Tile; 7] = [
    Tile::Supply(Item::Onion),
    Tile::Supply(Item::Meat),
    Tile::Supply(Item::Plate),
    Tile::Station(Station::Grill),
    Tile::Station(Station::Board),
    Tile::Station(Station::Sink),
    Tile::Window,
];

fn name(tile: Tile) -> &'static str {
    match tile {
        Tile::Floor => "floor tile",
        Tile::Counter => "counter (X)",
        Tile::Supply(Item::Onion) => "onion supply (O)",
        Tile::Supply(Item::Meat) => "meat supply (M)",
        Tile::Supply(_) => "plate supply (D)",
        Tile::Station(Station::Grill) => "grill (P)",
        Tile::Station(Station::Board) => "chopping board (B)",
        Tile::Station(Station::Sink) => "sink (W)",
        Tile::Window => "serving window (S)",
    }
}

/// Reads a character: its tile, and the number of the cook who starts there.
fn read_tile(character: char) -> Option<(Tile, Option<usize>)> {
    let tile = match character {
        ' ' => Tile::Floor,
        'X' => Tile::Counter,
        'O' => Tile::Supply(Item::Onion),
        'M' => Tile::Supply(Item::Meat),
        'D' => Tile::Supply(Item::Plate),
        'P' => Tile::Station(Station::Grill),
        'B' => Tile::Station(Station::Board),
        'W' => Tile::Station(Station::Sink),
        'S' => Tile::Window,
        '1'..='9' => return Some((Tile::Floor, character.to_digit(10).map(|n| n as usize))),
        _ => return None,
    };
    Some((tile, None))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: &str = "XPBWX\nO 1 S\nXMDXX";

    fn refused(text: &str) -> String {
        let found = Grid::parse(text).and_then(|grid| grid.check_kitchen());
        let error = found.expect_err("the layout is refused");
        format!("{error}; {}", error.allowed())
    }

    #[test]
    fn a_kitchen_is_read_row_by_row() {
        let grid = Grid::parse("\nXPBWPX\nO 1  S\nXM2DXX\n\n").unwrap_err();
        assert_eq!(grid, LayoutError::OpenBorder { row: 3, column: 3 });
        let grid =
            Grid::parse("\nXPBWPX\nO 1 2S\nXM DXX\n".replace("M D", "MXD").as_str()).unwrap();
        grid.check_kitchen().unwrap();
        assert_eq!((grid.width(), grid.height()), (6, 3));
        let stations: Vec<_> =
            grid.slots().iter().map(|slot| (slot.station, grid.position(slot.place))).collect();
        let (grill, board, sink) = (Station::Grill, Station::Board, Station::Sink);
        assert_eq!(stations, [(grill, [1, 0]), (grill, [4, 0]), (board, [2, 0]), (sink, [3, 0])]);
        assert_eq!(grid.slot_at(grid.place(4, 0).unwrap()), Some(1));
        assert_eq!(grid.person_start(), grid.place(4, 1));
        let pose = Pose { place: grid.place(1, 1).unwrap(), facing: Direction::West };
        assert_eq!(grid.tile(grid.ahead(pose)), Tile::Supply(Item::Onion));
        assert_eq!((grid.place(6, 0), grid.place(0, -1)), (None, None));
    }

    #[test]
    fn what_is_no_kitchen_is_named_by_row_and_column() {
        let with = |from: &str, to: &str| refused(&SMALL.replacen(from, to, 1));
        assert_eq!(refused(""), "there are 0 rows and 0 columns; 3 to 32 rows and columns");
        assert_eq!(
            with("O 1 S", "O 1S"),
            "row 2 has 4 columns and row 1 has 5; rows of one length"
        );
        assert_eq!(
            with("O 1 S", "O 1QS"),
            "row 2, column 4 is `Q`; space, X, O, M, D, P, B, W, S and 1 to 9"
        );
        assert_eq!(
            with("O 1 S", "O 1  "),
            "row 2, column 5 on the border is floor; a border without floor"
        );
        let starts = "starts numbered from 1 without a gap, each once";
        assert_eq!(
            with("O 1 S", "O 11S"),
            format!("row 2, column 4 is a second start `1`; {starts}")
        );
        assert_eq!(
            with("O 1 S", "O 3 S"),
            format!("there is no start `1`, and a higher one; {starts}")
        );
        assert_eq!(with("1", " "), "no tile is a start; a start tile `1`");
    }

    #[test]
    fn a_kitchen_without_a_way_to_a_dish_is_refused() {
        for (character, what) in [
            ("O", "onion supply (O)"),
            ("M", "meat supply (M)"),
            ("D", "plate supply (D)"),
            ("P", "grill (P)"),
            ("B", "chopping board (B)"),
            ("W", "sink (W)"),
            ("S", "serving window (S)"),
        ] {
            let text = refused(&SMALL.replace(character, "X"));
            let needed = "at least one each of O, M, D, P, B, W and S";
            assert_eq!(text, format!("there is no {what}; {needed}"));
        }
        let walled = "XPBWXXX\nO 1 X S\nXMDXXXX";
        assert_eq!(
            refused(walled),
            "row 2, column 6, a floor tile, cannot be reached from the start; \
             floor beside it that is joined to the start"
        );
        assert!(refused("XPBWX\nO 1 S\nXMDXX\nXXXPX").contains("row 4, column 4, a grill (P)"));
        let many = format!("X{}X\nO1{}S\nXMDBW{}X", "P".repeat(16), " ".repeat(15), "X".repeat(12));
        assert!(refused(&many).starts_with("there are 18 grills, boards and sinks"), "{many}");
    }
}
