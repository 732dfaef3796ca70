use leadtime_link::live::ArrivalEncoding;
use leadtime_policy::Parameters;
use leadtime_proto::{PolicySpec, TaskSpec};
use leadtime_sims::notifier::initial_bias;
use leadtime_taxonomy::words;
use leadtime_voice::WordTime;
use serde_json::{Value, json};

use super::*;
use crate::observation::{ObservationHead, write_json, write_raw};
use crate::say::HeardSay;

const MS: u64 = 1_000_000;
/// The moment at which a session is opened.
const OPENED: u64 = 3_600_000 * MS;

/// Everything that was told, with the moment.
#[derive(Debug, Default)]
struct Told {
    now: u64,
    says: Vec<(u64, HeardSay)>,
    statuses: Vec<(u64, Value)>,
    played: Vec<String>,
    n_hushed: usize,
}

impl SayTo for Told {
    fn say(&mut self, bytes: &[u8]) {
        self.says.push((self.now, HeardSay::read(bytes).expect("an event can be read")));
    }
    fn status(&mut self, bytes: &[u8]) {
        self.statuses.push((self.now, serde_json::from_slice(bytes).expect("a status is JSON")));
    }
    fn play(&mut self, sentence: &Arc<SpokenSentence>) {
        self.played.push(sentence.text.clone());
    }
    fn hush(&mut self) {
        self.n_hushed += 1;
    }
}

/// A notifier that starts a message in every step that offers one, or in none.
fn policy(talks: bool) -> WorkingPolicy {
    policy_with(if talks { 50.0 } else { -50.0 })
}

fn policy_with(initiate_bias: f64) -> WorkingPolicy {
    let task = TaskSpec { domain: "lander".to_owned(), settings: "{}".to_owned() };
    let env = leadtime_worlds::builtin().build(&task).unwrap();
    let logit_bias = initial_bias(&env.spec().actions, initiate_bias, 0.0);
    let spec = PolicySpec { logit_bias, ..PolicySpec::dense(env.spec(), &[8]) };
    let parameters = Parameters::initialize(&spec, 1).unwrap();
    let words = leadtime_taxonomy::shipped("lander").unwrap();
    let choice = leadtime_episodes::Choice::Sample;
    WorkingPolicy::new("lander", env.as_ref(), &spec, &parameters, choice, Some(words)).unwrap()
}

/// A session with its client.
struct Bench {
    session: LiveSession,
    decider: LiveDecider,
    told: Told,
    seq: u64,
    n: usize,
}

impl Bench {
    fn open(talks: bool, question: &Value) -> Self {
        Self::open_with(&policy(talks), question)
    }

    /// A session whose notifier has a voice: the words of a sentence take 100, 200, 300 ms and so on, with a pause of 50 ms
    /// after the first.
    fn open_with_voice(question: &Value) -> Self {
        let policy = policy(true);
        let spoken = |text: &str| {
            let n = words::count(text);
            let pause = |i: u32| if i > 0 { 50 } else { 0 };
            let end = |i: u32| 50 * (i + 1) * (i + 2) + pause(i);
            let time = |i: u32| WordTime {
                begin: if i == 0 { 0 } else { end(i - 1) + 50 - pause(i - 1) },
                end: end(i),
            };
            SpokenSentence {
                words: (0..n).map(time).collect(),
                is_estimated: false,
                ..SpokenSentence::unheard(text)
            }
        };
        let sentences: Vec<SpokenSentence> = policy.sentences().map(spoken).collect();
        assert!(sentences.iter().all(SpokenSentence::has_words_in_order));
        let book = VoiceBook::new("test".to_owned(), sentences);
        Self::open_with(&policy.with_voice(Some(book)), question)
    }

    /// A session of the first seed of which this holds, with one observation.
    fn such_that(initiate_bias: f64, question: &Value, holds: impl Fn(&mut Self) -> bool) -> Self {
        let policy = policy_with(initiate_bias);
        let observed = |seed| {
            let mut bench = Self::seeded(&policy, question, seed);
            bench.observe();
            holds(&mut bench).then_some(bench)
        };
        (1..1_000).find_map(observed).expect("it holds of some seed")
    }

    /// A session whose first message has two words until it is understood, and is followed by none.
    fn two_words(question: &Value) -> Self {
        Self::such_that(0.0, question, |bench| {
            bench.until(640);
            let says = &bench.told.says;
            says.first().is_some_and(|(_, say)| say.k == 2 && say.l > 2)
                && says.iter().all(|(_, say)| say.utterance == 1)
        })
    }

    fn open_with(policy: &WorkingPolicy, question: &Value) -> Self {
        Self::seeded(policy, question, 7)
    }

    fn seeded(policy: &WorkingPolicy, question: &Value, seed: u64) -> Self {
        let mut whole = json!({"protocol": 1, "domain": "lander"});
        for (key, value) in question.as_object().unwrap() {
            whole[key] = value.clone();
        }
        let plan = SessionPlan::read(whole.to_string().as_bytes(), policy, seed).unwrap();
        let decider = policy.decider();
        let session = LiveSession::new("s1".to_owned(), plan, policy, &decider, OPENED);
        let told = Told { now: OPENED, ..Told::default() };
        Self { session, decider, told, seq: 0, n: policy.obs_dim() }
    }

