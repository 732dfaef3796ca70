//! The domain `python`: from its settings to an environment.

use leadtime_proto::EnvSpec;
use leadtime_sims::registry::{WorldOnly, read};
use leadtime_sims::{DomainEntry, Environment, TaskError};

use crate::environment::PythonEnvironment;
use crate::pool::Workers;
use crate::settings::{DOMAIN, PythonSettings, SpecSetting};

/// Describes the domain, whose environments are stepped by these workers.
pub fn entry(workers: &Workers) -> DomainEntry {
    let (builds, completes) = (workers.clone(), workers.clone());
    DomainEntry::from_builder(DOMAIN, move |settings| build(&builds, settings))
        .completed_by(move |settings| complete(&completes, settings))
}

fn settings(settings: &str) -> Result<PythonSettings, TaskError> {
    let WorldOnly { world } = read::<WorldOnly<PythonSettings>>(DOMAIN, settings)?;
    world.check()?;
    match &world.spec {
        // What a worker says of its heads is checked when it has said it.
        SpecSetting::Ask => EnvSpec::check_metrics(&world.metrics)?,
        SpecSetting::Known(spec) => spec.env_spec(&world.metrics).check()?,
    }
    Ok(world)
}

fn build(workers: &Workers, text: &str) -> Result<Box<dyn Environment>, TaskError> {
    let settings = settings(text)?;
    let launch = workers.launch(&settings);
    let world = match &settings.spec {
        SpecSetting::Ask => workers.ask(&launch?)?,
        SpecSetting::Known(world) => {
            let world = world.clone();
            if workers.starts_at_once() {
                workers.start(&launch?)?;
            }
            world
        }
    };
    let spec = world.env_spec(&settings.metrics);
    let launch = workers.launch(&settings).map_err(|error| error.to_string());
    Ok(Box::new(PythonEnvironment::new(workers.clone(), launch, settings.snapshot, spec)))
}

/// Writes into the settings what a worker says of its environments, where nothing is written.
fn complete(workers: &Workers, text: &str) -> Result<Option<String>, TaskError> {
    let mut world = settings(text)?;
    if world.spec != SpecSetting::Ask {
        return Ok(None);
    }
    world.spec = SpecSetting::Known(workers.ask(&workers.launch(&world)?)?);
    let written = serde_json::to_string(&WorldOnly { world });
    written.map(Some).map_err(|fault| TaskError::Settings { domain: DOMAIN, fault })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_no_report_could_tell_apart_are_refused_before_a_worker_is_started() {
        let refused = |world: &str| {
            let text = format!(r#"{{"world": {{"worker": "false", {world}}}}}"#);
            // Neither is permitted: it would be refused for that.
            complete(&Workers::default(), &text).unwrap_err().to_string()
        };
        let twice = refused(r#""metrics": ["success", "success"]"#);
        assert!(twice.starts_with("two metrics are `success`"), "{twice}");
        let computed = refused(r#""metrics": ["length"]"#);
        assert!(computed.starts_with("a metric is `length`, which is the name of"), "{computed}");
        let head = r#"{"name": "a", "n_choices": 2}"#;
        let heads = refused(&format!(r#""spec": {{"obs_dim": 2, "heads": [{head}, {head}]}}"#));
        assert!(heads.starts_with("two heads of an action are `a`"), "{heads}");
    }
}
