//! Writes databases: TOML that a person can read and that equal input makes equal; CSV and JSON for other tools.

use std::fmt::Write as _;

use serde_json::json;

use super::candidate::Candidate;
use super::log::LogHeader;
use super::plan::DatabasePlan;
use super::presuppose::Presuppositions;
use crate::database::Taxonomy;
use crate::raw::{RawDatabase, RawUtterance, SCHEMA};
use crate::utterance::{Fidelity, Utterance};

/// Says at the head of a file what may be claimed of it.
fn claim(fidelity: Fidelity) -> &'static str {
    match fidelity {
        Fidelity::Paper => {
            "Written and rated by a language model of the source's class (arXiv:2509.07438)."
        }
        Fidelity::Authored => {
            "Written and rated by an annotator who followed the two prompts; not the output of the source's\n\
             # Llama-3-8B-Instruct, and no listener was asked. Figures that rest on it must say so."
        }
        Fidelity::Grammar => {
            "Put together from phrase lists; k is the place of the directive's last word. No language model was\n\
             # involved, and no listener was asked."
        }
        Fidelity::Local => {
            "Written or rated by a small stand-in, to try the pipeline; not fit for results."
        }
    }
}

/// Writes the file of the chosen sentences.
pub(super) fn database(plan: &DatabasePlan, header: &LogHeader, kept: &[Candidate]) -> String {
    let LogHeader { fidelity, generator, rater, embedder, .. } = header.clone();
    let presupposed = Presuppositions::new(plan);
    let raw = RawDatabase {
        schema: SCHEMA,
        domain: plan.domain.clone(),
        fidelity,
        generator,
        rater,
        embedder,
        theta: plan.settings.theta,
        words: plan.words,
        topics: plan.topic.iter().map(|topic| topic.id.clone()).collect(),
        config: plan.hash(),
        utterance: kept
            .iter()
            .filter_map(|candidate| utterance(plan, &presupposed, candidate))
            .collect(),
    };
    format!(
        "# What is said in the domain `{}`, by topic, comprehension time k and conveyance time l, in words.\n# {}\n\
         # Made by `leadtime taxonomy build`; made again, byte for byte, from its call log.\n\n{}",
        plan.domain,
        claim(fidelity),
        // Text, numbers and lists can always be written.
        toml::to_string(&raw).unwrap_or_default()
    )
}

fn utterance(
    plan: &DatabasePlan,
    presupposed: &Presuppositions,
    candidate: &Candidate,
) -> Option<RawUtterance> {
    let cell = candidate.landed?;
    Some(RawUtterance {
        topic: plan.topic[candidate.topic].id.clone(),
        comprehension: cell.comprehension,
        conveyance: cell.conveyance,
        text: candidate.text.clone(),
        spans: candidate.spans.clone(),
        facts: Some(presupposed.facts(candidate.topic, &candidate.text)),
        curve: candidate.curve.clone(),
        clamped: candidate.clamped,
        word_end_ms: Vec::new(),
        medoid: candidate.medoid.unwrap_or_default(),
        source: candidate.source.clone(),
    })
}

/// Writes a database as a table, one sentence per line.
pub(super) fn csv(taxonomy: &Taxonomy) -> String {
    let mut out =
        String::from("topic,comprehension,conveyance,text,reason,facts,curve,medoid,source\n");
    for topic in taxonomy.topics() {
        for utterance in topic.utterances() {
            let Utterance { cell, text, medoid, source, .. } = utterance;
            let curve: Vec<String> = utterance.curve.iter().map(u8::to_string).collect();
            // Writing to a string cannot fail.
            let _written = writeln!(
                out,
                "{},{},{},\"{}\",{},{},{},{medoid},\"{}\"",
                topic.name(),
                cell.comprehension,
                cell.conveyance,
                text.replace('"', "\"\""),
                utterance.states_reason(),
                taxonomy.fact_names(utterance.facts).collect::<Vec<_>>().join(" "),
                curve.join(" "),
                source.replace('"', "\"\"")
            );
        }
    }
    out
}

pub(super) fn json(taxonomy: &Taxonomy) -> String {
    let header = taxonomy.header();
    let topics: Vec<serde_json::Value> = taxonomy
        .topics()
        .iter()
        .map(|topic| {
            let said = topic.utterances().iter();
            let list: Vec<serde_json::Value> =
                said.map(|utterance| object(taxonomy, utterance)).collect();
            json!({"topic": topic.name(), "utterances": list})
        })
        .collect();
    let whole = json!({
        "domain": header.domain, "fidelity": header.fidelity, "generator": header.generator,
        "rater": header.rater, "theta": header.theta, "topics": topics,
    });
    format!("{whole:#}\n")
}

fn object(taxonomy: &Taxonomy, utterance: &Utterance) -> serde_json::Value {
    json!({
        "comprehension": utterance.cell.comprehension, "conveyance": utterance.cell.conveyance,
        "text": utterance.text, "spans": utterance.spans, "curve": utterance.curve,
        "facts": taxonomy.fact_names(utterance.facts).collect::<Vec<_>>(),
        "medoid": utterance.medoid, "source": utterance.source,
    })
}

#[cfg(test)]
mod tests {
    use crate::shipped;

    #[test]
    fn tables_and_json_hold_every_sentence() {
        let taxonomy = shipped("highway").unwrap();
        let n: usize = taxonomy.topics().iter().map(|topic| topic.utterances().len()).sum();
        let csv = super::csv(&taxonomy);
        assert_eq!(csv.lines().count(), n + 1);
        assert!(csv.contains(",2,5,\"Slow down for incoming traffic.\",true,"), "{csv}");
        let json: serde_json::Value = serde_json::from_str(&super::json(&taxonomy)).unwrap();
        let topics = json["topics"].as_array().unwrap();
        let lists = topics.iter().map(|topic| topic["utterances"].as_array().unwrap().len());
        assert_eq!(lists.sum::<usize>(), n);
    }
}
