//! Named arrays of numbers in a safetensors file: the checkpoints of learner and proximity service.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use crate::build::Build;
use crate::dropped::shortened;
use crate::error::MESSAGE_CHARS;
use crate::{Error, digest, durable};

/// Named arrays of numbers. The type of an array is checked when it is read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensors {
    arrays: BTreeMap<String, Array>,
}

#[derive(Clone, Debug, PartialEq)]
struct Array {
    kind: Dtype,
    bytes: Vec<u8>,
}

macro_rules! kind {
    ($put:ident, $get:ident, $number:ty, $kind:ident, $width:literal) => {
        #[doc = concat!("Adds an array of `", stringify!($number), "`.")]
        pub fn $put(&mut self, name: &str, numbers: impl IntoIterator<Item = $number>) {
            let bytes = numbers.into_iter().flat_map(<$number>::to_le_bytes).collect();
            self.arrays.insert(name.to_owned(), Array { kind: Dtype::$kind, bytes });
        }

        #[doc = concat!("The array of `", stringify!($number), "` called `name`.")]
        ///
        /// # Errors
        /// When there is no such array, or it has another type.
        pub fn $get(&self, name: &str) -> Result<Vec<$number>, String> {
            let bytes = self.bytes(name, Dtype::$kind)?.as_chunks::<$width>().0;
            Ok(bytes.iter().map(|bytes| <$number>::from_le_bytes(*bytes)).collect())
        }
    };
}

impl Tensors {
    kind!(put_f32, f32, f32, F32, 4);
    kind!(put_f64, f64, f64, F64, 8);
    kind!(put_u64, u64, u64, U64, 8);
    kind!(put_u8, u8, u8, U8, 1);

    /// Adds all arrays of `others`, with `prefix` before their names.
    pub fn put_all(&mut self, prefix: &str, others: Tensors) {
        let named =
            others.arrays.into_iter().map(|(name, array)| (format!("{prefix}{name}"), array));
        self.arrays.extend(named);
    }

    /// Returns the arrays whose names begin with `prefix`, without the prefix.
    pub fn all(&self, prefix: &str) -> Tensors {
        let named = |(name, array): (&String, &Array)| {
            Some((name.strip_prefix(prefix)?.to_owned(), array.clone()))
        };
        Tensors { arrays: self.arrays.iter().filter_map(named).collect() }
    }

    /// Returns an array that must have `expected` numbers. `read` is the getter for its type.
    ///
    /// # Errors
    /// Names the array that is missing or has another type or length.
    pub fn exactly<T>(
        &self,
        name: &str,
        expected: usize,
        read: impl Fn(&Self, &str) -> Result<Vec<T>, String>,
    ) -> Result<Vec<T>, String> {
        let numbers = read(self, name)?;
        if numbers.len() == expected {
            return Ok(numbers);
        }
        Err(format!("array `{name}`: expected {expected} numbers, found {}", numbers.len()))
    }

    fn bytes(&self, name: &str, kind: Dtype) -> Result<&[u8], String> {
        match self.arrays.get(name) {
            None => Err(format!("expected an array `{name}`, found none")),
            Some(array) if array.kind != kind => {
                Err(format!("array `{name}`: expected {kind:?}, found {:?}", array.kind))
            }
            Some(array) => Ok(&array.bytes),
        }
    }

    /// Refuses NaN and infinite numbers, which show that the arrays are damaged or training diverged.
    ///
    /// # Errors
    /// Names the first array with NaN or an infinity.
    pub fn expect_finite(&self) -> Result<(), String> {
        let is_finite = |array: &Array| match array.kind {
            Dtype::F32 => {
                array.bytes.as_chunks().0.iter().all(|&four| f32::from_le_bytes(four).is_finite())
            }
            Dtype::F64 => {
                array.bytes.as_chunks().0.iter().all(|&eight| f64::from_le_bytes(eight).is_finite())
            }
            _ => true,
        };
        match self.arrays.iter().find(|(_, array)| !is_finite(array)) {
            None => Ok(()),
            Some((name, _)) => {
                Err(format!("array `{name}`: expected finite numbers, found NaN or an infinity"))
            }
        }
    }

