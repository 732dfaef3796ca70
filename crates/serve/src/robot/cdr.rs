//! The bytes of two messages of ROS 2: what `std_msgs/Float32MultiArray` and `std_msgs/String` are in CDR.
//!
//! CDR is written little-endian behind four bytes that say so; everything else begins at a multiple of its size:
//!
//! ```text
//! 00 01 00 00                                      CDR, little-endian
//! Float32MultiArray   u32 dimensions, each: u32 length of its label, its label and a NUL, u32 size, u32 stride
//!                     u32 data_offset, u32 numbers, f32 ...
//! String              u32 length with the NUL, text, NUL
//! ```
//!
//! # Source
//!
//! OMG DDS-XTypes 1.3, section 7.4 (the plain encoding, version 1), which ROS 2 uses for all of its messages.

use thiserror::Error;

/// CDR, version 1, little-endian, no options.
const LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];
/// The most bytes that may follow the last number: some writers fill up to a multiple of four.
const MAX_FILL: usize = 3;

/// Why bytes are not the message that they should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum BadCdr {
    #[error("the message does not begin with 00 01 00 00: it is no little-endian CDR")]
    Header,
    #[error("the CDR message ends after {found} bytes, in the middle of {part}")]
    Short { part: &'static str, found: usize },
    #[error("{0} bytes follow the last number: it is no std_msgs/Float32MultiArray")]
    Long(usize),
    #[error("`data_offset` of the array is {0}; only 0 is read")]
    Offset(u32),
}

/// What is left of a message, with the place of its first byte.
struct Rest<'a> {
    bytes: &'a [u8],
    /// Counted from behind the header, which is where alignment is counted from.
    at: usize,
}

impl<'a> Rest<'a> {
    fn take(&mut self, n: usize, part: &'static str) -> Result<&'a [u8], BadCdr> {
        let short = BadCdr::Short { part, found: self.at + self.bytes.len() + LITTLE_ENDIAN.len() };
        let (taken, rest) = self.bytes.split_at_checked(n).ok_or(short)?;
        (self.bytes, self.at) = (rest, self.at + n);
        Ok(taken)
    }

    fn u32(&mut self, part: &'static str) -> Result<u32, BadCdr> {
        self.take(self.at.next_multiple_of(4) - self.at, part)?;
        let bytes = self.take(4, part)?;
        Ok(bytes.iter().rev().fold(0, |sum, byte| sum << 8 | u32::from(*byte)))
    }
}

/// Returns the numbers of a `std_msgs/Float32MultiArray`, each as its four bytes, little-endian; its layout is passed over.
///
/// # Errors
///
/// [`BadCdr`] if the message is no little-endian CDR, ends too early, has bytes left over, or has a `data_offset` other
/// than 0. Memory and time are bounded by the bytes that are there, whatever lengths they claim.
///
/// # Example
///
/// ```
/// use leadtime_serve::robot::cdr::float32_array;
///
/// let message = [&[0, 1, 0, 0][..], &[0; 8], &[1, 0, 0, 0], &1.5_f32.to_le_bytes()].concat();
/// assert_eq!(float32_array(&message), Ok(&[1.5_f32.to_le_bytes()][..]));
/// ```
pub fn float32_array(message: &[u8]) -> Result<&[[u8; 4]], BadCdr> {
    let bytes = message.strip_prefix(&LITTLE_ENDIAN).ok_or(BadCdr::Header)?;
    let mut rest = Rest { bytes, at: 0 };
    for _ in 0..rest.u32("the layout")? {
        let label = rest.u32("a label")?;
        rest.take(label as usize, "a label")?;
        rest.u32("a dimension")?;
        rest.u32("a dimension")?;
    }
    match rest.u32("`data_offset`")? {
        0 => {}
        offset => return Err(BadCdr::Offset(offset)),
    }
    let n = rest.u32("the number of numbers")? as usize;
    let numbers = rest.take(n.saturating_mul(4), "the numbers")?;
    if rest.bytes.len() > MAX_FILL {
        return Err(BadCdr::Long(rest.bytes.len()));
    }
    Ok(numbers.as_chunks().0)
}

/// Writes a `std_msgs/String` into `out`, instead of what was there. Text goes up to its first NUL, where it would end anyway.
pub fn write_string(text: &[u8], out: &mut Vec<u8>) {
    let text = text.split(|byte| *byte == 0).next().unwrap_or_default();
    let length = u32::try_from(text.len() + 1).unwrap_or(u32::MAX);
    out.clear();
    out.extend_from_slice(&LITTLE_ENDIAN);
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(text);
    out.push(0);
}

/// Returns the text of a `std_msgs/String`; `None` if it is none.
pub fn string(message: &[u8]) -> Option<&str> {
    let mut rest = Rest { bytes: message.strip_prefix(&LITTLE_ENDIAN)?, at: 0 };
    let length = rest.u32("the length").ok()?;
    let text = rest.take(length as usize, "the text").ok()?;
    str::from_utf8(text.strip_suffix(&[0])?).ok()
}

#[cfg(test)]
mod tests {
    use leadtime_numerics::Pcg64;
    use serde_json::Value;

