//! States of the public environment: runs, single interactions, views.

use std::sync::Arc;

use leadtime_steakhouse::world::{
    Action, ActionOutcome, Content, Direction, Event, FieldOfView, Grid, GridPlace, Item,
    KitchenWorld, Order, OrdersEnd, Pose, Station, WorkTimes, WorldState, start_pose,
};
use serde::Deserialize;
use serde_json::Value;

use super::report::RecordingReport;
use crate::error::ReplayError;

#[derive(Deserialize)]
pub(super) struct PublicRecordings {
    #[serde(default)]
    traces: Vec<KitchenTrace>,
    /// Runs of the original's own cook: we replay what it did, not why.
    #[serde(default)]
    source_cook: Vec<KitchenTrace>,
    interact_matrix: Option<Matrix>,
    #[serde(default)]
    fov: Vec<RecordedView>,
}

impl PublicRecordings {
    pub(super) fn replay(&self) -> Result<Vec<RecordingReport>, ReplayError> {
        let runs = self.traces.iter().chain(&self.source_cook);
        let mut comparisons = runs.map(KitchenTrace::replay).collect::<Result<Vec<_>, _>>()?;
        if let Some(matrix) = &self.interact_matrix {
            comparisons.push(matrix.replay()?);
        }
        if !self.fov.is_empty() {
            let mut comparison = RecordingReport::new("fov");
            self.fov.iter().for_each(|view| view.compare(&mut comparison));
            comparisons.push(comparison);
        }
        Ok(comparisons)
    }
}

/// Something that lies about or is in hand; a counter is given where it is cooked, chopped or washed.
#[derive(Clone, Debug, PartialEq, Deserialize)]
struct Thing {
    name: String,
    cook: Option<u8>,
    progress: Option<u8>,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
struct Object {
    pos: [i32; 2],
    #[serde(flatten)]
    thing: Thing,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
struct RecordedCook {
    pos: [i32; 2],
    ori: String,
    held: Option<Thing>,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
struct KitchenRow {
    players: Vec<RecordedCook>,
    objects: Vec<Object>,
    orders: Value,
}

#[derive(Deserialize)]
struct KitchenTrace {
    name: String,
    grid: Vec<String>,
    cook_time: u8,
    chop_time: u8,
    wash_time: u8,
    start: KitchenRow,
    #[serde(default)]
    terminal_at_start: bool,
    steps: Vec<KitchenStep>,
}

#[derive(Deserialize)]
struct KitchenStep {
    actions: Vec<String>,
    sparse: Vec<u32>,
    shaped: Vec<u32>,
    events: Vec<String>,
    done: bool,
    state: KitchenRow,
}

impl KitchenTrace {
    fn impossible(&self, what: &'static str) -> ReplayError {
        ReplayError::Impossible { run: self.name.clone(), what }
    }

