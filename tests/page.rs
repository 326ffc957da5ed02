//! The live page's answers: to browsers on this machine, to strangers, and about runs that were damaged or removed.
//!
//! Method: `goalward page` serves a real run while it trains and afterwards. Requests are written as the bytes that
//! a browser would send.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs::{self, Permissions};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::process::{Child, Stdio};

use mcap_log::{Contents, log_files};
use serde_json::Value;
use system_tests::{Page, SMALL, Signal, TestRun, programs, send};

#[test]
fn a_run_is_shown_while_it_trains_and_afterwards() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["steps=40000"]);
    training.await_checkpoint(4);
    let page = Page::over(&run, &["."]);

    // Changes are pushed: first the list, then rising step counts.
    let events = page.send(&page.question("GET", "/api/events", page.address()));
    let lists = BufReader::new(events).lines().map(Result::unwrap);
    let mut lists = lists.filter_map(|line| {
        let list: Value = serde_json::from_str(line.strip_prefix("data: ")?).ok()?;
        list["runs"][0]["environment_steps"].as_u64()
    });
    let first = lists.next().unwrap();
    assert!(lists.next().unwrap() > first);

    let listed = page.json("/api/runs");
    assert_eq!(listed["runs"][0]["id"], "run");
    assert_eq!(listed["runs"][0]["state"], "training");
    let so_far = page.json("/api/runs/run/updates")["next"].as_u64().unwrap();
    assert!(so_far > 0);

    assert_eq!(training.end(), Some(0));
    let updates = page.json("/api/runs/run/updates");
    let place = |name: &str| {
        let columns = updates["columns"].as_array().unwrap();
        columns.iter().position(|column| column == name).unwrap()
    };
    let rows = updates["rows"].as_array().unwrap();
    assert!(rows.len() as u64 > so_far && rows.len() as u64 == updates["next"].as_u64().unwrap());
    let iterations = rows.iter().map(|row| row[place("iteration")].as_f64().unwrap() as usize);
    assert!(iterations.eq(0..rows.len()));
    assert!(rows.iter().all(|row| row[place("agent_loss")].is_number()));
    let later = page.json(&format!("/api/runs/run/updates?from={so_far}"));
    assert_eq!(later["rows"].as_array().unwrap()[..], rows[so_far as usize..]);
    assert_eq!(page.json("/api/runs/run/updates?from=99999")["rows"], Value::Array(Vec::new()));

    let details = page.json("/api/runs/run");
    assert_eq!(details["run"]["state"], "finished");
    assert!(details["summary"]["policy_sha256"].is_string());
    assert!(details["command"].as_str().unwrap().starts_with("goalward train navigation"));
    let differs =
        |key: &str| details["differences"].as_array().unwrap().iter().any(|d| d["key"] == key);
    assert!(differs("rollout.lanes") && !differs("seed"));
    let names = details["curve"].as_array().unwrap().len();
    assert_eq!(names, 2, "by its demonstrations, and as those of its own seed");
    let (status, body) = page.get("/");
    assert!(status == 200 && body.contains("<!doctype html>"), "{body}");
}

/// Starts training as users do; returns it and the page that its first line names.
fn train_with_page(run: &TestRun, settings: &[&str]) -> (Child, Page) {
    let mut command = run.program("goalward");
    command.args(["train", "navigation", "--run", "run"]).stderr(Stdio::piped());
    command.env("XDG_STATE_HOME", run.path("state"));
    for setting in [&SMALL[..], settings].concat() {
        command.args(["--set", setting]);
    }
    let mut training = command.spawn().unwrap();
    let mut line = String::new();
    BufReader::new(training.stderr.as_mut().unwrap()).read_line(&mut line).unwrap();
    let (_, url) = line.trim().split_once("; ").unwrap();
    (training, Page::at(url.strip_suffix("#/run/run").unwrap()))
}

