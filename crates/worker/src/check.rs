//! Whether workers keep the promise of equal bits: two processes take the same steps, one of them with a second environment.

use crate::error::Error;
use crate::link::WorkerLink;
use crate::pool::Workers;
use crate::settings::PythonSettings;
use crate::trial::{difference, play};

/// Steps that two processes take.
const N_STEPS: usize = 200;

/// What the check of a worker found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkerReport {
    /// Steps that two processes took.
    pub n_steps: usize,
    /// Versions of Python and of the packages that step the environments.
    pub versions: Vec<String>,
    /// What breaks the promise of equal bits.
    pub defects: Vec<String>,
}

/// Has two workers take the same steps, and compares every byte that they show. One of them steps another environment of the
/// process as well, where `world.batch` lets it.
///
/// # Errors
///
/// [`Error`] if no worker can be started; what one does wrong once it runs is in the report.
pub fn check_worker(workers: &Workers, settings: &PythonSettings) -> Result<WorkerReport, Error> {
    let launch = workers.launch(settings)?;
    let mut shown = Vec::new();
    let mut report = WorkerReport { n_steps: N_STEPS, versions: Vec::new(), defects: Vec::new() };
    let last = launch.batch - 1;
    // Neither the process nor the place in it may make a difference, nor another environment that is stepped beside it.
    let beside: &[usize] = if last > 0 { &[last, 0] } else { &[0] };
    for places in [&[0], beside] {
        let mut link = WorkerLink::start(launch.clone())?;
        let said = &link.hello().world.versions;
        report.versions =
            said.iter().map(|(package, version)| format!("{package} {version}")).collect();
        match play(&mut link, places, N_STEPS) {
            Ok(rows) => shown.push(rows),
            Err(reason) => {
                // A second one would take as long to fail.
                report.defects.push(reason);
                return Ok(report);
            }
        }
    }
    let found = difference(&shown[0], &shown[1]).map(|(step, what)| {
        format!(
            "two processes differ in {what} after step {step}: the environment does not depend on its seed and its \
             actions alone; it may use its `index`, a clock, a generator of its own, or something that all environments of \
             a process share, such as an attribute of their class"
        )
    });
    report.defects.extend(found);
    Ok(report)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns what is found in a worker that steps so many environments.
    fn defects(mode: &str, batch: u32) -> Vec<String> {
        let fake = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/worker/fake.py");
        let worker = format!("python3 '{fake}' {mode}");
        let workers = Workers::default();
        workers.permit_configured();
        let settings = PythonSettings { worker, batch, ..PythonSettings::default() };
        check_worker(&workers, &settings).unwrap().defects
    }

    #[test]
    fn what_the_environments_of_a_process_share_is_found() {
        assert_eq!(defects("", 16), Vec::<String>::new());
        let shared = defects("shares", 2);
        let told = "two processes differ in observation[0]";
        assert!(shared.len() == 1 && shared[0].starts_with(told), "{shared:?}");
        assert_eq!(defects("shares", 1), Vec::<String>::new(), "nobody is beside it");
        let numbered = defects("numbered", 2);
        assert!(numbered.len() == 1 && numbered[0].contains("its `index`"), "{numbered:?}");
    }
}
