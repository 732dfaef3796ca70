//! Whether workers keep the promise of equal bits: two processes take the same steps.

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

/// Has two workers take the same steps, and compares every byte that they show.
///
/// # Errors
///
/// [`Error`] if no worker can be started; what one does wrong once it runs is in the report.
pub fn check_worker(workers: &Workers, settings: &PythonSettings) -> Result<WorkerReport, Error> {
    let launch = workers.launch(settings)?;
    let mut shown = Vec::new();
    let mut report = WorkerReport { n_steps: N_STEPS, versions: Vec::new(), defects: Vec::new() };
    for place in [0, launch.batch - 1] {
        // Neither the process nor the place in it may make a difference.
        let mut link = WorkerLink::start(launch.clone())?;
        let said = &link.hello().world.versions;
        report.versions =
            said.iter().map(|(package, version)| format!("{package} {version}")).collect();
        match play(&mut link, place, N_STEPS) {
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
             actions alone"
        )
    });
    report.defects.extend(found);
    Ok(report)
}
