//! From ratings to k: the first word after which a listener knows enough.

use super::candidate::Reason;

/// When a sentence is understood.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListenerCurve {
    /// Running maximum of the rating: a listener does not forget what was understood. Shape `[l]`.
    pub curve: Vec<u8>,
    /// Comprehension time k, in words.
    pub comprehension: u32,
    /// It was understood earlier than the least k.
    pub clamped: bool,
}

/// Finds where a rating reaches the threshold.
///
/// # Errors
///
/// [`Reason::NonMonotone`] if a word loses more than `max_drop` percent of what was understood before,
/// [`Reason::NeverUnderstood`] if the threshold is not reached.
///
/// # Source
///
/// arXiv:2509.07438 reads comprehension word by word and names no threshold.
pub fn listen(rated: &[u8], theta: u8, least: u32, max_drop: u8) -> Result<ListenerCurve, Reason> {
    let mut highest = 0;
    let mut curve = Vec::with_capacity(rated.len());
    for &percent in rated {
        if percent.saturating_add(max_drop) < highest {
            return Err(Reason::NonMonotone);
        }
        highest = highest.max(percent);
        curve.push(highest);
    }
    let crossing = curve.iter().position(|&percent| percent >= theta);
    let first = crossing.ok_or(Reason::NeverUnderstood)? as u32 + 1;
    Ok(ListenerCurve { curve, comprehension: first.max(least), clamped: first < least })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_crossing_is_k() {
        // The two worked examples of the source's rating prompt.
        let danger = listen(&[5, 20, 70, 80, 100], 70, 2, 20).unwrap();
        assert_eq!((danger.comprehension, danger.clamped), (3, false));
        let adjust = listen(&[5, 50, 50, 50, 70, 70, 70], 70, 2, 20).unwrap();
        assert_eq!(adjust.comprehension, 5);
    }

    #[test]
    fn nothing_is_understood_less_later() {
        let dip = listen(&[30, 60, 40, 90], 70, 2, 20).unwrap();
        assert_eq!(dip.curve, [30, 60, 60, 90]);
        assert_eq!(listen(&[30, 61, 40, 90], 70, 2, 20), Err(Reason::NonMonotone));
    }

    #[test]
    fn a_sentence_clear_at_once_is_clamped_and_one_that_never_is_clear_is_refused() {
        let clear = listen(&[90, 95], 70, 2, 20).unwrap();
        assert_eq!((clear.comprehension, clear.clamped), (2, true));
        assert_eq!(listen(&[10, 69], 70, 2, 20), Err(Reason::NeverUnderstood));
    }
}
