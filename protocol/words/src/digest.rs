//! SHA-256 of weights and files, in lower-case hexadecimal. Files are checked against the hashes in the log.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use sha2::{Digest, Sha256};

/// Number of bytes read from a file at a time.
const PART_BYTES: usize = 64 << 10;

/// Returns the SHA-256 of the concatenated parts.
pub fn sha256<B: AsRef<[u8]>>(parts: impl IntoIterator<Item = B>) -> String {
    let mut hasher = Sha256::new();
    parts.into_iter().for_each(|part| hasher.update(part));
    hexadecimal(hasher)
}

/// Returns the SHA-256 of a file of any length.
///
/// # Errors
/// When the file cannot be read.
pub fn sha256_of_file(path: &Path) -> std::io::Result<String> {
    let mut file = File::open(path)?;
    let mut hasher = Sha256::new();
    let mut bytes = vec![0; PART_BYTES];
    loop {
        match file.read(&mut bytes)? {
            0 => return Ok(hexadecimal(hasher)),
            count => hasher.update(&bytes[..count]),
        }
    }
}

fn hexadecimal(hasher: Sha256) -> String {
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_and_files_have_the_published_hash() {
        let published = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256([b"a", b"bc" as &[u8]]), published);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        assert_eq!(sha256_of_file(&path).unwrap(), published);
    }
}
