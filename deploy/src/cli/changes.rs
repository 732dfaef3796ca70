//! `--change`: which settings get another value in a run that goes on.

use anyhow::ensure;
use leadtime_config::Override;
use leadtime_config::identity::CHANGEABLE;

/// Reads a change of a setting in a run that goes on.
pub(super) fn parse(text: &str) -> Result<Override, String> {
    Override::parse(text).map(|change| change.given_by("--change"))
}

/// Refuses a key that gets two values: by two changes, or by a change and by `--set`.
pub(super) fn check_given_once(changes: &[Override], set: &[Override]) -> anyhow::Result<()> {
    for (i, change) in changes.iter().enumerate() {
        let key = change.key();
        let is_set = set.iter().any(|set| holds(&set.key(), &key));
        ensure!(!is_set, "`{key}` is given by --change and by --set: leave one of them out");
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

/// Tells whether a key is that of a setting, or of the section that holds it.
fn holds(key: &str, setting: &str) -> bool {
    let rest = setting.strip_prefix(key);
    rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changes(texts: &[&str]) -> Vec<Override> {
        texts.iter().map(|text| parse(text).unwrap()).collect()
    }

    #[test]
    fn a_key_gets_one_value() {
        let check = |change: &[&str], set: &[&str]| {
            check_given_once(&changes(change), &changes(set)).map_err(|error| error.to_string())
        };
        assert_eq!(check(&["learner.clip=0.1", "learner.gamma=0.9"], &["learner.clips=1"]), Ok(()));
        for set in ["learner.clip=0.4", "learner={clip=0.4}"] {
            let error = check(&["learner.clip=0.1"], &[set]).unwrap_err();
            assert!(error.starts_with("`learner.clip` is given by --change and by"), "{error}");
        }
        let error = check(&["learner.clip=0.1", "learner.clip=0.2"], &[]).unwrap_err();
        assert!(error.contains("by --change twice"), "{error}");
    }

    #[test]
    fn only_what_keeps_the_state_of_a_run_may_change() {
        assert!(check_changeable(&changes(&["learner.clip=0.1"])).is_ok());
        let error = check_changeable(&changes(&["learner.n_envs=8"])).unwrap_err().to_string();
        assert!(error.contains("`learner.n_envs` cannot change"), "{error}");
    }
}
