//! What a task shows, offers and pays, as text.

use leadtime_sims::{Description, Fact, ObservationLayout, Quantity};
use leadtime_table::{Table, wrapped};

/// Describes a task in three parts, and the facts that it states in a fourth, with tables written by `write`; where
/// there is a `width`, in characters, facts are broken to fit it.
pub fn describe(
    description: &Description,
    facts: &[Fact],
    write: fn(&Table) -> String,
    width: Option<usize>,
) -> String {
    let Description { observation, actions, rewards } = description;
    let ObservationLayout { n_frames, frame, rest } = observation;
    let n = observation.quantities().len();
    let size = match n_frames {
        1 => format!("Observation: {n} numbers"),
        _ => format!(
            "Observation: {n} numbers = {n_frames} x {} + {}.\nIn each of the last {n_frames} steps, oldest first",
            frame.len(),
            rest.len()
        ),
    };
    let mut heads = Table::new(["head", "choices"]).left(&[0, 1]);
    for head in actions {
        heads.push([&head.name, &head.choices.join(", ")]);
    }
    let mut terms = Table::new(["amount", "for", "setting"]).left(&[1, 2]);
    for term in rewards {
        terms.push([&format!("{:+}", decimals(term.amount, 4)), &term.when, &term.key]);
    }
    let now = (!rest.is_empty()).then(|| ("Then, of the present step", quantities(rest)));
    let paid = "Reward of a step: the sum of each amount times what it is for";
    let paid = (!rewards.is_empty()).then_some((paid, terms));
    let parts = [(size.as_str(), quantities(frame))].into_iter().chain(now);
    let told = ("Facts that a sentence may presuppose", told(facts, width));
    let told = (!facts.is_empty()).then_some(told);
    let parts = parts.chain([("Action: one choice per head, in this order", heads)]);
    let parts = parts.chain(paid).chain(told);
    let texts = parts.map(|(title, table)| format!("{title}\n\n{}", write(&table)));
    texts.collect::<Vec<_>>().join("\n")
}

/// Lists facts, each on as many lines as it takes.
fn told(facts: &[Fact], width: Option<usize>) -> Table {
    let mut table = Table::new(["fact", "holds when"]).left(&[0, 1]);
    let longest = facts.iter().map(|fact| fact.name.len()).max().unwrap_or_default();
    let room = width.map_or(usize::MAX, |width| width.saturating_sub(longest + 2));
    for Fact { name, meaning } in facts {
        for (i, line) in wrapped(meaning, room, 0).lines().enumerate() {
            table.push([if i == 0 { *name } else { "" }, line]);
        }
    }
    table
}

/// Numbers in a row that are alike but for one number in their names, such as `car1.x` to `car9.x`.
struct Alike<'a> {
    /// What stands around the number.
    around: [&'a str; 2],
    /// The first and the last number, if the names have one.
    numbers: Option<[u64; 2]>,
    quantity: &'a Quantity,
}

impl Alike<'_> {
    fn name(&self) -> String {
        let [before, after] = self.around;
        match self.numbers {
            None => before.to_owned(),
            Some([first, last]) if first == last => format!("{before}{first}{after}"),
            Some([first, last]) => format!("{before}{first}..{last}{after}"),
        }
    }
}

/// Lists the numbers of an observation, a row for those that are alike.
fn quantities(quantities: &[Quantity]) -> Table {
    let mut rows: Vec<Alike<'_>> = Vec::new();
    for quantity in quantities {
        let (around, number) = split_at_number(&quantity.name);
        let (meaning, range) = (&quantity.meaning, quantity.range);
        let goes_on = |row: &&mut Alike<'_>| {
            let next = row.numbers.map(|[_, last]| last + 1);
            let is_alike = row.quantity.meaning == *meaning && row.quantity.range == range;
            row.around == around && number.is_some() && next == number && is_alike
        };
        match (rows.iter_mut().find(goes_on), number) {
            (Some(Alike { numbers: Some([_, last]), .. }), Some(number)) => *last = number,
            _ => rows.push(Alike { around, numbers: number.map(|n| [n, n]), quantity }),
        }
    }
    let mut table = Table::new(["name", "range", "what it is"]).left(&[0, 1, 2]);
    for row in rows {
        let Quantity { meaning, range, .. } = row.quantity;
        let is_bounded = range.iter().all(|bound| bound.is_finite());
        let bounds = range.map(|bound| decimals(f64::from(bound), 3).to_string());
        let range = if is_bounded { bounds.join(" to ") } else { "any".to_owned() };
        table.push([row.name(), range, meaning.clone()]);
    }
    table
}

/// Splits a name around its first number; one without comes whole.
fn split_at_number(name: &str) -> ([&str; 2], Option<u64>) {
    let Some(start) = name.find(|c: char| c.is_ascii_digit()) else { return ([name, ""], None) };
    let (before, digits) = name.split_at(start);
    let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    let (number, after) = digits.split_at(end);
    number.parse().map_or(([name, ""], None), |number| ([before, after], Some(number)))
}

/// Rounds to so many digits after the point.
fn decimals(x: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    (x * scale).round() / scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_fact_takes_lines() {
        let fact = Fact { name: "wet", meaning: "the floor in front is wet" };
        let lines = |width| told(&[fact], width).text().lines().count();
        assert_eq!((lines(None), lines(Some(20))), (3, 4));
    }

    #[test]
    fn numbers_in_a_row_share_a_line_and_others_do_not() {
        let flag = |name: &str| Quantity::flag(name, "");
        let mut all = ["North", "car1.x", "car1.y", "car2.x", "car2.y", "k2", "k5"].map(flag);
        assert_eq!(names(&all), ["North", "car1..2.x", "car1..2.y", "k2", "k5"]);
        all[3].range = [-1.0, 1.0];
        assert_eq!(names(&all), ["North", "car1.x", "car1..2.y", "car2.x", "k2", "k5"]);
    }

    fn names(all: &[Quantity]) -> Vec<String> {
        let table = quantities(all).markdown();
        let cell = |line: &str| line.split('|').nth(1).unwrap_or_default().trim().to_owned();
        table.lines().skip(2).map(cell).collect()
    }
}
