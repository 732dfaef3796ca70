//! A listener who is played: what the model of the listener would have done has the same effects, and they may do otherwise.

use leadtime_numerics::{Purpose, stream};
use leadtime_proto::{EnvId, TaskSpec};
use leadtime_sims::{Environment, EpisodeSeed, SharedOutcome, TwoPlayers};

const SEED: EpisodeSeed = EpisodeSeed { run_seed: 3, env_id: EnvId(0), episode: 4 };

fn spec(domain: &str, settings: &str) -> TaskSpec {
    TaskSpec { domain: domain.to_owned(), settings: settings.to_owned() }
}

fn task(domain: &str, settings: &str) -> Box<dyn Environment> {
    leadtime_worlds::builtin().build(&spec(domain, settings)).expect("the task can be built")
}

fn two_players(domain: &str, settings: &str) -> Box<dyn TwoPlayers> {
    let built = leadtime_worlds::builtin().build_pair(&spec(domain, settings));
    built.expect("the task can be built").expect("there is a listener in it")
}

fn bits(row: &[f32]) -> Vec<u32> {
    row.iter().map(|value| value.to_bits()).collect()
}

/// The topic that the model of the listener has carried out in the last step.
fn reacting(env: &dyn Environment) -> Option<usize> {
    env.scene().expect("it can be drawn").listener.reacting
}

/// An episode of the lander in which both are played.
struct Played {
    together: Box<dyn TwoPlayers>,
    row: Vec<f32>,
    person: Vec<f32>,
}

impl Played {
    fn begin(settings: &str) -> Self {
        let mut together = two_players("lander", settings);
        let mut row = vec![0.0; together.notifier().spec().obs_dim];
        let mut person = vec![0.0; together.person_quantities().len()];
        together.reset(SEED, &mut row, &mut person);
        Self { together, row, person }
    }

    /// The action that says nothing.
    fn silence(&self) -> Vec<u8> {
        vec![0; self.together.notifier().spec().actions.heads.len()]
    }

    /// The action that starts the message nearest to this one.
    fn start(&self, topic: usize, comprehension: u32, conveyance: u32) -> Vec<u8> {
        let script = self.together.notifier().scriptable().expect("messages are sent");
        let mut action = self.silence();
        let message = leadtime_sims::Message { topic, comprehension, conveyance };
        script.write_action(Some(message), &mut action);
        action
    }

    fn step(&mut self, action: &[u8], topic: Option<usize>) -> SharedOutcome {
        self.together.step(action, topic, &mut self.row, &mut self.person)
    }

    fn metric(&self, name: &str) -> f32 {
        let names = &self.together.notifier().spec().metrics;
        let mut metrics = vec![0.0; names.len()];
        self.together.notifier().metrics(&mut metrics);
        metrics[names.iter().position(|it| it == name).expect(name)]
    }
}

#[test]
fn a_listener_who_does_what_the_model_does_has_the_same_episode() {
    for domain in ["lander", "highway", "steakhouse"] {
        // Reactions of a step do not follow each other on the same topic, which the model would begin anew and a listener who
        // keeps to a topic would not.
        let settings =
            r#"{"human": {"repeat": "restart", "reaction_reward": "off", "follow_through": 1}}"#;
        let (mut alone, mut together) = (task(domain, settings), two_players(domain, settings));
        let heads: Vec<_> = alone.spec().actions.heads.iter().map(|it| it.n_choices).collect();
        let mut draws = stream(5, Purpose::Act, 0, 0);
        let mut rows = [(); 2].map(|()| vec![0.0; alone.spec().obs_dim]);
        let mut person = vec![f32::NAN; together.person_quantities().len()];
        let (mut n_steps, mut n_reacted) = (0, 0);
        for episode in 0..40 {
            let seed = EpisodeSeed { episode, ..SEED };
            let [ours, theirs] = &mut rows;
            alone.reset(seed, ours);
            together.reset(seed, theirs, &mut person);
            loop {
                assert_eq!(bits(ours), bits(theirs), "{domain}, step {n_steps}");
                assert!(person.iter().all(|value| value.is_finite()), "{domain}: {person:?}");
                let mut action = vec![0; heads.len()];
                if n_steps % 6 == 0 {
                    action = heads.iter().map(|n_choices| draws.below(*n_choices) as u8).collect();
                    action[0] = 1;
                }
                let outcome = alone.step(&action, ours);
                let topic = reacting(alone.as_ref());
                let shared = together.step(&action, topic, theirs, &mut person);
                n_reacted += usize::from(topic.is_some());
                n_steps += 1;
                assert_eq!(outcome.end, shared.end, "{domain}, step {n_steps}");
                assert_eq!(outcome.reward.to_bits(), shared.notifier_reward.to_bits(), "{domain}");
                if outcome.end.is_some() {
                    break;
                }
            }
        }
        assert!(n_steps > 500 && n_reacted > 60, "{domain}: {n_reacted} of {n_steps}");
    }
}

