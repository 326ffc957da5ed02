//! The weights of one version of the policy, sent to actors over the bus and saved in checkpoints.

use std::path::Path;

use bytes::Bytes;
use prost::Message;

use crate::tensors::Tensors;
use crate::{Error, digest, task};

/// The weights of one version of the policy.
#[derive(Clone, PartialEq, Message)]
pub struct Weights {
    /// Number of updates the policy has had.
    #[prost(uint64, tag = "1")]
    pub version: u64,
    /// Little-endian `f32` parameters, in the order of `networks::ActorCritic`.
    #[prost(bytes = "bytes", tag = "2")]
    pub parameters: Bytes,
    /// Little-endian `f64` moments for normalizing observations, in the order of `networks::RunningNormalizer`; empty
    /// if observations are not normalized.
    #[prost(bytes = "bytes", tag = "3")]
    pub moments: Bytes,
}

impl Weights {
    /// Creates a version of the policy with these parameters and moments.
    pub fn new(version: u64, parameters: &[f32], moments: &[f64]) -> Weights {
        let moments = moments.iter().flat_map(|number| number.to_le_bytes()).collect();
        Weights { version, parameters: to_bytes(parameters), moments }
    }

    /// Returns the parameters as numbers.
    pub fn parameter_numbers(&self) -> Vec<f32> {
        task::floats(&self.parameters).collect()
    }

    /// Returns the moments as numbers.
    pub fn moment_numbers(&self) -> Vec<f64> {
        self.moments.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()
    }

    /// Returns the SHA-256 of parameters and moments, in lower-case hexadecimal.
    pub fn sha256(&self) -> String {
        digest::sha256([&self.parameters, &self.moments])
    }

    /// Writes a safetensors file and returns its SHA-256.
    ///
    /// # Errors
    /// [`Error::Checkpoint`] if the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<String, Error> {
        let mut tensors = Tensors::default();
        tensors.put_u64("version", [self.version]);
        tensors.put_f32("parameters", self.parameter_numbers());
        tensors.put_f64("moments", self.moment_numbers());
        tensors.save(path)
    }

    /// Reads the bytes of a file that [`Weights::save`] wrote.
    ///
    /// # Errors
    /// When the bytes are not a safetensors file, or its arrays are not those of a policy.
    pub fn from_file(bytes: &[u8]) -> Result<Weights, String> {
        Weights::from_tensors(&Tensors::from_file(bytes)?)
    }

    /// Reads the weights from the arrays of a file that [`Weights::save`] wrote.
    ///
    /// # Errors
    /// When the arrays are not those of a policy.
    pub fn from_tensors(tensors: &Tensors) -> Result<Weights, String> {
        let parameters = tensors.f32("parameters")?;
        let moments = tensors.f64("moments")?;
        match tensors.u64("version")?[..] {
            [version] => Ok(Weights::new(version, &parameters, &moments)),
            _ => Err("expected one version".to_owned()),
        }
    }
}

/// Encodes numbers as little-endian bytes.
pub fn to_bytes(numbers: &[f32]) -> Bytes {
    let mut bytes = vec![0; 4 * numbers.len()];
    task::write_floats(numbers.iter().copied(), &mut bytes);
    bytes.into()
}

/// Returns the SHA-256 of numbers as little-endian bytes, in lower-case hexadecimal.
pub fn sha256<'a>(parts: impl IntoIterator<Item = &'a [f32]>) -> String {
    digest::sha256(parts.into_iter().map(to_bytes))
}
