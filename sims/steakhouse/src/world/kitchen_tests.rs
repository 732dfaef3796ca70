use leadtime_numerics::Pcg64;

use super::*;
use crate::world::{
    Content, Cook, Direction, GridPlace, Item, LAYOUTS, Pose, StartFamily, StationPhase, Subtask,
    interactions_left, is_misled, is_redundant, kitchen, random_pose,
};

const GRILL_1: usize = 0;
const GRILL_2: usize = 1;

fn open(layout: &str, see_delay: u8) -> Kitchen {
    let plan = Floorplan::new(kitchen(layout).unwrap(), FieldOfView::Block);
    Kitchen::new(Arc::new(plan), WorkTimes::default(), see_delay)
}

/// Opens the ring, and returns how it starts when it is empty.
fn open_ring() -> (Kitchen, KitchenStart) {
    let ring = open("ring", 1);
    let start = KitchenStart::new(&ring.plan.grid).unwrap();
    (ring, start)
}

/// Lets the cook go on for `n` steps, or until the dish is served; returns the steps taken.
fn cook(kitchen: &mut Kitchen, generator: &mut Pcg64, n: u32) -> u32 {
    let before = kitchen.n_steps;
    while !kitchen.world.is_done() && kitchen.n_steps < before + n {
        let action = kitchen.decide(Ties::Random(generator));
        kitchen.step(action, true);
    }
    kitchen.n_steps - before
}

/// Puts the cook in front of the first grill, with something in hand.
fn before_the_grill(kitchen: &mut Kitchen, held: Option<Item>) {
    let place = kitchen.plan.grid.place(2, 1).unwrap();
    let pose = Pose { place, facing: Direction::North };
    kitchen.world.state.cooks[0] = Cook { pose, held };
}

fn families() -> [StartFamily; 9] {
    use StartFamily::{AllPartial, AllReady, Boards, Empty, FirstOfEach, Grills, Sinks};
    use StartFamily::{Random, Unavailable};
    [Empty, Grills, Boards, Sinks, FirstOfEach, AllPartial, AllReady, Random, Unavailable]
}

#[test]
fn no_start_and_no_belief_makes_the_cook_stall() {
    for (layout, _) in LAYOUTS {
        let mut kitchens = [1, 2, 3].map(|see_delay| open(layout, see_delay));
        let grid = Arc::clone(&kitchens[0].plan.grid);
        for (seed, family) in (0..3).flat_map(|seed| families().map(|family| (seed, family))) {
            if !family.is_possible(&grid) {
                continue;
            }
            let mut generator = Pcg64::seed_from_u64(seed);
            let mut start = KitchenStart::new(&grid).unwrap();
            family.fill(&grid, WorkTimes::default(), &mut generator, &mut start.contents);
            start.pose = random_pose(&grid, &mut generator);
            start.release_at = (seed == 0).then_some(20);
            for (kitchen, is_aware) in kitchens.iter_mut().zip([false, false, true]) {
                kitchen.begin(&start, is_aware);
                cook(kitchen, &mut generator, 400);
                assert!(kitchen.world.is_done(), "{layout} {family:?} {seed} {start:?}");
            }
        }
    }
}

#[test]
fn a_whole_order_takes_ten_interactions_and_the_chops_and_washes() {
    let (mut ring, start) = open_ring();
    ring.begin(&start, true);
    let (mut left, mut n_interactions) = (interactions_left(&ring.world), 0);
    assert_eq!(left, 14);
    while !ring.world.is_done() {
        let action = ring.decide(Ties::First);
        let outcome = ring.step(action, true);
        let needed = u32::from(action == Action::Interact);
        assert!(needed == 0 || outcome.changed);
        assert_eq!(interactions_left(&ring.world) + needed, left);
        (left, n_interactions) = (left - needed, n_interactions + needed);
    }
    assert_eq!((n_interactions, ring.n_steps), (14, 70));
}

#[test]
fn a_station_in_somebody_elses_use_cannot_be_used_until_it_is_released() {
    let (mut ring, mut start) = open_ring();
    start.contents[GRILL_1] = Content::Unavailable;
    start.release_at = Some(3);
    for held in [None, Some(Item::Meat), Some(Item::CleanPlate)] {
        ring.begin(&start, false);
        before_the_grill(&mut ring, held);
        for released in [false, false, true] {
            assert!(!ring.step(Action::Interact, false).changed);
            assert_eq!(ring.world.cook().held, held);
            let content = if released { Content::Empty } else { Content::Unavailable };
            assert_eq!(ring.world.contents()[GRILL_1], content);
            assert_eq!(ring.mind.belief.contents[GRILL_1], content);
        }
    }
    assert_eq!(ring.world.phase(GRILL_1, Content::Unavailable), StationPhase::Unavailable);
}

