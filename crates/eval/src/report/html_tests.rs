//! The page is well formed, needs nothing from outside, and cannot be broken by its texts.

use std::collections::BTreeMap;

use leadtime_numerics::stats::Bootstrap;

use crate::figure::{Band, BandPanel, ShareRow};
use crate::measure::{Comparison, Evaluation};
use crate::playthrough::{Spoken, synthetic};
use crate::report::{Book, Fact, Picture, Report, Verdict};

/// What every text of the report under test contains.
const NASTY: &str = "<script>alert('&')</script>\"";

fn evaluation(player: &str, success: f32) -> Evaluation {
    let rows = [[(10, [success]); 8].as_slice(), &[(10, [1.0 - success]); 2]].concat();
    Evaluation { player: player.to_owned(), ..Evaluation::of(["success"], &rows) }
}

fn report() -> Report {
    let text = |words: &str| format!("{words} {NASTY}");
    let (trained, unaided) = (evaluation(&text("trained"), 1.0), evaluation("unaided", 0.0));
    let comparison = Comparison::new(&[trained.clone(), unaided.clone()], Bootstrap::new(1))
        .with_difference(&trained, &unaided, "success");
    let points: Vec<_> = (0..80).map(|i| [f64::from(i) * 4000.0, f64::from(i % 7)]).collect();
    let bands = vec![Band { label: text("trained"), ..Band::summary(&points, 40) }];
    let svg = Spoken::from(synthetic::playthrough()).svg("play-0").text;
    Report {
        title: text("Report"),
        lead: text("A notifier was trained."),
        verdicts: vec![
            Verdict { holds: true, sentence: text("It learned.") },
            Verdict { holds: false, sentence: text("It is perfect.") },
        ],
        comparison: Some(comparison),
        pictures: vec![Picture { title: text("An episode"), caption: text("Look."), svg }],
        curves: vec![BandPanel { label: text("return"), range: None, bands }],
        staleness: BTreeMap::from([(0, 4), (1, 90)]),
        phases: vec![ShareRow { label: text("actor"), parts: vec![(text("wait"), 4.0)] }],
        books: vec![Book { name: text("trained"), count: 94, meaning: text("used") }],
        books_balance: Some(true),
        provenance: vec![Fact::new(text("command"), text("leadtime smoke"))],
        notes: vec![text("One seed.")],
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
    for id in ["results", "playthroughs", "training", "system", "provenance", "notes"] {
        assert_eq!(page.matches(&format!("<section id=\"{id}\">")).count(), 1, "{id}");
    }
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

#[test]
fn an_empty_report_is_still_a_page() {
    let page = Report::default().html();
    assert_well_formed(&page);
    assert!(!page.contains("<section"));
}