    /// Lets everything happen that is due until a moment, in milliseconds after the opening.
    fn until(&mut self, ms: u64) {
        let end = OPENED + ms * MS;
        while self.session.next_deadline() <= end {
            let now = self.session.next_deadline().max(self.told.now);
            self.told.now = now;
            self.session.tick(now, &mut self.decider, &mut self.told);
        }
        self.told.now = end;
    }

    fn arrive(&mut self, encoding: &ArrivalEncoding, bytes: &[u8], beside: Option<&[u8]>) {
        let now = self.told.now;
        let bytes = ObservationBytes { encoding, payload: bytes, beside };
        self.session.arrive(now, now, bytes, &mut self.decider, &mut self.told);
        self.session.tick(now, &mut self.decider, &mut self.told);
    }

    fn json(&mut self, bytes: &[u8]) {
        self.arrive(&ArrivalEncoding::Json, bytes, None);
    }

    fn head(&mut self) -> ObservationHead {
        self.seq += 1;
        let t = (self.told.now - OPENED) as f64 * 1e-9;
        ObservationHead { seq: self.seq, t, episode: 0, end: false }
    }

    /// Sends an observation now.
    fn observe(&mut self) {
        let head = self.head();
        self.send(&head);
    }

    fn send(&mut self, head: &ObservationHead) {
        self.json(&write_json(head, &vec![0.1; self.n]));
    }

    /// Sends an observation every 50 ms, from one moment to another.
    fn observe_from_to(&mut self, from: u64, to: u64) {
        for ms in (from..=to).step_by(50) {
            self.until(ms);
            self.observe();
        }
    }

    fn events(&self) -> Vec<SayEvent> {
        self.told.says.iter().map(|(_, say)| say.event).collect()
    }

    fn state(&self) -> LiveState {
        self.session.state()
    }

    fn last_status(&self) -> &Value {
        &self.told.statuses.last().expect("a status was told").1
    }

    /// Returns what was told about messages.
    fn told_of_messages(&self) -> Vec<String> {
        let told = self.told.statuses.iter().map(|(_, status)| status["told"].as_str().unwrap());
        told.filter(|told| !told.is_empty()).map(str::to_owned).collect()
    }
}

#[test]
fn words_come_at_the_pace_of_steps_and_an_understood_message_may_be_followed() {
    let mut bench = Bench::open(true, &json!({}));
    bench.observe_from_to(0, 2_000);
    let first = &bench.told.says[0];
    assert_eq!((first.0, first.1.event, first.1.utterance), (OPENED, SayEvent::Start, 1));
    let (k, l) = (first.1.k, first.1.l);
    assert!(first.1.text.split_whitespace().count() as u32 >= l);
    for (word, (at, say)) in bench.told.says.iter().take(k as usize).enumerate() {
        assert_eq!((*at, say.heard), (OPENED + word as u64 * 300 * MS, word as u32));
        assert_eq!(say.utterance, 1);
        assert!(say.age <= 0.05);
    }
    assert_eq!(bench.state(), LiveState::Speaking);
    assert_eq!(bench.last_status()["why"], "");
}

#[test]
fn silence_has_a_reason() {
    let mut bench = Bench::open(false, &json!({}));
    bench.until(100);
    assert_eq!(bench.last_status()["state"], "waiting");
    assert_eq!(bench.last_status()["why"], "no observation has come yet");
    bench.observe_from_to(150, 500);
    assert_eq!(bench.last_status()["state"], "silent");
    assert_eq!(bench.last_status()["why"], "the policy has nothing to say");
    assert_eq!(bench.told.says, []);
    bench.until(4_000);
    assert!(bench.told.statuses.len() > 4, "one a second");
}

#[test]
fn a_message_not_yet_understood_is_cut_when_its_observation_is_stale() {
    // Three words or more are said before it is understood.
    let mut bench = Bench::such_that(50.0, &json!({}), |bench| bench.told.says[0].1.k > 2);
    bench.observe_from_to(50, 100);
    let k = bench.told.says[0].1.k;
    bench.until(5_000);
    // Stale 600 ms after the last one: two or three words were said.
    let cut = bench.told.says.iter().find(|(_, say)| say.event == SayEvent::Cut);
    let stale_at = OPENED + 700 * MS;
    let (at, say) = cut.expect("it is cut");
    assert!((stale_at..stale_at + 2 * MS).contains(at) && say.heard < k, "{say:?}");
    for (at, say) in &bench.told.says {
        let is_fresh = *at <= stale_at + MS;
        assert!(is_fresh || say.heard >= say.k, "{say:?} at {}", (at - OPENED) / MS);
    }
    let n_started = bench.events().iter().filter(|event| **event == SayEvent::Start).count();
    assert_eq!(n_started, 1, "nothing new starts");
    assert_eq!(bench.state(), LiveState::Lost);
    assert_eq!(bench.last_status()["why"], "no observation has come for 1.2 s");
    let states: Vec<_> = bench.told.statuses.iter().map(|(_, status)| &status["state"]).collect();
    assert!(states.contains(&&json!("stale")));
}

