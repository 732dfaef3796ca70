use super::*;
use crate::human::Interrupt;

const TOPICS: &[&str] = &["up", "down"];

fn session(human: &HumanSettings) -> Session {
    let mut session = Session::new(1, TOPICS, human, &NotifierSettings::default()).unwrap();
    session.begin(|observation| observation[0] = 0.5);
    session
}

fn start(topic: usize) -> SpeechAct {
    SpeechAct::Start(Message { topic, comprehension: 2, conveyance: 3 })
}

fn act(session: &mut Session, act: SpeechAct) -> Initiation {
    let initiation = session.initiation_of(act);
    session.carry_out(act, initiation);
    session.hear_word();
    session.observe(|observation| observation[0] = 0.5);
    initiation
}

#[test]
fn the_rules_of_speech_are_those_of_the_listener() {
    let of = |interrupt| HumanSettings { interrupt, can_stop: true, ..HumanSettings::default() };
    for (interrupt, after_one, after_two) in [
        (Interrupt::Replace, Initiation::Started, Initiation::Started),
        (Interrupt::UntilComprehended, Initiation::Blocked, Initiation::Started),
        (Interrupt::Finish, Initiation::Blocked, Initiation::Blocked),
    ] {
        let mut session = session(&of(interrupt));
        assert_eq!(session.initiation_of(SpeechAct::Stop), Initiation::None);
        assert_eq!(act(&mut session, start(0)), Initiation::Started);
        assert_eq!(session.initiation_of(start(1)), after_one);
        assert_eq!(act(&mut session, SpeechAct::Continue), Initiation::None);
        assert!(session.speech().unwrap().understood);
        assert_eq!(session.initiation_of(start(1)), after_two);
        assert_eq!(act(&mut session, SpeechAct::Stop), Initiation::Stopped);
        assert_eq!(session.speech(), None);
    }
    let mut patient = session(&HumanSettings {
        repeat: Repeat::Continue,
        interrupt: Interrupt::Replace,
        ..HumanSettings::default()
    });
    act(&mut patient, start(0));
    let judged = [start(0), start(1), SpeechAct::Stop].map(|act| patient.initiation_of(act));
    assert_eq!(judged, [Initiation::Continued, Initiation::Started, Initiation::None]);
    assert!(patient.is_blind_to_repeats());
}

#[test]
fn an_utterance_is_over_with_its_last_word_or_when_nobody_listens() {
    let mut session = session(&HumanSettings::default());
    session.carry_out(start(1), Initiation::Started);
    assert_eq!([session.hear_word(), session.hear_word()], [None; 2]);
    assert_eq!(session.hear_word().map(|message| message.topic), Some(1));
    assert_eq!((session.speech(), session.hear_word()), (None, None));
    session.carry_out(start(0), Initiation::Started);
    session.fall_silent();
    assert_eq!((session.speech(), session.hear_word()), (None, None));
}

#[test]
fn a_state_goes_on_bit_for_bit_and_another_notifiers_is_refused() {
    let mut session = session(&HumanSettings::default());
    act(&mut session, start(1));
    session.carry_out(SpeechAct::Continue, Initiation::None);
    let state = session.state();
    let mut other = self::session(&HumanSettings::default());
    assert!(other.restore(&state));
    let mut rows = [vec![0.0; session.row_dim()], vec![1.0; session.row_dim()]];
    for (session, row) in [&mut session, &mut other].into_iter().zip(&mut rows) {
        session.hear_word();
        session.observe(|observation| observation[0] = 0.25);
        session.write_row(row);
    }
    assert_eq!(rows[0], rows[1]);
    assert_eq!(session.mask(), other.mask());
    let wide = Session::new(2, TOPICS, &HumanSettings::default(), &NotifierSettings::default());
    assert!(!wide.unwrap().restore(&state));
    let odd = SessionState { history: vec![f32::NAN; state.history.len()], ..state.clone() };
    assert!(!other.restore(&odd));
    let message = Message { topic: 9, comprehension: 2, conveyance: 3 };
    let speech = Some(SpokenMessage { message, heard: 0, understood: false });
    assert!(!other.restore(&SessionState { speech, ..state }));
}
