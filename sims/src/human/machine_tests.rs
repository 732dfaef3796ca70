//! One test per row of the transition table, and scripted timings.

use super::*;
use crate::ReactionStatus::{Followed, Refused};
use crate::human::{BlockedInitiation, Comprehension, FollowThrough, ReactionDelay};

#[path = "machine_invariants_tests.rs"]
mod invariants;

const A: usize = 0;
const B: usize = 1;

fn message(topic: usize, comprehension: u32, conveyance: u32) -> Message {
    Message { topic, comprehension, conveyance }
}

fn start(topic: usize, k: u32, l: u32) -> SpeechAct {
    SpeechAct::Start(message(topic, k, l))
}

fn human(settings: &HumanSettings) -> Human {
    let mut human = Human::new(settings);
    human.reset(Pcg64::seed_from_u64(1));
    human
}

fn with(change: impl FnOnce(&mut HumanSettings)) -> HumanSettings {
    let mut settings = HumanSettings::default();
    change(&mut settings);
    settings
}

/// Steps once in a world that always follows; returns the topic acted upon.
fn step(human: &mut Human, act: SpeechAct) -> Option<usize> {
    step_in(human, act, ReactionStatus::Followed).0
}

fn step_in(
    human: &mut Human,
    act: SpeechAct,
    status: ReactionStatus,
) -> (Option<usize>, Initiation) {
    human.begin_step();
    let initiation = human.apply(act);
    let reaction = human.reaction();
    human.acted(reaction.map(|_| status));
    human.hear_word();
    (reaction.map(|reaction| reaction.topic), initiation)
}

/// Steps through `acts`, then silence, for `n_steps`; returns the acted steps of each topic.
fn acted_steps(settings: &HumanSettings, acts: &[(u32, SpeechAct)], n_steps: u32) -> [Vec<u32>; 2] {
    let mut human = human(settings);
    let mut acted = [Vec::new(), Vec::new()];
    for t in 0..n_steps {
        let act = acts.iter().find(|(at, _)| *at == t).map_or(SpeechAct::Continue, |o| o.1);
        if let Some(topic) = step(&mut human, act) {
            acted[topic].push(t);
        }
    }
    acted
}

fn only(settings: &HumanSettings, k: u32, l: u32) -> Vec<u32> {
    acted_steps(settings, &[(0, start(A, k, l))], 20)[A].clone()
}

#[test]
fn a_message_is_acted_upon_from_k_plus_the_delay_for_its_length() {
    assert_eq!(only(&HumanSettings::default(), 2, 5), [4, 5, 6, 7, 8]);
    assert_eq!(only(&HumanSettings::paper(), 2, 5), [4, 5, 6, 7, 8, 9]);
    assert_eq!(only(&HumanSettings::default(), 5, 5), [7, 8, 9, 10, 11]);
}

#[test]
fn c6_l3_an_informative_message_leaves_no_reaction_and_works_when_it_is_delivered() {
    let settings = with(|s| s.interrupt = Interrupt::Replace);
    let mut human = human(&settings).with_informative(vec![B]);
    // A is understood at time 2 and due at time 4; B is understood in between, and leaves it alone.
    let acts = [Some(start(A, 2, 2)), None, Some(start(B, 1, 3))];
    let acted: Vec<Option<usize>> = (0..7)
        .map(|t| step(&mut human, acts.get(t).copied().flatten().unwrap_or(SpeechAct::Continue)))
        .collect();
    assert_eq!(acted, [None, None, None, None, Some(A), Some(A), None]);
    let tally = human.tally();
    assert_eq!((tally.comprehended, tally.followed, tally.unheeded), (2, 2, 0));
    // Cut before its last word, it was understood and came to nothing.
    step(&mut human, start(B, 1, 3));
    step(&mut human, start(A, 2, 2));
    assert_eq!((human.tally().followed, human.tally().unheeded), (2, 1));
}

