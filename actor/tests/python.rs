//! Python environments: what they look like to an actor, and every way in which they can fail.
//!
//! The interpreter in `GOALWARD_PYTHON` needs the packages of `tests/requirements.txt`; `GOALWARD_PYTHON=none`
//! skips these tests.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;

use actor::demonstrate::{Request, demonstrate};
use actor::expert::ActingExpert;
use actor::factory::Factory;
use actor::python::{make, purified};
use actor::{BUILT_IN, Environment, EnvironmentError, Setting, Step};
use protocol::ending::Ending;
use protocol::seed::{Purpose, stream};
use protocol::task::{ActionSpec, ObservationSpec, floats};
use run::process::Stop;

/// Returns whether there is a Python to test with.
fn has_python() -> bool {
    let named = std::env::var("GOALWARD_PYTHON").ok().filter(|python| !python.is_empty());
    named.expect("GOALWARD_PYTHON: expected an interpreter, or `none`; deploy/test.sh sets it")
        != "none"
}

fn setting(text: &str) -> Setting {
    Setting(text.parse().unwrap())
}

/// Makes an environment of `python_environments/__init__.py`.
fn own(name: &str, further: &str) -> Result<Box<dyn Environment>, EnvironmentError> {
    make(&setting(&format!("make = \"python:tests.python_environments:{name}\"\n{further}")))
}

fn bad(how: &str) -> Box<dyn Environment> {
    own("bad", &format!("kwargs.how = \"{how}\"")).unwrap()
}

/// Resets with the seed of an episode.
fn reset(environment: &mut dyn Environment, episode: u64) -> Vec<u8> {
    let mut observation = vec![0; environment.spec().observation.bytes()];
    let mut starts = stream(1, Purpose::TrainingEpisode, 0, episode);
    environment.reset(&mut starts, &mut observation).unwrap();
    observation
}

fn step(
    environment: &mut dyn Environment,
    action: &[u8],
) -> Result<(Step, Vec<u8>), EnvironmentError> {
    let mut observation = vec![0; environment.spec().observation.bytes()];
    let step = environment.step(action, &mut observation)?;
    Ok((step, observation))
}

/// Steps until the episode fails; returns the number of steps before the failure and its message.
fn failure(environment: &mut dyn Environment) -> (usize, String) {
    let mut taken = 0;
    loop {
        match step(environment, &1.0_f32.to_le_bytes()) {
            Ok(_) => taken += 1,
            Err(error) => return (taken, error.to_string()),
        }
    }
}

#[test]
fn a_picture_is_rendered_where_it_is_wanted() {
    if !has_python() {
        return;
    }
    let mut plain = own("line", "").unwrap();
    reset(&mut *plain, 0);
    assert_eq!(plain.picture().unwrap(), None);
    let mut rendering = own("line", "render = true").unwrap();
    reset(&mut *rendering, 0);
    let picture = rendering.picture().unwrap().unwrap();
    // A width of 900 pixels is reduced to a third.
    let (width, height) = (300_u32.to_be_bytes(), 7_u32.to_be_bytes());
    assert_eq!(picture[..8], *b"\x89PNG\r\n\x1a\n");
    assert_eq!(picture[16..24], [width, height].concat());
    step(&mut *rendering, &1.0_f32.to_le_bytes()).unwrap();
    assert_ne!(rendering.picture().unwrap().unwrap(), picture);
    let mut none = own("Grid", "render = true\nhorizon_steps = 5").unwrap();
    reset(&mut *none, 0);
    assert_eq!(none.picture().unwrap(), None, "what renders nothing is no failure");
    let mut refusing = own("Particular", "render = true\nhorizon_steps = 5").unwrap();
    reset(&mut *refusing, 0);
    assert_eq!(refusing.picture().unwrap(), None, "nor what has no such mode");
}

#[test]
fn environments_are_closed_when_nobody_needs_them() {
    if !has_python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("closed");
    let leaves = format!("horizon_steps = 5\nkwargs.leaves = {:?}", file.to_str().unwrap());
    let mut environment = own("Particular", &leaves).unwrap();
    reset(&mut *environment, 0);
    drop(environment);
    fs::remove_file(&file).ok();
    actor::python::close();
    assert_eq!(fs::read_to_string(&file).unwrap(), "closed");
}

