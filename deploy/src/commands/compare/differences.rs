//! What a part states over its rows: differences, of measures that there are.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::bail;
use leadtime_eval::measure::{Difference, Evaluation};
use leadtime_eval::study::RowResult;

use super::judging::bootstrap;
use super::naming::told_apart;
use super::plan::PlannedPart;
use super::study::DifferenceOf;

/// One evaluation per training seed.
pub(super) type BySeed = Vec<Evaluation>;

/// Evaluations by row and person.
pub(super) type Sampled = BTreeMap<(String, String), BySeed>;

/// Checks that every measure that a part asks for is one of some row's.
///
/// # Errors
///
/// One sentence that names it, and those there are.
pub(super) fn check_measures(planned: &PlannedPart, rows: &[RowResult]) -> anyhow::Result<()> {
    let summaries = || rows.iter().flat_map(|row| &row.judged).map(|judged| &judged.summary);
    let stated = planned.part.differences.iter().map(|difference| &difference.measure);
    for wanted in planned.part.columns.iter().chain(stated) {
        if summaries().all(|summary| summary.get(wanted).is_none()) {
            let measures = summaries().flat_map(|summary| &summary.measures);
            let known: BTreeSet<&str> = measures.map(|measure| measure.name.as_str()).collect();
            let known = known.into_iter().collect::<Vec<_>>().join(", ");
            bail!("part `{}`: there is no measure `{wanted}`; known: {known}", planned.part.name);
        }
    }
    Ok(())
}

/// States a difference; `None` where a row was not asked for, or has no such measure.
pub(super) fn difference(
    planned: &PlannedPart,
    stated: &DifferenceOf,
    sampled: &Sampled,
) -> Option<Difference> {
    let DifferenceOf { of, minus, on, measure } = stated;
    let evaluated = |row: &String| sampled.get(&(row.clone(), on.clone())).map(Vec::as_slice);
    let row = |name: &String| planned.rows.iter().find(|row| row.row.name == *name);
    let person = planned.part.evaluations.iter().find(|person| person.name == *on)?;
    let (a, b) = (evaluated(of)?, evaluated(minus)?);
    let [of, minus] = told_apart([row(of)?, row(minus)?]);
    let minus = format!("{minus} (both on: {})", person.title);
    Difference::over_seeds((&of, a), (&minus, b), measure, &bootstrap())
}
