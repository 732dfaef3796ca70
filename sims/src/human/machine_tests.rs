//! Every row of the transition table, scripted timings, and what holds whatever is said, set and refused.

use proptest::prelude::*;
use proptest::sample::select;

use super::*;
use crate::ReactionStatus::{Ended, Followed, Refused};
use crate::human::{
    BlockedInitiation, Comprehension, FollowThrough, FollowThroughEnd, Interrupt, ReactionDelay,
};

const A: usize = 0;
const B: usize = 1;

fn message(topic: usize, comprehension: u32, conveyance: u32) -> Message {
    Message { topic, comprehension, conveyance }
}

fn start(topic: usize, k: u32, l: u32) -> SpeechAct {
    SpeechAct::Start(message(topic, k, l))
}

fn human(settings: &HumanSettings) -> Human {
    let mut human = Human::new(settings, Vec::new(), ReasonTable::default());
    human.reset(Pcg64::seed_from_u64(1));
    human
}

fn with(change: impl FnOnce(&mut HumanSettings)) -> HumanSettings {
    let mut settings = HumanSettings::default();
    change(&mut settings);
    settings
}

fn undelayed() -> HumanSettings {
    with(|s| s.reaction_delay = ReactionDelay::Fixed(0))
}

/// Steps once in a world that always follows; returns the topic acted upon.
fn step(human: &mut Human, act: SpeechAct) -> Option<usize> {
    step_in(human, act, Followed).0
}

/// Steps once in a world that always follows; returns what became of the act.
fn say(human: &mut Human, act: SpeechAct) -> Initiation {
    step_in(human, act, Followed).1
}

fn step_in(
    human: &mut Human,
    act: SpeechAct,
    status: ReactionStatus,
) -> (Option<usize>, Initiation) {
    human.begin_step();
    let initiation = human.apply(act);
    let reaction = human.reaction();
    human.acted(reaction.map(|_| status), 0);
    human.hear_word();
    (reaction.map(|reaction| reaction.topic), initiation)
}

/// Steps through `acts`, then silence, for `n_steps`; returns the topic acted upon in each.
fn steps(human: &mut Human, acts: &[(usize, SpeechAct)], n_steps: usize) -> Vec<Option<usize>> {
    let act = |t| acts.iter().find(|(at, _)| *at == t).map_or(SpeechAct::Continue, |said| said.1);
    (0..n_steps).map(|t| step(human, act(t))).collect()
}

/// Says A (k, l) at time 0 and B (k, l) at time `at`; returns when each is acted upon, and the tally.
fn both(
    change: impl FnOnce(&mut HumanSettings),
    a: (u32, u32),
    at: usize,
    b: (u32, u32),
) -> ([Vec<usize>; 2], Tally) {
    let mut human = human(&with(change));
    let acted = steps(&mut human, &[(0, start(A, a.0, a.1)), (at, start(B, b.0, b.1))], 20);
    let of = |topic| (0..20).filter(|&t| acted[t] == Some(topic)).collect();
    ([of(A), of(B)], *human.tally())
}

fn only(settings: &HumanSettings, k: u32, l: u32) -> Vec<usize> {
    let acted = steps(&mut human(settings), &[(0, start(A, k, l))], 20);
    (0..20).filter(|&t| acted[t] == Some(A)).collect()
}

#[test]
fn a_message_is_acted_upon_from_k_plus_the_delay_for_its_length() {
    assert_eq!(only(&HumanSettings::default(), 2, 5), [4, 5, 6, 7, 8]);
    let inclusive = with(|s| s.follow_through_end = FollowThroughEnd::Inclusive);
    assert_eq!(only(&inclusive, 2, 5), [4, 5, 6, 7, 8, 9]);
    assert_eq!(only(&HumanSettings::default(), 5, 5), [7, 8, 9, 10, 11]);
    // Without a delay the reaction starts in the step after the k-th word.
    assert_eq!(only(&undelayed(), 2, 3), [2, 3, 4]);
    // Counting words from zero makes comprehension one step earlier.
    assert_eq!(only(&with(|s| s.words_from = 0), 2, 3), [3, 4, 5]);
    let settings = HumanSettings { words_from: 0, ..undelayed() };
    assert_eq!(only(&settings, 2, 3), [1, 2, 3]);
    assert_eq!(only(&settings, 1, 1), [0]);
    // Row I9: immediate comprehension still obeys the delay.
    assert_eq!(only(&with(|s| s.comprehension = Comprehension::Immediate), 3, 3), [2, 3, 4]);
}

