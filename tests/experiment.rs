//! An experiment trains exactly the runs that are missing, and they equal those that `goalward train` makes.
//!
//! Method: a plan of two methods and two seeds, two runs at a time. It is stopped as soon as one run has a
//! checkpoint, continued, and called once more when everything is finished. One of its runs must then have the
//! hashes of the same run trained alone, with other numbers of actors and threads and with its own demonstrations.
//! A summary of another build counts only when asked for. Finally a run is spoilt: it is named, and the others are
//! trained.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

use run::folder::RunFolder;
use system_tests::{
    PATIENCE, SMALL, Signal, Summary, TestRun, await_some, programs, read_by, send,
};

/// Writes a plan and returns the command that carries it out.
fn experiment(test: &TestRun) -> Command {
    let mut plan = "title = \"A test\"\nseeds = [1, 2]\n[[panel]]\nname = \"small\"\n\
                    title = \"Small\"\ntask = \"navigation\"\nmethods = []\n"
        .to_owned();
    for method in ["goal-proximity", "environment-reward"] {
        let settings: Vec<_> =
            read_by(method, &SMALL).iter().map(|setting| format!("{setting:?}")).collect();
        let settings = settings.join(", ");
        plan += &format!(
            "[[panel.curve]]\nname = {method:?}\nmethod = {method:?}\nset = [{settings}]\n"
        );
    }
    fs::write(test.path("plan.toml"), plan).unwrap();
    let mut command = test.program("goalward");
    command.args(["experiment", "plan.toml", "--out", "all", "--jobs", "2"]);
    command
}

/// Returns the run folders; method and seed are in their names.
fn folders(test: &TestRun) -> Vec<RunFolder> {
    let entries = fs::read_dir(test.path("all/runs")).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> =
        entries.map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
    paths.sort();
    paths.into_iter().map(RunFolder::new).collect()
}

fn text(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Makes a run look as if another build had finished it: it counts only if the user says so, and is kept apart.
fn count_other_builds_when_asked_to(test: &TestRun, folder: &RunFolder) {
    let before = fs::read(folder.summary_file()).unwrap();
    let mut summary = run::summary::Summary::of_run(folder).unwrap().unwrap();
    summary.builds[0].commit = "feedc0de0000".to_owned();
    summary.save(folder).unwrap();
    let output = experiment(test).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!((output.status.code(), said.lines().count()), (Some(2), 1), "{said}");
    for part in ["1 of 4", "commit feedc0de0000", "--other-build"] {
        assert!(said.contains(part), "expected {part} in {said}");
    }
    let said = text(&experiment(test).arg("--other-build").output().unwrap());
    assert!(said.contains("commit feedc0de0000") && said.matches("1 of 1").count() == 2, "{said}");
    fs::write(folder.summary_file(), before).unwrap();
}

#[test]
fn experiments_side_by_side_share_the_runs() {
    let test = TestRun::new(programs!());
    let mut commands = [(); 3].map(|()| experiment(&test));
    let begun = commands.each_mut().map(|one| one.stderr(Stdio::piped()).spawn().unwrap());
    for one in begun {
        let output = one.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && !said.contains("failed"), "{said}");
    }
    let said = text(&experiment(&test).output().unwrap());
    assert_eq!(said.matches("2 of 2").count(), 2, "{said}");
}

