//! Where the sound of a sentence begins and ends.

/// How much is kept after the last word, in seconds: voices ring out.
const TAIL: f64 = 0.03;
/// How long it takes to fade in and out, in seconds: sound that starts or ends at once clicks.
const FADE: f64 = 0.003;
/// The loudness under which a voice is silent, of its loudest.
const SILENT: f64 = 0.02;
/// How long a piece is whose loudness is measured, in seconds.
const PIECE: f64 = 0.005;

/// Cuts out what lies between two moments, in seconds, and a little more, faded in and out.
pub(crate) fn trimmed(samples: &[i16], rate: u32, from: f64, to: f64) -> Vec<i16> {
    let at = |seconds: f64| ((seconds * f64::from(rate)) as usize).min(samples.len());
    let mut cut = samples[at(from)..at(to + TAIL).max(at(from))].to_vec();
    let n_fade = at(FADE).min(cut.len());
    for i in 0..n_fade {
        let share = i as f64 / n_fade as f64;
        let last = cut.len() - 1 - i;
        cut[i] = (f64::from(cut[i]) * share) as i16;
        cut[last] = (f64::from(cut[last]) * share) as i16;
    }
    cut
}

/// Finds where a voice begins and ends, in seconds; `None` in silence.
pub(crate) fn voiced(samples: &[i16], rate: u32) -> Option<(f64, f64)> {
    let n = ((PIECE * f64::from(rate)) as usize).max(1);
    let loudness = |piece: &[i16]| {
        let sum: f64 = piece.iter().map(|sample| f64::from(*sample).powi(2)).sum();
        (sum / piece.len() as f64).sqrt()
    };
    let pieces: Vec<f64> = samples.chunks(n).map(loudness).collect();
    let loudest = pieces.iter().copied().fold(0.0, f64::max);
    let is_voiced = |loudness: &f64| *loudness > SILENT * loudest;
    let first = pieces.iter().position(is_voiced)?;
    let last = pieces.iter().rposition(is_voiced)?;
    let seconds = |piece: usize| (piece * n) as f64 / f64::from(rate);
    Some((seconds(first), seconds(last + 1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_voice_is_found_between_silences_and_cut_out() {
        let mut samples = vec![0; 3_200];
        samples[1_600..2_400].fill(1_000);
        let (from, to) = voiced(&samples, 16_000).unwrap();
        assert_eq!((from, to), (0.1, 0.15));
        let cut = trimmed(&samples, 16_000, from, to);
        assert_eq!(cut.len(), 1_280);
        assert_eq!((cut[0], cut[100], cut[1_279]), (0, 1_000, 0));
        assert_eq!(voiced(&[0; 100], 16_000), None);
        assert_eq!(trimmed(&samples, 16_000, 9.0, 10.0), [0; 0]);
    }
}