#[test]
fn spaces_become_numbers_with_labels_and_texts_are_left_out() {
    if !has_python() {
        return;
    }
    let mut line = own("line", "").unwrap();
    let spec = line.spec();
    assert_eq!(spec.observation, ObservationSpec::Vector { len: 3 });
    assert_eq!((spec.action, spec.horizon_steps), (ActionSpec::Continuous { len: 1 }, 20));
    assert_eq!(line.labels(), ["parity[0]", "parity[1]", "place"]);
    assert!(line.tells_success());
    let complete = line.setting().0;
    assert_eq!(complete["success"].as_str(), Some("is_success"));
    assert!(complete["versions"]["gymnasium"].is_str() && complete["versions"]["python"].is_str());
    let source = complete["sources"]["tests.python_environments"].as_str();
    assert_eq!(source.map(str::len), Some(64));
    let installed = make(&setting("make = \"gym:CartPole-v1\"")).unwrap().setting();
    assert!(!installed.0.contains_key("sources"), "a package has a version");
    let first: Vec<f32> = floats(&reset(&mut *line, 0)).collect();
    assert!(first[2].abs() <= 0.1 && first[..2] == [1.0, 0.0], "{first:?}");
    // The action is clipped to 1, which is the upper bound 0.5, and the environment subtracts 0.15.
    let (_, seen) = step(&mut *line, &7.0_f32.to_le_bytes()).unwrap();
    let second: Vec<f32> = floats(&seen).collect();
    assert!((second[2] - first[2] - 0.35).abs() < 1e-6 && second[..2] == [0.0, 1.0], "{second:?}");
}

#[test]
fn a_grid_of_classes_becomes_cells() {
    if !has_python() {
        return;
    }
    let refusal = own("Grid", "").err().unwrap().to_string();
    assert!(
        refusal.contains("`environment.horizon_steps`") && refusal.contains("no limit"),
        "{refusal}"
    );
    let mut grid = own("Grid", "horizon_steps = 7").unwrap();
    assert_eq!(grid.spec().observation, ObservationSpec::Cells { height: 3, width: 4, classes: 3 });
    assert_eq!(grid.spec().action, ActionSpec::Discrete { count: 6 });
    assert!(!grid.tells_success());
    assert_eq!(reset(&mut *grid, 0), [0; 12]);
    let (taken, seen) = step(&mut *grid, &[5]).unwrap();
    assert_eq!((taken.reward, taken.ending, seen), (12.0, None, vec![2; 12]));
    let mut endings = Vec::new();
    for _ in 1..7 {
        endings.push(step(&mut *grid, &[5]).unwrap().0.ending);
    }
    assert_eq!((endings[4], endings[5]), (None, Some(Ending::Truncated)));
    assert_eq!(step(&mut *grid, &[5]).unwrap_err(), EnvironmentError::NotRunning);
}

#[test]
fn episodes_end_as_the_environment_says_and_depend_on_their_seeds_alone() {
    if !has_python() {
        return;
    }
    let mut environments = [(); 2].map(|()| own("line", "").unwrap());
    let play = |environment: &mut dyn Environment, episode, action: f32| {
        let mut bytes = reset(environment, episode);
        loop {
            let (step, seen) = step(environment, &action.to_le_bytes()).unwrap();
            bytes.extend(seen);
            if let Some(ending) = step.ending {
                return (bytes, ending, step.success, environment.state_hash());
            }
        }
    };
    let [one, other] = &mut environments;
    let first = play(&mut **one, 3, 1.0);
    assert_eq!((first.1, first.2), (Ending::GoalReached, true));
    let fallen = play(&mut **one, 4, -1.0);
    assert_eq!((fallen.1, fallen.2), (Ending::Failed, false));
    let kept = play(&mut **one, 4, -0.4);
    assert_eq!((kept.1, kept.2), (Ending::Truncated, false), "{}", kept.0.len());
    // Side by side in one process: both are announced before they are stepped.
    assert_eq!(play(&mut **other, 3, 1.0), first);
    let before = [reset(&mut **one, 3), reset(&mut **other, 4)];
    let actions = [0.25_f32, 0.5].map(f32::to_le_bytes);
    one.announce(&actions[0]).unwrap();
    other.announce(&actions[1]).unwrap();
    let together =
        [step(&mut **one, &actions[0]).unwrap(), step(&mut **other, &actions[1]).unwrap()];
    assert_eq!([reset(&mut **one, 3), reset(&mut **other, 4)], before);
    let alone = [step(&mut **one, &actions[0]).unwrap(), step(&mut **other, &actions[1]).unwrap()];
    assert_eq!(together, alone);
}