    fn replay(&self) -> Result<RecordingReport, ReplayError> {
        let times = WorkTimes { cook: self.cook_time, chop: self.chop_time, wash: self.wash_time };
        let grid = read_grid(&self.name, &self.grid)?;
        let state = read_state(&grid, &self.start).ok_or_else(|| self.impossible("start"))?;
        let n_cooks = state.cooks.len();
        let mut world = KitchenWorld::new(grid, times, OrdersEnd::OneLeft, state);
        let mut comparison = RecordingReport::new(&self.name);
        comparison.check(format_args!("end at start"), &world.is_done(), &self.terminal_at_start);
        // The horizon is no rule of the world; the one run that meets it is as long as its horizon.
        let horizon = if self.name == "horizon" { self.steps.len() } else { usize::MAX };
        for (t, step) in self.steps.iter().enumerate() {
            let actions: Option<Vec<_>> = step.actions.iter().map(|a| read_action(a)).collect();
            let actions = actions.filter(|actions| actions.len() == n_cooks);
            let outcomes = world.step(&actions.ok_or_else(|| self.impossible("action"))?);
            let rewards: Vec<u32> = outcomes.iter().map(|outcome| outcome.reward).collect();
            let events = event_names(outcomes);
            comparison.check(format_args!("reward of step {t}"), &rewards, &step.sparse);
            let none = vec![0; n_cooks];
            comparison.check(format_args!("shaped reward of step {t}"), &none, &step.shaped);
            comparison.check(format_args!("events of step {t}"), &events, &step.events);
            let done = world.is_done() || t + 1 >= horizon;
            comparison.check(format_args!("end of step {t}"), &done, &step.done);
            let (ours, theirs) = (describe(&world), step.state.clone());
            comparison.check(format_args!("cooks of step {t}"), &ours.players, &theirs.players);
            comparison.check(format_args!("objects of step {t}"), &ours.objects, &theirs.objects);
            let orders = read_orders(&theirs.orders);
            comparison.check(format_args!("orders of step {t}"), &world.state().orders, &orders);
            comparison.n_compared += 1;
        }
        // A run may consist of its start alone.
        comparison.n_compared = comparison.n_compared.max(1);
        Ok(comparison)
    }
}

fn read_grid(run: &str, rows: &[String]) -> Result<Arc<Grid>, ReplayError> {
    let grid = Grid::parse(&rows.join("\n")).map(Arc::new);
    grid.map_err(|source| ReplayError::Layout { run: run.to_owned(), source })
}

fn read_action(name: &str) -> Option<Action> {
    match name {
        "_" => Some(Action::Stay),
        "I" => Some(Action::Interact),
        direction => read_direction(direction).map(Action::Go),
    }
}

pub(super) fn read_direction(name: &str) -> Option<Direction> {
    Direction::ALL.into_iter().find(|&direction| direction_name(direction) == name)
}

pub(super) fn direction_name(direction: Direction) -> &'static str {
    ["N", "S", "E", "W"][direction as usize]
}

pub(super) fn item_name(item: Item) -> &'static str {
    ["onion", "meat", "plate", "hot_plate", "steak", "dish"][item as usize]
}

fn read_item(thing: &Thing) -> Option<Item> {
    Item::ALL.into_iter().find(|&item| item_name(item) == thing.name)
}

/// Orders are a list of names, nothing, or (in the layout files) one string, which then counts by its characters.
fn read_orders(orders: &Value) -> Option<Vec<Order>> {
    let order = |name: &str| if name == "steak" { Order::Steak } else { Order::Other };
    match orders {
        Value::Array(names) => {
            Some(names.iter().map(|name| order(name.as_str().unwrap_or_default())).collect())
        }
        Value::Object(raw) => {
            let text = raw.get("raw_string").and_then(Value::as_str).unwrap_or_default();
            Some(text.chars().map(|_| Order::Other).collect())
        }
        _ => None,
    }
}

fn read_state(grid: &Grid, state: &KitchenRow) -> Option<WorldState> {
    let mut poses = Vec::new();
    for player in &state.players {
        let place = grid.place(player.pos[0], player.pos[1]);
        let place = place.filter(|&place| grid.is_floor(place))?;
        poses.push(Pose { place, facing: read_direction(&player.ori)? });
    }
    let mut found = WorldState::new(grid, &poses, read_orders(&state.orders));
    for (cook, player) in found.cooks.iter_mut().zip(&state.players) {
        if let Some(thing) = &player.held {
            cook.held = Some(read_item(thing)?);
        }
    }
    for object in &state.objects {
        let place = grid.place(object.pos[0], object.pos[1])?;
        put(grid, &mut found, place, &object.thing)?;
    }
    Some(found)
}

fn put(grid: &Grid, state: &mut WorldState, place: GridPlace, thing: &Thing) -> Option<()> {
    match grid.slot_at(place) {
        Some(slot) => state.contents[slot] = Content::Work(thing.cook.or(thing.progress)?),
        None => state.lying[place.index()] = Some(read_item(thing)?),
    }
    Some(())
}

fn plain(item: Item, times: WorkTimes) -> Thing {
    let cook = (item == Item::Steak).then_some(times.cook);
    let progress = (item == Item::CleanPlate).then_some(times.wash);
    Thing { name: item_name(item).to_owned(), cook, progress }
}

/// Describes what is on a tile, in the recordings' words.
fn thing_at(world: &KitchenWorld, place: GridPlace) -> Option<Thing> {
    let grid = world.grid();
    let Some(slot) = grid.slot_at(place) else {
        return world.lying(place).map(|item| plain(item, world.times));
    };
    let counter = Some(world.contents()[slot].work()?);
    let (name, cook, progress) = match grid.slots[slot].station {
        Station::Grill => ("steak", counter, None),
        Station::Board => ("garnish", None, counter),
        Station::Sink => ("hot_plate", None, counter),
    };
    Some(Thing { name: name.to_owned(), cook, progress })
}

fn describe(world: &KitchenWorld) -> KitchenRow {
    let grid = world.grid();
    let position = |place| grid.position(place).map(|side| side as i32);
    let players = world.state().cooks.iter().map(|cook| RecordedCook {
        pos: position(cook.pose.place),
        ori: direction_name(cook.pose.facing).to_owned(),
        held: cook.held.map(|item| plain(item, world.times)),
    });
    let object = |place| thing_at(world, place).map(|thing| Object { pos: position(place), thing });
    KitchenRow {
        players: players.collect(),
        objects: grid.places().filter_map(object).collect(),
        orders: Value::Null,
    }
}

fn event_names(outcomes: &[ActionOutcome]) -> Vec<String> {
    let logged = outcomes.iter().enumerate().flat_map(|(cook, outcome)| {
        outcome.events.iter().flatten().map(move |event| format!("{}:{cook}", event_name(*event)))
    });
    logged.collect()
}

fn event_name(event: Event) -> String {
    match event {
        Event::Pickup(item) => format!("{}_pickup", item_name(item)),
        Event::UsefulOnionPickup => "useful_onion_pickup".to_owned(),
        Event::Cooking => "steak_cooking".to_owned(),
        Event::Chopping => "onion_chopping".to_owned(),
        Event::Washing => "plate_heating".to_owned(),
        Event::Delivery => "dish_delivery".to_owned(),
    }
}

/// One interaction in every situation.
#[derive(Deserialize)]
struct Matrix {
    grid: Vec<String>,
    cook_time: u8,
    chop_time: u8,
    wash_time: u8,
    rows: Vec<MatrixRow>,
}

#[derive(Deserialize)]
struct MatrixRow {
    /// A tile's character, `floor` or `other_cook`.
    tile: String,
    content: Option<Thing>,
    held: Option<Thing>,
    content_after: Option<Thing>,
    held_after: Option<Thing>,
    sparse: u32,
    orders_left: usize,
    events: Vec<String>,
}

impl Matrix {
    fn replay(&self) -> Result<RecordingReport, ReplayError> {
        let times = WorkTimes { cook: self.cook_time, chop: self.chop_time, wash: self.wash_time };
        let grid = read_grid("interact_matrix", &self.grid)?;
        let mut comparison = RecordingReport::new("interact_matrix");
        for (number, row) in self.rows.iter().enumerate() {
            let state = self.start(&grid, row).ok_or_else(|| ReplayError::Impossible {
                run: format!("interact_matrix, row {number}"),
                what: "situation",
            })?;
            let place = grid.ahead(state.cooks[0].pose);
            let mut world = KitchenWorld::new(Arc::clone(&grid), times, OrdersEnd::OneLeft, state);
            let outcomes = world.step(&[Action::Interact, Action::Stay]);
            let (reward, events) = (outcomes[0].reward, event_names(outcomes));
            let held = world.cook().held.map(|item| plain(item, times));
            let left = world.state().orders.as_ref().map_or(0, Vec::len);
            comparison.check(format_args!("hand of row {number}"), &held, &row.held_after);
            let content = thing_at(&world, place);
            comparison.check(format_args!("tile of row {number}"), &content, &row.content_after);
            comparison.check(format_args!("reward of row {number}"), &reward, &row.sparse);
            comparison.check(format_args!("orders of row {number}"), &left, &row.orders_left);
            comparison.check(format_args!("events of row {number}"), &events, &row.events);
            comparison.n_compared += 1;
        }
        Ok(comparison)
    }