#[test]
fn a_person_hears_word_by_word_and_knows_the_topic_once_it_is_understood() {
    let mut played = Played::begin("{}");
    let names = played.together.person_quantities().into_iter().map(|it| it.name);
    let names: Vec<String> = names.collect();
    let at = |name: &str| names.iter().position(|it| it == name).expect(name);
    let topic = 1;
    let (heard, told, ago) = (
        at("heard"),
        at(&format!("understood.{}", played.together.topics()[topic])),
        at("understood.ago"),
    );
    assert_eq!([heard, told, ago].map(|i| played.person[i]), [0.0; 3]);
    // Understood with the second word, over with the third.
    let (start, silence) = (played.start(topic, 2, 3), played.silence());
    let mut seen = Vec::new();
    for action in [&start, &silence, &silence, &silence] {
        played.step(action, None);
        let person = &played.person;
        seen.push([person[heard] > 0.0, person[told] > 0.5, person[ago] > 0.0]);
    }
    let (yes, no) = (true, false);
    assert_eq!(seen, [[yes, no, no], [yes, yes, no], [no, yes, yes], [no, yes, yes]]);
}

#[test]
fn a_message_is_followed_when_the_person_acts_upon_it_and_only_then() {
    let followed = |motions: &[Option<usize>]| {
        let mut played = Played::begin("{}");
        played.step(&played.start(0, 1, 1), None);
        for motion in motions {
            played.step(&played.silence(), *motion);
        }
        played.metric("followed")
    };
    assert_eq!(followed(&[None; 20]), 0.0, "by their own plan, nothing is followed");
    assert_eq!(followed(&[Some(1); 5]), 0.0, "another topic is none that was said");
    assert_eq!(followed(&[None, None, Some(0), Some(0), None, Some(0)]), 1.0, "once");
}

#[test]
fn what_a_person_does_not_act_upon_may_be_said_again() {
    for repeat in ["restart", "continue"] {
        let mut played = Played::begin(&format!("{{\"human\": {{\"repeat\": \"{repeat}\"}}}}"));
        // The shortest message has two words.
        for _ in 0..8 {
            played.step(&played.start(0, 1, 1), None);
        }
        assert_eq!(played.metric("notifications"), 4.0, "{repeat}");
    }
}

#[test]
fn other_motions_lead_elsewhere_and_the_same_ones_to_the_same_bits() {
    let fly = |stream_of: u64| {
        let mut played = Played::begin("{}");
        let mut draws = stream(stream_of, Purpose::Act, 0, 0);
        for _ in 0..12 {
            let n_topics = played.together.topics().len();
            let motion = draws.below(n_topics + 1).checked_sub(1);
            let shared = played.step(&played.silence(), motion);
            assert_eq!(shared.notifier_reward, shared.person_reward, "silence is free");
        }
        bits(&played.person)
    };
    assert_eq!(fly(1), fly(1));
    assert_ne!(fly(1), fly(2));
}

#[test]
fn a_task_without_a_person_has_no_second_player() {
    let build = |settings| leadtime_worlds::builtin().build_pair(&spec("cartpole", settings));
    assert!(build("{}").expect("the settings are right").is_none());
    assert!(build("{\"wrld\": 1}").is_err(), "what is wrong is reported all the same");
}
