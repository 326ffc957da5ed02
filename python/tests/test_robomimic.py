"""Tests of robomimic data sets, written with h5py as robomimic documents them."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from walks import REACH, walk

from goalward import Error
from goalward.demonstrations import load


def stored(path: Path, demonstrations: list[tuple[Any, list[float]]], *, following: bool = True) -> Path:
    """Write a file of demonstrations, each with its states and its rewards, one fewer than states."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        for number, (states, rewards) in enumerate(demonstrations):
            group = data.create_group(f"demo_{number}")
            group.attrs["num_samples"] = len(rewards)
            group["rewards"] = rewards
            group["dones"] = [0] * (len(rewards) - 1) + [1]
            group["actions"] = np.zeros((len(rewards), 2))
            for name, rows in (("obs", states[:-1]), ("next_obs", states[1:])):
                if name == "obs" or following:
                    group[f"{name}/hand"] = rows[:, :2]
                    group[f"{name}/cube"] = rows[:, 2:]
                    group[f"{name}/camera_image"] = np.zeros((len(rows), 8, 8, 3), np.uint8)
    return path


def test_the_state_behind_the_last_step_is_the_last_one(tmp_path: Path) -> None:
    source = stored(tmp_path / "demo.hdf5", [(walk(4, number), [0, 0, 0, 1]) for number in range(12)])
    loaded = load(source, REACH, keys=["hand", "cube"])
    assert [episode.name for episode in loaded.episodes] == [f"demo_{number}" for number in range(12)]
    for number, episode in enumerate(loaded.episodes):
        np.testing.assert_array_equal(episode.observations, walk(4, number))


def test_without_it_the_state_before_the_last_step_is(tmp_path: Path) -> None:
    demonstrations: list[tuple[Any, list[float]]] = [(walk(4, 0), [0, 0, 0, 1]), (walk(4, 1), [0, 1, 1, 1])]
    source = stored(tmp_path / "demo.hdf5", demonstrations, following=False)
    late, early = (episode.observations for episode in load(source, REACH, keys=["hand", "cube"]).episodes)
    np.testing.assert_array_equal(late, walk(4, 0)[:-1])
    np.testing.assert_array_equal(early, walk(4, 1)[:3])


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.hdf5", "w") as file:
        file["data"] = np.zeros((3, 2))
    with pytest.raises(Error, match="expected a group `data` of demonstrations, found a dataset"):
        load(tmp_path / "other.hdf5", REACH)


def test_a_demonstration_ends_at_the_first_reward(tmp_path: Path) -> None:
    demonstrations = [(walk(4, 0), [0.0, 1, 1, 1]), (walk(4, 1), [0.0, 0, 0, 0])]
    loaded = load(stored(tmp_path / "demo.hdf5", demonstrations), REACH, keys=["hand", "cube"])
    [episode] = loaded.episodes
    np.testing.assert_array_equal(episode.observations, walk(4, 0)[:3])
    assert loaded.left_out == 1


def test_a_dense_reward_does_not_tell_success(tmp_path: Path) -> None:
    source = stored(tmp_path / "demo.hdf5", [(walk(4, 0), [0.1, 0.4, 0.9, 1])])
    with pytest.raises(Error, match="episode demo_0: rewards: expected 0 and 1, found 0.1"):
        load(source, REACH, keys=["hand", "cube"])
    assert len(load(source, REACH, keys=["hand", "cube"], success="dones").episodes) == 1


def test_images_are_no_keys(tmp_path: Path) -> None:
    source = stored(tmp_path / "demo.hdf5", [(walk(4, 0), [0, 0, 0, 1])])
    with pytest.raises(Error, match=r"expected `camera_image`, found"):
        load(source, REACH, keys=["camera_image"])
    assert len(load(source, REACH).episodes) == 1


@pytest.mark.parametrize("keep", [0.3, 0.9])
def test_a_damaged_file_is_refused(tmp_path: Path, keep: float) -> None:
    source = stored(tmp_path / "demo.hdf5", [(walk(4, 0), [0, 0, 0, 1])])
    data = source.read_bytes()
    source.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(Error, match="demo.hdf5: expected an HDF5 file") as refusal:
        load(source, REACH)
    assert "\n" not in str(refusal.value)


def test_a_file_without_demonstrations_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Error, match="expected at least one episode that reaches the goal, found no episode"):
        load(stored(tmp_path / "demo.hdf5", []), REACH)


@pytest.mark.parametrize("following", [True, False])
def test_actions_are_read(tmp_path: Path, following: bool) -> None:
    source = stored(tmp_path / "demo.hdf5", [(walk(4, 0), [0, 0, 0, 1])], following=following)
    [episode] = load(source, REACH, keys=["hand", "cube"], actions=["actions"]).episodes
    assert np.shape(np.asarray(episode.actions)) == (4 if following else 3, 2)


def add(source: Path, **members: Any) -> None:
    with h5py.File(source, "a") as file:
        for name, member in members.items():
            file["data/demo_0"][name] = member


@pytest.mark.parametrize("following", [True, False])
@pytest.mark.parametrize(
    ("won", "states"),
    [([0, 1, 0, 0], 3), ([False, False, False, True], 5), ([1], 5), (1.0, 5)],
)
def test_a_signal_beside_the_observations_tells_success(
    tmp_path: Path, following: bool, won: Any, states: int
) -> None:
    source = stored(tmp_path / "demo.hdf5", [(walk(4, 0), [0, 0, 0, 0])], following=following)
    add(source, won=won)
    [episode] = load(source, REACH, keys=["hand", "cube"], success="won").episodes
    np.testing.assert_array_equal(episode.observations, walk(4, 0)[: states if following else min(states, 4)])


def test_a_signal_that_never_tells_success_leaves_the_demonstration_out(tmp_path: Path) -> None:
    demonstrations = [(walk(4, number), [0.0, 0, 0, 1]) for number in range(2)]
    source = stored(tmp_path / "demo.hdf5", demonstrations)
    with h5py.File(source, "a") as file:
        file["data/demo_0/won"], file["data/demo_1/won"] = [0] * 4, [0, 0, 1, 0]
    loaded = load(source, REACH, keys=["hand", "cube"], success="won")
    assert [episode.name for episode in loaded.episodes] == ["demo_1"]
    assert loaded.left_out == 1


@pytest.mark.parametrize("key", ["none", "obs", "obs/won", "words"])
def test_what_is_no_signal_is_refused(tmp_path: Path, key: str) -> None:
    source = stored(tmp_path / "demo.hdf5", [(walk(4, 0), [0, 0, 0, 1])])
    add(source, words=["a"] * 4, **{"obs/won": [0] * 4})
    expected = rf"episode demo_0: success: .* success key \(dones, rewards\), found `{key}`"
    with pytest.raises(Error, match=expected):
        load(source, REACH, keys=["hand", "cube"], success=key)


def test_a_group_is_neither_a_key_nor_an_action(tmp_path: Path) -> None:
    source = stored(tmp_path / "demo.hdf5", [(walk(4, 0), [0, 0, 0, 1])])
    add(source, **{"obs/camera/depth": [0] * 4})
    assert len(load(source, REACH).episodes) == 1
    with pytest.raises(Error, match="episode demo_0: actions: expected `obs`, found none"):
        load(source, REACH, keys=["hand", "cube"], actions=["obs"])