#[test]
fn a_training_serves_a_page_that_may_die() {
    let run = TestRun::new(programs!());
    let (mut training, page) = train_with_page(&run, &[]);
    assert_eq!(page.json("/api/runs")["runs"][0]["id"], "run");
    let id = training.id();
    let children = fs::read_to_string(format!("/proc/{id}/task/{id}/children")).unwrap();
    let serves = |child: &&str| {
        let command = fs::read_to_string(format!("/proc/{child}/cmdline")).unwrap();
        command.contains("--beside-training")
    };
    let server = children.split_whitespace().find(serves).unwrap();
    send(server.parse().unwrap(), Signal::Kill);
    assert!(training.wait().unwrap().success());
    let disturbed = run.summary().hashes();

    fs::remove_dir_all(run.path("run")).unwrap();
    let (mut training, page) = train_with_page(&run, &[]);
    assert!(training.wait().unwrap().success());
    assert_eq!(run.summary().hashes(), disturbed);
    assert!(!page.is_there(), "it ends with the training");
}

#[test]
fn whoever_watches_a_training_sees_how_it_ends() {
    let run = TestRun::new(programs!());
    let (mut training, page) = train_with_page(&run, &[]);
    assert!(states(&page).any(|state| state == "finished"));
    assert!(page.json("/api/runs/run")["summary"]["policy_sha256"].is_string());
    assert!(training.wait().unwrap().success());
    assert!(!page.is_there(), "it ends with the training");
}

#[test]
fn whoever_watches_a_training_sees_that_it_was_stopped() {
    let run = TestRun::new(programs!());
    let (mut training, page) = train_with_page(&run, &["steps=10000000"]);
    let mut states = states(&page);
    assert!(states.any(|state| state == "training"));
    send(training.id(), Signal::Interrupt);
    assert!(states.any(|state| state == "stopped"));
    assert_eq!(training.wait().unwrap().code(), Some(130));
}

/// Returns the states of a page's only run, as its lists have them.
fn states(page: &Page) -> impl Iterator<Item = String> {
    let events = page.send(&page.question("GET", "/api/events", page.address()));
    BufReader::new(events).lines().map_while(Result::ok).filter_map(|line| {
        let list: Value = serde_json::from_str(line.strip_prefix("data: ")?).ok()?;
        Some(list["runs"][0]["state"].as_str()?.to_owned())
    })
}

#[test]
fn what_is_not_there_costs_a_line() {
    let run = TestRun::new(programs!());
    run.train(&[]).finish();
    let page = Page::over(&run, &["."]);
    for path in
        ["/api/runs/other", "/api/runs/..", "/api/runs/..%2f..%2fetc", "/api/runs/%2e%2e/updates"]
    {
        page.refusal(404, &page.question("GET", path, page.address()));
    }
    let (status, _) = page.get("/..%2f..%2fetc%2fpasswd");
    assert_eq!(status, 404);
    let (status, _) = page.answer(&page.question("POST", "/api/runs", page.address()));
    assert_eq!(status, 405);

    // A link to a run elsewhere does not count as a run of this folder.
    let elsewhere = run.path("").parent().unwrap().join("elsewhere-of-the-page");
    fs::create_dir_all(&elsewhere).unwrap();
    fs::copy(run.path("run/config.toml"), elsewhere.join("config.toml")).unwrap();
    std::os::unix::fs::symlink(&elsewhere, run.path("linked")).unwrap();
    assert_eq!(page.json("/api/runs")["runs"].as_array().unwrap().len(), 1);
    fs::remove_dir_all(&elsewhere).unwrap();

    // A log file without its end.
    let files = log_files(&run.path("run/log")).unwrap();
    let updates = files.into_iter().find(|file| file.contents == Contents::Updates).unwrap().path;
    let bytes = fs::read(&updates).unwrap();
    fs::write(&updates, &bytes[..bytes.len() / 2]).unwrap();
    let trouble = page.json("/api/runs/run")["trouble"].to_string();
    assert!(trouble.contains("cut off"), "{trouble}");
    fs::write(&updates, [0; 100]).unwrap();
    let trouble = page.json("/api/runs/run")["trouble"].to_string();
    assert!(trouble.contains("MCAP"), "{trouble}");

    // An invalid configuration, then a run that is removed.
    fs::write(run.path("run/config.toml"), "what?").unwrap();
    let listed = page.json("/api/runs");
    assert_eq!(listed["runs"], Value::Array(Vec::new()));
    assert!(listed["trouble"][0].as_str().unwrap().contains("config.toml"), "{listed}");
    page.refusal(500, &page.question("GET", "/api/runs/run", page.address()));
    fs::remove_dir_all(run.path("run")).unwrap();
    page.refusal(404, &page.question("GET", "/api/runs/run", page.address()));
}

