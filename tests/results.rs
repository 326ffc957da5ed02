//! Tables and numbers of the results pages match the data next to them.
//!
//! Method: the script that writes them finds nothing to change in the repository, and reports copies in which a
//! number of a table, a sentence, a run or a plan is changed. It agrees with `goalward experiment` on which curves
//! share runs, and its statistics agree with the libraries `rliable` and SciPy. The tests need an interpreter with
//! the packages of `tests/requirements.txt` in `GOALWARD_PYTHON`; `GOALWARD_PYTHON=none` skips them.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use system_tests::{TestRun, programs};
use tempfile::TempDir;

const REPOSITORY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// Files of the repository that the script needs; [`FOLDERS`] has whole folders.
const FILES: [&str; 24] = [
    "README.md",
    "docs/guide/src/environments.md",
    "docs/guide/src/methods.md",
    "docs/results/README.md",
    "docs/results/ablations.md",
    "docs/results/rebuild.py",
    "docs/results/quoted.py",
    "docs/results/tables.py",
    "docs/results/cells.py",
    "docs/results/pivots.py",
    "docs/results/pivots.toml",
    "docs/results/quoted.toml",
    "docs/results/estimates.py",
    "docs/results/data.py",
    "docs/results/settings.py",
    "deploy/methods.toml",
    "protocol/run/src/config/defaults.toml",
    "docs/results/runs.csv",
    "docs/results/points.csv",
    "docs/results/replays.csv",
    "docs/results/settings.csv",
    "docs/results/uncertainty.csv",
    "docs/results/random_policy.csv",
    "docs/results/mujoco_evaluations.csv",
];
const PLANS: &str = "deploy/experiments";
const FOLDERS: [&str; 2] = [PLANS, "deploy/tasks"];

/// Runs Python with some arguments in the results folder.
fn python(root: &Path, arguments: &[&str]) -> Option<Output> {
    let python = system_tests::python()?;
    let folder = root.join("docs/results");
    Some(Command::new(python).current_dir(folder).args(arguments).output().unwrap())
}

/// Runs the script in a repository; returns whether it succeeded, and what it printed.
fn rebuilt(root: &Path, arguments: &[&str]) -> Option<(bool, String)> {
    let arguments: Vec<&str> = ["rebuild.py"].iter().chain(arguments).copied().collect();
    let Output { status, stderr, .. } = python(root, &arguments)?;
    Some((status.success(), String::from_utf8(stderr).unwrap()))
}

/// Copies everything that the script reads.
fn copied() -> TempDir {
    let copy = tempfile::tempdir().unwrap();
    let inside = FOLDERS.into_iter().flat_map(|folder| {
        let entries = fs::read_dir(Path::new(REPOSITORY).join(folder)).unwrap();
        entries.map(move |entry| Path::new(folder).join(entry.unwrap().file_name()))
    });
    for name in FILES.iter().map(PathBuf::from).chain(inside) {
        let target = copy.path().join(&name);
        fs::create_dir_all(target.parent().unwrap()).unwrap();
        fs::copy(Path::new(REPOSITORY).join(name), target).unwrap();
    }
    copy
}

#[test]
fn tables_and_data_do_not_differ() {
    let Some((well, said)) = rebuilt(Path::new(REPOSITORY), &["--check"]) else { return };
    assert!(well && said.is_empty(), "{said}");
}

/// Returns what the script prints for a copy in which `text` in a file is replaced with `other`.
fn said_of_a_change(file: &str, text: &str, other: &str) -> Option<String> {
    let copy = copied();
    let changed = copy.path().join(file);
    let before = fs::read_to_string(&changed).unwrap();
    assert!(before.contains(text), "{file} has no {text}");
    fs::write(&changed, before.replacen(text, other, 1)).unwrap();
    let (well, said) = rebuilt(copy.path(), &["--check"])?;
    assert!(!well, "{file} with {other} for {text}");
    Some(said)
}

#[test]
fn a_number_that_is_another_is_found() {
    let run = "no-online,,602941,101,0.39,0.";
    for (page, file, number, other) in [
        ("README.md", "docs/results/README.md", "| **", "| **1"),
        ("README.md", "docs/results/README.md", " % (", " % (1"),
        ("README.md", "docs/results/runs.csv", ",500,0.", ",500,0.1"),
        ("README.md", "deploy/experiments/figure3.toml", "gaifo = 0.", "gaifo = 0.5"),
        ("ablations.md", "docs/results/settings.csv", run, &format!("{run}1")),
    ] {
        let Some(said) = said_of_a_change(file, number, other) else { return };
        let expected = format!("docs/results/{page}: expected the tables");
        assert!(said.contains(&expected), "{file}: {said}");
    }
}

