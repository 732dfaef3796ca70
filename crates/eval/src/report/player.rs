//! An episode as a page of its own: a slider over its moments, and the whole of it in one picture.

use leadtime_table::escape;

use super::contents::Picture;
use super::html::page;
use super::sections::described;
use crate::picture::Still;
use crate::playthrough::Spoken;

/// Moves through the moments; without it the page shows the picture alone.
const SCRIPT: &str = include_str!("player.js");

/// Writes a page that plays an episode in at most `max_frames` moments, the whole of it in `seconds`.
///
/// It needs no other file and no network.
pub fn player(spoken: &Spoken, max_frames: usize, seconds: f64) -> String {
    let stills = spoken.stills(max_frames);
    let (last, pause) = (stills.len() - 1, 1000.0 * seconds / stills.len() as f64);
    let frames = stills.iter().map(|Still { step, svg, caption }| {
        // What has no text may be as small as the screen is.
        let class = if svg.contains("<text ") { "wide" } else { "fit" };
        let caption = escape(caption);
        format!(
            "<div class=\"frame {class}\" data-step=\"{step}\" data-caption=\"{caption}\" hidden=\"\">\n{svg}</div>\n"
        )
    });
    let controls = format!(
        "<p class=\"controls\"><button type=\"button\" id=\"play\">Play</button>\n\
         <input type=\"range\" id=\"time\" min=\"0\" max=\"{last}\" value=\"0\" aria-label=\"moment of the episode\"/>\n\
         <output id=\"moment\" for=\"time\"></output></p>\n<p id=\"caption\"></p>\n"
    );
    let player = format!(
        "<div id=\"player\" data-pause=\"{pause:.0}\" data-end=\"{}\" hidden=\"\">\n{controls}{}</div>\n",
        spoken.played.n_steps(),
        frames.collect::<String>()
    );
    let picture = Picture::playthrough(spoken, "playthrough");
    let body = format!("{player}{}<script>\n{SCRIPT}</script>\n", described(&picture));
    page(&picture.title, "", &body)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::playthrough::synthetic;

    #[test]
    fn a_page_plays_the_moments_and_shows_the_whole_without_a_script() {
        let page = player(&Spoken::from(synthetic::playthrough()), 12, 6.0);
        let n_frames = page.matches("<div class=\"frame ").count();
        assert!((5..=12).contains(&n_frames), "{n_frames}");
        assert!(page.contains(&format!("max=\"{}\"", n_frames - 1)));
        assert!(page.contains("data-step=\"109\""), "the last moment");
        assert!(page.contains("data-caption=\"follows \u{201c}"), "what is done is said in words");
        // Frames are hidden until the script shows one; the picture of the whole is not.
        assert_eq!(page.matches(" hidden=\"\">").count(), n_frames + 1);
        assert_eq!(page.matches("<figure>").count(), 1);
        let title = "trained &amp; tested: landed &lt;safely&gt;, success";
        assert_eq!(page.matches(&format!("<h1>{title}</h1>")).count(), 1);
        assert!(!page.contains("<h2>") && !page.contains("<h3>"));
        for outside in ["src=", "href=", "@import", "fetch("] {
            assert!(!page.contains(outside), "{outside}");
        }
        assert_eq!(
            page.matches("http").count(),
            page.matches("http://www.w3.org/2000/svg").count()
        );
    }
}