#[test]
fn what_an_environment_raises_is_said_and_would_be_raised_again() {
    if !has_python() {
        return;
    }
    for (how, words) in [
        ("raises", "ZeroDivisionError: by nothing"),
        ("wrong shape", "expected shape (1,), found (2,)"),
        ("nothing", "TypeError"),
        ("four values", "expected 5, got 4"),
        ("odd success", "expected true or false, found 'maybe'"),
        ("memory", "MemoryError"),
        ("no number", "found NaN in place at step 3"),
        ("endless reward", "expected a finite reward at step 3, found inf"),
    ] {
        let mut environment = bad(how);
        reset(&mut *environment, 0);
        let (taken, said) = failure(&mut *environment);
        assert_eq!(taken, 2, "{how}: {said}");
        assert!(said.contains(words) && !said.contains('\n'), "{how}: {said}");
    }
    let mut environment = own("bad", "kwargs.how = \"reset raises\"\nsuccess = \"none\"").unwrap();
    let mut observation = vec![0; 12];
    let mut starts = stream(1, Purpose::TrainingEpisode, 0, 0);
    let said = environment.reset(&mut starts, &mut observation).unwrap_err();
    assert!(
        matches!(&said, EnvironmentError::Raised(words) if words.contains("no start today")),
        "{said}"
    );
}

#[test]
fn the_environment_that_raises_is_told_from_those_beside_it() {
    if !has_python() {
        return;
    }
    let [mut first, mut other] = [(); 2].map(|()| bad("raises beside"));
    reset(&mut *first, 0);
    reset(&mut *other, 1);
    let action = 1.0_f32.to_le_bytes();
    for _ in 0..2 {
        step(&mut *other, &action).unwrap();
    }
    first.announce(&action).unwrap();
    other.announce(&action).unwrap();
    let said = step(&mut *first, &action).unwrap_err();
    assert!(
        matches!(&said, EnvironmentError::Other(words) if words.contains("in the same process as an environment")),
        "{said}"
    );
    let said = step(&mut *other, &action).unwrap_err();
    assert!(
        matches!(&said, EnvironmentError::Raised(words) if words.contains("by nothing")),
        "{said}"
    );
}

#[test]
fn success_is_told_as_the_setting_says() {
    if !has_python() {
        return;
    }
    for (rule, reached, tells) in [
        ("is_success", true, true),
        ("terminated", true, true),
        ("reward", false, true),
        ("none", false, false),
        ("tests.python_environments:is_far", true, true),
    ] {
        let mut environment = own("line", &format!("success = \"{rule}\"")).unwrap();
        assert_eq!(environment.tells_success(), tells, "{rule}");
        reset(&mut *environment, 0);
        let last = loop {
            let (step, _) = step(&mut *environment, &1.0_f32.to_le_bytes()).unwrap();
            if step.ending.is_some() {
                break step;
            }
        };
        assert_eq!(last.success, reached, "{rule}");
    }
    let at_the_end = "success = \"is_success\"\nhorizon_steps = 20";
    let mut environment = own("Particular", at_the_end).unwrap();
    reset(&mut *environment, 0);
    let steps =
        std::iter::repeat_with(|| step(&mut *environment, &1.0_f32.to_le_bytes()).unwrap().0);
    let told: Vec<bool> =
        steps.map(|step| step.success).take_while(|success| !success).take(20).collect();
    assert!(told.len() < 20, "no success in {told:?}");
}

#[test]
fn packages_that_do_not_go_together_are_named_with_what_to_install() {
    if !has_python() {
        return;
    }
    let mut environment = own("conflicting", "success = \"none\"").unwrap();
    let mut observation = vec![0; 12];
    let mut starts = stream(1, Purpose::TrainingEpisode, 0, 0);
    let said = environment.reset(&mut starts, &mut observation).unwrap_err().to_string();
    let advice =
        "gymnasium-robotics 1.4.2 does not work with mujoco 4.0.0: pip install 'mujoco<3.12'";
    assert!(said.ends_with(advice), "{said}");
}

#[test]
fn a_process_that_is_gone_is_noticed() {
    if !has_python() {
        return;
    }
    for (how, words) in [("exits", "exit status: 7"), ("crashes", "signal: 11")] {
        let mut environment = bad(how);
        reset(&mut *environment, 0);
        let (taken, said) = failure(&mut *environment);
        assert_eq!(taken, 2);
        assert!(said.contains(words), "{how}: {said}");
    }
}

