//! A Llama-family model from a GGUF file, one token at a time.

use std::io::Cursor;
use std::path::PathBuf;

use candle_core::quantized::gguf_file;
use candle_core::quantized::tokenizer::TokenizerFromGguf as _;
use candle_core::{Device, Tensor};
use candle_transformers::models::quantized_llama::{MAX_SEQ_LEN, ModelWeights};
use leadtime_numerics::Pcg64;
use tokenizers::Tokenizer;

use super::complaint::local;
use super::sample::{log_probability, sample};
use crate::pipeline::backend::{Call, Finish, Model, Reply, Sampling};
use crate::pipeline::chat::ChatFormat;
use crate::pipeline::error::BackendError;
use crate::pipeline::weights::read;
use crate::utterance::Fidelity;

/// What stands before a sentence whose likelihood is asked for.
const BEFORE: &str = "Someone says aloud:";

/// How a model is talked to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// In a conversation, with the marks that its template asks for.
    Chat,
    /// By a text that it goes on with, up to the end of the line: all that a very small model can do.
    Completion,
}

/// Which model, and how it runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LlamaSettings {
    /// The GGUF file.
    pub path: PathBuf,
    /// Its sha256.
    pub sha256: String,
    /// How it is talked to.
    pub style: Style,
    /// Whether weights are unpacked to 32 bits (`CANDLE_DEQUANTIZE_ALL=1` in the environment): faster, and other text
    /// from the same seed, so it belongs to the name.
    pub dequantized: bool,
}

impl LlamaSettings {
    /// Names `SmolLM2-135M-Instruct`, as the script fetches it.
    pub fn smollm2(path: PathBuf) -> Self {
        Self {
            path,
            sha256: "b179c9523d0e6a0f98a330c7562b682750a6f8c8c15e5bc70ea373728110db53".to_owned(),
            style: Style::Completion,
            dequantized: false,
        }
    }
}

/// The model, loaded.
pub struct Llama {
    id: String,
    style: Style,
    format: ChatFormat,
    model: ModelWeights,
    tokenizer: Tokenizer,
    stops: Vec<u32>,
}

impl std::fmt::Debug for Llama {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.id)
    }
}

impl Llama {
    /// Loads a model.
    ///
    /// # Errors
    ///
    /// [`BackendError::WrongHash`] if the file is another one, [`BackendError::Local`] if it is no model of the family,
    /// or talks in marks that are not known.
    pub fn load(settings: &LlamaSettings) -> Result<Self, BackendError> {
        let bytes = read(&settings.path, &settings.sha256)?;
        let mut reader = Cursor::new(bytes);
        let mut content = gguf_file::Content::read(&mut reader).map_err(local)?;
        let text = |content: &gguf_file::Content, key: &str| {
            content.metadata.get(key).and_then(|value| value.to_string().ok()).cloned()
        };
        // The usual label of Llama 3's word splitting is one that the tokenizer does not know, and would take for
        // another without a word.
        if text(&content, "tokenizer.ggml.pre").as_deref() == Some("llama-bpe") {
            let label = gguf_file::Value::String("llama3".to_owned());
            content.metadata.insert("tokenizer.ggml.pre".to_owned(), label);
        }
        let template = text(&content, "tokenizer.chat_template").unwrap_or_default();
        let format = ChatFormat::of_template(&template).ok_or_else(|| BackendError::Local {
            message: "its chat template is neither ChatML nor Llama 3".to_owned(),
        })?;
        let name =
            text(&content, "general.name").unwrap_or_else(|| "a model without name".to_owned());
        let tokenizer = Tokenizer::from_gguf(&content).map_err(local)?;
        let model = ModelWeights::from_gguf(content, &mut reader, &Device::Cpu).map_err(local)?;
        let stops = format.stops().iter().filter_map(|stop| tokenizer.token_to_id(stop)).collect();
        let style = match settings.style {
            Style::Chat => "chat",
            Style::Completion => "completion",
        };
        let width = if settings.dequantized { ", 32 bits" } else { "" };
        let id = format!("{name}, GGUF {}, {style}{width}", &settings.sha256[..8]);
        Ok(Self { id, style: settings.style, format, model, tokenizer, stops })
    }