#[test]
fn what_has_no_runs_or_no_end_is_named() {
    let lambda = "settings = \"reward.uncertainty=1.0\"";
    let run = "fetch-push,no-online,reward.uncertainty=0.3,602880,101,";
    for (file, text, other, expected) in [
        (
            "pivots.toml",
            lambda,
            "settings = \"reward.uncertainty=7.0\"",
            "pivots.toml: expected runs of without-online-lambda.rows.1, found none",
        ),
        (
            "settings.csv",
            run,
            "fetch-push,no-online,reward.uncertainty=0.1,602880,101,",
            "settings.csv: expected one evaluation_success_rate for each seed, found 4 for 101",
        ),
        (
            "ablations.md",
            "number: paired members/push/prior-1 default",
            "number: paired members/push/prior-1 prior-3",
            "expected the seeds 101 102 103 104 105 106, found 101 102 103",
        ),
        (
            "ablations.md",
            "number: paired members/push/prior-1 default",
            "number: points members/pick/prior-1 default",
            "expected finished runs of members/pick/prior-1, found none",
        ),
        (
            "ablations.md",
            "number: paired members/push/prior-1 default",
            "number: points members/push/shared-0_1 default",
            "expected at least 3 seeds to compare, found 2 and 6",
        ),
        (
            "README.md",
            "number: seeds squared-errors/success/bc",
            "number: seeds squared-errors/success/bc@7",
            "expected finished runs of squared-errors/success/bc@7, found those of seeds 1 2 3 4 5",
        ),
        (
            "README.md",
            "Not everything is trained yet.",
            "GAIL reaches 98.5 and 96.8 %.",
            "expected `<!-- number: KIND CURVE... -->` before each rate, found 98.5 and 96.8 %",
        ),
        (
            "README.md",
            "<!-- end of table -->",
            "",
            "README.md: expected `<!-- end of table -->` for each `<!-- table`, found",
        ),
    ] {
        let file = format!("docs/results/{file}");
        let Some(said) = said_of_a_change(&file, text, other) else { return };
        assert!(said.contains(expected), "{file}: {said}");
    }
}

#[test]
fn seeds_are_paired_by_their_numbers_whatever_the_order_of_the_rows() {
    let copy = copied();
    let rows = copy.path().join("docs/results/settings.csv");
    let text = fs::read_to_string(&rows).unwrap();
    let (head, runs) = text.split_once('\n').unwrap();
    let runs: Vec<&str> = runs.lines().rev().collect();
    fs::write(&rows, format!("{head}\n{}\n", runs.join("\n"))).unwrap();
    let Some((well, said)) = rebuilt(copy.path(), &[]) else { return };
    assert!(well, "{said}");
    for page in ["README.md", "ablations.md"] {
        let paired = |root: &Path| {
            let text = fs::read_to_string(root.join("docs/results").join(page)).unwrap();
            let numbers = text.split("<!-- number: paired ").skip(1);
            numbers.map(|number| number.split_once("<!-- end").unwrap().0.to_owned()).collect()
        };
        let numbers: Vec<String> = paired(copy.path());
        assert!(!numbers.is_empty());
        assert_eq!(numbers, paired(Path::new(REPOSITORY)), "{page}");
    }
}

#[test]
fn curves_share_runs_as_in_an_experiment() {
    let count = "
from data import plans
from tables import runs_of
print(len(set().union(*map(runs_of, plans().values()))))
";
    let Some(counted) = python(Path::new(REPOSITORY), &["-c", count]) else { return };
    let counted = String::from_utf8(counted.stdout).unwrap();
    let test = TestRun::new(programs!());
    let plans = fs::read_dir(Path::new(REPOSITORY).join(PLANS)).unwrap();
    let plans: Vec<PathBuf> = plans.map(|plan| plan.unwrap().path()).collect();
    let planned = plans.iter().map(|plan| plan.to_str().unwrap());
    let arguments: Vec<&str> = ["experiment", "--dry-run"].into_iter().chain(planned).collect();
    let (well, said) = test.goalward(&arguments);
    let expected = format!("0 of {} runs are finished", counted.trim());
    assert!(well && said.contains(&expected), "expected {expected}, found {said}");
}