#[test]
fn a_cook_who_finds_a_grill_taken_goes_to_the_other() {
    let (mut ring, mut start) = open_ring();
    start.contents[GRILL_2] = Content::Unavailable;
    ring.begin(&start, false);
    ring.world.state.cooks[0].held = Some(Item::Meat);
    let grill = |ring: &Kitchen, slot: usize| Some(ring.plan.grid.slots[slot].place);
    ring.decide(Ties::First);
    assert_eq!(ring.mind.goal, grill(&ring, GRILL_2));
    assert!(is_misled(&ring.world, &ring.mind));
    let mut goals = Vec::new();
    while ring.world.contents()[GRILL_1] == Content::Empty {
        let action = ring.decide(Ties::First);
        goals.push(ring.mind.goal);
        ring.step(action, true);
    }
    assert_eq!(goals.first(), Some(&grill(&ring, GRILL_2)));
    assert_eq!(goals.last(), Some(&grill(&ring, GRILL_1)));
    // What cannot be used is no reason not to fetch meat.
    ring.begin(&start, true);
    assert!(!is_redundant(&ring.world, Subtask::FetchMeat));
}

#[test]
fn work_that_a_station_already_has_is_in_vain() {
    use Subtask::{Discard, FetchMeat, FetchOnion, PlaceMeat, PlateSteak, Wait};
    let (mut ring, mut start) = open_ring();
    start.contents[GRILL_1] = Content::Work(3);
    ring.begin(&start, false);
    let in_vain = |subtask| is_redundant(&ring.world, subtask);
    assert_eq!([FetchMeat, PlaceMeat, Discard].map(in_vain), [true; 3]);
    assert_eq!([FetchOnion, PlateSteak, Wait].map(in_vain), [false; 3]);
}

#[test]
fn equals_are_chosen_by_chance_or_by_order() {
    let (mut ring, start) = open_ring();
    let mut lengths = |seed| {
        let mut generator = Pcg64::seed_from_u64(seed);
        ring.begin(&start, true);
        cook(&mut ring, &mut generator, 200)
    };
    let random: Vec<u32> = (0..20).map(&mut lengths).collect();
    assert_eq!(random, (0..20).map(&mut lengths).collect::<Vec<_>>());
    assert!(random.iter().any(|&length| length != random[0]), "{random:?}");
    assert_eq!(ring.reference_steps(&start, 200), 70);
}

#[test]
fn waiting_at_the_grill_goes_on_until_the_steak_is_done() {
    let (mut ring, mut start) = open_ring();
    (start.contents[GRILL_1], start.contents[2]) = (Content::Work(7), Content::Work(2));
    ring.begin(&start, true);
    before_the_grill(&mut ring, Some(Item::CleanPlate));
    for _ in 0..3 {
        assert_eq!(ring.decide(Ties::First), Action::Stay);
        ring.step(Action::Stay, true);
    }
    assert_eq!(ring.decide(Ties::First), Action::Interact);
    ring.step(Action::Interact, true);
    assert_eq!(ring.world.cook().held, Some(Item::Steak));
}

#[test]
fn a_state_continues_bit_for_bit_and_one_of_another_kitchen_is_refused() {
    let mut ring = open("ring", 2);
    let mut start = KitchenStart::new(&ring.plan.grid).unwrap();
    start.contents.fill(Content::Work(1));
    (start.contents[GRILL_1], start.release_at) = (Content::Unavailable, Some(25));
    ring.begin(&start, false);
    let mut generator = Pcg64::seed_from_u64(5);
    cook(&mut ring, &mut generator, 17);
    let (state, mut again) = (ring.state(), generator.clone());
    let mut other = open("ring", 2);
    assert!(other.restore(state.clone()));
    assert_eq!(cook(&mut ring, &mut generator, 400), cook(&mut other, &mut again, 400));
    assert_eq!(ring.state(), other.state());
    let mut mid = open("steak_mid_2", 1);
    let before = mid.state();
    assert!(!mid.restore(state.clone()) && mid.state() == before);
    let refused = |change: fn(&mut KitchenState)| {
        let mut changed = state.clone();
        change(&mut changed);
        !open("ring", 2).restore(changed)
    };
    assert!(refused(|s| s.world.contents[0] = Content::Work(11)));
    assert!(refused(|s| s.world.cooks[0].pose.place = GridPlace(0)));
    assert!(refused(|s| s.world.cooks[0].pose.place = GridPlace(9999)));
    assert!(refused(|s| s.world.lying[10] = Some(Item::Dish)));
    assert!(refused(|s| s.world.cooks.clear()));
    assert!(refused(|s| s.world.orders = None));
    assert!(refused(|s| s.mind = Mind::new(5)));
}