#[test]
fn the_steakhouse_figure_of_the_source_is_reproduced() {
    // "down", k = 2, l = 5, no reaction delay, three steps of follow-through: steps 2, 3 and 4 go down.
    let settings = HumanSettings {
        follow_through: FollowThrough::Fixed(3),
        interrupt: Interrupt::Finish,
        blocked_initiation: BlockedInitiation::Mask,
        ..undelayed()
    };
    assert_eq!(only(&settings, 2, 5), [2, 3, 4]);
}

#[test]
fn a_delay_free_listener_acts_in_the_very_step_and_speech_still_takes_its_time() {
    let settings = HumanSettings::delay_free();
    assert_eq!(only(&settings, 4, 4), [0, 1, 2, 3]);
    let mut human = human(&settings);
    for heard in 1..4 {
        step(&mut human, if heard == 1 { start(A, 4, 4) } else { SpeechAct::Continue });
        assert_eq!(human.speech(), Some((message(A, 4, 4), heard)));
    }
    step(&mut human, SpeechAct::Continue);
    assert_eq!((human.speech(), human.tally().delivered), (None, 1));
}

#[test]
fn rows_d_i_and_c_two_messages_meet_as_their_settings_say() {
    let delayed = |s: &mut HumanSettings| s.reaction_delay = ReactionDelay::Fixed(3);
    // D3: a due reaction replaces the running one.
    assert_eq!(both(|_| {}, (2, 5), 3, (2, 2)).0, [vec![4, 5, 6], vec![7, 8]]);
    // I2: a message cut before comprehension never counts.
    let (acted, tally) = both(|s| s.interrupt = Interrupt::Replace, (2, 2), 1, (2, 2));
    assert_eq!((acted, tally.preempted, tally.started), ([vec![], vec![5, 6]], 1, 2));
    // I3: a message cut after comprehension is still acted upon, and nothing was in vain or heard to its end.
    for interrupt in [Interrupt::Replace, Interrupt::UntilComprehended] {
        let (acted, tally) = both(|s| s.interrupt = interrupt, (2, 5), 2, (4, 4));
        assert_eq!(acted, [vec![4, 5, 6, 7], vec![8, 9, 10, 11]]);
        assert_eq!((tally.started, tally.preempted, tally.delivered), (2, 0, 1));
    }
    // I7: a start can cancel what is pending.
    let acted = both(|s| s.pending = PendingRule::CancelOnInitiation, (2, 2), 3, (2, 2)).0;
    assert_eq!(acted, [vec![], vec![7, 8]]);
    // I8: a start can cancel what runs; before its first step, that counts as overwritten.
    let cancels = |s: &mut HumanSettings| s.running = RunningRule::CancelOnInitiation;
    assert_eq!(both(cancels, (2, 5), 5, (2, 2)).0, [vec![4], vec![9, 10]]);
    assert_eq!(both(cancels, (2, 2), 4, (2, 2)).1.overwritten, 1);
    // C2: the next comprehension takes the slot.
    let (acted, tally) = both(delayed, (2, 2), 2, (2, 2));
    assert_eq!((acted, tally.overwritten), ([vec![], vec![7, 8]], 1));
    // C5: A is due at time 4, the end of step 3, when B is comprehended: messages at a distance of the delay all count.
    assert_eq!(both(|_| {}, (2, 2), 2, (2, 2)).0, [vec![4, 5], vec![6, 7]]);
    // C3: a queue keeps both.
    let queues = |s: &mut HumanSettings| {
        delayed(s);
        s.pending = PendingRule::Queue;
    };
    assert_eq!(both(queues, (2, 2), 2, (2, 2)).0, [vec![5, 6], vec![7, 8]]);
    // C4: comprehension can end what runs.
    let acted = both(|s| s.running = RunningRule::CancelOnComprehension, (2, 5), 4, (2, 2)).0;
    assert_eq!(acted, [vec![4, 5], vec![8, 9]]);
}

