//! The kitchen as a picture's ingredients: a unit square per tile, north up.

use leadtime_sims::scene::{Gauge, Scene, Shape, Tone, View};

use crate::world::{Content, FieldOfView, Grid, GridPlace, Item, Kitchen, Subtask, Tile};

/// How far a drawn square stays off its tile's edges.
const MARGIN: f64 = 0.04;
/// Half the size of the cook.
const COOK: f64 = 0.32;

/// Room for the line that says what the cook is about to do.
const PLAN_HEIGHT: f64 = 0.5;
/// Room next to the kitchen, for labels that are wider than a tile.
const SIDES: f64 = 0.25;

/// Describes the kitchen, back to front: tiles, what the cook sees, true and believed states, the cook.
pub(super) fn scene(kitchen: &Kitchen, field_of_view: FieldOfView, outcome: &str) -> Scene {
    let world = &kitchen.world;
    let (grid, cook) = (world.grid(), world.cook());
    let mut shapes: Vec<Shape> = grid
        .places()
        .filter(|&place| grid.tile(place) != Tile::Floor)
        .map(|place| square(grid, place, tone(kitchen, place)))
        .collect();
    let visible = field_of_view.visible(grid, cook.pose);
    shapes.extend(visible.map(|place| square(grid, place, Tone::Hint)));
    shapes.extend(grid.places().flat_map(|place| labels(kitchen, place)));
    shapes.push(Shape::Polygon { points: body(grid, kitchen), tone: Tone::Own });
    let position = center(grid, cook.pose.place);
    if let Some(item) = cook.held {
        let [x, y] = position;
        shapes.push(Shape::Label { at: [x, y - 0.42], text: item_name(item).to_owned() });
    }
    let plan = format!("plan: {}", plan_name(kitchen.mind.leaning(world)));
    shapes.push(Shape::Label { at: [grid.width as f64 / 2.0, -0.5 * PLAN_HEIGHT], text: plan });
    let (min, max) = ([-SIDES, -PLAN_HEIGHT], [grid.width as f64 + SIDES, grid.height() as f64]);
    Scene {
        view: View { min, max },
        shapes,
        position,
        gauge: Gauge { label: "y (tiles)", value: position[1] },
        outcome: outcome.to_owned(),
        ..Scene::default()
    }
}

/// Returns the centre of a tile; rows count downward, pictures upward.
fn center(grid: &Grid, place: GridPlace) -> [f64; 2] {
    let [x, y] = grid.position(place);
    [x as f64 + 0.5, (grid.height() - y) as f64 - 0.5]
}

fn square(grid: &Grid, place: GridPlace, tone: Tone) -> Shape {
    let [x, y] = center(grid, place);
    let half = 0.5 - MARGIN;
    Shape::Rectangle { min: [x - half, y - half], max: [x + half, y + half], tone }
}

/// Stations that the cook is wrong about stand out.
fn tone(kitchen: &Kitchen, place: GridPlace) -> Tone {
    let world = &kitchen.world;
    match (world.grid().tile(place), world.grid().slot_at(place)) {
        (_, Some(slot)) if !kitchen.mind.belief.is_aware(slot, world) => Tone::Mistaken,
        (Tile::Window, _) => Tone::Goal,
        (Tile::Supply(_) | Tile::Station(_), _) => Tone::Other,
        (Tile::Floor | Tile::Counter, _) => Tone::Ground,
    }
}

/// Names what a tile is or holds; of a station, also what the cook believes, where that differs.
fn labels(kitchen: &Kitchen, place: GridPlace) -> Vec<Shape> {
    let world = &kitchen.world;
    let [x, y] = center(world.grid(), place);
    let label = |y, text: &str| Shape::Label { at: [x, y], text: text.to_owned() };
    match world.grid().tile(place) {
        Tile::Floor => Vec::new(),
        Tile::Counter => {
            world.lying(place).into_iter().map(|item| label(y, item_name(item))).collect()
        }
        Tile::Supply(Item::Onion) => vec![label(y, "onions")],
        Tile::Supply(Item::Plate) => vec![label(y, "plates")],
        Tile::Supply(item) => vec![label(y, item_name(item))],
        Tile::Window => vec![label(y, "window")],
        Tile::Station(station) => {
            let slot = world.grid().slot_at(place).unwrap_or_default();
            let limit = world.times.limit(station);
            let (truth, belief) = (world.contents()[slot], kitchen.mind.belief.contents[slot]);
            let mut labels = vec![label(y + 0.25, station.name()), label(y, &state(truth, limit))];
            if truth != belief {
                labels.push(label(y - 0.25, &format!("thinks {}", state(belief, limit))));
            }
            labels
        }
    }
}

fn state(content: Content, limit: u8) -> String {
    match content {
        Content::Empty => "empty".to_owned(),
        Content::Work(counter) => format!("{counter}/{limit}"),
        Content::Unavailable => "taken".to_owned(),
    }
}

fn plan_name(subtask: Subtask) -> &'static str {
    match subtask {
        Subtask::TakeDish => "take the dish",
        Subtask::TakePlatedSteak => "take the steak",
        Subtask::Chop => "chop the garnish",
        Subtask::Wash => "wash the plate",
        Subtask::FetchMeat => "fetch meat",
        Subtask::FetchOnion => "fetch an onion",
        Subtask::FetchPlate => "fetch a plate",
        Subtask::TakeCleanPlate => "take the clean plate",
        Subtask::PlaceMeat => "meat onto a free grill",
        Subtask::PlaceOnion => "onion onto a free board",
        Subtask::PlacePlate => "plate into a free sink",
        Subtask::PlateSteak => "steak onto the plate",
        Subtask::Garnish => "garnish the steak",
        Subtask::Serve => "serve",
        Subtask::Discard => "put it away",
        Subtask::Wait => "wait",
    }
}

/// Returns the cook as an arrow head in the direction of view.
fn body(grid: &Grid, kitchen: &Kitchen) -> Vec<[f64; 2]> {
    let pose = kitchen.world.cook().pose;
    let [x, y] = center(grid, pose.place);
    let (dx, dy) = pose.facing.offset();
    let (ahead_x, ahead_y) = (COOK * f64::from(dx), COOK * f64::from(-dy));
    vec![
        [x + ahead_x, y + ahead_y],
        [x - ahead_x - ahead_y, y - ahead_y + ahead_x],
        [x - ahead_x + ahead_y, y - ahead_y - ahead_x],
    ]
}

fn item_name(item: Item) -> &'static str {
    ["onion", "meat", "plate", "clean plate", "steak", "dish"][item as usize]
}
