//! Impossible requests are refused in one line, with the right exit code, and nothing is overwritten.
//!
//! Method: `goalward` is called with users' mistakes. Every refusal must have exit code 2 (1 if the machine is at
//! fault, not the user), print nothing on standard output, and say on standard error in a single line what was
//! expected or what was found. Afterwards the folder must hold the same bytes as before.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::path::Path;
use std::process::Command;

use bytes::Bytes;
use mcap_log::{FileWriter, Kind, Metadata, Topic};
use protocol::ending::Ending;
use protocol::trajectory::{Encoded, Source, Trajectory};
use system_tests::{SMALL, Signal, TestRun, programs};

/// Calls `goalward` and expects a refusal that names every one of `parts`.
fn refused(run: &TestRun, code: i32, arguments: &[&str], parts: &[&str]) {
    let mut command = run.program("goalward");
    command.args(arguments);
    refused_command(run, code, command, parts);
}

fn refused_command(run: &TestRun, code: i32, mut command: Command, parts: &[&str]) {
    let before = run.contents();
    let output = command.output().unwrap();
    let [said, printed] =
        [output.stderr, output.stdout].map(|bytes| String::from_utf8(bytes).unwrap());
    assert_eq!(output.status.code(), Some(code), "{command:?}: {said}{printed}");
    assert_eq!(printed, "", "{command:?}");
    assert_eq!(said.lines().count(), 1, "{command:?}: expected one line, found\n{said}");
    assert!(said.starts_with("goalward: "), "{said}");
    for part in parts {
        assert!(said.contains(part), "{command:?}: expected `{part}` in {said}");
    }
    assert!(run.contents() == before, "{command:?} changed a file");
}

#[test]
fn words_nobody_knows() {
    let run = TestRun::new(programs!());
    for (arguments, parts) in [
        (&["fly"][..], &["fly"][..]),
        (&["train", "chess"], &["chess", "navigation"]),
        (&["train", "--wings", "2"], &["--wings"]),
        (&["train", "--step", "2"], &["--step", "--steps"]),
        (&["train", "--preset", "magic"], &["magic", "paper"]),
        (&["train", "--method", "magic"], &["magic", "goal-proximity"]),
        (&["train", "--set", "ppo.wings=2"], &["wings"]),
        (&["train", "--set", "wings.clip=2"], &["wings"]),
        (&["train", "--set", "ppo.clip"], &["ppo.clip", "="]),
        (&["train", "--set", "ppo.clip=wide"], &["clip", "wide"]),
        (&["demonstrate", "chess", "--episodes", "1", "--out", "d.mcap"], &["chess"]),
        (&["status", "nowhere"], &["nowhere"]),
        (&["evaluate", "nowhere"], &["nowhere"]),
        (&["log", "info", "nowhere.mcap"], &["nowhere.mcap"]),
        (&["train", "--resume"], &["--run"]),
        (&["train", "--resume", "--run", "nowhere"], &["nowhere"]),
    ] {
        refused(&run, 2, arguments, parts);
    }
}

