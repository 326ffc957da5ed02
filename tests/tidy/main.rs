//! Tests the rules for source files that ARCHITECTURE.md lists: dependencies, forbidden functions, lengths, names.
//!
//! Method: the workspace's files are read as text; where only code matters, comments and string literals are blanked
//! out. Crate edges come from `cargo metadata`. Every rule collects all its breaches, with file and line, before it
//! fails. If a rule cannot be kept somewhere, it is changed here, with the reason, and not worked around there.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

mod imports;
mod source;

use std::collections::BTreeMap;
use std::fs;
use std::process::Command;

use serde_json::Value;
use source::{Source, files, root, sources};

/// A source file must have fewer lines than this.
const FILE_LINES: usize = 500;

/// A line must have at most this many characters. Code is formatted to fewer, which leaves comments and texts alone.
const LINE_CHARS: usize = 120;

/// A function must have fewer lines than this.
const FUNCTION_LINES: usize = 70;

/// Our crates, with those of our crates that they may depend on. No process depends on another: they meet on the bus.
const EDGES: [(&str, &[&str]); 16] = [
    ("protocol", &[]),
    ("bus", &["protocol"]),
    ("mcap-log", &["protocol"]),
    ("run", &["protocol", "mcap-log"]),
    ("environments", &["protocol"]),
    ("networks", &["protocol"]),
    ("export", &["protocol", "networks"]),
    ("actor", &["protocol", "bus", "mcap-log", "run", "environments", "networks", "export"]),
    ("learner", &["protocol", "bus", "mcap-log", "run", "networks"]),
    ("proximity-service", &["protocol", "bus", "mcap-log", "run", "networks", "export"]),
    ("gateway", &["protocol", "bus", "mcap-log", "run"]),
    ("terminal", &["protocol"]),
    ("report", &["protocol", "mcap-log", "run", "terminal"]),
    ("page", &["protocol", "mcap-log", "run", "terminal", "report"]),
    (
        "goalward",
        &[
            "protocol",
            "bus",
            "mcap-log",
            "run",
            "terminal",
            "report",
            "page",
            "actor",
            "learner",
            "proximity-service",
        ],
    ),
    (
        "system-tests",
        &[
            "protocol",
            "bus",
            "mcap-log",
            "run",
            "environments",
            "actor",
            "learner",
            "proximity-service",
            "gateway",
            "goalward",
        ],
    ),
];

/// Libraries for the bus, the log, physics and connections between machines, each with the one crate that may depend
/// on it.
const BEHIND: [(&str, &str); 6] = [
    ("iceoryx2", "bus"),
    ("iceoryx2-log", "bus"),
    ("mcap", "mcap-log"),
    ("rapier3d", "environments"),
    ("rcgen", "gateway"),
    ("tonic", "gateway"),
];

/// Words that mean a clock, a thread, a file, the outside world, or a private source of randomness.
const IMPURE: [&str; 20] = [
    "std::time",
    "Instant",
    "SystemTime",
    "std::thread",
    "thread_local",
    "rayon",
    "tokio",
    "std::sync",
    "std::fs",
    "std::io",
    "File",
    "std::env",
    "std::net",
    "std::process",
    "rand_chacha",
    "OsRng",
    "SysRng",
    "ThreadRng",
    "RandomState",
    "HashMap",
];

/// Functions of the system's mathematics library, whose last bits differ from machine to machine.
const SYSTEM_MATHEMATICS: [&str; 24] = [
    "exp", "exp_m1", "exp2", "ln", "ln_1p", "log2", "log10", "sin", "cos", "tan", "sin_cos",
    "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "powf",
    "cbrt", "hypot",
];

/// Meaningless words in file names.
const EMPTY_NAMES: [&str; 9] =
    ["util", "utils", "utility", "helper", "helpers", "manager", "misc", "common", "stuff"];

/// Folders of a run, which ARCHITECTURE.md names relative to the run's own folder.
const OF_A_RUN: [&str; 4] = ["checkpoints/", "log/", "output/", "runs/"];

