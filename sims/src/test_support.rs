//! What several domains' tests need.

use proptest::prelude::*;

use crate::{Environment, EpisodeSeed};

/// Plays a random notifier's episode twice, once through a snapshot, and expects the same bits throughout.
///
/// `choices`: per step whether a message starts (0: it does), topic, k and l; `cut`: the step of the snapshot.
pub(crate) fn goes_on_bit_for_bit<E: Environment>(
    make: impl Fn() -> E,
    seed: EpisodeSeed,
    choices: &[(u8, u8, u8, u8)],
    cut: usize,
) -> Result<(), TestCaseError> {
    let (mut straight, mut resumed) = (make(), make());
    let mut expected = vec![0.0; straight.spec().obs_dim];
    let mut observation = expected.clone();
    straight.reset(seed, &mut expected);
    resumed.reset(seed, &mut observation);
    for (t, &(speaks, topic, k, l)) in choices.iter().enumerate() {
        if t == cut {
            let mut bytes = Vec::new();
            resumed.snapshot(&mut bytes);
            resumed = make();
            resumed.restore(&bytes, &mut observation).unwrap();
            prop_assert_eq!(&observation, &expected);
        }
        // One step in four starts a message.
        let action = [u8::from(speaks == 0), topic, k, l.max(k)];
        let outcome = straight.step(&action, &mut expected);
        prop_assert_eq!(resumed.step(&action, &mut observation), outcome);
        prop_assert_eq!(&observation, &expected);
        if outcome.end.is_some() {
            break;
        }
    }
    let (mut a, mut b) = (Vec::new(), Vec::new());
    straight.snapshot(&mut a);
    resumed.snapshot(&mut b);
    prop_assert_eq!(a, b);
    Ok(())
}
