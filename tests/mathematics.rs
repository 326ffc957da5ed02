//! The functions that rapier takes from the system's mathematics library do not affect results: their last bits differ
//! between C libraries, but the episodes stay the same.
//!
//! Method: `nm` lists what the programs import from the mathematics library. The list is kept here, so that a new
//! import is noticed. A small library built with the C compiler is loaded before the system's (`LD_PRELOAD`): it shifts
//! every result of the functions on the actor's list by one unit in the last place, and counts the calls.
//! Episodes recorded without it must be re-simulated to the same bits with it.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use system_tests::{TestRun, programs};

/// Functions that the actor imports from the mathematics library for its physics: rapier's dependencies glamx and
/// parry call them. Our own crates call none of them, see `tests/tidy/`.
const OF_PHYSICS: [&str; 7] = ["acosf", "cosf", "expf", "log2f", "powf", "sincosf", "sinf"];

/// Functions that `goalward` itself imports, for the charts and intervals of reports; no training uses them.
const OF_REPORTS: [&str; 9] =
    ["atan2", "cos", "exp", "hypotf", "log", "log10", "pow", "sin", "sincos"];

/// Demonstrations of a small run.
const DEMONSTRATIONS: u64 = 10;

/// Environment variable with the path of the file that the library writes call counts to.
const COUNTS: &str = "GOALWARD_TEST_COUNTS";

fn output(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{command:?}: {said}");
    String::from_utf8(output.stdout).unwrap()
}

/// Lists a file's dynamic symbols of a kind (an option of `nm`), without their versions.
fn symbols(kind: &str, file: &Path) -> BTreeSet<String> {
    let listing = output(Command::new("nm").args(["-D", kind]).arg(file));
    let name = |line: &str| line.split_whitespace().last()?.split('@').next().map(str::to_owned);
    listing.lines().filter_map(name).collect()
}

fn mathematics_library() -> PathBuf {
    let path = output(Command::new("cc").arg("-print-file-name=libm.so.6"));
    PathBuf::from(path.trim())
}

#[test]
fn no_program_imports_more_mathematics_than_is_known() {
    let there = symbols("--defined-only", &mathematics_library());
    assert!(there.contains("acosf"), "expected the functions of a mathematics library");
    for (program, file) in programs!().files {
        let known = match program {
            "goalward-actor" => &OF_PHYSICS[..],
            "goalward" => &OF_REPORTS,
            _ => &[],
        };
        let imported = symbols("--undefined-only", Path::new(file));
        let mut unknown: Vec<_> = imported.intersection(&there).collect();
        unknown.retain(|name| !known.contains(&name.as_str()));
        assert!(unknown.is_empty(), "{program} takes {unknown:?} from the system's library");
    }
}

/// Returns the library's C source.
fn source() -> String {
    let mut source = "#define _GNU_SOURCE\n#include <dlfcn.h>\n#include <stdint.h>\n\
                      #include <stdio.h>\n#include <stdlib.h>\n#include <string.h>\n\
                      static float up(float x) {\n\
                      \x20 uint32_t bits;\n  memcpy(&bits, &x, 4);\n\
                      \x20 if ((bits & 0x7f800000) != 0x7f800000) bits += 1;\n\
                      \x20 memcpy(&x, &bits, 4);\n  return x;\n}\n"
        .to_owned();
    for name in OF_PHYSICS.iter().filter(|name| **name != "sincosf") {
        let (parameters, arguments) =
            if *name == "powf" { ("float x, float y", "x, y") } else { ("float x", "x") };
        write!(
            source,
            "static long n_{name};\nfloat {name}({parameters}) {{\n  static float (*real)({parameters});\n  \
             if (!real) real = dlsym(RTLD_NEXT, \"{name}\");\n  n_{name} += 1;\n  \
             return up(real({arguments}));\n}}\n"
        )
        .unwrap();
    }
    source += "static long n_sincosf;\nvoid sincosf(float x, float *s, float *c) {\n\
               \x20 static void (*real)(float, float *, float *);\n\
               \x20 if (!real) real = dlsym(RTLD_NEXT, \"sincosf\");\n\
               \x20 n_sincosf += 1;\n  real(x, s, c);\n  *s = up(*s);\n  *c = up(*c);\n}\n";
    source += "__attribute__((destructor)) static void tell(void) {\n";
    writeln!(source, "  const char *path = getenv(\"{COUNTS}\");").unwrap();
    source += "  FILE *file = path ? fopen(path, \"a\") : 0;\n  if (!file) return;\n";
    for name in OF_PHYSICS {
        writeln!(source, "  fprintf(file, \"{name} %ld\\n\", n_{name});").unwrap();
    }
    source + "  fclose(file);\n}\n"
}

/// Builds the library; returns its path.
fn nudging_library(run: &TestRun) -> PathBuf {
    let (code, library) = (run.path("nudge.c"), run.path("nudge.so"));
    fs::write(&code, source()).unwrap();
    let mut compiler = Command::new("cc");
    compiler.args(["-shared", "-fPIC", "-O1", "-fno-builtin", "-o"]).arg(&library).arg(&code);
    output(compiler.arg("-ldl"));
    library
}

/// Reads how often each function was called, summed over all processes.
fn counts(file: &Path) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    for line in fs::read_to_string(file).unwrap().lines() {
        let (name, count) = line.split_once(' ').unwrap();
        *counts.entry(name.to_owned()).or_insert(0) += count.parse::<u64>().unwrap();
    }
    counts
}

/// Re-simulates the episodes of a run with every function's result shifted by one unit in the last place. Returns how
/// often each function was called.
fn verify_nudged(task: &str) -> BTreeMap<String, u64> {
    let run = TestRun::new(programs!());
    let summary = run.train_task(task, &["steps=1600"]).finish();
    let told = run.path("counts");
    let mut verify = run.program("goalward");
    verify.arg("replay").arg(run.folder().path()).arg("--verify");
    verify.env("LD_PRELOAD", nudging_library(&run)).env(COUNTS, &told);
    let said = output(&mut verify);
    // The run's own demonstrations are verified, too.
    let all = summary.log.trajectories + DEMONSTRATIONS;
    let expected = format!("{all} of {all} episodes");
    assert!(said.contains(&expected), "expected {expected} in\n{said}");
    counts(&told)
}

#[test]
fn ant_reach_is_indifferent_to_the_last_bits_of_the_systems_mathematics() {
    let counts = verify_nudged("ant-reach");
    for name in ["acosf", "cosf"] {
        assert!(counts[name] > 0, "{name} was never called, so nothing was shown: {counts:?}");
    }
}

#[test]
fn fetch_takes_nothing_from_the_systems_mathematics() {
    for task in ["fetch-push", "fetch-pick"] {
        let counts = verify_nudged(task);
        assert_eq!(counts.len(), OF_PHYSICS.len(), "the functions were counted");
        assert!(counts.values().all(|count| *count == 0), "{task}: {counts:?}");
    }
}
