//! A notifier at work, through the program: who is let in, what is said, and that nothing stale ever is.

use std::fs;
use std::time::{Duration, Instant};

use leadtime_serve::observation::{write_json, write_raw};
use leadtime_serve::{HeardSay, SayEvent};
use serde_json::{Value, json};

use crate::notifier::{Client, STEP, coming_down, policy, serve};
use crate::support::{
    PATIENCE, PEER_LOST, Place, SOON, WRONG_INPUT, repository, signal, wait_for_words, wait_until,
};

/// What the way to the notifier and back, and a busy machine, may add to an age.
const SLACK: f64 = 0.5;

impl Client {
    /// Sends observations at 50 Hz for a while, and takes what is told.
    fn watch(&mut self, time: Duration) {
        let deadline = Instant::now() + time;
        while Instant::now() < deadline {
            self.observe();
            self.listen(Duration::from_millis(20));
        }
    }

    /// Takes what is told until a status says something.
    #[track_caller]
    fn listen_for(&mut self, key: &str, words: &str) {
        let says = |status: &Value| status[key].as_str().is_some_and(|text| text.contains(words));
        let is_told = |client: &Self| client.statuses.iter().any(says);
        self.act_until(words, is_told, |client| client.listen(Duration::from_millis(20)));
    }

    /// Returns whether the last status has this state.
    fn is(&self, state: &str) -> bool {
        self.statuses.last().is_some_and(|status| status["state"] == state)
    }

    /// Asserts of every word that was said that it was said on what was fresh, or went on because it was understood.
    #[track_caller]
    fn assert_fresh(&self, stale_after: f64) {
        for (at, say) in &self.says {
            let is_word = matches!(say.event, SayEvent::Start | SayEvent::Word);
            if !is_word {
                continue;
            }
            let may_finish = say.event == SayEvent::Word && say.heard >= say.k;
            assert!(say.age <= stale_after || may_finish, "{say:?}");
            let sent = self.sent.iter().find(|(seq, _)| *seq == say.seq).expect("we sent it").1;
            let age = (*at - sent).as_secs_f64();
            assert!(age <= stale_after + SLACK || may_finish, "{age} s: {say:?}");
        }
    }

    fn started(&self) -> usize {
        self.says.iter().filter(|(_, say)| say.event == SayEvent::Start).count()
    }
}

/// Returns the measures of the first player, but for what the policy wanted to say and could not: that is no message.
fn measures(of: &Value) -> Vec<Value> {
    let measures = of["comparison"]["summaries"][0]["measures"].as_array().unwrap().clone();
    measures.into_iter().filter(|it| it["name"] != "ignored_initiations").collect()
}

#[test]
fn over_the_network_a_policy_is_as_good_as_in_its_evaluation_message_by_message() {
    let place = Place::new();
    let _notifier = serve(&place, "");
    let to = place.endpoint("n");
    let drive = format!("--connect {to} --clock observation --episodes 20 --json");
    let driven = place.finish(&["drive", &policy(), &drive, "--messages-to m.jsonl"]).with_code(0);
    let evaluated = place.finish(&["eval", &policy(), "--episodes 20 --json"]).with_code(0);
    assert_eq!(measures(&driven.json()), measures(&evaluated.json()));
    let messages = std::fs::read_to_string(place.path().join("m.jsonl")).unwrap();
    assert!(messages.lines().count() > 40, "{messages}");
    // The same as raw numbers.
    let raw = format!("--connect {to} --max-speed --binary --episodes 20 --json");
    let raw = place.finish(&["drive", &policy(), &raw]).with_code(0);
    assert_eq!(measures(&raw.json()), measures(&evaluated.json()));
    // And in the words of the transcript, of which the table has a column.
    let heard = place.finish(&["eval", &policy(), "--episodes 1 --transcript"]).with_code(0).stdout;
    let head = heard.lines().find(|line| line.contains("understands")).unwrap();
    let (from, to) = (head.find("hears").unwrap(), head.find("understands").unwrap());
    let column = |line: &str| line.chars().skip(from).take(to - from).collect::<String>();
    let rows = heard.lines().skip_while(|line| *line != head).skip(1);
    let words: Vec<String> = rows.map(|line| column(line).trim().to_owned()).collect();
    let heard = words.iter().filter(|word| !word.is_empty()).cloned().collect::<Vec<_>>().join(" ");
    let said = messages.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let said = said.filter(|said| said["episode"] == 0).take(3);
    let said: Vec<String> = said.map(|said| said["text"].as_str().unwrap().to_owned()).collect();
    assert!(heard.starts_with(&said.join(" ")), "{said:?} is not what is heard: {heard}");
}

