//! The lander world as a whole: how episodes end, snapshots, determinism, wind, and the agreement of the two integrators.

use leadtime_lander::pilot::{Flyer, evaluate, fly, heuristic};
use leadtime_lander::world::{
    Engine, Frame, Lander, LanderOutcome, LanderSnapshot, Physics, PhysicsSettings,
};
use leadtime_numerics::Pcg64;
use leadtime_proto::codec;
use leadtime_sims::SnapshotError;

fn lander(physics: Physics, wind: bool) -> Lander {
    Lander::new(&PhysicsSettings { physics, wind, ..PhysicsSettings::default() })
}

/// Flies the heuristic for `n` frames, and returns them.
fn frames(lander: &mut Lander, n: usize) -> Vec<Frame> {
    (0..n).map(|_| lander.step(heuristic(lander.observation()))).collect()
}

/// Flies the heuristic until a condition holds.
fn fly_until(lander: &mut Lander, holds: impl Fn(&Lander) -> bool) {
    for _ in 0..1000 {
        if holds(lander) {
            return;
        }
        frames(lander, 1);
    }
    panic!("1000 frames were not enough");
}

/// Goes on from a snapshot in another, used world and in the same one: 60 frames must agree bit for bit.
fn assert_continues(lander: &mut Lander, physics: Physics) {
    let snapshot = lander.snapshot();
    let expected = frames(lander, 60);
    let mut other = self::lander(physics, false);
    other.reset(Pcg64::seed_from_u64(99));
    frames(&mut other, 200);
    let bytes = codec::encode(&snapshot).expect("plain data");
    assert!(bytes.len() < 16_384, "a snapshot of {} bytes", bytes.len());
    let moved = codec::decode(&bytes, 1 << 20).expect("it was encoded");
    other.restore(&moved).expect("the snapshot fits");
    assert_eq!(frames(&mut other, 60), expected);
    lander.restore(&snapshot).expect("the snapshot fits");
    assert_eq!(frames(lander, 60), expected);
}

#[test]
fn a_snapshot_in_flight_and_in_contact_continues_bit_for_bit() {
    for physics in [Physics::Hybrid, Physics::Rapier] {
        for wind in [false, true] {
            let mut lander = lander(physics, wind);
            lander.reset(Pcg64::seed_from_u64(3));
            frames(&mut lander, 20);
            assert_continues(&mut lander, physics);
            lander.reset(Pcg64::seed_from_u64(3));
            fly_until(&mut lander, |lander| lander.leg_contacts().contains(&true));
            assert!(lander.is_in_contact());
            assert_continues(&mut lander, physics);
        }
    }
}

#[test]
fn a_snapshot_that_does_not_fit_is_refused() {
    let mut flying = lander(Physics::Hybrid, false);
    let error = flying.restore(&lander(Physics::Rapier, false).snapshot()).unwrap_err();
    assert!(matches!(error, SnapshotError::Mismatch { what: "lander physics" }), "{error}");
    let mut contact = lander(Physics::Rapier, false);
    let bytes = codec::encode(&contact.snapshot()).unwrap();
    // The engine's state comes last; a cut in it leaves no snapshot at all, a flipped byte may leave a broken one.
    let cut = &bytes[..bytes.len() - 10];
    assert!(codec::decode::<LanderSnapshot>(cut, 1 << 20).is_err());
    let before = contact.snapshot();
    let mut n_refused = 0;
    for (at, flip) in (0..bytes.len()).flat_map(|at| [(at, 1_u8), (at, 0x40)]) {
        let mut flipped = bytes.clone();
        flipped[at] ^= flip;
        if let Ok(snapshot) = codec::decode(&flipped, 1 << 20) {
            if contact.restore(&snapshot).is_err() {
                assert_eq!(contact.snapshot(), before, "a refused snapshot changes nothing");
                n_refused += 1;
            } else {
                // It may be nonsense, but it can be flown.
                frames(&mut contact, 3);
            }
            contact.restore(&before).unwrap();
        }
    }
    assert!(n_refused > 0, "none was refused");
}

#[test]
fn every_moment_of_a_flight_can_be_restored() {
    for physics in [Physics::Hybrid, Physics::Rapier] {
        let (mut flying, mut other) = (lander(physics, true), lander(physics, true));
        for seed in 0..20 {
            flying.reset(Pcg64::seed_from_u64(seed));
            for frame in 0..400 {
                // Now and then without engines, so that it tumbles and falls.
                let falls = (frame / 20 + seed) % 3 == 0;
                let engine = if falls { Engine::Idle } else { heuristic(flying.observation()) };
                flying.step(engine);
                let restored = other.restore(&flying.snapshot());
                assert!(restored.is_ok(), "{physics:?}, seed {seed}, frame {frame}");
            }
        }
    }
}

