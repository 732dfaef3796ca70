//! Sentences as vectors of small integers, so that what is computed from a log is the same on every machine.

use super::error::BackendError;
use super::plan::hexadecimal;

/// A direction, rounded to 255 steps per component. Shape `[dim]`.
///
/// Only the direction matters for a cosine, so each vector is scaled by its own largest component; the error of a
/// cosine between 384 components is below 0.005.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Embedding(Vec<i8>);

impl Embedding {
    /// Rounds a vector, whatever its length.
    pub fn new(vector: &[f32]) -> Self {
        let largest = vector.iter().fold(0.0_f32, |largest, x| largest.max(x.abs()));
        let scale = if largest > 0.0 { 127.0 / largest } else { 0.0 };
        Self(vector.iter().map(|x| (x * scale).round() as i8).collect())
    }

    /// Computes the cosine of the angle between two vectors; 0 if one of them is zero or they differ in length.
    pub(super) fn cosine(&self, other: &Self) -> f64 {
        if self.0.len() != other.0.len() {
            return 0.0;
        }
        let norm = (self.dot(self) as f64) * (other.dot(other) as f64);
        if norm == 0.0 { 0.0 } else { self.dot(other) as f64 / norm.sqrt() }
    }

    fn dot(&self, other: &Self) -> i64 {
        self.0.iter().zip(&other.0).map(|(a, b)| i64::from(*a) * i64::from(*b)).sum()
    }

    /// Writes the vector as hexadecimal, two digits per component.
    pub(super) fn to_hex(&self) -> String {
        let bytes: Vec<u8> = self.0.iter().map(|x| x.to_ne_bytes()[0]).collect();
        hexadecimal(&bytes)
    }

    /// Reads what [`Embedding::to_hex`] wrote.
    pub(super) fn from_hex(text: &str) -> Result<Self, BackendError> {
        let says = "the embedder cannot be used: an embedding in the log is no hexadecimal";
        let wrong = || BackendError::Local(says.to_owned());
        if !text.is_ascii() || !text.len().is_multiple_of(2) {
            return Err(wrong());
        }
        let component = |pair: &[u8]| {
            let digit = |byte: u8| (byte as char).to_digit(16).ok_or_else(wrong);
            Ok(i8::from_ne_bytes([(digit(pair[0])? * 16 + digit(pair[1])?) as u8]))
        };
        text.as_bytes().chunks(2).map(component).collect::<Result<_, _>>().map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vector_survives_rounding_and_writing() {
        let a: Vec<f32> = (0_u8..100).map(|i| f32::from(i) * 0.01 - 0.3).collect();
        let b: Vec<f32> = (0_u8..100).map(|i| f32::from(i % 7) * 0.1 - 0.2).collect();
        let exact: f64 = {
            let dot = |a: &[f32], b: &[f32]| -> f64 {
                a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum()
            };
            dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt()
        };
        let (a, b) = (Embedding::new(&a), Embedding::new(&b));
        assert!((a.cosine(&b) - exact).abs() < 0.005);
        assert_eq!(Embedding::from_hex(&a.to_hex()).unwrap(), a);
        assert!((a.cosine(&a) - 1.0).abs() < 1e-12);
        assert_eq!(Embedding::new(&[0.0, 0.0]).cosine(&Embedding::new(&[1.0, 0.0])), 0.0);
    }

    #[test]
    fn odd_text_is_refused() {
        for text in ["abc", "zz", "äöü"] {
            Embedding::from_hex(text).unwrap_err();
        }
    }
}