#[test]
fn every_domain_goes_over_the_network_as_in_its_evaluation() {
    for name in ["driving", "cooking"] {
        let place = Place::new();
        let policy = repository(&format!("deploy/policies/{name}.safetensors"));
        let notifier = place.start(&["serve", &policy, "--listen", &place.endpoint("n")]);
        wait_for_words(&notifier, "is at work");
        let to = place.endpoint("n");
        let drive = format!("--connect {to} --max-speed --episodes 6 --json");
        let driven = place.finish(&["drive", &policy, &drive]).with_code(0).json();
        let evaluated = place.finish(&["eval", &policy, "--episodes 6 --json"]).with_code(0).json();
        assert_eq!(measures(&driven), measures(&evaluated), "{name}");
    }
}

#[test]
fn a_world_that_goes_by_the_clock_is_kept_up_with() {
    let place = Place::new();
    let _notifier = serve(&place, "");
    let to = place.endpoint("n");
    let drive = format!("--connect {to} --seconds-per-step 0.04 --episodes 3 --json");
    let driven = place.finish(&["drive", &policy(), &drive]).with_code(0).json();
    let measures = driven["comparison"]["summaries"][0]["measures"].as_array().unwrap().clone();
    let said = measures.iter().find(|it| it["name"] == "notifications").unwrap();
    assert!(said["interval"]["estimate"].as_f64().unwrap() > 1.0, "{said}");
}

#[test]
fn a_client_that_is_not_let_in_is_told_why() {
    let place = Place::new();
    let notifier = serve(&place, "--max-sessions 2");
    let first = Client::connect(&place, "car-1", 1);
    let answer = first.open(&json!({})).unwrap();
    assert_eq!((&answer["obs_dim"], &answer["topics"][0]), (&json!(8), &json!("ascend")));
    assert_eq!(answer["observation"][0]["name"], "x");
    let facts = answer["facts"].as_array().unwrap();
    assert!(facts.iter().any(|fact| fact["name"] == "zone_below"), "{facts:?}");
    assert_eq!(first.open(&json!({})).unwrap()["session"], answer["session"], "asked again");
    let second = Client::connect(&place, "car-1", 2);
    let told = second.open(&json!({})).unwrap_err();
    assert_eq!(
        told,
        "a client named `car-1` is here already; choose another name, or wait until it is gone"
    );
    for (question, told) in [
        (
            json!({"domain": "highway"}),
            "this notifier is for lander, with 8 numbers per observation; the client is of highway",
        ),
        (json!({"clok": "timer"}), "cannot be read: `clok` is not known; did you mean `clock`?"),
    ] {
        let sentence = second.open(&question).unwrap_err();
        assert!(sentence.contains(told), "{sentence}");
    }
    let other = Client::connect(&place, "car-2", 3);
    other.open(&json!({})).unwrap();
    let third = Client::connect(&place, "car-3", 4);
    let told = third.open(&json!({})).unwrap_err();
    assert_eq!(told, "no place is free: --max-sessions allows 2 sessions");
    // The first one goes, and its name is free.
    drop(first);
    wait_until("the name is free", PATIENCE, || second.open(&json!({})).is_ok());
    drop((second, other, third, notifier));
}

#[test]
fn an_unusable_observation_is_answered_with_one_sentence_and_sixteen_in_a_row_end_the_session() {
    let place = Place::new();
    let _notifier = serve(&place, "");
    let mut client = Client::connect(&place, "car-1", 1);
    client.open(&json!({})).unwrap();
    client.observe();
    client.listen_for("state", "s");
    let head = client.head();
    client.port.observe(&write_json(&head, &[0.0; 7])).unwrap();
    client.listen_for("told", "the observation has 7 numbers; 8 are expected");
    let (numbers, mut beside) = write_raw(&client.head(), &[0.0; 8]);
    beside[32] ^= 1;
    client.port.observe_raw(&numbers, &beside).unwrap();
    client.listen_for("told", "the checksum of the observation is wrong");
    client.port.observe_as("text/csv", b"0,1", None).unwrap();
    client.listen_for("told", "an observation of encoding `text/csv`; known: application/json");
    // One at a time: of several that wait only the newest is looked at.
    for (count_on, key, count) in [(10, "taken", 2), (-5, "out_of_order", 1)] {
        client.seq = client.seq.strict_add_signed(count_on);
        client.observe();
        let is_counted =
            |client: &Client| client.statuses.last().is_some_and(|it| it[key] == count);
        client.act_until(key, is_counted, |client| client.listen(Duration::from_millis(20)));
    }
    client.seq += 3;
    client.observe();
    client.listen_for("told", "came twice, with other content");
    let last = client.statuses.last().unwrap();
    assert_eq!((&last["out_of_order"], &last["missed"]), (&json!(1), &json!(12)), "{last}");
    let say_noise = |client: &mut Client| {
        client.port.observe(b"noise").unwrap();
        client.listen(Duration::from_millis(2));
    };
    client.act_until("it is closed", |client| client.is("closed"), say_noise);
    let why = client.statuses.last().unwrap()["why"].as_str().unwrap().to_owned();
    assert!(why.contains("messages in a row could not be used; open a new session"), "{why}");
    client.open(&json!({"seed": 2})).unwrap();
}

