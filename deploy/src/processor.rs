//! Checks that this machine's processor has the instructions that `goalward` is built for. A program that executes a
//! missing instruction is killed without a message.

use std::io::Write;

/// Printed without colors: the code that adds them needs the missing instructions.
const MISSING: &str = "goalward: expected a processor with AVX2 and FMA (x86-64-v3, since 2013), found one \
                       without: remove target-cpu from .cargo/config.toml and build again\n";

/// Returns whether `goalward` can run on this processor; prints an error if it cannot.
pub(crate) fn suffices() -> bool {
    let suffices = has_what_this_is_built_for();
    if !suffices {
        std::io::stderr().write_all(MISSING.as_bytes()).ok();
    }
    suffices
}

/// Asks the processor itself: the standard library's check takes features that the build enables as present.
#[cfg(target_feature = "avx2")]
fn has_what_this_is_built_for() -> bool {
    use std::arch::x86_64::{__cpuid, __cpuid_count};

    let has_avx2 = __cpuid(0).eax >= 7 && __cpuid_count(7, 0).ebx >> 5 & 1 == 1;
    let has_fma = __cpuid(1).ecx >> 12 & 1 == 1;
    has_avx2 && has_fma
}

#[cfg(not(target_feature = "avx2"))]
fn has_what_this_is_built_for() -> bool {
    true
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_processor_that_runs_this_build_suffices() {
        assert!(super::suffices());
    }
}
