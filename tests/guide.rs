//! The guide and the README do what they say: their code blocks are run as a reader would run them.
//!
//! Method: every `sh` and `python` block of a page is run in order in one folder, with the programs first on the
//! path. An `sh,refused` block must end with exit code 2. A `text` block has lines that the block before it must
//! print, where `…` stands for anything. `pip install` lines are skipped. The tests need the packages of
//! `tests/requirements.txt`; `GOALWARD_PYTHON=none` skips them.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use system_tests::{TestRun, programs};

const REPOSITORY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// A code block of a page.
struct Block<'a> {
    info: &'a str,
    line: usize,
    text: String,
}

fn blocks(page: &str) -> Vec<Block<'_>> {
    let mut blocks: Vec<Block<'_>> = Vec::new();
    let mut is_inside = false;
    for (line, number) in page.lines().zip(1..) {
        match line.strip_prefix("```") {
            Some(_) if is_inside => is_inside = false,
            Some(info) => {
                is_inside = true;
                blocks.push(Block { info, line: number, text: String::new() });
            }
            None if is_inside => {
                let block = blocks.last_mut().unwrap();
                block.text = format!("{}{line}\n", block.text);
            }
            None => {}
        }
    }
    assert!(!is_inside, "a block is not closed");
    blocks
}

/// Whether a line matches a pattern, in which `…` stands for anything.
fn matches(pattern: &str, line: &str) -> bool {
    let mut rest = line;
    let parts: Vec<&str> = pattern.split('…').collect();
    let [first, between @ .., last] = &parts[..] else { return pattern == line };
    let Some(behind) = rest.strip_prefix(first) else { return false };
    rest = behind;
    for part in between {
        let Some((_, behind)) = rest.split_once(part) else { return false };
        rest = behind;
    }
    rest.ends_with(last)
}

/// Runs the shell line `begin`, then the blocks of a page after `change` has been applied to its text.
fn run(page: &str, change: impl Fn(String) -> String, begin: &str) {
    let Some(python) = system_tests::python() else { return };
    let home = TestRun::new(programs!());
    let text = change(fs::read_to_string(Path::new(REPOSITORY).join(page)).unwrap());
    let path = [
        home.path("bin").display().to_string(),
        Path::new(&python).parent().unwrap().display().to_string(),
        std::env::var("PATH").unwrap(),
    ];
    let call = |program: &str, arguments: &[&str]| {
        // Captures both outputs in the order in which they were written.
        let mut command = Command::new("bash");
        command.args(["-c", r#"exec "$@" 2>&1"#, "bash", program]).args(arguments);
        command.current_dir(home.path("")).stdin(Stdio::null()).env_remove("RUST_LOG");
        command.env("PATH", path.join(":")).env("GOALWARD_PYTHON", &python);
        command.env("PYTHONPATH", format!("{REPOSITORY}/python/src"));
        command.env("XDG_STATE_HOME", home.path("state"));
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let (begun, said) = call("bash", &["-euc", begin]);
    assert_eq!(begun, Some(0), "{begin}: {said}");
    let mut printed = String::new();
    for Block { info, line, text } in blocks(&text) {
        let expected = if info == "sh,refused" { 2 } else { 0 };
        let ended;
        match info {
            "sh" | "sh,refused" => {
                let lines = text.lines().filter(|line| !line.starts_with("pip install"));
                let script = lines.collect::<Vec<_>>().join("\n");
                (ended, printed) = call("bash", &["-euc", &script]);
            }
            "python" => (ended, printed) = call(&python, &["-c", &text]),
            "text" => {
                let is_printed = |wanted: &&str| {
                    printed.lines().any(|line| matches(wanted.trim_end(), line.trim_end()))
                };
                let missing = text.lines().find(|wanted| !is_printed(wanted));
                assert_eq!(missing, None, "{page}, line {line}: found\n{printed}");
                continue;
            }
            _ => continue,
        }
        assert_eq!(ended, Some(expected), "{page}, line {line}:\n{text}\n{printed}");
    }
}

/// Defines a test for each chapter of the guide.
macro_rules! chapter {
    ($($name:ident, $file:literal;)*) => {
        $(
            #[test]
            fn $name() {
                run(concat!("docs/guide/src/", $file, ".md"), |text| text, "true");
            }
        )*
    };
}

chapter! {
    a_first_run, "first-run";
    curves, "curves";
    environments, "environments";
    demonstrations, "demonstrations";
    methods, "methods";
    experiments, "experiments";
    logs, "logs";
    viewers, "viewers";
    troubleshooting, "troubleshooting";
}

#[test]
fn every_chapter_is_run() {
    let summary = fs::read_to_string(format!("{REPOSITORY}/docs/guide/src/SUMMARY.md")).unwrap();
    let tests = include_str!("guide.rs");
    for chapter in summary.split("](").skip(1).filter_map(|rest| rest.split_once(".md")) {
        let name = chapter.0.trim_start_matches("./");
        let file = format!("{REPOSITORY}/docs/guide/src/{name}.md");
        let has_blocks = fs::read_to_string(file).unwrap().contains("```sh");
        assert!(!has_blocks || tests.contains(&format!("\"{name}\";")), "{name} has no test");
    }
}

#[test]
fn the_readme() {
    // Its own steps and network width take minutes. With these settings the expert still reaches the goal.
    let shorter = "--steps 60000 --set policy.hidden=[32,32]";
    let shortened = |text: String| text.replace("--steps 150000", shorter);
    // Stands in for the run that the README's first command makes.
    let begin = "goalward train fetch-push --steps 4000 --set demonstrations.episodes=40 \
                 --run runs/navigation-0001";
    run("README.md", shortened, begin);
}

#[test]
fn dots_stand_for_anything() {
    for (pattern, line, expected) in [
        ("as it is", "as it is", true),
        ("as it is", "as it is not", false),
        ("training …: preset…", "training navigation in r: preset goalward", true),
        ("…steps", "20,000 steps", true),
        ("a…b…c", "a then b then c", true),
        ("a…b…c", "a then c then b", false),
    ] {
        assert_eq!(matches(pattern, line), expected, "{pattern}: {line}");
    }
}
