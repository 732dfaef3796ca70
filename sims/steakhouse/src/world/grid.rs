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
use thiserror::Error;

use super::kinds::{Content, Direction, Item, Station, Tile, WorkTimes};

/// The most rows, and the most columns.
const MAX_SIDE: usize = 32;
/// The most grills, boards and sinks together.
const MAX_STATIONS: usize = 16;
/// What is allowed of starts.
const STARTS: &str = "starts numbered from 1 without a gap, each once";

/// Why rows of characters are no kitchen. Rows and columns count from 1.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{given}")]
pub struct LayoutError {
    /// What is wrong, and where.
    pub given: String,
    /// What would do instead.
    pub allowed: &'static str,
}

fn refused<T>(given: String, allowed: &'static str) -> Result<T, LayoutError> {
    Err(LayoutError { given, allowed })
}

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
    /// The tile that the cook stands on.
    pub place: GridPlace,
    /// The direction of view.
    pub facing: Direction,
}

/// A station and where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// The tile of the station.
    pub place: GridPlace,
    /// What kind of station it is.
    pub station: Station,
}

/// The tiles of a kitchen. Lists of places run row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Number of columns; a place's index runs row by row.
    pub width: usize,
    tiles: Vec<Tile>,
    /// The start of the cook who listens: the highest number. In the public layouts the lower one is a robot's,
    /// which is not there.
    pub person_start: Option<GridPlace>,
    /// The stations: grills, then boards, then sinks.
    pub slots: Vec<Slot>,
    /// By tile: which slot it is.
    slot_at: Vec<Option<u8>>,
    /// The tiles of supplies, by the item that they supply.
    supplies: [Vec<GridPlace>; 3],
    /// The counters, walls included.
    pub counters: Vec<GridPlace>,
    /// The windows at which dishes are served.
    pub windows: Vec<GridPlace>,
    /// The tiles on which a cook can stand.
    pub floor: Vec<GridPlace>,
}

impl Grid {
    /// Reads a kitchen, of which appliances may be missing.
    ///
    /// # Errors
    ///
    /// [`LayoutError`] if a side is not 3 to 32 tiles, rows differ in length, a character stands for nothing, a border
    /// tile is floor, start numbers have gaps or repeat, or there are more than 16 stations. It names row and column,
    /// from 1.
    pub fn parse(text: &str) -> Result<Self, LayoutError> {
        let rows: Vec<Vec<char>> =
            text.trim_matches(['\n', '\r']).lines().map(|row| row.chars().collect()).collect();
        let width = rows.first().map_or(0, Vec::len);
        let fits = |side: usize| (3..=MAX_SIDE).contains(&side);
        if !fits(rows.len()) || !fits(width) {
            let given = format!("there are {} rows and {width} columns", rows.len());
            return refused(given, "3 to 32 rows and columns");
        }
        let mut tiles = Vec::with_capacity(rows.len() * width);
        let mut starts = [None; 9];
        for (y, row) in rows.iter().enumerate() {
            if row.len() != width {
                let given =
                    format!("row {} has {} columns and row 1 has {width}", y + 1, row.len());
                return refused(given, "rows of one length");
            }
            for (x, &character) in row.iter().enumerate() {
                let at = format!("row {}, column {}", y + 1, x + 1);
                let Some((tile, number)) = read_tile(character) else {
                    let allowed = "space, X, O, M, D, P, B, W, S and 1 to 9";
                    return refused(format!("{at} is `{character}`"), allowed);
                };
                let is_border = y == 0 || y + 1 == rows.len() || x == 0 || x + 1 == width;
                if is_border && tile == Tile::Floor {
                    let given = format!("{at} on the border is floor");
                    return refused(given, "a border without floor");
                }
                if let Some(number) = number
                    && starts[number - 1].replace(GridPlace(tiles.len() as u16)).is_some()
                {
                    return refused(format!("{at} is a second start `{number}`"), STARTS);
                }
                tiles.push(tile);
            }
        }
        let n_starts = starts.iter().flatten().count();
        if let Some(gap) = starts[..n_starts].iter().position(Option::is_none) {
            return refused(format!("there is no start `{}`, and a higher one", gap + 1), STARTS);
        }
        Self::of_tiles(width, tiles, starts[..n_starts].last().copied().flatten())
    }

