//! Where a run's bus is: the names that keep runs, and tests, from ever meeting.
//!
//! iceoryx2 separates buses by the prefix of their shared memory objects and by the folder of their
//! node files and sockets. Both come from the run's folder, so that any tool that knows the folder
//! finds the bus. The bus folder lies in shared memory too: the same for all processes whatever
//! their `TMPDIR`, gone after a reboot, and short enough for the 108 bytes of a socket's path.

use std::fs;
use std::hash::{BuildHasher, RandomState};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use iceoryx2::prelude::{Config, FileName, FilePath, SemanticString};

use super::room::SHARED_MEMORY_ROOT;
use super::{SharedMemory, alive, clean_up, failed};
use crate::Error;

/// Serialises the first use of iceoryx2's process-wide defaults.
static DEFAULTS_CLAIMED: Mutex<bool> = Mutex::new(false);

/// How long a process waits for another one that is creating the same service.
const CREATION_TIMEOUT: Duration = Duration::from_secs(2);

/// The names of one bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusAddress {
    prefix: String,
    root: PathBuf,
}

impl BusAddress {
    /// The address of the run in `run_directory`, which must exist.
    ///
    /// # Errors
    /// When the folder's canonical path cannot be found.
    pub fn of_run(run_directory: &Path) -> Result<Self, Error> {
        let path = run_directory
            .canonicalize()
            .map_err(failed("finding of the run", &run_directory.display().to_string()))?;
        Ok(Self::of_key(xxhash_rust::xxh3::xxh3_64(path.as_os_str().as_encoded_bytes())))
    }

    /// An address no one else has.
    pub fn unique_for_test() -> Self {
        // The standard library's randomness for hash maps: new for every call, no clock.
        Self::of_key(RandomState::new().hash_one(std::process::id()))
    }

    fn of_key(key: u64) -> Self {
        let shared_memory = Path::new(SHARED_MEMORY_ROOT);
        let base =
            if shared_memory.is_dir() { shared_memory.to_owned() } else { std::env::temp_dir() };
        BusAddress { prefix: format!("gw_{key:016x}_"), root: base.join(format!("gw_{key:016x}")) }
    }

    /// What the name of every shared memory object of this bus begins with.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// The folder of the bus.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Whether a process of this run lives.
    ///
    /// # Errors
    /// When the bus cannot be listed.
    pub fn is_anyone_alive(&self) -> Result<bool, Error> {
        Ok(!alive::<SharedMemory>(&self.config()?)?.is_empty())
    }

    /// Removes everything the run left in shared memory: after its end, or before a new start. No
    /// process may be joining meanwhile. Other runs are never touched.
    ///
    /// # Errors
    /// When a process of the run lives, with its name, or a file cannot be removed.
    pub fn remove(&self) -> Result<(), Error> {
        const OPERATION: &str = "removal";
        let config = self.config()?;
        clean_up::<SharedMemory>(&config)?;
        let alive = alive::<SharedMemory>(&config)?;
        if !alive.is_empty() {
            let message = format!("still alive: {}", alive.join(", "));
            return Err(Error::Bus { operation: OPERATION, service: "bus".to_owned(), message });
        }
        if let Ok(entries) = fs::read_dir(SHARED_MEMORY_ROOT) {
            for entry in entries.flatten() {
                if entry.file_name().as_encoded_bytes().starts_with(self.prefix.as_bytes()) {
                    let shown = entry.path().display().to_string();
                    unless_missing(fs::remove_file(entry.path()))
                        .map_err(failed(OPERATION, &shown))?;
                }
            }
        }
        unless_missing(fs::remove_dir_all(&self.root))
            .map_err(failed(OPERATION, &self.root.display().to_string()))
    }

    pub(super) fn config(&self) -> Result<Config, Error> {
        const OPERATION: &str = "setting of the address";
        let mut config = Config::default();
        config.global.prefix =
            FileName::new(self.prefix.as_bytes()).map_err(failed(OPERATION, &self.prefix))?;
        let root = self.root.as_os_str().as_encoded_bytes();
        let root = iceoryx2::prelude::Path::new(root).map_err(failed(OPERATION, &self.prefix))?;
        config.global.set_root_path(&root);
        config.global.creation_timeout = CREATION_TIMEOUT;
        // A short-lived process must not spend its exit on others; the supervisor cleans up.
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        Ok(config)
    }

    /// Makes this process's first address iceoryx2's default too. Otherwise cleaning up after a
    /// process that died while it was joining would search the machine for somebody's settings.
    pub(super) fn claim_defaults(&self, config: &Config) -> Result<(), Error> {
        const OPERATION: &str = "writing of the settings";
        let Ok(mut claimed) = DEFAULTS_CLAIMED.lock() else { return Ok(()) };
        if *claimed {
            return Ok(());
        }
        let path = self.root.join(format!("{}.toml", std::process::id()));
        let shown = path.display().to_string();
        let text = toml::to_string(config).map_err(failed(OPERATION, &shown))?;
        fs::create_dir_all(&self.root).map_err(failed(OPERATION, &shown))?;
        fs::write(&path, text).map_err(failed(OPERATION, &shown))?;
        let file = FilePath::new(path.as_os_str().as_encoded_bytes())
            .map_err(failed(OPERATION, &shown))?;
        Config::setup_global_config_from_file(&file).map_err(failed(OPERATION, &shown))?;
        fs::remove_file(&path).map_err(failed(OPERATION, &shown))?;
        *claimed = true;
        Ok(())
    }
}

fn unless_missing(result: std::io::Result<()>) -> std::io::Result<()> {
    match result {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        other => other,
    }
}
