//! The page is well formed, needs nothing from outside, and cannot be broken by its texts.

use std::collections::BTreeMap;

use leadtime_numerics::stats::Bootstrap;
use leadtime_table::Table;

use crate::draw::inspect::{LEGIBLE, contrast};
use crate::figure::{Band, BandPanel, ShareRow};
use crate::measure::{Comparison, Evaluation};
use crate::playthrough::{Spoken, synthetic};
use crate::report::{Book, Picture, Provenance, ProvenanceDetail, Report, Verdict, player};

/// What every text of the report under test contains.
const NASTY: &str = "<script>alert('&')</script>\"";

fn evaluation(player: &str, success: f32) -> Evaluation {
    let of = |success: f32| (10, [success, 0.0, 5.0 * success]);
    let rows = [[of(success); 8].as_slice(), &[of(1.0 - success); 2]].concat();
    let measures = ["success", "timed_out", "danger_steps"];
    Evaluation { player: player.to_owned(), ..Evaluation::of(measures, &rows) }
}

fn report() -> Report {
    let text = |words: &str| format!("{words} {NASTY}");
    let (trained, unaided) = (evaluation(&text("trained"), 1.0), evaluation("unaided", 0.0));
    let comparison = Comparison::new(&[trained.clone(), unaided.clone()], Bootstrap::new(1))
        .with_difference(&trained, &unaided, "success");
    let points: Vec<_> = (0..80).map(|i| [f64::from(i) * 4000.0, f64::from(i % 7)]).collect();
    let bands = vec![Band { label: text("trained"), ..Band::summary(&points, 40) }];
    let picture = Picture::playthrough(&Spoken::from(synthetic::playthrough()), "play-0");
    let picture = Picture { title: text("An episode"), caption: text("Look."), ..picture };
    let mut changed = Table::new(["", "built in", "run"]);
    changed.push([text("learner.clip"), "0.2".to_owned(), text("0.3")]);
    let provenance = Provenance {
        run: text("run"),
        details: vec![ProvenanceDetail::new(text("seed"), text("1"))],
        command: text("leadtime up -c lander"),
        settings: text("seed = 1"),
    };
    Report {
        title: text("Report"),
        lead: text("A notifier was trained."),
        verdicts: vec![
            Verdict { holds: true, sentence: text("It learned.") },
            Verdict { holds: false, sentence: text("It is perfect.") },
        ],
        comparison: Some(comparison),
        notes: vec![text("One seed.")],
        pictures: vec![picture],
        curves: vec![BandPanel { label: text("return"), range: None, bands }],
        staleness: BTreeMap::from([(0, 4), (1, 90)]),
        phases: vec![ShareRow { label: text("actor"), parts: vec![(text("wait"), 4.0)] }],
        books: vec![Book { name: text("trained"), count: 94, meaning: text("used") }],
        books_balance: Some(true),
        provenance: vec![provenance],
        changed: Some(changed),
    }
}

/// Walks through the tags of a page and checks that each is closed in turn.
fn assert_well_formed(page: &str) {
    let body = page.strip_prefix("<!DOCTYPE html>").unwrap();
    let mut open: Vec<&str> = Vec::new();
    for piece in body.split('<').skip(1) {
        let (tag, _) = piece.split_once('>').expect("a tag ends");
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        let name = tag.split([' ', '\n', '/']).find(|part| !part.is_empty()).unwrap();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "closing tag");
        } else if !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert_eq!(open, Vec::<&str>::new());
}

#[test]
fn the_page_is_well_formed_and_has_every_section() {
    let page = report().html();
    assert_well_formed(&page);
    let mut places = vec![page.find("class=\"verdicts\"").unwrap()];
    for id in ["playthroughs", "results", "training", "system", "provenance", "settings"] {
        let section = format!("<section id=\"{id}\">");
        assert_eq!(page.matches(&section).count(), 1, "{id}");
        places.push(page.find(&section).unwrap());
    }
    assert!(places.is_sorted(), "the verdict first, then the picture: {places:?}");
    let mut ids: Vec<&str> =
        page.split(" id=\"").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    let n = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), n, "ids are unique");
}

#[test]
fn no_text_becomes_markup_and_nothing_is_needed_from_outside() {
    let page = report().html();
    assert!(!page.contains("<script"));
    let escaped = "&lt;script&gt;alert(&#39;&amp;&#39;)&lt;/script&gt;&quot;";
    assert!(page.matches(escaped).count() >= 15);
    for reference in ["src=", "href=", "url(http", "@import", "<link"] {
        assert!(!page.contains(reference), "{reference}");
    }
    // The one address is SVG's namespace, which nobody fetches.
    assert_eq!(page.matches("http").count(), page.matches("http://www.w3.org/2000/svg").count());
}

fn folded<'a>(page: &'a str, summary: &str) -> &'a str {
    let (_, body) = page.split_once(&format!("<summary>{summary}</summary>")).expect("folded");
    body.split("</details>").next().unwrap()
}

#[test]
fn the_measures_that_matter_are_open_and_the_others_folded_and_all_are_explained() {
    let page = report().html();
    let more = folded(&page, "2 more measures");
    assert!(more.contains("danger steps") && more.contains("0 in every episode: timed out."));
    let open = page.replace(more, "");
    let results = open.split("<section id=\"results\">").nth(1).unwrap();
    let results = results.split("<details>").next().unwrap();
    assert!(results.contains("success rate") && !results.contains("danger steps"));
    let explained = folded(&page, "What the measures mean");
    for text in [
        "share of episodes in which the task was done",
        "at the time limit",
        "steps inside a danger",
    ] {
        assert!(explained.contains(text), "{text}");
    }
}

#[test]
fn a_picture_is_told_in_words_and_the_settings_are_whole() {
    let page = report().html();
    assert!(folded(&page, "Transcript: what was said, word by word").contains("understands"));
    assert!(page.contains("<desc>"));
    let summary =
        format!("All settings of {}", leadtime_table::escape(&report().provenance[0].run));
    assert!(folded(&page, &summary).contains("seed = 1"));
}

/// Returns the value of a colour of the page's style, light or dark.
fn page_colour(name: &str, dark: bool) -> &'static str {
    let rules = super::STYLE.split(&format!("--{name}: ")).nth(if dark { 2 } else { 1 });
    &rules.expect("a colour")[..7]
}

#[test]
fn every_text_of_a_page_has_enough_contrast_in_light_and_in_dark() {
    for dark in [false, true] {
        let [text, muted, paper, panel, good, bad] =
            ["text", "muted", "paper", "panel", "good", "bad"].map(|name| page_colour(name, dark));
        for ink in [text, muted, good, bad] {
            for ground in [paper, panel] {
                assert!(contrast(ink, ground) >= LEGIBLE, "{ink} on {ground}");
            }
        }
    }
    let uses: Vec<&str> = super::STYLE.split(" color: var(--").skip(1).collect();
    let known = ["text)", "muted)", "good)", "bad)"];
    assert!(uses.iter().all(|used| known.iter().any(|ink| used.starts_with(ink))), "{uses:?}");
}

#[test]
fn a_page_that_plays_is_well_formed() {
    assert_well_formed(&player(&Spoken::from(synthetic::playthrough()), 5, 1.0));
}

#[test]
fn an_empty_report_is_still_a_page() {
    let page = Report::default().html();
    assert_well_formed(&page);
    assert!(!page.contains("<section"));
}
