//! A message as it is recorded: JSON as it was sent, byte for byte; raw bytes as JSON with the original next to it.

use leadtime_link::live::{ArrivalEncoding, LiveTopic};
use leadtime_proto::hex;
use leadtime_serve::HeardSay;
use leadtime_serve::observation::{LiveObservation, write_json};
use leadtime_serve::say::RAW_SAY;
use serde_json::{Value, json};

/// Where the original of a message that was no JSON is kept, and its attachment.
const RAW: &str = "x_raw";
const BESIDE: &str = "x_beside";
/// The encoding of an observation in a form that nobody knows.
const ENCODING: &str = "x_encoding";

/// An observation as its client sent it.
#[derive(Clone, Debug, PartialEq)]
pub struct SentObservation {
    /// Its number, counted by the client.
    pub seq: u64,
    /// The episode that the client counts it to.
    pub episode: u64,
    /// The observed numbers. Shape `[obs_dim]`.
    pub values: Vec<f32>,
    /// The form in which it was sent.
    pub encoding: ArrivalEncoding,
    /// The bytes that were sent.
    pub payload: Vec<u8>,
    /// The attachment of a raw one.
    pub beside: Option<Vec<u8>>,
}

pub(crate) fn record(
    topic: LiveTopic,
    encoding: &ArrivalEncoding,
    payload: &[u8],
    beside: Option<&[u8]>,
) -> Vec<u8> {
    let is_object = || serde_json::from_slice::<Value>(payload).is_ok_and(|it| it.is_object());
    // The first byte of a raw event is that of its utterance's number, which may be that of `{`.
    let is_raw_say = !payload.starts_with(b"{") || payload.len() == RAW_SAY;
    let mut converted = match (topic, encoding) {
        (LiveTopic::Observations, ArrivalEncoding::Binary) => observation(payload, beside),
        (LiveTopic::Observations, ArrivalEncoding::Other(name)) => json!({ ENCODING: name }),
        (LiveTopic::Say, _) if is_raw_say => say(payload),
        _ if is_object() => return payload.to_vec(),
        _ => json!({}),
    };
    converted[RAW] = hex::encode(payload).into();
    if let Some(beside) = beside {
        converted[BESIDE] = hex::encode(beside).into();
    }
    converted.to_string().into_bytes()
}

/// Writes a raw observation as JSON; an empty object if it cannot be read.
fn observation(numbers: &[u8], beside: Option<&[u8]>) -> Value {
    let mut read = LiveObservation::new(numbers.len() / 4);
    let is_read = read.read_raw(numbers, beside.unwrap_or_default()).is_ok();
    let json = is_read.then(|| write_json(&read.head, &read.values));
    json.and_then(|json| serde_json::from_slice(&json).ok()).unwrap_or_else(|| json!({}))
}

/// Writes a raw event as JSON; an empty object if it is none.
fn say(bytes: &[u8]) -> Value {
    let Some(event) = HeardSay::read(bytes) else { return json!({}) };
    let HeardSay { seq, step, event, utterance, topic_id, k, l, heard, last, .. } = event;
    json!({
        "seq": seq, "step": step, "event": event, "utterance": utterance, "topic_id": topic_id, "k": k, "l": l,
        "heard": heard, "last": last,
    })
}

/// Reads an observation back as it was sent; `None` if it never was one.
pub(crate) fn sent_observation(recorded: &[u8]) -> Option<SentObservation> {
    let json: Value = serde_json::from_slice(recorded).ok()?;
    let seq = json["seq"].as_u64()?;
    let episode = json["episode"].as_u64().unwrap_or(0);
    let values = json["obs"].as_array()?.iter().map(|value| value.as_f64().unwrap_or(0.0) as f32);
    let values = values.collect();
    let original = |key: &str| hex::decode_all(json[key].as_str()?);
    let (encoding, payload, beside) = match original(RAW) {
        Some(payload) => (ArrivalEncoding::Binary, payload, original(BESIDE)),
        None => (ArrivalEncoding::Json, recorded.to_vec(), None),
    };
    Some(SentObservation { seq, episode, values, encoding, payload, beside })
}

/// Reads an event of what is said back as it was put; `None` if it never was one.
pub(crate) fn said_event(recorded: &[u8]) -> Option<HeardSay> {
    let json: Value = serde_json::from_slice(recorded).ok()?;
    match json[RAW].as_str() {
        Some(original) => HeardSay::read(&hex::decode_all(original)?),
        None => HeardSay::read(recorded),
    }
}

#[cfg(test)]
mod tests {
    use leadtime_serve::observation::{ObservationHead, write_raw};

    use super::*;

    #[test]
    fn json_is_kept_byte_for_byte_and_raw_bytes_come_back() {
        let head = ObservationHead { seq: 17, t: 0.25, episode: 3, end: false };
        let values = [0.1_f32, -1e-30, f32::MAX / 1e30];
        let text = write_json(&head, &values);
        let topic = LiveTopic::Observations;
        let recorded = record(topic, &ArrivalEncoding::Json, &text, None);
        assert_eq!(recorded, text);
        let sent = sent_observation(&recorded).unwrap();
        assert_eq!((sent.seq, sent.episode, &sent.payload), (17, 3, &text));
        let (numbers, beside) = write_raw(&head, &values);
        let recorded = record(topic, &ArrivalEncoding::Binary, &numbers, Some(&beside));
        let json: Value = serde_json::from_slice(&recorded).unwrap();
        assert_eq!((&json["seq"], &json["episode"]), (&json!(17), &json!(3)));
        assert_eq!(json["obs"][0], f64::from(0.1_f32));
        let sent = sent_observation(&recorded).unwrap();
        assert_eq!((sent.encoding, sent.payload), (ArrivalEncoding::Binary, numbers));
        assert_eq!(sent.beside.unwrap(), beside);
    }

    #[test]
    fn every_message_is_recorded_as_an_object() {
        let other = ArrivalEncoding::Other("text/csv".to_owned());
        for (encoding, bytes) in [
            (&ArrivalEncoding::Json, &b"noise\xff"[..]),
            (&other, b"1,2"),
            (&ArrivalEncoding::Binary, b"odd"),
        ] {
            let recorded = record(LiveTopic::Observations, encoding, bytes, None);
            let json: Value = serde_json::from_slice(&recorded).unwrap();
            assert_eq!(hex::decode_all(json[RAW].as_str().unwrap()).unwrap(), bytes);
            assert_eq!(sent_observation(&recorded), None);
        }
        let mut raw = vec![0; 24];
        raw[4] = 1;
        let recorded = record(LiveTopic::Say, &ArrivalEncoding::Binary, &raw, None);
        assert_eq!(said_event(&recorded), HeardSay::read(&raw));
        assert!(said_event(&recorded).is_some());
        raw[0] = b'{';
        let recorded = record(LiveTopic::Say, &ArrivalEncoding::Binary, &raw, None);
        let json: Value = serde_json::from_slice(&recorded).unwrap();
        assert_eq!((&json["event"], &json["utterance"]), (&json!("start"), &json!(123)));
    }
}
