//! Records what an observer hears of a run, a line of JSON per event: what the tests of the page replay.
//!
//! ```console
//! cargo run -p leadtime-watch --example record -- unixsock-stream//tmp/l.sock RUN > run.jsonl
//! ```

#![expect(clippy::print_stdout, reason = "it prints what it hears")]

use std::time::Instant;

use leadtime_link::{ConnectSettings, ObserverEvent, ObserverLink};
use leadtime_proto::RunName;
use serde_json::{Value, json};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [endpoint, run] = args.as_slice() else {
        return Err("give an address and a run".into());
    };
    let run = RunName::new(run.clone())?;
    let (link, events) = ObserverLink::open(&ConnectSettings::new(vec![endpoint.parse()?])).await?;
    link.follow(&run)?;
    let (incarnation, about) = link.ask_about(&run).await?;
    let about: Value = serde_json::from_slice(&about)?;
    let started = Instant::now();
    println!("{}", json!({"at": 0.0, "event": "about", "start": incarnation.hex(), "told": about}));
    while let Some(event) = events.recv().await {
        let at = (started.elapsed().as_secs_f64() * 1e3).round() / 1e3;
        let line = match event {
            ObserverEvent::Metrics { member, incarnation, json } => {
                let told: Value = serde_json::from_slice(&json)?;
                json!({"at": at, "event": "metrics", "member": member.to_string(), "start": incarnation.hex(), "told": told})
            }
            ObserverEvent::Joined(member, incarnation) => {
                json!({"at": at, "event": "joined", "member": member.to_string(), "start": incarnation.hex()})
            }
            ObserverEvent::Left(member, incarnation) => {
                json!({"at": at, "event": "left", "member": member.to_string(), "start": incarnation.hex()})
            }
            ObserverEvent::Announcement { .. } => continue,
        };
        println!("{line}");
    }
    Ok(())
}
