//! What rows are called in tables, figures and sentences.

use toml::Value;

use super::plan::{PlannedPart, PlannedRow};

/// Names the type of a row's notifications.
pub(super) fn notification(row: &PlannedRow) -> String {
    if row.row.script.is_some() {
        return "scripted".to_owned();
    }
    let section = row.config.table.get("notifier");
    let kind = section.and_then(|section| section.get("notification")).and_then(Value::as_str);
    kind.unwrap_or_default().replace('_', " ")
}

/// Names two rows in a sentence: by their titles, and by what they may choose where the titles are the same.
pub(super) fn told_apart(rows: [&PlannedRow; 2]) -> [String; 2] {
    let titles = rows.map(|row| inside_a_sentence(&row.row.title));
    if titles[0] != titles[1] {
        return titles;
    }
    rows.map(|row| format!("{} ({})", titles[0], notification(row)))
}

/// Names a row: by its title, or, where rows share it, by its name.
pub(super) fn label_of(planned: &PlannedPart, row: &PlannedRow) -> String {
    let title = &row.row.title;
    let n = planned.part.rows.iter().filter(|other| other.title == *title).count();
    if n > 1 { row.row.name.replace('_', " ") } else { title.clone() }
}

/// Writes a title's first letter small, unless it is a symbol such as R or the N of N(2, 1).
fn inside_a_sentence(title: &str) -> String {
    let mut letters = title.chars();
    match (letters.next(), letters.clone().next()) {
        (Some(first), Some(second)) if second.is_lowercase() => {
            first.to_lowercase().chain(letters).collect()
        }
        _ => title.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn titles_become_words_of_a_sentence_and_symbols_stay() {
        for (title, inside) in [
            ("Convey & react", "convey & react"),
            ("R = l - 2", "R = l - 2"),
            ("N(2, 1.0)", "N(2, 1.0)"),
            ("W/ convey", "W/ convey"),
            ("", ""),
        ] {
            assert_eq!(inside_a_sentence(title), inside);
        }
    }
}
