//! Medoids against exhaustive search and against published numbers.

use proptest::prelude::*;

use super::*;

fn plane(points: &[(f64, f64)]) -> Distances {
    Distances::new(points.len(), |a, b| {
        (points[a].0 - points[b].0).abs() + (points[a].1 - points[b].1).abs()
    })
}

fn brute_force(distances: &Distances, k: usize) -> f64 {
    let mut least = f64::INFINITY;
    for bits in 0_u32..1 << distances.n {
        if bits.count_ones() as usize == k {
            let choice: Vec<usize> = (0..distances.n).filter(|i| bits >> i & 1 == 1).collect();
            least = least.min(distances.cost(&choice));
        }
    }
    least
}

proptest! {
    #[test]
    fn the_choice_costs_what_exhaustive_search_finds(
        points in proptest::collection::vec((0.0_f64..10.0, 0.0_f64..10.0), 1..10), k in 1_usize..5,
    ) {
        let distances = plane(&points);
        let k = k.min(points.len());
        let chosen = medoids(&distances, k);
        prop_assert_eq!(chosen.len(), k);
        prop_assert!(chosen.is_sorted());
        let least = brute_force(&distances, k);
        prop_assert!((distances.cost(&chosen) - least).abs() < 1e-9);
        // BUILD and SWAP alone stop where no exchange helps; that is never below the least cost.
        let local = pam(&distances, k);
        let cost = distances.cost(&local);
        prop_assert!(cost > least - 1e-9);
        for place in 0..k {
            for other in 0..points.len() {
                let mut swapped = local.clone();
                swapped[place] = other;
                prop_assert!(distances.cost(&swapped) > cost - 1e-9);
            }
        }
        prop_assert_eq!(medoids(&distances, k), chosen);
    }
}

#[test]
fn many_things_are_chosen_from_by_build_and_swap() {
    // Three heaps far apart, forty things each: too many choices to try all.
    let points: Vec<(f64, f64)> =
        (0..120).map(|i| (f64::from(i / 40) * 100.0, f64::from(i % 40 * 7 % 40))).collect();
    let distances = plane(&points);
    assert!(n_choices(120, 3) > MAX_CHOICES);
    let heaps: Vec<usize> = medoids(&distances, 3).iter().map(|i| i / 40).collect();
    assert_eq!(heaps, [0, 1, 2]);
}

#[test]
fn few_things_are_all_kept() {
    let distances = plane(&[(0.0, 0.0), (1.0, 0.0)]);
    assert_eq!(medoids(&distances, 4), [0, 1]);
    assert_eq!(medoids(&Distances::new(0, |_, _| 0.0), 4), [0; 0]);
}

/// Made by `crates/taxonomy/scripts/kmedoids_golden.py`: the reference package's PAM, and exhaustive search beside it.
#[test]
fn build_and_swap_finds_what_the_reference_finds() {
    let points: Vec<(f64, f64)> =
        (0..24).map(|i| (f64::from(37 * i % 101), f64::from(53 * i % 97))).collect();
    let distances = plane(&points);
    let golden: [(usize, &[usize], f64, f64); 4] = [
        (2, &[4, 23], 917.0, 889.0),
        (3, &[11, 12, 21], 680.0, 680.0),
        (4, &[1, 4, 5, 11], 565.0, 565.0),
        (5, &[4, 7, 8, 11, 12], 460.0, 460.0),
    ];
    for (k, reference, cost, least) in golden {
        let local = pam(&distances, k);
        assert_eq!(local, reference, "k = {k}");
        assert_eq!(distances.cost(&local), cost);
        assert_eq!(distances.cost(&medoids(&distances, k)), least);
    }
}