    /// Returns whether there is an array called `name`.
    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    /// Returns the SHA-256 of all arrays, with their names, types and lengths.
    pub fn sha256(&self) -> String {
        let heads = self.arrays.iter().map(|(name, array)| {
            (format!("{name} {:?} {}\n", array.kind, array.bytes.len()), &array.bytes)
        });
        digest::sha256(heads.flat_map(|(head, bytes)| [head.into_bytes(), bytes.clone()]))
    }

    /// Removes an array of `u8` and returns it as text.
    ///
    /// # Errors
    /// When there is no such array, or it is not UTF-8 text.
    pub fn take_text(&mut self, name: &str) -> Result<String, String> {
        let text = self.u8(name)?;
        self.arrays.remove(name);
        String::from_utf8(text).map_err(|error| format!("array `{name}`: {error}"))
    }

    /// Returns the bytes of the `f32` array called `name`, as they are in the file.
    ///
    /// # Errors
    /// When there is no such array, or it has another type.
    pub fn f32_bytes(&self, name: &str) -> Result<&[u8], String> {
        self.bytes(name, Dtype::F32)
    }

    /// Writes a safetensors file atomically, with the build in its metadata. Returns the file's SHA-256.
    ///
    /// # Errors
    /// [`Error::Checkpoint`] if the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<String, Error> {
        let failed = |message: String| Error::Checkpoint { path: path.to_owned(), message };
        let views = self.arrays.iter().map(|(name, array)| {
            let count = array.bytes.len() / (array.kind.bitsize() / 8);
            TensorView::new(array.kind, vec![count], &array.bytes).map(|view| (name, view))
        });
        let views: Vec<_> =
            views.collect::<Result<_, _>>().map_err(|error| failed(error.to_string()))?;
        let build = serde_json::to_string(Build::own()).expect("a build has only plain values");
        let metadata = HashMap::from([("build".to_owned(), build)]);
        let bytes = safetensors::serialize(views, Some(metadata))
            .map_err(|error| failed(error.to_string()))?;
        durable::write(path, &bytes).map_err(|error| failed(error.to_string()))?;
        Ok(digest::sha256([&bytes]))
    }

    /// Reads a safetensors file.
    ///
    /// # Errors
    /// [`Error::Checkpoint`] if the file cannot be read or is not a safetensors file.
    pub fn load(path: &Path) -> Result<Tensors, Error> {
        let failed = |message: String| Error::Checkpoint { path: path.to_owned(), message };
        let bytes = std::fs::read(path).map_err(|error| failed(error.to_string()))?;
        Tensors::from_file(&bytes).map_err(failed)
    }

    /// Reads the bytes of a safetensors file.
    ///
    /// # Errors
    /// When the bytes are not a safetensors file.
    pub fn from_file(bytes: &[u8]) -> Result<Tensors, String> {
        let tensors = SafeTensors::deserialize(bytes)
            .map_err(|error| shortened(&error.to_string(), MESSAGE_CHARS))?;
        let array = |(name, view): (String, TensorView<'_>)| {
            (name, Array { kind: view.dtype(), bytes: view.data().to_vec() })
        };
        Ok(Tensors { arrays: tensors.tensors().into_iter().map(array).collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_saved_is_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("some.safetensors");
        let mut tensors = Tensors::default();
        tensors.put_f32("weights", [1.5, -0.0]);
        tensors.put_u64("counts", [u64::MAX]);
        tensors.put_u8("none", []);
        tensors.save(&path).unwrap();
        let loaded = Tensors::load(&path).unwrap();
        assert_eq!(loaded, tensors);
        assert_eq!(loaded.u64("counts"), Ok(vec![u64::MAX]));
        assert!(loaded.f32("counts").unwrap_err().contains("expected F32, found U64"));
        assert!(loaded.f32("missing").unwrap_err().contains("found none"));
        let bytes = std::fs::read(&path).unwrap();
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let build = &header.metadata().as_ref().unwrap()["build"];
        assert_eq!(&serde_json::from_str::<Build>(build).unwrap(), Build::own());
        assert_eq!(loaded.expect_finite(), Ok(()));
        tensors.put_f64("moments", [0.0, f64::INFINITY]);
        assert!(tensors.expect_finite().unwrap_err().contains("`moments`"));
        tensors.put_f32("a", [f32::NAN]);
        assert!(tensors.expect_finite().unwrap_err().contains("`a`"));
    }
}