#[test]
fn an_understood_message_is_finished_on_a_stale_observation_and_cut_on_a_lost_one() {
    // Two words are heard by then.
    let mut bench = Bench::two_words(&json!({"stale_after": 0.65, "lost_after": 100}));
    bench.until(10_000);
    let last = &bench.told.says.last().unwrap().1;
    assert_eq!((last.event, bench.state()), (SayEvent::End, LiveState::Stale));
    let mut bench = Bench::two_words(&json!({"stale_after": 0.65, "lost_after": 0.65}));
    bench.until(10_000);
    let (at, last) = bench.told.says.last().unwrap();
    assert_eq!(last.event, SayEvent::Cut);
    assert!((at - OPENED) / MS <= 651);
}

#[test]
fn a_client_that_is_gone_is_not_spoken_to_and_may_come_back() {
    let mut bench = Bench::open(true, &json!({}));
    bench.observe_from_to(0, 100);
    bench.session.note_presence(false);
    bench.until(100);
    assert_eq!(bench.events().last(), Some(&SayEvent::Cut));
    assert_eq!((bench.state(), &bench.session.why), (LiveState::Lost, &Silence::ClientGone));
    bench.until(20_000);
    let n = bench.told.says.len();
    bench.observe();
    assert_eq!(bench.state(), LiveState::Speaking);
    let step = bench.told.says[n].1.step;
    assert!(step > 0, "the past is kept");
    bench.session.note_presence(false);
    bench.until(20_001);
    bench.session.tick(bench.told.now, &mut bench.decider, &mut bench.told);
    bench.until(60_000);
    let n = bench.told.says.len();
    bench.observe();
    assert_eq!(bench.told.says[n].1.step, 0, "after 30 s it is a new episode");
}

#[test]
fn a_simulator_that_is_gone_is_noticed_at_once() {
    let mut bench = Bench::open(true, &json!({"clock": "observation"}));
    bench.observe();
    bench.until(400);
    bench.session.note_presence(false);
    bench.until(400);
    assert_eq!((bench.events().last(), bench.state()), (Some(&SayEvent::Cut), LiveState::Lost));
    bench.until(3_000);
    assert_eq!(bench.events().last(), Some(&SayEvent::Cut));
}

#[test]
fn numbers_out_of_order_are_dropped_and_gaps_counted() {
    let mut bench = Bench::open(false, &json!({}));
    bench.observe_from_to(0, 200);
    let head = ObservationHead { seq: 2, t: 0.2, episode: 0, end: false };
    bench.send(&head);
    bench.send(&ObservationHead { seq: 5, ..head });
    let head = ObservationHead { seq: 9, ..head };
    bench.send(&head);
    let counts = bench.session.counts();
    assert_eq!((counts.out_of_order, counts.missed, counts.refused), (2, 3, 0));
    bench.json(&write_json(&head, &vec![0.2; bench.n]));
    bench.send(&ObservationHead { seq: 10, t: 0.1, ..head });
    assert_eq!(bench.session.counts().refused, 2);
    bench.until(1_000);
    let told = bench.told_of_messages().join("; ");
    assert!(told.contains("`t` went back from 0.2 to 0.1"), "{told}");
    assert_eq!(bench.session.last_seq(), 9);
}

#[test]
fn a_client_that_counts_from_the_beginning_again_is_told_that_nothing_is_taken() {
    let mut bench = Bench::open(false, &json!({}));
    let head = ObservationHead { seq: 1_000, t: 0.2, episode: 0, end: false };
    bench.send(&head);
    // One that comes again and again is no older than the newest.
    (0..2 * MAX_REFUSED).for_each(|_| bench.send(&head));
    (1..u64::from(MAX_REFUSED)).for_each(|seq| bench.send(&ObservationHead { seq, ..head }));
    bench.until(1_500);
    assert!(bench.told_of_messages().is_empty(), "{:?}", bench.told_of_messages());
    bench.send(&ObservationHead { seq: 16, ..head });
    bench.until(3_000);
    let told = bench.told_of_messages().join("; ");
    let says = "16 observations in a row have numbers below 1000, which was taken, and are passed over: the last has 16; \
                count on from `last_seq`, or open a new session";
    assert_eq!(told, says);
    assert_eq!(bench.session.counts().refused, 0);
}