#[test]
fn a_report_takes_the_places_of_its_finished_runs_alone() {
    let copy = copied();
    let data = copy.path().join("docs/results");
    let [runs, points] =
        ["runs.csv", "points.csv"].map(|name| fs::read_to_string(data.join(name)).unwrap());
    let lines: Vec<&str> = runs.lines().collect();
    let finished = lines[1].replace(",500,0.", ",500,0.1");
    let last = *lines.last().unwrap();
    let unfinished = last.replace(",goalward,1,", ",goalward,0,");
    assert!(finished != lines[1] && unfinished != last, "{}\n{last}", lines[1]);
    let report = copy.path().join("report");
    fs::create_dir(&report).unwrap();
    let summary = [lines[0], unfinished.as_str(), finished.as_str()].join("\n");
    fs::write(report.join("summary.csv"), summary).unwrap();
    // The report has only the last of the first run's twenty points.
    let (head, rows) = points.split_once('\n').unwrap();
    let kept = rows.splitn(20, '\n').last().unwrap();
    let point = kept.lines().next().unwrap();
    fs::write(report.join("results.csv"), format!("{head}\n{point}\n")).unwrap();
    let Some((well, said)) = rebuilt(copy.path(), &["--from", report.to_str().unwrap()]) else {
        return;
    };
    assert!(well && said.is_empty(), "{said}");
    let read = |name: &str| fs::read_to_string(data.join(name)).unwrap();
    assert_eq!(read("runs.csv"), runs.replacen(lines[1], &finished, 1));
    assert_eq!(read("points.csv"), format!("{head}\n{kept}"));
}

#[test]
fn a_report_of_short_runs_takes_no_places() {
    let copy = copied();
    let data = copy.path().join("docs/results");
    let runs = fs::read_to_string(data.join("runs.csv")).unwrap();
    let lines: Vec<&str> = runs.lines().collect();
    let short = lines[1].replace(",500,0.", ",50,0.");
    assert_ne!(short, lines[1]);
    let report = copy.path().join("report");
    fs::create_dir(&report).unwrap();
    fs::write(report.join("summary.csv"), [lines[0], short.as_str()].join("\n")).unwrap();
    let Some((well, said)) = rebuilt(copy.path(), &["--from", report.to_str().unwrap()]) else {
        return;
    };
    assert!(
        !well && said.ends_with("expected an evaluation of 500 episodes, found 50\n"),
        "{said}"
    );
    assert_eq!(fs::read_to_string(data.join("runs.csv")).unwrap(), runs);
}

/// The expected values are those of rliable 1.2.0 for the same scores: `aggregate_iqm` and
/// `probability_of_improvement` with `get_interval_estimates`, whose bootstrap draws differ, hence the tolerances.
#[test]
fn statistics_over_panels_are_those_of_rliable() {
    let program = "
from estimates import improvement, interquartile_mean
ours = [[.99, .985, .995, .97, .985], [.95, .95, .92, .93, .95], [.95, .94, .94, .965, .965], [.67, .7, .62, .55, .71]]
other = [[.38, .42, .33, .4, .36], [.8, .95, .84, .78, .96], [.87, .61, .95, .89, .97], [.13, .24, .15, .66, .2]]
print(*interquartile_mean(ours), *interquartile_mean(other), *improvement(other, ours))
";
    let Some(output) = python(Path::new(REPOSITORY), &["-c", program]) else { return };
    let said = String::from_utf8(output.stdout).unwrap();
    let found: Vec<f64> = said.split_whitespace().map(|word| word.parse().unwrap()).collect();
    let expected = [0.946, 0.9385, 0.953, 0.612, 0.542, 0.689, 0.18, 0.05, 0.325];
    let tolerances = [1e-9, 0.002, 0.002, 1e-9, 0.01, 0.01, 1e-9, 0.02, 0.02];
    assert_eq!(found.len(), expected.len(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    for ((found, expected), tolerance) in found.iter().zip(expected).zip(tolerances) {
        assert!((found - expected).abs() < tolerance, "{found} against {expected} in {said}");
    }
}

/// The references are SciPy's `ttest_ind` with unequal variances and `ttest_rel`.
#[test]
fn intervals_of_differences_are_those_of_scipy() {
    let program = "
from estimates import gain, paired_gain
from scipy.stats import ttest_ind, ttest_rel
own, others = [.97, .91, .99, .96, .98], [.92, .81, .98, .79, .86]
print(*gain(own, others)[1:], *paired_gain(own, others)[1:])
print(*ttest_ind(own, others, equal_var=False).confidence_interval(), *ttest_rel(own, others).confidence_interval())
";
    let Some(output) = python(Path::new(REPOSITORY), &["-c", program]) else { return };
    let said = String::from_utf8(output.stdout).unwrap();
    let numbers: Vec<f64> = said.split_whitespace().map(|word| word.parse().unwrap()).collect();
    assert_eq!(numbers.len(), 8, "{said}{}", String::from_utf8_lossy(&output.stderr));
    let (ours, scipy) = numbers.split_at(4);
    for (found, expected) in ours.iter().zip(scipy) {
        assert!((found - expected).abs() < 1e-12, "{said}");
    }
}

#[test]
fn what_is_no_run_is_not_replayed() {
    let arguments = ["replays.py", "goalward", "/nowhere"];
    let Some(output) = python(Path::new(REPOSITORY), &arguments) else { return };
    let said = String::from_utf8(output.stderr).unwrap();
    let expected = "/nowhere: expected the folder of a finished run, found no summary.json there\n";
    assert_eq!((output.status.code(), said.as_str()), (Some(1), expected));
}
