//! Parameters as safetensors bytes: what crosses the network and lies in run directories.
//!
//! The bytes are written here and not by a library, because equal parameters must give equal bytes and libraries keep
//! the metadata in unordered maps. The statistics come first, so that their 64-bit numbers are aligned.

use std::collections::BTreeMap;

use leadtime_proto::PolicySpec;
use safetensors::{Dtype, SafeTensors};
use serde_json::{Value, json};

use crate::error::{check_shape, missing, unknown};
use crate::parameters::{normalizer_tensors, shapes};
use crate::{Error, ObservationNormalizer, Parameters};

impl Parameters {
    /// Writes the parameters; equal parameters and metadata give equal bytes.
    ///
    /// # Errors
    ///
    /// [`Error::Tensor`] if the engine cannot read a tensor.
    pub fn to_safetensors(&self, metadata: &BTreeMap<String, String>) -> Result<Vec<u8>, Error> {
        let mut header = serde_json::Map::new();
        header.insert("__metadata__".to_owned(), json!(metadata));
        let mut data: Vec<u8> = Vec::new();
        let mut put = |name: &str, dtype: &str, shape: &[usize], bytes: &[u8]| {
            let start = data.len();
            data.extend_from_slice(bytes);
            let place = [start, data.len()];
            let entry = json!({"dtype": dtype, "shape": shape, "data_offsets": place});
            header.insert(name.to_owned(), entry);
        };
        if let Some(normalizer) = self.normalizer() {
            for (name, values) in normalizer_tensors(normalizer) {
                let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
                put(name, "F64", &[values.len()], &bytes);
            }
        }
        for (name, tensor) in self.tensors() {
            let bytes: Vec<u8> = self.values(name)?.iter().flat_map(|x| x.to_le_bytes()).collect();
            put(name, "F32", tensor.dims(), &bytes);
        }
        let mut header = Value::Object(header).to_string().into_bytes();
        // Padding with spaces is part of the format; it aligns the numbers behind the header.
        header.resize(header.len().next_multiple_of(8), b' ');
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.append(&mut header);
        bytes.append(&mut data);
        Ok(bytes)
    }

    /// Reads parameters and checks every tensor against the architecture.
    ///
    /// # Errors
    ///
    /// [`Error`] if the bytes are no safetensors, or a tensor is missing, unknown, misshapen or not finite; it names
    /// the tensor.
    pub fn from_safetensors(bytes: &[u8], spec: &PolicySpec) -> Result<Self, Error> {
        let file = SafeTensors::deserialize(bytes).map_err(Error::Read)?;
        let mut values = BTreeMap::new();
        let mut statistics = BTreeMap::new();
        let mut expected = shapes(spec);
        for (name, view) in file.iter() {
            if name.starts_with("normalizer.") {
                statistics.insert(name.to_owned(), read_f64(name, view.dtype(), view.data())?);
                continue;
            }
            let expected = expected.remove(name).ok_or_else(|| unknown(name))?;
            check_shape(name, view.shape(), &expected)?;
            values.insert(name.to_owned(), read_f32(name, view.dtype(), view.data())?);
        }
        Self::from_values(spec, values, read_normalizer(statistics)?)
    }
}

/// Reads what was written with the tensors, without reading them.
///
/// # Errors
///
/// [`Error::Read`] if the bytes are no safetensors file.
pub fn read_metadata(bytes: &[u8]) -> Result<BTreeMap<String, String>, Error> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(Error::Read)?;
    let entries = metadata.metadata().clone().unwrap_or_default();
    Ok(entries.into_iter().collect())
}

fn read_normalizer(
    mut tensors: BTreeMap<String, Vec<f64>>,
) -> Result<Option<ObservationNormalizer>, Error> {
    if tensors.is_empty() {
        return Ok(None);
    }
    let mut take = |name: &str| tensors.remove(name).ok_or_else(|| missing(name));
    let count = take("normalizer.count")?;
    let (mean, variance) = (take("normalizer.mean")?, take("normalizer.variance")?);
    if let Some(name) = tensors.keys().next() {
        return Err(unknown(name));
    }
    check_shape("normalizer.count", &[count.len()], &[1])?;
    Ok(Some(ObservationNormalizer { mean, variance, count: count[0] }))
}

fn read_f32(name: &str, dtype: Dtype, data: &[u8]) -> Result<Vec<f32>, Error> {
    check_type(name, dtype, Dtype::F32)?;
    let (numbers, _) = data.as_chunks::<4>();
    Ok(numbers.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
}

fn read_f64(name: &str, dtype: Dtype, data: &[u8]) -> Result<Vec<f64>, Error> {
    if dtype == Dtype::F32 {
        return Ok(read_f32(name, dtype, data)?.into_iter().map(f64::from).collect());
    }
    check_type(name, dtype, Dtype::F64)?;
    let (numbers, _) = data.as_chunks::<8>();
    Ok(numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect())
}

fn check_type(name: &str, found: Dtype, expected: Dtype) -> Result<(), Error> {
    if found == expected {
        return Ok(());
    }
    Err(Error::Misfit(format!("tensor `{name}` has numbers of type {found:?}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::notifier;

    fn metadata() -> BTreeMap<String, String> {
        BTreeMap::from([("domain".into(), "lander".into()), ("a".into(), "b".into())])
    }

    #[test]
    fn parameters_survive_a_file_bit_for_bit() {
        let spec = PolicySpec { normalize_observations: true, ..notifier(5) };
        let parameters = Parameters::initialize(&spec, 3).unwrap();
        let bytes = parameters.to_safetensors(&metadata()).unwrap();
        let back = Parameters::from_safetensors(&bytes, &spec).unwrap();
        assert_eq!(back.digest().unwrap(), parameters.digest().unwrap());
        assert_eq!(back.normalizer(), parameters.normalizer());
        assert_eq!(back.to_safetensors(&metadata()).unwrap(), bytes);
        assert_eq!(read_metadata(&bytes).unwrap(), metadata());
    }

    #[test]
    fn another_architectures_parameters_are_refused_by_name() {
        let bytes =
            Parameters::initialize(&notifier(5), 3).unwrap().to_safetensors(&metadata()).unwrap();
        let read = |spec| Parameters::from_safetensors(&bytes, &spec).unwrap_err().to_string();
        let error = read(notifier(6));
        // Of the actor or the critic, whichever the file's index lists first.
        let says = ".0.weight` has shape [64, 5], the architecture needs [64, 6]";
        assert!(error.ends_with(says), "{error}");
        let deeper = PolicySpec { hidden: vec![64; 3], ..notifier(5) };
        assert_eq!(read(deeper), "parameters hold no tensor `actor.2.bias`");
        let normalized = PolicySpec { normalize_observations: true, ..notifier(5) };
        assert_eq!(read(normalized), "parameters hold no tensor `normalizer.mean`");
    }

    #[test]
    fn torn_and_poisoned_files_are_refused() {
        let spec = notifier(2);
        let parameters = Parameters::initialize(&spec, 3).unwrap();
        let mut bytes = parameters.to_safetensors(&metadata()).unwrap();
        for length in [0, 7, 100, bytes.len() - 1] {
            let error = Parameters::from_safetensors(&bytes[..length], &spec).unwrap_err();
            assert!(matches!(error, Error::Read(_)), "{length}: {error}");
        }
        let last = bytes.len() - 4;
        bytes[last..].copy_from_slice(&f32::NAN.to_le_bytes());
        let error = Parameters::from_safetensors(&bytes, &spec).unwrap_err();
        assert_eq!(
            error.to_string(),
            "tensor `critic.head.weight` holds a value that is not finite"
        );
    }
}
