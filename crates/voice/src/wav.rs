//! WAV files of one channel and 16 bits, as speech programs write them.

/// Length of the head that [`write()`] writes.
const HEAD: usize = 44;

/// Writes a WAV file; `rate` in samples per second.
pub fn write(rate: u32, samples: &[i16]) -> Vec<u8> {
    let n_bytes = 2 * samples.len() as u32;
    let mut out = Vec::with_capacity(HEAD + 2 * samples.len());
    out.extend_from_slice(b"RIFF");
    out.extend_from_slice(&(n_bytes + HEAD as u32 - 8).to_le_bytes());
    out.extend_from_slice(b"WAVEfmt ");
    out.extend_from_slice(&16u32.to_le_bytes());
    out.extend_from_slice(&[1, 0, 1, 0]);
    out.extend_from_slice(&rate.to_le_bytes());
    out.extend_from_slice(&(2 * rate).to_le_bytes());
    out.extend_from_slice(&[2, 0, 16, 0]);
    out.extend_from_slice(b"data");
    out.extend_from_slice(&n_bytes.to_le_bytes());
    out.extend(samples.iter().flat_map(|sample| sample.to_le_bytes()));
    out
}

/// Reads a rate and the samples.
///
/// # Errors
///
/// If the bytes are no WAV file, or not one channel of 16 bits; in words.
pub fn read(bytes: &[u8]) -> Result<(u32, Vec<i16>), String> {
    let is_wav = bytes.get(..4) == Some(b"RIFF") && bytes.get(8..12) == Some(b"WAVE");
    let mut rest = bytes.get(12..).filter(|_| is_wav).ok_or("is no WAV file")?;
    let mut rate = None;
    while let Some((head, after)) = rest.split_first_chunk::<8>() {
        let length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
        // A program that writes into a pipe does not know the length beforehand.
        let body = &after[..length.min(after.len())];
        match &head[..4] {
            b"fmt " => {
                let form = body.get(..16).ok_or("has a short head")?;
                if form[..4] != [1, 0, 1, 0] || form[14..16] != [16, 0] {
                    return Err("is not one channel of 16 bits".to_owned());
                }
                rate = Some(u32::from_le_bytes([form[4], form[5], form[6], form[7]]));
            }
            b"data" => {
                let rate = rate.ok_or("has sound before its head")?;
                return Ok((rate, pcm(body)));
            }
            _ => {}
        }
        rest = &after[(length + length % 2).min(after.len())..];
    }
    Err("has no sound".to_owned())
}

/// Reads 16-bit samples, little-endian; an odd byte at the end is left out.
pub(crate) fn pcm(bytes: &[u8]) -> Vec<i16> {
    bytes.as_chunks().0.iter().map(|sample| i16::from_le_bytes(*sample)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let bytes = write(16_000, &[1, -2, 300]);
        assert_eq!(read(&bytes).unwrap(), (16_000, vec![1, -2, 300]));
        for cut in [0, 11, 30, 43] {
            read(&bytes[..cut]).unwrap_err();
        }
        assert_eq!(read(&bytes[..46]).unwrap().1, [1]);
        let mut stereo = bytes;
        stereo[22] = 2;
        assert!(read(&stereo).unwrap_err().contains("one channel"));
    }
}