#[test]
fn c6_l3_an_informative_message_leaves_no_reaction_and_works_when_it_is_delivered() {
    let settings = with(|s| s.interrupt = Interrupt::Replace);
    let mut human = Human::new(&settings, vec![B], ReasonTable::default());
    // A is understood at time 2 and due at time 4; B is understood in between, and leaves it alone.
    let acted = steps(&mut human, &[(0, start(A, 2, 2)), (2, start(B, 1, 3))], 7);
    assert_eq!(acted, [None, None, None, None, Some(A), Some(A), None]);
    let tally = human.tally();
    assert_eq!((tally.comprehended, tally.followed, tally.unheeded), (2, 2, 0));
    // Cut before its last word, it was understood and came to nothing.
    step(&mut human, start(B, 1, 3));
    step(&mut human, start(A, 2, 2));
    assert_eq!((human.tally().followed, human.tally().unheeded), (2, 1));
}

#[test]
fn the_coming_reaction_is_known_before_the_step() {
    let mut human = human(&undelayed());
    let mut coming = |act| {
        step(&mut human, act);
        human.upcoming().map(|(_, steps)| steps)
    };
    assert_eq!(coming(start(A, 2, 3)), None);
    let then: Vec<_> = (0..5).map(|_| coming(SpeechAct::Continue)).collect();
    assert_eq!(then, [Some(3), Some(2), Some(1), None, None]);
}

#[test]
fn row_d1_a_pending_reaction_waits() {
    let mut human = human(&HumanSettings::default());
    steps(&mut human, &[(0, start(A, 2, 2))], 2);
    human.begin_step();
    assert_eq!((human.pending(), human.reaction()), (Some(message(A, 2, 2)), None));
}

#[test]
fn row_d2_a_due_reaction_runs() {
    let mut human = human(&undelayed());
    step(&mut human, start(A, 1, 2));
    human.begin_step();
    assert_eq!(human.pending(), None);
    assert_eq!(human.reaction(), Some(ReactionStep { topic: A, first: true }));
    human.acted(Some(Followed), 0);
    assert_eq!(human.reaction(), Some(ReactionStep { topic: A, first: false }));
}

#[test]
fn rows_d3_and_i8_tell_the_world_of_a_replaced_reaction_that_it_has_seen() {
    let mut replaced = human(&undelayed());
    step(&mut replaced, start(A, 1, 5));
    step(&mut replaced, start(B, 1, 5));
    assert!(!replaced.take_reaction_over());
    replaced.begin_step();
    assert!(replaced.take_reaction_over());
    assert!(!replaced.take_reaction_over());
    let mut unseen = human(&with(|s| s.running = RunningRule::CancelOnInitiation));
    steps(&mut unseen, &[(0, start(A, 2, 2)), (4, start(B, 2, 2))], 5);
    assert!(!unseen.take_reaction_over());
}

#[test]
fn row_d4_a_reaction_of_no_steps_comes_to_nothing() {
    let mut human = human(&with(|s| s.follow_through = FollowThrough::TwiceLengthMinusTwo));
    assert_eq!(steps(&mut human, &[(0, start(A, 1, 1))], 8), [None; 8]);
    assert_eq!((human.tally().unheeded, human.tally().followed), (1, 0));
}

#[test]
fn row_i1_a_message_starts_in_silence() {
    let mut human = human(&HumanSettings::default());
    assert_eq!(human.apply(start(A, 2, 3)), Initiation::Started);
    assert_eq!(human.speech(), Some((message(A, 2, 3), 0)));
    assert_eq!((human.tally().started, human.tally().sum_k, human.tally().sum_l), (1, 2, 3));
}

#[test]
fn row_i4_nothing_starts_before_comprehension() {
    let mut human = human(&HumanSettings::default());
    step(&mut human, start(A, 3, 4));
    assert!(!human.may_start());
    assert_eq!(say(&mut human, start(B, 2, 2)), Initiation::Blocked);
    assert_eq!(human.speech(), Some((message(A, 3, 4), 2)));
    assert_eq!((human.tally().ignored, human.tally().started), (1, 1));
}

#[test]
fn row_i5_nothing_starts_before_the_last_word() {
    let mut human = human(&with(|s| s.interrupt = Interrupt::Finish));
    step(&mut human, start(A, 1, 3));
    let outcomes: [_; 3] = std::array::from_fn(|_| say(&mut human, start(B, 2, 2)));
    assert_eq!(outcomes, [Initiation::Blocked, Initiation::Blocked, Initiation::Started]);
}