#[test]
fn an_expert_of_python_acts_in_the_environment_it_is_made_for() {
    if !has_python() {
        return;
    }
    let with =
        |expert: &str| own("line", &format!("expert = \"tests.python_environments:{expert}\""));
    let mut environment = with("expert").unwrap();
    let mut action = [0; 4];
    assert_eq!(environment.expert_action(&mut action), Ok(false), "no episode runs");
    let before: Vec<f32> = floats(&reset(&mut *environment, 0)).collect();
    assert_eq!(environment.expert_action(&mut action), Ok(true));
    assert_eq!(f32::from_le_bytes(action), 1.0, "the upper bound, 0.5, in the measure of a policy");
    let (_, seen) = step(&mut *environment, &action).unwrap();
    assert!((floats(&seen).last().unwrap() - before[2] - 0.35).abs() < 1e-6);
    assert_eq!(own("line", "").unwrap().expert_action(&mut action), Ok(false), "there is none");
    let scaled = "expert = \"tests.python_environments:expert\"\naction_scale = [0.25]";
    let mut scaled = own("line", scaled).unwrap();
    reset(&mut *scaled, 0);
    assert_eq!(scaled.expert_action(&mut action), Ok(true));
    assert_eq!(f32::from_le_bytes(action), 4.0, "which a quarter makes 1 of");
    assert_eq!(step(&mut *scaled, &action).unwrap().1, seen);
    let mut lost = with("lost_expert").unwrap();
    reset(&mut *lost, 0);
    let said = lost.expert_action(&mut action).unwrap_err().to_string();
    assert!(said.contains("expert in Python: ValueError: action: expected shape (1,)"), "{said}");
    let said = with("nobody").err().unwrap().to_string();
    assert!(said.contains("nobody") && !said.contains('\n'), "{said}");
}

#[test]
fn an_expert_whose_first_episode_does_not_begin_leaves_no_file() {
    if !has_python() {
        return;
    }
    let text = "make = \"python:tests.python_environments:bad\"\nkwargs.how = \"reset raises\"\n\
        success = \"none\"\nexpert = \"tests.python_environments:expert\"";
    let folder = tempfile::tempdir().unwrap();
    let factory = Factory::new(BUILT_IN, "bad", setting(text)).unwrap();
    let file = folder.path().join("d.mcap");
    let request = Request { factory, episodes: 1, seed: 1, file: &file, force: false };
    let expert = ActingExpert::of_task(&request.factory).unwrap();
    let said = demonstrate(&request, expert, &Stop::default()).err().unwrap();
    assert!(format!("{said:#}").contains("no start today"), "{said:#}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn what_no_task_can_have_is_refused_in_one_line() {
    if !has_python() {
        return;
    }
    for (name, words) in [
        ("Picture", "images are not supported"),
        ("Unbounded", "expected bounded actions"),
        ("ManyChoices", "at most 256 choices of an action, found 289"),
        ("no_environment", "expected a gymnasium.Env, found str"),
        ("nobody", "AttributeError"),
    ] {
        let said = own(name, "horizon_steps = 9").err().unwrap().to_string();
        assert!(said.contains(words) && !said.contains('\n'), "{name}: {said}");
    }
    for (text, words) in [
        ("make = \"gym:Nowhere-v0\"", "Nowhere"),
        ("make = \"gym:no_such_module:Id-v0\"", "no_such_module"),
        ("make = \"rust:x\"", "expected gym:ID or python:module:function, found rust:x"),
        ("make = \"python:json\"", "expected module:function, found json"),
        (
            "make = \"gym:CartPole-v1\"\nsuccess = \"truncated\"",
            "success: expected auto, none, is_success, success, terminated, reward or",
        ),
        ("make = \"gym:CartPole-v1\"\nversions.gymnasium = \"0.1\"", "`versions.gymnasium`"),
        (
            "make = \"python:tests.python_environments:line\"\n\
             sources.\"tests.python_environments\" = \"00\"",
            "`sources.tests.python_environments`",
        ),
        ("make = \"gym:CartPole-v1\"\nsuccess = \"nobody:knows\"", "nobody"),
        ("make = \"gym:CartPole-v1\"\nwind = 3", "`wind`"),
    ] {
        let said = make(&setting(text)).err().unwrap().to_string();
        assert!(said.contains(words) && !said.contains('\n'), "{text}: {said}");
    }
}

#[test]
fn an_environment_that_is_not_pure_is_found_and_rebuilding_tried() {
    if !has_python() {
        return;
    }
    let purity = |name: &str| {
        let make = format!("make = \"python:tests.python_environments:{name}\"");
        let (setting, deterministic) = purified(setting(&make)).unwrap();
        (setting.0.get("rebuild").and_then(|value| value.as_bool()), deterministic)
    };
    assert_eq!(purity("line"), (None, true));
    assert_eq!(purity("traced"), (Some(true), true));
    assert_eq!(purity("chance"), (None, false));
    assert_eq!(purity("shared_chance"), (None, false), "episodes side by side differ");
    assert_eq!(purity("unordered"), (None, true), "texts have the same hashes in every process");
    assert_eq!(purified(setting("noise = 2")).unwrap(), (setting("noise = 2"), true));
}