#[test]
fn unusable_observations_are_reported_and_sixteen_in_a_row_end_the_session() {
    let mut bench = Bench::open(true, &json!({}));
    bench.observe();
    let n = bench.n;
    for (bytes, told) in [
        (write_json(&bench.head(), &vec![0.0; n - 1]), "has 7 numbers; 8 are expected"),
        (b"{\"seq\":3,\"t\":0.1,\"obs\":[NaN]}".to_vec(), "NaN or Infinity"),
        (b"\xff".to_vec(), "cannot be read"),
    ] {
        bench.json(&bytes);
        bench.until((bench.told.now - OPENED) / MS + 25);
        let last = bench.told_of_messages().pop().unwrap();
        assert!(last.contains(told), "{last}");
    }
    let (numbers, mut beside) = write_raw(&bench.head(), &vec![0.0; n]);
    beside[33] ^= 1;
    bench.arrive(&ArrivalEncoding::Binary, &numbers, Some(&beside));
    bench.arrive(&ArrivalEncoding::Binary, &numbers, None);
    bench.arrive(&ArrivalEncoding::Other("text/csv".to_owned()), b"1,2", None);
    assert_eq!(bench.session.counts().refused, 6);
    bench.observe();
    assert_eq!(bench.state(), LiveState::Speaking, "one good one makes up for it");
    for _ in 0..MAX_REFUSED {
        bench.json(b"{}");
    }
    assert_eq!(bench.state(), LiveState::Closed);
    assert_eq!(bench.events().last(), Some(&SayEvent::Cut));
    let why = bench.last_status()["why"].as_str().unwrap().to_owned();
    assert!(why.starts_with("16 messages in a row could not be used; open a new session"), "{why}");
    assert!(bench.session.end(bench.told.now, &mut bench.told).is_some());
    let n = bench.told.says.len();
    bench.observe();
    bench.until(60_000);
    assert_eq!(bench.told.says.len(), n);
}

#[test]
fn a_session_to_which_nothing_comes_for_ten_minutes_says_that_it_is_closed() {
    let ended = ObservationHead { seq: 1, t: 0.0, episode: 0, end: true };
    let begun = ObservationHead { end: false, ..ended };
    for (sent, state) in [
        (None, LiveState::Waiting),
        (Some(begun), LiveState::Lost),
        (Some(ended), LiveState::Ended),
    ] {
        let mut bench = Bench::open(true, &json!({}));
        if let Some(head) = &sent {
            bench.send(head);
        }
        bench.until(600_000);
        assert_eq!(bench.session.end(bench.told.now, &mut bench.told), None);
        assert_eq!(bench.state(), state);
        bench.until(602_000);
        let why = bench.session.end(bench.told.now, &mut bench.told);
        assert_eq!(why, Some(&Silence::Forgotten), "{state:?}");
        assert_eq!(bench.last_status()["state"], "closed");
        let why = "no observation has been taken for ten minutes; open a new session";
        assert_eq!(bench.last_status()["why"], why);
        // What may be kept of it after its end has no past to go on from either.
        assert!(!bench.session.snapshot(bench.told.now).is_begun);
    }
}

#[test]
fn raw_observations_are_taken_as_json_is() {
    let mut bench = Bench::open(true, &json!({"clock": "observation", "encoding": "binary"}));
    let (numbers, beside) = write_raw(&bench.head(), &vec![0.1; bench.n]);
    bench.arrive(&ArrivalEncoding::Binary, &numbers, Some(&beside));
    let mut written = Bench::open(true, &json!({"clock": "observation"}));
    written.observe();
    let [raw, json] = [&bench, &written].map(|bench| bench.told.says[0].1.clone());
    assert_eq!((raw.event, raw.k, raw.l), (SayEvent::Start, json.k, json.l));
    let topic = bench.session.notifier.topics()[usize::from(raw.topic_id.unwrap())];
    assert_eq!((topic, raw.last, json.last), (json.topic.as_str(), true, true));
}

#[test]
fn a_number_in_another_unit_is_strange_and_told_once() {
    let mut bench = Bench::open(false, &json!({}));
    bench.observe();
    let mut far = vec![0.1; bench.n];
    far[0] = 5_000.0;
    for ms in [50, 100, 150] {
        bench.until(ms);
        let head = bench.head();
        bench.json(&write_json(&head, &far));
    }
    bench.until(400);
    assert_eq!(bench.session.counts().strange, 3);
    let told = bench.told_of_messages();
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].contains("`x` is 5000, far from its range"), "{told:?}");
}

#[test]
fn a_listener_whose_episode_has_ended_is_not_spoken_to() {
    let mut bench = Bench::open(true, &json!({}));
    bench.observe_from_to(0, 100);
    let head = ObservationHead { end: true, ..bench.head() };
    bench.send(&head);
    assert_eq!(bench.events().last(), Some(&SayEvent::Cut));
    let n = bench.told.says.len();
    bench.observe_from_to(150, 3_000);
    assert_eq!((bench.told.says.len(), bench.state()), (n, LiveState::Ended));
    let why = "the episode has ended; a new one has another number";
    assert_eq!(bench.last_status()["why"], why);
    let head = ObservationHead { episode: 1, ..bench.head() };
    bench.send(&head);
    let (_, start) = &bench.told.says[n];
    assert_eq!((start.event, start.step, start.episode), (SayEvent::Start, 0, 1));
    // Another number alone ends an episode, too.
    let head = ObservationHead { episode: 2, ..bench.head() };
    bench.send(&head);
    let last: Vec<_> = bench.told.says[n + 1..].iter().map(|(_, say)| say.event).collect();
    assert_eq!(last, [SayEvent::Cut, SayEvent::Start]);
}