#[test]
fn an_episode_depends_on_its_seed_and_not_on_history() {
    for physics in [Physics::Hybrid, Physics::Rapier] {
        let mut used = lander(physics, false);
        for seed in 0..15 {
            fly(&mut used, Flyer::Heuristic, seed);
        }
        let mut fresh = lander(physics, false);
        for seed in [3, 7, 20] {
            let [again, anew] = [&mut used, &mut fresh].map(|l| fly(l, Flyer::Heuristic, seed));
            assert_eq!(again, anew);
            assert_eq!(used.snapshot(), fresh.snapshot());
        }
        let other = fly(&mut fresh, Flyer::Heuristic, 4);
        assert_ne!(fly(&mut fresh, Flyer::Heuristic, 3), other);
    }
}

#[test]
fn the_wind_moves_an_idle_lander() {
    let fall = |wind| {
        let mut lander = lander(Physics::Hybrid, wind);
        lander.reset(Pcg64::seed_from_u64(2));
        for _ in 0..50 {
            lander.step(Engine::Idle);
        }
        (lander.position(), lander.angle())
    };
    let ((calm, _), (windy, angle)) = (fall(false), fall(true));
    assert!((windy[0] - calm[0]).abs() > 0.05, "{windy:?} {calm:?}");
    assert!((windy[1] - calm[1]).abs() < 0.05 && angle != 0.0);
}

#[test]
fn both_integrators_fly_alike_until_the_ground_decides() {
    let mut worst = [0.0_f32; 6];
    for seed in 0..12 {
        let mut hybrid = lander(Physics::Hybrid, false);
        let mut rapier = lander(Physics::Rapier, false);
        let mut observation = hybrid.reset(Pcg64::seed_from_u64(seed));
        rapier.reset(Pcg64::seed_from_u64(seed));
        for _ in 0..100 {
            let engine = heuristic(&observation);
            let (ours, theirs) = (hybrid.step(engine), rapier.step(engine));
            if hybrid.is_in_contact() {
                break;
            }
            observation = ours.observation;
            for (i, worst) in worst.iter_mut().enumerate() {
                *worst = worst.max((ours.observation[i] - theirs.observation[i]).abs());
            }
        }
    }
    // Single precision, damped leg stops and one more leg frame: far below what a pilot notices.
    let bounds = [2e-3, 1e-3, 1e-2, 2e-3, 1e-2, 2e-2];
    assert!(worst.iter().zip(bounds).all(|(worst, bound)| *worst < bound), "{worst:?}");
    assert!(worst[0] > 0.0, "two different integrators were compared");
}

#[test]
fn falling_crashes_drifting_leaves_and_the_heuristic_lands() {
    for physics in [Physics::Hybrid, Physics::Rapier] {
        let mut lander = lander(physics, false);
        lander.reset(Pcg64::seed_from_u64(0));
        let last = (0..300).map(|_| lander.step(Engine::Idle)).find(|f| f.outcome.is_some());
        let last = last.expect("a falling lander meets the ground");
        assert_eq!((last.outcome, last.reward), (Some(LanderOutcome::Crashed), -100.0));
        lander.set_start(false, 3000.0);
        // Some seeds throw the lander far to one side; with its engine on it leaves before it falls.
        let leaves = |seed| {
            lander.reset(Pcg64::seed_from_u64(seed));
            let outcome = (0..300).find_map(|_| lander.step(Engine::Main).outcome);
            outcome == Some(LanderOutcome::Out)
        };
        assert!((0..20).any(leaves));
        lander.set_start(false, 1000.0);
        let flown = fly(&mut lander, Flyer::Heuristic, 1);
        assert_eq!(flown.outcome, Some(LanderOutcome::Landed));
        assert!(flown.total > 200.0, "{flown:?}");
        assert!(lander.observation()[0].abs() < 0.3 && lander.angle().abs() < 0.2);
    }
}

#[test]
fn the_heuristic_scores_as_in_the_original() {
    // Gymnasium, seeds 0..1000: return 243.4 ± 2.9, 93 % landed; of 60 episodes the standard error is 12 and 3.3 %.
    let fly = |wind| {
        let settings = PhysicsSettings { wind, ..PhysicsSettings::default() };
        evaluate(Flyer::Heuristic, &settings, 0..60)
    };
    let calm = fly(false);
    assert!((calm.mean_return - 243.4).abs() < 25.0, "{calm:?}");
    assert!(calm.landed > 0.86, "{calm:?}");
    // With wind: 92.2 ± 5.2, 47 % landed; of 60 episodes 21 and 6.5 %.
    let windy = fly(true);
    assert!((windy.mean_return - 92.2).abs() < 45.0, "{windy:?}");
    assert!((windy.landed - 0.471).abs() < 0.15, "{windy:?}");
}