    use super::*;

    /// What `rosbags` writes for 50 random arrays and 50 random texts; `ros2.py` beside it asks it.
    fn golden() -> Value {
        serde_json::from_str(include_str!("../../tests/data/ros2.json")).unwrap()
    }

    fn bytes(hex: &Value) -> Vec<u8> {
        let hex = hex.as_str().unwrap().as_bytes();
        let digits = |pair: &[u8]| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap();
        hex.chunks(2).map(digits).collect()
    }

    #[test]
    fn arrays_and_texts_have_the_bytes_of_another_implementation() {
        let golden = golden();
        let arrays = golden["arrays"].as_array().unwrap();
        let texts = golden["texts"].as_array().unwrap();
        assert_eq!((arrays.len(), texts.len()), (50, 50));
        for array in arrays {
            let message = bytes(&array["cdr"]);
            let numbers = bytes(&array["numbers"]);
            assert_eq!(float32_array(&message).unwrap().as_flattened(), numbers, "{array}");
        }
        for text in texts {
            let mut message = vec![7];
            let own = text["text"].as_str().unwrap();
            write_string(own.as_bytes(), &mut message);
            assert_eq!(message, bytes(&text["cdr"]), "{text}");
            assert_eq!(string(&message), Some(own));
        }
    }

    #[test]
    fn a_message_that_is_cut_anywhere_is_refused_with_the_part_that_is_missing() {
        for array in golden()["arrays"].as_array().unwrap() {
            let message = bytes(&array["cdr"]);
            for n in 0..message.len() {
                let error = float32_array(&message[..n]).unwrap_err();
                let expected = if n < 4 { "no little-endian CDR" } else { "in the middle of" };
                assert!(error.to_string().contains(expected), "{error}");
            }
        }
        let mut long = bytes(&golden()["arrays"][0]["cdr"]);
        long.extend([0; 3]);
        float32_array(&long).unwrap();
        long.push(0);
        assert_eq!(float32_array(&long), Err(BadCdr::Long(4)));
        // Big-endian, and an offset.
        assert_eq!(float32_array(&[0; 16]), Err(BadCdr::Header));
        let offset = [&[0, 1, 0, 0][..], &[0; 4], &[1, 0, 0, 0], &[0; 4]].concat();
        assert_eq!(float32_array(&offset), Err(BadCdr::Offset(1)));
        // More numbers and longer labels than any machine holds.
        let vast = [&[0, 1, 0, 0][..], &[0; 8], &[0xff; 4], &[0; 8]].concat();
        assert!(matches!(float32_array(&vast), Err(BadCdr::Short { part: "the numbers", .. })));
        let vast = [&[0, 1, 0, 0][..], &[0xff; 8], &[0; 8]].concat();
        assert!(matches!(float32_array(&vast), Err(BadCdr::Short { part: "a label", .. })));
    }

    #[test]
    fn damaged_messages_are_read_or_refused_and_nothing_else() {
        let golden = golden();
        let arrays: Vec<Vec<u8>> =
            golden["arrays"].as_array().unwrap().iter().map(|it| bytes(&it["cdr"])).collect();
        let mut draws = Pcg64::seed_from_u64(20);
        let mut draw = |n: usize| draws.next_u64() as usize % n.max(1);
        let (mut n_read, mut n_refused) = (0, 0);
        for round in 0..20_000 {
            let mut message = arrays[round % arrays.len()].clone();
            for _ in 0..=draw(4) {
                let at = draw(message.len());
                match draw(4) {
                    0 => message[at] = draw(256) as u8,
                    1 => message[at] ^= 1 << draw(8),
                    2 => message.truncate(at.max(1)),
                    _ => message.insert(at, draw(256) as u8),
                }
            }
            match float32_array(&message) {
                Ok(numbers) => {
                    assert!(numbers.as_flattened().len() + 16 <= message.len());
                    n_read += 1;
                }
                Err(_) => n_refused += 1,
            }
            assert!(string(&message).is_none_or(|text| text.len() < message.len()));
        }
        assert!(n_read > 1_000 && n_refused > 1_000, "{n_read} read, {n_refused} refused");
    }
}