#[test]
fn a_message_that_is_too_long_is_reported() {
    let place = Place::new();
    let _notifier = serve(&place, "");
    let mut client = Client::connect(&place, "car-1", 1);
    client.open(&json!({})).unwrap();
    let long = vec![b' '; 70_000];
    let told = "70000 bytes, with what is beside";
    let says = |status: &Value| status["told"].as_str().is_some_and(|text| text.contains(told));
    let send = |client: &mut Client| {
        client.port.observe(&long).unwrap();
        client.listen(Duration::from_millis(100));
    };
    client.act_until(told, |client| client.statuses.iter().any(says), send);
}

#[test]
fn a_client_that_asks_again_is_told_where_to_count_on_and_a_closed_session_does_not_come_back() {
    let place = Place::new();
    let _notifier = serve(&place, "--state state");
    let mut client = Client::connect(&place, "car-1", 1);
    let session = client.open(&json!({})).unwrap()["session"].clone();
    client.watch(Duration::from_millis(500));
    wait_until("the same session tells the newest number", PATIENCE, || {
        let again = client.open(&json!({})).unwrap();
        again["session"] == session && again["last_seq"] == client.seq
    });

    // The client's clock jumps ahead and back: nothing that it sends can be used any more, and that is kept.
    let (values, mut head) = (coming_down(client.seq as f32), client.head());
    head.t = 9e8;
    client.port.observe(&write_json(&head, &values)).unwrap();
    client.listen(Duration::from_millis(2_500));
    let observe = |client: &mut Client| {
        client.observe();
        client.listen(Duration::from_millis(2));
    };
    client.act_until("it is closed", |client| client.is("closed"), observe);
    let mut fresh = Value::Null;
    wait_until("it is over", PATIENCE, || {
        fresh = client.open(&json!({})).unwrap();
        fresh["session"] != session
    });
    assert_eq!(fresh["last_seq"], 0, "{fresh}");
    // It counts anew and is spoken to, with a landing from its beginning.
    client.seq = 0;
    client.statuses.clear();
    let speaks = |client: &Client| client.statuses.iter().any(|told| told["state"] == "speaking");
    client.act_until("it is spoken to", speaks, |client| client.watch(Duration::from_millis(100)));
}

#[test]
fn the_kept_state_of_a_session_that_was_changed_is_reported_and_a_new_session_begins() {
    let place = Place::new();
    let notifier = serve(&place, "--state state");
    let mut client = Client::connect(&place, "car-1", 1);
    let session = client.open(&json!({})).unwrap()["session"].clone();
    let file = place.path().join("state/car-1.session");
    let watch = |client: &mut Client| client.watch(Duration::from_millis(20));
    client.act_until("the state is kept", |_client| file.exists(), watch);
    notifier.kill();
    drop(client.link);
    let mut bytes = fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&file, bytes).unwrap();
    let notifier = serve(&place, "--state state");
    let client = Client::connect(&place, "car-1", 1);
    let fresh = client.open(&json!({})).unwrap();
    assert_ne!(fresh["session"], session);
    assert_eq!(fresh["last_seq"], 0, "{fresh}");
    wait_for_words(&notifier, "its checksum is wrong");
    assert!(notifier.stderr().contains("the client gets a new one"), "{}", notifier.stderr());
}

#[test]
fn a_client_that_has_to_give_up_its_place_is_told() {
    let place = Place::new();
    let _notifier = serve(&place, "--max-sessions 1");
    // Its presence is that of another start: nobody knows that it is there.
    let mut first = Client::connect(&place, "car-1", 1);
    first.open(&json!({"incarnation": "00000000000000ff"})).unwrap();
    let second = Client::connect(&place, "car-2", 2);
    second.open(&json!({})).unwrap();
    first.listen_for("why", "another client was given the place");
    assert_eq!(first.statuses.last().unwrap()["state"], "closed");
}

