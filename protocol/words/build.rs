//! Tells the crate what it is built from: the commit, whether files differ from it, the compiler and the processor
//! features it may use. `src/build.rs` uses this.
//!
//! Nothing here can fail: outside a checkout, or without git, the commit is unknown.
#![allow(clippy::print_stdout, reason = "so a build script speaks to cargo")]

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Paths that affect results besides configuration and seed, relative to the checkout's root.
const DECIDING: [&str; 23] = [
    ".cargo",
    "Cargo.lock",
    "Cargo.toml",
    "actor/Cargo.toml",
    "environments/experts",
    "actor/src",
    "environments/Cargo.toml",
    "environments/src",
    "learner/Cargo.toml",
    "learner/src",
    "networks/Cargo.toml",
    "networks/src",
    "protocol/bus/Cargo.toml",
    "protocol/bus/src",
    "protocol/log/Cargo.toml",
    "protocol/log/src",
    "protocol/run/Cargo.toml",
    "protocol/run/src",
    "protocol/words/Cargo.toml",
    "protocol/words/src",
    "proximity-service/Cargo.toml",
    "proximity-service/src",
    "rust-toolchain.toml",
];

fn main() {
    let root = Path::new(&variable("CARGO_MANIFEST_DIR")).join("../..");
    println!("cargo::rerun-if-changed=build.rs");
    // A development build does not run this script again after every edit and commit, so it always counts as changed.
    let is_release = variable("PROFILE") == "release";
    if is_release {
        watch(&root);
    }
    let commit = commit(&root);
    let is_changed = commit.is_none() || !is_release || has_changes(&root);
    tell("COMMIT", commit.as_deref().unwrap_or("unknown"));
    tell("DIRTY", if is_changed { "true" } else { "false" });
    let rustc = said(Command::new(variable("RUSTC")).arg("--version"));
    tell("RUSTC", rustc.as_deref().unwrap_or("unknown"));
    tell("TARGET_FEATURES", &variable("CARGO_CFG_TARGET_FEATURE"));
}

/// Makes cargo run the script again when the checkout moves to another commit or a deciding file changes.
fn watch(root: &Path) {
    let mut paths: Vec<PathBuf> = DECIDING.iter().map(|path| root.join(path)).collect();
    let branch = git(root, &["symbolic-ref", "--quiet", "HEAD"]);
    for name in ["HEAD", "logs/HEAD", "packed-refs"].into_iter().chain(branch.as_deref()) {
        // Git is asked for the path, because a worktree keeps these files elsewhere.
        paths.extend(git(root, &["rev-parse", "--git-path", name]).map(|path| root.join(path)));
    }
    for path in paths.into_iter().filter(|path| path.exists()) {
        println!("cargo::rerun-if-changed={}", path.display());
    }
}

/// Returns the newest commit that changed a deciding file; `None` if these files are not part of a checkout.
fn commit(root: &Path) -> Option<String> {
    git(root, &["ls-files", "--error-unmatch", "protocol/words/build.rs"])?;
    let commit = git(root, &[&["rev-list", "-1", "HEAD", "--"], &DECIDING[..]].concat())?;
    Some(commit).filter(|commit| !commit.is_empty())
}

/// Returns whether a deciding file differs from the commit or is untracked.
fn has_changes(root: &Path) -> bool {
    let status = ["--no-optional-locks", "status", "--porcelain", "--"];
    git(root, &[&status, &DECIDING[..]].concat()).is_none_or(|changes| !changes.is_empty())
}

fn git(root: &Path, arguments: &[&str]) -> Option<String> {
    said(Command::new("git").arg("-C").arg(root).args(arguments))
}

/// Returns the output of a program, if it starts and succeeds.
fn said(program: &mut Command) -> Option<String> {
    let output = program.output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}

fn variable(name: &str) -> String {
    env::var(name).unwrap_or_default()
}

fn tell(name: &str, value: &str) {
    println!("cargo::rustc-env=GOALWARD_{name}={value}");
}