    fn generate(
        &mut self,
        text: &str,
        sampling: Sampling,
        seed: u64,
    ) -> Result<Reply, BackendError> {
        let prompt = self.tokens(text)?;
        if prompt.len() + sampling.max_tokens as usize > MAX_SEQ_LEN {
            let message = format!(
                "a prompt of {} tokens; allowed: {MAX_SEQ_LEN} with the reply",
                prompt.len()
            );
            return Err(BackendError::Local { message });
        }
        let mut generator = Pcg64::seed_from_u64(seed);
        self.model.clear_kv_cache();
        let (mut next, mut at) = (prompt.clone(), 0);
        let (mut written, mut finish) = (Vec::new(), Finish::Length);
        while written.len() < sampling.max_tokens as usize {
            let logits = self.read(&next, at)?;
            at += next.len();
            let token = sample(&logits, sampling, &mut generator) as u32;
            if self.stops.contains(&token) || self.ends_line(token)? {
                finish = Finish::Stop;
                break;
            }
            written.push(token);
            next = vec![token];
        }
        let text = self.tokenizer.decode(&written, true).map_err(local)?;
        let tokens = Some((prompt.len() as u64, written.len() as u64));
        Ok(Reply { text, finish, tokens })
    }

    /// Cuts a text into tokens. The marks of a conversation are part of the text: none are added.
    fn tokens(&self, text: &str) -> Result<Vec<u32>, BackendError> {
        Ok(self.tokenizer.encode(text, false).map_err(local)?.get_ids().to_vec())
    }

    /// Reads tokens that stand at a place of the text, and returns the logits of the next one. Shape `[vocabulary]`.
    fn read(&mut self, tokens: &[u32], at: usize) -> Result<Vec<f32>, BackendError> {
        let input = Tensor::new(tokens, &Device::Cpu).and_then(|ids| ids.unsqueeze(0));
        let logits = input.and_then(|ids| self.model.forward(&ids, at)).map_err(local)?;
        logits.squeeze(0).and_then(|row| row.to_vec1()).map_err(local)
    }

    /// Tells whether a completion is over: what follows a line break is the next example, made up.
    fn ends_line(&self, token: u32) -> Result<bool, BackendError> {
        if self.style == Style::Chat {
            return Ok(false);
        }
        Ok(self.tokenizer.decode(&[token], false).map_err(local)?.contains('\n'))
    }
}

impl Model for Llama {
    fn id(&self) -> &str {
        &self.id
    }

    fn fidelity(&self) -> Fidelity {
        Fidelity::Local
    }

    fn complete(&mut self, call: &Call) -> Result<Reply, BackendError> {
        let text = match self.style {
            Style::Chat => self.format.render(&call.system, &call.prompt),
            Style::Completion => call.prompt.trim_end().to_owned(),
        };
        self.generate(&text, call.sampling, call.seed)
    }

    fn likelihood(&mut self, text: &str) -> Result<f64, BackendError> {
        // Which word comes first says little about the language, and most about how short a sentence is.
        let first = text.split_whitespace().next().unwrap_or_default();
        let mut seen = self.tokens(&format!("{BEFORE} {first}"))?;
        let all = self.tokens(&format!("{BEFORE} {text}"))?;
        let said = all.get(seen.len()..).unwrap_or_default();
        let mut at = 0;
        self.model.clear_kv_cache();
        let mut sum = 0.0;
        // A forward pass tells about one next token only.
        for &token in said {
            let logits = self.read(&seen, at)?;
            sum += log_probability(&logits, token as usize);
            at += seen.len();
            seen = vec![token];
        }
        Ok(sum / said.len().max(1) as f64)
    }
}
