//! Models that run in this process, from files that are named by path and checked by hash (feature `candle`).
//!
//! No weights come with Leadtime. `taxonomy/scripts/fetch_models.sh` fetches the two that were tried, by hash:
//!
//! | | weights | licence | use |
//! |---|---|---|---|
//! | [`MiniLm`] | `all-MiniLM-L6-v2`, 91 MB | Apache-2.0 | which sentences of a cell stand for the others |
//! | [`Llama`] | `SmolLM2-135M-Instruct`, Q4_1, 98 MB | Apache-2.0 | to try generation; far too small to rate |

mod complaint;
mod llama;
mod minilm;
mod sample;

pub use llama::{Llama, LlamaSettings, Style};
pub use minilm::MiniLm;
