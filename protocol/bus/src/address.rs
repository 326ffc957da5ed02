//! The address of a run's bus: names that keep the buses of runs, tests and users apart.
//!
//! iceoryx2 separates buses by the prefix of their shared memory objects and by the folder of their node files and
//! sockets. Both are derived from the path of the run's folder and from a random number in its file `bus`, which only
//! its owner can read. So nobody else can guess them beforehand, and a copy of a run's folder has a bus of its own.
//! The file also says where the bus folder is, so that every process finds the same one whatever its environment
//! variables.

use std::fs;
use std::hash::{BuildHasher, RandomState};
use std::io::ErrorKind;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use iceoryx2::prelude::{Config, FileName, FilePath, SemanticString};
use protocol::dropped::shortened;
use protocol::error::FOUND_CHARS;
use protocol::{Error, durable};
use serde::{Deserialize, Serialize};

use super::member::members;
use super::private::{self, check_folder};
use super::room::SHARED_MEMORY_ROOT;
use super::{Member, alive, clean_up, failed};

/// Serializes the first use of iceoryx2's process-wide defaults.
static DEFAULTS_CLAIMED: Mutex<bool> = Mutex::new(false);

/// How long a process waits for another one that is creating the same service.
pub(super) const CREATION_TIMEOUT: Duration = Duration::from_secs(2);

/// The file of a run that says where its bus is.
const BUS_FILE: &str = "bus";

/// Maximum length of the path of the folder that contains bus folders, in bytes. A socket's path has at most 107
/// bytes. After the base come `/gw_` and the key, 20 bytes, and iceoryx2's name of a socket, at most 66.
const BASE_BYTES: usize = 21;

/// The names used by one bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusAddress {
    prefix: String,
    root: PathBuf,
}

/// The content of the file `bus`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BusFile {
    /// A random number, in hexadecimal.
    nonce: String,
    /// The folder that contains the bus folder.
    base: PathBuf,
}

impl BusAddress {
    /// Returns the address of the run in `run_directory`, which must have been started before.
    ///
    /// # Errors
    /// When the run has never been started, or its file `bus` cannot be read.
    pub fn of_run(run_directory: &Path) -> Result<Self, Error> {
        let missing = || {
            let message = "expected where the bus is; the run has not been started yet".to_owned();
            Error::BusFile { path: run_directory.join(BUS_FILE), message }
        };
        Self::if_started(run_directory)?.ok_or_else(missing)
    }

    /// Returns the address of the run in `run_directory`; `None` if it has never been started.
    ///
    /// # Errors
    /// When the folder's canonical path cannot be found, or its file `bus` cannot be read.
    pub fn if_started(run_directory: &Path) -> Result<Option<Self>, Error> {
        let shown = run_directory.display().to_string();
        let path = run_directory.canonicalize().map_err(failed("finding of the run", &shown))?;
        let file = path.join(BUS_FILE);
        match fs::read_to_string(&file) {
            Ok(text) => Self::from_text(&path, &text).map(Some),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => {
                let owner = private::owner(&file);
                let message = format!("{error}; {owner}, who alone can reach the run's processes");
                Err(Error::BusFile { path: file, message })
            }
        }
    }

    /// Returns the address of the run in `run_directory`, which the caller is about to start. The caller must hold the
    /// run's lock.
    ///
    /// # Errors
    /// When its file `bus` cannot be read or written.
    pub fn for_start(run_directory: &Path) -> Result<Self, Error> {
        if let Some(address) = Self::if_started(run_directory)?
            // If the base folder is gone, as after its user's logout, nobody is on the bus.
            && address.root.parent().is_some_and(Path::is_dir)
        {
            return Ok(address);
        }
        let file = BusFile { nonce: format!("{:016x}", random()), base: base() };
        let text = toml::to_string(&file).expect("two texts are TOML");
        let path = run_directory.join(BUS_FILE);
        durable::write_private(&path, text)
            .map_err(|error| Error::BusFile { path, message: error.to_string() })?;
        Self::of_run(run_directory)
    }

    /// Returns an address that nobody else has.
    pub fn unique_for_test() -> Self {
        Self::of_key(&base(), random())
    }

    /// Derives the address of the run at this canonical path from the text of its file `bus`.
    fn from_text(run: &Path, text: &str) -> Result<Self, Error> {
        let refused = |message| Error::BusFile { path: run.join(BUS_FILE), message };
        let file: BusFile = toml::from_str(text)
            .map_err(|error| refused(shortened(error.message(), FOUND_CHARS)))?;
        let nonce = u64::from_str_radix(&file.nonce, 16);
        let (Ok(nonce), true, true) = (nonce, file.base.is_absolute(), fits(&file.base)) else {
            return Err(refused(format!(
                "expected a hexadecimal number and a folder of at most {BASE_BYTES} bytes, found {}",
                shortened(&format!("{:?} and {:?}", file.nonce, file.base), FOUND_CHARS)
            )));
        };
        let mut named = run.as_os_str().as_bytes().to_owned();
        named.extend(nonce.to_le_bytes());
        Ok(Self::of_key(&file.base, xxhash_rust::xxh3::xxh3_64(&named)))
    }

    fn of_key(base: &Path, key: u64) -> Self {
        BusAddress { prefix: format!("gw_{key:016x}_"), root: base.join(format!("gw_{key:016x}")) }
    }

    /// Returns the prefix of the names of this bus's shared memory objects.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Returns the bus folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Returns whether a process of this run is alive.
    ///
    /// # Errors
    /// When the bus folder is not private to this user, or cannot be listed.
    pub fn is_anyone_alive(&self) -> Result<bool, Error> {
        if !check_folder(&self.root)? {
            return Ok(false);
        }
        Ok(!alive(&self.config()?)?.is_empty())
    }