#[test]
fn a_session_that_another_question_replaces_is_cut() {
    let place = Place::new();
    let _notifier = serve(&place, "--set human.interrupt=replace");
    let mut client = Client::connect(&place, "car-1", 1);
    let question =
        |seed: u32| json!({"seconds_per_step": 0.5, "word_clock": "steps", "seed": seed});
    client.open(&question(5)).unwrap();
    let watch = |client: &mut Client| client.watch(Duration::from_millis(20));
    client.act_until("something is said", |client| client.started() > 0, watch);
    client.open(&question(6)).unwrap();
    client.listen(Duration::from_secs(1));
    assert_eq!(client.says.last().map(|(_, say)| say.event), Some(SayEvent::Cut));
}

#[test]
fn nothing_stale_is_said_under_a_flood_to_a_frozen_client_or_after_a_kill() {
    const STALE: f64 = 0.4;
    let place = Place::new();
    let notifier = serve(&place, "--state state --set human.interrupt=replace");
    let mut client = Client::connect(&place, "car-1", 1);
    let question = json!({"stale_after": STALE, "lost_after": 1.0, "seed": 5});
    let session = client.open(&question).unwrap()["session"].clone();
    client.watch(Duration::from_secs(2));
    let n_started = client.started();
    assert!(n_started > 0, "something was said");

    // Somebody else floods.
    let rogue = Client::connect(&place, "rogue", 9);
    rogue.open(&json!({})).unwrap();
    let until = Instant::now() + Duration::from_secs(2);
    while Instant::now() < until {
        for _ in 0..200 {
            rogue.port.observe(b"{\"seq\":1,\"t\":0,\"obs\":[]}").unwrap();
        }
        client.observe();
        client.listen(Duration::from_millis(10));
    }
    assert!(client.started() > n_started, "it is still spoken to");
    client.assert_fresh(STALE);

    // Silence: no observation for longer than a client may be silent.
    let last = client.sent.last().unwrap().1;
    client.listen(Duration::from_secs(2));
    client.assert_fresh(STALE);
    let words = client.says.iter().filter(|(_, say)| say.event != SayEvent::End);
    let late = words.filter(|(at, _)| (*at - last).as_secs_f64() > 1.0 + 2.0 * STEP + SLACK);
    assert_eq!(late.count(), 0, "{:?}", client.says.last());
    client.listen_for("state", "lost");

    // The notifier is frozen: what waits in its buffers is old when it goes on.
    client.watch(Duration::from_millis(500));
    signal("STOP", notifier.id());
    client.watch(Duration::from_millis(700));
    std::thread::sleep(Duration::from_millis(900));
    let resumed = Instant::now();
    signal("CONT", notifier.id());
    client.listen(Duration::from_secs(1));
    let is_new = |(at, say): &&(Instant, HeardSay)| *at > resumed && say.event == SayEvent::Start;
    assert_eq!(client.says.iter().find(is_new), None);

    // Killed and started again, it goes on with the same session.
    client.watch(Duration::from_millis(1_500));
    notifier.kill();
    drop(client.link);
    let _again = serve(&place, "--state state --set human.interrupt=replace");
    let seq = client.seq;
    let mut client = Client::connect(&place, "car-1", 1);
    let answer = client.open(&question).unwrap();
    assert_eq!(answer["session"], session);
    let last_seq = answer["last_seq"].as_u64().unwrap();
    assert!(last_seq > 0 && last_seq <= seq, "{last_seq} of {seq}");
    client.seq = seq;
    // The client's own clock goes on.
    client.began -= Duration::from_mins(1);
    client.listen(Duration::from_millis(300));
    assert_eq!(client.says, [], "nobody is spoken to before there is something new");
    client.watch(Duration::from_secs(2));
    assert!(client.started() > 0);
    client.assert_fresh(STALE);
}

