//! Checks that shared memory has room before it is needed.
//!
//! Segments are reserved sparsely: when the file system is full, the kernel answers the first write
//! with SIGBUS instead of an error. So a run checks before it starts.

use protocol::Error;

use super::failed;

/// Where Linux keeps shared memory.
pub(super) const SHARED_MEMORY_ROOT: &str = "/dev/shm";

const MIB: u64 = 1 << 20;

/// Checks that shared memory has `needed_bytes` free.
///
/// # Errors
/// When it has less. The message says how much is free and how to get more.
pub fn check_shared_memory_room(needed_bytes: u64) -> Result<(), Error> {
    const OPERATION: &str = "check of the free room";
    let status =
        rustix::fs::statvfs(SHARED_MEMORY_ROOT).map_err(failed(OPERATION, SHARED_MEMORY_ROOT))?;
    let free_bytes = status.f_bavail.saturating_mul(status.f_frsize);
    if free_bytes >= needed_bytes {
        return Ok(());
    }
    Err(Error::Bus {
        operation: OPERATION,
        service: SHARED_MEMORY_ROOT.to_owned(),
        message: format!(
            "{} MiB free, {} MiB needed; free some, or enlarge it \
             (`mount -o remount,size=2G /dev/shm`, `docker run --shm-size=2g`)",
            free_bytes / MIB,
            needed_bytes.div_ceil(MIB)
        ),
    })
}
