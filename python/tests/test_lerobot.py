"""Tests of LeRobot data sets in both layouts, written with pyarrow as LeRobot documents them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from walks import REACH, walk

from goalward import Error
from goalward.demonstrations import load

V21 = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
V30 = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
KEYS = ["observation.state", "observation.environment_state"]
FEATURES = {
    "observation.state": {"dtype": "float32", "shape": [2], "names": None},
    "observation.environment_state": {"dtype": "float32", "shape": [1], "names": None},
    "observation.images.top": {"dtype": "video", "shape": [8, 8, 3], "names": None},
    "action": {"dtype": "float32", "shape": [2], "names": None},
    "next.reward": {"dtype": "float32", "shape": [1], "names": None},
    "next.success": {"dtype": "bool", "shape": [1], "names": None},
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    "frame_index": {"dtype": "int64", "shape": [1], "names": None},
    "episode_index": {"dtype": "int64", "shape": [1], "names": None},
    "index": {"dtype": "int64", "shape": [1], "names": None},
    "task_index": {"dtype": "int64", "shape": [1], "names": None},
}


def frames(episode: int, success: bool) -> pyarrow.Table:
    """Make an episode of five frames that reaches the goal at its end, or does not."""
    states = walk(4, episode)
    fixed = pyarrow.FixedSizeListArray.from_arrays
    return pyarrow.table(
        {
            "observation.state": fixed(states[:, :2].ravel(), 2),
            "observation.environment_state": states[:, 2],
            "action": fixed(np.zeros(10, np.float32), 2),
            "next.reward": np.zeros(5, np.float32),
            "next.success": [False] * 4 + [success],
            "timestamp": np.arange(5, dtype=np.float32) / 10,
            "frame_index": np.arange(5),
            "episode_index": np.full(5, episode),
            "index": np.arange(5) + 5 * episode,
            "task_index": np.zeros(5, np.int64),
        }
    )


def stored(folder: Path, version: str, **changes: Any) -> Path:
    """Write a data set of four episodes, of which the third does not reach the goal."""
    features = {**FEATURES, **changes.get("features", {})}
    path = V30 if version == "v3.0" else V21
    info = {"codebase_version": version, "fps": 10, "features": features, "data_path": path}
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    (folder / "data" / "chunk-000").mkdir(parents=True)
    episodes = [frames(episode, success=episode != 2) for episode in range(4)]
    if version == "v3.0":
        # Rows need not be in order.
        turned = pyarrow.concat_tables([episodes[1].slice(2), episodes[0], episodes[1].slice(0, 2)])
        groups = [turned, pyarrow.concat_tables(episodes[2:])]
    else:
        groups = episodes
    for number, table in enumerate(groups):
        place = path.format(episode_chunk=0, episode_index=number, chunk_index=0, file_index=number)
        pyarrow.parquet.write_table(table, folder / place)
    return folder


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_frames_are_observations(tmp_path: Path, version: str) -> None:
    loaded = load(stored(tmp_path / "set", version), REACH, keys=KEYS)
    assert [episode.name for episode in loaded.episodes] == ["0", "1", "3"]
    for episode in loaded.episodes:
        np.testing.assert_array_equal(episode.observations, walk(4, int(episode.name)))
    assert loaded.left_out == 1


def test_without_keys_all_numbers_observed_are_taken(tmp_path: Path) -> None:
    loaded = load(stored(tmp_path / "set", "v3.0"), REACH, episodes=1)
    [episode] = loaded.episodes
    np.testing.assert_array_equal(episode.observations, walk(4, 0))


def test_a_file_without_rows_has_no_episodes(tmp_path: Path) -> None:
    source = stored(tmp_path / "set", "v2.1")
    pyarrow.parquet.write_table(frames(4, True).slice(0, 0), source / "data/chunk-000/episode_000004.parquet")
    assert len(load(source, REACH).episodes) == 3


def test_all_episodes_are_taken_where_all_succeed(tmp_path: Path) -> None:
    assert len(load(stored(tmp_path / "set", "v2.1"), REACH, success="all").episodes) == 4


def test_a_missing_column_is_refused(tmp_path: Path) -> None:
    source = stored(tmp_path / "set", "v3.0")
    with pytest.raises(Error, match=r"expected `observation.angle`, found observation.state \(2\)"):
        load(source, REACH, keys=["observation.angle", "observation.state"])


def test_a_column_that_is_only_announced_is_refused(tmp_path: Path) -> None:
    feature = {"observation.angle": {"dtype": "float32", "shape": [1], "names": None}}
    source = stored(tmp_path / "set", "v3.0", features=feature)
    with pytest.raises(Error, match="expected the column `observation.angle`"):
        load(source, REACH, keys=["observation.state", "observation.angle"])


def test_rows_of_differing_lengths_are_refused(tmp_path: Path) -> None:
    source = stored(tmp_path / "set", "v3.0")
    file = next(source.glob("data/*/*.parquet"))
    table = pyarrow.parquet.read_table(file)
    ragged = pyarrow.array([[0.0], [0.0, 1.0, 2.0]] * (len(table) // 2), pyarrow.list_(pyarrow.float32()))
    place = table.column_names.index("observation.state")
    pyarrow.parquet.write_table(table.set_column(place, "observation.state", ragged), file)
    with pytest.raises(Error, match="expected rows of numbers, found lists of 1 and 3 values"):
        load(source, REACH, keys=KEYS)


def test_another_version_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Error, match=r"expected version v2.0, v2.1, v3.0, found v9.0"):
        load(stored(tmp_path / "set", "v9.0"), REACH)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    source = stored(tmp_path / "set", "v3.0")
    file = source / "data" / "chunk-000" / "file-000.parquet"
    file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(Error, match=r"file-000.parquet: expected rows of numbers") as refusal:
        load(source, REACH)
    assert "\n" not in str(refusal.value)


def test_damaged_metadata_is_refused(tmp_path: Path) -> None:
    source = stored(tmp_path / "set", "v3.0")
    (source / "meta" / "info.json").write_text("{")
    with pytest.raises(Error, match=r"info.json: expected what LeRobot writes there"):
        load(source, REACH)


def test_an_empty_data_set_is_refused(tmp_path: Path) -> None:
    source = stored(tmp_path / "set", "v2.1")
    for file in source.glob("data/*/*.parquet"):
        file.unlink()
    with pytest.raises(Error, match="found no episode"):
        load(source, REACH)


def test_actions_are_read(tmp_path: Path) -> None:
    source = stored(tmp_path / "set", "v3.0")
    loaded = load(source, REACH, keys=KEYS, actions=["action"])
    assert [np.shape(np.asarray(episode.actions)) for episode in loaded.episodes] == [(4, 2)] * 3
