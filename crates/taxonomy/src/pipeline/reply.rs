//! Reads replies as models really write them: with fences, numbers, afterthoughts, and cut off in the middle.

use super::backend::{Finish, Reply};

/// What a generation reply proposes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Proposals {
    /// Sentences that are there as a whole.
    pub(super) whole: Vec<String>,
    /// What stood there when the reply ran into its limit.
    pub(super) cut: Option<String>,
}

/// Reads the sentences of a generation reply, which may have none.
///
/// A JSON list of strings is taken as it is, whatever stands around it; otherwise every line is a sentence, less
/// numbering, bullets and quotes. The last sentence of a reply that ran into its limit is not trusted.
pub(super) fn sentences(reply: &Reply) -> Proposals {
    let text = body(&reply.text);
    let is_cut = reply.finish == Finish::Length;
    if let Some(found) = json_list(&text, is_cut) {
        return found;
    }
    let separator = if text.trim().contains('\n') { '\n' } else { ';' };
    let mut lines: Vec<&str> = text.split(separator).map(bare).collect();
    let is_whole = text.ends_with('\n');
    let cut = if is_cut && !is_whole { lines.pop() } else { None };
    let talk = |line: &&str| !line.is_empty() && !line.ends_with(':');
    Proposals {
        whole: lines.into_iter().filter(talk).map(str::to_owned).collect(),
        cut: cut.filter(talk).map(str::to_owned),
    }
}

/// Finds a JSON list of strings; one that ends in the middle only in a reply that was cut.
fn json_list(text: &str, is_cut: bool) -> Option<Proposals> {
    let mut rest = text[text.find('[')? + 1..].trim_start();
    let mut found = Proposals::default();
    while rest.starts_with('"') {
        let mut strings = serde_json::Deserializer::from_str(rest).into_iter::<String>();
        let Some(Ok(sentence)) = strings.next() else {
            found.cut = Some(bare(rest).to_owned()).filter(|_| is_cut);
            return found.cut.is_some().then_some(found);
        };
        found.whole.push(sentence);
        rest = rest[strings.byte_offset()..].trim_start();
        rest = rest.strip_prefix(',').unwrap_or(rest).trim_start();
    }
    (!found.whole.is_empty() && (is_cut || rest.starts_with(']'))).then_some(found)
}

/// Reads a rating in the three-line form: one percentage per word.
///
/// ```text
/// Instruction: Slow down now.
/// Words: Slow | down | now.
/// Comprehension after each word: 40, 90, 95
/// ```
///
/// None if the numbers are not one per word, or not within 0 to 100: they are asked for again, never clipped.
pub(super) fn joint_rating(reply: &Reply, n_words: usize) -> Option<Vec<u8>> {
    if reply.finish == Finish::Length {
        return None;
    }
    let text = body(&reply.text);
    let line = text.lines().find(|line| line.trim().to_lowercase().starts_with("comprehension"))?;
    let numbers = line.rsplit(':').next()?;
    let percent = |item: &str| item.trim().trim_end_matches(['%', '.']).parse::<u8>().ok();
    let rated: Option<Vec<u8>> = numbers.split([',', '|']).map(percent).collect();
    rated.filter(|rated| rated.len() == n_words && rated.iter().all(|percent| *percent <= 100))
}

/// Reads a rating of one prefix: the one number of the reply.
pub(super) fn percentage(reply: &Reply) -> Option<u8> {
    let text = body(&reply.text);
    let mut numbers = text.split(|c: char| !c.is_ascii_digit()).filter(|part| !part.is_empty());
    let number = numbers.next()?.parse::<u8>().ok()?;
    (numbers.next().is_none() && number <= 100 && !text.contains('-')).then_some(number)
}

/// Writes a rating as replies and reports show it.
pub(super) fn joined(rating: &[u8]) -> String {
    rating.iter().map(u8::to_string).collect::<Vec<_>>().join(", ")
}

/// Drops what a model thinks aloud and the fences it puts around its answer.
fn body(text: &str) -> String {
    let answer = match text.rfind("</think>") {
        Some(end) => &text[end + "</think>".len()..],
        None => text,
    };
    let lines = answer.lines().filter(|line| !line.trim_start().starts_with("```"));
    let mut body = lines.collect::<Vec<_>>().join("\n");
    if answer.ends_with('\n') {
        body.push('\n');
    }
    body
}

/// Drops numbering, bullets and quotes around a sentence.
fn bare(line: &str) -> &str {
    let line = line.trim();
    let digits = line.len() - line.trim_start_matches(|c: char| c.is_ascii_digit()).len();
    let numbered = digits > 0 && line[digits..].starts_with(['.', ')']);
    let line = if numbered { &line[digits + 1..] } else { line };
    line.trim_start_matches(['-', '*', ' ']).trim_matches(['"', '\u{201c}', '\u{201d}', ' ', ','])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reply(text: &str) -> Reply {
        Reply::complete(text)
    }

    #[test]
    fn sentences_are_found_in_whatever_surrounds_them() {
        let wanted = ["Go up.", "Climb now!"];
        for text in [
            "Go up.\nClimb now!",
            "Here are two:\n\n1. Go up.\n2) \"Climb now!\"\n",
            "<think>short, clear\nones</think>\n```\n- Go up.\n* Climb now!\n```",
            "[\"Go up.\", \"Climb now!\"]",
            "Sure: {\"notifications\": [\"Go up.\", \"Climb now!\",]} I hope it helps.",
            "Go up.; Climb now!",
        ] {
            let found = sentences(&reply(text));
            assert_eq!(found.whole, wanted, "{text}");
            assert_eq!(found.cut, None, "{text}");
        }
        assert_eq!(sentences(&reply("  \n")), Proposals::default());
        // Brackets that are no list are part of a line.
        assert_eq!(sentences(&reply("Go up [now].")).whole, ["Go up [now]."]);
    }

    #[test]
    fn a_truncated_sentence_is_kept_apart() {
        for text in ["Go up.\nClimb no", "Go up.; Climb no", "[\"Go up.\", \"Climb no"] {
            let found = sentences(&Reply { finish: Finish::Length, ..reply(text) });
            assert_eq!(found.whole, ["Go up."], "{text}");
            assert_eq!(found.cut.as_deref(), Some("Climb no"), "{text}");
        }
        let cut = Reply { finish: Finish::Length, ..reply("Go up.\n") };
        assert_eq!(sentences(&cut).cut, None);
    }

    #[test]
    fn a_rating_has_one_percentage_per_word() {
        let good = "Instruction: Go up.\nWords: Go | up.\nComprehension after each word: 20, 90%";
        assert_eq!(joint_rating(&reply(good), 2), Some(vec![20, 90]));
        assert_eq!(joint_rating(&reply(good), 3), None);
        for bad in [
            "Comprehension after each word: 20, 190",
            "Comprehension after each word: 20, 101",
            "Comprehension after each word: 20, -5",
            "Comprehension after each word: 20, high",
            "20, 90",
        ] {
            assert_eq!(joint_rating(&reply(bad), 2), None, "{bad}");
        }
        let cut = Reply { finish: Finish::Length, ..reply(good) };
        assert_eq!(joint_rating(&cut, 2), None);
    }

    #[test]
    fn a_prefix_has_one_number() {
        assert_eq!(percentage(&reply(" 85%\n")), Some(85));
        assert_eq!(percentage(&reply("<think>70 or 80</think>75")), Some(75));
        for bad in ["", "between 20 and 30", "120", "-5", "high"] {
            assert_eq!(percentage(&reply(bad)), None, "{bad}");
        }
    }
}
