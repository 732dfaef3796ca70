//! Vorbis in Ogg, as the shipped sound is compressed. The only place that names the decoder.

use std::io::Cursor;

use symphonia_codec_vorbis::VorbisDecoder;
use symphonia_core::audio::Channels;
use symphonia_core::codecs::audio::{AudioDecoder as _, AudioDecoderOptions};
use symphonia_core::errors::Error as SymphoniaError;
use symphonia_core::formats::{FormatOptions, FormatReader as _, TrackType};
use symphonia_core::io::{MediaSourceStream, MediaSourceStreamOptions};
use symphonia_format_ogg::OggReader;

/// Decodes one channel.
///
/// # Errors
///
/// If the bytes are no Ogg Vorbis, or have another number of channels than one; in words.
pub(crate) fn decode(bytes: &[u8]) -> Result<(u32, Vec<i16>), String> {
    let wrong = |error: SymphoniaError| format!("is no Ogg Vorbis: {error}");
    let source = Box::new(Cursor::new(bytes.to_vec()));
    let stream = MediaSourceStream::new(source, MediaSourceStreamOptions::default());
    let mut reader = OggReader::try_new(stream, FormatOptions::default()).map_err(wrong)?;
    let track = reader.default_track(TrackType::Audio).ok_or("has no sound")?;
    let track_id = track.id;
    let parameters = track.codec_params.as_ref().and_then(|it| it.audio());
    let parameters = parameters.ok_or("has no sound")?;
    let rate = parameters.sample_rate.ok_or("names no rate")?;
    if parameters.channels.as_ref().map(Channels::count) != Some(1) {
        return Err("has more than one channel".to_owned());
    }
    let mut decoder =
        VorbisDecoder::try_new(parameters, &AudioDecoderOptions::default()).map_err(wrong)?;
    let (mut samples, mut part) = (Vec::new(), Vec::new());
    while let Some(packet) = reader.next_packet().map_err(wrong)? {
        if packet.track_id == track_id {
            let decoded = decoder.decode(&packet).map_err(wrong)?;
            decoded.copy_to_vec_interleaved::<i16>(&mut part);
            samples.extend_from_slice(&part);
        }
    }
    Ok((rate, samples))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_that_are_not_vorbis_are_refused() {
        for bytes in [&b""[..], b"OggS", &[7; 300]] {
            assert!(decode(bytes).is_err());
        }
    }
}