    fn of_tiles(
        width: usize,
        tiles: Vec<Tile>,
        person_start: Option<GridPlace>,
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
            let given = format!("there are {} grills, boards and sinks", slots.len());
            return refused(given, "at most 16 of them");
        }
        let mut slot_at = vec![None; tiles.len()];
        for (slot, at) in slots.iter().enumerate() {
            slot_at[at.place.index()] = Some(slot as u8);
        }
        Ok(Self {
            width,
            person_start,
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
    /// [`LayoutError`] if no tile is a start, an appliance or supply is missing, or one cannot be reached from the
    /// start; it names which.
    pub fn check_kitchen(&self) -> Result<(), LayoutError> {
        let Some(start) = self.person_start else {
            return refused("no tile is a start".to_owned(), "a start tile `1`");
        };
        if let Some(&needed) = NEEDED.iter().find(|needed| !self.tiles.contains(needed)) {
            let allowed = "at least one each of O, M, D, P, B, W and S";
            return refused(format!("there is no {}", name(needed)), allowed);
        }
        let reached = self.reached_from(start);
        let is_lost = |at: &GridPlace| self.tile(*at) != Tile::Counter && !reached[at.index()];
        let Some(lost) = self.places().find(is_lost) else { return Ok(()) };
        let ([x, y], what) = (self.position(lost), name(self.tile(lost)));
        let at = format!("row {}, column {}", y + 1, x + 1);
        let given = format!("{at}, a {what}, cannot be reached from the start");
        refused(given, "floor beside it that is joined to the start")
    }

    /// Marks the floor that a cook can get to, and whatever that floor borders on.
    fn reached_from(&self, start: GridPlace) -> Vec<bool> {
        let mut reached = vec![false; self.tiles.len()];
        let mut open = vec![start];
        reached[start.index()] = true;
        while let Some(place) = open.pop() {
            for facing in Direction::ALL {
                let next = self.ahead(Pose { place, facing });
                let is_new = !std::mem::replace(&mut reached[next.index()], true);
                if is_new && self.tile(next) == Tile::Floor {
                    open.push(next);
                }
            }
        }
        reached
    }

    /// Returns the number of rows.
    pub fn height(&self) -> usize {
        self.tiles.len() / self.width
    }

    /// Lists all tiles, row by row.
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

    /// Returns what a tile is.
    pub fn tile(&self, place: GridPlace) -> Tile {
        self.tiles[place.index()]
    }

    /// Returns whether a place, which may come from elsewhere, is floor of this grid.
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

    /// Lists all poses in which a cook can be.
    pub fn poses(&self) -> impl Iterator<Item = Pose> + '_ {
        let turned = |&place: &GridPlace| Direction::ALL.map(|facing| Pose { place, facing });
        self.floor.iter().flat_map(turned)
    }

    /// Returns the tile in front of a cook, if it is floor.
    pub(super) fn free_ahead(&self, pose: Pose) -> Option<GridPlace> {
        Some(self.ahead(pose)).filter(|&ahead| self.tile(ahead) == Tile::Floor)
    }

    /// Returns whether its stations could hold this.
    pub fn can_hold(&self, contents: &[Content], times: WorkTimes) -> bool {
        let possible = |(content, slot): (&Content, &Slot)| {
            content.work().is_none_or(|counter| counter <= times.limit(slot.station))
        };
        contents.len() == self.slots.len() && contents.iter().zip(&self.slots).all(possible)
    }

    /// Returns which slot a tile is, if it is one.
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
        format!("{error}; {}", error.allowed)
    }

    #[test]
    fn a_kitchen_is_read_row_by_row() {
        let grid = Grid::parse("\nXPBWPX\nO 1 2S\nXMXDXX\n\n").unwrap();
        grid.check_kitchen().unwrap();
        assert_eq!((grid.width, grid.height()), (6, 3));
        let stations: Vec<_> =
            grid.slots.iter().map(|slot| (slot.station, grid.position(slot.place))).collect();
        let (grill, board, sink) = (Station::Grill, Station::Board, Station::Sink);
        assert_eq!(stations, [(grill, [1, 0]), (grill, [4, 0]), (board, [2, 0]), (sink, [3, 0])]);
        assert_eq!(grid.slot_at(grid.place(4, 0).unwrap()), Some(1));
        assert_eq!(grid.person_start, grid.place(4, 1));
        let pose = Pose { place: grid.place(1, 1).unwrap(), facing: Direction::West };
        assert_eq!(grid.tile(grid.ahead(pose)), Tile::Supply(Item::Onion));
        assert_eq!((grid.place(6, 0), grid.place(0, -1)), (None, None));
    }

    #[test]
    fn a_grid_that_is_not_a_kitchen_is_named_by_row_and_column() {
        let with = |from: &str, to: &str| refused(&SMALL.replacen(from, to, 1));
        assert_eq!(refused(""), "there are 0 rows and 0 columns; 3 to 32 rows and columns");
        let starts = "starts numbered from 1 without a gap, each once";
        for (row, expected) in [
            ("O 1S", "row 2 has 4 columns and row 1 has 5; rows of one length"),
            ("O 1QS", "row 2, column 4 is `Q`; space, X, O, M, D, P, B, W, S and 1 to 9"),
            ("O 1  ", "row 2, column 5 on the border is floor; a border without floor"),
            ("O 1 2", "row 2, column 5 on the border is floor; a border without floor"),
            ("O 11S", &format!("row 2, column 4 is a second start `1`; {starts}")),
            ("O 3 S", &format!("there is no start `1`, and a higher one; {starts}")),
            ("O   S", "no tile is a start; a start tile `1`"),
        ] {
            assert_eq!(with("O 1 S", row), expected);
        }
    }

    #[test]
    fn a_kitchen_without_a_way_to_a_dish_is_refused() {
        for character in ["O", "M", "D", "P", "B", "W", "S"] {
            let text = refused(&SMALL.replace(character, "X"));
            let end = format!(" ({character}); at least one each of O, M, D, P, B, W and S");
            assert!(text.starts_with("there is no ") && text.ends_with(&end), "{text}");
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