#[test]
fn what_is_missing_is_trained() {
    let test = TestRun::new(programs!());
    let begun = experiment(&test).stderr(Stdio::piped()).spawn().unwrap();
    let has_checkpoint = |folder: &RunFolder| folder.newest_checkpoint().is_some();
    await_some("a checkpoint", PATIENCE, || folders(&test).into_iter().find(has_checkpoint));
    send(begun.id(), Signal::Interrupt);
    let output = begun.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("stopped; continue with"), "{said}");
    assert!(folders(&test).iter().any(|folder| !folder.summary_file().exists()), "{said}");

    let said = text(&experiment(&test).output().unwrap());
    assert_eq!(said.matches("2 of 2").count(), 2, "{said}");
    let finished = folders(&test);
    assert_eq!(finished.len(), 4);
    let summaries = |folder: &RunFolder| fs::read(folder.summary_file()).unwrap();
    let before: Vec<_> = finished.iter().map(summaries).collect();

    let said = text(&experiment(&test).output().unwrap());
    assert!(said.contains("report plan.toml --experiments all"), "{said}");
    assert_eq!(finished.iter().map(summaries).collect::<Vec<_>>(), before, "trained again");

    count_other_builds_when_asked_to(&test, &finished[0]);

    let named = |part: &str| {
        finished.iter().position(|folder| folder.path().to_str().unwrap().contains(part)).unwrap()
    };
    let ours = named("navigation-goal-proximity-s2-");
    let summary: Summary = serde_json::from_slice(&before[ours]).unwrap();
    assert_eq!(summary.hashes(), test.finish(&["seed=2"]).hashes());

    // One run's folder has lost its configuration and summary, so it looks like somebody else's. A second run is
    // gone. A third one's summary is empty, as after a crash of the machine while it was written without a sync.
    let spoilt = &finished[named("navigation-environment-reward-s1-")];
    for file in [spoilt.summary_file(), spoilt.config_file()] {
        fs::remove_file(file).unwrap();
    }
    fs::remove_dir_all(finished[ours].path()).unwrap();
    let emptied = finished[named("navigation-goal-proximity-s1-")].summary_file();
    fs::write(&emptied, "").unwrap();
    let dry = text(&experiment(&test).arg("--dry-run").output().unwrap());
    assert!(dry.contains("0 of 2"), "{dry}");
    let output = experiment(&test).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("found files") && said.contains("1 of 4 runs failed"), "{said}");
    assert!(finished[ours].summary_file().exists(), "the other one is trained: {said}");
    assert!(said.contains("the run counts as unfinished"), "{said}");
    let expected: Summary =
        serde_json::from_slice(&before[named("navigation-goal-proximity-s1-")]).unwrap();
    let anew: Summary = serde_json::from_slice(&fs::read(&emptied).unwrap()).unwrap();
    assert_eq!(anew.hashes(), expected.hashes());
}

#[test]
fn runs_on_demonstrations_that_were_replaced_do_not_count() {
    let test = TestRun::new(programs!());
    let settings: Vec<_> = SMALL.iter().map(|setting| format!("{setting:?}")).collect();
    let plan = format!(
        "title = \"A test\"\nseeds = [1]\nset = [{}, \"demonstrations.file='mine.mcap'\"]\n[[panel]]\n\
         name = \"small\"\ntitle = \"Small\"\ntask = \"navigation\"\nmethods = [\"goal-proximity\"]\n",
        settings.join(", ")
    );
    fs::write(test.path("plan.toml"), plan).unwrap();
    let recorded = |seed: &str| {
        let mut command = test.program("goalward");
        command.args(["demonstrate", "navigation", "--episodes", "40", "--out", "mine.mcap"]);
        text(&command.args(["--coverage", "0.5", "--force", "--seed", seed]).output().unwrap());
    };
    let trained = || {
        let mut command = test.program("goalward");
        command.args(["experiment", "plan.toml", "--out", "all"]).output().unwrap()
    };
    recorded("1");
    assert!(text(&trained()).contains("1 of 1"));
    assert!(text(&trained()).contains("1 of 1"));
    recorded("2");
    let output = trained();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!((output.status.code(), said.lines().count()), (Some(2), 1), "{said}");
    assert!(
        said.contains("expected the demonstrations of navigation-goal-proximity-s1-"),
        "{said}"
    );
}

/// Mocks Slurm's `sbatch` as far as the command uses it: it starts all tasks of an array at once.
const SBATCH: &str = r#"#!/bin/sh
[ "$1 $2" = '--parsable --output' ] || exit 1
out=$(dirname "$3")
cat > "$out/script"
tasks=$(sed -n 's/^#SBATCH --array=1-//p' "$out/script")
for task in $(seq "$tasks"); do
    SLURM_ARRAY_JOB_ID=7 SLURM_ARRAY_TASK_ID=$task bash "$out/script" > "$out/slurm-7_$task.out" 2>&1 &
    echo $! >> "$out/tasks"
