//! What the build script finds: in a checkout, in a worktree, with changes, in an unpacked archive, and without git.
//!
//! Method: `build.rs` is compiled and run as cargo runs it, on folders made for the test.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The compiled script, in a folder for checkouts.
struct Script {
    home: tempfile::TempDir,
}

/// What the script told the compiler.
#[derive(Debug, PartialEq)]
struct Told {
    commit: String,
    dirty: bool,
    /// Files that make it run again when they change.
    watched: Vec<String>,
}

fn succeeds(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{command:?}: {said}");
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

fn git(folder: &Path, arguments: &[&str]) -> String {
    let own = ["-c", "user.name=test", "-c", "user.email=test", "-c", "commit.gpgsign=false"];
    succeeds(Command::new("git").arg("-C").arg(folder).args(own).args(arguments))
}

impl Script {
    fn new() -> Script {
        let home = tempfile::tempdir().unwrap();
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("build.rs");
        let mut rustc = Command::new(std::env::var_os("RUSTC").unwrap_or("rustc".into()));
        succeeds(
            rustc.args(["--edition", "2024", "-o"]).arg(home.path().join("script")).arg(source),
        );
        Script { home }
    }

    /// Creates a folder with two deciding files and one that decides nothing.
    fn sources(&self, name: &str) -> PathBuf {
        let root = self.home.path().join(name);
        fs::create_dir_all(root.join("protocol/words/src")).unwrap();
        for file in ["protocol/words/build.rs", "protocol/words/src/lib.rs", "README.md"] {
            fs::write(root.join(file), "").unwrap();
        }
        root
    }

    fn run(&self, root: &Path, profile: &str, path: Option<&Path>) -> Told {
        let mut script = Command::new(self.home.path().join("script"));
        script.env("CARGO_MANIFEST_DIR", root.join("protocol/words")).env("PROFILE", profile);
        script.env("RUSTC", "rustc").env("CARGO_CFG_TARGET_FEATURE", "avx,fma");
        if let Some(path) = path {
            script.env("PATH", path);
        }
        let said = succeeds(&mut script);
        let told = |name: &str| {
            let start = format!("cargo::rustc-env=GOALWARD_{name}=");
            said.lines().find_map(|line| line.strip_prefix(&start)).unwrap().to_owned()
        };
        assert_eq!(told("TARGET_FEATURES"), "avx,fma");
        assert!(path.is_some() || told("RUSTC").starts_with("rustc 1."));
        let watched = said.lines().filter_map(|line| line.strip_prefix("cargo::rerun-if-changed="));
        Told {
            commit: told("COMMIT"),
            dirty: told("DIRTY") == "true",
            watched: watched.map(str::to_owned).collect(),
        }
    }
}

#[test]
fn a_checkout_has_a_commit_and_knows_its_changes() {
    let script = Script::new();
    let root = script.sources("checkout");
    git(&root, &["init", "--quiet"]);
    git(&root, &["add", "."]);
    git(&root, &["commit", "--quiet", "-m", "one"]);
    let first = git(&root, &["rev-parse", "HEAD"]);
    let told = script.run(&root, "release", None);
    assert_eq!((&told.commit, told.dirty), (&first, false));
    for part in [".git/HEAD", ".git/refs/heads/", "protocol/words/src"] {
        assert!(told.watched.iter().any(|path| path.contains(part)), "{part}: {:?}", told.watched);
    }

    // A file that decides nothing does not change the build, committed or not.
    fs::write(root.join("README.md"), "more").unwrap();
    assert!(!script.run(&root, "release", None).dirty);
    git(&root, &["commit", "--quiet", "-a", "-m", "two"]);
    assert_eq!(script.run(&root, "release", None).commit, first);

    let development = script.run(&root, "debug", None);
    assert_eq!((&development.commit, development.dirty), (&first, true));
    assert_eq!(development.watched, ["build.rs"]);

    let worktree = script.home.path().join("worktree");
    git(&root, &["worktree", "add", "--quiet", worktree.to_str().unwrap()]);
    let told = script.run(&worktree, "release", None);
    assert_eq!((&told.commit, told.dirty), (&first, false));
    let head = |path: &&String| path.ends_with("worktrees/worktree/HEAD");
    assert_eq!(told.watched.iter().filter(head).count(), 1, "{:?}", told.watched);

    for name in ["lib.rs", "new.rs"] {
        let file = root.join("protocol/words/src").join(name);
        fs::write(&file, "fn f() {}").unwrap();
        assert!(script.run(&root, "release", None).dirty, "{name}");
        git(&root, &["add", "."]);
        git(&root, &["commit", "--quiet", "-m", name]);
        let told = script.run(&root, "release", None);
        assert!(!told.dirty && told.commit == git(&root, &["rev-parse", "HEAD"]), "{told:?}");
    }
    // Without git, the commit is unknown and nothing fails.
    let told = script.run(&root, "release", Some(script.home.path()));
    assert_eq!((told.commit.as_str(), told.dirty), ("unknown", true));
}

#[test]
fn an_unpacked_archive_has_none_even_within_a_checkout() {
    let script = Script::new();
    let alone = script.sources("alone");
    let around = script.home.path().join("around");
    fs::create_dir_all(&around).unwrap();
    git(&around, &["init", "--quiet"]);
    fs::write(around.join("notes.txt"), "").unwrap();
    git(&around, &["add", "."]);
    git(&around, &["commit", "--quiet", "-m", "somebody else's"]);
    for root in [alone, script.sources("around/unpacked")] {
        let told = script.run(&root, "release", None);
        assert_eq!((told.commit.as_str(), told.dirty), ("unknown", true), "{root:?}");
    }
}
