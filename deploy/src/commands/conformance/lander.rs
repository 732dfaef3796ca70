//! The lander's table: errors per component before first contact.

use leadtime_sims::lander::conformance::Report;

use crate::output;

pub(super) fn print(report: &Report) {
    output::line(&format!("recorded by {}", report.source));
    for comparison in &report.comparisons {
        let wind = if comparison.wind { "with wind" } else { "without wind" };
        let (n, frames) = (comparison.n_episodes, comparison.n_frames);
        output::line(&format!("\n{wind}: {n} episodes, {frames} frames before first contact"));
        output::line(&format!(
            "{:<18} {:>10} {:>10} {:>10}",
            "component", "maximum", "median", "bound"
        ));
        let (reset, bound) = (comparison.reset_error, report.reset_bound);
        output::line(&format!("{:<18} {reset:>10.2e} {:>10} {bound:>10.2e}", "reset", "-"));
        for error in &comparison.components {
            let mark = if error.maximum <= error.bound { "" } else { "  beyond the bound" };
            output::line(&format!(
                "{:<18} {:>10.2e} {:>10.2e} {:>10.2e}{mark}",
                error.name, error.maximum, error.median, error.bound
            ));
        }
    }
    output::line(if report.passed { "\npassed" } else { "\nfailed" });
}
