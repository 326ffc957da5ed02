"""Tests of Minari data sets, made and stored by the real package."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import minari
import numpy as np
import pytest
from gymnasium import spaces
from minari.data_collector import EpisodeBuffer
from walks import REACH, walk

from goalward import Error, Task, Vector
from goalward.demonstrations import load
from goalward.demonstrations.minari import _actions
from goalward.spaces import actions_of, observations_of

PARTS = spaces.Dict(
    {
        "observation": spaces.Box(-np.inf, np.inf, (2,), np.float32),
        "goal": spaces.Box(-np.inf, np.inf, (1,), np.float32),
    }
)
MOVES = spaces.Box(-1, 1, (2,), np.float32)
LABELS = ("goal", "observation[0]", "observation[1]")


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))


def buffer(number: int, observations: Any, steps: int, infos: dict[str, Any] | None = None) -> EpisodeBuffer:
    return EpisodeBuffer(
        id=number,
        observations=observations,
        actions=np.zeros((steps, 2), np.float32),
        rewards=[0.0] * steps,
        terminations=[False] * steps,
        truncations=[False] * (steps - 1) + [True],
        infos=infos,
    )


def parts(states: Any) -> dict[str, Any]:
    return {"observation": states[:, 1:], "goal": states[:, :1]}


def stacked(seen: list[Any]) -> Any:
    """Stack observations as Minari does, each part on its own."""
    if isinstance(seen[0], dict):
        return {key: stacked([one[key] for one in seen]) for key in seen[0]}
    if isinstance(seen[0], tuple):
        return tuple(stacked(list(part)) for part in zip(*seen, strict=True))
    return seen if isinstance(seen[0], str) else np.stack(seen)


def stored(buffers: list[EpisodeBuffer], space: spaces.Space[Any], data_format: str = "hdf5") -> Path:
    data = minari.create_dataset_from_buffers(
        "goalward/walks-v0",
        buffers,
        observation_space=space,
        action_space=MOVES,
        data_format=data_format,
    )
    return Path(str(data.storage.data_path)).parent


@pytest.mark.parametrize("data_format", ["hdf5", "arrow"])
def test_parts_are_called_and_ordered_as_by_gymnasium(data_format: str) -> None:
    walks = [walk(steps, steps) for steps in (5, 9)]
    buffers = [buffer(number, parts(states), len(states) - 1) for number, states in enumerate(walks)]
    source = stored(buffers, PARTS, data_format)
    loaded = load(source, replace(REACH, labels=LABELS), success="all")
    for episode, states in zip(loaded.episodes, walks, strict=True):
        np.testing.assert_array_equal(episode.observations, states)


@pytest.mark.parametrize("data_format", ["hdf5", "arrow"])
@pytest.mark.parametrize("key", ["success", "is_success"])
def test_infos_tell_success(key: str, data_format: str) -> None:
    won = {key: [False, False, False, True, True, True]}
    lost = {key: [False] * 6}
    walks = [parts(walk(5, 0)), parts(walk(5, 1))]
    source = stored([buffer(0, walks[0], 5, won), buffer(1, walks[1], 5, lost)], PARTS, data_format)
    loaded = load(source, REACH, keys=["goal", "observation"])
    [episode] = loaded.episodes
    np.testing.assert_array_equal(episode.observations, walk(5, 0)[:4])
    assert loaded.left_out == 1


def test_a_choice_becomes_one_hot() -> None:
    space = spaces.Dict({"room": spaces.Discrete(3, start=1), "at": spaces.Box(-9, 9, (1,), np.float32)})
    seen = {"room": np.array([1, 3, 2]), "at": np.array([[5], [6], [7]], np.float32)}
    source = stored([buffer(0, seen, 2)], space)
    task = Task("rooms", Vector(4), REACH.action, 5, labels=("room[0]", "room[1]", "room[2]", "at"))
    [episode] = load(source, task, keys=["room", "at"], success="all").episodes
    assert np.asarray(episode.observations).tolist() == [[1, 0, 0, 5], [0, 0, 1, 6], [0, 1, 0, 7]]


def test_nested_parts_have_paths() -> None:
    inner = spaces.Dict({"joints": spaces.Box(-9, 9, (2,), np.float32)})
    space = spaces.Dict({"arm": inner, "goal": spaces.Box(-9, 9, (1,), np.float32)})
    states = walk(3, 0)
    seen = {"arm": {"joints": states[:, :2]}, "goal": states[:, 2:]}
    task = replace(REACH, labels=("arm/joints[0]", "arm/joints[1]", "goal"))
    [episode] = load(stored([buffer(0, seen, 3)], space), task, success="all").episodes
    np.testing.assert_array_equal(episode.observations, states)


def test_parts_are_those_that_an_actor_sees() -> None:
    space = spaces.Dict(
        {
            "b": spaces.Tuple((spaces.Discrete(3, start=1), spaces.MultiBinary((2, 2)))),
            "a": spaces.Dict(
                {"x": spaces.Box(-9, 9, (2, 1)), "n": spaces.MultiDiscrete([2, 3], start=[0, 5])}
            ),
            "say": spaces.Text(4),
        }
    )
    space.seed(1)
    seen = [space.sample() for _ in range(4)]
    numbers = observations_of(space)
    rows = np.array([numbers.row() for _ in seen])
    for row, observation in zip(rows, seen, strict=True):
        numbers.write(observation, row)
    _, labels = numbers.layout()
    task = replace(REACH, observation=Vector(len(labels)), labels=tuple(labels))
    [episode] = load(stored([buffer(0, stacked(seen), 3)], space), task, success="all").episodes
    np.testing.assert_array_equal(episode.observations, rows)


def test_a_space_without_parts_is_called_observation() -> None:
    space = spaces.Box(-np.inf, np.inf, (3,), np.float32)
    source = stored([buffer(0, walk(4, 0), 4)], space)
    [episode] = load(source, REACH, keys=["observation"], success="all").episodes
    np.testing.assert_array_equal(episode.observations, walk(4, 0))


def test_success_is_asked_for_where_infos_do_not_tell() -> None:
    source = stored([buffer(0, parts(walk(4, 0)), 4)], PARTS)
    with pytest.raises(Error, match="success: expected `all`.*terminations, rewards"):
        load(source, REACH)


def test_a_damaged_data_set_is_refused() -> None:
    source = stored([buffer(0, parts(walk(4, 0)), 4)], PARTS)
    file = source / "data" / "main_data.hdf5"
    file.write_bytes(file.read_bytes()[:300])
    with pytest.raises(Error, match="expected a Minari data set") as refusal:
        load(source, REACH, success="all")
    assert "\n" not in str(refusal.value)


def test_actions_are_numbers_over_the_bounds_or_choices() -> None:
    box = spaces.Box(np.array([-2, 0], np.float32), np.array([2, 4], np.float32), dtype=np.float32)
    moves = np.array([[-2, 0], [2, 4], [1, 1]], np.float32)
    np.testing.assert_array_equal(_actions(box, moves)["actions"], [[-1, -1], [1, 1], [0.5, -0.5]])
    choices = _actions(spaces.Discrete(3, start=5), np.array([5, 7]))
    np.testing.assert_array_equal(choices["actions"], [0, 2])
    source = stored([buffer(0, walk(4, 0), 4)], spaces.Box(-np.inf, np.inf, (3,), np.float32))
    [episode] = load(source, REACH, success="all", actions=["actions"]).episodes
    np.testing.assert_array_equal(np.asarray(episode.actions), np.zeros((4, 2)))


def test_an_action_that_its_bounds_leave_no_choice_is_zero() -> None:
    box = spaces.Box(np.array([-1, 0], np.float32), np.array([1, 0], np.float32))
    found = _actions(box, np.array([[-1, 0], [0.5, 0]], np.float32))["actions"]
    np.testing.assert_array_equal(found, [[-1, 0], [0.5, 0]])


@pytest.mark.parametrize("space", [spaces.Box(-4, 4, (2, 2), np.int16), spaces.Box(0, 5, ())], ids=str)
def test_actions_are_those_that_an_actor_acts_on(space: spaces.Space[Any]) -> None:
    space.seed(1)
    moves = [space.sample() for _ in range(5)]
    own = actions_of(space)
    expected = [np.frombuffer(own.encode(move), "<f4") for move in moves]
    np.testing.assert_array_equal(_actions(space, np.stack(moves))["actions"], expected)


def test_actions_of_another_space_are_refused_with_it() -> None:
    with pytest.raises(Error, match=r"expected a Discrete or a bounded Box space, found MultiDiscrete"):
        _actions(spaces.MultiDiscrete([2, 3]), np.zeros((4, 2)))


def test_actions_of_another_shape_than_their_space_are_refused() -> None:
    source = stored([buffer(0, walk(4, 0), 4)], spaces.Box(-np.inf, np.inf, (3,), np.float32))
    with h5py.File(source / "data" / "main_data.hdf5", "a") as file:
        del file["episode_0/actions"]
        file["episode_0/actions"] = np.zeros((4, 3))
    assert len(load(source, REACH, success="all").episodes) == 1
    with pytest.raises(Error, match=r"episode 0: actions: .* expected shape \(4, 2\), found \(4, 3\)"):
        load(source, REACH, success="all", actions=["actions"])
