//! `--change`: which settings get another value in a run that goes on.

use anyhow::ensure;
use leadtime_config::Override;
use leadtime_config::identity::CHANGEABLE;

/// Reads a change of a setting in a run that goes on.
pub(super) fn parse(text: &str) -> Result<Override, String> {
    Override::parse(text).map(|change| change.given_by("--change"))
}

/// Refuses a key that gets two values. One that `--set` gives as well is what the run began with: the change holds.
pub(super) fn check_given_once(changes: &[Override]) -> anyhow::Result<()> {
    for (i, change) in changes.iter().enumerate() {
        let key = change.key();
        let is_again = changes[..i].iter().any(|earlier| earlier.key() == key);
        ensure!(!is_again, "`{key}` is given by --change twice: leave one of them out");
    }
    Ok(())
}

/// Refuses a key that cannot change while a run goes on.
pub(super) fn check_changeable(changes: &[Override]) -> anyhow::Result<()> {
    for key in changes.iter().map(Override::key) {
        let allowed = CHANGEABLE.map(|key| key.trim_start_matches("learner.")).join(", ");
        ensure!(
            CHANGEABLE.contains(&key.as_str()),
            "--change: `{key}` cannot change while a run goes on; of the section `learner` can: {allowed}; `--fork` starts \
             a new run from the weights"
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changes(texts: &[&str]) -> Vec<Override> {
        texts.iter().map(|text| parse(text).unwrap()).collect()
    }

    #[test]
    fn a_key_gets_one_value() {
        let check =
            |change: &[&str]| check_given_once(&changes(change)).map_err(|error| error.to_string());
        assert_eq!(check(&["learner.clip=0.1", "learner.gamma=0.9"]), Ok(()));
        let error = check(&["learner.clip=0.1", "learner.clip=0.2"]).unwrap_err();
        assert!(error.contains("by --change twice"), "{error}");
    }

    #[test]
    fn only_what_keeps_the_state_of_a_run_may_change() {
        assert!(check_changeable(&changes(&["learner.clip=0.1"])).is_ok());
        let error = check_changeable(&changes(&["learner.n_envs=8"])).unwrap_err().to_string();
        assert!(error.contains("`learner.n_envs` cannot change"), "{error}");
    }
}
