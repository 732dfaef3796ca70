//! Measures and draws from policy files, in process.
//!
//! What this crate does not know: the network, the clock, files and arguments. It is given environments and
//! policies, and gives numbers, tables and pictures as text and bytes; `deploy` puts them where they belong.
//!
//! ```text
//! measure      players x environments --> episodes --> means with intervals, tables
//! playthrough  one episode --> SVG, PNG, GIF
//! figure       curves, histograms, shares of time --> SVG
//! report       all of it --> one self-contained HTML file
//! draw         canvas, inks, typeface, axes, pixels
//! ```
//!
//! # Where to start
//!
//! [`measure::evaluate`] and [`measure::Comparison`]; [`playthrough::Playthrough::record`]; [`report::Report`].

pub mod draw;
mod error;
pub mod figure;
pub mod measure;
pub mod playthrough;
pub mod report;

pub use error::Error;

#[cfg(test)]
mod gallery_tmp {
    #[test]
    fn gallery() {
        let r = crate::draw::Rasterizer::new();
        let task = leadtime_proto::TaskSpec { domain: "lander".into(), settings: "{}".into() };
        let task = leadtime_sims::Registry::builtin().for_evaluation(&task).unwrap();
        for (who, idx) in [("unaided", 0_u64), ("heuristic", 1), ("heuristic", 2)] {
            let mut env = leadtime_sims::Registry::builtin().build(&task).unwrap();
            let p = crate::playthrough::Playthrough::record(
                env.as_mut(),
                &crate::measure::Player::baseline(who),
                5,
                idx,
            )
            .unwrap();
            std::fs::write(format!("/tmp/fontwork/real_{who}_{idx}.png"), p.png(&r, 1.5).unwrap())
                .unwrap();
        }
        let make = || leadtime_sims::Registry::builtin().build(&task);
        let evs: Vec<_> = ["unaided", "heuristic"]
            .iter()
            .map(|who| {
                crate::measure::evaluate(
                    &make,
                    &crate::measure::Player::baseline(who),
                    &crate::measure::EvaluateSettings::new(200, 3).threads(2),
                )
                .unwrap()
            })
            .collect();
        let c = crate::measure::Comparison::new(&evs, leadtime_numerics::stats::Bootstrap::new(1));
        std::fs::write("/tmp/fontwork/real.txt", c.text()).unwrap();
    }
}
