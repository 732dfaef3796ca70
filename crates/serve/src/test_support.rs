//! What several tests need.

use leadtime_episodes::Choice;
use leadtime_policy::Parameters;
use leadtime_proto::{PolicySpec, TaskSpec};
use leadtime_taxonomy::Taxonomy;

use crate::working_policy::WorkingPolicy;

/// Makes an untrained policy of a built-in task that speaks in these words.
pub(crate) fn policy(domain: &str, words: Option<Taxonomy>) -> WorkingPolicy {
    let task = TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() };
    let env = leadtime_worlds::builtin().build(&task).unwrap();
    let spec = PolicySpec::dense(env.spec(), &[8]);
    let parameters = Parameters::initialize(&spec, 1).unwrap();
    WorkingPolicy::new(domain, env.as_ref(), &spec, &parameters, Choice::Greedy, words).unwrap()
}