#[test]
fn row_i6_a_repetition_continues_what_is_under_way_or_restarts() {
    let mut settings = with(|s| s.interrupt = Interrupt::Replace);
    let mut restarting = human(&settings);
    step(&mut restarting, start(A, 2, 2));
    step(&mut restarting, start(A, 2, 2));
    assert_eq!((restarting.tally().continued, restarting.tally().preempted), (0, 1));
    settings.repeat = Repeat::Continue;
    let mut human = human(&settings);
    // Spoken at 0 and 1, pending at 2 and 3, running from 4 to 5.
    step(&mut human, start(A, 2, 2));
    for t in 1..6 {
        assert_eq!(say(&mut human, start(A, 2, 2)), Initiation::Continued, "at {t}");
    }
    assert_eq!(say(&mut human, start(A, 2, 2)), Initiation::Started);
    assert_eq!((human.tally().continued, human.tally().started), (5, 2));
}

#[test]
fn rows_s_stop_breaks_off_speech_if_it_may() {
    let mut stopping = human(&with(|s| s.can_stop = true));
    assert_eq!(say(&mut stopping, SpeechAct::Stop), Initiation::None);
    step(&mut stopping, start(A, 2, 4));
    assert!(stopping.may_stop());
    assert_eq!(say(&mut stopping, SpeechAct::Stop), Initiation::Stopped);
    assert_eq!((stopping.speech(), stopping.pending()), (None, None));
    assert_eq!(stopping.tally().preempted, 1);

    step(&mut stopping, start(A, 1, 4));
    step(&mut stopping, SpeechAct::Stop);
    assert_eq!((stopping.tally().preempted, stopping.tally().delivered), (1, 0));
    assert_eq!(stopping.pending(), Some(message(A, 1, 4)));

    let mut human = human(&HumanSettings::default());
    step(&mut human, start(A, 2, 4));
    assert_eq!((say(&mut human, SpeechAct::Stop), human.may_stop()), (Initiation::None, false));
    assert_eq!(human.speech(), Some((message(A, 2, 4), 2)));
}

#[test]
fn rows_a1_a2_refused_steps_use_up_the_reaction() {
    let mut human = human(&undelayed());
    step(&mut human, start(A, 1, 2));
    for _ in 0..2 {
        assert!(!human.take_reaction_over());
        assert_eq!(step_in(&mut human, SpeechAct::Continue, Refused).0, Some(A));
    }
    assert!(human.take_reaction_over());
    assert_eq!(step(&mut human, SpeechAct::Continue), None);
    assert_eq!((human.tally().unheeded, human.tally().followed), (1, 0));
}

#[test]
fn row_a3_the_world_can_end_a_reaction() {
    let mut human = human(&undelayed());
    step(&mut human, start(A, 1, 5));
    step_in(&mut human, SpeechAct::Continue, Ended);
    assert!(human.take_reaction_over());
    assert_eq!(step(&mut human, SpeechAct::Continue), None);
    assert_eq!(human.tally().followed, 1);
}

#[test]
fn rows_c1_l1_the_k_th_word_makes_pending_and_the_last_word_delivers() {
    let mut occupying = human(&HumanSettings::default());
    occupying.apply(start(A, 2, 3));
    assert_eq!((occupying.hear_word(), occupying.pending()), (None, None));
    assert_eq!((occupying.hear_word(), occupying.pending()), (None, Some(message(A, 2, 3))));
    assert_eq!((occupying.tally().comprehended, occupying.tally().delivered), (1, 0));
    assert_eq!(occupying.hear_word(), Some(message(A, 2, 3)));
    assert_eq!((occupying.speech(), occupying.tally().delivered), (None, 1));
    // Speech that does not occupy the channel is over once it is understood.
    let mut human = human(&with(|s| s.occupies = false));
    human.apply(start(A, 2, 5));
    human.hear_word();
    assert_eq!(human.hear_word(), Some(message(A, 2, 5)));
    assert_eq!((human.speech(), human.tally().comprehended), (None, 1));
}

#[test]
fn row_l2_a_delivery_can_cancel_the_running_reaction_but_not_the_pending_one() {
    let mut human = human(&HumanSettings::default());
    steps(&mut human, &[(0, start(A, 2, 5))], 6);
    human.apply(start(B, 1, 2));
    human.hear_word();
    human.end_running();
    assert!(human.take_reaction_over());
    assert_eq!((human.reaction(), human.pending()), (None, Some(message(B, 1, 2))));
}