done
echo '7;cluster'
"#;

/// Mocks Slurm's `squeue`: it lists the running tasks.
const SQUEUE: &str = r#"#!/bin/sh
[ "$*" = '--noheader --jobs 7' ] || exit 1
for task in $(cat all/tasks); do
    kill -0 "$task" 2> /dev/null && echo "$task" || true
done
"#;

/// Mocks `kubectl` for a cluster that keeps what is applied, a Job that does not end.
const KUBECTL: &str = r#"#!/bin/sh
case "$*" in
    'delete job --ignore-not-found '*) ;;
    'apply --filename -') cat >> applied ;;
    'get job '*) [ -e applied ] || { echo 'Error from server (NotFound): jobs.batch not found' >&2; exit 1; } ;;
    *) exit 1 ;;
esac
"#;

/// Puts programs into a folder of the test; returns a path for the environment that finds them first.
fn programs_in(test: &TestRun, folder: &str, programs: &[(&str, &str)]) -> String {
    fs::create_dir(test.path(folder)).unwrap();
    for (name, text) in programs {
        let file = test.path(folder).join(name);
        fs::write(&file, text).unwrap();
        fs::set_permissions(&file, Permissions::from_mode(0o755)).unwrap();
    }
    format!("{}:/usr/bin:/bin", test.path(folder).display())
}

#[test]
fn a_job_is_submitted_to_kubernetes_only_where_there_is_none() {
    let test = TestRun::new(programs!());
    let path = programs_in(&test, "kubernetes", &[("kubectl", KUBECTL)]);
    let submit = |path: &str| {
        let mut command = experiment(&test);
        let output = command.args(["--on", "kubernetes"]).env("PATH", path).output().unwrap();
        String::from_utf8(output.stderr).unwrap()
    };
    let said = submit("/nowhere");
    assert!(said.contains("expected kubectl on the path"), "{said}");
    let said = submit(&path);
    assert!(said.contains("submitted as goalward-experiment-"), "{said}");
    let applied = || fs::read_to_string(test.path("applied")).unwrap();
    let once = applied();
    assert!(once.contains("kind: Job") && once.contains("kind: ConfigMap"), "{once}");
    let said = submit(&path);
    assert!(said.contains("is still there and is left as it is; runs missing: 4"), "{said}");
    assert_eq!(applied(), once);
}

#[test]
fn a_cluster_trains_what_is_missing() {
    let test = TestRun::new(programs!());
    let path = programs_in(&test, "slurm", &[("sbatch", SBATCH), ("squeue", SQUEUE)]);
    let output =
        experiment(&test).args(["--on", "slurm"]).env("PATH", "/nowhere").output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("expected sbatch on the path"), "{said}");
    let on_slurm = |flags: &[&str]| {
        let mut command = experiment(&test);
        command.args(["--on", "slurm", "--tasks", "2"]).args(flags).env("PATH", &path);
        command.output().unwrap()
    };
    let script = text(&on_slurm(&["--dry-run"]));
    assert!(script.starts_with("#!/usr/bin/env bash\n#SBATCH"), "{script}");
    assert!(!test.path("all/script").exists(), "a dry run submits nothing");
    let output = on_slurm(&["--watch"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("submitted as 7: runs: 4, tasks: 2"), "{said}");
    assert_eq!(text(&output).matches("2 of 2").count(), 2);
    assert_eq!(fs::read_to_string(test.path("all/script")).unwrap(), script);
    fs::remove_file(test.path("all/script")).unwrap();
    assert_eq!(text(&on_slurm(&["--watch"])).matches("2 of 2").count(), 2);
    assert!(!test.path("all/script").exists(), "nothing is missing");
}
