//! The kitchen's table: how many values differ per recording.

use leadtime_sims::steakhouse::conformance::Report;

use crate::output;

pub(super) fn print(report: &Report) {
    output::line(&format!("recorded by {}\n", report.source));
    output::line(&format!("{:<36} {:>9} {:>12}", "recording", "compared", "differences"));
    for comparison in &report.comparisons {
        let (compared, differences) = (comparison.n_compared, comparison.n_differences);
        output::line(&format!("{:<36} {compared:>9} {differences:>12}", comparison.name));
        if let Some(first) = &comparison.first_difference {
            output::line(&format!("    first: {first}"));
        }
    }
    output::line(if report.passed { "\npassed" } else { "\nfailed" });
}
