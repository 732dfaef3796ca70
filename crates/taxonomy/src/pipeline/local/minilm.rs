//! `all-MiniLM-L6-v2`: sentences as 384 numbers, by mean over the tokens.

use std::path::Path;

use candle_core::{DType, Device, Tensor};
use candle_nn::VarBuilder;
use candle_transformers::models::bert::{BertModel, Config};
use tokenizers::Tokenizer;

use super::complaint::local;
use crate::pipeline::backend::Embedder;
use crate::pipeline::embedding::Embedding;
use crate::pipeline::error::BackendError;
use crate::pipeline::weights::read;

/// Hash of `model.safetensors`.
const WEIGHTS: &str = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db";

/// Hash of `tokenizer.json`.
const TOKENIZER: &str = "be50c3628f2bf5bb5e3a7f17b1f74611b2561a3a27eeab05e5aa30f411572037";

/// The embedder, loaded.
pub struct MiniLm {
    model: BertModel,
    tokenizer: Tokenizer,
}

impl std::fmt::Debug for MiniLm {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.id())
    }
}

impl MiniLm {
    /// Loads `model.safetensors`, `tokenizer.json` and `config.json` of a directory.
    ///
    /// # Errors
    ///
    /// [`BackendError::WrongHash`] if a file is another one, [`BackendError::Local`] if it cannot be read.
    pub fn load(directory: &Path) -> Result<Self, BackendError> {
        let weights = read(&directory.join("model.safetensors"), WEIGHTS)?;
        let tokenizer = read(&directory.join("tokenizer.json"), TOKENIZER)?;
        let config = std::fs::read_to_string(directory.join("config.json")).map_err(local)?;
        let config: Config = serde_json::from_str(&config).map_err(local)?;
        let device = Device::Cpu;
        let weights =
            VarBuilder::from_buffered_safetensors(weights, DType::F32, &device).map_err(local)?;
        let model = BertModel::load(weights, &config).map_err(local)?;
        let mut tokenizer = Tokenizer::from_bytes(tokenizer).map_err(local)?;
        // One sentence at a time: padding changes the last bits.
        tokenizer.with_padding(None);
        Ok(Self { model, tokenizer })
    }

    /// Computes a sentence's vector of length 1. Shape `[384]`.
    ///
    /// # Errors
    ///
    /// [`BackendError::Local`] if the model fails.
    pub fn vector(&self, text: &str) -> Result<Vec<f32>, BackendError> {
        let tokens = self.tokenizer.encode(text, true).map_err(local)?;
        let ids = Tensor::new(tokens.get_ids(), &Device::Cpu).and_then(|ids| ids.unsqueeze(0));
        let ids = ids.map_err(local)?;
        let hidden = ids.zeros_like().and_then(|types| self.model.forward(&ids, &types, None));
        let mean = hidden.and_then(|hidden| hidden.mean(1)).and_then(|mean| mean.squeeze(0));
        let mean: Vec<f32> = mean.and_then(|mean| mean.to_vec1()).map_err(local)?;
        let norm = mean.iter().map(|x| f64::from(*x) * f64::from(*x)).sum::<f64>().sqrt();
        Ok(mean.iter().map(|x| (f64::from(*x) / norm) as f32).collect())
    }
}

impl Embedder for MiniLm {
    fn id(&self) -> &'static str {
        "all-MiniLM-L6-v2, safetensors 53aa5117, mean over tokens, rounded to 8 bits"
    }

    fn embed(&mut self, text: &str) -> Result<Embedding, BackendError> {
        Ok(Embedding::new(&self.vector(text)?))
    }
}