#[test]
fn an_observation_held_up_on_its_way_is_old() {
    let mut bench = Bench::open(true, &json!({}));
    bench.observe_from_to(0, 200);
    bench.until(5_000);
    assert_eq!(bench.state(), LiveState::Lost);
    let n = bench.told.says.len();
    // A frozen process finds it in its buffers.
    let head = ObservationHead { seq: 100, t: 0.25, episode: 0, end: false };
    bench.send(&head);
    let started = bench.told.says[n..].iter().any(|(_, say)| say.event == SayEvent::Start);
    assert!(!started, "{:?}", &bench.told.says[n..]);
}

#[test]
fn with_the_clock_of_observations_every_one_is_answered() {
    for talks in [false, true] {
        let mut bench = Bench::open(talks, &json!({"clock": "observation"}));
        for seq in 1..=20 {
            bench.observe();
            let answers: Vec<_> =
                bench.told.says.iter().filter(|(_, say)| say.seq == seq).collect();
            let n_last = answers.iter().filter(|(_, say)| say.last).count();
            assert_eq!(n_last, 1, "{answers:?}");
            assert!(answers.last().unwrap().1.last);
        }
        assert_eq!(bench.session.counts().steps, 20);
        assert_eq!(bench.events().contains(&SayEvent::Silent), !talks);
        // Missed ones are steps in which nothing new was seen.
        let head = ObservationHead { seq: 24, ..bench.head() };
        bench.send(&head);
        assert_eq!(bench.session.counts().steps, 21);
        assert_eq!(bench.told.says.last().unwrap().1.step, 23);
    }
}

#[test]
fn what_the_loudspeaker_reports_counts_instead_of_the_clock() {
    let mut bench = Bench::open(true, &json!({}));
    bench.observe();
    let (number, l) = (bench.told.says[0].1.utterance, bench.told.says[0].1.l);
    let report = |bench: &mut Bench, event: &str, word: u32| {
        let report = json!({"utterance": number, "event": event, "word": word, "t": 0.1});
        let now = bench.told.now;
        let text = report.to_string();
        bench.session.hear(now, text.as_bytes(), &mut bench.decider, &mut bench.told);
    };
    report(&mut bench, "start", 0);
    bench.observe_from_to(50, 950);
    // Three steps, and not a word: the loudspeaker is slow.
    assert_eq!(bench.session.notifier.speech().unwrap().heard, 0);
    report(&mut bench, "word", 1);
    assert_eq!(bench.session.notifier.speech().unwrap().heard, 1);
    assert_eq!(bench.told.says.last().unwrap().1.event, SayEvent::Word);
    report(&mut bench, "end", 0);
    assert_eq!(bench.told.says.last().unwrap().1.event, SayEvent::End);
    assert_eq!(bench.told.says.last().unwrap().1.heard, l);
    report(&mut bench, "end", 0);
    bench.session.hear(bench.told.now, b"noise", &mut bench.decider, &mut bench.told);
    assert_eq!(bench.session.counts().refused, 1);
    bench.observe_from_to(1_000, 1_250);
    let n = bench.told.says.iter().filter(|(_, say)| say.event == SayEvent::Start).count();
    assert_eq!(n, 2, "the next message starts with the next step");
}

#[test]
fn with_the_clock_of_words_a_step_is_taken_where_a_word_begins() {
    let mut bench = Bench::open(true, &json!({"clock": "word"}));
    bench.observe();
    let number = bench.told.says[0].1.utterance;
    bench.until(120);
    let report = json!({"utterance": number, "event": "word", "word": 1}).to_string();
    let now = bench.told.now;
    bench.session.hear(now, report.as_bytes(), &mut bench.decider, &mut bench.told);
    assert_eq!(bench.session.counts().steps, 2);
    bench.until(419);
    assert_eq!(bench.session.counts().steps, 2);
    bench.until(420);
    assert_eq!(bench.session.counts().steps, 3);
}

