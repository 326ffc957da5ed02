//! The folder of a bus. The system removes it when its user logs out, and processes would then wait for each other
//! forever.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use bus::BusAddress;

/// A folder that a process of the run makes when it joins the bus.
pub(super) struct BusFolder {
    path: PathBuf,
    was_there: bool,
}

impl BusFolder {
    /// Returns the folder, which need not be there yet.
    pub(super) fn of(address: &BusAddress) -> BusFolder {
        BusFolder { path: address.root().to_owned(), was_there: false }
    }

    /// Checks that the folder is there if it was.
    ///
    /// # Errors
    /// When it has been removed.
    pub(super) fn check(&mut self) -> Result<()> {
        let is_there = self.path.is_dir();
        ensure!(
            is_there || !self.was_there,
            "expected the folder of the bus, found no {}: systems remove it when its user logs out, unless \
             `loginctl enable-linger` was called before",
            self.path.display()
        );
        self.was_there = is_there;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_folder_may_come_but_not_go() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("gw_7");
        let mut folder = BusFolder { path: path.clone(), was_there: false };
        folder.check().unwrap();
        fs::create_dir(&path).unwrap();
        folder.check().unwrap();
        fs::remove_dir(&path).unwrap();
        let said = folder.check().unwrap_err().to_string();
        assert!(said.starts_with("expected the folder of the bus, found no /"), "{said}");
    }
}