#[test]
fn strangers_are_not_answered() {
    let run = TestRun::new(programs!());
    let page = Page::over(&run, &["."]);
    let (status, _) = page.get("/api/runs");
    assert_eq!(status, 200);
    let line = page.refusal(403, &page.question("GET", "/api/runs", "evil.example:7878"));
    assert!(line.contains("own name"), "{line}");
    let host = page.address();
    let asked = page.question("GET", "/api/runs", host);
    let foreign = asked.replacen("\r\n", "\r\norigin: http://evil.example\r\n", 1);
    let line = page.refusal(403, &foreign);
    assert!(line.contains("one from \"http://evil.example\""), "{line}");
    // Another user of this machine, who does not know the token.
    for path in ["/api/runs", "/api/runs?token=00", "/api/events"] {
        let line = page.refusal(403, &Page::question_of_a_stranger("GET", path, host));
        assert!(line.contains("token"), "{line}");
    }
    // Neither half a request nor noise blocks other clients.
    let _half = page.send("GET /api/runs HTTP/1.1\r\nhost: ");
    let _noise = page.send("\0\0\0\0");
    assert_eq!(page.get("/api/runs").0, 200);

    let open = Page::over(&run, &[".", "--host", "0.0.0.0"]);
    assert!(!open.address().starts_with("0.0.0.0"), "{}", open.address());
    for path in ["/api/runs", "/api/runs?token=00"] {
        open.refusal(403, &Page::question_of_a_stranger("GET", path, "10.0.0.5"));
    }
    // The page's own files need no token in their address.
    for path in ["/", "/app.js", "/style.css"] {
        let asked = Page::question_of_a_stranger("GET", path, "10.0.0.5");
        assert_eq!(open.answer(&asked).0, 200, "{path}");
    }
    assert_eq!(open.answer(&open.question("GET", "/api/runs", "10.0.0.5")).0, 200);
}

#[test]
fn a_page_that_is_started_again_has_the_same_token_unless_others_may_know_it() {
    let run = TestRun::new(programs!());
    let known = Page::over(&run, &["."]).query().to_owned();
    assert_eq!(Page::over(&run, &["."]).query(), known);
    fs::set_permissions(run.path("state/goalward/page-token"), Permissions::from_mode(0o644))
        .unwrap();
    let page = Page::over(&run, &["."]);
    assert_ne!(page.query(), known);
    let old = format!("/api/runs?{known}");
    page.refusal(403, &Page::question_of_a_stranger("GET", &old, page.address()));
    // It cannot be kept where there is no folder.
    fs::remove_dir_all(run.path("state")).unwrap();
    fs::write(run.path("state"), "").unwrap();
    assert_eq!(Page::over(&run, &["."]).get("/api/runs").0, 200);
}

#[test]
fn a_port_that_is_taken_and_a_folder_that_is_none_are_refused() {
    let run = TestRun::new(programs!());
    let page = Page::over(&run, &["."]);
    let port = page.address().rsplit_once(':').unwrap().1;
    let (well, said) = run.goalward(&["page", ".", "--port", port]);
    assert!(!well && said.contains("--port chooses another port"), "{said}");
    let (well, said) = run.goalward(&["page", "nowhere"]);
    assert!(!well && said.contains("nowhere: expected a folder of runs"), "{said}");
}