    /// Puts the first cook in front of such a tile, and the second onto it or out of the way.
    fn start(&self, grid: &Grid, row: &MatrixRow) -> Option<WorldState> {
        let character = |place| {
            let [x, y] = grid.position(place);
            self.grid.get(y)?.chars().nth(x)
        };
        let fits = |pose: &Pose| match row.tile.as_str() {
            "floor" | "other_cook" => grid.is_floor(grid.ahead(*pose)),
            tile => character(grid.ahead(*pose)).map(String::from).as_deref() == Some(tile),
        };
        let pose = grid.poses().find(fits)?;
        let ahead = grid.ahead(pose);
        let mut free = grid.floor.iter().filter(|&&place| place != pose.place && place != ahead);
        let other = if row.tile == "other_cook" { ahead } else { *free.next()? };
        let orders = Some(vec![Order::Steak; 3]);
        let mut state = WorldState::new(grid, &[pose, start_pose(other)], orders);
        if let Some(thing) = &row.held {
            state.cooks[0].held = Some(read_item(thing)?);
        }
        if let Some(thing) = &row.content {
            put(grid, &mut state, ahead, thing)?;
        }
        Some(state)
    }
}

/// What is in view of a cook at the origin, at most four tiles away.
#[derive(Deserialize)]
struct RecordedView {
    #[serde(rename = "view_angle")]
    degrees: u16,
    ori: String,
    visible_offsets: Vec<[i32; 2]>,
}

impl RecordedView {
    fn compare(&self, comparison: &mut RecordingReport) {
        let cone = FieldOfView::Cone(self.degrees);
        let offsets = (-4..=4).flat_map(|dy| (-4..=4).map(move |dx| [dx, dy]));
        let seen = |facing| {
            let seen = offsets.clone().filter(|&[dx, dy]| cone.sees_offset(facing, dx, dy));
            seen.collect::<Vec<_>>()
        };
        let ours = read_direction(&self.ori).map(seen).unwrap_or_default();
        let mut theirs = self.visible_offsets.clone();
        theirs.sort_by_key(|&[dx, dy]| (dy, dx));
        let Self { degrees, ori, .. } = self;
        comparison.check(format_args!("{degrees} degrees, facing {ori}"), &ours, &theirs);
        comparison.n_compared += 1;
    }
}