#[test]
fn what_comes_next_is_known_before_the_step() {
    let settings = with(|s| s.reaction_delay = ReactionDelay::Fixed(0));
    let mut human = human(&settings);
    let coming: Vec<Option<u32>> = (0..6)
        .map(|t| {
            step(&mut human, if t == 0 { start(A, 2, 3) } else { SpeechAct::Continue });
            human.upcoming().map(|(_, steps)| steps)
        })
        .collect();
    assert_eq!(coming, [None, Some(3), Some(2), Some(1), None, None]);
}

#[test]
fn without_delay_the_reaction_starts_in_the_step_after_the_k_th_word() {
    let settings = with(|s| s.reaction_delay = ReactionDelay::Fixed(0));
    assert_eq!(only(&settings, 2, 3), [2, 3, 4]);
}

#[test]
fn counting_words_from_zero_makes_comprehension_one_step_earlier() {
    let mut settings = with(|s| s.words_from = 0);
    assert_eq!(only(&settings, 2, 3), [3, 4, 5]);
    settings.reaction_delay = ReactionDelay::Fixed(0);
    assert_eq!(only(&settings, 2, 3), [1, 2, 3]);
    assert_eq!(only(&settings, 1, 1), [0]);
}

#[test]
fn the_steakhouse_figure_of_the_source_is_reproduced() {
    // "down", k = 2, l = 5, no reaction delay, three steps of follow-through: steps 2, 3 and 4 go down.
    let settings = with(|s| {
        s.reaction_delay = ReactionDelay::Fixed(0);
        s.follow_through = FollowThrough::Fixed(3);
        s.interrupt = Interrupt::Finish;
        s.blocked_initiation = BlockedInitiation::Mask;
    });
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
fn row_d1_a_pending_reaction_waits() {
    let mut human = human(&HumanSettings::default());
    step(&mut human, start(A, 2, 2));
    step(&mut human, SpeechAct::Continue);
    human.begin_step();
    assert_eq!((human.pending(), human.reaction()), (Some(message(A, 2, 2)), None));
}

#[test]
fn row_d2_a_due_reaction_runs() {
    let mut human = human(&with(|s| s.reaction_delay = ReactionDelay::Fixed(0)));
    step(&mut human, start(A, 1, 2));
    human.begin_step();
    assert_eq!(human.pending(), None);
    assert_eq!(human.reaction(), Some(ReactionStep { topic: A, first: true }));
    human.acted(Some(ReactionStatus::Followed));
    assert_eq!(human.reaction(), Some(ReactionStep { topic: A, first: false }));
}

#[test]
fn row_d3_a_due_reaction_replaces_the_running_one() {
    let acts = [(0, start(A, 2, 5)), (3, start(B, 2, 2))];
    let [a, b] = acted_steps(&HumanSettings::default(), &acts, 20);
    assert_eq!((a, b), (vec![4, 5, 6], vec![7, 8]));
}

#[test]
fn row_d3_tells_the_world_that_the_replaced_reaction_is_over() {
    let mut human = human(&with(|s| s.reaction_delay = ReactionDelay::Fixed(0)));
    step(&mut human, start(A, 1, 5));
    step(&mut human, start(B, 1, 5));
    assert!(!human.take_reaction_over());
    human.begin_step();
    assert!(human.take_reaction_over());
    assert!(!human.take_reaction_over());
}

#[test]
fn row_d4_a_reaction_of_no_steps_comes_to_nothing() {
    let settings = with(|s| s.follow_through = FollowThrough::TwiceLengthMinusTwo);
    let mut human = human(&settings);
    for t in 0..8 {
        let act = if t == 0 { start(A, 1, 1) } else { SpeechAct::Continue };
        assert_eq!(step(&mut human, act), None);
    }
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
fn row_i2_a_message_cut_before_comprehension_never_counts() {
    let settings = with(|s| s.interrupt = Interrupt::Replace);
    let acts = [(0, start(A, 2, 2)), (1, start(B, 2, 2))];
    let [a, b] = acted_steps(&settings, &acts, 20);
    assert_eq!((a, b), (vec![], vec![5, 6]));
    let mut human = human(&settings);
    step(&mut human, start(A, 2, 2));
    step(&mut human, start(B, 2, 2));
    assert_eq!((human.tally().preempted, human.tally().started), (1, 2));
}

#[test]
fn row_i3_a_message_cut_after_comprehension_is_still_acted_upon() {
    for interrupt in [Interrupt::Replace, Interrupt::UntilComprehended] {
        let settings = with(|s| s.interrupt = interrupt);
        let acts = [(0, start(A, 2, 5)), (2, start(B, 4, 4))];
        let [a, b] = acted_steps(&settings, &acts, 20);
        assert_eq!((a, b), (vec![4, 5, 6, 7], vec![8, 9, 10, 11]));
        let mut human = human(&settings);
        for (_, act) in [(0, start(A, 1, 5)), (1, start(B, 4, 4))] {
            assert_eq!(step_in(&mut human, act, ReactionStatus::Followed).1, Initiation::Started);
        }
        assert_eq!((human.tally().preempted, human.tally().delivered), (0, 0));
    }
}

#[test]
fn row_i4_nothing_starts_before_comprehension() {
    let mut human = human(&HumanSettings::default());
    step(&mut human, start(A, 3, 4));
    assert!(!human.may_start());
    let (_, initiation) = step_in(&mut human, start(B, 2, 2), ReactionStatus::Followed);
    assert_eq!(initiation, Initiation::Blocked);
    assert_eq!(human.speech(), Some((message(A, 3, 4), 2)));
    assert_eq!((human.tally().ignored, human.tally().started), (1, 1));
}

#[test]
fn row_i5_nothing_starts_before_the_last_word() {
    let mut human = human(&with(|s| s.interrupt = Interrupt::Finish));
    step(&mut human, start(A, 1, 3));
    for _ in 0..2 {
        let (_, initiation) = step_in(&mut human, start(B, 2, 2), ReactionStatus::Followed);
        assert_eq!(initiation, Initiation::Blocked);
    }
    assert_eq!(human.apply(start(B, 2, 2)), Initiation::Started);
}

#[test]
fn row_i6_a_repetition_continues_what_is_under_way() {
    let settings = with(|s| {
        s.repeat = Repeat::Continue;
        s.interrupt = Interrupt::Replace;
    });
    let mut human = human(&settings);
    // Spoken at 0 and 1, pending at 2 and 3, running from 4 to 5.
    step(&mut human, start(A, 2, 2));
    for t in 1..6 {
        let (_, initiation) = step_in(&mut human, start(A, 2, 2), ReactionStatus::Followed);
        assert_eq!(initiation, Initiation::Continued, "at {t}");
    }
    let (_, initiation) = step_in(&mut human, start(A, 2, 2), ReactionStatus::Followed);
    assert_eq!(initiation, Initiation::Started);
    assert_eq!((human.tally().continued, human.tally().started), (5, 2));
}

#[test]
fn a_repetition_restarts_by_default() {
    let mut human = human(&with(|s| s.interrupt = Interrupt::Replace));
    step(&mut human, start(A, 2, 2));
    step(&mut human, start(A, 2, 2));
    assert_eq!((human.tally().continued, human.tally().preempted), (0, 1));
}

#[test]
fn row_i7_a_start_can_cancel_what_is_pending() {
    let settings = with(|s| s.pending = PendingRule::CancelOnInitiation);
    let acts = [(0, start(A, 2, 2)), (3, start(B, 2, 2))];
    let [a, b] = acted_steps(&settings, &acts, 20);
    assert_eq!((a, b), (vec![], vec![7, 8]));
}

#[test]
fn row_i8_a_start_can_cancel_what_runs() {
    let settings = with(|s| s.running = RunningRule::CancelOnInitiation);
    let acts = [(0, start(A, 2, 5)), (5, start(B, 2, 2))];
    let [a, b] = acted_steps(&settings, &acts, 20);
    assert_eq!((a, b), (vec![4], vec![9, 10]));
}

#[test]
fn row_i8_a_reaction_cancelled_before_its_first_step_counts_as_overwritten() {
    let settings = with(|s| s.running = RunningRule::CancelOnInitiation);
    let mut human = human(&settings);
    for t in 0..5 {
        let act = [(0, start(A, 2, 2)), (4, start(B, 2, 2))].into_iter().find(|o| o.0 == t);
        assert_eq!(step(&mut human, act.map_or(SpeechAct::Continue, |o| o.1)), None);
    }
    assert_eq!((human.tally().overwritten, human.take_reaction_over()), (1, false));
}

#[test]
fn row_i9_immediate_comprehension_still_obeys_the_delay() {
    let settings = with(|s| s.comprehension = Comprehension::Immediate);
    assert_eq!(only(&settings, 3, 3), [2, 3, 4]);
}

#[test]
fn rows_s_stop_breaks_off_speech() {
    let settings = with(|s| s.can_stop = true);
    let mut human = human(&settings);
    assert_eq!(step_in(&mut human, SpeechAct::Stop, ReactionStatus::Followed).1, Initiation::None);
    step(&mut human, start(A, 2, 4));
    assert!(human.may_stop());
    let (_, initiation) = step_in(&mut human, SpeechAct::Stop, ReactionStatus::Followed);
    assert_eq!((initiation, human.speech()), (Initiation::Stopped, None));
    assert_eq!((human.tally().preempted, human.pending()), (1, None));

    step(&mut human, start(A, 1, 4));
    step(&mut human, SpeechAct::Stop);
    assert_eq!((human.tally().preempted, human.tally().delivered), (1, 0));
    assert_eq!(human.pending(), Some(message(A, 1, 4)));
}

#[test]
fn row_s3_stop_needs_its_setting() {
    let mut human = human(&HumanSettings::default());
    step(&mut human, start(A, 2, 4));
    let (_, initiation) = step_in(&mut human, SpeechAct::Stop, ReactionStatus::Followed);
    assert_eq!((initiation, human.may_stop()), (Initiation::None, false));
    assert_eq!(human.speech(), Some((message(A, 2, 4), 2)));
}

#[test]
fn rows_a1_a2_refused_steps_use_up_the_reaction() {
    let settings = with(|s| s.reaction_delay = ReactionDelay::Fixed(0));
    let mut human = human(&settings);
    step(&mut human, start(A, 1, 2));
    for _ in 0..2 {
        assert!(!human.take_reaction_over());
        assert_eq!(step_in(&mut human, SpeechAct::Continue, ReactionStatus::Refused).0, Some(A));
    }
    assert!(human.take_reaction_over());
    assert_eq!(step(&mut human, SpeechAct::Continue), None);
    assert_eq!((human.tally().unheeded, human.tally().followed), (1, 0));
}

#[test]
fn row_a3_the_world_can_end_a_reaction() {
    let settings = with(|s| s.reaction_delay = ReactionDelay::Fixed(0));
    let mut human = human(&settings);
    step(&mut human, start(A, 1, 5));
    step_in(&mut human, SpeechAct::Continue, ReactionStatus::Ended);
    assert!(human.take_reaction_over());
    assert_eq!(step(&mut human, SpeechAct::Continue), None);
    assert_eq!(human.tally().followed, 1);
}

#[test]
fn row_c1_comprehension_makes_pending() {
    let mut human = human(&HumanSettings::default());
    human.apply(start(A, 2, 3));
    assert_eq!(human.hear_word(), None);
    assert_eq!(human.hear_word(), None);
    assert_eq!((human.pending(), human.tally().comprehended), (Some(message(A, 2, 3)), 1));
}

#[test]
fn row_c2_the_next_comprehension_takes_the_slot() {
    let settings = with(|s| s.reaction_delay = ReactionDelay::Fixed(3));
    let acts = [(0, start(A, 2, 2)), (2, start(B, 2, 2))];
    let [a, b] = acted_steps(&settings, &acts, 20);
    assert_eq!((a, b), (vec![], vec![7, 8]));
    let mut human = human(&settings);
    for t in 0..4 {
        step(
            &mut human,
            [start(A, 2, 2), SpeechAct::Continue, start(B, 2, 2), SpeechAct::Continue][t],
        );
    }
    assert_eq!(human.tally().overwritten, 1);
}

#[test]
fn row_c5_a_reaction_that_is_due_when_the_next_is_comprehended_is_not_lost() {
    // A is due at time 4, the end of step 3, when B is comprehended: messages at a distance of the delay all count.
    let acts = [(0, start(A, 2, 2)), (2, start(B, 2, 2))];
    let [a, b] = acted_steps(&HumanSettings::default(), &acts, 20);
    assert_eq!((a, b), (vec![4, 5], vec![6, 7]));
}

#[test]
fn row_c3_a_queue_keeps_both() {
    let settings = with(|s| {
        s.reaction_delay = ReactionDelay::Fixed(3);
        s.pending = PendingRule::Queue;
    });
    let acts = [(0, start(A, 2, 2)), (2, start(B, 2, 2))];
    let [a, b] = acted_steps(&settings, &acts, 20);
    assert_eq!((a, b), (vec![5, 6], vec![7, 8]));
}

#[test]
fn row_c4_comprehension_can_end_what_runs() {
    let settings = with(|s| s.running = RunningRule::CancelOnComprehension);
    let acts = [(0, start(A, 2, 5)), (4, start(B, 2, 2))];
    let [a, b] = acted_steps(&settings, &acts, 20);
    assert_eq!((a, b), (vec![4, 5], vec![8, 9]));
}

#[test]
fn row_l1_the_last_word_delivers() {
    let mut human = human(&HumanSettings::default());
    human.apply(start(A, 2, 3));
    human.hear_word();
    assert_eq!(human.hear_word(), None);
    assert_eq!(human.hear_word(), Some(message(A, 2, 3)));
    assert_eq!((human.speech(), human.tally().delivered), (None, 1));
}

#[test]
fn row_l1_speech_that_does_not_occupy_is_over_once_understood() {
    let mut human = human(&with(|s| s.occupies = false));
    human.apply(start(A, 2, 5));
    human.hear_word();
    assert_eq!(human.hear_word(), Some(message(A, 2, 5)));
    assert_eq!(human.tally().comprehended, 1);
    assert_eq!(human.speech(), None);
}

#[test]
fn row_l2_a_delivery_can_cancel_the_running_reaction_but_not_the_pending_one() {
    let mut human = human(&HumanSettings::default());
    for t in 0..6 {
        step(&mut human, if t == 0 { start(A, 2, 5) } else { SpeechAct::Continue });
    }
    human.apply(start(B, 1, 2));
    human.hear_word();
    human.cancel_reaction();
    assert!(human.take_reaction_over());
    assert_eq!((human.reaction(), human.pending()), (None, Some(message(B, 1, 2))));
}

#[test]
fn the_reaction_reward_is_paid_as_set() {
    let paid = |reaction_reward, statuses: [ReactionStatus; 3]| -> Vec<f64> {
        let settings = with(|s| {
            s.reaction_reward = reaction_reward;
            s.reaction_delay = ReactionDelay::Fixed(0);
            s.follow_through = FollowThrough::Fixed(3);
        });
        let mut human = human(&settings);
        step(&mut human, start(A, 1, 5));
        human.begin_step();
        statuses.map(|status| human.acted(Some(status))).to_vec()
    };
    assert_eq!(paid(ReactionReward::Off, [Followed; 3]), [0.0, 0.0, 0.0]);
    assert_eq!(paid(ReactionReward::Once, [Refused, Followed, Followed]), [0.0, 3.0, 0.0]);
    assert_eq!(paid(ReactionReward::PerStep, [Followed, Refused, Followed]), [3.0, 0.0, 3.0]);
}
