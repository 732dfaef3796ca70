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
/// assert_eq!(hex::decode_all("0aff"), Some(vec![10, 255]));
/// assert_eq!(hex::decode_all("0g"), None);
/// assert_eq!(hex::decode_all("012"), None);
/// ```
pub fn encode(bytes: &[u8]) -> String {
    let digit = |half: u8| char::from_digit(u32::from(half), 16).unwrap_or_default();
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]).collect()
}

/// Reads what [`encode`] wrote; `None` of anything else, or of another length.
pub fn decode<const N: usize>(text: &str) -> Option<[u8; N]> {
    // Before it is read: it may be as long as a stranger wants.
    if text.len() == 2 * N { decode_all(text)?.try_into().ok() } else { None }
}

/// Reads what [`encode`] wrote, of any length; `None` of anything else.
pub fn decode_all(text: &str) -> Option<Vec<u8>> {
    let digit = |c: u8| char::from(c).to_digit(16).map(|digit| digit as u8);
    let (pairs, rest) = text.as_bytes().as_chunks::<2>();
    let byte = |[high, low]: &[u8; 2]| Some(digit(*high)? << 4 | digit(*low)?);
    if rest.is_empty() { pairs.iter().map(byte).collect() } else { None }
}
