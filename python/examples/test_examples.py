"""The examples in MuJoCo: their spaces, starts and goals, endings, experts, and that they are pure.

Method: whole episodes of every environment at fixed seeds. The tests need the packages of
`python/examples/requirements.txt` and are skipped where MuJoCo is not installed.
"""

import pathlib
import subprocess
import sys
import warnings

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics")

import ant
import fetch
import gymnasium
import gymnasium_robotics
import numpy as np
import scripts
from gymnasium.utils.env_checker import check_env

EXAMPLES = pathlib.Path(__file__).resolve().parent

# What makes it, numbers of its observation and of its action, longest episode.
TASKS = [(fetch.pick, 16, 4, 50), (fetch.push, 16, 3, 60), (ant.reach, 132, 8, 50)]
MAKERS = [task[0] for task in TASKS]
EXPERTS = [(fetch.pick, fetch.pick_expert), (fetch.push, fetch.push_expert)]
GRIP_STARTS = {fetch.pick: [1.3419, 0.7491, 0.5347], fetch.push: [1.3455, 0.7490, 0.4136]}
REST_HEIGHT_M = 0.4247
RESETS = 500


def episode(environment, seed, choose):
    """The observations of an episode, rewards, and what its last step returned."""
    seen, _ = environment.reset(seed=seed)
    observations, rewards, ended = [seen], [], False
    while not ended:
        seen, reward, terminated, truncated, info = environment.step(choose(seen))
        observations.append(seen)
        rewards.append(reward)
        ended = terminated or truncated
    return np.array(observations), rewards, (terminated, truncated, info)


def random_episode(environment, seed):
    actions = np.random.default_rng(seed)
    size = environment.action_space.shape
    return episode(environment, seed, lambda _: actions.uniform(-1, 1, size).astype(np.float32))


def starts(environment, resets=RESETS):
    """The first observations of so many episodes, in rows."""
    return np.array([environment.reset(seed=seed)[0] for seed in range(resets)])


@pytest.mark.parametrize("make, observation_len, action_len, horizon_steps", TASKS)
def test_spaces_and_horizon_are_those_of_the_paper(make, observation_len, action_len, horizon_steps):
    environment = make()
    assert environment.observation_space.shape == (observation_len,)
    assert environment.action_space == gymnasium.spaces.Box(-1, 1, (action_len,), np.float32)
    still = np.zeros(action_len, np.float32)
    observations, _, (terminated, truncated, info) = episode(environment, 1, lambda _: still)
    assert observations.shape == (horizon_steps + 1, observation_len)
    assert (terminated, truncated, info["is_success"]) == (False, True, False)


@pytest.mark.parametrize("make", MAKERS)
def test_gymnasium_has_nothing_to_say_but_that_observations_have_no_bounds(make):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_env(make().unwrapped, skip_render_check=True)
    others = [str(warning.message) for warning in said if "infinity" not in str(warning.message)]
    assert not others