#[test]
fn a_restarted_notifier_goes_on_with_the_same_decisions() {
    let question = json!({"clock": "observation"});
    let mut bench = Bench::open(true, &question);
    (0..30).for_each(|_| bench.observe());
    // Between two utterances nothing is lost.
    while bench.session.notifier.speech().is_some() {
        bench.observe();
        if bench.events().last() == Some(&SayEvent::Start) {
            break;
        }
    }
    bench.session.cut(bench.told.now, &mut bench.told);
    bench.session.release(true, &mut bench.told);
    let snapshot = bench.session.snapshot(bench.told.now);
    let mut restarted = Bench::open(true, &question);
    assert!(restarted.session.restore(snapshot));
    restarted.seq = bench.seq;
    let n = bench.told.says.len();
    for _ in 0..30 {
        bench.observe();
        restarted.observe();
    }
    let said = |says: &[(u64, HeardSay)]| -> Vec<_> {
        says.iter().map(|(_, say)| (say.event, say.step, say.k, say.l, say.text.clone())).collect()
    };
    assert_eq!(said(&bench.told.says[n..]), said(&restarted.told.says));
    let first = restarted.told.says.iter().find(|(_, say)| say.utterance > 0).unwrap();
    assert!(first.1.utterance > bench.told.says[n - 1].1.utterance);
    // Too late, only the numbers go on.
    let mut late = Bench::open(true, &question);
    assert!(late.session.restore(bench.session.snapshot(bench.told.now)));
    late.session.forget();
    late.seq = bench.seq;
    late.observe();
    assert_eq!((late.told.says[0].1.step, late.session.last_seq()), (0, bench.seq + 1));
    // A client that comes back long after the restart finds nothing of the past either.
    let mut slow = Bench::open(true, &question);
    assert!(slow.session.restore(bench.session.snapshot(bench.told.now)));
    slow.seq = bench.seq;
    slow.until(31_000);
    slow.observe();
    assert_eq!((slow.told.says[0].1.step, slow.session.last_seq()), (0, bench.seq + 1));
    let mut other = bench.session.snapshot(bench.told.now);
    other.recurrent.push(0.0);
    assert!(!restarted.session.restore(other));
}

#[test]
fn what_was_overwritten_before_a_restart_counts() {
    let mut bench = Bench::open(true, &json!({}));
    bench.observe();
    bench.session.note_overwritten(3);
    let snapshot = bench.session.snapshot(bench.told.now);
    let mut restarted = Bench::open(true, &json!({}));
    assert!(restarted.session.restore(snapshot));
    restarted.session.note_overwritten(2);
    restarted.session.note_overwritten(1);
    restarted.until(1_000);
    assert_eq!(restarted.last_status()["overwritten"], 6);
}

#[test]
fn a_client_that_was_lost_for_long_is_kept_without_its_past() {
    let mut bench = Bench::open(true, &json!({}));
    bench.observe_from_to(0, 500);
    for (ms, goes_on) in [(20_000, true), (60_000, false)] {
        bench.until(ms);
        assert_eq!(bench.state(), LiveState::Lost);
        let mut restarted = Bench::open(true, &json!({}));
        assert!(restarted.session.restore(bench.session.snapshot(bench.told.now)));
        assert_eq!(restarted.session.goes_on(), goes_on, "after {ms} ms");
        restarted.seq = bench.seq;
        restarted.until(1_000);
        restarted.observe();
        assert_eq!(restarted.session.step_of_episode() > 0, goes_on, "after {ms} ms");
    }
}

#[test]
fn a_late_step_is_counted_and_nobody_is_spoken_to_faster_for_it() {
    let mut bench = Bench::open(true, &json!({}));
    bench.observe_from_to(0, 250);
    // The process did not run from here on.
    bench.told.now = OPENED + 2_000 * MS;
    bench.observe();
    let n = bench.told.says.len();
    bench.observe_from_to(2_050, 2_250);
    assert_eq!(bench.told.says.len(), n, "the next step comes a whole step later");
    assert_eq!(bench.session.counts().late_steps, 1);
    bench.observe_from_to(2_300, 2_350);
    assert!(bench.told.says.len() > n);
}

#[test]
fn a_question_is_checked_against_the_policy() {
    let policy = policy(false);
    let refused = |question: Value| {
        let question = question.to_string();
        SessionPlan::read(question.as_bytes(), &policy, 7).unwrap_err().to_string()
    };
    let with = |key: &str, value: Value| {
        let mut question = json!({"protocol": 1, "domain": "lander"});
        question[key] = value;
        question
    };
    for (question, told) in [
        (json!({}), "cannot be read: `protocol` is missing: the version of the messages, 1"),
        (json!([]), "cannot be read: it has to be a JSON object with protocol, domain, "),
        (with("domain", json!(7)), "`domain` has to be the name of the task, as a text; it is 7"),
        (with("protocol", json!(2)), "protocol 2 is asked for; this notifier speaks protocol 1"),
        (
            with("domain", json!("highway")),
            "this notifier is for lander, with 8 numbers per observation; the client is of highway",
        ),
        (with("obs_dim", json!(9)), "the client is of lander, with 9"),
        (
            with("seconds_per_step", json!(0)),
            "`seconds_per_step` is 0; allowed: 0.001 to 5 seconds",
        ),
        (with("seconds_per_step", json!(-0.3)), "`seconds_per_step` is -0.3"),
        (with("seconds_per_step", json!(5.1)), "`seconds_per_step` is 5.1"),
        (with("stale_after", json!(0)), "`stale_after` is 0"),
        (with("lost_after", json!(0.1)), "`lost_after` is 0.1; allowed: 0.6 to 600 seconds"),
        (
            with("clock", json!("sun")),
            "`clock` has to be timer, observation or word; it is \"sun\"",
        ),
        (with("words", json!("mine")), "`words` is mine; allowed: shipped"),
        (with("incarnation", json!("12")), "`incarnation` is 12; allowed: 16 hexadecimal digits"),
        (with("seed", json!(-1)), "`seed` has to be a whole number from 0; it is -1"),
        (with("sed", json!(1)), "`sed` is not known; did you mean `seed`?"),
    ] {
        let sentence = refused(question);
        assert!(sentence.contains(told), "{sentence}");
    }
    let question = with("person", json!({"reaction_delay": {"mean": 0.9}}));
    let plan = SessionPlan::read(question.to_string().as_bytes(), &policy, 7).unwrap();
    assert!(plan.notes[0].starts_with("`person` is not used"), "{:?}", plan.notes);
    assert_eq!((plan.seed, plan.seconds_per_step), (7, 0.3));
}

