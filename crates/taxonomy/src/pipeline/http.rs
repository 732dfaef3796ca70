//! A language model behind HTTP: whatever speaks the common part of the `OpenAI` chat API.
//!
//! Only fields that llama.cpp's server, vLLM and Ollama all understand are sent: model, messages, temperature,
//! `top_p`, seed, `max_tokens`, stream. What a server says besides text, reason of ending and token counts is ignored.
//!
//! A server that is slow, busy (429, 5xx) or cuts its answer short is asked again, each time after twice as long; any
//! other refusal ends the run, because waiting would not help.

use std::time::Duration;

use serde::Deserialize;
use serde_json::json;

use super::backend::{Call, Finish, Model, Reply, Sampling};
use super::error::{BackendError, PipelineError};
use crate::utterance::Fidelity;

/// The longest answer that is read, in bytes.
const MAX_ANSWER: u64 = 4 << 20;

/// How much of a refusal is repeated, in characters.
const SHOWN: usize = 200;

/// Where a model is, and how patient one is with it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HttpSettings {
    /// Base of the API: `http://127.0.0.1:8080/v1`, with or without a slash at its end.
    pub url: String,
    /// Model, as the server names it.
    pub model: String,
    /// Sent as bearer token; never logged.
    pub api_key: Option<String>,
    /// What may be claimed: [`Fidelity::Paper`] for an instruct model of the source's class, else `Local`.
    pub fidelity: Fidelity,
    /// Longest wait for an answer.
    pub timeout: Duration,
    /// Times that a call is tried (1..=10).
    pub tries: u32,
    /// Wait before the second try; doubles with each further one.
    pub backoff: Duration,
}

/// A model behind HTTP.
#[derive(Debug)]
pub struct Http {
    settings: HttpSettings,
    id: String,
    agent: ureq::Agent,
}

/// The part of an answer that is read.
#[derive(Deserialize)]
struct ChatAnswer {
    choices: Vec<ChatChoice>,
    usage: Option<Usage>,
}

#[derive(Deserialize)]
struct ChatChoice {
    message: ChatMessage,
    finish_reason: Option<String>,
}

#[derive(Deserialize)]
struct ChatMessage {
    content: Option<String>,
}

#[derive(Deserialize)]
struct Usage {
    #[serde(default)]
    prompt_tokens: u64,
    #[serde(default)]
    completion_tokens: u64,
}

impl Http {
    /// Prepares a client; nothing is sent yet.
    ///
    /// # Errors
    ///
    /// [`PipelineError::Unusable`] if the address is no web address or the patience impossible.
    pub fn new(mut settings: HttpSettings) -> Result<Self, PipelineError> {
        // First of all: what a database names as its generator has no slash at its end.
        settings.url.truncate(settings.url.trim_end_matches('/').len());
        let tls = cfg!(feature = "https");
        let schemes: &[&str] = if tls { &["http://", "https://"] } else { &["http://"] };
        if !schemes.iter().any(|scheme| settings.url.starts_with(scheme)) {
            let allowed = if tls {
                "http:// or https:// and HOST/v1"
            } else {
                "http://HOST:PORT/v1 (https:// if built with the feature `https`)"
            };
            let url = settings.url;
            return Err(PipelineError::Unusable(format!("--url is {url}; allowed: {allowed}")));
        }
        if !(1..=10).contains(&settings.tries) {
            let tries = settings.tries;
            return Err(PipelineError::Unusable(format!("--tries is {tries}; allowed: 1 to 10")));
        }
        let config = ureq::Agent::config_builder()
            .timeout_global(Some(settings.timeout))
            .http_status_as_error(false)
            .build();
        let id = format!("{} at {}", settings.model, settings.url);
        Ok(Self { id, agent: config.into(), settings })
    }

    fn body(&self, call: &Call) -> String {
        let Sampling { temperature, top_p, max_tokens } = call.sampling;
        let messages = json!([
            {"role": "system", "content": call.system},
            {"role": "user", "content": call.prompt},
        ]);
        json!({
            "model": self.settings.model, "messages": messages, "temperature": temperature, "top_p": top_p,
            "max_tokens": max_tokens, "seed": call.seed, "stream": false,
        })
        .to_string()
    }

    /// Tries once; an error says why another try is worth it.
    fn attempt(&self, body: &str) -> Result<Result<Reply, BackendError>, String> {
        let url = format!("{}/chat/completions", self.settings.url);
        let mut request = self.agent.post(&url).header("content-type", "application/json");
        if let Some(key) = &self.settings.api_key {
            request = request.header("authorization", &format!("Bearer {key}"));
        }
        let mut response = request.send(body).map_err(|error| error.to_string())?;
        let status = response.status().as_u16();
        let text = response.body_mut().with_config().limit(MAX_ANSWER).read_to_string();
        let text = text.map_err(|error| error.to_string())?;
        match status {
            200..=299 => read(&text).map(Ok),
            408 | 429 | 500..=599 => Err(format!("status {status}")),
            _ => {
                let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
                let (url, message) =
                    (self.settings.url.clone(), line.chars().take(SHOWN).collect());
                Ok(Err(BackendError::Refused { url, status, message }))
            }
        }
    }
}

fn read(text: &str) -> Result<Reply, String> {
    let answer: ChatAnswer = serde_json::from_str(text)
        .map_err(|error| format!("an answer that cannot be read: {error}"))?;
    let choice = answer.choices.into_iter().next().ok_or("an answer without choices")?;
    let cut = choice.finish_reason.as_deref() == Some("length");
    Ok(Reply {
        text: choice.message.content.unwrap_or_default(),
        finish: if cut { Finish::Length } else { Finish::Stop },
        tokens: answer.usage.map(|usage| (usage.prompt_tokens, usage.completion_tokens)),
    })
}

impl Model for Http {
    fn id(&self) -> &str {
        &self.id
    }

    fn fidelity(&self) -> Fidelity {
        self.settings.fidelity
    }

    fn complete(&mut self, call: &Call) -> Result<Reply, BackendError> {
        let body = self.body(call);
        let (url, tries) = (self.settings.url.clone(), self.settings.tries);
        let mut message = String::new();
        for attempt in 0..tries {
            if attempt > 0 {
                std::thread::sleep(self.settings.backoff.saturating_mul(1 << (attempt - 1)));
            }
            match self.attempt(&body) {
                Ok(answer) => return answer,
                Err(why) => message = why,
            }
        }
        Err(BackendError::Unreachable { url, tries, message })
    }
}

#[cfg(test)]
#[path = "http_tests.rs"]
mod tests;