/// Fails with all breaches of a rule if there are any.
fn keep(rule: &str, breaches: Vec<String>) {
    assert!(breaches.is_empty(), "{rule}:\n  {}", breaches.join("\n  "));
}

/// Finds words in the code of files; returns `path:line: words` for each place.
fn places<'a>(
    sources: impl Iterator<Item = &'a Source>,
    words: impl IntoIterator<Item = &'a str> + Clone,
) -> Vec<String> {
    let mut places = Vec::new();
    for source in sources {
        for words in words.clone() {
            let lines = source.lines_with(words).into_iter();
            places.extend(lines.map(|line| format!("{}:{line}: {words}", source.path)));
        }
    }
    places
}

#[test]
fn every_file_says_what_it_is() {
    let sources = sources();
    assert!(sources.len() > 80, "expected the whole workspace, found {} files", sources.len());
    let silent = sources.iter().filter(|source| !source.text.starts_with("//! "));
    let rule = "a source file begins with a `//!` header";
    keep(rule, silent.map(|source| source.path.clone()).collect());
}

#[test]
fn files_are_short() {
    let mut long = Vec::new();
    for path in files() {
        let ending = path.extension().unwrap_or_default().to_string_lossy().into_owned();
        if ["rs", "sh", "py", "proto", "toml"].contains(&ending.as_str()) {
            let lines = fs::read_to_string(root().join(&path)).unwrap().lines().count();
            if lines >= FILE_LINES {
                long.push(format!("{}: {lines} lines", path.display()));
            }
        }
    }
    keep(&format!("a file has fewer than {FILE_LINES} lines"), long);
}

#[test]
fn lines_are_short() {
    let mut long = Vec::new();
    for source in sources() {
        for (line, number) in source.text.lines().zip(1..) {
            let chars = line.chars().count();
            if chars > LINE_CHARS {
                long.push(format!("{}:{number}: {chars} characters", source.path));
            }
        }
    }
    keep(&format!("a line has at most {LINE_CHARS} characters"), long);
}

#[test]
fn functions_are_short() {
    let mut long = Vec::new();
    let mut count = 0;
    for source in sources() {
        for function in source.functions() {
            count += 1;
            if function.lines >= FUNCTION_LINES {
                let (name, line, lines) = (function.name, function.line, function.lines);
                long.push(format!("{}:{line}: {name} has {lines} lines", source.path));
            }
        }
    }
    assert!(count > 500, "expected all functions, found {count}");
    keep(&format!("a function has fewer than {FUNCTION_LINES} lines"), long);
}

#[test]
fn environments_and_networks_are_pure() {
    let sources = sources();
    let pure = || {
        let folders = ["environments/src/", "networks/src/"];
        sources.iter().filter(move |source| folders.iter().any(|folder| source.is_in(folder)))
    };
    assert!(pure().count() > 15);
    let rule = "environments and networks have no clock, no file, no randomness but the stream \
                handed to them, and no threads but in networks/src/training.rs";
    let threads_of_training = "networks/src/training.rs:";
    let mut breaches = places(pure(), IMPURE);
    breaches
        .retain(|place| !(place.starts_with(threads_of_training) && place.ends_with(": rayon")));
    keep(rule, breaches);
}

#[test]
fn mathematics_is_the_same_on_every_machine() {
    let sources = sources();
    let folders = ["environments/", "networks/", "learner/", "proximity-service/", "actor/"];
    let is_ours =
        |source: &&Source| folders.iter().any(|folder| source.is_in(&format!("{folder}src/")));
    let ours: Vec<&Source> = sources.iter().filter(is_ours).collect();
    assert!(ours.len() > 80, "expected the files of five crates, found {}", ours.len());
    let mut breaches = Vec::new();
    for source in ours {
        for (line, number) in source.code.lines().zip(1..) {
            let called = |name: &str| {
                let forms = [format!(".{name}("), format!("f32::{name}"), format!("f64::{name}")];
                forms.iter().any(|form| line.contains(form.as_str()))
            };
            let found = SYSTEM_MATHEMATICS.into_iter().filter(|name| called(name));
            breaches.extend(found.map(|name| format!("{}:{number}: {name}", source.path)));
        }
    }
    keep("results never see the system's mathematics library; use `libm`", breaches);
}

