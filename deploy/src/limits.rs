//! The system's limits on a process (`ulimit`), checked before a run starts: a process that runs into one later may
//! stall without a message.

use anyhow::{Result, ensure};
use rustix::process::{Resource, getrlimit};

const MIB: u64 = 1 << 20;

/// Address space of the largest process, the learner, bytes: its own, and what it shares with each actor. Most of it is
/// never touched.
const ADDRESS_SPACE: [u64; 2] = [2 << 30, 160 << 20];

/// Open files of a process: its own, and those for each actor. Sockets and shared memory count as files.
const OPEN_FILES: [u64; 2] = [160, 12];

/// Shared memory that the bus of a run can take, bytes.
pub(crate) const SHARED_MEMORY_BYTES: u64 = 300 << 20;

/// Checks that the processes of a run with `actors` actors stay within the limits.
///
/// # Errors
/// For the first limit that is too low.
pub(crate) fn check(actors: u64) -> Result<()> {
    let needed = |[own, per_actor]: [u64; 2]| own + per_actor * actors;
    let limit = |resource| getrlimit(resource).current.unwrap_or(u64::MAX);
    let (needed_bytes, found) = (needed(ADDRESS_SPACE), limit(Resource::As));
    ensure!(
        found >= needed_bytes,
        "expected {} MiB of address space for each process of a run with {actors} actors, found a \
         limit of {} MiB (`ulimit -v unlimited` lifts it)",
        needed_bytes / MIB,
        found / MIB
    );
    let (needed, found) = (needed(OPEN_FILES), limit(Resource::Nofile));
    ensure!(
        found >= needed,
        "expected {needed} open files for each process of a run with {actors} actors, found a limit of \
         {found} (`ulimit -n {needed}` raises it)"
    );
    Ok(())
}
