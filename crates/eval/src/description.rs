//! What a task shows, offers and pays, as text.

use leadtime_sims::{Description, ObservationLayout, Quantity};
use leadtime_table::Table;

/// Describes a task in three parts, with tables written by `write`.
pub fn describe(description: &Description, write: fn(&Table) -> String) -> String {
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
    let parts = parts.chain([("Action: one choice per head, in this order", heads)]).chain(paid);
    let texts = parts.map(|(title, table)| format!("{title}\n\n{}", write(&table)));
    texts.collect::<Vec<_>>().join("\n")
}

/// Numbers whose names differ in one number alone, such as `car1.x` to `car9.x`.
struct Alike {
    /// With an N for the number; names are of small letters.
    name: String,
    meaning: String,
    range: [f32; 2],
    numbers: Vec<u64>,
}

/// Lists the numbers of an observation, a row for those that are alike.
fn quantities(quantities: &[Quantity]) -> Table {
    let mut rows: Vec<Alike> = Vec::new();
    for Quantity { name, meaning, range } in quantities {
        let digits = first_number(name).unwrap_or_default();
        let number: Option<u64> = digits.parse().ok();
        let name = number.map_or_else(|| name.clone(), |_| name.replacen(digits, "N", 1));
        let is_alike = |row: &&mut Alike| (&row.name, &row.meaning) == (&name, meaning);
        if let Some(row) = rows.iter_mut().find(is_alike) {
            row.numbers.extend(number);
        } else {
            let (meaning, numbers) = (meaning.clone(), number.into_iter().collect());
            rows.push(Alike { name, meaning, range: *range, numbers });
        }
    }
    let mut table = Table::new(["name", "range", "what it is"]).left(&[0, 1, 2]);
    for Alike { name, meaning, range, numbers } in rows {
        let is_bounded = range.iter().all(|bound| bound.is_finite());
        let bounds = range.map(|bound| decimals(f64::from(bound), 3).to_string());
        let range = if is_bounded { bounds.join(" to ") } else { "any".to_owned() };
        let numbers = match numbers[..] {
            [first, .., last] => format!("{first}..{last}"),
            [only] => only.to_string(),
            [] => String::new(),
        };
        let name = name.replacen('N', &numbers, 1);
        table.push([name, range, meaning]);
    }
    table
}

/// Finds the first number in a name.
fn first_number(name: &str) -> Option<&str> {
    let (_, digits) = name.split_at(name.find(|c: char| c.is_ascii_digit())?);
    let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    Some(&digits[..end])
}

/// Rounds to so many digits after the point.
fn decimals(x: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    (x * scale).round() / scale
}
