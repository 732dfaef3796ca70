//! `all-MiniLM-L6-v2` in this process: sentences as 384 numbers, by mean over the tokens (feature `minilm`).
//!
//! The shipped databases were made with it, so it is what makes them again from their annotations, byte for byte. No
//! weights come with Leadtime: `crates/taxonomy/scripts/fetch_model.sh` fetches them (91 MB, Apache-2.0), and whatever
//! is loaded is checked by hash.

use std::path::Path;

use candle_core::{DType, Device, Tensor};
use candle_nn::VarBuilder;
use candle_transformers::models::bert::{BertModel, Config};
use sha2::{Digest as _, Sha256};
use tokenizers::Tokenizer;

use super::backend::Embedder;
use super::embedding::Embedding;
use super::error::BackendError;
use super::plan::hexadecimal;

/// SHA-256 of the `model.safetensors` that is meant.
const WEIGHTS: &str = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db";

/// SHA-256 of the `tokenizer.json` that is meant.
const TOKENIZER: &str = "be50c3628f2bf5bb5e3a7f17b1f74611b2561a3a27eeab05e5aa30f411572037";

/// The embedder `all-MiniLM-L6-v2`, loaded into memory.
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
    /// [`BackendError::Local`] if a file cannot be read, or is another one.
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
    fn vector(&self, text: &str) -> Result<Vec<f32>, BackendError> {
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

/// Reports the first line of what the tensor library or the tokenizer says.
fn local(error: impl std::fmt::Display) -> BackendError {
    let error = error.to_string();
    let line = error.lines().next().unwrap_or_default();
    BackendError::Local(format!("the embedder cannot be used: {line}"))
}

/// Reads a file whose sha256 is known; `expected` in hexadecimal.
fn read(path: &Path, expected: &str) -> Result<Vec<u8>, BackendError> {
    let bytes =
        std::fs::read(path).map_err(|error| local(format!("{}: {error}", path.display())))?;
    let found = hexadecimal(&Sha256::digest(&bytes));
    if found != expected {
        let path = path.display();
        return Err(BackendError::Local(format!("{path} has sha256 {found}; expected {expected}")));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_the_one_named_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("model.safetensors");
        std::fs::write(&path, "abc").unwrap();
        let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(read(&path, abc).unwrap(), b"abc");
        let error = read(&path, "0000").unwrap_err().to_string();
        assert!(error.ends_with(&format!("has sha256 {abc}; expected 0000")), "{error}");
        let error = read(&directory.path().join("none"), abc).unwrap_err().to_string();
        assert!(error.starts_with("the embedder cannot be used: "), "{error}");
    }
}
