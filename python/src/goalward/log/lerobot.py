"""Export of a log's trajectories as a LeRobot data set, format v3.0."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goalward.error import Error
from goalward.log.run import Log
from goalward.log.trajectory import Trajectory
from goalward.packages import optional
from goalward.replacing import new_folder
from goalward.task import Discrete, Task

VERSION = "v3.0"
CHUNK_FILES = 1000
FILE_MEGABYTES = 100
PLACE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

Frames = dict[str, NDArray[Any]]


def write_lerobot(
    log: Log, folder: str | Path, fps: int, trajectories: Iterable[Trajectory] | None = None
) -> None:
    """Write trajectories to a folder, completely or not at all.

    A trajectory of T steps becomes T frames, because LeRobot has no place for the observation after the last
    step. Grids become rows of numbers. Actions are those of `Log.acted`.

    Args:
        log: the log of the run, which has the task.
        folder: the folder of the data set; must not exist.
        fps: steps per second of the task's time.
        trajectories: the trajectories to write; None for all training episodes.

    Raises:
        Error: if the folder exists, there is no trajectory, writing fails, or a package is not installed.
    """
    if fps < 1:
        raise Error(f"fps: expected a number from 1, found {fps}")
    chosen = log.acted(log.trajectories() if trajectories is None else trajectories)
    with new_folder(Path(folder)) as root:
        episodes = list(_write_data(root, chosen, fps))
        if not episodes:
            raise Error(f"{folder}: expected at least one trajectory, found none")
        _write_episodes(root, episodes, log.task)
        _write_info(root, episodes, log.task, fps)


def features(task: Task) -> dict[str, dict[str, Any]]:
    """Return the features of a task's data set, as `meta/info.json` has them."""
    numbers = int(np.prod(task.observation.shape))
    action = ("int64", 1) if isinstance(task.action, Discrete) else ("float32", task.action.len)
    shapes = {"observation.state": ("float32", numbers), "action": action, "next.reward": ("float32", 1)}
    shapes |= {name: ("bool", 1) for name in ("next.done", "next.success")}
    shapes |= {"timestamp": ("float32", 1)}
    shapes |= {name: ("int64", 1) for name in ("frame_index", "episode_index", "index", "task_index")}
    return {name: {"dtype": dtype, "shape": [n], "names": None} for name, (dtype, n) in shapes.items()}


def _frames(trajectory: Trajectory, number: int, first: int, fps: int) -> Frames:
    steps = trajectory.steps
    frame = np.arange(steps)
    discrete = trajectory.actions.ndim == 1
    return {
        "observation.state": trajectory.observations[:-1].reshape(steps, -1).astype(np.float32),
        "action": trajectory.actions.astype(np.int64 if discrete else np.float32),
        "next.reward": trajectory.rewards,
        "next.done": frame + 1 == steps,
        "next.success": (frame + 1 == trajectory.steps_to_goal) & trajectory.success,
        "timestamp": (frame / fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.full(steps, number),
        "index": frame + first,
        "task_index": np.zeros(steps, np.int64),
    }


def _write_data(root: Path, trajectories: Iterable[Trajectory], fps: int) -> Iterator[dict[str, Any]]:
    """Write the frames file by file; yield each episode's metadata."""
    held: list[Frames] = []
    size, first, file = 0, 0, 0
    for number, trajectory in enumerate(trajectories):
        frames = _frames(trajectory, number, first, fps)
        own = sum(column.nbytes for column in frames.values())
        if held and size + own > FILE_MEGABYTES << 20:
            _write_frames(root, file, held)
            held, size, file = [], 0, file + 1
        held.append(frames)
        size += own
        yield {"length": trajectory.steps, "first": first, "file": file, "stats": _sums(frames)}
        first += trajectory.steps
    if held:
        _write_frames(root, file, held)


def _write_frames(root: Path, file: int, held: list[Frames]) -> None:
    columns = {name: np.concatenate([frames[name] for frames in held]) for name in held[0]}
    _write_table(root / "data" / _place(file), {name: _column(array) for name, array in columns.items()})


def _column(array: NDArray[Any]) -> Any:
    arrow = optional("pyarrow", "lerobot")
    flat = arrow.array(array.reshape(-1))
    width = array.shape[1] if array.ndim > 1 else 1
    return flat if width == 1 else arrow.FixedSizeListArray.from_arrays(flat, width)


def _write_table(path: Path, columns: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    arrow, parquet = optional("pyarrow", "lerobot"), optional("pyarrow.parquet", "lerobot")
    parquet.write_table(arrow.table(columns), path)


def _place(file: int) -> str:
    return PLACE.format(chunk_index=file // CHUNK_FILES, file_index=file % CHUNK_FILES)


def _write_episodes(root: Path, episodes: list[dict[str, Any]], task: Task) -> None:
    files = np.array([episode["file"] for episode in episodes])
    lengths = np.array([episode["length"] for episode in episodes])
    firsts = np.array([episode["first"] for episode in episodes])
    columns = {
        "episode_index": np.arange(len(episodes)),
        "tasks": [[task.name]] * len(episodes),
        "length": lengths,
        "data/chunk_index": files // CHUNK_FILES,
        "data/file_index": files % CHUNK_FILES,
        "dataset_from_index": firsts,
        "dataset_to_index": firsts + lengths,
        "meta/episodes/chunk_index": np.zeros(len(episodes), np.int64),
        "meta/episodes/file_index": np.zeros(len(episodes), np.int64),
    }
    _write_table(root / "meta" / "episodes" / _place(0), columns)
    pandas = optional("pandas", "lerobot")
    pandas.DataFrame({"task_index": [0]}, index=[task.name]).to_parquet(root / "meta" / "tasks.parquet")


def _write_info(root: Path, episodes: list[dict[str, Any]], task: Task, fps: int) -> None:
    info = {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": len(episodes),
        "total_frames": sum(episode["length"] for episode in episodes),
        "total_tasks": 1,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": FILE_MEGABYTES,
        "video_files_size_in_mb": 2 * FILE_MEGABYTES,
        "fps": fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": f"data/{PLACE}",
        "video_path": None,
        "features": features(task),
    }
    (root / "meta" / "info.json").write_text(json.dumps(info, indent=4))
    stats = _statistics([episode["stats"] for episode in episodes])
    (root / "meta" / "stats.json").write_text(json.dumps(stats, indent=4))


def _sums(frames: Frames) -> dict[str, Frames]:
    """Return minimum, maximum, sum, sum of squares and count of each column."""
    rows = {name: array.reshape(len(array), -1).astype(np.float64) for name, array in frames.items()}
    return {
        name: {
            "min": array.min(axis=0),
            "max": array.max(axis=0),
            "sum": array.sum(axis=0),
            "squares": (array**2).sum(axis=0),
            "count": np.array([len(array)]),
        }
        for name, array in rows.items()
    }


def _statistics(episodes: list[dict[str, Frames]]) -> dict[str, dict[str, list[float]]]:
    return {name: _statistic([episode[name] for episode in episodes]) for name in episodes[0]}


def _statistic(sums: list[Frames]) -> dict[str, list[float]]:
    count = sum(int(own["count"][0]) for own in sums)
    mean = np.sum([own["sum"] for own in sums], axis=0) / count
    variance = np.sum([own["squares"] for own in sums], axis=0) / count - mean**2
    return {
        "min": np.min([own["min"] for own in sums], axis=0).tolist(),
        "max": np.max([own["max"] for own in sums], axis=0).tolist(),
        "mean": mean.tolist(),
        "std": np.sqrt(np.maximum(variance, 0)).tolist(),
        "count": [count],
    }
