"""Tests of a log's trajectories in other formats, read back with the real packages and our own importers."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import minari
import numpy as np
import pandas
import pyarrow.parquet
import pytest
from logs import CONFIG, trajectory, write
from walks import REACH, ROOMS, rooms, walk

from goalward import Cells, Discrete, Error, Task, schema
from goalward.demonstrations import load
from goalward.log import Log, lerobot, write_lerobot, write_minari

GOAL = {"ending": schema.GOAL_REACHED, "success": True}
FILE = "log/trajectories-00000.mcap"
SCALE = [0.5, 2.0]


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Log:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    episodes = [
        trajectory(0, 0, 0, steps=4, **GOAL, steps_to_goal=4),
        trajectory(0, 1, 1, steps=6),
        trajectory(1, 0, 2, steps=5, **GOAL, steps_to_goal=3),
    ]
    messages = [("/trajectory", episode) for episode in episodes]
    write(tmp_path / FILE, messages, config=f"{CONFIG}[environment]\naction_scale = {SCALE}\n")
    return Log(tmp_path)


@pytest.fixture
def grid_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Log:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    changes = {"values": [], "continuous_actions": [], "discrete_actions": bytes([3, 1])}
    episode = trajectory(0, 0, 0, steps=2, cells=rooms(2, 0).tobytes(), **changes)
    write(tmp_path / FILE, [("/trajectory", episode)], ROOMS)
    return Log(tmp_path)


def test_minari_loads_the_episodes(log: Log) -> None:
    write_minari(log, "goalward/reach-v0", description="walks")
    data = minari.load_dataset("goalward/reach-v0")
    assert (data.total_episodes, data.total_steps) == (3, 15)
    for episode, recorded in zip(data.iterate_episodes(), log.trajectories(), strict=True):
        np.testing.assert_array_equal(episode.observations, recorded.observations)
        np.testing.assert_array_equal(episode.actions, np.clip(SCALE * recorded.actions, -1, 1))
        np.testing.assert_array_equal(episode.rewards, recorded.rewards)
    endings = [(one.terminations[-1], one.truncations[-1]) for one in data.iterate_episodes()]
    assert endings == [(True, False), (False, True), (True, False)]


@pytest.mark.parametrize("data_format", ["hdf5", "arrow"])
def test_minari_loads_grids_and_choices(grid_log: Log, data_format: str) -> None:
    write_minari(grid_log, "goalward/rooms-v0", data_format=data_format)
    [episode] = minari.load_dataset("goalward/rooms-v0").iterate_episodes()
    np.testing.assert_array_equal(episode.observations, rooms(2, 0))
    assert episode.actions.tolist() == [3, 1]


def test_large_grids_of_256_classes_lose_nothing(tmp_path: Path, grid_log: Log) -> None:
    task = Task("map", Cells(32, 32, 256), Discrete(4), horizon_steps=20)
    cells = np.random.default_rng(0).integers(0, 256, (3, 32, 32)).astype(np.uint8)
    changes = {"values": [], "continuous_actions": [], "discrete_actions": bytes([3, 1])}
    write(
        tmp_path / "map" / FILE,
        [("/trajectory", trajectory(0, 0, 0, 2, cells=cells.tobytes(), **changes))],
        task,
    )
    write_minari(Log(tmp_path / "map"), "goalward/map-v0")
    [episode] = minari.load_dataset("goalward/map-v0").iterate_episodes()
    np.testing.assert_array_equal(episode.observations, cells)


def test_a_minari_data_set_becomes_demonstrations_again(log: Log, tmp_path: Path) -> None:
    write_minari(log, "goalward/reach-v0")
    loaded = load(tmp_path / "minari" / "goalward" / "reach-v0", REACH)
    assert loaded.left_out == 1
    first, third = (episode.observations for episode in loaded.episodes)
    np.testing.assert_array_equal(first, walk(4, 0))
    np.testing.assert_array_equal(third, walk(5, 2)[:4])


def test_chosen_trajectories_are_stored(log: Log) -> None:
    chosen = (one for one in log.trajectories() if one.iteration == 1)
    assert write_minari(log, "goalward/late-v0", chosen).total_episodes == 1


@pytest.mark.parametrize("reason", ["none", "there"])
def test_minari_refuses_in_one_line(log: Log, reason: str) -> None:
    if reason == "none":
        with pytest.raises(Error, match="expected at least one trajectory, found none"):
            write_minari(log, "goalward/reach-v0", [])
        return
    write_minari(log, "goalward/reach-v0")
    with pytest.raises(Error, match="expected the name of a new data set, found .*already exists"):
        write_minari(log, "goalward/reach-v0")


def test_lerobot_has_a_frame_for_each_step(log: Log, tmp_path: Path) -> None:
    write_lerobot(log, tmp_path / "set", fps=10)
    table = pyarrow.parquet.read_table(tmp_path / "set" / "data" / "chunk-000" / "file-000.parquet")
    states = np.array(table["observation.state"].to_pylist(), np.float32)
    np.testing.assert_array_equal(states, np.concatenate([walk(4, 0)[:-1], walk(6, 1)[:-1], walk(5, 2)[:-1]]))
    chosen = np.concatenate([recorded.actions for recorded in log.trajectories()])
    np.testing.assert_array_equal(table["action"].to_pylist(), np.clip(SCALE * chosen, -1, 1))
    assert table["next.done"].to_pylist() == [False] * 3 + [True] + [False] * 5 + [True] + [False] * 4 + [
        True
    ]
    assert np.flatnonzero(table["next.success"].to_pylist()).tolist() == [3, 12]
    assert table["index"].to_pylist() == list(range(15))
    np.testing.assert_allclose(table["timestamp"].to_pylist()[4:10], np.arange(6) / 10, rtol=1e-6)


def test_lerobot_metadata_says_where_episodes_are(log: Log, tmp_path: Path) -> None:
    write_lerobot(log, tmp_path / "set", fps=10)
    meta = tmp_path / "set" / "meta"
    info = json.loads((meta / "info.json").read_text())
    assert (info["codebase_version"], info["total_episodes"], info["total_frames"]) == ("v3.0", 3, 15)
    assert info["features"]["observation.state"] == {"dtype": "float32", "shape": [3], "names": None}
    episodes = pyarrow.parquet.read_table(meta / "episodes" / "chunk-000" / "file-000.parquet").to_pydict()
    assert episodes["length"] == [4, 6, 5]
    assert list(zip(episodes["dataset_from_index"], episodes["dataset_to_index"], strict=True)) == [
        (0, 4),
        (4, 10),
        (10, 15),
    ]
    assert pandas.read_parquet(meta / "tasks.parquet").loc["reach"].task_index == 0
    stats = json.loads((meta / "stats.json").read_text())
    table = pyarrow.parquet.read_table(tmp_path / "set" / "data" / "chunk-000" / "file-000.parquet")
    states = np.array(table["observation.state"].to_pylist())
    np.testing.assert_allclose(stats["observation.state"]["mean"], states.mean(axis=0))
    np.testing.assert_allclose(stats["observation.state"]["std"], states.std(axis=0))
    assert stats["observation.state"]["count"] == [15]


def test_a_lerobot_data_set_becomes_demonstrations_again(log: Log, tmp_path: Path) -> None:
    write_lerobot(log, tmp_path / "set", fps=10)
    loaded = load(tmp_path / "set", REACH)
    assert loaded.left_out == 1
    first, third = (episode.observations for episode in loaded.episodes)
    np.testing.assert_array_equal(first, walk(4, 0)[:-1])
    np.testing.assert_array_equal(third, walk(5, 2)[:4])


def test_lerobot_takes_grids_as_rows(grid_log: Log, tmp_path: Path) -> None:
    write_lerobot(grid_log, tmp_path / "set", fps=1)
    task = replace(ROOMS, tells_success=False)
    [episode] = load(tmp_path / "set", task, success="all").episodes
    np.testing.assert_array_equal(episode.observations, rooms(2, 0)[:-1])


def test_lerobot_begins_another_file_when_one_is_full(
    log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lerobot, "FILE_MEGABYTES", 0)
    write_lerobot(log, tmp_path / "set", fps=10)
    files = sorted(path.name for path in tmp_path.glob("set/data/*/*.parquet"))
    assert files == ["file-000.parquet", "file-001.parquet", "file-002.parquet"]
    assert len(load(tmp_path / "set", REACH, success="all").episodes) == 3


def broken(log: Log) -> Any:
    yield next(log.trajectories())
    raise Error("the disk has gone")


def test_nothing_of_a_lerobot_data_set_is_left_when_it_fails(log: Log, tmp_path: Path) -> None:
    before = sorted(tmp_path.iterdir())
    with pytest.raises(Error, match="the disk has gone"):
        write_lerobot(log, tmp_path / "set", 10, broken(log))
    with pytest.raises(Error, match="expected at least one trajectory, found none"):
        write_lerobot(log, tmp_path / "set", 10, [])
    with pytest.raises(Error, match="fps: expected a number from 1, found 0"):
        write_lerobot(log, tmp_path / "set", 0)
    assert sorted(tmp_path.iterdir()) == before
    (tmp_path / "set").mkdir()
    with pytest.raises(Error, match="expected no such file or folder, found one$"):
        write_lerobot(log, tmp_path / "set", 10)
