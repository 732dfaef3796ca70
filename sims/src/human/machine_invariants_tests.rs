//! What holds of the machine whatever is said, set and refused.

use proptest::prelude::*;

use super::*;

fn any_settings() -> impl Strategy<Value = HumanSettings> {
    let interrupt = prop::sample::select(vec![
        Interrupt::Replace,
        Interrupt::UntilComprehended,
        Interrupt::Finish,
    ]);
    let pending = prop::sample::select(vec![
        PendingRule::OverwriteOnComprehension,
        PendingRule::CancelOnInitiation,
        PendingRule::Queue,
    ]);
    let running = prop::sample::select(vec![
        RunningRule::UntilNextDue,
        RunningRule::CancelOnInitiation,
        RunningRule::CancelOnComprehension,
    ]);
    let flags = (any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>());
    let rest = (interrupt, pending, running, flags, 0_u32..6, 0_u32..2);
    rest.prop_map(|(interrupt, pending, running, flags, high, words_from)| {
        let (occupies, can_stop, immediate, repeats) = flags;
        let drawn = crate::human::DelayDraw::PerNotification;
        with(|s| {
            s.interrupt = interrupt;
            s.pending = pending;
            s.running = running;
            s.occupies = occupies;
            s.can_stop = can_stop;
            s.words_from = words_from;
            s.reaction_delay = ReactionDelay::Uniform { low: 0, high, drawn };
            s.follow_through = FollowThrough::TwiceLengthMinusTwo;
            s.repeat = if repeats { Repeat::Restart } else { Repeat::Continue };
            s.comprehension =
                if immediate { Comprehension::Immediate } else { Comprehension::Words };
        })
    })
}

fn any_step() -> impl Strategy<Value = (SpeechAct, ReactionStatus)> {
    let words = (1_u32..6, 0_u32..4).prop_map(|(k, more)| (k, k + more));
    let act = prop_oneof![
        3 => Just(SpeechAct::Continue),
        1 => Just(SpeechAct::Stop),
        4 => (0_usize..2, words).prop_map(|(topic, (k, l))| start(topic, k, l)),
    ];
    let status = prop::sample::select(vec![
        ReactionStatus::Followed,
        ReactionStatus::Refused,
        ReactionStatus::Ended,
    ]);
    (act, status)
}

proptest! {
    #[test]
    fn every_message_is_accounted_for(
        settings in any_settings(),
        steps in prop::collection::vec(any_step(), 1..80),
    ) {
        let mut human = human(&settings);
        for (act, status) in steps {
            step_in(&mut human, act, status);
            let HumanState { speech, pending, running, tally, .. } = human.state();
            let spoken = u32::from(speech.is_some_and(|utterance| !utterance.understood));
            prop_assert_eq!(tally.started, tally.preempted + tally.comprehended + spoken);
            let under_way = pending.len() as u32
                + u32::from(running.is_some_and(|running| !running.followed));
            let ended = tally.overwritten + tally.followed + tally.unheeded;
            prop_assert_eq!(tally.comprehended, ended + under_way);
        }
    }

    #[test]
    fn a_restored_listener_goes_on_as_if_nothing_had_happened(
        settings in any_settings(),
        steps in prop::collection::vec(any_step(), 2..60),
        cut in 0.0..1.0_f64,
    ) {
        let mut straight = human(&settings);
        let mut resumed = human(&settings);
        let cut = (cut * steps.len() as f64) as usize;
        for (t, &(act, status)) in steps.iter().enumerate() {
            if t == cut {
                let bytes = leadtime_proto::codec::encode(resumed.state()).unwrap();
                resumed = Human::new(&settings);
                resumed.restore(leadtime_proto::codec::decode(&bytes, bytes.len()).unwrap());
            }
            let expected = step_in(&mut straight, act, status);
            prop_assert_eq!(step_in(&mut resumed, act, status), expected);
            prop_assert_eq!(resumed.state(), straight.state());
        }
    }
}