#[test]
fn impossible_numbers() {
    let run = TestRun::new(programs!());
    for (arguments, parts) in [
        (["--actors", "0"], ["actors", "0"]),
        (["--actors", "65"], ["actors", "65"]),
        (["--actors", "-1"], ["actors", "-1"]),
        (["--steps", "0"], ["steps", "0"]),
        (["--steps", "-5"], ["steps", "-5"]),
        (["--steps", "many"], ["steps", "many"]),
        (["--coverage", "0"], ["coverage", "0"]),
        (["--coverage", "-0.5"], ["coverage", "-0.5"]),
        (["--coverage", "1.5"], ["coverage", "1.5"]),
        (["--coverage", "nan"], ["coverage", "nan"]),
        (["--noise", "inf"], ["noise", "inf"]),
        (["--seed", "-1"], ["seed", "-1"]),
        (["--seed", "9223372036854775808"], ["seed", "9223372036854775808"]),
        (["--set", "ppo.learning_rate=nan"], ["ppo.learning_rate", "nan"]),
        (["--set", "ppo.gamma=1.01"], ["ppo.gamma", "1.01"]),
        (["--set", "rollout.lag=2"], ["rollout.lag", "2"]),
        (["--set", "reward.ensemble=0"], ["reward.ensemble", "0"]),
        (["--set", "demonstrations.episodes=0"], ["demonstrations.episodes", "0"]),
        (["--set", "preset=paper"], ["preset=paper", "--preset paper"]),
        (["--set", "policy.hidden=[8]"], ["policy.hidden", "left out"]),
        (["--set", "reward.delta=1.0"], ["reward.delta", "found 1"]),
        (["--set", "reward.experience=100"], ["reward.samples", "reward.experience = 100"]),
        (["--set", "reward.hidden=[1000000,1000000]"], ["not enough memory", "service"]),
        (["--set", "resources.learner_threads=100000"], ["learner_threads", "100000"]),
        (["--set", "ppo.epochs=1000000000"], ["would take too long", "rows"]),
        (["--set", "demonstrations.episodes=1000000000000"], ["not enough memory", "learner"]),
    ] {
        refused(&run, 2, &["train", arguments[0], arguments[1]], &parts);
    }
    let endless = ["demonstrate", "navigation", "--episodes", "1000000000000", "--out", "d.mcap"];
    refused(&run, 2, &endless, &["would take too long", "1.0e14"]);
    let out = ["--out", "d.mcap"];
    for (flag, number) in [("--episodes", "0"), ("--coverage", "0"), ("--coverage", "2")] {
        let mut arguments = vec!["demonstrate", "navigation", flag, number, out[0], out[1]];
        if flag != "--episodes" {
            arguments.extend(["--episodes", "1"]);
        }
        refused(&run, 2, &arguments, &[flag.trim_start_matches('-'), number]);
    }
}

#[test]
fn numbers_that_a_verb_does_not_take() {
    let run = TestRun::new(programs!());
    let negative = "expected a whole number that is not negative, found -1";
    for (arguments, said) in [
        (&["evaluate", "run", "--seed", "-1"][..], format!("--seed: {negative}")),
        (&["export", "run", "--checkpoint", "-1"], format!("--checkpoint: {negative}")),
        (&["evaluate", "run", "--episodes", "0"], "expected a whole number from 1, found 0".into()),
        (&["scale", "run", "--actors", "65"], "a whole number from 0 to 64, found 65".into()),
        (&["page", "--port", "-1"], "a whole number from 0 to 65535, found -1".into()),
    ] {
        refused(&run, 2, arguments, &[&said]);
    }
}

#[test]
fn a_python_without_the_package() {
    let run = TestRun::new(programs!());
    let mut command = run.program("goalward");
    // No Python, but it fails with a reason, as Python does where a module is missing.
    let other = command.get_program().to_owned();
    command.args(["demonstrations", "info", "d.mcap"]).env("GOALWARD_PYTHON", other);
    let parts = ["the Python package goalward", "unexpected argument '-c' found", "pip install"];
    refused_command(&run, 2, command, &parts);
}

#[test]
fn what_would_be_mistaken() {
    let run = TestRun::new(programs!());
    run.finish(&[]);
    refused(&run, 2, &["train", "--seed", "4", "--set", "seed=3"], &["--set seed=3", "seed=4"]);
    refused(&run, 2, &["train", "--run", "run/log/inner"], &["run/log/inner", "outside of runs"]);
    refused(&run, 2, &["report", "run", "./run", "--out", "r"], &["each run once", "./run"]);
    fs::write(run.path("file"), "").unwrap();
    refused(&run, 2, &["train", "--tensorboard", "file"], &["file"]);
    let recording = ["demonstrate", "fetch-push", "--episodes", "1", "--out", "d.mcap", "--set"];
    for (other, why) in [
        ("ppo.clip=0.1", "environment.KEY=VALUE"),
        ("demonstrations.episodes=3", "--episodes sets it"),
    ] {
        refused(&run, 2, &[&recording[..], &[other]].concat(), &[other, why]);
    }
}

/// Makes a demonstration of three steps with observations of this shape.
fn demonstration(shape: [u32; 2]) -> Trajectory {
    let cells = vec![0; 4 * (shape[0] * shape[1]) as usize];
    Trajectory {
        task: "navigation".to_owned(),
        source: Source::Demonstration as i32,
        steps: 3,
        observation_shape: shape.to_vec(),
        cells: Bytes::from(cells),
        discrete_actions: Bytes::from_static(&[0, 1, 2]),
        ending: Ending::GoalReached as i32,
        success: true,
        ..Trajectory::default()
    }
}