#[test]
fn the_reaction_reward_is_paid_as_set() {
    let paid = |reaction_reward, statuses: [ReactionStatus; 3]| {
        let follow_through = FollowThrough::Fixed(3);
        let mut human = human(&HumanSettings { follow_through, reaction_reward, ..undelayed() });
        step(&mut human, start(A, 1, 5));
        human.begin_step();
        statuses.map(|status| human.acted(Some(status), 0))
    };
    assert_eq!(paid(ReactionReward::Off, [Followed; 3]), [0.0, 0.0, 0.0]);
    assert_eq!(paid(ReactionReward::Once, [Refused, Followed, Followed]), [0.0, 3.0, 0.0]);
    assert_eq!(paid(ReactionReward::PerStep, [Followed, Refused, Followed]), [3.0, 0.0, 3.0]);
}

#[test]
fn a_reason_is_paid_once_per_danger() {
    let reasons = [("up".to_owned(), 1, 5, 0.5)];
    let reasons = ReasonTable::new(&reasons, &["up", "down"]).unwrap();
    let settings = HumanSettings {
        follow_through: FollowThrough::Fixed(1),
        reaction_reward: ReactionReward::Once,
        reason_weight: 4.0,
        ..undelayed()
    };
    let mut human = Human::new(&settings, Vec::new(), reasons);
    human.reset(Pcg64::seed_from_u64(1));
    let mut paid = |topic, danger| {
        step(&mut human, start(topic, 1, 5));
        human.begin_step();
        let paid = human.acted(Some(Followed), danger);
        human.hear_word();
        paid
    };
    // l - 2 is paid each time, the reason on top of it for a danger that was not explained yet.
    assert_eq!([paid(B, 0), paid(A, 0), paid(A, 0)], [3.0, 5.0, 3.0]);
    assert_eq!([paid(A, 1), paid(A, 1), paid(A, 0)], [5.0, 3.0, 3.0]);
    assert_eq!([paid(A, 63), paid(A, 64), paid(A, usize::MAX)], [5.0, 3.0, 3.0]);
}

fn any_settings() -> impl Strategy<Value = HumanSettings> {
    let interrupt =
        select(vec![Interrupt::Replace, Interrupt::UntilComprehended, Interrupt::Finish]);
    let pending = select(vec![
        PendingRule::OverwriteOnComprehension,
        PendingRule::CancelOnInitiation,
        PendingRule::Queue,
    ]);
    let running = select(vec![
        RunningRule::UntilNextDue,
        RunningRule::CancelOnInitiation,
        RunningRule::CancelOnComprehension,
    ]);
    let repeat = select(vec![Repeat::Restart, Repeat::Continue]);
    let comprehension = select(vec![Comprehension::Immediate, Comprehension::Words]);
    let rules = (interrupt, pending, running, repeat, comprehension);
    let rest = (rules, any::<bool>(), any::<bool>(), 0_u32..6, 0_u32..2);
    rest.prop_map(|(rules, occupies, can_stop, high, words_from)| {
        let (interrupt, pending, running, repeat, comprehension) = rules;
        let drawn = crate::human::DelayDraw::PerNotification;
        HumanSettings {
            interrupt,
            pending,
            running,
            repeat,
            comprehension,
            occupies,
            can_stop,
            words_from,
            reaction_delay: ReactionDelay::Uniform { low: 0, high, drawn },
            follow_through: FollowThrough::TwiceLengthMinusTwo,
            ..HumanSettings::default()
        }
    })
}

fn any_step() -> impl Strategy<Value = (SpeechAct, ReactionStatus)> {
    let words = (1_u32..6, 0_u32..4).prop_map(|(k, more)| (k, k + more));
    let act = prop_oneof![
        3 => Just(SpeechAct::Continue),
        1 => Just(SpeechAct::Stop),
        4 => (0_usize..2, words).prop_map(|(topic, (k, l))| start(topic, k, l)),
    ];
    (act, select(vec![Followed, Refused, Ended]))
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
                resumed = Human::new(&settings, Vec::new(), ReasonTable::default());
                resumed.restore(leadtime_proto::codec::decode(&bytes, bytes.len()).unwrap());
            }
            let expected = step_in(&mut straight, act, status);
            prop_assert_eq!(step_in(&mut resumed, act, status), expected);
            prop_assert_eq!(resumed.state(), straight.state());
        }
    }
}
