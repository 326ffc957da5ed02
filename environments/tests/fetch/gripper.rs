//! The gripper's response to actions, compared with values measured in MuJoCo.

use super::Fetch;
use environments::Environment;
use environments::fetch::{FetchSetting, FetchTask};

#[test]
fn the_gripper_answers_as_in_mujoco() {
    let mut fetch = Fetch::open(FetchTask::Pick, &FetchSetting::default());
    let start = fetch.reset(0);
    let mut reach = |action, index: usize, expected: f32| {
        let (observation, _) = fetch.step(action);
        let found = observation[index] - start[index];
        assert!((found - expected).abs() < 0.0035, "{action:?}: {found} m, not {expected} m");
    };
    for expected in [0.0289, 0.0609, 0.0921, 0.1230, 0.1534] {
        reach([1.0, 0.0, 0.0, 0.0], 0, expected);
    }
    reach([0.0; 4], 0, 0.1556);
    for expected in [0.0102, 0.0338, 0.0514] {
        reach([0.0, 0.0, 0.0, 0.05], 9, expected);
    }
    for expected in [0.0398, 0.0183, -0.0013] {
        reach([0.0, 0.0, 0.0, -0.05], 9, expected);
    }
}

#[test]
fn the_gripper_answers_along_every_axis_alike_and_in_proportion() {
    let mut fetch = Fetch::open(FetchTask::Pick, &FetchSetting::default());
    let start = fetch.reset(0);
    for (axis, action) in
        [[1.0, 0.0, 0.0, 0.0], [0.0, -0.3, 0.0, 0.0], [0.0, 0.0, 0.6, 0.0]].into_iter().enumerate()
    {
        fetch.reset(0);
        for _ in 0..5 {
            fetch.step(action);
        }
        let found = (fetch.observation()[axis] - start[axis]) / action[axis];
        assert!((found - 0.1546).abs() < 0.002, "axis {axis}: {found} m");
    }
}

#[test]
fn what_passes_one_is_clipped() {
    let after = |action| {
        let mut fetch = Fetch::open(FetchTask::Pick, &FetchSetting::default());
        fetch.reset(0);
        fetch.step(action);
        fetch.environment.state_hash()
    };
    assert_eq!(after([7.0, -1.5, 1.0, 2.0]), after([1.0, -1.0, 1.0, 1.0]));
    assert_ne!(after([0.9, -1.0, 1.0, 1.0]), after([1.0, -1.0, 1.0, 1.0]));
}