fn write(file: &Path, kind: Kind, task: &str, trajectory: Trajectory) {
    let metadata = Metadata::new(kind, task, 1);
    let mut writer = FileWriter::create(file, &metadata, &[Topic::Trajectory]).unwrap();
    writer.trajectory(&Encoded::encode(trajectory), 0).unwrap();
    writer.seal().unwrap();
}

/// Expects `goalward train --demonstrations FILE` to be refused with a line that names the file.
fn refused_file(run: &TestRun, file: &str, parts: &[&str]) {
    let arguments =
        ["train", "--set", "demonstrations.episodes=1", "--run", "run", "--demonstrations", file];
    let parts: Vec<_> = parts.iter().copied().chain([file]).collect();
    refused(run, 2, &arguments, &parts);
    assert!(!run.folder().path().exists());
}

#[test]
fn demonstrations_of_something_else() {
    let run = TestRun::new(programs!());
    let write = |name: &str, kind, task, trajectory| {
        write(&run.path(name), kind, task, trajectory);
    };
    write("log.mcap", Kind::Run, "navigation", demonstration([19, 19]));
    write("pick.mcap", Kind::Demonstrations, "fetch-pick", demonstration([19, 19]));
    write("small.mcap", Kind::Demonstrations, "navigation", demonstration([10, 10]));
    let wrong = Trajectory { task: "fetch-pick".to_owned(), ..demonstration([19, 19]) };
    write("mixed.mcap", Kind::Demonstrations, "navigation", wrong);
    fs::write(run.path("text.mcap"), "dear diary").unwrap();
    fs::write(run.path("empty.mcap"), "").unwrap();
    fs::create_dir(run.path("folder.mcap")).unwrap();

    refused_file(&run, "missing.mcap", &[]);
    refused_file(&run, "folder.mcap", &[]);
    refused_file(&run, "text.mcap", &[]);
    refused_file(&run, "empty.mcap", &[]);
    refused_file(&run, "log.mcap", &["expected demonstrations"]);
    refused_file(&run, "pick.mcap", &["navigation", "fetch-pick"]);
    refused_file(&run, "mixed.mcap", &["navigation", "fetch-pick"]);
    refused_file(&run, "small.mcap", &["observation shape", "[19, 19]", "[10, 10]"]);
}

#[test]
fn demonstrations_that_are_damaged_short_or_other_than_asked_for() {
    let run = TestRun::new(programs!());
    let recorded = ["demonstrate", "navigation", "--episodes", "20", "--out", "whole.mcap"];
    assert!(run.program("goalward").args(recorded).output().unwrap().status.success());
    let whole = fs::read(run.path("whole.mcap")).unwrap();
    let half = &whole[..whole.len() / 2];
    fs::write(run.path("cut.mcap"), half).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 0x10;
    fs::write(run.path("flipped.mcap"), flipped).unwrap();

    refused_file(&run, "cut.mcap", &["log repair"]);
    refused_file(&run, "flipped.mcap", &["damaged", "log repair"]);
    let wanted = ["train", "--demonstrations", "whole.mcap", "--set", "demonstrations.episodes=21"];
    refused(&run, 2, &wanted, &["whole.mcap", "21", "20"]);
    let wanted = ["train", "--demonstrations", "whole.mcap", "--coverage", "0.25"];
    refused(&run, 2, &wanted, &["whole.mcap", "coverage = 0.25", "recorded with 1"]);
    refused(&run, 2, &recorded, &["whole.mcap", "not overwritten"]);
}

/// The number of steps in demonstrations is known only once they are recorded, so this refusal comes afterwards.
#[test]
fn recorded_demonstrations_that_make_no_batch() {
    let run = TestRun::new(programs!());
    let one = ["demonstrations.episodes=1", "reward.batch=101", "reward.samples=101"];
    assert_eq!(run.train(&one).end(), Some(2));
    let remarks = run.remarks();
    let said = remarks.lines().last().unwrap();
    for part in ["goalward: demonstrations ", "reward.batch = 101", "in 1 demonstrations"] {
        assert!(said.contains(part), "expected `{part}` in {said}");
    }
}

