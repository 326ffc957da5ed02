//! Named arrays of numbers in a safetensors file: the checkpoints of learner and proximity service.

use std::collections::BTreeMap;
use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use crate::Error;

/// Named arrays of numbers. Each knows its kind only when it is read.
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

    /// An array that has to have so many numbers, read by one of the functions for a kind.
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

    /// Writes a safetensors file and waits until it is on the disk.
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        let failed = |message: String| Error::Checkpoint { path: path.to_owned(), message };
        let views = self.arrays.iter().map(|(name, array)| {
            let count = array.bytes.len() / (array.kind.bitsize() / 8);
            TensorView::new(array.kind, vec![count], &array.bytes).map(|view| (name, view))
        });
        let views: Vec<_> =
            views.collect::<Result<_, _>>().map_err(|error| failed(error.to_string()))?;
        let bytes =
            safetensors::serialize(views, None).map_err(|error| failed(error.to_string()))?;
        let write = || {
            std::fs::write(path, bytes)?;
            std::fs::File::open(path)?.sync_all()
        };
        write().map_err(|error: std::io::Error| failed(error.to_string()))
    }

    /// Reads a safetensors file.
    pub fn load(path: &Path) -> Result<Tensors, Error> {
        let failed = |message: String| Error::Checkpoint { path: path.to_owned(), message };
        let bytes = std::fs::read(path).map_err(|error| failed(error.to_string()))?;
        Tensors::from_file(&bytes).map_err(failed)
    }

    /// Reads the bytes of a safetensors file.
    pub fn from_file(bytes: &[u8]) -> Result<Tensors, String> {
        let tensors = SafeTensors::deserialize(bytes).map_err(|error| error.to_string())?;
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
    }
}
