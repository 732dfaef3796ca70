use super::*;
use crate::test_support::{CART, sentence};

fn refused(from: &str, to: &str) -> String {
    assert!(CART.contains(from), "{from}");
    sentence(Study::parse("study", &CART.replacen(from, to, 1)))
}

#[test]
fn a_study_reads_as_it_is_written() {
    let study = Study::parse("study", CART).unwrap();
    let part = &study.parts[0];
    assert_eq!((study.policy, part.layout), (WhichPolicy::Last, Layout::Lines));
    assert_eq!((study.seeds, study.failed_below), (None, 0.05));
    let [a, b] = &part.rows[..] else { panic!("two rows") };
    assert!(a.is_evaluated_on("own") && a.is_evaluated_on("long") && !b.is_evaluated_on("own"));
    let published = &a.published()[0];
    assert_eq!((published.mean, published.deviation), (490.0, Some(6.0)));
    assert_eq!(b.published()[0].evaluation.as_deref(), Some("long"));
}

#[test]
fn an_inconsistent_study_is_refused_with_one_sentence() {
    for (from, to, reason) in [
        ("title = \"t\"", "heading = \"t\"", "unknown key `heading`"),
        ("name = \"b\"", "name = \"a\"", "`a` is there twice"),
        ("name = \"b\"", "name = \"B 2\"", "`B 2` is not a name"),
        ("on = [\"long\"]", "on = [\"short\"]", "row `b`: there is no evaluation `short`"),
        ("paper_on.long", "paper_on.short", "row `b`: there is no evaluation `short`"),
        ("minus = \"a\"", "minus = \"c\"", "`differences`: there is no row `c`"),
        ("on = \"long\",", "on = \"nobody\",", "`differences`: there is no evaluation `nobody`"),
        ("on = \"long\",", "on = \"own\",", "row `b` is not evaluated on `own`"),
        ("paper_on.long", "paper_on.own", "row `b`: `paper_on.own`, where it is not evaluated"),
        ("quick_steps", "layout = \"grid\"\nquick_steps", "in a grid `own` needs `at`"),
        ("[490.0, 6.0]", "[]", "row `a`: `return` needs a mean"),
        ("[\"return\"]", "[]", "`columns` is empty"),
        ("quick_steps = 512", "quick_steps = 0", "`quick_steps` is 0"),
        ("quick", "axis_name = \"a/b\"\nquick", "`axis_name`: `a/b` is not a name"),
        ("quick_steps = 512", "seeds = 0\nquick_steps = 512", "`seeds` is 0; allowed: 1 to 1000"),
        ("title = \"A\"", "title = \"A\"\nseeds = 2000", "row `a`: `seeds` is 2000"),
        ("title = \"A\"", "title = \"A\"\nseeds = 2\nscript = \"x\"", "a script is not trained"),
        ("lead = \"l\"", "lead = \"l\"\nseeds = 0", "`seeds` is 0"),
        (
            "lead = \"l\"",
            "lead = \"l\"\nfailed_below = 0.0",
            "`failed_below` is 0; allowed: above 0",
        ),
        ("quick", "pictured_on = \"x\"\nquick", "`pictured_on`"),
        (
            "quick",
            "trajectories_on = \"x\"\nquick",
            "`trajectories_on`: there is no evaluation `x`",
        ),
        ("quick", "maps = [{ profile = \"lander\" }]\nquick", "missing key `title`"),
    ] {
        let text = refused(from, to);
        assert!(text.contains(reason), "{reason}: {text}");
    }
    let text = sentence(Study::parse("study", "title = \"t\"\nlead = \"l\"\nparts = []"));
    assert!(text.contains("at least one of `parts`"), "{text}");
}