@pytest.mark.parametrize("make", MAKERS)
def test_an_episode_is_a_function_of_its_seed(make):
    environment = make()
    first, *_ = random_episode(environment, 3)
    for other in (4, 5):
        assert not np.array_equal(random_episode(environment, other)[0][0], first[0])
    for same in (environment, make()):
        assert random_episode(same, 3)[0].tobytes() == first.tobytes()
    script = (
        f"import sys; sys.path[:0] = [{str(EXAMPLES)!r}, {str(pathlib.Path(__file__).parent)!r}]\n"
        f"import test_examples as tests; from {make.__module__} import {make.__name__} as make\n"
        "print('episode', tests.random_episode(make(), 3)[0].tobytes().hex())"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == first.tobytes().hex()


@pytest.mark.parametrize("make", [fetch.pick, fetch.push])
@pytest.mark.parametrize("ranges", ["symmetric", "one-sided"])
@pytest.mark.parametrize("noise", [0, 1, 2])
def test_cubes_and_goals_fill_their_ranges(make, ranges, noise):
    first = starts(make(noise=noise, ranges=ranges), RESETS if noise else 2)
    grip = np.array(GRIP_STARTS[make])
    assert np.allclose(first[:, fetch.GRIP], grip, atol=1e-4)
    assert np.allclose(first[:, fetch.CUBE_FROM_GRIP], first[:, fetch.CUBE] - first[:, fetch.GRIP])
    assert np.allclose(first[:, fetch.FINGERS], 0, atol=2e-3)
    assert np.allclose(first[:, fetch.CUBE_TILT], 0, atol=1e-3)
    cube_x = 0.02 if make is fetch.pick and ranges == "symmetric" else 0.05
    low, high = (-0.02, 0.02) if ranges == "symmetric" else (0.0, 0.04)
    goal_z = REST_HEIGHT_M + (0.15 if make is fetch.pick else 0.0)
    spread = noise * np.array([[-cube_x, low], [cube_x, high]])
    filled(first[:, fetch.CUBE] - grip, spread + [0, 0.1], REST_HEIGHT_M - grip[2])
    spread = noise * np.array([[-0.05, -high], [0.05, -low]])
    filled(first[:, fetch.GOAL] - grip, spread + [0, -0.1], goal_z - grip[2])


def filled(offsets, corners, height):
    """Asserts that places are at a height, within a rectangle, and within 2 % of its edges."""
    least, largest = offsets[:, :2].min(axis=0), offsets[:, :2].max(axis=0)
    margin = 0.02 * (corners[1] - corners[0]) + 1e-4
    assert (least >= corners[0] - 1e-4).all() and (least <= corners[0] + margin).all()
    assert (largest <= corners[1] + 1e-4).all() and (largest >= corners[1] - margin).all()
    assert np.allclose(offsets[:, 2], height, atol=1e-4)


@pytest.mark.parametrize(
    "coverage, rows",
    [
        (0.25, ["0", "1", "2", "3"]),
        (0.5, ["01", "02", "03", "12"]),
        (0.75, ["012", "013", "023", "123"]),
        (1.0, ["0123"] * 4),
    ],
)
def test_a_coverage_keeps_its_bins(coverage, rows):
    first = starts(fetch.push(coverage=coverage, noise=1.75))
    for place, side in ((fetch.CUBE, 0.1), (fetch.GOAL, -0.1)):
        offsets = first[:, place][:, :2] - first[:, fetch.GRIP][:, :2] - [0, side]
        shares = offsets / (1.75 * np.array([0.05, 0.02]))
        bins = np.floor(2 * (shares + 1)).astype(int)
        found = {(int(x), int(y)) for x, y in bins}
        assert found == {(x, int(y)) for x in range(4) for y in rows[x]}


@pytest.mark.parametrize("make, expert", EXPERTS)
def test_experts_succeed_and_success_ends_the_episode(make, expert):
    environment, successes = make(), 0
    for seed in range(50):
        environment.reset(seed=seed)
        seen, rewards, (terminated, _, info) = episode(environment, seed, expert(environment))
        apart = np.linalg.norm(seen[:, fetch.CUBE] - seen[:, fetch.GOAL], axis=1)
        assert terminated == info["is_success"] == (apart[-1] < 0.05)
        assert (apart[:-1] >= 0.05).all()
        assert rewards == [-1.0] * (len(rewards) - 1) + [float(terminated) - 1.0]
        successes += info["is_success"]
    assert successes >= 48


def test_actions_of_experts_are_actions():
    for make, expert in EXPERTS:
        environment = make(noise=2)
        seen, _ = environment.reset(seed=1)
        act = expert(environment)
        for _ in range(30):
            action = act(seen)
            assert action in environment.action_space
            seen, *_ = environment.step(action)


def test_the_ant_is_that_of_the_authors():
    model = ant.Ant(1.0, 0.0, False).model
    assert (model.nq, model.nv, model.nbody, model.nu) == (22, 20, 15, 8)
    assert np.isclose(model.body_mass[:14].sum(), 0.911, atol=1e-3)
    assert np.isclose(model.body_mass[14], 0.6)
    motors = [model.joint(model.actuator(index).trnid[0]).name for index in range(8)]
    order = "hip_4 ankle_4 hip_1 ankle_1 hip_2 ankle_2 hip_3 ankle_3"
    assert motors == order.split()
    assert (model.actuator_gear[:, 0] == 150).all() and model.opt.timestep == 0.02
    assert np.allclose(model.geom_solimp[:, :3], [0.8, 0.8, 0.01])


def test_an_ant_without_torque_sinks_and_its_marker_comes_to_rest():
    environment = ant.reach()
    seen, *_ = episode(environment, 1, lambda _: np.zeros(8, np.float32))
    assert abs(seen[-1, ant.HEIGHT] - 0.37) < 0.01
    assert np.allclose(np.abs(seen[-1, ant.JOINTS][1::2]), 0.52, atol=0.01)
    assert np.allclose(seen[-1, ant.MARKER_POSITION][2], 0.51, atol=0.01)
    assert np.allclose(seen[-1, ant.MARKER_VELOCITY], 0, atol=0.01)
    assert (seen[:, ant.CONTACT_FORCES] == 0).all()


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_noise_moves_every_coordinate_of_the_ants_start(noise):
    first = starts(ant.reach(noise=noise))
    torso_xy = first[:, 13:15] - first[:, ant.TO_GOAL]
    level = [0.55, 0, 1, 0, -1, 0, -1, 0, 1, 0.15]
    heights_and_angles = first[:, [0, *range(5, 13), 15]]
    apart = np.hstack([torso_xy, heights_and_angles - level])
    assert (np.abs(apart) <= noise + 1e-9).all()
    assert (np.abs(apart).max(axis=0) >= 0.95 * noise).all()
    for quaternion in (first[:, ant.ORIENTATION], first[:, ant.MARKER_ORIENTATION]):
        assert np.allclose(np.linalg.norm(quaternion, axis=1), 1)
        assert (quaternion.std(axis=0).max() > 1e-6) == (noise > 0)
    assert (np.abs(first[:, 20:40]) <= 0.005).all()
    assert (np.abs(first[:, 20:40]).max(axis=0) > 0.0045).all()


@pytest.mark.parametrize("coverage", [0.25, 0.5, 0.75, 1.0])
def test_goals_of_the_ant_lie_on_a_half_circle(coverage):
    goals = starts(ant.reach(coverage=coverage))[:, 13:15]
    assert np.allclose(np.linalg.norm(goals, axis=1), 5)
    bins = np.floor(np.arctan2(goals[:, 1], goals[:, 0]) / np.pi * 20).astype(int)
    quarter = set(range(2, 20, 4))
    all_bins = set(range(20))
    kept = {0.25: quarter, 0.5: set(range(0, 20, 2)), 0.75: all_bins - quarter, 1.0: all_bins}
    assert set(bins) == kept[coverage]


def test_success_of_the_ant_stays_and_ends_nothing():
    environment = ant.reach()
    environment.reset(seed=1)
    inner, action = environment.unwrapped, np.full(8, 0.5, np.float32)
    told = []
    for distance_m in (0.7, 0.4, 3.0):
        inner.data.qpos[:2] = inner.goal - [distance_m, 0]
        _, reward, terminated, truncated, info = environment.step(action)
        left_m = np.linalg.norm(inner.goal - inner.data.qpos[:2])
        assert np.isclose(reward, 1 - left_m / 5 - 0.005 * 8 * 0.25)
        assert not terminated and not truncated
        told.append(info["is_success"])
    assert told == [False, True, True]
    environment.reset(seed=2)
    assert not environment.step(action)[4]["is_success"]


def test_contact_forces_are_observed_when_asked_for_and_change_nothing_else():
    seen, *_ = random_episode(ant.reach(), 1)
    felt, *_ = random_episode(ant.reach(contact_forces=True), 1)
    forces = felt[:, ant.CONTACT_FORCES]
    assert np.abs(forces).max() == 1 and (forces[:, :6] == 0).all()
    assert np.array_equal(np.delete(felt, np.s_[40:130], 1), np.delete(seen, np.s_[40:130], 1))


@pytest.mark.parametrize(
    "make, setting",
    [
        (fetch.pick, {"coverage": 0.3}),
        (fetch.push, {"noise": -1}),
        (fetch.push, {"noise": 5}),
        (fetch.pick, {"ranges": "round"}),
        (ant.reach, {"coverage": 0}),
        (ant.reach, {"noise": 1}),
    ],
)
def test_a_setting_out_of_its_range_is_refused(make, setting):
    [name] = setting
    with pytest.raises(ValueError, match=f"{name}: expected"):
        make(**setting)


SCRIPTS = [
    ("MountainCarContinuous-v0", {}, scripts.mountain_car, lambda reward, info: reward > 0),
    ("LunarLander-v3", {}, scripts.lander, lambda reward, info: reward > 0),
    (
        "PointMaze_Medium-v3",
        {"continuing_task": False},
        scripts.point_maze,
        lambda reward, info: info["success"],
    ),
    ("MiniGrid-FourRooms-v0", {}, scripts.four_rooms, lambda reward, info: reward > 0),
]


@pytest.mark.parametrize("name, keywords, expert, reached", SCRIPTS)
def test_scripts_reach_the_goals_of_environments_of_others(name, keywords, expert, reached):
    if needed := {"LunarLander-v3": "Box2D", "MiniGrid-FourRooms-v0": "minigrid"}.get(name):
        pytest.importorskip(needed)
    gymnasium.register_envs(gymnasium_robotics)
    environment = gymnasium.make(name, **keywords)
    successes = 0
    for seed in range(20):
        _, rewards, (terminated, _, info) = episode(environment, seed, expert_of(environment, expert))
        successes += bool(terminated and reached(rewards[-1], info))
    assert successes >= 18


def expert_of(environment, expert):
    """An expert that is made when the episode has begun."""
    made = []
    return lambda seen: (made or made.append(expert(environment)) or made)[0](seen)
