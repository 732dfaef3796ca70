//! The highway's table: the largest errors per scenario.

use leadtime_sims::highway::conformance::{Errors, Report};

use crate::output;

pub(super) fn print(report: &Report) {
    output::line(&format!("recorded by {}", report.source));
    let (state, observation) = (report.state_bound, report.observation_bound);
    output::line(&format!("bounds: states {state:.0e}, observations {observation:.0e}\n"));
    output::line(&format!(
        "{:<16} {:>7} {:>7} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9} {:>10}",
        "scenario",
        "states",
        "steps",
        "position",
        "heading",
        "speed",
        "command",
        "observed",
        "reward",
        "mismatches"
    ));
    for scenario in &report.scenarios {
        let Errors { position, heading, speed, command, observation, reward, .. } = scenario.errors;
        let mark = if scenario.passed { "" } else { "  beyond the bounds" };
        output::line(&format!(
            "{:<16} {:>7} {:>7} {position:>9.1e} {heading:>9.1e} {speed:>9.1e} {command:>9.1e} {observation:>9.1e} \
             {reward:>9.1e} {:>10}{mark}",
            scenario.name, scenario.n_states, scenario.n_decisions, scenario.n_mismatches
        ));
    }
    output::line(if report.passed { "\npassed" } else { "\nfailed" });
}
