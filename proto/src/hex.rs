//! Bytes as hexadecimal digits, two for each.

/// Writes bytes as digits.
///
/// # Example
///
/// ```
/// use leadtime_proto::hex;
///
/// assert_eq!(hex::encode(&[0, 10, 255]), "000aff");
/// assert_eq!(hex::decode("000aff"), Some([0, 10, 255]));
/// assert_eq!(hex::decode::<3>("+00aff"), None);
/// ```
pub fn encode(bytes: &[u8]) -> String {
    let digit = |half: u8| char::from_digit(u32::from(half), 16).unwrap_or_default();
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]).collect()
}

/// Reads what [`encode`] wrote; `None` of anything else, or of another length.
pub fn decode<const N: usize>(text: &str) -> Option<[u8; N]> {
    let digits = text.bytes().map(|c| char::from(c).to_digit(16).map(|digit| digit as u8));
    let digits: Vec<u8> = digits.take(2 * N + 1).collect::<Option<_>>()?;
    (digits.len() == 2 * N).then(|| std::array::from_fn(|i| digits[2 * i] << 4 | digits[2 * i + 1]))
}