#[test]
fn a_frozen_client_is_lost_and_a_restarted_one_has_a_new_session() {
    let place = Place::new();
    let notifier = serve(&place, "");
    let endpoint = place.endpoint("n");
    let drive = ["drive", &policy(), "--connect", &endpoint, "--seconds-per-step 0.1"];
    let frozen = place.start(&drive);
    wait_for_words(&frozen, "the notifier listens");
    // Another client sees what is told to it.
    let mut witness = Client::connect(&place, "drive", 7);
    witness.listen_for("state", "speaking");
    signal("STOP", frozen.id());
    let stopped = Instant::now();
    witness.statuses.clear();
    witness.says.clear();
    witness.listen_for("state", "stale");
    assert!(stopped.elapsed() < SOON, "{:?}", stopped.elapsed());
    witness.listen_for("state", "lost");
    for (_, say) in &witness.says {
        let may = say.age <= 0.5 || say.event != SayEvent::Start;
        assert!(may, "{say:?}");
    }
    // Its presence lasts until the network notices, and so does its name.
    wait_until("it is gone", PATIENCE, || witness.open(&json!({})).is_ok());
    assert!(stopped.elapsed() < SOON, "{:?}", stopped.elapsed());
    signal("CONT", frozen.id());
    drop((frozen, notifier));
}

#[test]
fn a_notifier_that_cannot_work_says_so_in_one_sentence() {
    let place = Place::new();
    let refused = |args: &[&str], told: &[&str]| {
        place.finish(args).with_code(WRONG_INPUT).saying(told);
    };
    let listen = format!("--listen {}", place.endpoint("n"));
    let file = place.write("p.safetensors", "no policy");
    refused(&["serve", &file, &listen], &["is not a policy of Leadtime: it is text"]);
    refused(&["serve nothing", &listen], &["`nothing` is no policy file"]);
    refused(&["serve", &policy()], &["--listen tcp/", "--connect tcp/"]);
    refused(&["serve", &policy(), &listen, "--max-sessions 65"], &["65", "1..=64"]);
    refused(&["serve", &policy(), &listen, "--service A/b"], &["not a valid service name"]);
    refused(&["serve", &policy(), &listen, "--words highway"], &["no sentences for the topics"]);
    let state = place.write("state", "a file");
    refused(&["serve", &policy(), &listen, "--state", &state], &["--state", "cannot make"]);
    // Two that keep their sessions in one place would write over each other's.
    let first = serve(&place, "--state kept");
    let second = "--listen tcp/127.0.0.1:0 --service second --state kept";
    let told = "--state: kept is another notifier's that is at work";
    refused(&["serve", &policy(), second], &[told]);
    first.kill();
    place.finish(&["up -c cartpole --steps 2000 --name pole"]).with_code(0);
    refused(&["serve pole", &listen], &["nobody is spoken to in `cartpole`"]);
    place
        .finish(&["drive lander --connect 127.0.0.1:1 --connect-timeout 200ms"])
        .with_code(PEER_LOST)
        .saying(&[
            "no notifier can be reached",
            "start a service there: `leadtime serve POLICY --listen ENDPOINT`",
        ]);

    let _notifier = serve(&place, "");
    refused(&["serve", &policy(), &listen], &["is in use"]);
    let to = place.endpoint("n");
    let told = [
        "this notifier is for lander, with 8 numbers",
        "the client is of highway, with ",
        "`leadtime drive` with that task's name, or with the policy's own file",
    ];
    place.finish(&["drive highway --connect", &to]).with_code(PEER_LOST).saying(&told);
    let told = ["no notifier `other` is at work", "there: `notifier`", "with --service other"];
    let other = "--service other --connect-timeout 3s";
    place.finish(&["drive lander --connect", &to, other]).with_code(PEER_LOST).saying(&told);
    let another = "--max-speed --episodes 1 --set human.reaction_delay=4";
    let told = ["this task is not the one", "human", "here and", "the policy's own file"];
    place.finish(&["drive", &policy(), "--connect", &to, another]).with_code(0).saying(&told);
    let same = place.finish(&["drive", &policy(), "--connect", &to, "--max-speed --episodes 1"]);
    let same = same.with_code(0).stderr;
    assert!(!same.contains("this task is not the one"), "{same}");
    let described = place.finish(&["serve", &policy(), "--describe --json"]).with_code(0).json();
    assert_eq!(described["properties"]["obs"]["maxItems"], 8);
    let other = place.finish(&["serve", &policy(), "--describe --json --obs-key foo"]).with_code(2);
    other.saying(&["--describe", "--obs-key"]);
    let quiet = place.finish(&["serve", &policy(), "--describe"]).with_code(0).stdout;
    assert!(quiet.contains("Topics: ascend, shift_left, shift_right, descend"), "{quiet}");
    let driving = repository("deploy/policies/driving.safetensors");
    let wide = place.finish(&["serve", &driving, "--describe"]).with_code(0).stdout;
    for told in [&quiet, &wide] {
        let fits = told.lines().all(|line| line.chars().count() <= 80);
        assert!(fits && !told.contains('\u{2026}'), "{told}");
    }
}
