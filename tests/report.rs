//! `goalward report` on a run: a self-contained page, its pictures, and tables with every update; and one line if there
//! is nothing to report on.
//!
//! Method: a small run of the real programs, whose log the test reads itself and compares.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::process::Output;

use mcap_log::{Contents, Record, read_contents};
use system_tests::{TestRun, programs};

fn report(run: &TestRun, arguments: &[&str]) -> Output {
    run.program("goalward").arg("report").args(arguments).output().unwrap()
}

#[test]
fn a_run_becomes_a_page() {
    let run = TestRun::new(programs!());
    let summary = run.finish(&[]);
    let Output { status, stdout, stderr } = report(&run, &[".", "--out", "web"]);
    assert!(status.success(), "{}", String::from_utf8_lossy(&stderr));
    assert_eq!(String::from_utf8(stdout).unwrap(), "web/index.html\n");
    let read = |name: &str| fs::read_to_string(run.path("web").join(name)).unwrap();

    let page = read("index.html");
    let hash = &summary.policy_sha256[..12];
    for part in ["goal-proximity", hash, "../run", "--steps 8000", "--set ppo.epochs=1"] {
        assert!(page.contains(part), "expected {part} in the page");
    }
    let outside = page.matches("http").count() - page.matches("http://www.w3.org/").count();
    assert_eq!(outside, 0, "the page names an address");
    let pictures = ["runs+navigation", "runs+navigation+time", "runs+navigation+proximity"];
    for name in pictures.into_iter().chain(["episode-navigation"]) {
        let picture = read(&format!("{name}.svg"));
        assert!(page.contains(&picture), "expected {name} in the page");
    }

    let updates = read_contents(&run.folder().log(), Contents::Updates).unwrap();
    let is_policy = |record: &Record| matches!(record, Record::PolicyUpdate(_));
    let updates = updates.filter(|entry| is_policy(&entry.as_ref().unwrap().record)).count();
    assert_eq!(read("results.csv").lines().count(), 1 + updates);
    let table = read("summary.csv");
    assert_eq!(table.lines().count(), 2);
    assert!(table.contains(&summary.policy_sha256), "{table}");
    let curves = read("curves.csv");
    let fields = curves.lines().map(|line| line.split(',').count()).collect::<Vec<_>>();
    assert!(fields.len() == 2 && fields[0] == fields[1], "{curves}");
}

#[test]
fn nothing_to_report_is_said_in_a_line() {
    let run = TestRun::new(programs!());
    run.finish(&["steps=800"]);
    let log = run.folder().log();
    fs::create_dir(run.path("empty")).unwrap();
    let plan = "title = 'A'\nseeds = [1]\nmethods = ['bc']\n\
                [[panel]]\nname = 'n'\ntitle = 'N'\ntask = 'navigation'\n";
    fs::write(run.path("plan.toml"), plan).unwrap();
    for (arguments, gone, part) in [
        (&["run", "empty"][..], None, "empty"),
        (&["run", "missing.toml"], None, "missing.toml"),
        (&["run", "--quick"], None, "--quick"),
        (&["run", "."], None, "expected each run once, found ./run again"),
        (&["plan.toml"], None, "navigation-bc-s1-"),
        (&["run"], Some("updates-00000.mcap"), "expected files"),
    ] {
        if let Some(file) = gone {
            fs::remove_file(log.join(file)).unwrap();
        }
        let Output { status, stdout, stderr } = report(&run, arguments);
        let said = String::from_utf8(stderr).unwrap();
        assert_eq!((status.code(), stdout.len()), (Some(2), 0), "{arguments:?}: {said}");
        assert!(said.lines().count() == 1 && said.contains(part), "{arguments:?}: {said}");
        assert!(!run.path("report").exists(), "{arguments:?}");
    }
}