#[test]
fn an_unknown_fact_is_counted_and_told_once_with_the_one_that_was_meant() {
    let mut bench = Bench::open(true, &json!({"clock": "observation"}));
    for (i, facts) in
        [r#"["zone_belwo", "zone_below"]"#, r#"["zone_belwo"]"#, r#"["quite_another"]"#]
            .into_iter()
            .enumerate()
    {
        bench.until(i as u64 * 100);
        let (head, n) = (bench.head(), bench.n);
        let mut observation: Value =
            serde_json::from_slice(&write_json(&head, &vec![0.1; n])).unwrap();
        observation["facts"] = serde_json::from_str(facts).unwrap();
        bench.json(observation.to_string().as_bytes());
    }
    bench.until(2_000);
    let told = bench.told.statuses.iter().map(|(_, status)| status["told"].as_str().unwrap());
    let told: Vec<&str> = told.filter(|told| !told.is_empty()).collect();
    let [first, second] = told[..] else { panic!("{told:?}") };
    let meant = "there is no fact `zone_belwo`; did you mean `zone_below`? Known: ";
    assert!(first.starts_with(meant), "{first}");
    assert!(second.starts_with("there is no fact `quite_another`. Known: "), "{second}");
    assert_eq!(bench.last_status()["unknown_facts"], 3);
    assert_eq!(bench.session.counts().taken, 3, "the observations count all the same");
}

#[test]
fn a_message_that_is_too_long_and_an_unreadable_report_are_reported() {
    let mut bench = Bench::open(true, &json!({}));
    bench.observe();
    bench.until(100);
    bench.arrive(&ArrivalEncoding::TooLong(70_000), b"", None);
    bench.until(200);
    let report = b"{\"utterance\":1,\"event\":\"sad\"}";
    bench.session.hear(bench.told.now, report, &mut bench.decider, &mut bench.told);
    bench.until(300);
    let told = bench.told_of_messages();
    let [long, unread] = &told[..] else { panic!("{told:?}") };
    assert_eq!(long, "the observation has 70000 bytes, with what is beside it; 65536 at most");
    let start =
        "a report of what was heard cannot be read: `event` has to be start, word, end or cut";
    assert!(unread.starts_with(start), "{unread}");
    assert_eq!(bench.session.refusals(), (2, unread.as_str()));
    // Reports end no session, however many there are.
    for _ in 0..2 * MAX_REFUSED {
        bench.session.hear(bench.told.now, b"?", &mut bench.decider, &mut bench.told);
    }
    assert_ne!(bench.state(), LiveState::Closed);
}

#[test]
fn a_robot_that_cannot_ask_again_is_never_given_up() {
    let mut bench = Bench::open(true, &json!({"seconds_per_step": 0.1}));
    let policy = policy(true);
    let question = json!({"protocol": 1, "domain": "lander", "seconds_per_step": 0.1});
    let plan = SessionPlan::read(question.to_string().as_bytes(), &policy, 7).unwrap();
    let plan = SessionPlan { source: ObservationSource::Robot(crate::RobotForm::F32), ..plan };
    bench.session = LiveSession::new("s2".to_owned(), plan, &policy, &bench.decider, OPENED);
    let numbers = vec![0; 4 * bench.n];
    let other = ArrivalEncoding::Other("application/cdr".to_owned());
    // What a sample says of its form does not matter: the command line has said it.
    for ms in (0..1_000).step_by(50) {
        bench.until(ms);
        bench.arrive(&other, &numbers, None);
    }
    assert_eq!((bench.state(), bench.session.last_seq()), (LiveState::Speaking, 20));
    // Nonsense, as much as ends anybody else's session, and then an hour of silence.
    for _ in 0..2 * MAX_REFUSED {
        bench.arrive(&ArrivalEncoding::Json, b"{}", None);
    }
    bench.until(3_000);
    assert_eq!(bench.state(), LiveState::Lost);
    assert_eq!(bench.session.end(OPENED + 3_600_000 * MS, &mut bench.told), None);
    let n_said = bench.told.says.len();
    bench.until(4_000);
    assert_eq!(bench.told.says.len(), n_said, "nothing is said to a robot that is lost");
    for ms in (4_000..5_000).step_by(50) {
        bench.until(ms);
        bench.arrive(&ArrivalEncoding::Json, &numbers, None);
    }
    assert_eq!(bench.state(), LiveState::Speaking);
    assert_eq!(bench.session.counts().refused, u64::from(2 * MAX_REFUSED));
    assert!(bench.told.says.len() > n_said);
}

/// Returns when the first words of the first utterance were told, in milliseconds after its start.
fn first_words(bench: &Bench) -> Vec<u64> {
    let said = bench.told.says.iter().filter(|(_, say)| say.utterance == 1);
    let said = said.filter(|(_, say)| matches!(say.event, SayEvent::Start | SayEvent::Word));
    said.map(|(at, _)| (at - OPENED) / MS).collect()
}

#[test]
fn words_begin_and_end_as_in_the_voice() {
    let mut bench = Bench::open_with_voice(&json!({"stale_after": 9, "lost_after": 99}));
    bench.observe();
    // Nothing new is said on one observation that is not stale, so the first utterance may run until it is understood.
    bench.until(150);
    let heard = |bench: &Bench| bench.session.notifier.speech().map(|speech| speech.heard);
    assert_eq!(heard(&bench), Some(1), "the first word took 100 ms");
    bench.until(349);
    assert_eq!(heard(&bench), Some(1));
    bench.until(350);
    assert_eq!(heard(&bench), Some(2));
    bench.until(3_000);
    let begins = [0, 150, 350, 650, 1_050];
    let told = first_words(&bench);
    assert!(told.len() >= 2 && begins.starts_with(&told), "{told:?}");
    // Decisions are made by the clock, whatever the words do.
    assert_eq!(bench.session.counts().steps, 11);
}

#[test]
fn with_a_voice_the_clock_of_words_takes_a_step_where_one_ends() {
    let mut bench =
        Bench::open_with_voice(&json!({"clock": "word", "stale_after": 9, "lost_after": 99}));
    bench.observe();
    bench.until(99);
    assert_eq!(bench.session.counts().steps, 1);
    bench.until(100);
    assert_eq!(bench.session.counts().steps, 2);
    bench.until(349);
    assert_eq!(bench.session.counts().steps, 2);
    bench.until(350);
    assert_eq!(bench.session.counts().steps, 3);
}

#[test]
fn with_the_clock_of_observations_nothing_depends_on_the_voice() {
    let question = json!({"clock": "observation"});
    let mut voiced = Bench::open_with_voice(&question);
    let mut silent = Bench::open(true, &question);
    for bench in [&mut voiced, &mut silent] {
        for ms in (0..12_000).step_by(40) {
            bench.until(ms);
            bench.observe();
        }
    }
    assert!(voiced.told.says.len() > 300);
    assert_eq!(voiced.told.says, silent.told.says);
    let counted_by_steps = json!({"word_clock": "steps"});
    let mut voiced = Bench::open_with_voice(&counted_by_steps);
    let mut silent = Bench::open(true, &counted_by_steps);
    voiced.observe_from_to(0, 9_000);
    silent.observe_from_to(0, 9_000);
    assert_eq!(voiced.told.says, silent.told.says);
}

#[test]
fn a_report_of_the_loudspeaker_counts_more_than_the_voice() {
    let mut bench = Bench::open_with_voice(&json!({"stale_after": 9, "lost_after": 99}));
    bench.observe();
    let report = json!({"utterance": 1, "event": "start"}).to_string();
    bench.session.hear(bench.told.now, report.as_bytes(), &mut bench.decider, &mut bench.told);
    bench.until(2_000);
    assert_eq!(first_words(&bench), [0]);
    assert_eq!(bench.session.notifier.speech().unwrap().heard, 0);
}

#[test]
fn what_starts_is_played_what_is_cut_falls_silent_and_a_mute_loudspeaker_is_told() {
    let mut bench = Bench::open_with_voice(&json!({}));
    bench.observe_from_to(0, 4_000);
    let started = bench.told.says.iter().filter(|(_, say)| say.event == SayEvent::Start);
    let started: Vec<String> = started.map(|(_, say)| say.text.clone()).collect();
    assert!(started.len() > 2);
    assert_eq!(bench.told.played, started);
    let n_cut = bench.events().iter().filter(|event| **event == SayEvent::Cut).count();
    assert!(n_cut > 0);
    assert_eq!(bench.told.n_hushed, n_cut);
    bench.session.note_mute(true);
    bench.observe_from_to(4_050, 5_000);
    assert_eq!(bench.last_status()["state"], "mute");
    let why = "the loudspeaker is gone; what is said goes on in text";
    assert_eq!(bench.last_status()["why"], why);
    assert!(bench.told.played.len() > started.len(), "it goes on");
    bench.session.note_mute(false);
    bench.observe_from_to(5_050, 5_200);
    assert_eq!(bench.last_status()["state"], "speaking");
}