    /// Returns all members of this run's bus, sorted by name. Dead ones are included until they are cleaned up.
    ///
    /// # Errors
    /// When the bus cannot be listed.
    pub fn members(&self) -> Result<Vec<Member>, Error> {
        if !check_folder(&self.root)? {
            return Ok(Vec::new());
        }
        members(&self.config()?)
    }

    /// Removes everything the run left in shared memory, after its end or before a new start. No process may join at
    /// the same time. Other runs and other users' files are never touched.
    ///
    /// # Errors
    /// When a process of the run is alive, with its name; when another user's file is in the way, with its path and
    /// owner; or when a file cannot be removed.
    pub fn remove(&self) -> Result<(), Error> {
        const OPERATION: &str = "removal";
        if check_folder(&self.root)? {
            clean_up(self, Duration::ZERO)?;
            let alive = alive(&self.config()?)?;
            if !alive.is_empty() {
                let message = format!("still alive: {}", alive.join(", "));
                return Err(Error::Bus {
                    operation: OPERATION,
                    service: "bus".to_owned(),
                    message,
                });
            }
        }
        for path in self.objects() {
            private::check_owner(&path)?;
            let shown = path.display().to_string();
            unless_missing(fs::remove_file(&path)).map_err(failed(OPERATION, &shown))?;
        }
        // This follows no links.
        unless_missing(fs::remove_dir_all(&self.root))
            .map_err(failed(OPERATION, &self.root.display().to_string()))
    }

    /// Removes shared memory objects that have had size 0 for at least `patience`, and returns whether there are
    /// younger ones. A process that is killed between creating an object and setting its size leaves one. iceoryx2
    /// then waits forever for the size, in any process that opens the object or cleans up dead nodes.
    ///
    /// # Errors
    /// When such an object belongs to another user, with its path and owner, or cannot be removed.
    pub(super) fn remove_sizeless(&self, patience: Duration) -> Result<bool, Error> {
        let mut is_any_young = false;
        for path in self.objects() {
            let Ok(found) = fs::symlink_metadata(&path) else { continue };
            if !found.is_file() || found.len() > 0 {
                continue;
            }
            let age = found.modified().ok().and_then(|since| since.elapsed().ok());
            if age.unwrap_or_default() < patience {
                is_any_young = true;
                continue;
            }
            private::check_owner(&path)?;
            let shown = path.display().to_string();
            unless_missing(fs::remove_file(&path)).map_err(failed("removal", &shown))?;
        }
        Ok(is_any_young)
    }

    /// Returns the shared memory objects of this bus, without its folder.
    fn objects(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir(SHARED_MEMORY_ROOT).into_iter().flatten().flatten();
        let is_ours = |entry: &fs::DirEntry| {
            entry.file_name().as_encoded_bytes().starts_with(self.prefix.as_bytes())
        };
        entries.filter(is_ours).map(|entry| entry.path()).collect()
    }

    /// Creates the bus folder, or checks that the existing one is private to this user.
    pub(super) fn enter(&self) -> Result<(), Error> {
        private::make_folder(&self.root)
    }

    /// Removes other users' access to this bus's objects. iceoryx2 makes one of them, a counter of nodes, writable for
    /// everybody.
    pub(super) fn close_to_others(&self) -> Result<(), Error> {
        self.objects().iter().try_for_each(|path| private::close_to_others(path))
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
        // A short-lived process must not delay its exit to clean up after others; the supervisor does that.
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        Ok(config)
    }

    /// Makes this process's first address iceoryx2's default as well. Otherwise, cleaning up after a process that died
    /// while joining would search the machine for somebody's configuration.
    pub(super) fn claim_defaults(&self, config: &Config) -> Result<(), Error> {
        const OPERATION: &str = "writing of the settings";
        let Ok(mut claimed) = DEFAULTS_CLAIMED.lock() else { return Ok(()) };
        if *claimed {
            return Ok(());
        }
        let path = self.root.join(format!("{}.toml", std::process::id()));
        let shown = path.display().to_string();
        let text = toml::to_string(config).map_err(failed(OPERATION, &shown))?;
        fs::write(&path, text).map_err(failed(OPERATION, &shown))?;
        let file = FilePath::new(path.as_os_str().as_encoded_bytes())
            .map_err(failed(OPERATION, &shown))?;
        Config::setup_global_config_from_file(&file).map_err(failed(OPERATION, &shown))?;
        fs::remove_file(&path).map_err(failed(OPERATION, &shown))?;
        *claimed = true;
        Ok(())
    }
}

/// Returns a number that nobody can guess: the standard library's hash maps are keyed by the system's randomness.
fn random() -> u64 {
    RandomState::new().hash_one(std::process::id())
}

/// Returns the folder that contains bus folders: the user's private runtime folder; else shared memory, which is gone
/// after a reboot; else the folder of temporary files.
fn base() -> PathBuf {
    let own = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    let shared_memory = || {
        let folder = Path::new(SHARED_MEMORY_ROOT);
        let temporary = || Some(std::env::temp_dir()).filter(|folder| fits(folder));
        if folder.is_dir() {
            folder.to_owned()
        } else {
            temporary().unwrap_or_else(|| PathBuf::from("/tmp"))
        }
    };
    own.filter(|folder| is_usable(folder)).unwrap_or_else(shared_memory)
}

fn is_usable(folder: &Path) -> bool {
    folder.is_absolute() && fits(folder) && matches!(check_folder(folder), Ok(true))
}

fn fits(base: &Path) -> bool {
    base.as_os_str().len() <= BASE_BYTES && base.to_str().is_some()
}

fn unless_missing(result: std::io::Result<()>) -> std::io::Result<()> {
    match result {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        other => other,
    }
}