#[test]
fn nothing_is_unsafe() {
    let sources = sources();
    keep("no unsafe code", places(sources.iter(), ["unsafe", "allow(unsafe_code)"]));
    let mut breaches = Vec::new();
    for package in packages() {
        let manifest = package["manifest_path"].as_str().unwrap();
        let text = fs::read_to_string(manifest).unwrap();
        if !text.contains("[lints]\nworkspace = true") {
            breaches.push(manifest.to_owned());
        }
    }
    keep("every crate takes the workspace's lints, which forbid unsafe code", breaches);
}

/// Returns the crates of the workspace, as `cargo metadata` describes them.
fn packages() -> Vec<Value> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    serde_json::from_value(metadata["packages"].take()).unwrap()
}

/// Returns a crate's normal dependencies, without those for tests and build scripts.
fn dependencies(package: &Value) -> Vec<String> {
    let all = package["dependencies"].as_array().unwrap().iter();
    let built = all.filter(|dependency| dependency["kind"].is_null());
    built.map(|dependency| dependency["name"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn crates_know_only_whom_they_should() {
    let allowed: BTreeMap<_, _> = EDGES.into_iter().collect();
    let mut breaches = Vec::new();
    for package in packages() {
        let name = package["name"].as_str().unwrap();
        let Some(may_know) = allowed.get(name) else {
            breaches.push(format!("{name}: not in the table of this test"));
            continue;
        };
        for other in dependencies(&package) {
            if allowed.contains_key(other.as_str()) && !may_know.contains(&other.as_str()) {
                breaches.push(format!("{name} depends on {other}"));
            }
            if BEHIND.iter().any(|&(library, owner)| library == other && owner != name) {
                breaches.push(format!("{name} depends on {other}"));
            }
        }
    }
    keep("crates depend on each other as ARCHITECTURE.md says", breaches);
}

#[test]
fn the_command_knows_no_process_but_by_its_program() {
    let sources = sources();
    let command = sources
        .iter()
        .filter(|source| source.is_in("deploy/src/") && !source.is_in("deploy/src/bin/"));
    let rule = "of the package `goalward` only the programs in deploy/src/bin/ name the crates of processes";
    keep(rule, places(command, ["actor::", "learner::", "proximity_service::"]));
}

#[test]
fn no_two_files_name_each_other() {
    keep("no two files of a crate name each other", imports::circles());
}

#[test]
fn names_say_something() {
    let mut breaches = Vec::new();
    for path in files() {
        let names = path.iter().map(|part| part.to_string_lossy().to_lowercase());
        let is_empty =
            |name: String| name.split(['.', '_', '-']).any(|word| EMPTY_NAMES.contains(&word));
        if names.into_iter().any(is_empty) {
            breaches.push(path.display().to_string());
        }
    }
    keep("no file is called a helper, a manager or a collection of utilities", breaches);
}

/// Returns the parts of a document in backticks.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.lines().flat_map(|line| line.split('`').skip(1).step_by(2))
}

#[test]
fn the_architecture_is_described_as_it_is() {
    let text = fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let is_path = |part: &&str| {
        let plain = |letter: char| letter.is_alphanumeric() || "_-./".contains(letter);
        part.chars().all(plain) && (part.ends_with(".rs") || part.ends_with('/'))
    };
    let is_of_a_run = |path: &&str| OF_A_RUN.iter().any(|folder| path.starts_with(folder));
    let ours = quoted(&text).filter(is_path).filter(|path| !is_of_a_run(path));
    let gone = ours.filter(|path| !root().join(path).exists());
    keep("ARCHITECTURE.md names only what exists", gone.map(str::to_owned).collect());

    let mut unnamed = Vec::new();
    for source in sources().iter().filter(|source| source.path.contains("/src/")) {
        let (folder, _) = source.path.rsplit_once('/').unwrap();
        if !text.contains(folder) && !unnamed.iter().any(|known| known == folder) {
            unnamed.push(folder.to_owned());
        }
    }
    keep("the code map of ARCHITECTURE.md names every folder of source files", unnamed);
}
