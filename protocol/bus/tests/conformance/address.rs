//! The address of a run's bus. Other users of the machine can do nothing but block it, and the error then names them.
//!
//! Method: as root, the tests act as a second user (`nobody`) by running commands under that user ID. Otherwise this
//! part is skipped, with a message.

use std::fs;
use std::io::Write;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use bus::{Bus, BusAddress, Role};

use super::watched;

/// User ID of `nobody` on most systems. It need not have a name.
const STRANGER: u32 = 65_534;

/// Whether this user can act as another one. If not, a line on standard error says so: what tests print themselves is
/// not shown.
fn is_root() -> bool {
    let is_root = rustix::process::geteuid().is_root();
    if !is_root {
        std::io::stderr().write_all(b"left out: only root can act as a second user\n").unwrap();
    }
    is_root
}

/// Runs a command as another user; returns false if this user cannot.
fn as_stranger(program: &str, arguments: &[&Path]) -> bool {
    if !is_root() {
        return false;
    }
    let done = Command::new(program).args(arguments).uid(STRANGER).gid(STRANGER).status().unwrap();
    assert!(done.success(), "{program} {arguments:?}: {done}");
    true
}

/// Returns the errors of opening, checking and removing a bus.
fn refusals(address: &BusAddress) -> [String; 3] {
    [
        Bus::open(address, "actor-0").unwrap_err().to_string(),
        address.is_anyone_alive().unwrap_err().to_string(),
        address.remove().unwrap_err().to_string(),
    ]
}

fn expect_named(address: &BusAddress, what: &str) {
    let root = address.root().display().to_string();
    for refusal in refusals(address) {
        assert!(refusal.contains(&root) && refusal.contains(what), "{refusal}");
        assert!(!refusal.contains('\n'), "{refusal}");
    }
}

#[test]
fn address_follows_from_the_run() {
    let run = tempfile::tempdir().unwrap();
    let error = BusAddress::of_run(run.path()).unwrap_err().to_string();
    assert!(error.contains("not been started"), "{error}");
    assert_eq!(BusAddress::if_started(run.path()), Ok(None));

    let address = BusAddress::for_start(run.path()).unwrap();
    assert_eq!(BusAddress::for_start(run.path()).unwrap(), address);
    let detour = run.path().join("../").join(run.path().file_name().unwrap());
    assert_eq!(BusAddress::of_run(&detour).unwrap(), address);
    let mode = fs::metadata(run.path().join("bus")).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600, "only the owner knows the names");

    let copy = tempfile::tempdir().unwrap();
    fs::copy(run.path().join("bus"), copy.path().join("bus")).unwrap();
    assert_ne!(BusAddress::of_run(copy.path()).unwrap(), address, "a copy meets the original");
    assert_ne!(BusAddress::unique_for_test(), BusAddress::unique_for_test());
    let error = BusAddress::of_run(Path::new("/no/such/run")).unwrap_err().to_string();
    assert!(error.contains("/no/such/run"), "{error}");
}

#[test]
fn a_place_that_is_gone_is_chosen_anew() {
    let run = tempfile::tempdir().unwrap();
    fs::write(run.path().join("bus"), "nonce = \"7\"\nbase = \"/no/such/place\"\n").unwrap();
    assert!(!BusAddress::of_run(run.path()).unwrap().is_anyone_alive().unwrap());
    let address = BusAddress::for_start(run.path()).unwrap();
    assert!(address.root().parent().unwrap().is_dir(), "{}", address.root().display());
}

#[test]
fn names_cannot_be_foretold_from_the_path() {
    let run = tempfile::tempdir().unwrap();
    let first = BusAddress::for_start(run.path()).unwrap();
    fs::remove_file(run.path().join("bus")).unwrap();
    assert_ne!(BusAddress::for_start(run.path()).unwrap(), first);
}

#[test]
fn the_bus_folder_is_its_users_alone() {
    watched(|address| {
        let bus = Bus::open(address, "actor-0").unwrap();
        let _learner = bus.lease_server().unwrap();
        let _bell = bus.doorbell(Role::Learner).unwrap();
        let mode = fs::metadata(address.root()).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
        let objects = fs::read_dir("/dev/shm").unwrap().flatten();
        for object in objects.filter(|one| {
            one.file_name().as_encoded_bytes().starts_with(address.prefix().as_bytes())
        }) {
            let mode = object.metadata().unwrap().permissions().mode();
            assert_eq!(mode & 0o077, 0, "{:?} is open to others: {mode:o}", object.path());
        }
        let sockets = sockets(address.root());
        assert!(!sockets.is_empty(), "the bell has one");
        for socket in sockets {
            // Below the longest base, which has 21 bytes.
            let base = address.root().parent().unwrap();
            let length = 21 + socket.as_os_str().len() - base.as_os_str().len();
            assert!(length <= 107, "{} may have {length} bytes", socket.display());
        }
    });
}

