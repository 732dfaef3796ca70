//! The one door to the wire: the only file that names the encoding.
//!
//! Decoding always has a limit that grows with the message (without one a 20-byte message can claim a terabyte and
//! abort the process), and always consumes everything (the encoding itself would accept trailing bytes and even
//! another struct).

use bincode::config::{self, Config};
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

use crate::limits;

/// Why a message could not be encoded or decoded.
#[derive(Debug, Error)]
pub enum CodecError {
    /// The value cannot be written in this encoding.
    #[error("message cannot be encoded")]
    Encode(#[source] bincode::error::EncodeError),
    /// The bytes are no such message, or claim more than the limit.
    #[error("message cannot be decoded")]
    Decode(#[source] bincode::error::DecodeError),
    /// The message ended so many bytes before its payload.
    #[error("message has {0} bytes too many")]
    Trailing(usize),
    /// The message is larger than its kind may be.
    #[error("message has {found} bytes, at most {limit} are possible")]
    TooLarge {
        /// Its size in bytes, before it is decoded.
        found: usize,
        /// The limit of its kind.
        limit: usize,
    },
}

/// The most that a message of the largest size may claim while it is decoded: its bytes and a quarter.
const LARGEST: usize = limits::MAX_MESSAGE_BYTES + limits::MAX_MESSAGE_BYTES / 4;

/// The encoding, with a limit on what a message may claim (and thereby have allocated) while it is decoded.
fn encoding<const LIMIT: usize>() -> impl Config {
    config::standard().with_limit::<LIMIT>()
}

/// Encodes a message body.
///
/// # Errors
///
/// [`CodecError::Encode`] if the value cannot be represented, which no message of this crate is.
pub fn encode<T: Serialize>(message: &T) -> Result<Vec<u8>, CodecError> {
    bincode::serde::encode_to_vec(message, encoding::<LARGEST>()).map_err(CodecError::Encode)
}

/// Decodes a message body of at most `max_bytes`, all of it.
///
/// # Errors
///
/// [`CodecError`] if it is too large, malformed, or longer than the message in it.
pub fn decode<T: DeserializeOwned>(bytes: &[u8], max_bytes: usize) -> Result<T, CodecError> {
    if bytes.len() > max_bytes {
        return Err(CodecError::TooLarge { found: bytes.len(), limit: max_bytes });
    }
    // The limit is a constant of the encoding, so there are a few. No honest message claims more than 8 times its
    // bytes (a number of 8 bytes may be written in one), and large ones are nearly all plain bytes.
    let decoded = match bytes.len() {
        0..=0x1000 => bincode::serde::decode_from_slice(bytes, encoding::<0x1_0000>()),
        0x1001..=0x1_0000 => bincode::serde::decode_from_slice(bytes, encoding::<0x10_0000>()),
        0x1_0001..=0x10_0000 => bincode::serde::decode_from_slice(bytes, encoding::<0x100_0000>()),
        _ => bincode::serde::decode_from_slice(bytes, encoding::<LARGEST>()),
    };
    let (message, used) = decoded.map_err(CodecError::Decode)?;
    if used != bytes.len() {
        return Err(CodecError::Trailing(bytes.len() - used));
    }
    Ok(message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{EnvId, Iteration, PolicyVersion, Rollout};

    fn rollout() -> Rollout {
        Rollout {
            env_id: EnvId(3),
            iteration: Iteration(4),
            version: PolicyVersion(5),
            observations: vec![0.5, -1.5],
            masks: vec![1, u64::MAX],
            actions: vec![0, 1],
            next_value: 3.0,
            snapshot: vec![1, 2, 3],
            ..Rollout::default()
        }
    }

    #[test]
    fn a_rollout_survives_the_wire() {
        let bytes = encode(&rollout()).unwrap();
        assert_eq!(decode::<Rollout>(&bytes, limits::MAX_ROLLOUT_BYTES).unwrap(), rollout());
    }

    #[test]
    fn a_message_longer_than_its_limit_is_refused() {
        let mut bytes = encode(&rollout()).unwrap();
        assert!(matches!(decode::<Rollout>(&bytes, 8), Err(CodecError::TooLarge { .. })));
        bytes.push(0);
        let trailing = decode::<Rollout>(&bytes, limits::MAX_ROLLOUT_BYTES);
        assert!(matches!(trailing, Err(CodecError::Trailing(1))));
    }

    #[test]
    fn a_message_cannot_claim_more_than_it_can_hold() {
        // 1 TiB, and what is far below the largest message and far above what 9 bytes can hold.
        for bits in [40, 20] {
            // A string in the encoding's own words: marker 253, then the length as a u64.
            let bytes = [&[253], (1_u64 << bits).to_le_bytes().as_slice()].concat();
            let error = decode::<String>(&bytes, limits::MAX_MESSAGE_BYTES).unwrap_err();
            assert!(matches!(
                error,
                CodecError::Decode(bincode::error::DecodeError::LimitExceeded)
            ));
        }
    }

    #[test]
    fn the_densest_honest_messages_are_within_the_limits() {
        for n in [100, 4_000, 60_000, 1_000_000] {
            let dense = vec![1_u64; n];
            assert_eq!(decode::<Vec<u64>>(&encode(&dense).unwrap(), 1 << 24).unwrap(), dense);
        }
    }
}
