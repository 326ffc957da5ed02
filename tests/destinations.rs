//! `--out` overwrites nothing unless asked, and nothing is ever written into a run under a name that the user chose.
//!
//! Method: every verb that writes is pointed at files that exist, at files and folders of a run, and at links to
//! them. Each is refused in one line with exit code 2, and every byte of the test's folder stays. With `--force`,
//! files outside of runs are replaced.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::os::unix::fs::symlink;
use std::process::Output;

use system_tests::{TestRun, programs};

fn goalward(run: &TestRun, line: &str) -> Output {
    run.program("goalward").args(line.split(' ')).output().unwrap()
}

fn refused(run: &TestRun, line: &str, part: &str) {
    let before = run.contents();
    let Output { status, stdout, stderr } = goalward(run, line);
    let said = String::from_utf8(stderr).unwrap();
    assert_eq!((status.code(), stdout.len()), (Some(2), 0), "{line}: {said}");
    assert!(said.lines().count() == 1 && said.contains(part), "{line}: {said}");
    assert!(run.contents() == before, "{line} changed a file");
}

fn done(run: &TestRun, line: &str) {
    let output = goalward(run, line);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{line}: {said}");
}

const WITH: &str = "replay run --with reward.uncertainty=0.1";
const DEMONSTRATE: &str = "demonstrate navigation --episodes 2";

#[test]
fn every_verb_keeps_what_is_there() {
    let run = TestRun::new(programs!());
    run.finish(&["steps=800"]);
    for name in ["d.mcap", "a.csv", "b.toml", "c.svg"] {
        fs::write(run.path(name), "dear").unwrap();
    }
    for folder in ["web", "restored"] {
        fs::create_dir(run.path(folder)).unwrap();
        fs::write(run.path(folder).join("thesis.txt"), "dear").unwrap();
    }
    let taken = "not overwritten";
    refused(&run, &format!("{DEMONSTRATE} --out d.mcap"), taken);
    // The configuration and the picture are written beside the rewards.
    for out in ["a.csv", "b.csv", "c.csv"] {
        refused(&run, &format!("{WITH} --out {out}"), taken);
    }
    refused(&run, &format!("{WITH} --out new.toml"), "expected a name such as");
    refused(&run, "report run --out web", taken);
    refused(&run, "log restore run --out restored", taken);
    refused(&run, "replay run --retrain --out restored", "found files in restored");

    done(&run, "evaluate run --episodes 3");
    refused(&run, "evaluate run --episodes 3", taken);
    done(&run, "evaluate run --episodes 3 --force");
    done(&run, WITH);
    refused(&run, WITH, taken);
    done(&run, &format!("{WITH} --force"));
    done(&run, &format!("{WITH} --out b.csv --force"));
    assert!(fs::read_to_string(run.path("b.toml")).unwrap().contains("uncertainty = 0.1"));
    done(&run, &format!("{DEMONSTRATE} --out d.mcap --force"));
    let demonstrations = fs::read(run.path("d.mcap")).unwrap();
    assert!(demonstrations.len() > 1000);
    let fails = format!("{DEMONSTRATE} --out d.mcap --force --policy nowhere");
    refused(&run, &fails, "nowhere");
    assert!(fs::read(run.path("d.mcap")).unwrap() == demonstrations);
    done(&run, "report run --out web --force");
    done(&run, "log restore run --out restored --force");
    done(&run, "log restore run --out restored --force");
    for folder in ["web", "restored"] {
        assert_eq!(fs::read(run.path(folder).join("thesis.txt")).unwrap(), b"dear");
    }
}

#[test]
fn no_verb_writes_into_a_run() {
    let run = TestRun::new(programs!());
    run.finish(&["steps=800"]);
    symlink("run", run.path("link")).unwrap();
    symlink("run/config.toml", run.path("plan.csv")).unwrap();
    symlink("run/config.toml", run.path("beside.toml")).unwrap();
    let inside = "the folder of the run";
    for out in ["run/config.toml", "run/new.mcap", "run/log/../new", "link/new", "plan.csv"] {
        refused(&run, &format!("{DEMONSTRATE} --out {out} --force"), inside);
    }
    let log = "run/log/updates-00000.mcap";
    for out in ["run/config.csv", log, "link/log/new.csv", "plan.csv", "beside.csv"] {
        refused(&run, &format!("{WITH} --out {out} --force"), inside);
    }
    for out in ["run", "link", "run/new", "link/log"] {
        refused(&run, &format!("report run --out {out} --force"), inside);
        refused(&run, &format!("log restore run --out {out} --force"), inside);
        refused(&run, &format!("replay run --retrain --out {out}"), inside);
    }
    fs::write(
        run.path("plan.toml"),
        "title = \"A\"\nseeds = [1]\nmethods = [\"bc\"]\n[[panel]]\nname = \"a\"\ntitle = \"A\"\n\
         task = \"navigation\"\n",
    )
    .unwrap();
    refused(&run, "experiment plan.toml --out run/more", inside);
}