#[test]
fn folders_that_are_taken() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(4);
    // While it trains, its files change, so only the output is checked.
    for arguments in [["train", "--run", "run"].as_slice(), &["train", "--resume", "--run", "run"]]
    {
        let output = run.program("goalward").args(arguments).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), said.lines().count()), (Some(2), 1), "{said}");
    }
    training.finish();

    refused(&run, 2, &["train", "--run", "run"], &["run already holds a run", "--resume"]);
    let changed = ["train", "--resume", "--run", "run", "--set", "ppo.clip=0.3"];
    refused(&run, 2, &changed, &["ppo.clip=0.3 would change the result"]);
    let changed = ["train", "--resume", "--run", "run", "--seed", "2"];
    refused(&run, 2, &changed, &["seed=2 would change the result"]);
    let changed = ["train", "--resume", "--run", "run", "--preset", "paper"];
    refused(&run, 2, &changed, &["another preset would change the result"]);

    fs::create_dir(run.path("letters")).unwrap();
    fs::write(run.path("letters/thesis.txt"), "dear").unwrap();
    refused(&run, 2, &["train", "--run", "letters"], &["letters", "found files"]);
    refused(&run, 2, &["train", "--run", "letters/thesis.txt"], &["thesis.txt"]);
}

#[test]
fn a_configuration_edited_since_the_run_began() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["steps=4000000"]);
    training.await_checkpoint(4);
    training.signal(Signal::Interrupt);
    training.end();
    let file = run.folder().config_file();
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace("gamma = 0.99", "gamma = 0.98")).unwrap();
    let folder = run.folder().path().display().to_string();
    let parts = ["config.toml", "ppo.gamma = 0.99", "found 0.98"];
    refused(&run, 2, &["train", "--resume", "--run", &folder], &parts);
}

/// Expects a run to be refused if `folder` has one MiB of room. This happens in a mount namespace of its own, so that
/// it affects nobody else. If the system allows no namespace, the test is skipped and says so.
fn refused_without_room(folder: &str, parts: &[&str]) {
    let run = TestRun::new(programs!());
    let alone = ["--user", "--map-root-user", "--mount"];
    let mut attempt = Command::new("unshare");
    attempt.args(alone).args(["mount", "-t", "tmpfs", "narrow", "/mnt"]);
    if !attempt.output().is_ok_and(|output| output.status.success()) {
        let mut stderr = std::io::stderr();
        std::io::Write::write_all(&mut stderr, b"left out: this needs a mount namespace\n").ok();
        return;
    }
    fs::create_dir_all(run.path("narrow")).unwrap();
    let line = format!(
        "mount -t tmpfs -o size=1m narrow {folder} && exec bin/goalward train --run narrow/run \"$@\""
    );
    let mut command = Command::new("unshare");
    command.args(alone).args(["sh", "-c", &line, "sh"]).current_dir(run.path(""));
    for setting in SMALL {
        command.args(["--set", setting]);
    }
    refused_command(&run, 1, command, parts);
}

#[test]
fn plans_that_cannot_be_carried_out() {
    let run = TestRun::new(programs!());
    let plan = |methods: &str| {
        format!(
            "title = \"A test\"\nseeds = [1]\nmethods = [\"{methods}\"]\n[[panel]]\n\
             name = \"half\"\ntitle = \"Half\"\ntask = \"navigation\"\n"
        )
    };
    fs::write(run.path("magic.toml"), plan("magic")).unwrap();
    fs::write(run.path("cut.toml"), &plan("bc")[..20]).unwrap();
    refused(&run, 2, &["experiment", "magic.toml"], &["magic.toml", "panel half", "curve magic"]);
    refused(&run, 2, &["experiment", "cut.toml"], &["cut.toml, line 2"]);
    refused(&run, 2, &["experiment", "nowhere.toml", "--quick"], &["nowhere.toml"]);
    refused(&run, 2, &["experiment"], &["PLAN.toml"]);
}

#[test]
fn a_full_disk() {
    refused_without_room("narrow", &["no room on the disk", "narrow"]);
}

#[test]
fn no_room_in_shared_memory() {
    refused_without_room("/dev/shm", &["/dev/shm"]);
}