fn sockets(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().flatten().map(|entry| entry.path());
    entries.filter(|path| path.extension().is_some_and(|end| end == "event")).collect()
}

#[test]
fn a_folder_open_to_others_is_not_accepted() {
    let address = BusAddress::unique_for_test();
    fs::create_dir(address.root()).unwrap();
    fs::set_permissions(address.root(), fs::Permissions::from_mode(0o755)).unwrap();
    expect_named(&address, "mode 755");
    fs::remove_dir(address.root()).unwrap();
}

#[test]
fn a_file_in_the_way_is_named() {
    let address = BusAddress::unique_for_test();
    fs::write(address.root(), "mine").unwrap();
    expect_named(&address, "found a file");
    assert_eq!(fs::read_to_string(address.root()).unwrap(), "mine");
    fs::remove_file(address.root()).unwrap();
}

#[test]
fn a_link_is_not_followed() {
    let address = BusAddress::unique_for_test();
    let victim = tempfile::tempdir().unwrap();
    fs::write(victim.path().join("thesis.txt"), "dear").unwrap();
    fs::set_permissions(victim.path(), fs::Permissions::from_mode(0o700)).unwrap();
    symlink(victim.path(), address.root()).unwrap();
    expect_named(&address, "found a link");
    fs::remove_file(address.root()).unwrap();
    assert_eq!(fs::read_to_string(victim.path().join("thesis.txt")).unwrap(), "dear");
    assert_eq!(fs::read_dir(victim.path()).unwrap().count(), 1, "something was written there");
}

#[test]
fn a_link_among_shared_memory_objects_is_removed_and_not_followed() {
    let address = BusAddress::unique_for_test();
    let victim = tempfile::NamedTempFile::new().unwrap();
    fs::write(victim.path(), "dear").unwrap();
    let link = PathBuf::from(format!("/dev/shm/{}data", address.prefix()));
    symlink(victim.path(), &link).unwrap();
    address.remove().unwrap();
    assert!(link.symlink_metadata().is_err());
    assert_eq!(fs::read_to_string(victim.path()).unwrap(), "dear");
}

#[test]
fn what_another_user_put_there_is_named_with_its_owner() {
    let address = BusAddress::unique_for_test();
    let owner = format!("user {STRANGER}");
    if !as_stranger("mkdir", &[Path::new("-m700"), address.root()]) {
        return;
    }
    expect_named(&address, &owner);
    fs::remove_dir(address.root()).unwrap();

    let home = tempfile::tempdir().unwrap();
    as_stranger("ln", &[Path::new("-s"), home.path(), address.root()]);
    expect_named(&address, &owner);
    assert_eq!(fs::read_dir(home.path()).unwrap().count(), 0);
    fs::remove_file(address.root()).unwrap();

    let object = PathBuf::from(format!("/dev/shm/{}node", address.prefix()));
    as_stranger("touch", &[&object]);
    let refusal = address.remove().unwrap_err().to_string();
    assert!(
        refusal.contains(&object.display().to_string()) && refusal.contains(&owner),
        "{refusal}"
    );
    fs::remove_file(&object).unwrap();
    address.remove().unwrap();
}

#[test]
fn another_user_can_neither_find_nor_look_into_a_bus() {
    if !is_root() {
        return;
    }
    let run = tempfile::tempdir().unwrap();
    let address = BusAddress::for_start(run.path()).unwrap();
    let bus = Bus::open(&address, "learner").unwrap();
    let listing = Command::new("ls").arg(address.root()).uid(STRANGER).gid(STRANGER).output();
    assert!(!listing.unwrap().status.success(), "others can look into the bus folder");
    let reading =
        Command::new("cat").arg(run.path().join("bus")).uid(STRANGER).gid(STRANGER).output();
    assert!(!reading.unwrap().status.success(), "others can read where the bus is");
    drop(bus);
    address.remove().unwrap();
}
