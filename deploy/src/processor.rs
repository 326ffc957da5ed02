//! Whether this machine's processor has what `goalward` is built for. A program that comes upon an instruction that
//! is not there is killed without a word.

use std::io::Write;

/// Printed as it is: what colors it needs the instructions that are missing.
const MISSING: &str = "goalward: expected a processor with AVX2 and FMA (x86-64-v3, since 2013), found one \
                       without: remove target-cpu from .cargo/config.toml and build again\n";

/// Whether it can go on here; says so if not.
pub(crate) fn suffices() -> bool {
    let suffices = has_what_this_is_built_for();
    if !suffices {
        std::io::stderr().write_all(MISSING.as_bytes()).ok();
    }
    suffices
}

/// By the processor's own word: the standard library's, of what a build is for, is that of the build.
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
